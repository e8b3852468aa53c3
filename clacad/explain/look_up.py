"""Look up what a code, check, word, process, effect or material means, why it matters, and what to do."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from clacad.base.text import did_you_mean, near, whole_number
from clacad.base.units import LENGTHS, Unit
from clacad.checks.check import kinds
from clacad.config.mistakes import CODES as IN_DESIGNS
from clacad.design.keys import DESIGN, PAIR, ROOT, SECTIONS
from clacad.explain.design_mistakes import MISTAKES
from clacad.explain.entry import Entry
from clacad.explain.glossary import SYNONYMS, WORDS
from clacad.explain.named_things import materials_text, named_things
from clacad.optics.material.catalogue import find
from clacad.topology.cannot_build import CODES as BODIES

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

    Parameters
    ----------
    more : sequence of Entry
        Entries of the caller, such as those of commands.
    """
    found = {}
    for code, title in sorted({**IN_DESIGNS, **BODIES}.items()):
        means, why, formula, do = MISTAKES[code]
        found[code] = Entry(code, "", title, means, why, formula, do)
    for kind in sorted(kinds().values(), key=lambda kind: kind.code):
        found[kind.code] = Entry(
            kind.code, kind.id, f"check {kind.id}", kind.means, kind.why, kind.formula, kind.do
        )
    for word, (means, key) in WORDS.items():
        found[word] = Entry("", word, word, means, "", "", _see(key))
    taken = {entry.name for entry in found.values()}
    for entry in (*named_things(), *more):
        name = entry.name if entry.name not in taken else f"{entry.title.split()[0]} {entry.name}"
        found[name] = replace(entry, name=name)
    return found


def _see(key: str) -> str:
    """Key or command that a word refers to."""
    if not key:
        return ""
    return f"see clacad {key}" if " " in key else f"see {key} of the design file"


def explain(text: str, more: Sequence[Entry] = ()) -> Entry:
    """Look up a code ("CL337", "337"), a check ("wall"), a word ("moire"), a process, effect or material, a
    key ("pair.web").

    The former name of a check finds the check; its title then states the present name.

    Parameters
    ----------
    text : str
    more : sequence of Entry
        Entries of the caller, as in `entries`.

    Raises
    ------
    Unexplained
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
    key = _key(folded)
    if key is not None:
        return key
    try:
        return by_name[find(word).name]  # another name of a material
    except (KeyError, ValueError):
        pass
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
            "", last, f"section [{last}] of the design file", f"keys: {', '.join(SECTIONS[last])}", "", "", ""
        )
    key = (SECTIONS[section] if section else ROOT)[last]
    allowed = key.kind.allowed(Unit("the design's unit", LENGTHS["m"]))
    if place == PAIR.material:
        allowed = (
            f"one of the names of the table ({materials_text()}), or a page of the refractiveindex.info"
            " database (ri:…)"
        )
    return Entry("", place, f"key {place} of the design file", key.about, "", "", f"it takes {allowed}")


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
