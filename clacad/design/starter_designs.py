"""Starter design files (`clacad new`): a commented template of each form, and the designs of the paper.

Where both have one name, such as "slab", the commented template is used. The source of the paper's designs
and scenes is the folder `designs` of the repository. An installed package contains them as its own folder of
that name, created when the wheel is built. In a checkout they lie next to the package.
"""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

from clacad.base.units import LENGTHS, Unit
from clacad.config.mistakes import design_error
from clacad.config.value_kinds import Refusal, Word, shown
from clacad.design.sections import ROOT

_FOLDER = Path(__file__).parent / "templates"
_PACKAGE = Path(__file__).resolve().parents[1]
MOST_NAMED = 5
"""Greatest number of templates that a message suggests."""

_NAME = re.compile(r'^name = ".*"$', re.MULTILINE)


def templates() -> dict[str, str]:
    """Return the kinds of template with one line about each, in alphabetical order."""
    return {kind: _about(path.read_text(encoding="utf-8")) for kind, path in sorted(_files().items())}


def template(name: str, kind: str = "slab") -> str:
    """Return the text of a new design file.

    Parameters
    ----------
    name : str
        Name of the design, 1 to 80 letters, digits, spaces and - _ . , + ( ) =.
    kind : str
        A key of `templates()`: "galilean", "hexagonal", "paper", "plano", "slab", "tilted", "window", or the
        name of
        a shipped design, such as "fig3".

    Returns
    -------
    str
        TOML with comments; it loads without changes.

    Raises
    ------
    DesignError
        The name is not allowed, or the kind is unknown.
    """
    nothing, files = Unit("m", LENGTHS["m"]), _files()
    for key, reader, value in (
        ("name", ROOT["name"].kind, name),
        ("template", Word(tuple(sorted(files))), kind),
    ):
        try:
            reader.read(value, nothing)
        except Refusal as refusal:
            message = f"{key} = {shown(value)} {refusal.complaint}"
            hint = (
                _nearest_of(value) if key == "template" and isinstance(value, str) else ""
            ) or refusal.hint
            raise design_error(refusal.code, message, key, allowed=refusal.allowed, hint=hint) from None
    text = files[kind].read_text(encoding="utf-8")
    return _NAME.sub(lambda _: f'name = "{name}"', text, count=1)


def figure_of(name: str) -> str:
    """Return the paper's figure of a template: "Fig. 5", "sheet" for the paper's others, else ""."""
    found = re.match(r"fig(\d+[a-z]?)", name)
    return f"Fig. {found[1]}" if found else "sheet" if name.startswith("paper-") else ""


def differences(name: str) -> str:
    """Values of a template that differ from paper-base, "law.eta = [-0.5, -0.5]"; not name and notes."""
    own, base = (tomllib.loads(_files()[kind].read_text(encoding="utf-8")) for kind in (name, "paper-base"))
    found = [
        f"{section}.{key} = {shown(value)}"
        for section, keys in own.items()
        if isinstance(keys, dict)
        for key, value in keys.items()
        if value != base.get(section, {}).get(key)
    ]
    return ", ".join(found) or "as paper-base"


def _nearest_of(word: str) -> str:
    """Return a question with the templates that share the longest prefix with a word; "" where none does."""
    names = sorted(_files())
    for length in range(len(word), 3, -1):
        found = [name for name in names if name.startswith(word[:length].lower())]
        if found:
            return f"did you mean {' or '.join(quoted for quoted in map(shown, found[:MOST_NAMED]))}?"
    return ""


def file_of(name: str) -> Path | None:
    """File of a template or shipped design; None for another name."""
    return _files().get(name)


def _files() -> dict[str, Path]:
    """Every template, by its name."""
    return {path.stem: path for folder in (shipped_designs(), _FOLDER) for path in folder.glob("*.toml")}


def _about(text: str) -> str:
    found = re.search(r"^# (.*)$", text, re.MULTILINE)
    return "" if found is None else found[1]


def shipped_designs() -> Path:
    """Folder of the shipped design files; their scenes lie in its subfolder `scenes`.

    Raises FileNotFoundError: The package was taken out of its repository without the designs.
    """
    for folder in (_PACKAGE / "designs", _PACKAGE.parent / "designs"):
        if (folder / "scenes").is_dir():
            return folder
    raise FileNotFoundError(
        f"{_PACKAGE / 'designs'}: the designs that come with clacad are missing; install it again"
    )
