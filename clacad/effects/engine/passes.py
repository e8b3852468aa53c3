"""Effects as passes over a block of rays, and the driver that runs them.

A trace without effects does not use this module. With effects, rays are traced a block at a time with their
hits. Every pass goes over the block once, and the block's rows are written to the result. The channels of a
pass (the hits) exist for one block at a time and only if some pass needs them.

Results of ray blocks, collected in the order of launch.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from threading import local
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clacad import effects as registry
from clacad.base.types import Floats, Rung
from clacad.effects import declared, declared_all
from clacad.effects.engine.effect import Effect, RayBlock, Setting, When, crossings
from clacad.optics.ledger import Ledger
from clacad.optics.rays import Rays, TraceResult
from clacad.sheet.face_order import media_of
from clacad.sheet.window import Window

Chosen = slice | NDArray[np.intp]

_ROOM = local()


class OrderedResult:
    """Results of blocks, stored in the order of launch."""

    def __init__(self, count: int, window: Window, direct: bool | None) -> None:
        """`direct`: the compiled tracer writes slices of the whole itself (True: with hits recorded).

        None: it does not.
        """
        self.count, self.window = count, window
        self.columns: dict[str, Any] = {}
        self.whole: TraceResult | None = None
        if direct is not None:
            made = Ledger.blank(count, 2 * len(window.bodies) if direct else 0)
            self.columns = {name: getattr(made, name) for name in Ledger.__slots__} | {"flux": np.ones(count)}
            if not direct:
                self.columns |= {"hits": None, "directions": None}

    def traced_with_losses(
        self, rows: slice, rays: Rays, wavelength: float | None, lossy: Sequence[Effect]
    ) -> TraceResult:
        """Trace a block with the losses on the way; rays that had to be walked get theirs afterwards."""
        from clacad.effects.engine.compiled_passes import Traced, losses_pass

        bodies = self.window.bodies
        media = media_of(self.window.bodies, wavelength)
        asked = [effect.losses(wavelength) for effect in lossy if effect.losses is not None]
        rates = np.zeros(len(bodies))
        for _, own in asked:
            rates[: len(own)] += own
        reflects = any(own for own, _ in asked)
        result = self.traced(rows, rays, media, 2 * len(bodies), 1, (float(reflects), *rates))
        hits, turns = result.hits, result.directions
        assert hits is not None
        assert turns is not None
        flux = result.flux
        flux[:] = turns[-1].reshape(-1)[: len(rays)]
        traced = Traced(
            rays.position, rays.direction, hits, turns, result.fate, result.surface, np.array(media)
        )
        losses_pass(traced, rates, reflects, flux)
        return replace(result, hits=None, directions=None)

    def traced(
        self,
        rows: slice,
        rays: Rays,
        media: tuple[float, ...],
        faces: int,
        more: int = 0,
        losses: tuple[float, ...] = (),
    ) -> TraceResult:
        """Trace a block into its slice, with the hits at the first `faces` faces kept.

        See `Packed` for the media and losses.
        """
        from clacad.tracing.compiled.chunk import trace_compiled
        from clacad.tracing.layout import lay_out

        own = {
            name: column[rows] for name, column in self.columns.items() if name not in ("hits", "directions")
        }
        for name in ("hits", "directions"):
            whole = self.columns[name]
            layers = faces + (more if name == "directions" else 0)
            own[name] = self.lent(name, layers, len(rays)) if whole is None else whole[:, rows]
        ledger = Ledger(**own)
        trace_compiled(lay_out(self.window), rays, ledger, np.arange(len(rays)), media, 1, losses=losses)
        return ledger.closed()

    def lent(self, name: str, faces: int, count: int) -> Floats:
        """Buffer (faces, count, 3) for a block's hits, kept by the thread: allocating costs a pass's time."""
        size = faces * count * 3
        room: Floats | None = getattr(_ROOM, name, None)
        if room is None or len(room) < size:
            room = np.empty(size)
            setattr(_ROOM, name, room)
        return room[:size].reshape(faces, count, 3)

    def enter(self, rows: Chosen, result: TraceResult, record: bool) -> None:
        """Write a block's rows."""
        if len(result) == self.count:
            self.whole = result if record else replace(result, hits=None, directions=None)
            return
        for name in TraceResult.__dataclass_fields__:
            kept = name in ("hits", "directions")
            if kept and not record:
                self.columns[name] = None
                continue
            block = getattr(result, name)
            if name not in self.columns:
                shape = (len(block), self.count, 3) if kept else (self.count, *block.shape[1:])
                self.columns[name] = np.empty(shape, dtype=block.dtype)
            if kept:
                self.columns[name][:, rows] = block
            else:
                self.columns[name][rows] = block

    def closed(self) -> TraceResult:
        """All rows."""
        return TraceResult(**self.columns) if self.whole is None else self.whole


