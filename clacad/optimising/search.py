"""Search for better faces of a design with the same law.

Properties that a search must preserve: the plates, the cells, and the light that reaches its partner cell.

Design file of a search result, with comments on its origin and its gains.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import degrees, nan
from typing import Any

import numpy as np

from clacad.base.text import mrad_text, percent_text
from clacad.base.types import Floats, silent
from clacad.config.edit_text import to_toml
from clacad.design import Design
from clacad.design.faces import face_table
from clacad.design.sections import LIGHT, PAIR
from clacad.optimising.aim import MOST_LOST, RAYS, WHOLE, Aim, AimedRays, Seen, Weights, fields_of, measured
from clacad.optimising.face_search import Effort, FaceSearch, Progress
from clacad.optimising.scan_light import SCAN_POSITIONS, ScanLight
from clacad.optimising.unknowns import ListedUnknowns, Unknowns, chosen, listed_unknowns, refused
from clacad.prescription.face_list import as_listed
from clacad.prescription.prescribe import prescribe
from clacad.sheet.need_window import equal_cells
from clacad.sheet.window import Window
from clacad.steering.scan import Position, Scan, Steered, steer

SAME = 1e-12
"""Tolerance of positions as a share of the separation: rounding error of the recipes."""


def refuse_lost_light(before: Sequence[Seen], after: Sequence[Seen]) -> None:
    """Refuse faces that lose more than `MOST_LOST` of the light of a cone, compared with the start.

    Raises DesignError.
    """
    if not after:
        return
    worst = max(zip(before, after, strict=True), key=lambda pair: pair[0].throughput - pair[1].throughput)
    was, now = (seen.throughput for seen in worst)
    if not was - now <= MOST_LOST:
        raise refused(
            "CL120",
            f"the faces that were found take {now:.3f} of the light of a cone of"
            f" {np.degrees(worst[0].field):.3g} deg to its partner cell, the start {was:.3f}; nothing"
            " is written",
            "free",
            allowed=f"a loss of at most {MOST_LOST:g}",
            hint="fewer words of --free, or a smaller field",
        )


def refuse_moved(start: Window, found: Window, *, traced: bool) -> None:
    """Refuse a design whose plates, vertices or cells have moved from those of the start.

    traced : bool
        Whether tracing places the vertices of lens 2 in their cells; then only their heights are compared.
    Raises DesignError.
    """
    apart = np.abs(_places(found, traced=traced) - _places(start, traced=traced)).max()
    if not apart <= SAME * start.thin.separation:
        raise refused(
            "CL120",
            f"the plates or cells would move by {apart:.3g}; nothing is written",
            PAIR.separation,
            allowed="plates and cells that stay where the start has them",
            hint='pair.confocal = "exact" in the design to start from',
        )


def _places(window: Window, *, traced: bool) -> Floats:
    """Lengths that fix plates and cells: vertices of all faces or only their heights, shifts of arrays."""
    vertices = np.array([face.vertex for face in window.faces])
    return np.concatenate([(vertices[:, 2:] if traced else vertices).ravel(), np.ravel(window.shifts)])


OWN = "design"
"""Word for the lines that [light] of the design states."""

ALIKE = "a slope as lattice.aperture aims all cells alike"
"""Suggested input of a search for a non-uniform sheet."""


@dataclass(frozen=True, eq=False)
class Optimised:
    """Result of a search.

    Parameters
    ----------
    design : Design
        Design with the found faces; passes the design rules if the start did.
    start : Design
    free : tuple of str
        Words of the request.
    left_out : tuple of str
        Words of `free` that would have reduced the error by less than a tenth and were left unchanged.
    aim : Aim
    unknowns, evaluations : int
    before, after : tuple of Seen
        Start and end at ½, 1 and 2 × the field; empty after an interruption.
    expected : (float, float) or None, radians
        Expected rms error of parts as made, start and end, over the search's own rays; None without
        tolerances.
    history : tuple of (evaluations, rms error in radians)
        Best result within the walls at each improvement by a tenth, the first and the last; contains no
        times.
    spectrum : str
        Word of the request; "" for the design's wavelength.
    scans : (Steered, Steered) or None
        Light of the start and of the end at every position of the requested scan.
    stopped : str
        "": finished; "interrupted" or "seconds": `design` is the best so far.
    """

    design: Design
    start: Design
    free: tuple[str, ...]
    left_out: tuple[str, ...]
    aim: Aim
    unknowns: int
    evaluations: int
    before: tuple[Seen, ...]
    after: tuple[Seen, ...]
    expected: tuple[float, float] | None
    history: tuple[tuple[int, float], ...]
    stopped: str
    spectrum: str = ""
    scans: tuple[Steered, Steered] | None = None

    @property
    def finished(self) -> bool:
        """Whether the search ended by itself."""
        return not self.stopped

    @property
    def field(self) -> float:
        """Half angle of the cone of rays, radians."""
        return self.aim.field

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers: what was free, errors before and after, the faces."""
        return {
            "design": self.design.name,
            "from_sha256": self.start.sha256,
            "sha256": self.design.sha256,
            "free": list(self.free),
            "left_out": list(self.left_out),
            "field": self.field,
            "weights": [list(pair) for pair in self.aim.weights],
            "tolerances": self.aim.tolerances,
            **({"spectrum": [list(pair) for pair in self.aim.spectrum]} if self.aim.spectrum else {}),
            "unknowns": self.unknowns,
            "rays": RAYS,
            "evaluations": self.evaluations,
            "finished": self.finished,
            "stopped": self.stopped,
            "before": [vars(seen) for seen in self.before],
            "after": [vars(seen) for seen in self.after],
            "expected": None if self.expected is None else list(self.expected),
            "history": [list(one) for one in self.history],
            **({} if self.scans is None else {"scan": [one.to_dict() for one in self.scans]}),
            "faces": [face_table(face) for face in self.design.pair.face],
        }


