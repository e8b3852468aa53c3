"""Materials by name: the table `materials.toml`, with sources, and refractiveindex.info pages."""

from __future__ import annotations

import tomllib
from functools import cache
from importlib.resources import files
from typing import Any

from clacad.base.text import did_you_mean, near
from clacad.optics.material.database import PREFIX, page
from clacad.optics.material.material import MICROMETRES, Material, ThermalNumbers


def names() -> tuple[str, ...]:
    """Names of all materials in the table, plastics first."""
    return tuple(_table()[0])


def find(name: str) -> Material:
    """The material with a given name or alias; case, spaces, hyphens and ® do not count.

    Parameters
    ----------
    name : str
        Of the table, or "ri:SHELF/BOOK/PAGE": a page of the refractiveindex.info database, if that is installed.

    Raises
    ------
    ValueError
        If there is none, naming the nearest ones.
    """
    if name.startswith(PREFIX):
        return page(name)
    materials, known = _table()
    found = known.get(_plain(name))
    if found is None:
        hint = did_you_mean(suggestions(name)) or f"known are {', '.join(materials)}"
        raise ValueError(f"unknown material {name!r}; {hint}")
    return materials[found]


def suggestions(name: str) -> tuple[str, ...]:
    """Up to three names of the table nearest to an unknown one.

    Parameters
    ----------
    name : str
    """
    _, known = _table()
    return tuple(dict.fromkeys(known[plain] for plain in near(_plain(name), known, most=6)))[:3]


@cache
def _table() -> tuple[dict[str, Material], dict[str, str]]:
    """Materials by name, and every name and alias in plain form → name."""
    entries: dict[str, Any] = tomllib.loads(
        files("clacad.optics.material").joinpath("materials.toml").read_text(encoding="utf-8")
    )
    materials = {name: _from_entry(name, entry) for name, entry in entries.items()}
    known: dict[str, str] = {}
    for name, entry in entries.items():
        for alias in (name, *entry.get("also", ())):
            if known.setdefault(_plain(alias), name) != name:
                raise ValueError(f"material name {alias!r} stands for both {known[_plain(alias)]} and {name}")
    return materials, known


def _from_entry(name: str, entry: dict[str, Any]) -> Material:
    short, long = entry["range_um"]
    return Material(
        name=name,
        formula=entry["formula"],
        coefficients=tuple(float(c) for c in entry["coefficients"]),
        range_m=(short / MICROMETRES, long / MICROMETRES),
        source=entry["source"],
        kind=entry["kind"],
        density_kg_m3=entry.get("density_kg_m3"),
        thermal=_thermal(entry),
        extinction=tuple((um / MICROMETRES, k) for um, k in entry.get("extinction", ())),
        extinction_source=entry.get("extinction_source", ""),
    )


def _thermal(entry: dict[str, Any]) -> ThermalNumbers:
    dn_dt = entry.get("dn_dt_per_k")
    return ThermalNumbers(
        dn_dt=None if dn_dt is None else (dn_dt[0], dn_dt[1] / MICROMETRES),
        expansion=entry.get("expansion_per_k"),
        source=entry.get("thermal_source", ""),
    )


def _plain(name: str) -> str:
    return "".join(letter for letter in name.casefold() if letter.isalnum())
