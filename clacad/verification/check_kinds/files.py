"""Kinds of checks of files: whether a file is whole, which one it is, and where its part lies."""

from __future__ import annotations

from typing import Any

from clacad.storage.errors import ExportError, OverBudget, WorkerDied
from clacad.verification.checks import Check, CheckKind

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
