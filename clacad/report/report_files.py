"""Write report.json, report.html, run.json and, on request, report.pdf: each whole or not at all.

Fill the page: every text escaped, nothing loaded from anywhere, one script that the policy names by its hash.
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from clacad.base.interactive import shown_progress
from clacad.base.types import Progress
from clacad.base.untrusted_files import read_regular
from clacad.report import content as contents
from clacad.report import figures, plots
from clacad.report.content import Content, assembly, data_uri, lens_detail, plan, telescopelet
from clacad.report.plots import varying
from clacad.report.rows import number
from clacad.report.self_contained import HERE, environment, one_script
from clacad.storage.atomic import RUN_FACTS, write_set

if TYPE_CHECKING:
    from clacad.verification import Report


MARK = "<!-- clacad report -->"
"""In every page, so that a later run may replace its own report and nothing else."""

RUN_MARK = "run facts of a clacad report"
PDF_MARK = b"%PDF"

LARGEST = 64 << 20
"""Bytes beyond which no file is a report of ours."""


def write_report(
    report: Report | Content,
    folder: str | os.PathLike[str],
    overwrite: bool = False,
    *,
    progress: Progress | None = None,
    more: Sequence[Section] = (),
    pdf: bool = False,
    timings: bool = False,
) -> tuple[Path, ...]:
    """Write the page and its numbers.

    Parameters
    ----------
    report : Report, or Content made from one
        What is measured and pictured for the page alone is done here unless it was done before.
    folder : path
        Made if missing.
    overwrite : bool
        Replace files of these names that are no reports, too.
    progress : callable or None
        Called with a stage's name and the part done, 0 … 1.
    more : sequence of Section
        Further sections of the page, after its own.
    pdf : bool
        Write report.pdf as well.
    timings : bool
        Show seconds of this run in page and numbers, too; a Content has its own setting.

    Returns
    -------
    (report.html, report.json[, report.pdf]) : paths

    Raises
    ------
    CannotWrite, ExportRefused
    PdfMissing
        The extra package that sets the PDF is not installed.
    """
    return _write_all(
        report, Path(folder), overwrite, shown_progress(progress), more, pdf=pdf, timings=timings
    )


def _write_all(
    report: Report | Content,
    folder: Path,
    overwrite: bool,
    tell: Progress,
    more: Sequence[Section],
    *,
    pdf: bool,
    timings: bool,
) -> tuple[Path, ...]:
    """Gather what is shown, write page, numbers, PDF and run facts; paths of all but the last."""
    if pdf:
        from clacad.report.pdf import pdf_bytes, typesetter

        typesetter()  # reported before the work, not after it
    began = time.monotonic()
    made = report if isinstance(report, contents.Content) else contents.content(report, tell, timings)
    html, numbers = folder / "report.html", folder / "report.json"
    written = [html, numbers]
    files: dict[str, str | bytes] = {
        numbers.name: _json(contents.numbers(made)),
        html.name: page(made, MARK, more, tell),
    }
    if pdf:
        tell("setting the PDF", 0.0)
        written.append(folder / "report.pdf")
        files["report.pdf"] = pdf_bytes(made)
    if not (folder / RUN_FACTS).exists() or is_report(
        folder / RUN_FACTS
    ):  # run facts of an export there are left alone
        facts = {"what": RUN_MARK, "seconds": round(time.monotonic() - began, 3)}
        files[RUN_FACTS] = _json(facts | {"accuracy": made.evidence.ladder.measured()})
    write_set(folder, files, overwrite=overwrite, replace=is_report)
    return tuple(written)


def _json(numbers: dict[str, Any]) -> str:
    return json.dumps(numbers, indent=1, sort_keys=True, ensure_ascii=False, allow_nan=False) + "\n"


def is_report(path: Path) -> bool:
    """Whether a file is one that was written here."""
    if path.suffix == ".pdf":
        try:
            data = read_regular(path, LARGEST)
        except OSError:
            return False
        return data.startswith(PDF_MARK) and b"clacad report" in data
    try:
        text = read_regular(path, LARGEST).decode()
    except (OSError, UnicodeDecodeError):
        return False
    if path.name == RUN_FACTS:
        return RUN_MARK in text
    if path.suffix == ".html":
        return MARK in text[:4096]
    return text.startswith("{\n") and all(f'"{key}"' in text for key in ("checks", "verdict", "sha256"))


__all__ = ["SECTIONS", "Section", "number", "page", "sections"]


@dataclass(frozen=True, slots=True)
class Section:
    """One section of the page.

    anchor : Its address within the page.
    body : HTML that needs no escaping; text of a design must have been escaped by the caller.
    """

    anchor: str
    title: str
    body: str


Drawings = Callable[[Content], dict[str, str]]


def _fabrication(content: Content) -> dict[str, str]:
    report = content.report
    return {
        "plan": plan(content.sheet),
        "assembly": assembly(content.sheet),
        "pair": telescopelet(report),
        "lens1": lens_detail(report, 0),
        "lens2": lens_detail(report, 1),
        "field": "".join(lens_detail(report, k) for k in range(2, len(report.facts.lenses))),
    }


def _parts(content: Content) -> dict[str, str]:
    from markupsafe import escape

    from clacad.report.pictures import packed, picture

    facts, triangles = packed(content.parts)
    return {"facts": str(escape(facts)), "triangles": triangles, "picture": data_uri(picture(content.parts))}


def _asked(content: Content) -> dict[str, str]:
    report = content.report
    return {"convergence": figures.convergence(report), "caption": figures.convergence_caption(report)}


def _look(content: Content) -> dict[str, str]:
    return {"without": data_uri(content.look.without), "through": data_uri(content.look.through)}


def _light(content: Content) -> dict[str, str]:
    report = content.report
    return {
        "transfer": figures.transfer(report),
        "transmission": figures.transmission(report),
        "ghosts": plots.ghosts(content.evidence),
        "residual": figures.residual_map(report),
        "spots": figures.spots(report),
        "foci": plots.foci(report, content.evidence),
        "viewed": plots.viewed(report, content.whole or report.window),
        "varying": varying(report, content.whole or report.window),
    }


def _errors(content: Content) -> dict[str, str]:
    report = content.report
    found = {"budget": figures.budget(report)}
    for k, one in enumerate(content.evidence.attributions):
        found[f"parts{k}"] = plots.parts_of_error(one, report.design.check.law_rms)
    return found


def _accuracy(content: Content) -> dict[str, str]:
    return {"accuracy": plots.accuracy(content.report, content.evidence, content.timings)}


def _effects(content: Content) -> dict[str, str]:
    return {"waves": plots.waves(content.evidence)}


def _nothing(_content: Content) -> dict[str, str]:
    return {}


SECTIONS: tuple[tuple[str, str, Drawings], ...] = (
    ("fabrication", "Fabrication", _fabrication),
    ("parts", "The part in three dimensions", _parts),
    ("checks", "Checks", _nothing),
    ("asked", "Specified and built", _asked),
    ("look", "The view through it", _look),
    ("light", "What light does", _light),
    ("errors", "Where errors come from", _errors),
    ("accuracy", "Accuracy against time", _accuracy),
    ("effects", "Effects", _effects),
)
"""Anchor (and name of the template under sections/), title, and what draws the figures of each section, in
order.

