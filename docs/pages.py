"""Sphinx extension: writes the pages that follow from the program before the documentation is read.

Reference pages come from the registries (keys, commands, formats, checks, effects, materials, processes, words). Tutorials are
run and their output and pictures are kept. Figures of the three pages on accuracy, stability and effects are computed.
Pages that are up to date with the sources of the program are not made again.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import os
import re
import resource
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from html.parser import HTMLParser
from multiprocessing import get_context
from pathlib import Path
from typing import Any
from urllib.parse import unquote

from figures import FIGURES
from sphinx.util import logging

logger = logging.getLogger(__name__)

ROOT = Path(__file__).resolve().parents[1]
HERE = ROOT / "docs"
GENERATED = "_made"
"""Folder, inside the sources, of pictures and of the stamps of what was made."""


def cell(text: object) -> str:
    """Text as one cell of a table."""
    return re.sub(r"([|<>*_`\[\]$\\])", r"\\\1", " ".join(str(text).split()))


def prose(text: object) -> str:
    """Text of the program as Markdown: what stands between backticks is code, everything else is literal."""
    parts = " ".join(str(text).split()).split("`")
    if len(parts) % 2 == 0:
        return cell(text)
    return "".join(f"`{part}`" if k % 2 else cell(part) for k, part in enumerate(parts))


def code(text: object) -> str:
    """Text as code in a cell of a table."""
    return f"`{text}`" if "|" not in str(text) else f"<code>{cell(text)}</code>"


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table of cells that are Markdown already."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(f"| {' | '.join(row)} |" for row in lines) + "\n"


def page(title: str, first: str, *parts: str) -> str:
    """A page: title, first paragraph, parts."""
    return "\n\n".join([f"# {title}", first, *parts]).rstrip() + "\n"


# -- reference -----------------------------------------------------------------------------------------------


def _keys(sections: Mapping[str, Mapping[str, Any]], root: Mapping[str, Any]) -> Iterator[str]:
    """Sections of a file as headings with tables of their keys."""
    from clacad.base.units import LENGTHS, Unit
    from clacad.config.compound_kinds import REQUIRED

    unit = Unit("the file's unit", LENGTHS["m"])

    def row(name: str, key: Any) -> list[str]:
        return [
            code(name),
            prose(key.about),
            cell(key.kind.allowed(unit)),
            "required" if key.default is REQUIRED else "",
        ]

    head = ["key", "meaning", "allowed", ""]
    yield "## Top of the file\n\n" + table(
        head, (row(*item) for item in root.items() if hasattr(item[1], "kind"))
    )
    for section, keys in sections.items():
        yield f"## [{section}]\n\n" + table(head, (row(*item) for item in keys.items()))


def design_file() -> str:
    """Keys of design files."""
    from clacad.design.sections import ROOT as TOP
    from clacad.design.sections import SECTIONS
    from clacad.design.starter_designs import figure_of, templates

    first = (
        'A design file is TOML or JSON. Lengths are in `unit` unless a unit is written (`"250 um"`), angles in degrees '
        '(`"1 mrad"`). Every mistake is reported at once, with its line, the allowed range and the nearest key. '
        "`clacad schema` prints the JSON Schema for editors; `clacad explain KEY` explains one key."
    )
    known = {name: about for name, about in templates().items() if not figure_of(name)}
    starters = table(["starter", "content"], ([code(name), prose(about)] for name, about in known.items()))
    start = (
        "## Starters\n\n`clacad new NAME --template STARTER` writes a design file to start from.\n\n"
        + starters
    )
    return page("Design file", first, *_keys(SECTIONS, TOP), start)


def scene_file() -> str:
    """Keys of scene files."""
    from clacad.scene.sections import ROOT as TOP
    from clacad.scene.sections import SECTIONS

    first = "A scene file names sheets, camera, light, background and objects of a picture or movie. `clacad render` reads it."
    return page("Scene file", first, *_keys(SECTIONS, TOP))


def commands() -> str:
    """Help of every command."""
    from clacad.cli.app import command_help
    from clacad.cli.command import commands as known

    parts = [
        f"## {one.word}\n\n```text\n{command_help(one).strip()}\n```"
        for one in sorted(known(), key=lambda c: c.word)
    ]
    first = "A result fits 24 lines of 100 columns; `--all` prints all of it, `--json` prints it as JSON, `-q` prints errors only. Exit statuses: {doc}`exit-status`."
    return page("Commands", first, *parts)


def formats() -> str:
    """Formats that are written."""
    from clacad.exporting.formats.registry import formats as known

    rows = [
        [
            code(one.word),
            prose(one.about),
            "one cell" if one.of_cell else "all",
            prose("; ".join(way.note for way in one.stored)),
        ]
        for one in known()
    ]
    roles = table(
        ["role", "files", "judged by"],
        [
            ["optical master", "STEP, BREP, maps, points, tables, masks; meshes whose light is within the limits of the design",
             "light against the law, and shape: beyond a limit is a failure"],
            ["shape preview", "meshes too coarse for light; files declared as previews", "shape; light is reported as a warning"],
            ["scan", "measured surfaces of made parts", "light and shape; never called fit for making"],
            ["other", "baffle, frame, pins, coupon, POV-Ray, prescriptions, drawings", "hash and shape"],
        ],
    )  # fmt: skip
    first = "`clacad export DESIGN --format A,B` writes these files. Each file has a role in the manifest."
    return page(
        "Formats and roles", first, table(["format", "content", "sheets", "accuracy"], rows), "## Roles\n\n" + roles,
        "`--role preview` or `--role stl=preview` declares a preview; the default role follows from the forecast of the light.",
    )  # fmt: skip


def _entry(one: Any) -> str:
    """An explanation as Markdown."""
    parts = [prose(one.means)]
    parts += [
        f"{name}: {prose(text)}"
        for name, text in (("Why", one.why), ("Formula", one.formula), ("What to do", one.do))
        if text
    ]
    return "\n\n".join(parts)


def checks() -> str:
    """Checks and codes."""
    from clacad.explain.look_up import entries

    known = entries()
    coded = [one for one in known.values() if one.code]
    parts = [f"## {one.code} {cell(one.name or one.title)}\n\n{_entry(one)}" for one in coded]
    first = "Every message and every check has a code. `clacad explain CL337` or `clacad explain wall` prints the entry."
    return page("Checks and codes", first, *parts)


def _named(title: str, first: str, kind: str) -> str:
    from clacad.explain.look_up import entries

    chosen = [one for one in entries().values() if one.kind == kind]
    parts = [f"## {cell(one.title.removeprefix(f'{kind} '))}\n\n{_entry(one)}" for one in chosen]
    return page(title, first, *parts)


def effects() -> str:
    """Effects of pictures."""
    return _named(
        "Effects",
        "A scene is rendered with the effects that it calls for. `clacad effects SCENE` prints the plan.",
        "effect",
    )


def materials() -> str:
    """Materials and their numbers."""
    return _named(
        "Materials",
        "`pair.material` takes one of these names, or a page of the refractiveindex.info database (`ri:…`).",
        "material",
    )


def processes() -> str:
    """Processes and their limits."""
    return _named(
        "Processes", "`check.process` names the process whose limits the part must keep.", "process"
    )


def glossary() -> str:
    """Words of the field and of the program."""
    from clacad.explain.glossary import WORDS

    rows = [
        [cell(word), prose(means), prose(key)]
        for word, (means, key) in sorted(WORDS.items(), key=lambda item: item[0].lower())
    ]
    return page(
        "Glossary", "`clacad explain WORD` prints one entry.", table(["word", "meaning", "see"], rows)
    )


def python() -> str:
    """Public names of the package."""
    import clacad

    names = "\n".join(f"   {name}" for name in clacad.__all__)
    body = f"```{{eval-rst}}\n.. currentmodule:: clacad\n\n.. autosummary::\n   :toctree: api\n   :nosignatures:\n\n{names}\n```"
    first = "`import clacad` loads neither the CAD kernel nor a compiler; both are loaded by the first call that needs them."
    return page("Python", first, body)


REFERENCE: Mapping[str, Callable[[], str]] = {
    "design-file": design_file, "scene-file": scene_file, "commands": commands, "formats": formats, "checks": checks,
    "effects": effects, "materials": materials, "processes": processes, "glossary": glossary, "python": python,
}  # fmt: skip


# -- tutorials -----------------------------------------------------------------------------------------------


class Notebook:
    """Runs the cells of a tutorial and turns them, their output and their pictures into Markdown."""

    def __init__(self, stem: str, folder: Path) -> None:
        self._stem, self._folder, self._count = stem, folder, 0
        self._names: dict[str, Any] = {"__name__": "__main__"}

    def markdown(self, text: str) -> str:
        """The whole page."""
        parts = []
        for kind, body in self._cells(text):
            if kind == "markdown":
                parts.append(re.sub(r"^# ?", "", body, flags=re.M))
            elif body:
                parts += [f"```python\n{body}\n```", *self._run(body)]
        return "\n\n".join(parts) + "\n"

    @staticmethod
    def _cells(text: str) -> Iterator[tuple[str, str]]:
        for part in re.split(r"^# %%", re.sub(r"  # (fmt|noqa|type).*", "", text), flags=re.M)[1:]:
            head, _, body = part.partition("\n")
            yield ("markdown" if "markdown" in head else "code"), body.strip()

    def _run(self, body: str) -> Iterator[str]:
        """Run a cell; its last expression is shown as a notebook would."""
        import ast

        tree = ast.parse(body)
        last = tree.body.pop() if tree.body and isinstance(tree.body[-1], ast.Expr) else None
        printed = io.StringIO()
        value = None
        with contextlib.redirect_stdout(printed):
            exec(compile(tree, self._stem, "exec"), self._names)
            if last is not None:
                value = eval(compile(ast.Expression(last.value), self._stem, "eval"), self._names)
        if printed.getvalue().strip():
            yield f"```text\n{printed.getvalue().rstrip()}\n```"
        if value is not None:
            yield from self._shown(value)

    def _shown(self, value: Any) -> Iterator[str]:
        svg = getattr(value, "_repr_svg_", lambda: None)()
        html = getattr(value, "_repr_html_", lambda: None)()
        if svg is not None or hasattr(value, "savefig"):
            yield self._picture(value, svg)
        elif html is not None and "<svg" in html:
            yield f"```{{raw}} html\n{html}\n```"
        else:
            yield f"```text\n{value!r}\n```"

    def _picture(self, value: Any, svg: str | None) -> str:
        self._count += 1
        name = f"{self._stem}-{self._count}.svg"
        if svg is None:
            value.savefig(self._folder / name)
        else:
            (self._folder / name).write_text(svg, encoding="utf-8")
        return f"![output of the cell](../{GENERATED}/{name})"


def tutorials() -> Iterator[tuple[Path, Callable[[], str]]]:
    """Pages of the tutorials."""
    for file in sorted((ROOT / "designs" / "tutorials").glob("*.py")):
        yield HERE / "tutorials" / f"{file.stem}.md", lambda file=file: _tutorial(file)


def _tutorial(file: Path) -> str:
    here = Path.cwd()
    with tempfile.TemporaryDirectory() as scratch:
        os.chdir(scratch)
        try:
            return Notebook(file.stem, HERE / GENERATED).markdown(file.read_text(encoding="utf-8"))
        finally:
            os.chdir(here)


# -- making --------------------------------------------------------------------------------------------------

SECONDS = 60.0
"""Processor seconds that a tutorial may take."""


def _stamp() -> str:
    """Hash of everything that pages follow from."""
    total = hashlib.sha256()
    for folder in ("clacad", "designs", "docs"):
        for path in sorted((ROOT / folder).rglob("*.*")):
            if path.suffix in {".py", ".toml"}:
                total.update(path.read_bytes())
    return total.hexdigest()


def _seconds() -> float:
    """Processor seconds of this process and of those that it started and that ended."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(one.ru_utime + one.ru_stime for one in used)


