"""Parameter sweeps: any keys of the design over a grid of values, each point built, judged and traced."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache
from itertools import product
from math import inf, isfinite, nan, prod
from pathlib import Path
from typing import TYPE_CHECKING, Any

from clacad import __version__
from clacad.base import units
from clacad.base.interactive import Tabular, columns_of
from clacad.base.text import whole_number
from clacad.base.types import Floats, Progress
from clacad.config.toml_text import toml_value
from clacad.design.sections import CHECK, LIGHT
from clacad.formats.study_file import FORMAT
from clacad.optics.rays import Fate
from clacad.prescription.prescribe import prescribe
from clacad.sheet.bundle import bundle, middle_direction
from clacad.sheet.feasibility import Feasibility, feasibility
from clacad.sheet.vignetting import order_shares, thin_cells
from clacad.tracing.worst_cell import SeenCell, worst_cell
from clacad.verification.tolerance.farm import Farm
from clacad.verification.tolerance.light_measures import (
    MEASURES,
    RAYS,
    STATED,
    bench,
    measures_of,
    sloped,
)
from clacad.verification.tolerance.study import asked_design, named_design, worked

if TYPE_CHECKING:
    from clacad.design import Design

MOST_POINTS = 1_000_000

TRACED: Mapping[str, str] = {
    **dict.fromkeys(("exit_x", "exit_y"), "slope"),
    **{
        name: MEASURES[name]
        for name in (
            *("power_xx", "power_yy", "residual_power", "blur", "throughput", "kept", "law_rms", "law_bias"),
            *("eta_x", "eta_y", "delta_x", "delta_y"),
        )
    },
}
"""Measures of a point by light: those of `clacad.verification.tolerance.light_measures`, and the exit slopes
of the chief ray."""

BEAM: Mapping[str, str] = {
    "beam_exit_x": "slope",
    "beam_exit_y": "slope",
    "partner_share": "",
    "ghost_share": "",
    "orders": "",
}
"""Measures of the parallel beam in the middle of the light.