Sections of other origin are handed to `page` as `more` and come after these.
"""


def sections(content: Content, progress: Progress | None = None) -> list[Section]:
    """Make the sections of the page, in the order of `SECTIONS`."""
    from markupsafe import Markup

    templates = environment()
    found = []
    for k, (anchor, title, draw) in enumerate(SECTIONS):
        if progress is not None:
            progress("drawing the report", k / len(SECTIONS))
        drawn = {name: Markup(text) for name, text in draw(content).items()}  # our own drawings
        template = templates.get_template(f"sections/{anchor}.html.j2")
        found.append(Section(anchor, title, template.render(_common(content), figure=drawn)))
    return found


def page(content: Content, mark: str, more: Sequence[Section] = (), progress: Progress | None = None) -> str:
    """The whole report as one HTML text that needs no network.

    mark : Comment by which the page is known again.
    more : Appended after the page's own.
    """
    from markupsafe import Markup

    script, digest = one_script(HERE / "viewer.js")
    shown = [*sections(content, progress), *more]
    return (
        environment()
        .get_template("page.html.j2")
        .render(
            _common(content),
            mark=Markup(mark),
            script=Markup(script),
            digest=digest,
            sections=[(s.anchor, s.title, Markup(s.body)) for s in shown],
        )
    )


def _common(content: Content) -> dict[str, Any]:
    report = content.report
    return {
        "viewer_picture": None if content.of_viewer is None else data_uri(content.of_viewer),
        "content": content,
        "report": report,
        "design": report.design,
        "verdict": report.verdict(),
        "counts": report.counts(),
    }