BLOCK = 8192
"""Number of rays at a time: the hits of four faces take 1.5 MB."""

LIGHT_BLOCK = 65536
"""Number of rays at a time where hits are kept of few rays only."""


Place = tuple[Chosen, float | None]
"""Rows of a block, and the wavelength (metres) of all its rays or None."""


def resolve(names: Sequence[str | Effect], window: Window, setting: Setting | None = None) -> list[Effect]:
    """Effects of given names, in the order in which they must run; modules not named are not imported.

    Raises ValueError: An unknown name.
    """
    named = tuple(name if isinstance(name, str) else name.name for name in names)
    setting = replace(setting or Setting(), active=named)
    found: dict[str, Effect] = {}
    for name in names:
        if isinstance(name, str):
            found[name] = declared(name).effect(window, setting)
        else:
            found[name.name] = name
    for included in {name for kind in declared_all(found) for name in kind.includes}:
        found.pop(included, None)
    return sorted(
        found.values(), key=lambda e: (e.when.value, declared(e.name).follows, registry.NAMES.index(e.name))
    )


def trace_with(
    window: Window,
    rays: Rays,
    rung: Rung,
    effects: Sequence[str | Effect],
    record: bool = False,
    setting: Setting | None = None,
    **options: Any,
) -> TraceResult:
    """Trace rays with effects; see `clacad.trace`.

    Parameters
    ----------
    effects : names or `Effect`
    setting : Setting
        Parameters of effects given by name.
    options
        Passed on to `trace`.

    Returns
    -------
    TraceResult
        One row per ray, as without effects; fate, cell, order and surface are unchanged.
    """
    from clacad.tracing.trace import trace

    resolved = resolve(effects, window, setting)
    for effect in resolved:
        if effect.rung is not None and rung != "mesh":
            rung, options = effect.rung, {**options, **effect.options}
        if effect.launch is not None:
            rays = effect.launch(window, rays)
    passes = [effect for effect in resolved if effect.apply is not None]
    if not passes:
        return trace(window, rays, rung, record=record, **options)
    threads, options["path"] = _workers(window, rays, rung, options)
    run_block = _BlockRun.of(window, rays, rung, passes, record, options)
    places = list(blocks(rays, any(effect.colours for effect in passes), run_block.size))
    _run_on_threads(run_block, places, threads)
    return run_block.gathered.closed()


def _run_on_threads(run_block: _BlockRun, places: list[Place], threads: int) -> None:
    """Run the blocks at these places; on one thread if there is little work."""
    run_block(places[0])  # its columns define those of the others
    if threads == 1 or len(places) <= 2:
        for place in places[1:]:
            run_block(place)
        return
    from concurrent.futures import ThreadPoolExecutor

    with ThreadPoolExecutor(threads) as pool:
        list(pool.map(run_block, places[1:]))


