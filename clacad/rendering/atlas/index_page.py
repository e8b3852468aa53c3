"""The atlas's index page: pictures, movies and measured numbers; it loads only the pictures in its folder."""

from __future__ import annotations

import html
from collections.abc import Mapping, Sequence

from clacad.rendering.atlas.finding import AtlasFinding
from clacad.rendering.atlas.paper_figures import Figure

POLICY = "default-src 'none'; img-src 'self'; style-src 'unsafe-inline'; base-uri 'none'; form-action 'none'"
"""Content security policy: no script, no frame, no font, nothing from other sites."""

NOTE = (
    "Figures F and W are drawn left-handed (x to the right), as the paper's renderer draws: the part made from a design shows "
    "the view flipped left-right. Figures V are drawn as the part shows it. Lengths are floor tiles in F, millimetres elsewhere. "
    "Exact refraction at every lens face, ghosts included."
)

STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; max-width: 76em; margin: 2em auto; padding: 0 1em; color: #222 }
figure { display: inline-block; margin: 0 1em 1em 0; vertical-align: top } img { max-width: 100%; border: 1px solid #ccc }
figcaption { font-size: 90%; color: #555 } table { border-collapse: collapse; margin: 0 0 2em }
td, th { padding: .15em .8em; text-align: right; border-bottom: 1px solid #ddd } td:first-child, th:first-child { text-align: left }
.fail { color: #b00; font-weight: bold }
@media (prefers-color-scheme: dark) { body { background: #181a1c; color: #ddd } td, th { border-color: #444 } }
"""


def page_of(
    figures: Sequence[Figure], findings: Mapping[str, tuple[AtlasFinding, ...]], movies: Sequence[tuple[str, str]],
    names: Sequence[str],
) -> str:  # fmt: skip
    """The page of some figures.

    Parameters
    ----------
    figures : sequence of Figure
    findings : mapping from row to findings
    movies : sequence of (scene file stem, title)
    names : sequence of str
        Files in the folder of the page.
    """
    parts = [f"<p>{html.escape(NOTE)}</p>"]
    if "fig1a.svg" in names:
        parts.append(
            "<h2>F1 &ndash; Fig. 1: geometry</h2>"
            + _img("fig1a.svg", "one telescopelet, to scale, rays traced")
        )
        parts.append(_img("fig1b.png", "both arrays, drawn as tinted solids (no refraction)"))
        if "F1" in findings:
            parts.append(_table(findings["F1"]))
    for figure in figures:
        parts.append(
            f"<h2>{html.escape(figure.row)} &ndash; {html.escape(figure.title)}</h2><p>{html.escape(figure.says)}</p>"
        )
        parts += [_img(f"{stem}.png", label) for stem, label in figure.scenes]
        parts += [_img(f"{stem}.png", label) for stem, label, _ in figure.drawn]
        parts += [_img(f"{stem}.webp", title) for stem, title in movies if figure.owns(title)]
        if figure.row in findings:
            parts.append(_table(findings[figure.row]))
    return (
        f'<!doctype html>\n<html lang="en"><head><meta charset="utf-8">\n<meta http-equiv="Content-Security-Policy" '
        f'content="{POLICY}">\n<meta name="viewport" content="width=device-width"><title>Views through the sheet</title>'
        f"<style>{STYLE}</style></head>\n<body><h1>Views through generalized confocal lenslet arrays</h1>\n"
        + "\n".join(parts)
        + "\n</body></html>\n"
    )


def _img(name: str, label: str) -> str:
    text = html.escape(label)
    return f'<figure><img src="{html.escape(name)}" alt="{text}"><figcaption>{text}</figcaption></figure>'


def _table(findings: Sequence[AtlasFinding]) -> str:
    rows = "".join(
        f"<tr><td>{html.escape(one.what)}</td><td>{one.measured:.4g}</td><td>{one.expected:.4g}</td>"
        f"<td>{one.tolerance:.2g}</td><td{'' if one.passed else ' class=fail'}>{'pass' if one.passed else 'FAIL'}</td></tr>"
        for one in findings
    )
    head = "<tr><th>measured in the picture</th><th>measured</th><th>formula</th><th>tolerance</th><th></th></tr>"
    return f"<table>{head}{rows}</table>"