def optimise(
    design: Design,
    free: tuple[str, ...] = ("radii", "conic"),
    field: float | Scan | None = None,
    progress: Progress | None = None,
    *,
    weights: Weights = WHOLE,
    tolerances: bool = False,
    seconds: float | Effort | None = None,
    spectrum: str | None = None,
) -> Optimised:
    """Search for face shapes that keep closer to the law of a design than the derived ones, over a field.

    Parameters
    ----------
    design : Design
    free : tuple of str
        Free parameters: "radii", "conic", "bending" (separate radii of both faces; biconvex), "a4" (on
        paraboloids unless "conic" is free, too), "a6" on top of it and "a8" on top of that, "offset" (of lens
        2; fixed otherwise). Terms of sixth and eighth order are kept only if they reduce the error by more
        than a tenth. Listed faces: "radii", "conic", "a4", "a6", "a8", "thickness" (all distances, with B of
        the faces kept) and "joints" (their radii and places).
    field : float or None, radians; or Scan
        Half angle of the cone of rays; None: the design's `check.field`. Or positions of moving plates, of
        listed faces: minimise the spread of light along the normal at all of them, with the exit beam, the
        slope at the end of the travel and the share held.
    progress : callable or None
        Called with the number of designs tried and the rms error (radians) of each better one; None: a bar
        at a prompt and in a notebook.
    weights : tuple of (part of the field, weight)
        Cones and the weights of their mean square errors; default the field alone.
    tolerances : bool
        Minimise the expected error of parts made with the design's [tolerances], not of the perfect part.
    seconds : float, Effort or None
        Time limit, after which the best result so far is returned, or limit and number of starts. A search
        that finishes earlier does not depend on the limit.
    spectrum : str or None
        Minimise the mean rms error over the lines of "visible" or "photopic" light, or of the [light] of the
        "design"; None: the error at the design's wavelength.

    Returns
    -------
    Optimised
        Reproducible, regardless of the machine's speed. KeyboardInterrupt ends the search and returns the
        best result so far.

    Raises
    ------
    DesignError
        A word that cannot be free; a weight that is none; a material without an index at a line; or no faces
        were found that keep within the walls.
    NoTolerances
        `tolerances` is True, and the design states none.

    Examples
    --------
    >>> import clacad
    >>> design = clacad.load("slab", ["lattice.count = [3, 3]"])
    >>> better = clacad.optimise(design, free=("radii",))
    >>> better.after[1].law_rms < better.before[1].law_rms
    True
    >>> better.design.pair.prescription
    'given'
    """
    design, window, unknowns, aim = _set_up(design, free, field, weights, tolerances, spectrum)
    scan = aim.scan
    effort = seconds if isinstance(seconds, Effort) else Effort(seconds)
    search = FaceSearch(design, window, unknowns, aim, progress or _shown(), effort)
    before = _compared(design, window, aim)
    stopped = search.run()
    if stopped == "interrupted" and not search.gained:
        raise KeyboardInterrupt
    found = replace(_checked(search, tuple(free), before, stopped), spectrum=spectrum or "")
    return (
        found
        if scan is None
        else replace(found, scans=(_scanned(design, scan), _scanned(found.design, scan)))
    )


