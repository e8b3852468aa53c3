"""Where a wish cannot come true: what stands in its way, and which wishes near it can."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

from clacad.advice.wish import Wish, workable_material
from clacad.advice.wish_search import Search, Tried
from clacad.base.digits import shown
from clacad.design.sections import Outline
from clacad.verification.checks import Check

FEW = 2
"""Wishes that are named."""

SEARCHES = 9
"""Wishes that are tried."""

PROCESSES = ("moulding", "diamond-turning", "greyscale", "sla", "two-photon", "none")


def binding(search: Search) -> Iterator[str]:
    """Which limits bind: the failing checks of the design that fails least, and what could not be built at all."""
    yield f"no design was found that passes; {len(search.tried)} were built and judged"
    if search.tried:
        best = min(search.tried, key=lambda t: (len(t.judged.failing), _excess(t)))
        form, pair = best.variant.form, best.judged.design.pair
        yield f"  the nearest ({form}, pitch {best.pitch.value:g} mm, separation {pair.separation:g} mm):"
        checks = best.judged.failing or tuple(c for c in best.judged.checks if c.state == "warn")
        yield from (f"    {_fault(check)}" for check in checks)
    yield from (f"  {reason}" for reason in dict.fromkeys(search.refused[:3]))


def nearest(search: Search) -> Iterator[str]:
    """Wishes near this one that come true, each tried; a sentence for each."""
    found = 0
    for number, (words, wish) in enumerate(_relaxed(search.wish)):
        if found == FEW or number == SEARCHES:
            break
        search.progress(f"trying {words}", number / SEARCHES)
        one = Search(wish, search.name, search.overrides).run()
        if one is not None:
            found += 1
            with_ = sorted({c.id for c in one.judged.warning})
            yield f"  {words} comes true: {one.variant.form}, pitch {one.pitch.value:g} mm" + (
                f" (with a warning: {', '.join(with_)})" if with_ else ""
            )
    if not found:
        yield "  none of the wishes near it that were tried comes true either"


def _relaxed(wish: Wish) -> Iterator[tuple[str, Wish]]:
    """Wishes that ask for less, the least change first."""
    if wish.form != "any":
        yield "form=any", replace(wish, form="any")
    for part in (0.7, 0.4, 0.2):
        if not wish.straight:
            changed = replace(
                wish,
                delta=_scaled(wish.delta, part),
                euler=(wish.euler[0], round(part * wish.euler[1], 4), wish.euler[2]),
            )
            yield _difference(wish, changed), changed
    for changed in (
        replace(wish, size=Outline(wish.size.shape, _scaled(wish.size.size, 3.0))), replace(wish, field=0.5 * wish.field)
    ):  # fmt: skip
        yield _difference(wish, changed), changed
    for process in PROCESSES:
        if process != wish.process:
            material = workable_material(process, wish.material)
            words = f"process={process}" + (f", material={material}" if material != wish.material else "")
            yield words, replace(wish, process=process, material=material)


def _scaled(pair: tuple[float, float], part: float) -> tuple[float, float]:
    return round(part * pair[0], 6), round(part * pair[1], 6)


def _difference(before: Wish, after: Wish) -> str:
    """The words of a wish that another one does not say so."""
    first, second = before.words(), after.words()
    return ", ".join(f"{key}={_plain(value)}" for key, value in second.items() if first.get(key) != value)


def plain_words(wish: Wish) -> str:
    """A wish as it would be typed after --for."""
    return ", ".join(f"{key}={_plain(value)}" for key, value in wish.words().items())


def _plain(value: Any) -> str:
    """A value as a person types it: whole numbers without a point."""
    if isinstance(value, list):
        return f"[{', '.join(_plain(item) for item in value)}]"
    return repr(value).removesuffix(".0") if isinstance(value, float) else str(value)


def _excess(tried: Tried) -> float:
    """How far failing numbers are beyond their limits, in limits."""
    return sum(
        abs(check.value - check.limit) / abs(check.limit) if check.limit else 1.0
        for check in tried.judged.failing
        if isinstance(check.value, float) and isinstance(check.limit, float)
    )


def _fault(check: Check) -> str:
    value, limit, unit, _ = shown(check.value, check.limit, check.relation, check.unit, check.state)
    return (
        f"{check.id}: {value}, and the limit is {check.relation} {limit} {unit}".rstrip()
        + f" ({check.source}); {check.sentence}"
    )
