"""Facets per cell side of every format, and the role of each file: as requested, and as chosen."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import isfinite
from typing import TYPE_CHECKING, Generic, TypeVar

from clacad.base.text import did_you_mean, near
from clacad.exporting import limits
from clacad.exporting.formats import registry
from clacad.exporting.formats.format import STREAM_FACET, ChosenMesh, stream_bytes
from clacad.exporting.formats.registry import format_of
from clacad.exporting.light_forecast import FINE, POWERS, Grader
from clacad.exporting.request import DEFAULTS, AskedQuads, AskedRole, Quads
from clacad.exporting.roles import WORDS, Prospect, Role
from clacad.storage.errors import BadRequest, LimitRefused

if TYPE_CHECKING:
    from clacad.design import Design
    from clacad.exporting.formats.format import Forecast
    from clacad.exporting.request import Request
    from clacad.exporting.tessellations import Meshes
    from clacad.sheet.window import Window

ROLES = ("master", "preview")
"""Words by which an export declares a role."""

T = TypeVar("T")

COARSEST = 4
"""Facets per cell side of a declared preview without a requested grid."""

MOST_WELDED = 8_000_000
"""Largest number of facets with shared vertices that "auto" chooses."""

COUNTED = (8, 16)
"""Grids whose facets are counted; the facets of other grids are computed from them."""

TRACED = 256
"""Finest grid that is meshed only to decide a role; above it, the formula of the coarser grids is used."""


# -- as requested: one value for all files, or one a format -----------------------------------------


def asked_quads(asked: AskedQuads, formats: Sequence[str]) -> dict[str, Quads]:
    """Requested facet grid of each exported mesh format.

    Raises BadRequest: A value that is no grid, a format that is unknown, has no facets or is not exported.
    """
    meshes = [one.word for one in registry.formats() if one.is_mesh]
    lacking = f"for {{}}: it has no facets; formats that have: {', '.join(meshes)}"
    return _of_formats(asked, formats, _Asked("quads", _grid, meshes.__contains__, lacking))


def asked_roles(asked: AskedRole, formats: Sequence[str]) -> dict[str, Role]:
    """Declared role of each exported format.

    Raises BadRequest: A word that is no role, a format that is unknown, carries no light or is not exported.
    """
    dark = [one.word for one in registry.formats() if not one.optical]
    lacking = "of {}: no light of the law goes through it, so it has none to declare"
    return _of_formats(asked, formats, _Asked("role", _role, lambda word: word not in dark, lacking))


@dataclass(frozen=True, slots=True)
class _Asked(Generic[T]):
    """Per-format option: its name, its value's reader, the formats that have it, what other formats lack."""

    name: str
    read: Callable[[object], T]
    suits: Callable[[str], bool]
    lacking: str


def _of_formats(asked: object, formats: Sequence[str], kind: _Asked[T]) -> dict[str, T]:
    """Value of each exported format in export order: one for all formats that have the option, or named."""
    if asked is None:
        return {}
    if not isinstance(asked, Mapping):
        value = kind.read(asked)
        return {name: value for name in dict.fromkeys(formats) if kind.suits(name)}
    named = {name: kind.read(value) for name, value in asked.items()}
    for name in named:
        _exported(name, formats, kind.name)
        if not kind.suits(name):
            raise BadRequest(f"{kind.name} {kind.lacking.format(name)}")
    return {name: named[name] for name in dict.fromkeys(formats) if name in named}


MOST_QUADS = 8192
"""Largest number of facets along a cell side; one array of the corners then takes 0.5 GB."""


def _grid(value: object) -> Quads:
    if value == "auto":
        return "auto"
    if isinstance(value, int) and not isinstance(value, bool) and value >= 1:
        if value > MOST_QUADS:
            raise LimitRefused(
                f"quads = {value}: a cell side is cut into {MOST_QUADS} at most: use auto, or format step for"
                " exact faces"
            )
        return value
    hint = _near(value, ("auto",))
    raise BadRequest(f"quads = {value}: it is a whole number above 0, or auto{hint}")


