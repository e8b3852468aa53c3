"""Answer to a wish: a design that passes, with the reasons for its numbers; or the nearest wishes.

A proposal has a design file with comments. For a wish that cannot be fulfilled: the binding limits, and
similar wishes that can.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from textwrap import wrap
from typing import Any

from clacad.advice.candidate import round_to
from clacad.advice.judged import Judged, fault
from clacad.advice.lens_shape import Work, least_of_one_material, reasons_for_white
from clacad.advice.trade_offs import Trade, rows_of, sentences, trade_offs
from clacad.advice.wish import KEYS, Wish, angle_text, read_wish, workable_material
from clacad.advice.wish_search import Search, Tried, returned_share
from clacad.base.interactive import shown_progress
from clacad.base.text import percent_text, table
from clacad.base.types import Progress
from clacad.checks.light_kinds import FIELD, VIEWED
from clacad.config.edit_text import to_toml
from clacad.design import Design
from clacad.design.body import Outline
from clacad.design.sections import ROOT, SECTIONS

FEW = 2
"""Largest number of wishes, and of failing checks, that are printed in full."""

NEAR = 1e-3
"""Largest difference of a wished side, in pitches, of which nothing is printed."""

MOST_WORK = 1500
"""Work after which no further wish is tried, in shares of thin lenses."""

REASONS = 4
"""Largest number of printed reasons why designs could not be built."""

FARTHER = (16.0, 8.0, 4.0, 2.0, 1.3)
"""Trial distances of the eye over the wished one; sheets are reduced by the same factors."""

WHITER = (6.0, 3.0, 1.5)
"""Trial limits of the error in white light over the least of one material."""

LAYERED, GLASS = ("moulding", "none"), "P-BK7"
"""Processes that make layers of glass, and a glass that both work."""

LESS = (0.2, 0.4, 0.7)
"""Trial tilts and offsets over the wished ones."""

PROCESSES = ("moulding", "diamond-turning", "greyscale", "sla", "two-photon", "none")


def binding(search: Search) -> Iterator[str]:
    """Binding limits: failing checks of the design that fails least, and reasons of designs not built."""
    yield f"no design was found that passes; {len(search.tried)} were built and judged"
    if search.tried:
        best = min(search.tried, key=lambda t: (len(t.judged.failing), _excess(t)))
        yield (
            f"  the nearest ({best.variant}, pitch {best.pitch.value:g} mm, separation"
            f" {best.separation:g} mm):"
        )
        checks = sorted(best.judged.failing or best.judged.tight, key=lambda c: c.source != "design file")
        yield from (f"    {fault(check)}" for check in checks[:FEW])
        if checks[FEW:]:
            yield f"    and {', '.join(dict.fromkeys(check.id for check in checks[FEW:]))}"
    yield from (f"  {reason}" for reason in list(dict.fromkeys(search.refused))[:REASONS])


def nearest(search: Search) -> Iterator[str]:
    """Sentences on similar wishes that can be fulfilled, each tried.

    Of each row the most demanding wish that comes true is named.
    """
    found, work = 0, Work(MOST_WORK)
    for row in _rows(search):
        if found == FEW or work.over:
            break
        best = _most_demanding(list(row), search, work)
        if best is not None:
            found += 1
            words, one = best
            yield f"  {words} comes true: {one.variant}, pitch {one.pitch.value:g} mm{_warned(one)}"
    if not found and search.wish.viewing is not None:  # regardless of the work spent on the eye
        words, plain = "leaving viewing out", replace(search.wish, viewing=None)
        search.progress(f"trying {words}", 1.0)
        unseen = Search(plain, search.name, search.overrides, work=Work(MOST_WORK), first=True).run()
        if unseen is not None:
            found += 1
            yield f"  {words} comes true: {unseen.variant}, pitch {unseen.pitch.value:g} mm{_warned(unseen)}"
    if not found:
        yield "  none of the wishes near it that were tried comes true either"


def _most_demanding(row: Sequence[tuple[str, Wish]], search: Search, work: Work) -> tuple[str, Tried] | None:
    """Most demanding wish of a row that comes true, by bisection; the least demanding comes first."""
    best, low, high = None, -1, len(row)
    while high - low > 1 and not work.over:
        middle = (low + high) // 2
        words, wish = row[middle]
        search.progress(f"trying {words}", min(work.done / work.most, 1.0))
        one = Search(wish, search.name, search.overrides, work=work, first=True).run()
        if one is None:
            high = middle
        else:
            best, low = (words, one), middle
    return best


def _warned(one: Tried) -> str:
    with_ = sorted({c.id for c in one.judged.warning})
    return f" (with a warning: {', '.join(with_)})" if with_ else ""


def _rows(search: Search) -> Iterator[Iterable[tuple[str, Wish]]]:
    """Rows of more and more demanding wishes near the one that cannot be fulfilled."""
    wish = search.wish
    if wish.white is not None:
        for process in LAYERED:
            yield _changed(wish, [{"process": process, "material": GLASS}])
        least = least_of_one_material(wish)
        yield _changed(wish, [{"white": round_to(factor * least, 2)} for factor in WHITER])
    if wish.form != "any":
        yield [("form=any", replace(wish, form="any"))]
    wide = max(wish.size.size)
    if wide > search.widest > 0.0:
        yield _changed(wish, [{"size": _resized(wish, search.widest / wide)}])
    yield from _changed_for_the_eye(search)
    if not wish.straight:
        euler = (wish.euler[0], wish.euler[2])
        yield _changed(
            wish,
            (
                {
                    "delta": _scaled(wish.delta, part),
                    "euler": (euler[0], round(part * wish.euler[1], 4), euler[1]),
                }
                for part in LESS
            ),
        )
    yield _changed(wish, [{"size": _resized(wish, 3.0)}])
    yield _changed(wish, [{"field": 0.5 * wish.field}])
    for process in PROCESSES:
        if process != wish.process:
            material = workable_material(process, wish.material, wish.wavelength)
            yield _changed(wish, [{"process": process, "material": material}])


def _changed_for_the_eye(search: Search) -> Iterator[Iterable[tuple[str, Wish]]]:
    """Rows with the eye farther away, or a smaller sheet, where that can help a stated eye."""
    wish = search.wish
    if wish.viewing is None or returned_share(wish) < search.limit:
        return
    yield _changed(wish, [{"viewing": round_to(wish.viewing * factor, 2)} for factor in FARTHER])
    yield _changed(wish, [{"size": _resized(wish, 1.0 / factor)} for factor in FARTHER])


def _changed(wish: Wish, changes: Iterable[dict[str, Any]]) -> Iterator[tuple[str, Wish]]:
    """The wish with some changed values, and the words of the change."""
    for values in changes:
        changed = replace(wish, **values)
        yield _difference(wish, changed), changed


def _resized(wish: Wish, factor: float) -> Outline:
    width, height = wish.size.size
    return Outline(wish.size.shape, (round_to(width * factor, 3), round_to(height * factor, 3)))


def _scaled(pair: tuple[float, float], part: float) -> tuple[float, float]:
    return round(part * pair[0], 6), round(part * pair[1], 6)


def _difference(before: Wish, after: Wish) -> str:
    """Words that turn one wish into another, including those that return to their default."""
    first, second = before.words(), after.words()
    values = {
        key: second.get(key, KEYS[key].default) for key in (*second, *(k for k in first if k not in second))
    }
    return ", ".join(f"{key}={_plain(value)}" for key, value in values.items() if first.get(key) != value)


def plain_words(words: Mapping[str, Any]) -> str:
    """The words of a wish as typed after --for."""
    return ", ".join(f"{key}={_plain(value)}" for key, value in words.items())


def _plain(value: Any) -> str:
    """A value as typed: whole numbers without a point."""
    if isinstance(value, list):
        return f"[{', '.join(_plain(item) for item in value)}]"
    return repr(value).removesuffix(".0") if isinstance(value, float) else str(value)


def _excess(tried: Tried) -> float:
    """Excess of failing numbers over their limits, in limits."""
    return sum(
        abs(check.value - check.limit) / abs(check.limit) if check.limit else 1.0
        for check in tried.judged.failing
        if isinstance(check.value, float) and isinstance(check.limit, float)
    )


class NoSuchSheet(ValueError):
    """No tried design fulfils the wish; the message has the binding limits and similar wishes that can be."""

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
    forms : tuple of str
        Of a wide field: reasons for its form, and against others.
    """

    wish: Wish
    chosen: Tried
    trades: tuple[Trade, ...]
    judgements: int
    forms: tuple[str, ...] = ()

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
            *not_met(self.wish, self.judged),
            *(self.forms or self._of_recipe()),
            *warnings,
        )

    def _of_recipe(self) -> Iterator[str]:
        """Reasons for the numbers of a pair by recipe."""
        one = self.chosen
        yield (
            f"separation {one.separation:g} mm, {one.ratio:g} pitches: the nearest at which"
            " the law is kept as sharply as a pixel looks, or as the limits ask"
        )
        if one.variant.conic is not None:
            yield f"conic {one.variant.conic:g}: keeps light on the law where it goes off the axis"
        yield from reasons_for_white(self.wish, self.judged)
        yield from _for_the_eye(self)
        yield from sentences(self.wish, self.trades[0])

    @property
    def text(self) -> str:
        """The commented design file."""
        return file_text(self.wish, self.judged, self.reasons, self.trades)


