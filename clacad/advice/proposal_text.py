"""The design file of a proposal, with comments."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from textwrap import wrap
from typing import Any

from clacad.advice.judged import Judged
from clacad.advice.nearest_wish import plain_words
from clacad.advice.trade_offs import Trade, rows_of
from clacad.advice.wish import Wish
from clacad.base.text import table
from clacad.config.edit_text import to_toml
from clacad.design.keys import ROOT, SECTIONS

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