By trace: mean exit slopes of its ALIVE rays along the sheet's x and y. Shares of thin lenses: of the partner,
of all ghosts, and of each order "i,j" of at least `clacad.sheet.vignetting.LEAST_SHARE`.
"""

BUILT: Mapping[str, str] = {
    "pieces": "",
    "cover": "",
    "edge": "design unit",
    "neck": "design unit",
    "step": "design unit",
    "clearance": "design unit",
    "radius": "design unit",
    "sag": "design unit",
    "thickness_1": "design unit",
    "thickness_2": "design unit",
    "normal_z": "",
    "half_field": "slope",
    "fresnel_number": "",
}
"""Geometric numbers of a point: the worst of its lenses or bodies."""

_RANGE = re.compile(r"(?P<start>[^:]+):(?P<stop>[^:]+):(?P<count>[^:]+)(?P<log>:log)?\Z")

Axis = tuple[str, tuple[Any, ...]]
"""A dotted key and its values."""


class CannotVary(ValueError):
    """A --vary without values or without a key."""

    exit_status = 2


@dataclass(frozen=True, eq=False)
class Sweep(Tabular):
    """Table of the points of a sweep.

    Attributes
    ----------
    name, sha256 : str
        Of the varied design.
    axes : tuple of (key, values)
    rows : list of mappings
        In the order of the grid, the last axis fastest: the varied keys, "state" ("ok", "failed": a check of
        the design rules fails, or "error": the point cannot be built), "failed" and "message", then `BUILT`,
        `TRACED`, `STATED` where stated, and `BEAM`.
    incident : (x, y) slopes or None
        Middle of the light at every point; None: the middle of the field of each point.
    """

    name: str
    sha256: str
    axes: tuple[Axis, ...]
    rows: list[dict[str, Any]]
    incident: tuple[float, float] | None = None

    def __repr__(self) -> str:
        keys = ", ".join(f"{key} ({len(values)})" for key, values in self.axes)
        return f"Sweep({self.name!r}, {len(self.rows)} points of {keys})"

    def to_columns(self) -> dict[str, Any]:
        """One row for each point, in the order of the grid."""
        found = columns_of(self.rows)
        return {name: found.get(name, []) for name in self.columns()}

    def columns(self) -> list[str]:
        """Names of the columns of the table."""
        white = [name for name in STATED if any(name in row for row in self.rows)]
        return [key for key, _ in self.axes] + ["state", "failed", "message", *BUILT, *TRACED, *white, *BEAM]


def parse_vary(text: str) -> Axis:
    """Read "key=from:to:count", "key=from:to:count:log" or "key=a,b,c".

    Values may carry a unit ("5 um:20 um:4"); whole numbers stay whole. The steps of a linear range are
    rounded once, from exact fractions.

    Raises
    ------
    CannotVary

    Examples
    --------
    >>> parse_vary("law.eta.0=-0.25:-4:4")
    ('law.eta.0', (-0.25, -1.5, -2.75, -4.0))
    """
    key, equals, values = text.partition("=")
    key, values = key.strip(), values.strip()
    if not (equals and key and values):
        raise CannotVary(f"--vary {text!r}: write KEY=FROM:TO:COUNT or KEY=A,B,C")
    found = _RANGE.match(values)
    if found is None:
        return key, tuple(_value(part) for part in _split(values))
    count = whole_number(found["count"]) or 0
    if not 1 <= count <= MOST_POINTS:
        raise CannotVary(f"--vary {text!r}: COUNT is a whole number from 1 to {MOST_POINTS}")
    start, stop = units.split(found["start"]), units.split(found["stop"])
    if start is None or stop is None or start[1] != stop[1]:
        raise CannotVary(f"--vary {text!r}: FROM and TO are two numbers with the same unit, or with none")
    if found["log"] and not start[0] * stop[0] > 0:
        raise CannotVary(f"--vary {text!r}: a logarithmic range does not reach or cross 0")
    ends = (found[end].strip().removesuffix(start[1]).strip() for end in ("start", "stop"))
    whole = all(whole_number(end.removeprefix("+"), signed=True) is not None for end in ends)
    numbers = _spaced(start[0], stop[0], count, by_ratio=bool(found["log"]), whole=whole)
    return key, tuple(f"{n!r} {start[1]}" if start[1] else n for n in numbers)


def _spaced(low: Fraction, high: Fraction, count: int, *, by_ratio: bool, whole: bool) -> Sequence[float]:
    """Numbers of a range, each rounded once; integers where all steps are whole."""
    if by_ratio:
        ratio = float(high / low)
        return [float(low) * ratio ** (k / max(1, count - 1)) for k in range(count)]
    steps = [low + (high - low) * Fraction(k, max(1, count - 1)) for k in range(count)]
    if whole and all(step.denominator == 1 for step in steps):
        return [int(step) for step in steps]
    return [float(step) for step in steps]


def _split(values: str) -> list[str]:
    """Parts between commas that are outside brackets and quotes."""
    parts, depth, quote = [""], 0, ""
    for sign in values:
        if quote:
            quote = "" if sign == quote else quote
        elif sign in "\"'":
            quote = sign
        else:
            depth += (sign in "[{") - (sign in "]}")
        if sign == "," and depth == 0 and not quote:
            parts.append("")
        else:
            parts[-1] += sign
    return [part.strip() for part in parts if part.strip()]


def _value(text: str) -> Any:
    try:
        return toml_value(text)
    except ValueError:
        return text


def grid(axes: Sequence[Axis]) -> list[dict[str, Any]]:
    """Every combination of the values, the last key fastest."""
    return [
        dict(zip((key for key, _ in axes), values, strict=True)) for values in product(*(v for _, v in axes))
    ]


@lru_cache(maxsize=2)
def _asked(study: str) -> tuple[Any, list[dict[str, Any]], int, tuple[float, float] | None]:
    asked = json.loads(study)
    axes = [(key, tuple(values)) for key, values in asked["axes"]]
    incident = None if asked["incident"] is None else tuple(asked["incident"])
    return asked_design(asked), grid(axes), asked["rays"], incident


def make_points(study: str, points: Sequence[int]) -> list[dict[str, Any]]:
    """Build, judge and trace some points; the numbers do not depend on the process."""
    design, values, rays, incident = _asked(study)
    return [_point(design, values[k], rays, incident) for k in points]


def _point(
    design: Design, changes: Mapping[str, Any], rays: int, incident: tuple[float, float] | None
) -> dict[str, Any]:
    """Row of one point of the grid: its varied keys, its geometry, and its measures of light."""
    from clacad.design import DesignError
    from clacad.verification.design_rules import design_checks

    row: dict[str, Any] = {"state": "error", "failed": "", "message": ""}
    row |= dict.fromkeys([*BUILT, *TRACED, *BEAM], nan) | {"orders": {}}
    row |= dict.fromkeys(_stated(design, changes), nan)
    try:
        made = design.replace(changes)
        window = prescribe(made)
        facts = feasibility(window)
        checks = design_checks(made, window, facts)
    except DesignError as error:
        return row | {"message": "; ".join(m.message for m in error.mistakes)}
    failed = ", ".join(dict.fromkeys(c.id for c in checks if c.state == "fail"))
    row |= {"state": "failed" if failed else "ok", "failed": failed} | _built(facts)
    seen = worst_cell(window, made.check.field)
    if seen.tried:
        row["message"] = (
            f"light through cell ({seen.cell[0]}, {seen.cell[1]}), the worst of {seen.tried} tried"
        )
    table = bench(made, seen.like, rays, incident)
    measured = table.measured({})
    chief = {f"exit_{a}": float(table.chief[k]) for k, a in enumerate("xy")}
    row |= chief | {name: measured[name] for name in (*TRACED, *STATED) if name in measured}
    middle = middle_direction(seen.like, made.check.field_centre) if incident is None else sloped(incident)
    return row | _beam(seen, middle, rays)


def _stated(design: Design, changes: Mapping[str, Any]) -> list[str]:
    """Measures of white light and temperature that a design states, or a key that is varied."""
    white, warm = (
        {LIGHT.spectrum, CHECK.law_white} & {*changes},
        {LIGHT.temperature, CHECK.temperature} & {*changes},
    )
    varied = {"law_white": white, "colour": white, "temperature": warm}
    return [name for name in STATED if name in measures_of(design) or varied[name]]


def _beam(seen: SeenCell, direction: Floats, rays: int) -> dict[str, Any]:
    """Measures `BEAM` of parallel light of one direction (3,) over one cell."""
    traced = seen.send(bundle(seen.like, rays, 0.0, middle=direction))
    out = traced.direction[traced.fate == Fate.ALIVE]
    x, y = (out[:, :2] / out[:, 2:]).mean(axis=0) if len(out) else (nan, nan)
    cells = thin_cells(seen.like)
    orders = order_shares(cells, direction)
    ghosts = 0.0 if seen.like.baffle is not None else max(0.0, cells.part - orders[0, 0])
    return {
        "beam_exit_x": float(x),
        "beam_exit_y": float(y),
        "partner_share": orders[0, 0],
        "ghost_share": ghosts,
        "orders": {f"{i},{j}": part for (i, j), part in orders.items()},
    }


def _built(facts: Feasibility) -> dict[str, float]:
    return {
        "pieces": max(body.pieces for body in facts.bodies),
        "cover": min(lens.cover for lens in facts.lenses),
        "edge": min(body.edge for body in facts.bodies),
        "neck": min(body.neck for body in facts.bodies),
        "step": max(body.step for body in facts.bodies),
        "clearance": facts.clearance,
        "radius": min(abs(r) for lens in facts.lenses for r in lens.radii),
        "sag": max(lens.sag for lens in facts.lenses),
        "thickness_1": facts.lenses[0].thickness,
        "thickness_2": facts.lenses[1].thickness,
        "normal_z": min(lens.least_normal_z for lens in facts.lenses),
        "half_field": min(facts.half_field),
        "fresnel_number": facts.fresnel_number,
    }


TASK = "sweep"
"""Name under which the required time is recorded."""


def sweep_seconds(axes: Sequence[Axis], rays: int) -> float:
    """Processor seconds of a sweep from its beginning, by a model of one reference machine."""
    return 0.3 + _point_count(tuple(axes)) * (0.15 + 3e-5 * rays)


def sweep(
    design: Design,
    axes: Mapping[str, Sequence[Any]] | Sequence[Axis | str],
    rays: int = RAYS,
    farm: Farm | None = None,
    checkpoint: Path | None = None,
    progress: Progress | None = None,
    incident: tuple[float, float] | None = None,
) -> Sweep:
    """Vary keys of a design over a grid of values: build, judge and trace the design at every point.

    Parameters
    ----------
    design : Design
    axes : mapping of dotted key to values, or sequence
        A sequence has pairs (dotted key, values), or texts as `parse_vary` reads them.
    rays : int
        Rays of a bundle.
    farm, checkpoint, progress
        As for `clacad.verification.tolerance.tolerance`.
    incident : (x, y) slopes or None
        Middle of the light along the sheet's x and y, at every point; None: the middle of the field of each
        point.

    Raises
    ------
    CannotVary
        No axes, one key twice, or too many points.

    Examples
    --------
    >>> import clacad
    >>> design = clacad.load("slab", ["lattice.count = [3, 3]"])
    >>> from clacad.verification.tolerance import Farm
    >>> grid = clacad.sweep(design, {"pair.separation": [8.0, 10.0]}, rays=64, farm=Farm(1))
    >>> grid.to_columns()["state"]
    ['ok', 'ok']
    """
    varied = _axes(axes)
    count = _point_count(varied)
    whole = [[key, list(values)] for key, values in varied]
    asked = {"axes": whole, "rays": rays, "incident": None if incident is None else list(incident)}
    text = json.dumps({**named_design(design), **asked}, sort_keys=True)
    header = {"kind": "sweep", "format": FORMAT, "clacad": __version__, "design": design.sha256, **asked}
    found = worked(make_points, text, header, count, farm or Farm(), checkpoint, progress, piece=1)
    rows = [point | row for point, row in zip(grid(varied), found, strict=True)]
    if not any(row["state"] != "error" for row in rows):
        raise CannotVary(f"no point can be built; the first: {rows[0]['message']}")
    return Sweep(design.name, design.sha256, varied, rows, incident)


def _axes(given: Mapping[str, Sequence[Any]] | Sequence[Axis | str]) -> tuple[Axis, ...]:
    pairs = given.items() if isinstance(given, Mapping) else given
    read = (parse_vary(one) if isinstance(one, str) else one for one in pairs)
    return tuple((key, tuple(values)) for key, values in read)


def _point_count(axes: Sequence[Axis]) -> int:
    """Number of points of a grid; raises CannotVary for none, too many, or a repeated key."""
    if not axes or len({key for key, _ in axes}) < len(axes):
        raise CannotVary(
            "give --vary once or more, each with another key" if axes else "nothing is varied: --vary"
        )
    count = prod(len(values) for _, values in axes)
    if not 1 <= count <= MOST_POINTS:
        raise CannotVary(f"{count} points: at most {MOST_POINTS}")
    return count


def shown(value: Any) -> str:
    """Text of a CSV cell: the shortest number that reads back exactly, empty for NaN."""
    if isinstance(value, float):
        return repr(value) if isfinite(value) else {inf: "inf", -inf: "-inf"}.get(value, "")
    if isinstance(value, list | tuple | dict):
        return json.dumps(value)
    return str(value)
