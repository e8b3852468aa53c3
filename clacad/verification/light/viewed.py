"""Light that an eye sees from the whole sheet: its share on the law, the check of it, and remedies.

The field of one cell is narrow. An eye near a wide sheet sees its border obliquely, where light enters
lenslets other than the partner. The share is traced through the exact surfaces and computed in closed form
of thin lenses. A stated viewer is judged; an assumed one gives a warning. Changes that give the viewer more
light are built and judged before the check names them.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from math import ceil, floor, log10
from typing import Any, Final

import numpy as np

from clacad.base.sobol import sobol
from clacad.base.text import percent_text
from clacad.base.types import Floats, Ints
from clacad.checks.check import Check, accepted, wrong
from clacad.checks.light_kinds import VIEWED
from clacad.config.edit_text import value_text
from clacad.config.mistakes import DesignError
from clacad.design import Design
from clacad.design.sections import LATTICE, PAIR, AimedAt
from clacad.optics.rays import Fate, Rays
from clacad.prescription.aimed_cells import refuse_aim
from clacad.prescription.prescribe import prescribe
from clacad.prescription.radii import NoSuchLens
from clacad.sheet.feasibility import feasibility
from clacad.sheet.feasibility.derived_numbers import VIEWING_DISTANCE
from clacad.sheet.vignetting import partner_share
from clacad.sheet.window import Window
from clacad.tracing.trace import trace
from clacad.verification.design_rules import design_checks
from clacad.verification.light.law_checks import judge_light
from clacad.verification.light.through_window import Lit

RAYS = 8192
"""Sobol rays over the whole sheet: the mean is within .004 (random rays: rms .5/√8192)."""

PLACES = 48
"""Cells along each side of the map over the sheet."""


FARTHEST = 1000.0
"""Pitches from a lens to where undeviated light lands; beyond, no lens reaches its partner: not traced."""


@dataclass(frozen=True, eq=False)
class Viewed:
    """The share of one viewer's light that obeys the law.

    viewer : (x, y, z), lengths. Sheet frame.
    traced, thin : float
        Mean over the sheet: ALIVE rays over all rays that enter a cell, and the closed form of thin lenses.
    position : (n, 2) lengths. Where each ray crosses z = 0.
    alive : (n,) bool
    """

    viewer: tuple[float, float, float]
    traced: float
    thin: float
    position: Floats
    alive: Floats


def states_viewer(design: Design) -> bool:
    """Whether the design states where the eye is: in [check] viewer, or by the aim of its cells."""
    return design.check.viewer is not None or isinstance(design.lattice.aperture, AimedAt)


def viewer_of(design: Design) -> tuple[float, float, float]:
    """Position of the eye: as in [check] viewer, on the axis; else the cells' aim point; else 1 m before."""
    distance, _ = design.viewing_places
    aperture = design.lattice.aperture
    if distance is None and isinstance(aperture, AimedAt):
        return aperture.point
    return 0.0, 0.0, -(VIEWING_DISTANCE if distance is None else distance) / design.unit_m


def viewed(window: Window, viewer: tuple[float, float, float], rays: int = RAYS) -> Viewed:
    """Trace light of a viewer through a whole sheet.

    viewer : (x, y, z), lengths
        Sheet frame; light starts there if z < 0 (before the sheet), and goes towards it if z > 0.
    rays : Sobol points over all cells; fewer where an outline omits cells, but at least a quarter.
    """
    points = sobol(rays, 4)
    cells, kept = _kept_cells(window, points[:, :2])
    inside = window.lattice.over_cell(points[kept, 2:])
    place = window.centres(0, cells) + inside
    slope = _slopes(place, viewer)
    ray = np.column_stack([slope, np.ones(len(slope))])
    before = window.z_range[0] - max(window.lattice.pitch)
    start = np.column_stack([place + before * slope, np.full(len(slope), before)])
    near = np.hypot(*slope.T) * window.thin.separation <= FARTHEST * min(window.lattice.pitch)
    alive = np.zeros(len(slope), dtype=bool)
    alive[near] = trace(window, Rays(start[near], ray[near]), path="size").fate == Fate.ALIVE
    return Viewed(viewer, float(alive.mean()), _thin_share(window, cells, viewer), place, alive)


def thin_share(window: Window, viewer: tuple[float, float, float], cells: int = 2048) -> float:
    """Mean share of the viewer's light that obeys the law, thin lenses, over `cells` cells."""
    drawn, _ = _kept_cells(window, sobol(cells, 2))
    return _thin_share(window, drawn, viewer)


def _thin_share(window: Window, cells: Ints, viewer: tuple[float, float, float]) -> float:
    slope = _slopes(window.centres(0, cells), viewer)
    return float(partner_share(window, cells, np.column_stack([slope, np.ones(len(slope))])).mean())


