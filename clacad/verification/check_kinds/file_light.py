"""Kinds of checks by light through files: as the law, and as the design is cut."""

from __future__ import annotations

from clacad.verification.checks import CheckKind

FAITHFUL_RMS = CheckKind(
    "faithful_rms", "CL346", "rad", where="file", limit="file_rms", former="file_rms"
).explained(
    means=(
        "Direction error of light through the file's own surfaces against the design's exact ones: "
        "whether the file is the design, with the facets that it states. Whether light through it "
        "obeys the law is measured by file_law_rms."
    ),
    why="Facets that are as coarse as stated are faithful; dents, noise and wrong corners are not.",
    formula=(
        "≤ 1.25 × forecast from the facets' slope errors, and an absolute limit where no manifest "
        "states any; 10⁻⁶ rad for STEP"
    ),
    do="Export it again; if it is of a measured part, look at the deviation map.",
)

FAITHFUL_ETA = CheckKind(
    "faithful_eta", "CL347", "relative", where="file", limit="eta", former="file_eta"
).explained(
    means="η fitted to light through the file, against the design cut into the same facets.",
    why="It finds wrong radii however coarse the facets are.",
    formula="max_i |η_i,file/η_i,design − 1|",
    do="The part is not this design: wrong radius, index, separation or scale in z.",
)

FAITHFUL_DELTA = CheckKind(
    "faithful_delta", "CL348", "slope", where="file", limit="delta", former="file_delta"
).explained(
    means="δ fitted to light through the file, against the design cut into the same facets.",
    why="It finds decentred or exchanged lenses.",
    formula="max_i |δ_i,file − δ_i,design|",
    do="Check decentre of the arrays, sign of δ, and handedness.",
)

FILE_LAW_RMS = CheckKind("file_law_rms", "CL349", "rad", where="file", limit="law_rms").explained(
    means=(
        "Rms angle between light through the file's own triangles or faces and the requested law; "
        "limit law_rms, or check.mesh_law_rms if given; fails a master, warns a preview. The value is "
        "that of the worst traced cell; the sentence adds the rms over all traced cells, and where an "
        "array is displaced the rms of the light that leaves nearer to the law than to the direction "
        "of a neighbouring lens."
    ),
    why=(
        "Parts are made from the file, not from the design: facets that are too coarse bend light wherever "
        "they lie."
    ),
    formula="√⟨∠(d', A d)²⟩ over ALIVE rays through the file; a facet's slope error falls as its size",
    do=(
        "Finer facets (--quads, --slope-error, or 3MF, whose one cell repeated is small), or send the STEP; "
        "if the file is only looked at, declare it: --role preview."
    ),
)

FILE_LAW_BIAS = CheckKind("file_law_bias", "CL356", "rad", where="file", limit="law_bias").explained(
    means=(
        "Largest angle, over nine directions of the field, between the mean direction of light through "
        "the file and the law; fails a master, warns a preview."
    ),
    why="A mean error bends straight lines; a blur only softens them.",
    formula="max ∠(⟨d'⟩, A d) through the file; limit law_bias",
    do="Finer facets; if the exact surfaces miss it too (law_bias), the design.",
)

FILE_LAW_ETA = CheckKind("file_law_eta", "CL357", "relative", where="file", limit="eta").explained(
    means=(
        "η fitted to light through the file less η fitted to the same rays through the exact surfaces; "
        "fails a master, warns a preview."
    ),
    why=(
        "Four facets across a lens can show another magnification than the requested one. The "
        "difference is taken because aberration alone moves a fit over a degree by 1 to 2 %."
    ),
    formula="max_i |η_i,file/η_i,exact − 1|; limit check.eta",
    do="Finer facets, or another file: wrong radius, index, separation or scale in z.",
)

FILE_LAW_DELTA = CheckKind("file_law_delta", "CL358", "slope", where="file", limit="delta").explained(
    means=(
        "δ fitted to light through the file less δ fitted to the same rays through the exact surfaces; "
        "fails a master, warns a preview."
    ),
    why="An error of δ shifts the whole image.",
    formula="max_i |δ_i,file − δ_i,exact|; limit check.delta",
    do="Finer facets, or another file: arrays decentred, exchanged or mirrored.",
)

FILE_CONFOCALITY = CheckKind(
    "file_confocality", "CL359", "of separation", where="file", limit="confocality"
).explained(
    means=(
        "How far array 2 would have to move along the normal for light through the file to keep to the "
        "law as well as through the exact surfaces; fails a master, warns a preview."
    ),
    why="A file whose arrays lie at the wrong distance focuses or spreads light.",
    formula=(
        "argmin over Δz of the rms to the law, file less exact, same rays, worse axis, over the "
        "separation; limit check.confocality"
    ),
    do="Check the distance of the bodies in the file and its unit; finer facets.",
)

FILE_THROUGHPUT = CheckKind(
    "file_throughput", "CL366", "of closed form", relation=">=", where="file", rule="throughput"
).explained(
    means=(
        "Share of the light that passes the file's own triangles or faces by corresponding lenslets, "
        "over what thin lenses would keep; fails a master, warns a preview."
    ),
    why="Light that a facet throws on a wrong lenslet is lost to the image and seen as a ghost.",
    formula="ALIVE/launched through the file ÷ V; limit check.throughput (0.9)",
    do="Finer facets; if the exact surfaces miss it too (throughput), the design.",
)

THROUGH_FILE = (
    FILE_LAW_RMS,
    FILE_LAW_BIAS,
    FILE_LAW_ETA,
    FILE_LAW_DELTA,
    FILE_CONFOCALITY,
    FILE_THROUGHPUT,
)
"""Checks of light through a file against the law: by them a file is called an optical master."""

FILE_NORMALS = CheckKind("file_normals", "CL367", where="file").explained(
    means=(
        "Normals stored in a file (PLY, GLB) against the normals of the exact surface at the same "
        "points; fails in every role."
    ),
    why=(
        "A renderer shades and refracts by the stored normals: wrong ones show another part. Right ones "
        "never make a master, for parts are made from the facets."
    ),
    formula="∠(n_stored, n_surface) ≤ 2 × the facets' slope error",
    do="Export it again; another program may have turned or recomputed the normals.",
)

FILE_TARGET = CheckKind("file_target", "CL355", "rad", where="file", rule="--target").explained(
    means="Whether a file keeps the error that its export requested.",
    why="An export that names a target has promised it.",
    do="Export with a finer setting.",
)

CONVERGENCE = CheckKind("convergence", "CL353", "order", relation="in", where="mesh").explained(
    means=(
        "Whether light through facets approaches the exact surfaces as they shrink, at the rate physics "
        "predicts."
    ),
    why="A wrong order means that mesh or tracer is wrong, however small the error.",
    formula="direction error ∝ L, η error ∝ L²",
    do="This is an error of the program: please report it with the design.",
)

STACK_LIGHT = CheckKind("stack_light", "CL380", where="file").explained(
    means=(
        "Rays that pass every sheet of a stack are sent through the faces of the written assembly, all "
        "sheets one after the other, and leave as they do through the exact surfaces."
    ),
    why="Each sheet may be right and the assembly wrong: a sheet turned, exchanged or missing.",
    formula="max ∠(d' through the file, d' through the exact surfaces) ≤ 10⁻⁶ rad",
    do="Export the stack again; give `clacad stack --files` the designs, gaps and cells it was made with.",
)
