"""Kinds of checks of the bodies, the lenses and the process: whether the part can exist and can be made."""

from __future__ import annotations

from clacad.checks.check import CheckKind
from clacad.checks.levers import (
    APERTURE,
    BORDER,
    CLOSER,
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

FOUND_BY = {
    "cell": (
        "clacad.verification.design_rules:one_piece",
        "clacad.verification.design_rules:cover",
        "clacad.verification.design_rules:graph",
        "clacad.verification.design_rules:lengths",
        "clacad.verification.process_rules:making",
    ),
    "part": ("clacad.verification.process_rules:workable", "clacad.verification.process_rules:sizes"),
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
    means="Pitch of the lattice against what the process resolves.", do="A larger pitch or a finer process."
)


TOOL = CheckKind("tool", "CL336", limit="tool", levers=(FARTHER, COARSER, SEAM)).explained(
    means=(
        "Share of a cell's width that the nose of the tool leaves rounded where two faces meet in a groove."
    ),
    why="Light through the rounding goes astray: it is lost from the image and seen as haze.",
    formula=(
        "Σ r tan(τ/2) cos β / p, τ the turning angle, β the slopes; r/√(R² − p²/4) for spheres without a seam"
    ),
    do="A smaller nose, larger radii, or a seam that takes the rounding. Making the inverse (a mould) "
    "turns grooves into ridges.",
)

WALL = CheckKind("wall", "CL337", limit="wall", levers=(FARTHER, SEAM, FINER, APERTURE)).explained(
    means="Highest vertical wall on the optical side: the step between neighbours of a tilted array, or "
    "the edge of a seam.",
    why="Turning leaves no vertical walls, and mouldings stick on them; a ramp in their place is lost to "
    "light.",
    formula="h ≈ p |tan τ| for a tilt τ across the border, more where the lens is steep",
    do="Less tilt, φ + ψ a multiple of 90°, or a web instead of a seam.",
)

DRAFT = CheckKind(
    "draft", "CL338", "rad", relation=">=", limit="draft", levers=(SEAM, FARTHER, FINER)
).explained(
    means="Least angle between anything that must release (walls, steep faces) and the sheet's normal.",
    why="Below it the tool's flank rubs, the moulding sticks, or exposed walls come out slanted anyway.",
    formula="0 for a wall, else 90° − steepest slope",
    do="Avoid steps, or allow it with a reason if walls may be slanted.",
)

SLOPE = CheckKind("slope", "CL361", "rad", limit="slope", levers=FLATTER).explained(
    means="Steepest slope of a lens face against the sheet.",
    why="A tool's clearance, a resist's contrast or a mould's finish end there.",
    formula="acos(min n_z)",
    do="Larger radii, a smaller pitch, less tilt.",
)

VOXEL = CheckKind("voxel", "CL362", relation=">=", limit="voxel", levers=(COARSER, SEAM)).explained(
    means="Narrowest thing to be drawn (a twentieth of the pitch, half a seam, half a baffle's wall) "
    "against the voxel, pixel or spot.",
    why="A lens of fewer than 20 voxels across is a mosaic; a wall of one voxel may be missing.",
    formula="min(p/20, seam/2, wall/2) ≥ voxel",
    do="A larger pitch, wider seams and walls, or a finer process.",
)

LAYER = CheckKind("layer", "CL363", relation=">=", limit="layer", levers=(CLOSER, COARSER)).explained(
    means="Number of layers that shape the flatter lens.",
    why="Few layers make stairs: each step is a slope error as large as the lens's own slope.",
    formula="sag/layer ≥ 20",
    do="Steeper lenses (shorter separation or larger pitch), finer layers; or use the print as a "
    "demonstrator and allow it.",
)

ASPECT = CheckKind("aspect", "CL364", limit="aspect", levers=(FARTHER, SEAM, FINER)).explained(
    means="Greatest height over width of a lens, a seam or a baffle's wall.",
    why="Tall thin walls bend, and deep narrow grooves cannot be reached or filled.",
    formula="h/w",
    do="Wider walls and seams, or shallower ones.",
)

UNDERCUT = CheckKind("undercut", "CL365", relation=">=", levers=FLATTER).explained(
    means="Whether a face overhangs, seen along the sheet's normal.",
    why="What a tool, a mould or a light field from one side cannot reach.",
    formula="min n_z > 0",
    do="Less tilt or larger radii, or a process that builds in layers.",
)

WORKABLE = CheckKind("workable", "CL325", relation="=", limit="materials").explained(
    means="Whether the process can work the material of the part.",
    why="Single-point diamond turning cuts plastics, infrared crystals and chalcogenides, not ordinary "
    "glass; a printer hardens resins only.",
    do="The material or the process that the message names; check.materials lists the materials of "
    "your workshop in place of the profile.",
)

PART_HEIGHT = CheckKind("part_height", "CL326", limit="part_height", levers=(CLOSER, THINNER)).explained(
    means="Height of the tallest body, land and steps included, against the tallest part that the process "
    "makes.",
    why="Stages, build volumes, substrates and moulds end; sag limits the lenses alone.",
    formula="max z − min z of a body",
    do="A shorter separation, a thinner plate, or the process that the message names.",
)

PART_WIDTH = CheckKind("part_width", "CL327", limit="part_width").explained(
    means="Greater side of the rectangle around the widest body, seen along z, against the widest part "
    "that the process makes.",
    why="Spindles, stages and build plates end.",
    do="A smaller sheet in several pieces, or the process that the message names.",
)