def share_map(
    window: Window, viewer: tuple[float, float, float]
) -> tuple[Floats, tuple[float, float, float, float]]:
    """Thin share (PLACES, PLACES), [y, x], NaN off the sheet; its (x_min, x_max, y_min, y_max), lengths."""
    x0, x1, y0, y1 = window.lattice.extent()
    y, x = np.meshgrid(
        *(np.linspace(a, b, 2 * PLACES + 1)[1::2] for a, b in ((y0, y1), (x0, x1))), indexing="ij"
    )
    cells, _, _ = window.lattice.locate(x.ravel(), y.ravel())
    slope = _slopes(window.centres(0, cells), viewer)
    found = partner_share(window, cells, np.column_stack([slope, np.ones(len(slope))]))
    return np.where(window.lattice.contains(cells), found, np.nan).reshape(x.shape), (x0, x1, y0, y1)


def _slopes(place: Floats, viewer: tuple[float, float, float]) -> Floats:
    x, y, z = viewer
    return np.asarray((place - (x, y)) / -z)


def _kept_cells(window: Window, unit_square: Floats) -> tuple[Ints, Ints]:
    """Kept cells (k, 2), spread evenly over the sheet by points (n, 2), and the indices (k,) of these."""
    lattice = window.lattice
    n1, n2 = lattice.count
    i, j = (np.floor(unit_square * (n1, n2)).astype(np.int64)).T
    drawn = np.stack([i - j // 2 if lattice.hexagonal else i, j], axis=-1)
    found = np.flatnonzero(lattice.contains(drawn))
    if 4 * len(found) >= len(drawn):
        return drawn[found], found
    cells = lattice.cells()  # the outline keeps few of the lattice's cells
    return cells[np.floor(unit_square[:, 0] * len(cells)).astype(np.int64)], np.arange(len(drawn))


Point = tuple[float, float, float]


def viewed_check(lit: Lit) -> Iterator[Check]:
    """Judge the share of the viewer's light that obeys the law.

    Below the limit a stated viewer fails and an assumed one warns.
    """
    design, window = lit.design, lit.window
    found = viewed(window, viewer_of(design))
    stated, limit = design.check.viewer is not None, design.check.viewed
    eye = _eye(design, found.viewer)
    sentence = _share_of(found.traced, eye)
    if not found.traced >= limit:
        sentence += f" (ideal lenses: {percent_text(found.thin)}); the rest meets other lenslets"
    check = VIEWED.judge(
        found.traced,
        limit,
        sentence,
        required=stated,
        bundle=f"{len(found.alive)} Sobol rays over all cells, seed 0",
        detail={"viewer": found.viewer, "thin": found.thin, "stated": stated, "eye": eye},
    )
    yield replace(check, state="warn") if check.state == "fail" and not stated else check


def headline(checks: Sequence[Check]) -> str:
    """One line with the share of light for the viewer and the limit; "" where that was not checked."""
    check = next((c for c in checks if c.kind is VIEWED and isinstance(c.value, float)), None)
    if check is None:
        return ""
    verdict = {"pass": "passes", "fail": "FAILS", "warn": "a warning"}[check.state]
    limit = f"limit {percent_text(float(check.limit or 0.0), 4)}"
    return f"{_share_of(float(check.value or 0.0), check.detail['eye'])} ({limit}: {verdict})"


def _share_of(share: float, eye: str) -> str:
    """Text of the share, never rounded up to 100 %."""
    percent = 100.0 if share == 1.0 else min(100.0 * share, 99.9)
    return f"{percent:.3g} % of the light of {eye} obeys the law over the whole sheet"


def _eye(design: Design, viewer: Point) -> str:
    """Text of the eye's position and its source."""
    x, y, z = viewer
    where = f"at ({x:.4g}, {y:.4g}, {z:.4g}) {design.unit}"
    if design.check.viewer is not None:
        return f"the eye of check.viewer {where}"
    if isinstance(design.lattice.aperture, AimedAt):
        return f"the eye {where} that the cells are aimed at"
    return f"an assumed eye {where} (check.viewer states one)"


TRIED_RAYS: Final = 4096
"""Sobol rays through each changed sheet: the mean is within .008."""

JUDGED_RAYS: Final = (8192, 1024)
"""Rays of the main bundle and of each field point when a changed design is judged."""

MOST_TRACED: Final = 5000
"""Largest number of aimed cells whose lenses 2 are positioned by traced light, at 1 ms a cell; more are
positioned by formula."""

MOST_AIMED: Final = 10_000_000
"""Largest number of cells that are tried as aimed at the viewer: every cell at the rim is examined."""

FARTHEST_VIEWER: Final = 1024.0
"""Largest factor on the viewer's distance that is tried."""

STEPS: Final = 6
"""Most steps of a tenth that rays need beyond the distance for ideal lenses."""

PARAXIAL: Final = {PAIR.offset: "paraxial"}


def name_remedies(checks: Iterable[Check], design: Design, window: Window) -> list[Check]:
    """Add to the sentence of `viewed`, where it does not pass, the changes that reach its limit.

    A key is named only if the changed design can be built and fails no check that the design passes.

    checks : All checks of the design, those by light and the design rules.
    """
    checks = list(checks)
    return [
        (
            replace(c, sentence=f"{c.sentence}; {_remedy_text(checks, design, window, c.detail['viewer'])}")
            if c.kind is VIEWED and c.state in ("fail", "warn")
            else c
        )
        for c in checks
    ]


def _remedy_text(checks: list[Check], design: Design, window: Window, viewer: Point) -> str:
    found = [*_keys(_failing(checks, design), design, viewer), *_farther(design, window, viewer)]
    if not found:
        return "neither aimed cells nor a field lens nor a viewer farther away mends it alone"
    return f"{percent_text(design.check.viewed, 4)} is reached by {', or by '.join(found)}"


def _keys(failing: frozenset[tuple[str, str]], design: Design, viewer: Point) -> Iterator[str]:
    """Keys whose change reaches the limit and makes no other check fail: aimed cells, or a field lens."""
    point = {LATTICE.aperture: {"point": [int(v) if v.is_integer() else v for v in map(float, viewer)]}}
    n1, n2 = design.lattice.count
    aimed = point if n1 * n2 <= MOST_TRACED else point | PARAXIAL
    tried = (aimed, {PAIR.field_lens: True}) if n1 * n2 <= MOST_AIMED else ({PAIR.field_lens: True},)
    for changes in tried:
        share = _share(design, changes, viewer)
        if share >= design.check.viewed and _fails_no_more(design, changes, failing):
            keys = " with ".join(f"{key} = {value_text(value)}" for key, value in changes.items())
            yield f"{keys} ({percent_text(share)})"


def _share(design: Design, changes: dict[str, Any], viewer: Point) -> float:
    """Viewer's share of light with some keys changed; paraxial lenses for aimed cells; 0: not buildable."""
    try:
        asked = design.replace(changes)
        if isinstance(asked.lattice.aperture, AimedAt):
            asked = asked.replace(PARAXIAL)
            refuse_aim(prescribe(asked.replace({LATTICE.aperture: "aligned"})), asked)
        return viewed(prescribe(asked), viewer, TRIED_RAYS).traced
    except (DesignError, NoSuchLens):
        return 0.0


def _fails_no_more(design: Design, changes: dict[str, Any], failing: frozenset[tuple[str, str]]) -> bool:
    """Whether a design with some keys changed can be built and fails no check but those that fail already.

    The rules come first: light is traced only where they hold.
    """
    try:
        changed = design.replace(changes)
        window = prescribe(changed)
        rules = design_checks(changed, window, feasibility(window, *changed.viewing_places), solved=False)
        if not _failing(rules, changed) <= failing:
            return False
        light, _ = judge_light(changed, window, *JUDGED_RAYS, judged_only=True)
    except (DesignError, NoSuchLens):
        return False
    return _failing(light, changed) <= failing


def _failing(checks: Iterable[Check], design: Design) -> frozenset[tuple[str, str]]:
    return frozenset((c.id, c.subject) for c in wrong(accepted(checks, design)))


def _farther(design: Design, window: Window, viewer: Point) -> Iterator[str]:
    """Nearest viewer distance that reaches the limit, first by thin lenses and then by rays."""
    limit = design.check.viewed

    def at(factor: float) -> Point:
        x, y, z = (factor * v for v in viewer)
        return x, y, z

    if isinstance(design.lattice.aperture, AimedAt) or thin_share(window, at(FARTHEST_VIEWER)) < limit:
        return
    low, high = 1.0, FARTHEST_VIEWER
    while high > 1.02 * low:
        middle = (low * high) ** 0.5
        low, high = (low, middle) if thin_share(window, at(middle)) >= limit else (middle, high)
    for step in range(STEPS):
        distance = _two_digits_up(1.1**step * high * abs(viewer[2]))
        factor = distance / abs(viewer[2])
        if viewed(window, at(factor), TRIED_RAYS).traced >= limit:
            yield f"a viewer at {distance:g} {design.unit} or farther"
            if window.uniform:
                yield f"a sheet {1.0 / factor:.2g} times as wide"
            return


def _two_digits_up(length: float) -> float:
    step = 10.0 ** (floor(log10(length)) - 1)
    return ceil(length / step - 1e-9) * step