@dataclass(frozen=True, eq=False)
class _BlockRun:
    """Tracing of each block, and its passes.

    passes : those that change columns; `lossy` of them run inside the compiled tracer, then `others` run
    keep : whether hits are kept while a block is processed; `record`: also in the result
    fast : whether compiled code writes slices of the whole
    options : of `trace`
    """

    window: Window
    rays: Rays
    rung: Rung
    passes: list[Effect]
    lossy: list[Effect]
    others: list[Effect]
    record: bool
    keep: bool
    fast: bool
    options: dict[str, Any]
    gathered: OrderedResult

    @classmethod
    def of(
        cls,
        window: Window,
        rays: Rays,
        rung: Rung,
        passes: list[Effect],
        record: bool,
        options: dict[str, Any],
    ) -> _BlockRun:
        """Choose the way of tracing; `options["path"]` is "numba" or "numpy"."""
        fast = options["path"] == "numba" and rung == "surfaces" and window.uniform
        lossy = [effect for effect in passes if effect.losses is not None]
        others = [effect for effect in passes if effect.losses is None]
        if not fast or record or any("hits" in effect.needs for effect in others):
            lossy, others = [], passes
        keep = record or any("hits" in effect.needs for effect in passes)
        gathered = OrderedResult(len(rays), window, record if fast else None)
        return cls(window, rays, rung, passes, lossy, others, record, keep, fast, options, gathered)

    @property
    def size(self) -> int:
        """Number of rays in a block."""
        return LIGHT_BLOCK if self.lossy else BLOCK

    def __call__(self, place: Place) -> None:
        """Trace the block at these rows, of one wavelength or none, and write its columns."""
        rows, wavelength = place
        window, part = self.window, take_rays(self.rays, rows)
        if self.fast and isinstance(rows, slice):
            if self.lossy:
                result = self.gathered.traced_with_losses(rows, part, wavelength, self.lossy)
            else:
                media, faces = media_of(window.bodies, wavelength), 2 * len(window.bodies) if self.keep else 0
                result = self.gathered.traced(rows, part, media, faces)
            run(self.others, RayBlock(window, part, result, self.rung, wavelength, compiled=True))
            return
        from clacad.tracing.trace import trace

        result = trace(window, part, self.rung, record=self.keep, threads=1, **self.options)
        if not result.flux.flags.writeable:
            result = replace(result, flux=result.flux.copy())
        compiled = self.options["path"] == "numba"
        run(self.passes, RayBlock(window, part, result, self.rung, wavelength, compiled))
        self.gathered.enter(rows, result, self.record)


def _workers(window: Window, rays: Rays, rung: Rung, options: dict[str, Any]) -> tuple[int, str]:
    """Threads for the blocks and the tracer's path, as `trace` would choose them for all rays together."""
    from clacad.tracing.layout import lay_out
    from clacad.tracing.which_path import compiled_suits

    threads, path = options.pop("threads", None), options.pop("path", None)
    if rung in ("law", "thin"):
        return 1, "numpy"
    if rung == "mesh" and path is None:  # as a trace without effects
        path = "numba"
    if not compiled_suits(rung, path, len(rays), 2 * len(window.bodies), lay_out(window)):
        return 1, "numpy"
    from clacad.tracing.compiled.threads import thread_count

    return thread_count(threads), "numba"


def run(passes: Sequence[Effect], block: RayBlock) -> None:
    """Run the passes over one block."""
    at_hits = [e for e in passes if e.when is When.HIT]
    fast = [e.compiled for e in at_hits if block.compiled and e.compiled is not None]
    slow = [
        e.apply for e in at_hits if e.apply is not None and not (block.compiled and e.compiled is not None)
    ]
    for whole in fast:
        whole(block)
    if slow:
        for crossing in crossings(block):
            for apply in slow:
                apply(block, crossing)
    for effect in passes:
        if effect.finish is not None:
            effect.finish(block)
        if effect.when is When.EXIT and effect.apply is not None:
            effect.apply(block, None)


def blocks(rays: Rays, by_colour: bool, size: int = BLOCK) -> Iterator[Place]:
    """Rows of rays a block at a time, each of one wavelength if required."""
    if rays.wavelength is None or not by_colour or len(rays) == 0:
        for first in range(0, max(len(rays), 1), size):
            yield slice(first, min(first + size, len(rays))), None
        return
    if one_colour(rays):
        first_wave = float(rays.wavelength[0])
        for first in range(0, len(rays), size):
            yield slice(first, min(first + size, len(rays))), _real(first_wave)
        return
    waves, which = np.unique(rays.wavelength, return_inverse=True)
    for k, wave in enumerate(waves):
        rows = np.flatnonzero(which == k)
        for first in range(0, len(rows), size):
            yield rows[first : first + size], _real(float(wave))


def one_colour(rays: Rays) -> bool:
    """Whether rays have a wavelength, and all the same one."""
    waves = rays.wavelength
    return waves is not None and len(waves) > 0 and bool((waves == waves[0]).all())


def _real(wave: float) -> float | None:
    """A valid wavelength, or None: rays without one are INVALID anyway."""
    return wave if np.isfinite(wave) and wave > 0.0 else None


def take_rays(rays: Rays, rows: Chosen) -> Rays:
    """Select rays."""
    waves = None if rays.wavelength is None else rays.wavelength[rows]
    return Rays(rays.position[rows], rays.direction[rows], waves)
