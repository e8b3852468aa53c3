"""Sheets whose plates move: direction, spread, share and orders of their light at every position.

`scan` moves plates and measures. The geometry of a moved plate is in `clacad.sheet.moved_plates`, files of a
scan are in `clacad.report.scan_files`. A sheet that turns as a whole does not belong here.
"""

from __future__ import annotations

from clacad.steering.scan import Position, Scan, Steered, steer

__all__ = ["Position", "Scan", "Steered", "steer"]
