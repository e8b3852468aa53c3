"""A tolerance study: every parameter by itself, then all together; ranked contributors and yield."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import islice
from math import isfinite, sqrt
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from clacad import __version__
from clacad.base.interactive import Tabular, shown_progress
from clacad.base.text import percent_text
from clacad.base.types import Floats, Progress
from clacad.design.sections import CHECK, TOLERANCES
from clacad.formats.study_file import FORMAT
from clacad.prescription.prescribe import prescribe
from clacad.tracing.worst_cell import worst_cell
from clacad.verification.tolerance.farm import Checkpoint, Farm, WorkersLost
from clacad.verification.tolerance.light_measures import MEASURES, RAYS, STATED, Bench, bench, measures_of
from clacad.verification.tolerance.misaligned import Parameter, draw, parameters

if TYPE_CHECKING:
    from clacad.design import Design


PIECE = 8
"""Sheets in one piece of work."""

SMALL = 0.1
"""Part of a tolerance over which slopes are computed."""

RANKED = ("image_shift", "moire_rate", "residual_power", "blur", "throughput", "law_rms")
"""Measures for which contributors are ranked."""

_LAW = list(MEASURES).index("law_rms")

FARTHEST = 10.0
"""Largest adjustment of a compensator in one step, over its tolerance."""

TRIED = 6
"""Values of a compensator that are tried on each sheet."""

ENDS = 4
"""Sheets for each parameter: at both ends of its tolerance, and at a small error of either sign."""


@dataclass(frozen=True, slots=True)
class Limit:
    """A limit of a good sheet: `measure` relation `value`, and the source of the limit."""

    measure: str
    relation: str
    value: float
    source: str

    def kept(self, values: Floats) -> NDArray[np.bool_]:
        """Mask of the values (n,) that keep the limit; NaN does not."""
        with np.errstate(invalid="ignore"):
            return np.asarray(values <= self.value if self.relation == "<=" else values >= self.value)


@dataclass(frozen=True, eq=False)
class Study(Tabular):
    """Results of a tolerance study.

    Attributes
    ----------
    name, sha256 : str
        Of the design.
    unit_m : float
        The design unit in metres.
    parameters : tuple of Parameter
    limits : tuple of Limit
    distribution : str; seed, rays : int
    nominal : mapping
        Measures of the sheet as designed.
    ends : (p, 2, m)
        Measures at the two ends of each tolerance alone (one-sided: the end, and as designed).
    slopes : (p, m)
        Change of each measure per unit of the parameter, from central differences over a tenth of the
        tolerance.
    errors : (n, p), measures : (n, m)
        Of the Monte-Carlo sheets.
    cell : (i, j) or None; tried : int
        For a non-uniform sheet: the study is of this cell's uniform equivalent, by light the worst of
        `tried` cells.
    of_cell : That cell and the spread over the others, in words.
    """

    name: str
    sha256: str
    unit_m: float
    parameters: tuple[Parameter, ...]
    limits: tuple[Limit, ...]
    distribution: str
    seed: int
    rays: int
    nominal: Mapping[str, float]
    ends: Floats
    slopes: Floats
    errors: Floats
    measures: Floats
    cell: tuple[int, int] | None = None
    tried: int = 0
    of_cell: str = ""

    def __repr__(self) -> str:
        share, count = self.yields()[0], len(self.measures)
        made = f"yield {percent_text(share, 3)} of {count} sheets" if count else "no sheets drawn"
        return f"Study({self.name!r}, {len(self.parameters)} parameters, {made})"

    def to_columns(self) -> dict[str, Any]:
        """One row for each sheet drawn: its errors and measures (SI, radians), and whether it is good."""
        errors = {p.name: self.errors[:, k] for k, p in enumerate(self.parameters)}
        return errors | {name: self.column(name) for name in self.units} | {"good": self.good()}

    @property
    def units(self) -> dict[str, str]:
        """Name and unit of each measure."""
        return {name: unit for name, unit in {**MEASURES, **STATED}.items() if name in self.nominal}

    def column(self, measure: str) -> Floats:
        """One measure of all sheets, (n,)."""
        return np.asarray(self.measures[:, list(self.units).index(measure)])

    def change(self, measure: str) -> Floats:
        """Largest change of a measure over each tolerance alone, (p,)."""
        at = list(self.units).index(measure)
        found = np.abs(self.ends[:, :, at] - self.nominal[measure]).max(axis=1)
        return np.where(np.isfinite(found), found, np.inf)

    def place(self, parameter: str) -> tuple[float, float]:
        """Centre (metres) of the cell of the worst law error at the worse end of a parameter's tolerance."""
        number = [p.name for p in self.parameters].index(parameter)
        return _centre(
            self.ends[number, int(np.argmax(np.nan_to_num(self.ends[number, :, _LAW], nan=np.inf)))]
        )

    def ranking(self, measure: str) -> list[tuple[str, float, float]]:
        """(parameter, change over its tolerance, share of the sum of squares), largest first."""
        change = self.change(measure)
        lost = ~np.isfinite(change)
        square = lost.astype(np.float64) if lost.any() else change**2
        total = float(square.sum())
        share = square / total if total > 0.0 else np.zeros_like(square)
        order = sorted(range(len(change)), key=lambda k: (-change[k], k))
        return [(self.parameters[k].name, float(change[k]), float(share[k])) for k in order]

    def good(self) -> NDArray[np.bool_]:
        """Mask (n,) of the sheets that keep every limit."""
        kept = np.ones(len(self.measures), dtype=bool)
        for limit in self.limits:
            kept &= limit.kept(self.column(limit.measure))
        return kept

    def yields(self) -> tuple[float, float, float]:
        """Share of good sheets, ends of its 95 % interval (Wilson, J. Am. Stat. Assoc. 22, 209 (1927))."""
        n = len(self.measures)
        if n == 0:
            return float("nan"), 0.0, 1.0
        share, z = float(self.good().mean()), 1.959963984540054
        middle = (share + z * z / (2 * n)) / (1 + z * z / n)
        half = z / (1 + z * z / n) * sqrt(share * (1 - share) / n + z * z / (4 * n * n))
        return share, max(0.0, middle - half), min(1.0, middle + half)

    def misses(self) -> dict[str, int]:
        """Number of sheets that miss each limit."""
        return {limit.measure: int((~limit.kept(self.column(limit.measure))).sum()) for limit in self.limits}

    def nominal_misses(self) -> list[str]:
        """Limits that the sheet misses as designed, regardless of tolerances."""
        return [
            limit.measure
            for limit in self.limits
            if not limit.kept(np.array([self.nominal[limit.measure]]))[0]
        ]

    def percentiles(self, measure: str) -> list[float]:
        """Values below which 5, 50 and 95 % of the sheets lie; unmeasurable sheets count as infinite."""
        column = self.column(measure)
        if not len(column):
            return [float("nan")] * 3
        filled = np.sort(np.where(np.isnan(column), np.inf, column))
        return [float(filled[min(len(filled) - 1, int(part * len(filled)))]) for part in (0.05, 0.5, 0.95)]


