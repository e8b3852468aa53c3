"""Frames of an animation: the values of animated keys at a given time."""

from __future__ import annotations

from typing import Any

from clacad.base.text import plain
from clacad.scene.sections import Animation, Move


def value_at(move: Move, time: float) -> Any:
    """Value of an animated key at a time 0 … 1, interpolated linearly between the given values."""
    if move.ease == "smooth":
        time = time * time * (3.0 - 2.0 * time)
    times, values = move.times, move.values
    last = len(times) - 1
    k = next((k for k in range(last) if time <= times[k + 1]), last - 1)
    span = times[k + 1] - times[k]
    share = min(1.0, max(0.0, (time - times[k]) / span))
    here, there = values[k], values[k + 1]
    if share in (0.0, 1.0):  # the written value itself, without rounding
        return plain(there if share == 1.0 else here, float)
    if isinstance(here, tuple):
        return [a + (b - a) * share for a, b in zip(here, there, strict=True)]
    return here + (there - here) * share


def time_of(animation: Animation, frame: int) -> float:
    """Time 0 … 1 of a frame; the first frame is at 0, the last at 1."""
    if not 0 <= frame < animation.frames:
        raise ValueError(f"frame {frame} of {animation.frames}: frames are numbered from 0")
    return frame / (animation.frames - 1)


def values_at(animation: Animation, frame: int) -> dict[str, Any]:
    """Animated key → value in a frame."""
    time = time_of(animation, frame)
    return {move.key: value_at(move, time) for move in animation.moves}
