"""Designs of solved stacks: sheets for a wanted matrix, chosen by traced light, and their scene file.

The closed form of `wanted_stack` ranks the family; the few best are built and traced through thin lenses,
which choose among them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import ceil, isfinite, tan
from os.path import relpath
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from clacad.advice.stack_wish import StackWish
from clacad.advice.wanted_stack import (
    NoSuchStack,
    Solved,
    Wanted,
    WantedSheet,
    about,
    shortlist,
    solve_three,
    solve_two,
    stack_of_three,
)
from clacad.base.sobol import sobol
from clacad.base.types import Floats, Pair2, Progress, Rung, silent
from clacad.config.edit_text import parse, value_text
from clacad.config.mistakes import Mistake
from clacad.design.sections import LATTICE, LAW, PAIR
from clacad.optics.rays import Fate
from clacad.prescription.intent import intent_of, separation_of
from clacad.prescription.prescribe import prescribe
from clacad.sheet.stack import Stack, stacked
from clacad.storage.atomic import write_content
from clacad.storage.errors import BadRequest
from clacad.tracing.through_stack import StackTracer, started

if TYPE_CHECKING:
    from clacad.design import Design


TRACED = 6
"""Number of members of a family that are traced."""

RAYS = 1 << 14
"""Number of rays through a stack that is ranked."""

DENSER = 0.63
"""Exponent of the distance from the axis of rays that are fitted: 1 fills zone and field evenly."""

CORRECTIONS = 2
"""Number of times that the matrix is corrected by light through exact faces."""


def wanted_of(design: Design, wish: StackWish, gaps: Pair2, width: float, field: float) -> Wanted:
    """What a stack of sheets like a design must do; lengths in the design's unit.

    gaps : From array to array. width : Of the light. field : radians.
    Raises NoSuchStack: The design is a plate of listed faces.
    """
    pair, intent = design.pair, intent_of(design)
    if pair.form == "plates" or pair.prescription == "given":
        raise NoSuchStack(
            "sheets are solved of lenses that follow from eta: form slab, plano or biconvex, no listed faces"
        )
    separation, pitch = separation_of(intent), max(intent.lattice.pitch)
    length = 3.0 * separation + sum(gaps)
    shown, unit = (length if wish.kind == "cloak" else wish.value), f" {design.unit}"
    return Wanted(
        f"{wish.kind} of {shown:.6g}{unit if wish.kind in ('cloak', 'space') else ''}",
        wanted_matrix(wish.kind, wish.value, length, wish.planes),
        separation,
        pitch,
        gaps,
        0.5 * width,
        field,
        (intent.index - 1.0) * (2.0 if pair.form == "biconvex" else 1.0),
        wish.ring,
        pair.field_lens,
        wish.etas,
    )


def wanted_matrix(kind: str, value: float, length: float, planes: Pair2 = (0.0, 0.0)) -> tuple[Pair2, Pair2]:
    """Matrix ((A, B), (C, D)) of what is wanted.

    kind : One of `stack_wish.KINDS`. value : Length of the space; magnification of a relay or an image.
    length : Of the stack, which a cloak acts as.
    planes : lengths. Distance of the imaged plane before the stack, and of its image behind.
    """
    if kind in ("cloak", "space"):
        return (1.0, length if kind == "cloak" else value), (0.0, 1.0)
    before, behind = planes  # parallel light stays parallel: diag(m, 1/m) from plane to plane
    return (value, -value * before - behind / value), (0.0, 1.0 / value)


def sheet_keys(wanted: Wanted, one: WantedSheet) -> dict[str, Any]:
    """Keys of a design that make it one of the solved sheets.

    A sheet lit by light that converges to a point behind it is given by the growth of its offset: most of its
    cells pass no light parallel to the axis, of which f_image would be the image.
    """
    cells = 2 * ceil(one.reach / wanted.pitch)
    keys: dict[str, Any] = {LAW.eta: [one.eta, one.eta], LATTICE.count: [cells, cells]}
    if isfinite(one.f_image) and isfinite(one.viewer) and one.viewer > 0.0:
        growth = one.eta / one.f_image
        keys[f"{LAW.varying}.gradient"] = [[growth, 0.0], [0.0, growth]]
    elif isfinite(one.f_image):
        keys[f"{LAW.varying}.f_image"] = one.f_image
    if isfinite(one.viewer):
        keys[LATTICE.aperture] = {"point": [0.0, 0.0, one.viewer]}
    if one.field_lens or wanted.field_lens:
        keys[PAIR.field_lens] = one.field_lens
    return keys


def designs_of(bases: Sequence[Design], wanted: Wanted, solved: Solved) -> list[Design]:
    """Designs of solved sheets, each like its base."""
    return [base.replace(sheet_keys(wanted, one)) for base, one in zip(bases, solved.sheets)]


def placed(designs: Sequence[Design], gaps: Sequence[float], exact: bool = False) -> Stack:
    """Stack of the designs with these lengths from array 2 of a sheet to array 1 of the next.

    Lens planes depend on the thickness, and not on where the vertices of lens 2 are: those are traced only
    for `exact` faces.
    Raises NoSuchStack: The material of neighbours would overlap.
    """
    windows = [prescribe(one if exact else one.replace(PAIR.offset, "paraxial")) for one in designs]
    sheets = stacked(windows, [0.0] * len(gaps)).sheets
    clear = [gap - (b.lens_planes[0] - a.lens_planes[1]) for a, b, gap in zip(sheets, sheets[1:], gaps)]
    if min(clear) < 0.0:
        raise NoSuchStack(f"the sheets would overlap by {-min(clear):.4g}: their lens planes lie too close")
    return stacked(windows, clear)


def solve(
    bases: Sequence[Design], wanted: Wanted, progress: Progress = silent
) -> tuple[dict[int, Solved | NoSuchStack], Solved | None]:
    """Stacks of two and of three sheets that have a wanted matrix, or why there is none; the brightest.

    bases : Designs that the sheets are like.

    Of three sheets the closed form gives the few best, and rays through thin lenses choose one of them.
    """
    found: dict[int, Solved | NoSuchStack] = {}
    for count, family in ((2, lambda two: [solve_two(two)]), (3, _three)):
        progress(f"trace stacks of {count} sheets", 0.4 * (count - 2))
        try:
            found[count] = _brightest(bases, wanted, family(wanted))
        except NoSuchStack as refusal:
            found[count] = refusal
    good = [one for one in found.values() if isinstance(one, Solved)]
    return found, max(good, key=lambda one: one.by_rays or 0.0, default=None)


def _three(wanted: Wanted) -> list[Solved]:
    """The few best stacks of three sheets, or the one of stated η. Raises NoSuchStack."""
    if wanted.etas is not None:
        stated = stack_of_three(wanted, *wanted.etas)
        if stated.binding:
            raise NoSuchStack(f"three sheets: {stated.binding}")
        return [stated]
    return shortlist(wanted, TRACED) or [solve_three(wanted)]


def _brightest(bases: Sequence[Design], wanted: Wanted, several: Sequence[Solved]) -> Solved:
    """The stack that passes most light by rays, of those that can be built. Raises NoSuchStack."""
    from clacad.design import DesignError

    found, refused = [], []
    for one in several:
        try:
            found.append(traced(bases, wanted, one))
        except (NoSuchStack, DesignError) as refusal:
            refused.append(str(refusal).splitlines()[0])
    if not found:
        raise NoSuchStack(f"{len(several[0].sheets)} sheets: {refused[0]}")
    return max(found, key=lambda one: one.by_rays or 0.0)


def traced(bases: Sequence[Design], wanted: Wanted, solved: Solved) -> Solved:
    """Solved sheets with their share by rays through thin lenses. Raises NoSuchStack, DesignError."""
    stack = placed(designs_of(bases, wanted, solved), solved.gaps)
    points = 2.0 * sobol(RAYS, 4) - 1.0
    return replace(solved, by_rays=len(_sent(stack, wanted, points, "thin")[0]) / RAYS)


def _sent(stack: Stack, wanted: Wanted, points: Floats, rung: Rung) -> tuple[Floats, Floats]:
    """Places and slopes (m, 4) of light on the first array and on the last, of rays that pass all sheets.

    points : (n, 4), −1 … 1. Places over the zone in x and y, slopes over the field in x and y.
    """
    first = points * np.repeat([wanted.radius, tan(wanted.field)], 2)
    found = StackTracer(stack, rung, path="size")(started(stack, first[:, :2], first[:, 2:]))
    alive = found.fate == Fate.ALIVE
    way = found.direction[alive, :2] / found.direction[alive, 2:]
    ahead = stack.sheets[-1].lens_planes[1] - found.position[alive, 2:]
    return first[alive], np.hstack([found.position[alive, :2] + way * ahead, way])


def matrix_by_rays(stack: Stack, wanted: Wanted) -> Floats:
    """Matrix (2, 2) that fits light through the exact faces best, both meridians together.

    Places and slopes lie denser towards the rim and the edge of the field: least squares then keeps the
    largest error nearly as small as it can be.
    """
    points = 2.0 * sobol(RAYS, 4) - 1.0
    first, last = _sent(stack, wanted, np.sign(points) * np.abs(points) ** DENSER, "surfaces")
    before, behind = (np.vstack([rays[:, [0, 2]], rays[:, [1, 3]]]) for rays in (first, last))
    return np.asarray(np.linalg.lstsq(before, behind, rcond=None)[0].T)


def corrected(bases: Sequence[Design], wanted: Wanted, solved: Solved) -> Solved:
    """Solved sheets, of another matrix, such that light through their exact faces has the wanted one.

    Lenses that are not ideal, and cells that pass only a part of their light, change it by some percent.
    """
    aim = np.array(wanted.matrix)
    for _ in range(CORRECTIONS if len(solved.sheets) == 3 else 0):
        stack = placed(designs_of(bases, wanted, solved), solved.gaps, exact=True)
        aim += np.array(wanted.matrix) - matrix_by_rays(stack, wanted)
        (a, b), (c, d) = aim.tolist()
        eta_1, eta_2 = (one.eta for one in solved.sheets[:2])
        changed = replace(wanted, matrix=((a, b), (c, d)))
        near = about(changed, eta_1, eta_2) if wanted.etas is None else stack_of_three(changed, eta_1, eta_2)
        solved = replace(near, by_rays=solved.by_rays)
    return solved


def write_solved(
    out: Path,
    source: Path,
    overrides: Sequence[Sequence[str]],
    bases: Sequence[Design],
    wanted: Wanted,
    solved: Solved,
    overwrite: bool,
) -> Solved:
    """Correct solved sheets by their exact faces, and write their scene: a camera before, stripes behind.

    source, overrides : The design file that the sheets are like, and the changed keys of each.
    Raises BadRequest: The file would lie above the design's folder.
    """
    name = relpath(source, out.parent).replace("\\", "/")
    if name.startswith("../../"):
        near = source.parent / out.name
        raise BadRequest(
            f"-o {out}: a scene lies in the folder of {source} or in a folder there; try -o {near}"
        )
    solved = corrected(bases, wanted, solved)
    lines = ["format = 1", f"name = {value_text(out.stem)}", f"unit = {value_text(bases[0].unit)}"]
    stack = placed(designs_of(bases, wanted, solved), solved.gaps)
    for one, sheet, texts in zip(stack.sheets, solved.sheets, overrides):
        given = dict(pair for text in texts if not isinstance(pair := parse(text), Mistake))
        values = {**given, **sheet_keys(wanted, sheet)}.items()
        keys = ", ".join(f"{value_text(key)} = {value_text(value)}" for key, value in values)
        lines += ["", "[[sheet]]", f'id = "{one.id}"', f"design = {value_text(name)}"]
        lines += [f"set = {{ {keys} }}", f"z = {one.z!r}"]
    far = 4.0 * wanted.length
    lines += ["", "[camera]", f"position = [0, 0, {-far:.6g}]", f"frame = {2.6 * wanted.radius:.6g}"]
    lines += ["", "[[object]]", 'id = "wall"', 'kind = "screen"', f"at = [0, 0, {wanted.length + far:.6g}]"]
    lines += [f"size = [{far:.6g}, {far:.6g}]", 'pattern = "stripes"', f"period = {wanted.radius:.6g}"]
    write_content(out, "\n".join(lines) + "\n", overwrite=overwrite)
    return solved
