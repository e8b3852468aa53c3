"""Saying before a long command how long it will take, and noting afterwards how long it took."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from clacad.base.machine_rates import Clock, Rates, Span, processor_seconds
from clacad.cli.console import say

WORTH_SAYING = 2.0
"""Processor seconds from which a forecast is said."""

MEASURED = 1.3
"""Factor by which a part of some work tells what the whole takes."""


@contextmanager
def forecast(
    task: str, modelled: float, *, quiet: bool, clock: Clock = processor_seconds, measured: bool = False
) -> Iterator[Span]:
    """Say what the block will cost on this machine, then note what it did cost.

    A run in which kernels were compiled is not noted: the next one will not be like it.

    Parameters
    ----------
    task : str
        Name under which it is noted.
    modelled : float
        Seconds by the model of the reference machine.
    quiet : bool
    clock : callable
        Processor seconds so far.
    measured : bool
        `modelled` was measured here on a part of the work, and is what all of it takes within MEASURED; where such
        work was done before, what it took then corrects that.
    """
    rates = Rates.here()
    span = rates.span(task, modelled)
    if measured and span.seen == 0:
        span = Span(modelled / MEASURED, modelled * MEASURED)
    if span.high >= WORTH_SAYING:
        say(f"this takes {span} of processor time", quiet=quiet)
    kept, began = _kernels(), clock()
    yield span
    if _kernels() == kept:
        rates.note(task, modelled, clock() - began)


def tell_compiling(task: str, modelled: float, *, quiet: bool) -> None:
    """Say what compiling takes that comes on top of a forecast, in processor seconds of the reference machine; nothing of 0."""
    if modelled > 0.0:
        takes = Rates.here().span(task, modelled)
        say(f"what traces is compiled on the way, once on this machine: {takes} more", quiet=quiet)


def _kernels() -> frozenset[tuple[Path, int]]:
    """Compiled kernels that are kept, of every package, and from when each is."""
    from clacad.doctor import kernel_cache

    beside = Path(__file__).parent.parent.glob("**/__pycache__/*.nbc")
    found = set()
    for kept in {*kernel_cache()[1], *beside}:
        with suppress(OSError):  # another process replaces it
            found.add((kept, kept.stat().st_mtime_ns))
    return frozenset(found)
