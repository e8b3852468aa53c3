"""Answer to a wish: a design that passes, the reasons for its numbers, and its file; or why there is none.

The design file of a proposal, with comments.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from textwrap import wrap
from typing import Any

from clacad.advice.judged import Judged
from clacad.advice.nearest_wish import binding, nearest, plain_words
from clacad.advice.trade_offs import Trade, rows_of, sentences, trade_offs
from clacad.advice.wish import Wish, read_wish
from clacad.advice.wish_search import Search, Tried
from clacad.base.text import table
from clacad.base.types import Progress, silent
from clacad.checks.light_kinds import VIEWED
from clacad.config.edit_text import to_toml
from clacad.design import Design
from clacad.design.keys import ROOT, SECTIONS


class NoSuchSheet(ValueError):
    """No tried design fulfils the wish; the message gives the binding limits and similar wishes that can be
    fulfilled.
    """

    exit_status = 1


@dataclass(frozen=True, eq=False)
class Proposal:
    """A design that fulfils a wish.

    Parameters
    ----------
    wish : Wish
    chosen : Tried
        The design, as judged, and its variant and pitch.
    trades : tuple of Trade
        It and its neighbours.
    judgements : int
        Number of designs that were built, traced and judged.
    """

    wish: Wish
    chosen: Tried
    trades: tuple[Trade, ...]
    judgements: int

    @property
    def design(self) -> Design:
        """The design."""
        return self.chosen.judged.design

    @property
    def judged(self) -> Judged:
        """Forecast of verify for the design."""
        return self.chosen.judged

    @property
    def reasons(self) -> tuple[str, ...]:
        """Reasons for the numbers, and their trade-offs."""
        one = self.chosen
        warnings = [f"warning {c.id}: {c.sentence}" for c in self.judged.warning]
        return (
            f"pitch {one.pitch.value:g} mm: {one.pitch.why}",
            *not_met(self.wish, self.design),
            (
                f"separation {self.design.pair.separation:g} mm, {one.ratio:g} pitches: the nearest at which"
                " the law is kept as sharply as a pixel looks, or as the limits ask"
            ),
            *(
                []
                if one.variant.conic is None
                else [f"conic {one.variant.conic:g}: keeps light on the law where it goes off the axis"]
            ),
            *_for_the_eye(self),
            *sentences(self.wish, self.trades[0]),
            *warnings,
        )

    @property
    def text(self) -> str:
        """The commented design file."""
        return file_text(self.wish, self.judged, self.reasons, self.trades)


def not_met(wish: Wish, design: Design) -> Iterator[str]:
    """Sides of the sheet that differ from the wish because they are not a whole number of pitches."""
    if design.lattice.outline is not None:
        return
    cells = zip(("width", "height"), wish.size.size, design.lattice.count, design.lattice.pitch, strict=True)
    for name, asked, count, pitch in list(cells)[: 1 if wish.size.size[0] == wish.size.size[1] else 2]:
        if abs(count * pitch - asked) > 1e-9 * asked:
            yield f"{name}: requested {asked:g} mm, {count} x {pitch:g} = {count * pitch:g} mm"


def _for_the_eye(found: Proposal) -> Iterator[str]:
    """Construction that serves a stated eye, and the share of its light that obeys the law."""
    if found.wish.viewing is None:
        return
    share = next(check.value for check in found.judged.checks if check.kind is VIEWED)
    means = {"": "aligned cells alone", "field lens": "field lenses", "aimed": "cells aimed at the eye"}
    yield (
        f"viewer at {found.wish.viewing:g} mm: {means[found.chosen.variant.eye]} keep"
        f" {100.0 * float(share or 0.0):.3g} % of its light on the law over the whole sheet"
    )


def design_for(
    wish: Wish | Mapping[str, Any],
    overrides: Sequence[str] = (),
    *,
    name: str = "wish",
    progress: Progress | None = None,
) -> Proposal:
    """Find a design that fulfils a wish and passes verify.

    Closed formulas give the search range. The proposal was built, traced through one cell and judged by the
    checks and limits of verify. The same wish gives the same design.

    Parameters
    ----------
    wish : Wish or mapping
        ``{"eta": -1, "circle": "60 mm", "process": "moulding", "material": "PC"}``: words of `clacad new
        --for`; lengths
        without a unit are millimetres.
    overrides : sequence of str
        "key.path=value" that the design must keep, as with --set.
    name : str
        Of the design.
    progress : callable or None
        Called with a stage's name and the part done.

    Raises
    ------
    DesignError
        The wish or an override cannot be read.
    NoSuchSheet
        No tried design passes.
    """
    asked = wish if isinstance(wish, Wish) else read_wish(wish)
    search = Search(asked, name, tuple(overrides), progress or silent)
    chosen = search.run()
    if chosen is None:
        raise NoSuchSheet("\n".join([*binding(search), *nearest(search)]))
    trades = trade_offs(asked, chosen.judged)
    return Proposal(asked, chosen, trades, len(search.tried) + len(trades) - 1)


WIDTH = 118


def file_text(wish: Wish, judged: Judged, reasons: Sequence[str], trades: Sequence[Trade]) -> str:
    """Loadable TOML with comments."""
    lines = ["#:schema clacad.schema.json"]
    lines += _wrapped(f"Made for the wish {plain_words(wish)}.")
    words = sorted({check.id for check in judged.warning})
    end = f"passes, with a warning: {', '.join(words)}" if words else "passes, without a warning"
    lines += _wrapped(f"Built, traced through one cell and judged by the checks of clacad verify: {end}.")
    lines += ["#", "# Why these numbers:"]
    for reason in reasons:
        lines += _wrapped(reason, first="# * ", rest="#   ")
    lines += ["#", "# What others would give, each built and traced:"]
    lines += [f"#{row}" for row in table(rows_of(trades)).split("\n")]
    return "\n".join([*lines, "", *_keys(judged.design.given)]) + "\n"


def _wrapped(text: str, first: str = "# ", rest: str = "# ") -> list[str]:
    return wrap(
        text,
        WIDTH,
        initial_indent=first,
        subsequent_indent=rest,
        break_long_words=False,
        break_on_hyphens=False,
    )


def _keys(given: Any) -> Iterator[str]:
    """The keys as written, each with its meaning."""
    section = ""
    for line in to_toml(given).rstrip("\n").split("\n"):
        if line.startswith("["):
            section = line.strip("[]")
        name = line.partition(" = ")[0]
        known = SECTIONS.get(section, {}).get(name) if section else ROOT.get(name)
        yield line if known is None or not line.partition(" = ")[1] else f"{line.ljust(34)} # {known.about}"
