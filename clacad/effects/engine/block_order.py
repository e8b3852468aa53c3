"""Results of ray blocks, collected in the order of launch."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from threading import local
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clacad.base.types import Floats
from clacad.effects.engine.block import around
from clacad.effects.engine.effect import Effect
from clacad.optics.rays import Rays, TraceResult
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
            faces = 2 * len(window.bodies) if direct else 0
            self.columns = {
                "position": np.empty((count, 3)), "direction": np.empty((count, 3)),
                "fate": np.empty(count, dtype=np.uint8), "optical_path": np.empty(count),
                "cell": np.empty((count, 2), dtype=np.int32), "order": np.empty((count, 2), dtype=np.int32),
                "surface": np.empty(count, dtype=np.int32), "flux": np.ones(count),
                "hits": np.empty((faces, count, 3)) if direct else None,
                "directions": np.empty((faces, count, 3)) if direct else None,
            }  # fmt: skip

    def traced_in_place(self, rows: slice, rays: Rays, wavelength: float | None, keep: bool) -> TraceResult:
        """Trace a block by the compiled kernels straight into its slice; its hits may be kept for it alone."""
        indices = tuple(body.index_at(wavelength) for body in self.window.bodies)
        return self.traced(rows, rays, indices, 2 * len(self.window.bodies) if keep else 0)

    def traced_with_losses(
        self, rows: slice, rays: Rays, wavelength: float | None, lossy: Sequence[Effect]
    ) -> TraceResult:
        """Trace a block with the losses on the way; rays that had to be walked get theirs afterwards."""
        from clacad.effects.engine.compiled_passes import Traced, losses_pass

        bodies = self.window.bodies
        indices = tuple(body.index_at(wavelength) for body in bodies)
        asked = [effect.losses(wavelength) for effect in lossy if effect.losses is not None]
        rates = np.zeros(len(bodies))
        for _, own in asked:
            rates[: len(own)] += own
        reflects = any(own for own, _ in asked)
        result = self.traced(rows, rays, (*indices, float(reflects), *rates), 2 * len(bodies), 1)
        hits, turns = result.hits, result.directions
        assert hits is not None
        assert turns is not None
        flux = result.flux
        flux[:] = turns[-1].reshape(-1)[: len(rays)]
        traced = Traced(
            rays.position, rays.direction, hits, turns, result.fate, result.surface, np.array(around(indices))
        )
        losses_pass(traced, rates, reflects, flux)
        return replace(result, hits=None, directions=None)

    def traced(
        self, rows: slice, rays: Rays, indices: tuple[float, ...], faces: int, more: int = 0
    ) -> TraceResult:
        """Trace a block into its slice, with the hits at the first `faces` faces kept.

        See `trace_chunk` for the indices.
        """
        from clacad.tracing.compiled.surfaces import trace_compiled
        from clacad.tracing.layout import lay_out
        from clacad.tracing.ledger import Ledger

        own = {
            name: column[rows] for name, column in self.columns.items() if name not in ("hits", "directions")
        }
        for name in ("hits", "directions"):
            whole = self.columns[name]
            layers = faces + (more if name == "directions" else 0)
            own[name] = self.lent(name, layers, len(rays)) if whole is None else whole[:, rows]
        ledger = Ledger(**own)
        trace_compiled(lay_out(self.window), rays, ledger, np.arange(len(rays)), indices, 1)
        return ledger.closed()

    def lent(self, name: str, faces: int, count: int) -> Floats:
        """Buffer (faces, count, 3) for a block's hits, reused by the thread: allocating costs a pass's time."""
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