LEAST_SHEETS = 30.0
"""Effective number of sheets below which no yield is estimated."""


def yield_if_tighter(study: Study, key: str, factor: float) -> float | None:
    """Estimate the yield with one tolerance times `factor` from the sheets of a study.

    Each sheet is weighted by the ratio of the probability densities of its errors (importance sampling):
    of uniform errors, those beyond the tighter tolerance have weight 0 and the others equal weights.

    Returns: None where too few sheets have a weight.
    """
    weight = np.ones(len(study.errors))
    for k, one in enumerate(study.parameters):
        if one.key != key or one.half == 0.0:
            continue
        if one.scatter:  # every sheet has it: none was drawn without
            return None
        scaled = study.errors[:, k] / one.half
        if study.distribution == "normal" and not one.uniform:  # a tolerance is two standard deviations
            weight *= np.exp(-2.0 * scaled**2 * (factor**-2 - 1.0))
        else:
            weight *= np.abs(scaled) <= factor
    total = float(weight.sum())
    if total == 0.0 or total**2 / float((weight**2).sum()) < LEAST_SHEETS:
        return None
    return float(weight @ study.good()) / total


def _centre(measures: Floats) -> tuple[float, float]:
    """Centre (metres) of the cell of the law error in a row of measures."""
    x, y = (float(measures[list(MEASURES).index(name)]) for name in ("law_rms_x", "law_rms_y"))
    return x, y


