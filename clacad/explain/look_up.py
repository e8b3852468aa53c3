"""Look up what a code, check, word, process, effect or material means, why it matters, and what to do.

Processes, effects, formats and materials are explained from their own tables and docstrings.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from importlib.util import find_spec
from math import inf, pi
from pathlib import Path
from string import ascii_letters

from clacad import effects as registry
from clacad.base.text import did_you_mean, near, nm_text, table, whole_number
from clacad.base.units import LENGTHS, Unit
from clacad.checks.check import kinds
from clacad.config.mistakes import CODES as IN_DESIGNS
from clacad.design.combinations import BUILT, ITSELF, matrix
from clacad.design.process_profiles import TOLERANCE_CLASSES, ProcessProfile, ToleranceClass, profiles
from clacad.design.sections import DESIGN, PAIR, ROOT, SECTIONS
from clacad.explain.design_mistakes import MISTAKES, Entry
from clacad.explain.glossary import SYNONYMS, WORDS
from clacad.exporting.formats.format import Format
from clacad.exporting.formats.registry import formats
from clacad.optics.material.catalogue import find, names
from clacad.optics.material.material import D_LINE, NOT_PUBLISHED, Material, state_it
from clacad.topology.complex_parts import CODES as BODIES

SHOWN = (550e-9, 4e-6, 10.6e-6)
"""Wavelengths, metres, at which known indices are printed: the eye's, the middle and far infrared."""


def named_things() -> Iterator[Entry]:
    """Entries of all processes, effects, formats and materials."""
    yield _combinations()
    yield from map(_process, profiles())
    yield from map(_tolerance_class, TOLERANCE_CLASSES.values())
    yield from map(_effect, registry.NAMES)
    yield _formats()
    yield from map(_format, formats())
    yield from (_material(find(name)) for name in names())


def _combinations() -> Entry:
    """Features that combine with non-uniform sheets: a matrix, from the table of the reader's refusals."""
    (_, *sheets), *rows = matrix()
    codes: dict[str, str] = {}
    lines = [["", *(sheet.rpartition(".")[2] for sheet in sheets)]]
    for feature, *cells in rows:
        lines.append([feature, *(_combined(cell, codes) for cell in cells)])
    legend = [f"{code}  {reason}" for reason, code in codes.items()]
    return Entry(
        "",
        "combinations",
        "non-uniform sheets (columns) with other features (rows)",
        "\n  ".join(
            [
                *table(lines, indent="").splitlines(),
                f"columns: {', '.join(sheets)}",
                "yes: built; -: the same key; a letter: refused by CL125, because",
                *legend,
            ]
        ),
        "",
        "",
        "see CL125",
    )


def _combined(cell: str, codes: dict[str, str]) -> str:
    """A cell of the matrix: yes, - or the letter of a reason, which is added to `codes` when it is new."""
    if cell in (BUILT, ITSELF):
        return "yes" if cell == BUILT else "-"
    return codes.setdefault(cell, ascii_letters[len(codes)])


def materials_text() -> str:
    """Names of all materials, by kind."""
    kinds: dict[str, list[str]] = {}
    for name in names():
        kinds.setdefault(find(name).kind, []).append(name)
    return "; ".join(f"{kind}: {', '.join(those)}" for kind, those in kinds.items())


# --- processes ----------------------------------------------------------------------------------------------
_LIMITS = (
    ("edge", "edge at least {}"),
    ("neck", "between lenslets at least {}"),
    ("radius", "radii at least {}"),
    ("pitch", "pitch at least {}"),
    ("sag", "structures up to {} high"),
    ("part_height", "parts up to {} high"),
    ("part_width", "parts up to {} wide"),
    ("wall", "walls up to {} high"),
    ("clearance", "gap between bodies at least {}"),
    ("tool", "tool nose {}"),
    ("voxel", "voxels of {}"),
    ("layer", "layers of {}"),
)
"""Limits in metres, and their sentences; 0 and infinity set none."""


