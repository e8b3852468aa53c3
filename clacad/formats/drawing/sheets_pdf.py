"""A drawing as PDF: each sheet as SVG, set by Typst as in the report. Needs the extra `pdf`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from clacad.formats.drawing.canvas import STYLE
from clacad.formats.drawing.sheet_layout import Sheet
from clacad.storage.atomic import scratch_folder
from clacad.storage.errors import FileDisagrees


def sheet_svg(sheet: Sheet) -> str:
    """A sheet of paper as SVG, a millimetre a unit."""
    wide, tall = sheet.paper
    boards = "\n".join(
        f'<g transform="translate({one.x:.4f} {one.y:.4f})'
        f' scale({sheet.unit:.7f})">\n{one.canvas.body(sheet.zoom)}\n</g>'
        for one in sheet.drawn
    )
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {wide:g} {tall:g}" width="{wide:g}mm"'
        f' height="{tall:g}mm"><style>{STYLE}</style>\n{boards}\n</svg>'
    )


def write_drawing_pdf(made: Sequence[Sheet], path: Path) -> None:
    """Write all sheets, a page each; equal sheets give equal bytes."""
    import typst

    with scratch_folder() as place:
        lines = []
        for number, sheet in enumerate(made):
            (place / f"{number}.svg").write_text(sheet_svg(sheet), encoding="utf-8")
            wide, tall = sheet.paper
            lines.append(
                f'#page(width: {wide:g}mm, height: {tall:g}mm, margin: 0mm, image("{number}.svg", width:'
                f" {wide:g}mm))"
            )
        main = '#set document(title: "drawing", author: "clacad", date: none)\n' + "\n".join(lines)
        (place / "main.typ").write_text(main, encoding="utf-8")
        path.write_bytes(
            bytes(typst.compile(str(place / "main.typ"), root=str(place), ignore_system_fonts=True))
        )


def check_drawing_pdf(path: Path, pages: int) -> None:
    """Reject a file that is not a whole PDF with this number of pages.

    Raises
    ------
    FileDisagrees
    """
    data = path.read_bytes()
    if not data.startswith(b"%PDF") or b"%%EOF" not in data[-64:] or b"/Count %d" % pages not in data:
        raise FileDisagrees(f"{path.name}: no whole PDF of {pages} pages")
