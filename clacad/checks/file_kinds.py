"""Kinds of checks of files and maps: what they are, whether whole, their pose, light through them."""

from __future__ import annotations

from typing import Any

from clacad.checks.check import Check, CheckKind
from clacad.storage.errors import ExportError, OverBudget, WorkerDied

READABLE = CheckKind("readable", "CL339", where="file").explained(
    means="Whether the file could be read, and what is in it.",
    why="No other check can run on a file that cannot be read.",
    do="Export it again, or in another format.",
)

DESIGN = CheckKind("design", "CL340", relation="=", where="file").explained(
    means="Whether the files were made from this very design.",
    why="Files of another design are judged by this one, and may fail for that.",
    formula="sha256 of the canonical text",
    do="Verify against the design they were made from.",
)

INTEGRITY = CheckKind("integrity", "CL341", relation="=", where="file").explained(
    means="Whether a file's bytes are those that were written.",
    why="A changed file is no longer what was checked.",
    formula="sha256",
    do="Export it again. A file from a workshop: verify it alone, outside its folder.",
)

TABLE = CheckKind("table", "CL371", where="file").explained(
    means="Whether the table of cells next to the files is the one whose SHA-256 the design states.",
    why="The table defines the places of the lenses: another table is another part.",
    do="Export again, or take the design and the table that belong together.",
)

CLOSED = CheckKind("closed", "CL342", where="file").explained(
    means="Whether the surface of a mesh is closed and consistently wound.",
    why="An open mesh has no inside, so nothing can be made from it.",
    formula="every edge once in each direction",
    do="Export it again. For a scan an open surface is normal, and only a warning.",
)

PIECES = CheckKind("pieces", "CL343", where="file").explained(
    means="Number of connected pieces in a file.",
    why="More pieces than designed: something is missing or torn.",
    do="Export it again.",
)

SOLIDS = CheckKind("solids", "CL354", relation="=", where="file").explained(
    means="Number of solids in a STEP file.",
    why="A solid too few is a piece that was lost.",
    do="Export it again.",
)

BODIES = CheckKind("bodies", "CL368", relation="=", where="file").explained(
    means="Whether a delivery holds every body of the design; a missing one is named in a warning.",
    why="Without its second array a sheet does not refract by the law, and nobody notices before assembly.",
    do="Export all bodies, or send the other file along; verify them together.",
)

PLACEMENT = CheckKind("placement", "CL369", where="file").explained(
    means="Whether every instance of a repeated cell lies at a cell of the lattice: all placements are read.",
    why="One row of instances a few per cent of the pitch aside sends its light elsewhere, and no cell by "
    "itself is wrong.",
    formula="|placement − lattice| ≤ 10⁻⁷ of the pitch, each cell exactly once",
    do="Export it again; a program that moved instances must not be trusted with the rest.",
)

DELIVERY = CheckKind("delivery", "CL370", where="file").explained(
    means="Whether a delivery can be judged at all: it fails if no optical file was judged, as when it "
    "holds nothing but frames, baffles or coupons, or when its manifest withholds its optical files.",
    why="A comparison of bytes alone measures no light, so the files cannot be passed.",
    do="Verify a folder with an optical master in it, with the manifest that was written with it, or the "
    "file by itself.",
)

VOLUME = CheckKind("volume", "CL344", where="file", limit="volume").explained(
    means="Volume a file encloses against quadrature of the design.",
    why="It finds what no picture shows: a facet turned over, a wrong unit, a missing body.",
    formula="|V − ∫(back − front)| ≤ stated chord error",
    do="Export it again; check the unit.",
)

SHAPE = CheckKind("shape", "CL345", where="file", limit="shape").explained(
    means="Distance of a file's surfaces from the exact faces; for a measured part the mean over its "
    "cells, without noise.",
    why="A deviation that all cells share is the process; one cell's own is damage.",
    formula="1.1 × L²/8R for facets; 10⁻⁷ pitch for STEP",
    do="Finer facets, or look at the deviation map.",
)

SCALE = CheckKind("scale", "CL350", "relative", where="file", limit="scale").explained(
    means="Size of a file over the design's.",
    why="Shrinkage moves partners apart by more than a cell in a large sheet.",
    formula="fitted scale, or extent over extent",
    do="Compensate the shrinkage in the process, or check the unit.",
)