def not_met(wish: Wish, judged: Judged) -> Iterator[str]:
    """Parts of a wish that a design does not fulfil: its field where that is wider than the field of view,
    of which verify only warns; sides that are not a whole number of pitches.
    """
    design = judged.design
    for check in judged.warning:
        if check.kind is FIELD and wish.field != KEYS["field"].default:
            yield f"field: {angle_text(wish.field)} requested, light beyond the field of view leaves the law"
    if design.lattice.outline is not None:
        return
    cells = zip(("width", "height"), wish.size.size, design.lattice.count, design.lattice.pitch, strict=True)
    for name, asked, count, pitch in list(cells)[: 1 if wish.size.size[0] == wish.size.size[1] else 2]:
        if abs(count * pitch - asked) > NEAR * pitch:
            yield f"{name}: requested {asked:g} mm, {count} x {pitch:g} = {count * pitch:g} mm"


def _for_the_eye(found: Proposal) -> Iterator[str]:
    """Construction that serves a stated eye, and the share of its light that obeys the law."""
    if found.wish.viewing is None:
        return
    means = {"": "aligned cells alone", "field lens": "field lenses", "aimed": "cells aimed at the eye"}
    yield (
        f"viewer at {found.wish.viewing:g} mm: {means[found.chosen.variant.eye]} keep"
        f" {percent_text(found.judged.measured(VIEWED))} of its light on the law over the whole sheet"
    )