def make_one(job: str) -> tuple[str, float]:
    """Run one tutorial or make one figure, and return its name and processor seconds."""
    before = _seconds()
    if job in FIGURES:
        FIGURES[job](HERE / GENERATED)
    else:
        page, text = next((page, text) for page, text in tutorials() if page.stem == job)
        page.write_text(text(), encoding="utf-8")
    seconds = _seconds() - before
    if job not in FIGURES and seconds > SECONDS:
        raise RuntimeError(
            f"tutorial {job}: {seconds:.0f} s of processor time, at most {SECONDS:.0f} s are allowed"
        )
    return job, seconds


def make(app: Any = None, config: Any = None) -> None:
    """Write all generated pages; tutorials and figures are made by two processes."""
    folder = HERE / GENERATED
    for one in (folder, HERE / "tutorials"):
        one.mkdir(exist_ok=True)
    pages = [page for page, _ in tutorials()]
    stamp, now = folder / "stamp", _stamp()
    if stamp.exists() and stamp.read_text() == now and all(page.exists() for page in pages):
        return
    stamp.unlink(missing_ok=True)
    for name, text in REFERENCE.items():
        (HERE / "reference" / f"{name}.md").write_text(text(), encoding="utf-8")
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as pool:
        for job, seconds in pool.map(make_one, [*FIGURES, *(page.stem for page in pages)]):
            logger.info("%s: made in %.1f s of processor time", job, seconds)
    stamp.write_text(now)