def limits(design: Design) -> tuple[Limit, ...]:
    """Limits of a good sheet: those of [check], and those of [tolerances]."""
    check, own = design.check, design.tolerances
    found = [
        Limit("law_rms", "<=", check.law_rms, CHECK.law_rms),
        Limit("law_bias", "<=", check.law_bias, CHECK.law_bias),
        Limit("eta_error", "<=", check.eta, CHECK.eta),
        Limit("delta_error", "<=", check.delta, CHECK.delta),
        Limit("kept", ">=", check.throughput, CHECK.throughput),
    ]
    for measure in ("law_white", "temperature"):
        stated = getattr(check, measure)
        if stated is not None:
            found.append(Limit(measure, "<=", stated, getattr(CHECK, measure)))
    for measure in ("image_shift", "blur", "residual_power", "moire_period"):
        value = getattr(own, measure)
        if value is not None:
            metres = design.unit_m if measure == "moire_period" else 1.0
            relation = ">=" if measure == "moire_period" else "<="
            found.append(Limit(measure, relation, value * metres, getattr(TOLERANCES, measure)))
    return tuple(found)


# -- cases ------------------------------------------------------------------------------------------------


def case_errors(chosen: Sequence[Parameter], seed: int, distribution: str, case: int) -> Mapping[str, float]:
    """Errors of case 0 (as designed), of the cases of each parameter alone, then of the drawn sheets."""
    if case == 0:
        return {}
    number, which = divmod(case - 1, ENDS)
    if number < len(chosen):
        p = chosen[number]
        part = (1.0, 0.0 if p.one_sided else -1.0, SMALL, 0.0 if p.one_sided else -SMALL)[which]
        return {p.name: part * p.half}
    return draw(chosen, seed, case - 1 - ENDS * len(chosen), distribution)


@lru_cache(maxsize=2)
def _set_up(study: str) -> tuple[Bench, tuple[Parameter, ...], int, str]:
    asked = json.loads(study)
    design = asked_design(asked)
    window = worst_cell(prescribe(design), design.check.field).like
    return (
        bench(design, window, asked["rays"]),
        parameters(design, window),
        asked["seed"],
        design.tolerances.distribution,
    )


def make_cases(study: str, cases: Sequence[int]) -> list[list[float]]:
    """Make the sheets of some cases and measure them; the numbers do not depend on the process."""
    table, chosen, seed, distribution = _set_up(study)
    spec = asked_design(json.loads(study)).tolerances
    alone = 1 + ENDS * len(chosen)
    found = []
    for case in cases:
        errors = case_errors(chosen, seed, distribution, case)
        if spec.compensator is not None and case >= alone:
            step = next(one.half for one in chosen if one.name == spec.compensator)
            errors = adjusted(table, errors, spec.compensator, step)
        measured = table.measured(errors)
        found.append([measured[name] for name in (*MEASURES, *STATED) if name in measured])
    return found


