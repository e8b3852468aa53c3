"""The loop of command, part, map and next command with a simulated maker and instrument: for tests and a table of the documentation."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from pathlib import Path

import numpy as np
from making.makers import Instrument, Lattice, Maker, interpolated

import clacad
from clacad.design import Design, load
from clacad.making.correction import correct
from clacad.measuring.light_through_form import law_rms_of_form
from clacad.measuring.measure import Maps, fitted_sides
from clacad.measuring.read_map import MeasuredMap

DESIGNS = Path(__file__).parents[2] / "designs"
PIXEL, SIZE = 0.006, 280
SURE = (1.0, 1e-4)
GOOD = Instrument()


@cache
def design(name: str) -> Design:
    return load(DESIGNS / f"{name}.toml", ("lattice.count = [8, 8]",))


def as_map(z: np.ndarray, pixel: float = PIXEL) -> MeasuredMap:
    """Map of heights (millimetres), without a file."""
    row, column = np.nonzero(np.isfinite(z))
    at = (np.stack([column, row]) - len(z) / 2.0) * pixel * 1e-3
    return MeasuredMap("map", np.vstack([at, z[row, column] * 1e-3]), (pixel * 1e-3, pixel * 1e-3), z.shape)


def made(of: Design, maker: Maker, heights: np.ndarray | None = None, size: int = SIZE) -> np.ndarray:
    """Part that a maker makes from a command, or from the spheres of window-100mm."""
    hexagonal = of.lattice.kind == "hexagonal"
    pitch = of.lattice.pitch[0]
    if heights is None:
        radius = 2.468143364277402

        def command(u: np.ndarray, v: np.ndarray) -> np.ndarray:
            return np.sqrt(radius**2 - u * u - v * v) - radius

    else:
        command = interpolated(heights, pitch, pitch * (2.0 / 3.0**0.5 if hexagonal else 1.0))
    return maker.field(command, Lattice(pitch, hexagonal), size, PIXEL)


def light(of: Design, z: np.ndarray, both: bool = False) -> float:
    """Error of the light through the formed surface of the front, or of both sides; its map has no noise."""
    window = clacad.prescribe(of)
    back = as_map(z) if both else None
    found, _, _ = fitted_sides(of, window, Maps(as_map(z), back, z_scale=1.0, lateral_scale=1.0))
    lit = {name: side.lit for name, side in found.items()}
    return law_rms_of_form(window, lit, of.check.field, of.check.field_centre)


@cache
def commanded(name: str) -> np.ndarray:
    """Command of a design itself: nothing is to be corrected."""
    return correct(design(name), as_map(perfect(design(name))), z_scale=SURE).heights


def parts(of: Design, maker: Maker, rounds: int, instrument: Instrument = GOOD) -> Iterator[np.ndarray]:
    """Parts as made from the design and after each correction."""
    state, command = None, commanded(of.name)
    for number in range(rounds + 1):
        z = made(of, maker, command)
        yield z
        if number < rounds:
            state = correct(of, as_map(instrument.measured(z, number)), previous=state, z_scale=SURE)
            command = state.heights


def loop(of: Design, maker: Maker, rounds: int) -> list[float]:
    """Errors of the light of these parts."""
    return [light(of, z) for z in parts(of, maker, rounds)]


def perfect(of: Design) -> np.ndarray:
    """Field of the design's own cells, by its faces."""
    face = clacad.prescribe(of).faces[0]
    at = (np.arange(SIZE) - SIZE / 2.0) * PIXEL
    x, y = np.meshgrid(at, at)
    u, v = Lattice(of.lattice.pitch[0], of.lattice.kind == "hexagonal").local(x, y)
    return np.asarray(-face.surface.sag(u, v))


def designed(of: Design) -> float:
    return light(of, perfect(of))
