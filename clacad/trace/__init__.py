"""Tracing rays: explicit sequences of surfaces (`sequence`) and whole windows."""

from __future__ import annotations

from clacad.trace.sequence import Interface, trace_sequence

__all__ = ["Interface", "trace_sequence"]