def _set_up(
    design: Design,
    free: Sequence[str],
    field: float | Scan | None,
    weights: Weights,
    tolerances: bool,
    spectrum: str | None,
) -> tuple[Design, Window, Unknowns | ListedUnknowns, Aim]:
    """Design as searched, its window, the unknowns that words name and the objective."""
    design = as_listed(design)
    window = equal_cells(prescribe(design), "a search for better faces", ALIKE)
    listed, words = window.form == "plates", tuple(free)
    unknowns = listed_unknowns(design, window, words) if listed else chosen(window, words)
    cone = field if isinstance(field, float) else design.check.field
    scan, lines = field if isinstance(field, Scan) else None, lines_of_search(design, spectrum)
    return design, window, unknowns, _aim(window, Aim(cone, tuple(weights), tolerances, lines, scan))


def _aim(window: Window, aim: Aim) -> Aim:
    """The objective, refused where a scan goes with what it does not have.

    Raises DesignError.
    """
    if aim.scan is None:
        return aim
    if window.form != "plates":
        raise refused(
            "CL114",
            f"a scan moves listed plates, and this form is {window.form}",
            PAIR.form,
            found=window.form,
            allowed='pair.form = "plates"',
            hint="clacad new NAME --template scanner-f5",
        )
    if aim.spectrum or aim.tolerances or aim.weights != WHOLE:
        raise refused(
            "CL112",
            "a scan is searched at one wavelength, as designed, with light along the normal",
            "scan",
            allowed="without weights, tolerances and spectrum",
        )
    return aim


def _scanned(design: Design, scan: Scan) -> Steered:
    """Light of a design at every position of a scan."""
    return steer(
        design, scan.travel, scan.axis, scan.move, positions=scan.positions, waves=False, progress=silent
    )


def lines_of_search(design: Design, spectrum: str | None) -> Weights:
    """Lines (metres, weight) that a word names; empty for None.

    Raises DesignError: A material of the design has no index at one of them.
    """
    if spectrum is None:
        return ()
    stated = design.given.get("light", {}).get("spectrum", "visible") if spectrum == OWN else spectrum
    return tuple(design.replace(LIGHT.spectrum, stated).light.lines.items())


def _shown() -> Progress:
    """Progress as the stage of a bar; how much is left is not known."""
    from clacad.base.interactive import shown_progress

    report = shown_progress(None)
    return lambda tried, rms: report(f"{tried} designs tried, best {mrad_text(rms, 3)}", nan)


def _compared(design: Design, window: Window, aim: Aim) -> tuple[Seen, ...]:
    """Light of a design at the shares of the field at which start and end are compared."""
    return tuple(measured(window, part * aim.field, design, aim.spectrum) for part in fields_of(window))


def _checked(search: FaceSearch, free: tuple[str, ...], before: tuple[Seen, ...], stopped: str) -> Optimised:
    """Result of a search that ended; refused where plates, cells or light moved."""
    design, window, aim = search.design, search.window, search.aim
    better = search.best_design(free)
    assert search.best is not None  # otherwise there is no best design
    made = prescribe(better)
    if not {"offset", "thickness", "joints"} & set(free):
        refuse_moved(window, made, traced=design.pair.offset == "traced")
    after = () if stopped == "interrupted" else _compared(better, made, aim)
    refuse_lost_light(before[: len(after)], after)
    return Optimised(
        better,
        design,
        free,
        search.left_out,
        aim,
        search.kept_unknowns,
        search.evaluations,
        before,
        after,
        (search.before, search.best.rms) if aim.tolerances else None,
        search.best.history,
        stopped,
    )


def outlook(
    design: Design,
    free: tuple[str, ...],
    weights: Weights = WHOLE,
    *,
    tolerances: bool = False,
    spectrum: str | None = None,
    scan: Scan | None = None,
) -> dict[str, float]:
    """Forecast of a search: unknowns, evaluations and processor seconds of one core of the reference machine.

    Raises
    ------
    DesignError, NoTolerances
        As `optimise` of the same words.
    """
    design, window, unknowns, aim = _set_up(design, free, scan, weights, tolerances, spectrum)
    k = len(unknowns.free)
    evaluations = 10.0 + 0.8 * k * k  # measured: 16, 37, 34 and 379 of 4, 8, 10 and 20 unknowns
    each = (0.005 if unknowns.still else 0.02) * (1.5 if "a4" in free else 1.0) * len(weights)
    if window.form == "plates":
        evaluations, each = 10.0 + 9.0 * k * k, 0.03 * len(weights)  # measured: 293, 1372 of 6, 12 unknowns
    if scan is not None:
        ScanLight.of(scan, window)  # refuses plates that cannot move
        evaluations, each = 100.0 + 2.5 * k * k, 0.01 * SCAN_POSITIONS  # measured: 744 of 17 unknowns
    else:
        each *= max(1, len(aim.spectrum))
        each += 0.008 * len(AimedRays.of(aim, design, window, k).errors)
    return {"unknowns": k, "evaluations": evaluations, "seconds": 0.6 + each * evaluations}