def _role(word: object) -> Role:
    if word == "scan":
        raise BadRequest("role = scan: a scan is measured, not exported; allowed: master, preview")
    if word == "tooling":
        raise BadRequest(
            "role = tooling: --compensate and the formats for tools declare it; allowed: master, preview"
        )
    if isinstance(word, str) and word in WORDS:
        return WORDS[word]
    raise BadRequest(f"role = {word}: unknown{_near(word, ROLES)}; allowed: {', '.join(ROLES)}")


def _exported(name: str, formats: Sequence[str], what: str) -> None:
    if name in formats:
        return
    if name in registry.words():
        raise BadRequest(f"{what} for {name}, which is not exported: add it to the formats, or leave it out")
    raise BadRequest(f"{what} for {name!r}: unknown format{_near(name, registry.words())}")


def _near(word: object, words: Mapping[str, object] | Sequence[str]) -> str:
    return did_you_mean(near(str(word), words), before="; ")


# -- as chosen -------------------------------------------------------------------------------------


class Sizes:
    """Facets and bytes of the mesh formats at any grid, extrapolated from two coarse grids."""

    def __init__(self, meshes: Meshes) -> None:
        self.meshes = meshes
        self._rows: dict[tuple[str, int], Forecast] = {}

    def facets(self, format: str, quads: int) -> int:
        """Approximate number of facets that a file stores; those of one cell where the format repeats it."""
        square, linear = self._cell if format_of(format).repeats_cells(self.meshes) else self._sheet
        return int(square * quads * quads + linear * quads)

    def bytes(self, format: str, quads: int) -> int:
        """Approximate size of the file, scaled from a file that is small enough to be generated."""
        drawn = min(quads, FINE if format_of(format).repeats_cells(self.meshes) else COUNTED[1])
        row = self._drawn(format, drawn)
        facets = self.facets(format, quads)
        if format_of(format).family == "stream":
            return row.bytes + STREAM_FACET * (facets - self.facets(format, drawn))
        return int(row.places + (row.bytes - row.places) * facets / max(1, self.facets(format, drawn)))

    def fits(self, format: str, quads: int) -> bool:
        """Whether a file of a format is within the limits of facets and bytes."""
        facets = self.facets(format, quads)
        if format_of(format).family == "stream":
            return facets <= limits.MOST_FACETS and stream_bytes(facets) <= limits.MOST_BYTES
        return facets <= MOST_WELDED and self.bytes(format, quads) <= limits.MOST_BYTES

    def finest(self, format: str) -> int:
        """Finest grid of "auto" that fits, or the coarsest grid if none fits."""
        return next((quads for quads in reversed(POWERS) if self.fits(format, quads)), POWERS[0])

    def _drawn(self, format: str, quads: int) -> Forecast:
        """Forecast of a file on a coarse grid, computed once."""
        if (format, quads) not in self._rows:
            self._rows[format, quads] = format_of(format).forecast(self.meshes, quads, DEFAULTS)
        return self._rows[format, quads]

    @cached_property
    def _cell(self) -> tuple[float, float]:
        return _law_of_growth(*(self.meshes.at(quads).cell.facet_count for quads in COUNTED))

    @cached_property
    def _sheet(self) -> tuple[float, float]:
        return _law_of_growth(*(self.meshes.facets(quads) for quads in COUNTED))


@dataclass(frozen=True, slots=True)
class Needed:
    """Grid and size of a master of one format.

    quads : a cell side
    bytes : Approximate size of the file.
    fits : Whether an export would write it without `force`.
    """

    quads: int
    bytes: int
    fits: bool


def masters(grader: Grader, formats: Sequence[str]) -> dict[str, Needed]:
    """Grid and bytes of a master in each mesh format; empty where no grid up to 1024 is fine enough."""
    quads, sizes = grader.foreseen(), Sizes(grader.meshes)
    if quads is None:
        return {}
    return {name: Needed(quads, sizes.bytes(name, quads), sizes.fits(name, quads)) for name in formats}


def _law_of_growth(coarse: int, fine: int) -> tuple[float, float]:
    """Facets per quads squared, and per quads, from the facet counts of two grids."""
    small, large = COUNTED
    square = (fine / large - coarse / small) / (large - small)
    return square, coarse / small - small * square


