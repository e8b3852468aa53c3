"""Report as PDF: the page's rows and drawings, set by Typst, an extra package that pip alone installs."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from clacad.report import figures, plots
from clacad.report.content import Content, assembly, lens_detail, plan, telescopelet
from clacad.storage.atomic import scratch_folder

Block = dict[str, Any]


class PdfMissing(RuntimeError):
    """The package that sets the PDF is not installed; exit status 2."""

    exit_status = 2


def typesetter() -> Any:
    """The module that sets the PDF. Raises PdfMissing."""
    try:
        import typst
    except ImportError as error:
        raise PdfMissing(
            "report.pdf needs the package typst: pip install 'clacad[pdf]'; report.html prints well, too"
        ) from error
    return typst


def pdf_bytes(content: Content) -> bytes:
    """Set the report; the same content gives the same bytes. Raises PdfMissing."""
    typst = typesetter()
    with scratch_folder() as place:
        made = _document(content, _Shelf(place))
        (place / "content.json").write_text(json.dumps(made), encoding="utf-8")
        (place / "main.typ").write_bytes((Path(__file__).parent / "pdf.typ").read_bytes())
        return bytes(typst.compile(str(place / "main.typ"), root=str(place), ignore_system_fonts=True))


class _Shelf:
    """Drawings and pictures as files next to the text."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def put(self, name: str, data: str | bytes) -> str:
        """Keep a drawing (text) or a picture (bytes) and give its file name."""
        raw = data.encode("utf-8") if isinstance(data, str) else data
        path = self.folder / f"{name}.{'svg' if isinstance(data, str) else 'png'}"
        path.write_bytes(_with_namespaces(raw) if isinstance(data, str) else raw)
        return path.name


def _with_namespaces(svg: bytes) -> bytes:
    head, rest = svg.split(b">", 1)
    for name, address in (
        (b"xmlns", b"http://www.w3.org/2000/svg"),
        (b"xmlns:xlink", b"http://www.w3.org/1999/xlink"),
    ):
        if name + b"=" not in head:
            head += b" " + name + b'="' + address + b'"'
    return head + b">" + rest


def _document(content: Content, shelf: _Shelf) -> dict[str, Any]:
    """All that the typesetter is given: head, verdict, tally of the checks, and blocks in their order."""
    report = content.report
    counts = report.counts()
    return {
        "title": report.design.name,
        "about": f"confocal lenslet array pair, {report.window.form}, {content.cells} cells; verification",
        "state": report.word,
        "verdict": {
            "state": {"passed": "pass", "shape": "warn"}.get(content.head[1], "fail"),
            "word": content.head[0],
            "sentence": report.verdict(),
            "failures": [f"{c['id']} {c['subject']}: {c['sentence']}" for c in content.checked.failures],
        },
        "tally": ", ".join(f"{n} {state}" for state, n in counts.items()),
        "blocks": [
            *_viewer(content, shelf),
            *_verdicts(content),
            *_fabrication(content, shelf),
            *_checks(content),
            *_asked(content),
            *_light(content, shelf),
            *_errors(content, shelf),
            *_rest(content, shelf),
        ],
    }


def _viewer(content: Content, shelf: _Shelf) -> list[Block]:
    """What the viewer gets of the whole sheet, with the picture of its view where there is one."""
    if not content.viewer:
        return []
    if content.of_viewer is None:
        return [{"kind": "text", "text": f"{content.viewer}."}]
    caption = f"{content.viewer}; its view of a chess knight, by ideal lenses."
    return [_figure(shelf, "viewer", content.of_viewer, caption, 30)]


def _verdicts(content: Content) -> list[Block]:
    """One line a file: role, verdict, light through it."""
    if not content.checked.verdicts:
        return []
    head = ["verdict", "file", "role", "rms / mrad", "limit"]
    rows = [
        [
            {"text": f["word"], "state": f["css"]},
            f"{f['name']}: {f['sentence']}",
            f["role"],
            f["rms"],
            f["limit"],
        ]
        for f in content.checked.verdicts
    ]
    return [{"kind": "table", "widths": [2, 6, 2, 0, 0], "head": head, "rows": rows, "numbers": [3, 4]}]


def _heading(text: str, level: int = 1) -> Block:
    return {"kind": "heading", "level": level, "text": text}


