"""The design file that a search ends in: ordinary, commented, saying from what it came and what was gained."""

from __future__ import annotations

from collections.abc import Mapping
from math import degrees

from clacad.design.canonical_text import to_toml
from clacad.optimising.search import RAYS, Optimised

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
    """The better design as TOML, with comments; it loads as it stands."""
    data = dict(found.design.given)
    pair = dict(data["pair"])
    faces = pair.pop("face")
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
    return "".join(parts)


def _about(found: Optimised) -> str:
    """What the file says of itself before its first key."""
    lines = [
        f"{found.design.name}: faces found by clacad optimise --free {','.join(found.free)} "
        f'--field "{degrees(found.field):.4g} deg"',
        f"from the design {found.start.sha256} with {found.unknowns} unknowns, {RAYS} Sobol rays, "
        f"{found.evaluations} evaluations.",
    ]
    if not found.finished:
        lines.append("The search was stopped on the way; this is the best it had found within the walls.")
    else:
        lines += [
            "",
            "Direction error to the law, rms over fresh rays, and share of light that gets to its partner cell:",
        ]
        lines += [f"  {text}" for text in gains(found)]
        lines += ["What is best over this field need not be over another."]
    return "".join(f"# {line}".rstrip() + "\n" for line in lines) + "\n"


def gains(found: Optimised) -> list[str]:
    """One line a field: error and share before and after."""
    return [
        f"{degrees(one.field):6.4g} deg: {1e3 * one.law_rms:.4g} mrad, {100 * one.throughput:.1f} %  ->  "
        f"{1e3 * two.law_rms:.4g} mrad, {100 * two.throughput:.1f} %"
        for one, two in zip(found.before, found.after, strict=True)
    ]