def chosen_quads(grader: Grader, sizes: Sizes, request: Request, formats: Sequence[str]) -> dict[str, int]:
    """Facet grid of each mesh format: as requested, by slope error, or by the light through it.

    Without a request it is the coarsest grid that makes a master within the limits of facets and bytes. If
    there is none, it is the finest grid within the limits, up to `FINE`: a preview. A declared preview has
    the coarsest grid.

    Raises LimitRefused: The facets for the requested slope error exceed the limits.
    """
    chosen: dict[str, int] = {}
    for name in formats:
        if not format_of(name).is_mesh:
            continue
        asked = request.quads.get(name)
        if asked == "auto" or by_default(request, name):
            most = POWERS[-1] if asked == "auto" else FINE
            chosen[name] = _master(grader, sizes, name) or min(sizes.finest(name), most)
        elif asked is not None:
            chosen[name] = asked
        elif request.slope_error != "auto" and request.role.get(name) is not Role.PREVIEW:
            slope_error = float(request.slope_error)
            chosen[name] = limits.quads_for_slope(grader.meshes.window, slope_error, request.force)
        else:
            chosen[name] = COARSEST
    return chosen


def default_meshes(design: Design, window: Window, formats: Sequence[str]) -> dict[str, ChosenMesh]:
    """Mesh files of an export with default options, with the grids that `export` chooses."""
    from clacad.exporting.tessellations import Meshes

    grader = Grader.of(Meshes(window), design)
    sizes = Sizes(grader.meshes)
    return {
        name: ChosenMesh(quads, sizes.facets(name, quads), sizes.bytes(name, quads))
        for name, quads in chosen_quads(grader, sizes, DEFAULTS, formats).items()
    }


def by_default(request: Request, format: str) -> bool:
    """Whether neither grid nor preview was requested of a mesh format; the light then decides both."""
    said = request.quads.get(format) is not None or request.slope_error != "auto"
    return format_of(format).is_mesh and not said and request.role.get(format) is not Role.PREVIEW


def _master(grader: Grader, sizes: Sizes, format: str) -> int | None:
    """Coarsest grid that makes a master of a format within the limits, or None."""
    finest = sizes.finest(format)
    if finest > FINE:
        least = grader.foreseen()
        if least is None or least > finest:
            return None  # nothing that fits is worth tracing
    return grader.least(finest)


def with_prospects(
    grader: Grader, sizes: Sizes, rows: Sequence[Forecast], request: Request
) -> list[Forecast]:
    """Rows of a forecast with the role of each file and the forecast of the light through it.

    A preview whose facets were chosen by default counts as declared: no master of that format was requested.
    """
    found = (replace(row, prospect=_prospect(grader, sizes, row, request)) for row in rows)
    said = f"light forecast of {grader.cell}" if grader.cell else ""
    return [
        replace(row, note="; ".join(filter(None, (row.note, said)))) if row.quads is not None else row
        for row in found
    ]


def _prospect(grader: Grader, sizes: Sizes, row: Forecast, request: Request) -> Prospect:
    asked = request.role.get(row.format)
    if format_of(row.format).compensated(request):
        return Prospect(Role.TOOLING, True)
    if row.quads is None:
        return Prospect(format_of(row.format).role if asked is None else asked, asked is not None)
    rms, beyond = _light(grader, row.quads)
    role = asked if asked is not None else (Role.PREVIEW if beyond else Role.MASTER)
    known = rms if isfinite(rms) else None
    declared = asked is not None or (role is Role.PREVIEW and by_default(request, row.format))
    found = Prospect(role, declared, row.quads, known, grader.limits.rms, beyond)
    if role is Role.MASTER and not beyond:
        return found
    needed = grader.foreseen()
    return replace(
        found, master_quads=needed, master_bytes=None if needed is None else sizes.bytes(row.format, needed)
    )


def _light(grader: Grader, quads: int) -> tuple[float, tuple[str, ...]]:
    """Forecast rms (radians), and the limits that the light is forecast to exceed."""
    if quads > TRACED:
        rms = grader.law_rms(quads)
        return rms, () if rms <= grader.limits.rms else ("law_rms",)
    grade = grader.grade(quads)
    return grade.rms, grade.beyond(grader.limits)