class _Page(HTMLParser):
    """Identifiers and local links of a built page."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.names: set[str] = set()
        self.links: set[str] = set()
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        for key, value in attrs:
            if key in {"id", "name"} and value:
                self.names.add(value)
            elif key in {"href", "src"} and value and not re.match(r"[a-z]+:|//", value):
                self.links.add(value)


def keep_options(app: Any, name: str, template: str, context: dict[str, Any], tree: Any) -> None:
    """Mark options in commands, which a narrow page does not break at their hyphens."""
    if "body" in context:
        context["body"] = re.sub(
            r"(?<=</span>)(--?\w[\w-]*)(?=[<\s])", r'<span class="option">\1</span>', context["body"]
        )


def dead_links(built: Path) -> list[str]:
    """Local links of built pages whose file or anchor does not exist."""
    pages = {path.resolve(): _Page(path.read_text(encoding="utf-8")) for path in built.rglob("*.html")}
    dead = []
    for path, one in pages.items():
        for link in sorted(one.links):
            target, _, anchor = unquote(link).partition("#")
            there = (path.parent / target.partition("?")[0]).resolve() if target else path
            if not there.exists() or (anchor and there in pages and anchor not in pages[there].names):
                dead.append(f"{path.relative_to(built.resolve())}: {link}")
    return dead


def check(app: Any, error: Exception | None) -> None:
    """Warn of every dead link of the built pages."""
    if error is None and app.builder.name == "html":
        for one in dead_links(Path(app.outdir)):
            logger.warning("dead link: %s", one)


def setup(app: Any) -> dict[str, Any]:
    """Register with Sphinx."""
    app.connect("config-inited", make)  # before autosummary looks for pages
    app.connect("html-page-context", keep_options)
    app.connect("build-finished", check)
    return {"parallel_read_safe": True}