def adjusted(table: Bench, errors: Mapping[str, float], name: str, step: float) -> Mapping[str, float]:
    """Errors of a sheet with one of them set to the least law error: a spacer, or focus.

    The square of the error is a parabola of a gap, so that three values give its least; a second parabola
    about that refines it. The best of all tried is returned.

    step : Distance of the tried values, in the unit of the error.
    """
    tried: dict[float, float] = {}

    def square(value: float) -> float:
        if value not in tried:
            tried[value] = table.law_rms({**errors, name: value}) ** 2
        return tried[value]

    at = errors.get(name, 0.0)
    for width in (step, 0.25 * step):
        low, here, high = square(at - width), square(at), square(at + width)
        bend = low - 2.0 * here + high
        if not bend > 0.0:
            break
        at += min(max(0.5 * width * (low - high) / bend, -FARTHEST * step), FARTHEST * step)
    square(at)
    known = {value: one for value, one in tried.items() if isfinite(one)}
    return {**errors, name: min(known, key=lambda value: known[value])} if known else errors


class NoTolerances(ValueError):
    """The design states no tolerances."""

    exit_status = 2


NO_TOLERANCES = (
    "the design states no tolerances: give it a [tolerances] table, such as\n"
    '  [tolerances]\n  decentre = "5 um"\n  rotation = "0.1 mrad"\n  tilt = "0.1 mrad"\n  radius = 0.005\n'
    '  or class = "moulding-precision" (clacad explain tolerances)'
)


TASK = "tolerances"
"""Name under which the required time is recorded."""


def study_seconds(design: Design, samples: int | None, rays: int) -> float:
    """Processor seconds of a study from its beginning, by a model of one reference machine."""
    chosen = parameters(design, prescribe(design))  # as many as of any cell
    drawn = design.tolerances.samples if samples is None else samples
    each = 1.0 if design.tolerances.compensator is None else 1.0 + 0.5 * TRIED  # less is measured of these
    count = 1 + ENDS * len(chosen) + each * drawn
    return 0.8 + count * (0.006 + 2e-5 * rays)


def tolerance(
    design: Design,
    samples: int | None = None,
    seed: int | None = None,
    rays: int = RAYS,
    farm: Farm | None = None,
    checkpoint: Path | None = None,
    progress: Progress | None = None,
) -> Study:
    """Find what fabrication errors do to light: draw sheets within the design's [tolerances], trace each,
    count the good ones.

    Parameters
    ----------
    design : Design
        With a [tolerances] table; without one, NoTolerances is raised.
    samples, seed : int or None
        In place of the design's values.
    rays : int
        Rays of a bundle.
    farm : Farm or None
        Executor of the work; None: all cores of this machine.
    checkpoint : path or None
        Results are stored here as they arrive. Stored results are not computed again, and more samples
        continue from them. A checkpoint of another study raises OtherStudy.
    progress : callable or None
        (stage, done 0 … 1).

    Examples
    --------
    >>> import clacad
    >>> design = clacad.load("slab", ["lattice.count = [3, 3]", "tolerances.decentre = 5 um"])
    >>> from clacad.verification.tolerance import Farm
    >>> study = clacad.tolerance(design, samples=4, rays=64, farm=Farm(1))
    >>> len(study.column("law_rms"))
    4
    """
    seen = worst_cell(prescribe(design), design.check.field)
    chosen = parameters(design, seen.like)
    if not chosen:
        raise NoTolerances(NO_TOLERANCES)
    _refuse_compensator(design, chosen)
    seed = design.tolerances.seed if seed is None else seed
    count = 1 + ENDS * len(chosen) + (design.tolerances.samples if samples is None else samples)
    text = json.dumps({**named_design(design), "rays": rays, "seed": seed}, sort_keys=True)
    header = {"kind": "tolerances", "format": FORMAT, "clacad": __version__, "design": design.sha256}
    header |= {
        "seed": seed,
        "rays": rays,
        "parameters": [p.name for p in chosen],
        "measures": [*measures_of(design)],
    }
    rows = worked(make_cases, text, header, count, farm or Farm(), checkpoint, progress)
    study = _study(design, chosen, seed, rays, np.array(rows, dtype=np.float64))
    i, j = (int(v) for v in seen.cell)
    return replace(study, cell=(i, j), tried=seen.tried, of_cell=seen.words) if seen.tried else study