POSE = CheckKind("pose", "CL351", where="file", limit="pose").explained(
    means="Pose of a measured part in its file: axes turned, rotation, displacement; and the error of "
    "the fit.",
    why="A part in the design's own frame that fits only when turned has tilt, offset or arrays of the "
    "other sign.",
    formula="24 turns of the axes, then least squares point to plane; residual ≤ pitch/20",
    do="If the part was turned on purpose, mount it turned; if not, it is not the design's part.",
)

HANDEDNESS = CheckKind("handedness", "CL352", where="file").explained(
    means="Whether the part is the design or its mirror image.",
    why="A mirrored part shows the view flipped left to right; δ and φ, ψ have the other sign.",
    formula="best of 24 mirrored turns against the best of 24 proper ones",
    do="Mirror the file back: somebody's software took a left-handed frame.",
)


def unreadable(error: Exception, **rest: Any) -> Check:
    """Return the failed check of a file that could not be read; its detail names an exceeded budget."""
    known = isinstance(error, (ExportError, OSError))
    why = str(error) if known else f"damaged ({type(error).__name__}: {str(error)[:200]})"
    beyond = isinstance(error, (OverBudget, MemoryError))
    beyond |= isinstance(error, WorkerDied) and error.over_budget
    detail = {"over_budget": True} if beyond else {}
    return READABLE.check("fail", f"it cannot be read: {why}", detail=detail, **rest)


FAITHFUL_RMS = CheckKind(
    "faithful_rms", "CL346", "rad", where="file", limit="file_rms", former="file_rms"
).explained(
    means="Direction error of light through the file's own surfaces against the design's exact ones: "
    "whether the file is the design, with the facets that it states. Whether light through it "
    "obeys the law is measured by file_law_rms.",
    why="Facets that are as coarse as stated are faithful; dents, noise and wrong corners are not.",
    formula="≤ 1.25 × forecast from the facets' slope errors, and an absolute limit where no manifest "
    "states any; 10⁻⁶ rad for STEP",
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
    means="Rms angle between light through the file's own triangles or faces and the requested law; "
    "limit law_rms, or check.mesh_law_rms if given; fails a master, warns a preview. The value is "
    "that of the worst traced cell; the sentence adds the rms over all traced cells, and where an "
    "array is displaced the rms of the light that leaves nearer to the law than to the direction "
    "of a neighbouring lens.",
    why="Parts are made from the file, not from the design: facets that are too coarse bend light wherever "
    "they lie.",
    formula="√⟨∠(d', A d)²⟩ over ALIVE rays through the file; a facet's slope error falls as its size",
    do="Finer facets (--quads, --slope-error, or 3MF, whose one cell repeated is small), or send the STEP; "
    "if the file is only looked at, declare it: --role preview.",
)

FILE_LAW_WHITE = CheckKind("file_law_white", "CL375", "rad", where="file", limit="law_white").explained(
    means="Rms angle between light through the file and the requested law in each line of light.spectrum, "
    "averaged over the lines; only where check.law_white is written.",
    why="A file may hold the faces of a sheet for daylight.",
    formula="as law_white, through the file",
    do="As for file_law_rms and law_white.",
)

FILE_LAW_BIAS = CheckKind("file_law_bias", "CL356", "rad", where="file", limit="law_bias").explained(
    means="Largest angle, over nine directions of the field, between the mean direction of light through "
    "the file and the law; fails a master, warns a preview.",
    why="A mean error bends straight lines; a blur only softens them.",
    formula="max ∠(⟨d'⟩, A d) through the file; limit law_bias",
    do="Finer facets; if the exact surfaces miss it too (law_bias), the design.",
)

FILE_LAW_ETA = CheckKind("file_law_eta", "CL357", "relative", where="file", limit="eta").explained(
    means="η fitted to light through the file less η fitted to the same rays through the exact surfaces; "
    "fails a master, warns a preview.",
    why="Four facets across a lens can show another magnification than the requested one. The "
    "difference is taken because aberration alone moves a fit over a degree by 1 to 2 %.",
    formula="max_i |η_i,file/η_i,exact − 1|; limit check.eta",
    do="Finer facets, or another file: wrong radius, index, separation or scale in z.",
)

