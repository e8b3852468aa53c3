"""Kinds of checks of the bodies and lenses: whether the part can exist."""

from __future__ import annotations

from clacad.verification.check_kinds.levers import (
    BORDER,
    COARSER,
    FARTHER,
    FINER,
    FLATTER,
    SEAM,
    THICKER,
    THINNER,
    WEB,
    WHOLE,
    WIDER_NECK,
)
from clacad.verification.checks import CheckKind

FOUND_BY = {
    "cell": (
        "clacad.verification.design.design_rules:one_piece",
        "clacad.verification.design.design_rules:cover",
        "clacad.verification.design.design_rules:graph",
        "clacad.verification.design.design_rules:lengths",
    ),
}
"""Functions that compute these checks, by stage, in the order of the report."""


ONE_PIECE = CheckKind(
    "one_piece", "CL321", relation="=", where="geometry (closed form)", levers=(*WHOLE, WIDER_NECK, WEB, SEAM)
).explained(
    means="Each body hangs together and has no holes.",
    why="A sheet that falls into strips cannot be delivered.",
    formula="T − p_i²/(4 R_i) > p_i |tan τ_i| across every border i",
    do='thickness = "auto", a web, or a smaller pitch.',
)

COVER = CheckKind("cover", "CL322", relation=">=", limit="cover", levers=WHOLE).explained(
    means="Share of each optical cell where the lens exists.",
    why="Where it does not, light passes a hole or flat land.",
    formula="T ≥ 2ρ/(1 + √(1 − κρ)), ρ = c_x x² + c_y y² at the worst corner",
    do="The thickness, index or pitch named in the message.",
)

GRAPH = CheckKind("graph", "CL324", relation=">=", limit="graph", levers=FLATTER).explained(
    means="Smallest z component of the outward normal of a lens face.",
    why="At 0 the face is undercut; near 0 nobody can make or measure it.",
    formula="n_z = cos(slope) ≥ 0.1",
    do="Larger radii, a smaller pitch, less tilt.",
)

CLEARANCE = CheckKind(
    "clearance", "CL323", relation=">=", limit="clearance", levers=(FARTHER, THINNER, FINER)
).explained(
    means="Gap between the two bodies, steps included.",
    why="Bodies that touch cannot be assembled, or grind.",
    formula="min z of body 2 − max z of body 1",
    do="A larger separation or less tilt.",
)

EDGE = CheckKind(
    "edge", "CL331", relation=">=", limit="edge", levers=(THICKER, WEB, BORDER, FARTHER, FINER)
).explained(
    means="Least thickness along the outer side of a body.",
    why="A knife edge chips.",
    do="`body.border`, `pair.web` or `pair.thickness`.",
)

NECK = CheckKind("neck", "CL332", relation=">=", limit="neck", levers=(WIDER_NECK, WEB, *WHOLE)).explained(
    means="Least thickness that joins neighbours, after the step between them.",
    why="The sheet breaks there first.",
    formula="min over borders of (common height of both columns)",
    do="`pair.thickness`, `pair.web` or `body.neck`; less tilt.",
)

RADIUS = CheckKind("radius", "CL333", relation=">=", limit="radius", levers=(FARTHER, COARSER)).explained(
    means="Smallest apex radius of a lens.",
    why="Tool noses, voxels and spots allow no less.",
    formula="R = 1/c",
    do="A longer separation, or a finer process.",
)

SAG = CheckKind("sag", "CL334", limit="sag", levers=FLATTER).explained(
    means="Height of a lens over its cell.",
    why="Servo strokes, resists and working distances end.",
    do="Larger radii or a smaller pitch.",
)

PITCH = CheckKind("pitch", "CL335", relation=">=", limit="pitch", levers=(COARSER,)).explained(
    means="Pitch of the lattice against what the process resolves.",
    do="A larger pitch or a finer process.",
)
