"""The wish for a stack in words, `clacad stack --for …`, and the text of the sheets that were solved."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from math import degrees, isfinite
from string import ascii_lowercase
from typing import TYPE_CHECKING, Any

from clacad.base.text import percent_text
from clacad.base.types import Pair2
from clacad.storage.errors import BadRequest

if TYPE_CHECKING:
    from clacad.advice.wanted_stack import NoSuchStack, Solved, Wanted

KINDS = ("cloak", "space", "relay", "image")
"""What can be wanted: space of the stack's own length, of another one, a relay, an image of a plane."""

MORE = ("ring", "object", "at")
"""Lengths that may be added: the hidden ring, the imaged plane before the stack and its image behind."""

ETAS = ("eta1", "eta2")
"""Numbers that may be added, both: η of the first two of three sheets."""

PRODUCT = "product of the sheets"
"""How a share is found that was not traced."""


@dataclass(frozen=True)
class StackWish:
    """What a stack must do; lengths in the unit of its design.

    kind : One of `KINDS`. value : Length of the space; magnification of a relay or an image; cloak: 1.
    ring : Width that is hidden. planes : Distance of the imaged plane before the stack, of its image behind.
    etas : η of the first two of three sheets; None: searched.
    """

    kind: str
    value: float
    ring: float
    planes: Pair2
    etas: Pair2 | None = None


def read_wish(given: Sequence[str], length: Callable[..., float]) -> StackWish:
    """Read the words of a wish.

    length : Reads a length of an option's text; `signed` ones may be negative, others are 0 or above.
    Raises BadRequest.
    """
    words = {key: value for key, _, value in (word.partition("=") for word in given)}
    kinds = [key for key in words if key in KINDS]
    if len(kinds) != 1 or not words.keys() <= {*KINDS, *MORE, *ETAS}:
        more = ", ".join((*MORE, *ETAS))
        raise BadRequest(f"--for {','.join(given)}: give one of {', '.join(KINDS)}; then {more}")
    kind = kinds[0]
    if kind == "cloak" and "ring" not in words:
        raise BadRequest(
            "--for cloak needs ring=LENGTH, the width that is hidden: sheets that do nothing hide nothing"
        )
    ring, before, behind = (length(f"--for {key}=", words.get(key, "0")) for key in MORE)
    if kind == "space":
        value = length("--for space=", words[kind], signed=True)
    else:
        value = 1.0 if kind == "cloak" else _number(kind, words[kind], "a magnification")
    return StackWish(kind, value, ring, (before, behind), _etas(words))


def _etas(words: Mapping[str, str]) -> Pair2 | None:
    given = [_number(key, words[key], "eta of a sheet") for key in ETAS if key in words]
    if len(given) == 1:
        raise BadRequest(f"--for: give both of {', '.join(ETAS)}, or neither")
    return (given[0], given[1]) if given else None


def _number(key: str, text: str, meaning: str) -> float:
    with suppress(ValueError):
        if isfinite(value := float(text)) and value:
            return value
    raise BadRequest(f"--for {key}={text}: is {meaning}, a number that is not 0")


def solved_text(solved: Solved, wanted: Wanted, unit: str) -> str:
    """Share, loss, field and waist of solved sheets."""
    share, how = (solved.share, PRODUCT) if solved.by_rays is None else (solved.by_rays, "by rays")
    return (
        f"{len(solved.sheets)} sheets pass {percent_text(share)} of the light within "
        f"± {degrees(wanted.field):.3g} deg over {2.0 * wanted.radius:.4g} {unit} (thin lenses, {how}), none "
        f"beyond ± {degrees(solved.field):.3g} deg; narrowest half width {solved.waist:.4g} {unit}"
    )


def report_of(found: Mapping[int, Solved | NoSuchStack], wanted: Wanted, unit: str) -> dict[str, Any]:
    """Plain values of what two and three sheets can do."""
    sheets = {
        count: {"impossible": str(one)} if isinstance(one, Exception) else one.to_dict()
        for count, one in found.items()
    }
    return {"matrix": wanted.matrix, "length": wanted.length, "unit": unit, "sheets": sheets}


def rows_of(count: int, solved: Solved | NoSuchStack, unit: str) -> list[tuple[str, str]]:
    """What a number of sheets can do, one row for each sheet, or why they cannot."""
    if isinstance(solved, Exception):
        return [(f"{count} sheets", f"not possible: {solved}")]
    least = percent_text(1.0 / solved.loss**2)
    rows = [
        (
            f"{count} sheets",
            f"{percent_text(solved.share)} of the light, {PRODUCT}; |eta| alone leaves {least}; the light is"
            f" {solved.waist:.4g} {unit} from the axis at its waist",
        )
    ]
    for name, one in zip(ascii_lowercase, solved.sheets):
        aim = f"aimed at z = {one.viewer:.6g}" if isfinite(one.viewer) else "aligned cells"
        words = (
            f"eta {one.eta:.6g}",
            f"f_image {one.f_image:.6g} {unit}, {aim}",
            f"{2.0 * one.reach:.4g} {unit} wide",
            f"{percent_text(one.share)} an axis",
            f"lens 2 reaches {one.height:.2f} of its radius",
            *(("field lenses",) if one.field_lens else ()),
        )
        rows.append((f"sheet {name}", "; ".join(words)))
    return rows