FILE_LAW_DELTA = CheckKind("file_law_delta", "CL358", "slope", where="file", limit="delta").explained(
    means="δ fitted to light through the file less δ fitted to the same rays through the exact surfaces; "
    "fails a master, warns a preview.",
    why="An error of δ shifts the whole image.",
    formula="max_i |δ_i,file − δ_i,exact|; limit check.delta",
    do="Finer facets, or another file: arrays decentred, exchanged or mirrored.",
)

FILE_CONFOCALITY = CheckKind(
    "file_confocality", "CL359", "of separation", where="file", limit="confocality"
).explained(
    means="How far array 2 would have to move along the normal for light through the file to keep to the "
    "law as well as through the exact surfaces; fails a master, warns a preview.",
    why="A file whose arrays lie at the wrong distance focuses or spreads light.",
    formula="argmin over Δz of the rms to the law, file less exact, same rays, worse axis, over the "
    "separation; limit check.confocality",
    do="Check the distance of the bodies in the file and its unit; finer facets.",
)

FILE_THROUGHPUT = CheckKind(
    "file_throughput", "CL366", "of closed form", relation=">=", where="file", rule="throughput"
).explained(
    means="Share of the light that passes the file's own triangles or faces by corresponding lenslets, "
    "over what thin lenses would keep; fails a master, warns a preview.",
    why="Light that a facet throws on a wrong lenslet is lost to the image and seen as a ghost.",
    formula="ALIVE/launched through the file ÷ V; limit check.throughput (0.9)",
    do="Finer facets; if the exact surfaces miss it too (throughput), the design.",
)

THROUGH_FILE = (FILE_LAW_RMS, FILE_LAW_BIAS, FILE_LAW_ETA, FILE_LAW_DELTA, FILE_CONFOCALITY, FILE_THROUGHPUT)
"""Checks of light through a file against the law: by them a file is called an optical master."""

FILE_NORMALS = CheckKind("file_normals", "CL367", where="file").explained(
    means="Normals stored in a file (PLY, GLB) against the normals of the exact surface at the same "
    "points; fails in every role.",
    why="A renderer shades and refracts by the stored normals: wrong ones show another part. Right ones "
    "never make a master, for parts are made from the facets.",
    formula="∠(n_stored, n_surface) ≤ 2 × the facets' slope error",
    do="Export it again; another program may have turned or recomputed the normals.",
)

FILE_TARGET = CheckKind("file_target", "CL355", "rad", where="file", rule="--target").explained(
    means="Whether a file keeps the error that its export requested.",
    why="An export that names a target has promised it.",
    do="Export with a finer setting.",
)

CONVERGENCE = CheckKind("convergence", "CL353", "order", relation="in", where="mesh").explained(
    means="Whether light through facets approaches the exact surfaces as they shrink, at the rate physics "
    "predicts.",
    why="A wrong order means that mesh or tracer is wrong, however small the error.",
    formula="direction error ∝ L, η error ∝ L²",
    do="This is an error of the program: please report it with the design.",
)

STACK_LIGHT = CheckKind("stack_light", "CL380", where="file").explained(
    means="Rays that pass every sheet of a stack are sent through the faces of the written assembly, all "
    "sheets one after the other, and leave as they do through the exact surfaces.",
    why="Each sheet may be right and the assembly wrong: a sheet turned, exchanged or missing.",
    formula="max ∠(d' through the file, d' through the exact surfaces) ≤ 10⁻⁶ rad",
    do="Export the stack again; give `clacad stack --files` the designs, gaps and cells it was made with.",
)

CANNOT_SAY = "cannot_say"
"""Key in the detail of a check without an answer: what would have to be known."""