PLACES: dict[int, tuple[str, ...]] = {
    2: ("lens 1, front of the slab", "lens 2, back of the slab"),
    4: ("lens 1, front", "lens 1, back", "lens 2, front", "lens 2, back"),
}
PLACES[6] = (*PLACES[4][:2], "field lens, front", "field lens, back", *PLACES[4][2:])
PLATES = ("lens 1", "field lens, back of plate 1", "field lens, front of plate 2", "lens 2")


def design_text(found: Optimised) -> str:
    """Optimised design as loadable TOML, with comments."""
    data = dict(found.design.given)
    pair = dict(data["pair"])
    faces, record = pair.pop("face"), pair.pop("search")
    head = {key: value for key, value in data.items() if not isinstance(value, Mapping)}
    parts = [_about(found), to_toml(head)]
    for name, section in data.items():
        if not isinstance(section, Mapping):
            continue
        parts.append(to_toml({name: pair if name == "pair" else section}))
        if name == "pair":
            for face, place in zip(faces, _names(pair["form"], len(faces)), strict=True):
                body = to_toml(face)
                parts.append(f"\n[[pair.face]]    # {place}\n{body}")
            parts.append(to_toml({PAIR.search: record}))
    return "".join(parts)


def _names(form: str, count: int) -> tuple[str, ...]:
    """Names of the faces of a form in the order of the light."""
    if form == "plates":
        return tuple(f"face {number}" for number in range(1, count + 1))
    return PLATES if form == "slab" and count == len(PLATES) else PLACES[count]


def _about(found: Optimised) -> str:
    """Comments of the file before its first key."""
    lines = [
        f"{found.design.name}: faces found by clacad optimise {asked(found)}",
        f"from the design {found.start.sha256} with {found.unknowns} unknowns, {RAYS} Sobol rays, "
        f"{found.evaluations} evaluations.",
    ]
    lines += [left_out(found)] if found.left_out and found.finished else []
    if found.stopped:
        why = "on the way" if found.stopped == "interrupted" else "when its seconds were over"
        lines.append(f"The search was stopped {why}; this is the best it had found within the walls.")
    if found.after:
        mean = ", mean of the lines" if found.spectrum else ""
        what = f"Direction error to the law, rms over fresh rays{mean}, and share of light that gets to its"
        what += " partner"
        lines += ["", f"{what} cell:", *(f"  {text}" for text in gains(found))]
        lines += ["What is best over this field need not be over another."]
    if found.expected is not None:
        lines.append(expected(found))
    return "".join(f"# {line}".rstrip() + "\n" for line in lines) + "\n"


def asked(found: Optimised) -> str:
    """Requested options, as they would be typed."""
    text = f'--free {",".join(found.free)} --field "{degrees(found.field):.4g} deg"'
    if found.aim.weights != WHOLE:
        text += f" --weights {','.join(f'{part:g}:{weight:g}' for part, weight in found.aim.weights)}"
    text += f" --spectrum {found.spectrum}" if found.spectrum else ""
    text += "" if found.aim.scan is None else f" --scan {found.aim.scan.words(found.design.unit)}"
    return text + (" --tolerances" if found.aim.tolerances else "")


def left_out(found: Optimised) -> str:
    """A sentence on the orders that gave too little gain."""
    return f"Left out, for the error would be less by under a tenth with it: {', '.join(found.left_out)}."


def _steered(one: Position) -> str:
    """Spread, share and exit beam of a position."""
    share = percent_text(one.share, 1, fixed=True)
    beam = ", ".join(f"{width:.3f}" for width in one.exit_beams)
    return f"{mrad_text(one.spread)}, {share}, beam {beam}"


def expected(found: Optimised) -> str:
    """A sentence on the error of parts as made."""
    assert found.expected is not None
    before, after = map(mrad_text, found.expected)
    return f"To expect of parts made with the [tolerances]: {before}  ->  {after} rms."


def gains(found: Optimised) -> list[str]:
    """One line per field, or per position of a scan: error and share before and after."""
    if found.scans is not None:
        pairs = zip(*(one.positions for one in found.scans), strict=True)
        return [f"{one.travel:8.4g}: {_steered(one)}  ->  {_steered(two)}" for one, two in pairs]
    return [
        f"{degrees(one.field):6.4g} deg: {mrad_text(one.law_rms)},"
        f" {percent_text(one.throughput, 1, fixed=True)}"
        f"  ->  {mrad_text(two.law_rms)}, {percent_text(two.throughput, 1, fixed=True)}"
        for one, two in zip(found.before, found.after, strict=True)
    ]
