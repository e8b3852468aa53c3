"""Design file of a search result, with comments on its origin and its gains."""

from __future__ import annotations

from collections.abc import Mapping
from math import degrees

from clacad.config.edit_text import to_toml
from clacad.design.keys import PAIR
from clacad.optimising.aim import RAYS, WHOLE
from clacad.optimising.search import Optimised

PLACES = {
    2: ("lens 1, front of the slab", "lens 2, back of the slab"),
    4: ("lens 1, front", "lens 1, back", "lens 2, front", "lens 2, back"),
    6: (
        "lens 1, front",
        "lens 1, back",
        "field lens, front",
        "field lens, back",
        "lens 2, front",
        "lens 2, back",
    ),
}
PLATES = ("lens 1", "field lens, back of plate 1", "field lens, front of plate 2", "lens 2")


def design_text(found: Optimised) -> str:
    """Optimised design as loadable TOML, with comments."""
    data = dict(found.design.given)
    pair = dict(data["pair"])
    faces, record = pair.pop("face"), pair.pop("search")
    head = {key: value for key, value in data.items() if not isinstance(value, Mapping)}
    parts = [_about(found), to_toml(head)]
    for name, section in data.items():
        if not isinstance(section, Mapping):
            continue
        parts.append(to_toml({name: pair if name == "pair" else section}))
        if name == "pair":
            plates = pair["form"] == "slab" and len(faces) == len(PLATES)
            for face, place in zip(faces, PLATES if plates else PLACES[len(faces)], strict=True):
                body = to_toml(face)
                parts.append(f"\n[[pair.face]]    # {place}\n{body}")
            parts.append(to_toml({PAIR.search: record}))
    return "".join(parts)


def _about(found: Optimised) -> str:
    """Comments of the file before its first key."""
    lines = [
        f"{found.design.name}: faces found by clacad optimise {asked(found)}",
        f"from the design {found.start.sha256} with {found.unknowns} unknowns, {RAYS} Sobol rays, "
        f"{found.evaluations} evaluations.",
    ]
    lines += [left_out(found)] if found.left_out and found.finished else []
    if found.stopped:
        why = "on the way" if found.stopped == "interrupted" else "when its seconds were over"
        lines.append(f"The search was stopped {why}; this is the best it had found within the walls.")
    if found.after:
        lines += [
            "",
            "Direction error to the law, rms over fresh rays, and share of light that gets to its partner cell:",
        ]
        lines += [f"  {text}" for text in gains(found)]
        lines += ["What is best over this field need not be over another."]
    if found.expected is not None:
        lines.append(expected(found))
    return "".join(f"# {line}".rstrip() + "\n" for line in lines) + "\n"


def asked(found: Optimised) -> str:
    """Requested options, as they would be typed."""
    text = f'--free {",".join(found.free)} --field "{degrees(found.field):.4g} deg"'
    if found.aim.weights != WHOLE:
        text += f" --weights {','.join(f'{part:g}:{weight:g}' for part, weight in found.aim.weights)}"
    return text + (" --tolerances" if found.aim.tolerances else "")


def left_out(found: Optimised) -> str:
    """A sentence on the orders that gave too little gain."""
    return f"Left out, for the error would be less by under a tenth with it: {', '.join(found.left_out)}."


def expected(found: Optimised) -> str:
    """A sentence on the error of parts as made."""
    assert found.expected is not None
    before, after = (1e3 * error for error in found.expected)
    return f"To expect of parts made with the [tolerances]: {before:.4g} mrad  ->  {after:.4g} mrad rms."


def gains(found: Optimised) -> list[str]:
    """One line per field: error and share before and after."""
    return [
        f"{degrees(one.field):6.4g} deg: {1e3 * one.law_rms:.4g} mrad, {100 * one.throughput:.1f} %  ->  "
        f"{1e3 * two.law_rms:.4g} mrad, {100 * two.throughput:.1f} %"
        for one, two in zip(found.before, found.after, strict=True)
    ]
