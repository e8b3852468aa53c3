"""Write the explorer page of a design."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from clacad.storage.errors import BadRequest, ExportRefused

if TYPE_CHECKING:
    from clacad.design import Design
    from clacad.explorer.first_verdict import FirstVerdict

HERE = Path(__file__).parent

LARGEST = 400_000
"""Most bytes of a page; a test checks them."""

SECONDS = 0.3
"""Processor seconds a page takes on the reference machine, nearly all of them for templates."""


@dataclass(frozen=True, slots=True)
class Explored:
    """A page that was made.

    Parameters
    ----------
    file : Path
    bytes : int
    written : bool
        False after a dry run.
    verdict : FirstVerdict
        Verdict of the page before a slider is moved.
    not_shown : tuple of str
        What of the design its view leaves out.
    """

    file: Path
    bytes: int
    written: bool
    verdict: FirstVerdict
    not_shown: tuple[str, ...]

    def to_dict(self) -> dict[str, Any]:
        """Plain JSON."""
        return {
            "file": str(self.file),
            "bytes": self.bytes,
            "written": self.written,
            "verdict": self.verdict.to_dict(),
            "not_shown": list(self.not_shown),
        }


def explore(
    design: Design, out: str | os.PathLike[str], overwrite: bool = False, *, dry_run: bool = False
) -> Explored:
    """Write one self-contained page on which the numbers of a design are moved, live.

    Parameters
    ----------
    design : Design
    out : path
        Ends in .html; its folder is made if missing. The file appears whole or not at all.
    overwrite : bool
        Replace a file that is there.
    dry_run : bool
        Make the page and report its size, but write nothing.

    Returns
    -------
    Explored

    Raises
    ------
    BadRequest
        `out` is no page.
    LimitRefused
        More lenslets than are ever gone through.
    NoSuchLens, DesignError
        The design cannot be built.
    ExportRefused, CannotWrite
    """
    from clacad.explorer.first_verdict import first_verdict
    from clacad.explorer.page_facts import not_shown, places
    from clacad.exporting.limits import refuse_uncountable
    from clacad.prescription.prescribe import prescribe
    from clacad.storage.atomic import write_content

    file = Path(out)
    if file.suffix.lower() not in (".html", ".htm"):
        raise BadRequest(f"{file}: the page is one file that ends in .html")
    refuse_uncountable(design)
    window = prescribe(design)
    text = page(design)
    if dry_run:
        if file.exists() and not overwrite:
            raise ExportRefused(f"{file} exists; choose another name, or ask to overwrite")
    else:
        write_content(file, text, overwrite=overwrite)
    verdict = first_verdict(window, *places(design, window))
    return Explored(file, len(text.encode()), not dry_run, verdict, not_shown(design, window))


def page(design: Design) -> str:
    """The page as one HTML text that needs no network; every text of the design is escaped in it.

    Raises
    ------
    NoSuchLens, DesignError
    """
    import json

    from markupsafe import Markup

    from clacad.explorer.page_facts import LAW, PRESETS, SHEET, VIEW, facts, not_shown, sliders
    from clacad.prescription.prescribe import prescribe
    from clacad.report.self_contained import environment, one_script

    window = prescribe(design)
    moved = sliders(design, window)
    script, digest = one_script(HERE / "closed_forms.js", HERE / "explorer.js")
    count = " × ".join(map(str, window.lattice.count))
    return (
        environment(HERE)
        .get_template("page.html.j2")
        .render(
            name=design.name,
            about=(
                f"confocal lenslet array pair, {window.form}, {window.lattice.kind} lattice of {count} cells"
            ),
            facts=json.dumps(facts(design, window, moved), sort_keys=True, allow_nan=False),
            groups=[(name, [one for one in moved if one.group == name]) for name in (LAW, SHEET, VIEW)],
            presets=[name for name, _ in PRESETS],
            not_shown=not_shown(design, window),
            fine=FINE,
            digest=digest,
            script=Markup(script),
            shader=Markup((HERE / "thin_sheet.glsl").read_text(encoding="utf-8")),
        )
    )


FINE = 12
"""Rays a pixel of a still picture, as in explorer.js."""
