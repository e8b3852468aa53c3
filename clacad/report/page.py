"""Fill the page: every text escaped, nothing loaded from anywhere, one script that the policy names by its hash."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from clacad.report import drawing, figures, plots
from clacad.report.content import Content, data_uri
from clacad.report.light_rows import number
from clacad.report.self_contained import HERE, environment, one_script
from clacad.report.varying_plot import varying

if TYPE_CHECKING:
    from clacad.base.types import Progress

__all__ = ["SECTIONS", "Section", "number", "page", "sections"]


@dataclass(frozen=True, slots=True)
class Section:
    """One section of the page.

    anchor : str
        Its address within the page.
    title : str
    body : str
        HTML that needs no escaping; text of a design must have been escaped by the caller.
    """

    anchor: str
    title: str
    body: str


Drawings = Callable[[Content], dict[str, str]]


def _fabrication(content: Content) -> dict[str, str]:
    report = content.report
    return {
        "plan": drawing.plan(content.sheet), "assembly": drawing.assembly(content.sheet), "pair": drawing.telescopelet(report),
        "lens1": drawing.lens_detail(report, 0), "lens2": drawing.lens_detail(report, 1),
        "field": "".join(drawing.lens_detail(report, k) for k in range(2, len(report.facts.lenses))),
    }  # fmt: skip


def _parts(content: Content) -> dict[str, str]:
    from markupsafe import escape

    from clacad.report.parts_in_3d import packed, picture

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
        "transfer": figures.transfer(report), "transmission": figures.transmission(report),
        "ghosts": plots.ghosts(content.evidence), "residual": figures.residual_map(report),
        "spots": figures.spots(report), "foci": plots.foci(report, content.evidence),
        "viewed": plots.viewed(report, content.whole or report.window), "varying": varying(report, content.whole or report.window),
    }  # fmt: skip


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
    ("asked", "Asked and built", _asked),
    ("look", "The view through it", _look),
    ("light", "What light does", _light),
    ("errors", "Where errors come from", _errors),
    ("accuracy", "Accuracy against time", _accuracy),
    ("effects", "Effects", _effects),
)
"""Anchor (and name of the template under sections/), title, and what draws the figures of each section, in order.

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

    Parameters
    ----------
    content : Content
    mark : str
        Comment by which the page is known again.
    more : sequence of Section
        Appended after the page's own.
    progress : callable or None
    """
    from markupsafe import Markup

    script, digest = one_script(HERE / "viewer.js")
    shown = [*sections(content, progress), *more]
    return environment().get_template("page.html.j2").render(
        _common(content), mark=Markup(mark), script=Markup(script), digest=digest,
        sections=[(s.anchor, s.title, Markup(s.body)) for s in shown],
    )  # fmt: skip


def _common(content: Content) -> dict[str, Any]:
    report = content.report
    return {
        "viewer_picture": None if content.of_viewer is None else data_uri(content.of_viewer),
        "content": content, "report": report, "design": report.design, "verdict": report.verdict(), "counts": report.counts(),
    }  # fmt: skip
