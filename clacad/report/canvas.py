"""A little drawing board for dimensioned drawings: shapes, dimension lines with numbers, leaders; plain SVG."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

import numpy as np

from clacad.base.types import Floats

Point = tuple[float, float]

CHARACTER = 6.3
"""Width of a character of the 11 px type, on average, px."""

STYLE = (
    "text{font:11px system-ui,'Segoe UI',Helvetica,Arial,sans-serif;fill:#1c2733}.note{fill:#5c6b78}.title{font-weight:bold}"
    ".body{fill:#cfe3f1;stroke:#1b6ca8;stroke-width:1}.cut{fill:#e3eff7;stroke:#1b6ca8;stroke-width:1}"
    ".dim{stroke:#1c2733;stroke-width:.8;fill:none}.ext{stroke:#8b98a5;stroke-width:.6;fill:none}"
    ".axis{stroke:#8b98a5;stroke-width:.8;stroke-dasharray:9 3 2 3;fill:none}.ray{stroke:#c2571a;stroke-width:.9;fill:none}"
    ".focus{stroke:#2b7a4b;stroke-width:1;stroke-dasharray:4 3;fill:none}.head{fill:#1c2733}.mark{fill:#c2571a}"
)


class Canvas:
    """Drawing board in pixels, y downwards."""

    def __init__(self, width: float, height: float, label: str) -> None:
        self.width, self.height, self.label = width, height, label
        self._parts: list[str] = []

    def polygon(self, points: Floats, kind: str) -> None:
        """Draw a closed outline (k, 2)."""
        self._parts.append(f'<polygon class="{kind}" points="{_points(points)}"/>')

    def line(self, points: Floats | Sequence[Point], kind: str) -> None:
        """Draw a line through points (k, 2)."""
        self._parts.append(f'<polyline class="{kind}" points="{_points(np.asarray(points))}"/>')

    def circle(self, at: Point, radius: float, kind: str) -> None:
        """Draw a circle."""
        self._parts.append(f'<circle class="{kind}" cx="{at[0]:.1f}" cy="{at[1]:.1f}" r="{radius:.1f}"/>')

    def text(self, at: Point, words: str, anchor: str = "middle", kind: str = "") -> None:
        """Write words; `anchor` is start, middle or end."""
        named = f' class="{kind}"' if kind else ""
        self._parts.append(
            f'<text{named} x="{at[0]:.1f}" y="{at[1]:.1f}" text-anchor="{anchor}">{escape(words)}</text>'
        )

    def across(self, x0: float, x1: float, y: float, words: str, start: tuple[float, float]) -> None:
        """Dimension between two x at height y; extension lines come from `start` (y at x0, y at x1)."""
        for x, from_y in zip((x0, x1), start, strict=True):
            self.line([(x, from_y), (x, y + (4 if y > from_y else -4))], "ext")
        room = abs(x1 - x0)
        wide = CHARACTER * len(words)
        self._measure((x0, y), (x1, y), inside=room > 26)
        if room > wide + 18:
            self._words((0.5 * (x0 + x1), y - 4), words, "middle")
        elif max(x0, x1) + wide + 22 < self.width:
            self._words((max(x0, x1) + (4 if room > 26 else 16), y + 4), words, "start")
        else:
            self._words((min(x0, x1) - (4 if room > 26 else 16), y + 4), words, "end")

    def upright(self, y0: float, y1: float, x: float, words: str, start: tuple[float, float]) -> None:
        """Dimension between two y at place x; extension lines come from `start` (x at y0, x at y1)."""
        for y, from_x in zip((y0, y1), start, strict=True):
            self.line([(from_x, y), (x + (4 if x > from_x else -4), y)], "ext")
        room = abs(y1 - y0)
        self._measure((x, y0), (x, y1), inside=room > 26)
        right = x >= 0.5 * self.width
        middle = 0.5 * (y0 + y1) if room > 14 else min(y0, y1) - 16
        self._words((x + (5 if right else -5), middle + 4), words, "start" if right else "end")

    def leader(self, tip: Point, elbow: Point, words: str, anchor: str = "start") -> None:
        """Words at the end of a line that points at something."""
        self.line([elbow, tip], "dim")
        self._head(tip, np.subtract(tip, elbow))
        if words:
            self._words((elbow[0] + (3 if anchor == "start" else -3), elbow[1] + 4), words, anchor)

    def _measure(self, a: Point, b: Point, inside: bool) -> None:
        way = np.subtract(b, a)
        length = float(np.hypot(*way))
        if length == 0.0:
            return
        unit = way / length
        if inside:
            self.line([a, b], "dim")
            self._head(a, -unit)
            self._head(b, unit)
            return
        self.line([tuple(np.asarray(a) - 14 * unit), a], "dim")
        self.line([b, tuple(np.asarray(b) + 14 * unit)], "dim")
        self._head(a, unit)
        self._head(b, -unit)

    def _head(self, tip: Point, way: Floats) -> None:
        unit = np.asarray(way, dtype=np.float64)
        unit = unit / max(float(np.hypot(*unit)), 1e-9)
        aside = np.array([-unit[1], unit[0]])
        corners = np.array([tip, tip - 7 * unit + 2.2 * aside, tip - 7 * unit - 2.2 * aside])
        self._parts.append(f'<polygon class="head" points="{_points(corners)}"/>')

    def _words(self, at: Point, words: str, anchor: str) -> None:
        wide = CHARACTER * len(words)
        left = at[0] - {"start": 0.0, "middle": 0.5 * wide, "end": wide}[anchor]
        self._parts.append(
            f'<rect x="{left - 1:.1f}" y="{at[1] - 10:.1f}" width="{wide + 2:.1f}" height="13" fill="#fff" fill-opacity=".85"/>'
        )
        self.text(at, words, anchor)

    def svg(self) -> str:
        """The drawing as one element that says what it shows."""
        body = "\n".join(self._parts)
        rules = "".join(f".drawing {rule}}}" for rule in STYLE.split("}") if rule)
        return (
            f'<svg xmlns="http://www.w3.org/2000/svg" class="drawing" viewBox="0 0 {self.width:.0f} {self.height:.0f}" '
            f'width="{self.width:.0f}" height="{self.height:.0f}" role="img" aria-label="{escape(self.label, quote=True)}">'
            f"<style>{rules}</style>\n{body}\n</svg>"
        )


def _points(points: Floats) -> str:
    return " ".join(f"{x:.2f},{y:.2f}" for x, y in np.asarray(points, dtype=np.float64))