def _refuse_compensator(design: Design, chosen: Sequence[Parameter]) -> None:
    """Refuse a compensator that is no error of the design with a tolerance."""
    name, known = design.tolerances.compensator, [one.name for one in chosen if not one.one_sided]
    if name is not None and name not in known:
        raise NoTolerances(f"{TOLERANCES.compensator} = {name!r}: it is one of {', '.join(known)}")


def named_design(design: Design) -> dict[str, Any]:
    """A design as workers get it: its keys, and its path if a table of cells lies next to it."""
    varying = design.law_spec.varying
    beside = varying is not None and varying.table is not None
    return {"design": design.to_dict(), **({"path": design.path} if beside else {})}


def asked_design(asked: Mapping[str, Any]) -> Design:
    """The design of a study."""
    from clacad.design import Design
    from clacad.design.read import read_changed

    return Design(**read_changed(asked["design"], asked.get("path", ""), {}))


def worked(
    work: Callable[[str, Any], list[Any]],
    text: str,
    header: Mapping[str, Any],
    count: int,
    farm: Farm,
    checkpoint: Path | None,
    progress: Progress | None,
    piece: int = PIECE,
) -> list[Any]:
    """Records 0 … count − 1 of a study: those of the checkpoint, and the computed others, which are added to
    it.

    Raises WorkersLost: With the number of stored records, and how to continue.
    """
    report = shown_progress(progress)
    with Checkpoint(checkpoint, header) as kept:
        rows = list(islice(kept.records, count))
        pieces = list(_pieces(len(rows), count, piece)) if len(rows) < count else []
        try:
            for found in farm.run(work, text, pieces):
                kept.append(found)
                rows += found
                report("making sheets", len(rows) / count)
        except WorkersLost as error:
            raise WorkersLost(f"{error}; {_how_to_go_on(len(rows), count, checkpoint)}") from error
    return rows


def _how_to_go_on(done: int, count: int, checkpoint: Path | None) -> str:
    if checkpoint is None:
        return (
            f"{done} of {count} results were made and none is kept: with -o DIR the same command would go on"
            " from there"
        )
    return (
        f"{done} of {count} results are kept in {checkpoint}: "
        "the same command goes on from there, with this scheduler, another or none"
    )


def _pieces(start: int, stop: int, size: int) -> Iterator[list[int]]:
    for first in range(start, stop, size):
        yield list(range(first, min(first + size, stop)))


def _study(design: Design, chosen: tuple[Parameter, ...], seed: int, rays: int, rows: Floats) -> Study:
    """The study assembled from the measures (cases, m) of all its sheets."""
    n = len(chosen)
    names = measures_of(design)
    alone = rows[1 : 1 + ENDS * n].reshape(n, ENDS, len(names))
    with np.errstate(invalid="ignore"):
        width = np.array([(SMALL if p.one_sided else 2.0 * SMALL) * p.half for p in chosen])
        slopes = (alone[:, 2] - alone[:, 3]) / width[:, None]
    distribution = design.tolerances.distribution
    drawn = len(rows) - 1 - ENDS * n
    errors = [list(draw(chosen, seed, k, distribution).values()) for k in range(drawn)]
    return Study(
        design.name,
        design.sha256,
        design.unit_m,
        chosen,
        limits(design),
        distribution,
        seed,
        rays,
        dict(zip(names, (float(v) for v in rows[0]), strict=True)),
        alone[:, :2],
        slopes,
        np.array(errors, dtype=np.float64).reshape(drawn, n),
        rows[1 + ENDS * n :],
    )


def finite(value: float) -> float | str | None:
    """A number as JSON holds it: "inf" for infinity, null for NaN."""
    return value if isfinite(value) else ("inf" if value > 0 else None)