SCAN_PITCH = CheckKind("scan_pitch", "CL381", "relative", where="file", rule="fixed: 0.005").explained(
    means="Pitch of the measured lenslets against the design's. Pitch and lateral scale of an instrument are"
    " one number: a part that shrank and a wrong scale look alike.",
    why="Arrays of different pitch are displaced against each other towards the rim of the sheet.",
    formula="max |p/p₀ − 1| over both steps of the lattice; its uncertainty is that of the lateral scale",
    do="State the lateral scale (--lateral-scale). A part that shrank: allow for it in the tool.",
)

SCAN_RADIUS = CheckKind("scan_radius", "CL382", "relative", where="file", limit="law_rms").explained(
    means="Mean radius of the measured lenslets against the design's; a warning beyond the error that alone"
    " would use up the limit of law_rms. Light decides: see scan_light.",
    why="The radius sets the focus. A map fixes only the radius over the scale of heights.",
    formula="|R/R₀ − 1| ≤ law_rms f/r, r the rms distance from the middle of a cell",
    do="State the scale of heights (--z-scale), or find it by a tilted map (--tilted). Another radius:"
    " another insert or tool, or shrinkage in height.",
)

SCAN_FORM = CheckKind("scan_form", "CL383", where="file", rule="a quarter of the wavelength").explained(
    means="Rms of the form of the measured lenslets against the design's, in wavefront, without height, tilt"
    " and defocus; a warning beyond a quarter of the wavelength. It fails where the texture is too rough for"
    " light to stay undisturbed.",
    why="Form bends rays; texture scatters a share of the light.",
    formula="(n − 1) rms of the form; texture: phase 2π(n − 1) Sq/λ ≤ 1 rad, share kept exp(−phase²)",
    do="Look at the deviation map. Texture: finish the tool.",
)

SCAN_LIGHT = CheckKind("scan_light", "CL384", "rad", where="file", limit="law_rms").explained(
    means="Direction error of light through the measured form, clear of seams. Sides that were not measured,"
    " and thickness, are as designed.",
    why="The law is what the sheet is for: the form of the lenslets decides whether it is kept.",
    formula="rms ∠(d', A d) over the cells measured, with the range that the uncertainties leave; limit"
    " law_rms",
    do="No answer: the sentence names the scale that would be needed. A failure: see scan_radius and the"
    " numbers of each lenslet.",
)

SCAN_SEAM = CheckKind("scan_seam", "CL385", "of the light", where="file").explained(
    means="Share of the light through the measured part that met a seam, dirt, or a place without points.",
    why="Rounded seams throw light elsewhere; what was not measured is not known.",
    formula="light that met none of them ÷ all that passes, less 1; limit check.scan_seam (0.15)",
    do="A sharper tool; a cleaner part; a map with fewer points lost.",
)

MADE_LIGHT = CheckKind("made_light", "CL376", "rad", where="surfaces", limit="law_rms").explained(
    means="Direction error of light through the faces as the process makes them (section [process]), clear of"
    " rounded seams. Next to it: the error as designed, and that of all light.",
    why="A shape that a process can make is not the shape it leaves: shrinkage, dose and sink change radii.",
    formula="rms ∠(d', A d) over rays that met no rounding; limit law_rms",
    do="Compensate what is known of the process; know it to the tolerance that the advice names.",
)

MADE_SEAM = CheckKind("made_seam", "CL377", "of the light", where="surfaces", limit="scan_seam").explained(
    means="Share of the light that passes the sheet as made, but met a seam that tool or spot rounds.",
    why="Rounded seams throw light elsewhere: it is lost to the image and veils it.",
    formula="of spheres 1 − (R/(R + r))² of each face for a nose r; limit check.scan_seam (0.15)",
    do="A smaller process.nose or process.spot, or a larger pitch.",
)

MADE_TEXTURE = CheckKind(
    "made_texture", "CL378", "rad of phase", where="surfaces", rule="fixed: 1 rad"
).explained(
    means="Rms phase of what feed, layers and levels leave on one face; the share of light it leaves"
    " undisturbed is printed. Above 1 rad that share is not known: the check fails. Texture is not traced.",
    why="Texture scatters a share of the light; it does not bend the rest.",
    formula="2π(n − 1) Sq/λ; Sq = f²/8r · 2/√45 of scallops, step/√12 of layers and levels; exp(−phase²)",
    do="A smaller process.feed or process.layer, more process.levels; or polish.",
)