def design_for(
    wish: Wish | Mapping[str, Any],
    overrides: Sequence[str] = (),
    *,
    name: str = "wish",
    progress: Progress | None = None,
) -> Proposal:
    """Find a design for a wish, such as a round window of 60 mm for an eye at 400 mm, that passes verify.

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

    Examples
    --------
    >>> import clacad
    >>> found = clacad.design_for({"eta": -1, "width": "5 mm", "viewing": "1 m"})
    >>> found.design
    Design('wish', slab, eta -1 -1, separation 3.33 mm, 6 x 6 cells)
    >>> found.judged.passes
    True
    """
    from clacad.advice.wide_field import is_wide

    asked = wish if isinstance(wish, Wish) else read_wish(wish)
    if is_wide(asked):
        return _wide(asked, name, tuple(overrides), shown_progress(progress))
    search = Search(asked, name, tuple(overrides), shown_progress(progress))
    chosen = search.run()
    if chosen is None:
        raise NoSuchSheet("\n".join([*binding(search), *nearest(search)]))
    trades = trade_offs(asked, chosen.judged)
    return Proposal(asked, chosen, trades, len(search.tried) + len(trades) - 1)


def _wide(wish: Wish, name: str, overrides: Sequence[str], progress: Progress) -> Proposal:
    """A design of several plates for a wish of a wide field. Raises NoSuchSheet."""
    from clacad.advice.wide_field import WideSearch

    search = WideSearch(wish, name, overrides, progress)
    chosen = search.run()
    if chosen is None:
        head = f"no design was found that passes; {len(search.tried)} were built and judged"
        raise NoSuchSheet("\n".join([head, *(f"  {reason}" for reason in search.why)]))
    own = trade_offs(wish, chosen.judged)[:1]
    return Proposal(wish, chosen, own, len(search.tried), tuple(search.why))


WIDTH = 118


def file_text(wish: Wish, judged: Judged, reasons: Sequence[str], trades: Sequence[Trade]) -> str:
    """Loadable TOML with comments."""
    lines = ["#:schema clacad.schema.json"]
    lines += _wrapped(f"Made for the wish {plain_words(wish.words())}.")
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
