"""Angles and stretches that acos and plain quotients lose; each with its reason."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class HardAngle:
    """Two directions and why the angle between them is hard."""

    name: str
    why: str
    first: tuple
    second: tuple


@dataclass(frozen=True)
class HardView:
    """An upright law's (η_x, η_y), an object's distance, the camera's, and why the stretch is hard."""

    name: str
    why: str
    eta: tuple[float, float]
    z: float
    camera: float


ANGLES = [
    HardAngle("1e-4 rad", "acos(1 - 5e-9) keeps eight digits", (0, 0, 1), (1e-4, 0, 1)),
    HardAngle("1e-8 rad", "acos sees 0 or 2e-8", (0, 0, 1), (1e-8, 0, 1)),
    HardAngle("1e-12 rad", "acos sees nothing", (0.3, 0.1, 1), (0.3 + 1e-12, 0.1, 1)),
    HardAngle("1e-16 rad", "the cross product's terms are rounded before they cancel", (0.3, 0.1, 1), (0.3 + 5.551115123125783e-17, 0.1, 1)),
    HardAngle("1e-200 rad", "the sine's square underflows", (0, 0, 1), (1e-200, 0, 1)),
    HardAngle("nearly opposite", "acos near -1", (0, 0, 1), (1e-9, 0, -1)),
    HardAngle("lengths 1e200 and 1e-200", "products of the lengths", (3e199, 0, 1e200), (3e-201, 1e-210, 1e-200)),
    HardAngle("right angle", "asin near 1 would lose what acos keeps", (1, 0, 1e-12), (0, 1, 0)),
]  # fmt: skip

PAPER = (-0.25, -1.0)
VIEWS = [
    HardView("object on the sheet", "the stretch is 1", PAPER, 0.0, 20.0),
    HardView("object 1e-12 behind", "z/η beside D", PAPER, 1e-12, 20.0),
    HardView("z_k = 10", "the paper's own", PAPER, 10.0, 20.0),
    *(HardView(f"z_k = 5 {sign:+.0e}", "the first pole: the stretch changes sign through infinity", PAPER, 5 + sign, 20.0) for sign in (-1e-12, 1e-12)),
    *(HardView(f"z_k = 20 {sign:+.0e}", "the second pole", PAPER, 20 + sign, 20.0) for sign in (-1e-12, 1e-12)),
    HardView("one place before the pole", "the smallest step a double can take", PAPER, 4.999999999999999, 20.0),
    HardView("pole of η = -0.3", "η is no double: D + z/η and a rounded Dη + z are rounding only", (-0.3, -0.7), 6.0, 20.0),
    HardView("object at 1e15", "D beside z is lost", PAPER, 1e15, 20.0),
    HardView("eta 1e-6", "z/η is a million times z", (-1e-6, 1e-6), 3.0, 20.0),
    HardView("eta 1e6", "z/η is nothing beside D", (-1e6, 1e6), 3.0, 20.0),
]  # fmt: skip