def _process(one: ProcessProfile) -> Entry:
    told = [
        words.format(_length(value)) for name, words in _LIMITS if 0.0 < (value := getattr(one, name)) < inf
    ]
    told += [f"draft at least {one.draft * 180 / pi:g}°"] if one.draft > 0.0 else []
    told += [f"slopes up to {one.slope * 180 / pi:g}°"] if one.slope < 0.5 * pi else []
    told += [] if one.undercut else ["no undercut"]
    told += [f"works {', '.join(_worked(one))}"] if one.materials else []
    limits = ", ".join(told) or "A part must exist, nothing more: no limit of a process is checked"
    return Entry(
        "",
        one.name,
        f"process {one.name}",
        f"{limits[0].upper()}{limits[1:]}.",
        f"Limits from: {one.source}.\n  Defaults of [process]: {_defaults(one)}. From: {one.made_source}.",
        "",
        f'check.process = "{one.name}" in the design file; a limit may be allowed to be passed with a reason'
        " (check.allow).",
        "process",
    )


def _defaults(one: ProcessProfile) -> str:
    """What a process leaves by default, as the keys of section [process]."""
    made = one.made
    words = [f"{name} {_length(made[name])}" for name in ("nose", "feed", "spot", "layer") if made[name]]
    words += [f"levels {made['levels']:g}"] if made["levels"] else []
    lateral, height = made["lateral"], made["height"]
    if lateral or height:
        base = " on a base that keeps its thickness" if made["substrate"] else ""
        words.append(f"shrinkage {100 * lateral:g} % in x and y, {100 * height:g} % in z{base}")
    return ", ".join(words) or "nothing is left"


def _tolerance_class(one: ToleranceClass) -> Entry:
    values = ", ".join(
        f"{name} {' and '.join(value) if isinstance(value, list) else value}"
        for name, value in one.values.items()
    )
    return Entry(
        "",
        f"class {one.name}",
        f"tolerance class {one.name}",
        f"Tolerances of [tolerances] that are not stated: {values}.",
        f"From: {one.source}.",
        "",
        f'tolerances.class = "{one.name}" in the design file; a stated tolerance replaces that of the class.',
        "process",
    )


def _worked(one: ProcessProfile) -> list[str]:
    """Materials a process works: kinds as a whole with their names, then single ones."""
    kinds: dict[str, list[str]] = {}
    for name in names():
        material = find(name)
        if one.works(material):
            kinds.setdefault(material.kind, []).append(name)
    return [f"{kind} ({', '.join(those)})" for kind, those in kinds.items()]


def _length(metres: float) -> str:
    return f"{1e3 * metres:g} mm" if metres >= 1e-4 else f"{1e6 * metres:g} µm"


# --- effects ------------------------------------------------------------------------------------------------
def _effect(name: str) -> Entry:
    """An effect by the docstring of its module: title, *Model*, *Law*, *On when*."""
    place = find_spec(f"clacad.effects.{name}")
    assert place is not None
    assert place.origin is not None
    text = Path(place.origin).read_text(encoding="utf-8")
    title, _, body = (ast.get_docstring(ast.parse(text)) or "").partition("\n")
    parts = re.split(r"\n\*(Model|Law|On)\b([^*]*)\*", f"\n{body.strip()}")
    found = {
        word: " ".join(f"{more.strip(' .')} {said}".split())
        for word, more, said in zip(parts[1::3], parts[2::3], parts[3::3])
    }
    return Entry(
        "",
        name,
        f"effect {name}: {title.rstrip('.')}",
        found["Model"],
        f"Its law: {found['Law']}",
        "",
        f"It is simulated {found['On']} A scene switches it on or leaves it out by effects.force and"
        " effects.without; `clacad effects SCENE` shows the plan.",
        "effect",
    )


# --- formats ------------------------------------------------------------------------------------------------
def _formats() -> Entry:
    """List of all formats."""
    listed = table([[one.word, one.about] for one in formats()], indent="")
    return Entry(
        "",
        "formats",
        "formats of files",
        "\n  ".join(listed.splitlines()),
        "",
        "",
        "clacad export DESIGN --format A,B",
    )


