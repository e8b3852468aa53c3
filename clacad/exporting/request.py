"""What was asked of an export, and how quads and roles are asked for: one value for all files, or one a format."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from difflib import get_close_matches
from typing import Any, Literal

from clacad.exporting.format_names import FORMATS, MESHES
from clacad.exporting.roles import WORDS, Role, role_of
from clacad.storage.errors import BadRequest

EXTRAS = ("step_schema", "pcurves", "saddle_bevel", "gpu_instancing", "grey_levels")

Quads = int | Literal["auto"]
AskedQuads = Quads | Mapping[str, Quads] | None
"""Facets a cell side: of every mesh format, or one a format; None: see `export`."""

AskedRole = str | Mapping[str, str] | None
"""Role declared: of every file that has optics, or one a format."""

ROLES = ("master", "preview")
"""Words by which an export declares a role."""


@dataclass(frozen=True, slots=True)
class Request:
    """What was asked of an export; see `clacad.exporting.export_design.export`.

    Parameters
    ----------
    quads : mapping
        Mesh format → facet grid asked for, as `asked_quads` gives it; formats of which nothing was said are left out.
    role : mapping
        Format → role declared, as `asked_roles` gives it.
    """

    formats: tuple[str, ...]
    slope_error: float | Literal["auto"] = "auto"
    quads: Mapping[str, Quads] = field(default_factory=dict)
    step: Literal["auto", "fused", "instanced"] = "auto"
    cells: tuple[int, int] | None = None
    overwrite: bool = False
    force: bool = False
    step_schema: Literal["ap242", "ap214"] = "ap242"
    pcurves: bool = True
    saddle_bevel: float = 0.0
    gpu_instancing: bool = False
    grey_levels: int = 64
    role: Mapping[str, Role] = field(default_factory=dict)

    def to_dict(self) -> dict[str, Any]:
        """Options as the manifest keeps them; those that few ask for only where they were asked for."""
        plain = {
            "formats": list(self.formats), "slope_error": self.slope_error, "quads": dict(self.quads) or None,
            "step": self.step, "cells": None if self.cells is None else list(self.cells),
        }  # fmt: skip
        usual = {field.name: field.default for field in fields(self)}
        asked = {name: getattr(self, name) for name in EXTRAS}
        roles = {"role": {name: str(role) for name, role in self.role.items()}} if self.role else {}
        return plain | {name: value for name, value in asked.items() if value != usual[name]} | roles


def asked_quads(asked: AskedQuads, formats: Sequence[str]) -> dict[str, Quads]:
    """Facet grid asked for of each mesh format that is exported.

    Raises
    ------
    BadRequest
        A value that is no grid, a format that is unknown, has no facets or is not exported.
    """
    if asked is None:
        return {}
    if not isinstance(asked, Mapping):
        value = _grid(asked)
        return {name: value for name in dict.fromkeys(formats) if name in MESHES}
    named = {name: _grid(value) for name, value in asked.items()}
    for name in named:
        _exported(name, formats, "quads")
        if name not in MESHES:
            raise BadRequest(f"quads for {name}: it has no facets; formats that have: {', '.join(MESHES)}")
    return {name: named[name] for name in dict.fromkeys(formats) if name in named}


def asked_roles(asked: AskedRole, formats: Sequence[str]) -> dict[str, Role]:
    """Role declared of each format that is exported.

    Raises
    ------
    BadRequest
        A word that is no role, a format that is unknown, carries no light or is not exported.
    """
    if asked is None:
        return {}
    if not isinstance(asked, Mapping):
        role = _role(asked)
        return {name: role for name in dict.fromkeys(formats) if role_of(name) is not Role.OTHER}
    named = {name: _role(word) for name, word in asked.items()}
    for name in named:
        _exported(name, formats, "role")
        if role_of(name) is Role.OTHER:
            raise BadRequest(
                f"role of {name}: no light of the law goes through it, so it has none to declare"
            )
    return {name: named[name] for name in dict.fromkeys(formats) if name in named}


def _grid(value: object) -> Quads:
    if value == "auto":
        return "auto"
    if isinstance(value, int) and not isinstance(value, bool) and value >= 1:
        return value
    near = _near(value, ("auto",))
    raise BadRequest(f"quads = {value}: it is a whole number above 0, or auto{near}")


def _role(word: object) -> Role:
    if word == "scan":
        raise BadRequest("role = scan: a scan is measured, not exported; allowed: master, preview")
    if isinstance(word, str) and word in WORDS:
        return WORDS[word]
    raise BadRequest(f"role = {word}: unknown{_near(word, ROLES)}; allowed: {', '.join(ROLES)}")


def _exported(name: str, formats: Sequence[str], what: str) -> None:
    if name in formats:
        return
    if name in FORMATS:
        raise BadRequest(f"{what} for {name}, which is not exported: add it to the formats, or leave it out")
    raise BadRequest(f"{what} for {name!r}: unknown format{_near(name, FORMATS)}")


def _near(word: object, words: Mapping[str, object] | Sequence[str]) -> str:
    found = get_close_matches(str(word), list(words), 1)
    return f"; did you mean {found[0]}?" if found else ""
