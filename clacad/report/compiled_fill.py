"""Compiled filling of triangles with a depth buffer; imported only when the parts are pictured."""

from __future__ import annotations

from clacad.base.compiled import entry
from clacad.base.types import Floats


@entry
def fill(corners: Floats, bright: Floats, depth: Floats, shade: Floats) -> None:
    """Fill `shade` (h, w) with the brightness of the nearest of the triangles that face the eye.

    corners : (t, 3, 3)
        Pixels to the right, pixels downwards, height towards the eye; counter-clockwise seen by the eye.
    bright : (t, 3)
    depth, shade : (h, w)
    """
    tall, wide = depth.shape
    for k in range(len(corners)):
        ax, ay, az = corners[k, 0, 0], corners[k, 0, 1], corners[k, 0, 2]
        bx, by, bz = corners[k, 1, 0], corners[k, 1, 1], corners[k, 1, 2]
        cx, cy, cz = corners[k, 2, 0], corners[k, 2, 1], corners[k, 2, 2]
        area = (bx - ax) * (cy - ay) - (cx - ax) * (by - ay)
        if area >= 0.0:  # rows run downwards: seen from behind, or no area
            continue
        first, last = max(0, int(min(ay, by, cy))), min(tall - 1, int(max(ay, by, cy)) + 1)
        left, right = max(0, int(min(ax, bx, cx))), min(wide - 1, int(max(ax, bx, cx)) + 1)
        for row in range(first, last + 1):
            y = row + 0.5
            for column in range(left, right + 1):
                x = column + 0.5
                b = ((x - ax) * (cy - ay) - (cx - ax) * (y - ay)) / area
                c = ((bx - ax) * (y - ay) - (x - ax) * (by - ay)) / area
                a = 1.0 - b - c
                if a >= -1e-9 and b >= -1e-9 and c >= -1e-9:
                    z = a * az + b * bz + c * cz
                    if z > depth[row, column]:
                        depth[row, column] = z
                        shade[row, column] = a * bright[k, 0] + b * bright[k, 1] + c * bright[k, 2]