def _format(one: Format) -> Entry:
    """A format by what it declares."""
    name = f"format {one.word}" if DESIGN.homes(one.word) else one.word
    sheets = "one cell, of a non-uniform sheet that of --cell" if one.of_cell else "non-uniform sheets too"
    repeats = "; it stores one cell of a uniform sheet and its places" if one.repeats else ""
    return Entry(
        "",
        name,
        f"format {one.word}",
        f"{one.about[0].upper()}{one.about[1:]}.",
        f"It holds {sheets}{repeats}. Accuracy: {'; '.join(way.note for way in one.stored)}.",
        "",
        f"clacad export DESIGN --format {one.word}",
        "format",
    )


# --- materials ----------------------------------------------------------------------------------------------
def _material(one: Material) -> Entry:
    assert one.range_m is not None, "every material of the table has its range"
    short, long = one.range_m
    waves = [wave for wave in SHOWN if short <= wave <= long] or [0.5 * (short + long)]
    abbe, thermal = one.abbe_number, one.thermal
    means = [
        ", ".join(f"n = {one.index(wave):.4f} at {_wave(wave)}" for wave in waves),
        f"n_d = {one.index(D_LINE):.5f}, V_d = {abbe:.1f}" if abbe is not None else "V_d is not published",
        f"known from {1e9 * short:.0f} to {nm_text(long, 0, fixed=True)}",
        _density(one),
        "dn/dT: " + (NOT_PUBLISHED if thermal.dn_dt is None else _dn_dt(*thermal.dn_dt)),
        "expansion: "
        + (NOT_PUBLISHED if thermal.expansion is None else f"{1e6 * thermal.expansion:.3g}e-6/K"),
        "absorption known" if one.extinction else "absorption not published",
    ]
    made = [rules.name for rules in profiles() if rules.materials and rules.works(one)]
    means.append(f"worked by {', '.join(made)}" if made else "worked by no process known here")
    why = f"From: {one.source}." + (f" Thermal numbers: {thermal.source}." if thermal.source else "")
    missing = "dn_dt" if thermal.dn_dt is None else "expansion" if thermal.expansion is None else ""
    return Entry(
        "",
        one.name,
        f"material {one.name} ({one.kind})",
        f"{'; '.join(means)}.",
        why,
        "",
        f'pair.material = "{one.name}" in the design file'
        + (f"; {state_it(one.name, missing)}." if missing else "."),
        "material",
    )


def _density(one: Material) -> str:
    if one.density_kg_m3 is None:
        return f"density: {NOT_PUBLISHED}"
    by = "of that catalogue" if "catalogue" in one.source else "a typical value of handbooks"
    return f"{one.density_kg_m3:g} kg/m³ ({by})"


def _dn_dt(change: float, wave: float) -> str:
    return f"{1e6 * change:.3g}e-6/K at {_wave(wave)}"


def _wave(metres: float) -> str:
    return nm_text(metres, 0, fixed=True) if metres < 1e-6 else f"{1e6 * metres:g} µm"


__all__ = ["Entry", "Unexplained", "entries", "explain"]


class Unexplained(KeyError):
    """Nothing has that name; the message suggests the nearest ones."""

    exit_status = 2

    def __str__(self) -> str:
        """The sentence, without the quotes of a KeyError."""
        return str(self.args[0])