def _figure(shelf: _Shelf, name: str, data: str | bytes, caption: str, width: int = 88) -> Block:
    return {
        "kind": "figure",
        "file": shelf.put(name, data),
        "caption": caption,
        "alt": caption,
        "width": width,
    }


def _table(
    head: Sequence[str], rows: Sequence[Sequence[Any]], numbers: Sequence[int] = (), wide: int = -1
) -> Block:
    """A table; columns in `numbers` are set flush right, the one called `wide` takes the remaining room."""
    wide = wide % len(head)
    return {
        "kind": "table",
        "head": list(head),
        "rows": [list(r) for r in rows],
        "numbers": list(numbers),
        "widths": [1 if k == wide else 0 for k in range(len(head))],
    }


def _fabrication(content: Content, shelf: _Shelf) -> list[Block]:
    """Blocks for the workshop: table, files, how to hold the part, drawings."""
    report = content.report
    rows = [
        (about, line.name, line.text, line.unit) for about, lines in content.fabrication for line in lines
    ]
    blocks: list[Block] = [_heading("Fabrication"), _table(("", "", "", "unit"), rows, (2,), 1)]
    if content.checked.files:
        files = [(f["name"], f["bytes"], f["size"], f["sha256"]) for f in content.checked.files]
        blocks += [_heading("Files", 2), _table(("file", "bytes", "holds", "sha256"), files, (1, 2))]
    blocks += [
        _heading("Orientation", 2),
        {"kind": "list", "lines": content.orientation},
        _heading("Drawings", 2),
        _figure(shelf, "assembly", assembly(content.sheet), "Assembly, cut along x, to scale; millimetres."),
        _figure(shelf, "pair", telescopelet(report), "One telescopelet, cut along x; millimetres."),
    ]
    lenses = [
        _item(shelf, f"lens{k}", lens_detail(report, k), f"Lens {k + 1} over its cell.", f"lens {k + 1}")
        for k in (0, 1)
    ]
    from clacad.report.pictures import picture

    cells = f"{content.parts.cells} × {content.parts.cells} cells, from the side of lens 2."
    whole = _item(shelf, "plan", plan(content.sheet), "The sheet as light sees it.", "plan")
    solid = _item(shelf, "solid", picture(content.parts), cells, "the part")
    return [*blocks, {"kind": "pair", "items": lenses}, {"kind": "pair", "items": [whole, solid]}]


def _item(shelf: _Shelf, name: str, data: str | bytes, caption: str, alt: str) -> dict[str, Any]:
    """One of two pictures next to one another."""
    return {"file": shelf.put(name, data), "caption": caption, "alt": alt}


def _checks(content: Content) -> list[Block]:
    blocks = [_heading("Checks")]
    for title, rows in content.checked.groups:
        lines = [
            (
                {"state": c["state"], "text": c["word"]},
                f"{c['id']} {c['subject'] if c['subject'] != title else ''}".strip(),
                c["value"],
                c["limit"],
                c["unit"],
                (
                    f"{c['sentence']} [{c['where']}; {c['bundle'] + '; ' if c['bundle'] else ''}"
                    f"limit: {c['source']}]"
                ),
            )
            for c in rows
        ]
        blocks += [
            _heading(title, 2),
            _table(("", "check", "value", "limit", "unit", "result"), lines, (2, 3)),
        ]
    return blocks + (
        [{"kind": "text", "text": f"{content.checked.process}."}] if content.checked.process else []
    )


def _asked(content: Content) -> list[Block]:
    derived = [(about, *row) for about, rows in content.derived for row in rows]
    return [
        _heading("Specified and built"),
        _table(("", "specified", "built or measured"), content.asked),
        _table(("", "", "", "unit", "what it means"), derived, (2,)),
    ]


FOCI = ("meridian", "focus of lens 1 (mm)", "focus of lens 2 (mm)", "apart (mm)", "relative", "caustics (mm)")
"""Head of the table of foci."""


