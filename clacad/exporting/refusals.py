"""Refusals of an export before its first byte, with the reasons of all formats together.

Formats with special requirements check them here: an installed extra, a gap, a border, room for a line of
text. Limits of size, and bodies that cannot be built, are found by the forecast and collected here too.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import TYPE_CHECKING

from clacad.base.units import millimetres
from clacad.exporting.format_names import refuse_other_cells
from clacad.sheet.gap import NoFixture
from clacad.storage.errors import ExportError, NotPossible

if TYPE_CHECKING:
    from clacad.exporting.request import Request
    from clacad.sheet.window import Window
    from clacad.storage.worker import Worker


class Refusals:
    """Refusals of formats, collected until all formats have been checked."""

    def __init__(self) -> None:
        self._found: dict[str, Exception] = {}

    def __contains__(self, format: object) -> bool:
        return format in self._found

    def __bool__(self) -> bool:
        return bool(self._found)

    @contextmanager
    def of(self, *formats: str) -> Iterator[None]:
        """Keep a refusal raised in the block as that of some formats; program errors propagate."""
        try:
            yield
        except (ExportError, ValueError) as error:
            if getattr(error, "exit_status", None) is None:
                raise
            refusal = NotPossible(str(error)) if isinstance(error, NoFixture) else error
            self._found |= dict.fromkeys(formats, refusal)

    def complete(self) -> None:
        """Refuse the export if any format was.

        Raises
        ------
        ExportError, ValueError
            The refusal, if there is only one; else their common type, or `NotPossible`, with all of them.
        """
        by_text: dict[str, list[str]] = {}
        for name, error in self._found.items():
            by_text.setdefault(str(error), []).append(name)
        if not by_text:
            return
        errors = list(self._found.values())
        if len(by_text) == 1:
            raise errors[0]
        kinds = {type(error) for error in errors}
        kind = kinds.pop() if len(kinds) == 1 and issubclass(type(errors[0]), ExportError) else NotPossible
        raise kind("\n".join(_line(names, text) for text, names in by_text.items()))


def _line(formats: list[str], text: str) -> str:
    """Text of a refusal, prefixed with its formats unless it already begins with them."""
    named = ", ".join(formats)
    return text if text.startswith((f"{named}:", f"format {named}")) else f"{named}: {text}"


def require_possible(window: Window, format: str, asked: Request, worker: Worker) -> None:
    """Refuse a format that is impossible for a design; only long text in a small space needs the worker.

    Raises
    ------
    NotPossible, NoFixture, LimitRefused, CannotBuild
    CellsDiffer
        The format holds uniform sheets only.
    WorkerDied
        The letters could not be drawn.
    """
    refuse_other_cells(window, format)
    if format in _NEEDS:
        _NEEDS[format](window, asked, worker)


# --- what each format needs -------------------------------------------------------------------------------


def _gds(window: Window, asked: Request, _worker: Worker) -> None:
    """Require the package that writes GDSII, and levels that its layers distinguish."""
    from clacad.formats.maps.gds import grey_cell, require_gdstk
    from clacad.formats.maps.sag import structured_faces

    require_gdstk()
    for body, face, label in structured_faces(window):
        grey_cell(window, body, face, label, asked.grey_levels, millimetres(window.unit))


def _mask(window: Window, _asked: Request, _worker: Worker) -> None:
    """Require one outline for the lenses of a face."""
    from clacad.formats.maps.mask import aperture
    from clacad.formats.maps.sag import structured_faces

    if not window.uniform:
        for body, face, _ in structured_faces(window):
            aperture(window, body, face)


def _baffle(window: Window, _asked: Request, _worker: Worker) -> None:
    """Require walls, and a gap for them."""
    from clacad.exporting.fixtures import baffle_meshes

    baffle_meshes(window)


def _frame(window: Window, _asked: Request, worker: Worker) -> None:
    """Require two plates with flat borders, a gap, and room for the name."""
    from clacad.exporting.fixtures.frame import frame_spec, mark_lines
    from clacad.solid.marks import mark_text

    for width, height in mark_lines(frame_spec(window, window.land.border)):
        _require_room(mark_text(window.name), width, height, worker)


def _pins(window: Window, _asked: Request, _worker: Worker) -> None:
    """Require two plates with pin holes, a gap, and land for the shoulders."""
    from clacad.exporting.fixtures.shoulder_pins import pin_spec

    pin_spec(window)


def _marks(window: Window, _asked: Request, worker: Worker) -> None:
    """Require a border with room for the name."""
    from clacad.solid.marks import mark_place, mark_text

    for place, body in [(mark_place(window, body), body) for body in window.bodies]:
        _require_room(mark_text(f"{window.name} {body.name}"), place.width, place.height, worker)


def _marked(window: Window, asked: Request, worker: Worker) -> None:
    """Require a border with room for the name, and bodies that OCC accepts."""
    _marks(window, asked, worker)
    _solids(window, "marked")


def _brep(window: Window, _asked: Request, _worker: Worker) -> None:
    """Require bodies that OCC accepts."""
    _solids(window, "BREP")


def _coupon(window: Window, _asked: Request, _worker: Worker) -> None:
    """Require a patch of a few cells that is a solid."""
    from clacad.exporting.fixtures.coupon import PATCH_CELLS

    _solids(window.with_cells(PATCH_CELLS), "coupon")


def _drawing(_window: Window, _asked: Request, _worker: Worker) -> None:
    """Require the packages that write DXF and PDF."""
    from clacad.formats.drawing.dxf import require_drawing

    require_drawing()


def _zmx(window: Window, _asked: Request, _worker: Worker) -> None:
    """Require faces that Zemax surfaces can hold."""
    from clacad.formats.sequential.zmx import zmx_lines

    for _ in zmx_lines(window):
        pass


def _optiland(window: Window, _asked: Request, _worker: Worker) -> None:
    """Require optiland, which reads the file back, and faces that its surfaces can hold."""
    from clacad.formats.sequential.optiland_json import optiland_document, require_optiland

    require_optiland()
    optiland_document(window)


def _solids(window: Window, what: str) -> None:
    """Require at most the number of cells that OCC takes, and faces that can be described."""
    from clacad.exporting.file_sizes import step_bytes
    from clacad.exporting.fixtures.fixture_files import refuse_many

    refuse_many(window, what)
    step_bytes(window, "fused")  # describes the faces of small sheets, as the solids are described


def _require_room(text: str, width: float, height: float, worker: Worker) -> None:
    """Require room for a line of text (mm): estimated from its number of letters, or else measured by drawing
    it.
    """
    from clacad.solid.marks import surely_fits

    if not surely_fits(text, width, height):
        worker.run("clacad.solid.marks:require_room", text, width, height, timeout=DRAWING_SECONDS)


DRAWING_SECONDS = 300.0
"""Time for OCC to draw a line of text."""

_NEEDS: Mapping[str, Callable[[Window, Request, Worker], None]] = {
    "gds": _gds, "mask": _mask, "baffle": _baffle, "frame": _frame, "pins": _pins, "marked": _marked, "marked-stl": _marks, "marked-3mf": _marks,
    "brep": _brep, "coupon": _coupon, "drawing": _drawing, "optiland": _optiland, "zmx": _zmx,
}  # fmt: skip
"""Format → its check; other formats are refused by their forecast alone."""
