"""The design file that the page hands out: the design's own text, with places for what the sliders move."""

from __future__ import annotations

from typing import Any

from clacad.design import Design

MOVED = {
    ("law", "eta"): "eta", ("law", "delta"): "delta", ("law", "euler"): "euler", ("pair", "separation"): "separation",
    ("lattice", "pitch"): "pitch", ("lattice", "count"): "count", ("check", "viewer"): "viewer", ("check", "object"): "object",
}  # fmt: skip
"""Section and key of the file, and what moves it."""

METRES = ("viewer", "object")
"""Written with their unit, since they must have one."""


def lines(design: Design) -> list[str | dict[str, Any]]:
    """Lines of the canonical text, those that sliders move as dictionaries.

    A moved line has `key` (what moves it), `start` (the line as long as nothing is moved; None: there is none), `as` (what
    precedes its value), `single` (one number, not a list) and `metres` (the value is a text in metres).
    With no slider moved, the result is the canonical text. A slab given by its thickness gets the separation it is moved to instead.
    """
    found: list[str | dict[str, Any]] = []
    section, missing = "", list(METRES)
    thick = design.pair.form == "slab" and design.pair.separation is None
    for line in [*design.canonical_toml().splitlines(), ""]:
        if not line and section == "check":
            found += [_moved("check", key, key, None, design) for key in missing]
            section = ""
        if line.startswith("["):
            section = line.strip("[]")
        key = line.partition(" = ")[0]
        name = "separation" if thick and (section, key) == ("pair", "thickness") else key
        what = MOVED.get((section, name))
        if what in missing and what is not None:
            missing.remove(what)
        found.append(line if what is None else _moved(section, name, what, line, design))
    return found[:-1]


def _moved(section: str, key: str, what: str, start: str | None, design: Design) -> dict[str, Any]:
    assert (section, key) in MOVED
    single = what == "pitch" and design.lattice.kind != "rectangular"
    return {"key": what, "as": f"{key} = ", "start": start, "single": single, "metres": what in METRES}