def entries(more: Sequence[Entry] = ()) -> dict[str, Entry]:
    """Every explanation: codes first, in order, then words, processes, effects, materials, and more entries.

    An entry with the name of a word or a check (diffraction) is listed with its kind: "effect diffraction".

    more : Entries of the caller, such as those of commands.
    """
    found = {}
    for code, title in sorted({**IN_DESIGNS, **BODIES}.items()):
        means, why, formula, do = MISTAKES[code]
        found[code] = Entry(code, "", title, means, why, formula, do, "code")
    for kind in sorted(kinds().values(), key=lambda kind: kind.code):
        found[kind.code] = Entry(
            kind.code, kind.id, f"check {kind.id}", kind.means, kind.why, kind.formula, kind.do, "check"
        )
    for word, (means, key) in WORDS.items():
        found[word] = Entry("", word, word, means, "", "", _see(key))
    taken = {entry.name for entry in found.values()}
    for entry in (*named_things(), *more):
        name = entry.name if entry.name not in taken else f"{entry.kind} {entry.name}"
        found[name] = replace(entry, name=name)
    return found


def _see(key: str) -> str:
    """Key or command that a word refers to."""
    if not key:
        return ""
    return f"see clacad {key}" if " " in key else f"see {key} of the design file"


def explain(text: str, more: Sequence[Entry] = ()) -> Entry:
    """Look up a code ("CL337", "337"), check ("wall"), word, process, effect, material or key ("pair.web").

    The former name of a check finds the check; its title then states the present name.

    more : Entries of the caller, as in `entries`.
    Raises Unexplained.
    """
    known = entries(more)
    word = text.strip()
    code = word.upper() if whole_number(word) is None else f"CL{word}"
    if code in known:
        return known[code]
    by_name = {entry.name: entry for entry in known.values() if entry.name}
    folded = word.lower().replace("é", "e").replace("-", "_")
    former = {kind.former: kind.id for kind in kinds().values() if kind.former}
    if folded in former:
        now = by_name[former[folded]]
        return replace(now, title=f"{now.title} ({folded} is now called {now.name})")
    folded = SYNONYMS.get(folded, SYNONYMS.get(folded.replace("_", " "), folded))
    for name in () if "." in folded else (folded, folded.replace("_", " "), folded.replace("_", "-")):
        if name in by_name:
            return by_name[name]
    same = [entry for name, entry in by_name.items() if _bare(name) == _bare(word)]
    if same and "." not in folded:
        return same[0]
    if (key := _key(folded)) is not None:
        return key
    with suppress(KeyError, ValueError):
        return by_name[find(word).name]  # another name of a material
    raise Unexplained(f"nothing is called {text!r}; {_nearest(word, known, list(by_name))}")


def _key(name: str) -> Entry | None:
    """A key of the design file, by its dotted name or its last part."""
    places = DESIGN.homes(name.rsplit(".", 1)[-1])
    place = name if name in places else (places[0] if places and "." not in name else None)
    if place is None:
        return None
    section, _, last = place.rpartition(".")
    if not section and last not in ROOT:
        return Entry(
            "",
            last,
            f"section [{last}] of the design file",
            f"keys: {', '.join(SECTIONS[last])}",
            "",
            "",
            "",
            "key",
        )
    key = (SECTIONS[section] if section else ROOT)[last]
    allowed = key.kind.allowed(Unit("the design's unit", LENGTHS["m"]))
    if place == PAIR.material:
        allowed = (
            f"one of the names of the table ({materials_text()}), or a page of the refractiveindex.info"
            " database (ri:…)"
        )
    return Entry(
        "", place, f"key {place} of the design file", key.about, "", "", f"it takes {allowed}", "key"
    )


def _bare(name: str) -> str:
    """A name without case, spaces and hyphens, as materials are looked up."""
    return "".join(sign for sign in name.casefold() if sign.isalnum())


def _nearest(word: str, known: dict[str, Entry], names: list[str]) -> str:
    """Suggestion of the nearest names."""
    number = whole_number(word[2:] if word[:2].upper() == "CL" else word)
    if number is not None:
        codes = [code for code in known if known[code].code]
        nearest = sorted(codes, key=lambda code: (abs(int(code[2:]) - number), code))[:3]
        return f"the nearest codes are {', '.join(sorted(nearest))}"
    close = near(word.lower(), names, 0.4, most=3)
    return did_you_mean(close) or "`clacad explain` lists all codes and words"