def _light(content: Content, shelf: _Shelf) -> list[Block]:
    """Blocks for the referee: views, transfer, transmission, maps, spots, foci."""
    report, evidence = content.report, content.evidence
    views: Mapping[str, tuple[bytes, str]] = {
        "without": (content.look.without, "Without the sheet."),
        "through": (content.look.through, f"Through it: {content.look.how}."),
    }
    pair = [{"file": shelf.put(k, data), "caption": text, "alt": text} for k, (data, text) in views.items()]
    blocks = [
        _heading("What light does"),
        {"kind": "pair", "items": pair},
        _figure(
            shelf, "transfer", figures.transfer(report), "Slope after the window against slope before it."
        ),
        _figure(
            shelf,
            "transmission",
            figures.transmission(report),
            "Share of light through corresponding lenslets.",
        ),
        _figure(shelf, "ghosts", plots.ghosts(evidence), "The same over both slopes, and the ghosts."),
        _figure(
            shelf,
            "viewed",
            plots.viewed(report, content.whole or report.window),
            f"Of the whole sheet: {content.light.viewed}.",
        ),
        _figure(shelf, "residual", figures.residual_map(report), "Angle to the law over aperture and field."),
        _figure(shelf, "spots", figures.spots(report), "Spots about the law's direction over the field.", 66),
    ]
    if content.light.foci:
        foci, words = plots.foci(report, evidence), "Both foci in both meridians, and the caustics."
        blocks += [_figure(shelf, "foci", foci, words), _table(FOCI, content.light.foci, (1, 2, 3, 4, 5))]
    return blocks


def _errors(content: Content, shelf: _Shelf) -> list[Block]:
    """Blocks of the separate errors, and the budget."""
    report = content.report
    blocks = [_heading("Where errors come from")]
    head = ("part", "rms (mrad)", "half below", "largest", "share", "what it is")
    for k, (one, found) in enumerate(
        zip(content.light.attributions, content.evidence.attributions, strict=True)
    ):
        drawn = plots.parts_of_error(found, report.design.check.law_rms)
        rows = [
            *one["parts"],
            ("whole", one["rms"], "", "", one["rms"], f"cell {one['cell']}, {one['used']} rays compared"),
        ]
        blocks += [
            _heading(one["about"], 2),
            _figure(shelf, f"parts{k}", drawn, "Five parts of the error."),
            _table(head, rows, (1, 2, 3, 4)),
        ]
    return [
        *blocks,
        _heading("Budget", 2),
        _table(("contribution", "mrad", "measured as"), content.light.budget, (1,)),
        *_daylight(content),
    ]


def _daylight(content: Content) -> list[Block]:
    """White light line by line, and temperature, where the design has either."""
    if not content.light.daylight:
        return []
    return [
        _heading("Daylight and temperature", 2),
        _table(content.light.daylight_head, content.light.daylight, (1, 2, 3, 4, 5)),
        {"kind": "text", "text": content.light.daylight_sentence},
    ]


def _waves(content: Content, shelf: _Shelf) -> list[Block]:
    """Light of one telescopelet as a wave, where an effect calls for it."""
    drawn = plots.waves(content.evidence)
    if not drawn:
        return []
    from clacad.waves.wave_report import HEAD

    return [
        _heading("Waves", 2),
        _figure(shelf, "waves", drawn, "Far field of one telescopelet as waves and as rays."),
        _table(HEAD, content.light.waves, (1, 2, 3, 4, 5, 6), 0),
        {"kind": "text", "text": content.light.waves_sentence},
    ]


def _rest(content: Content, shelf: _Shelf) -> list[Block]:
    """Blocks at the end: accuracy, effects, the design, how to make the report again."""
    report = content.report
    rungs = ("rung", "setting", "model error (mrad)", "law error (mrad)", "other fate (%)", "µs a ray")
    effects = ("effect", "in a picture", "mrad", "% of light", "time", "why")
    drawn = plots.accuracy(report, content.evidence, content.timings)
    blocks: list[Block] = [
        _heading("Accuracy against time"),
        _figure(
            shelf,
            "accuracy",
            drawn,
            f"What each rung leaves out, and what it costs. {content.evidence.ladder.conclusion}",
        ),
        _table(rungs, content.light.ladder, (2, 3, 4, 5), 1),
        _heading("Effects"),
        {"kind": "text", "text": content.light.effects_sentence},
        *(
            [_table(effects, [(n, s, a, r, c, w) for n, s, w, a, r, c in content.light.effects], (2, 3, 4))]
            if content.light.effects
            else []
        ),
        *_waves(content, shelf),
    ]
    if report.design.notes:
        blocks += [
            _heading("What the source text says that cannot hold"),
            {"kind": "list", "lines": list(report.design.notes)},
        ]
    again = f"Versions: {content.checked.versions}. Design sha256 {report.design.sha256}."
    return [
        *blocks,
        _heading("How to reproduce"),
        {"kind": "code", "text": content.command},
        {"kind": "text", "text": again},
    ]
