"""Made parts as an instrument would give them, by formulas of their own: nothing here is imported from the
package.

A part is a lattice of conics with astigmatism about their own middles; the instrument turns and tilts it,
adds noise,
loses points, rounds nothing, and writes heights times its scale. Lengths in millimetres.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np


@dataclass
class Made:
    """A part and how it was measured."""

    radius: float = 2.468143364277402
    conic: float = 0.0
    astigmatism: float = 0.0  # A0, 1/mm
    pitch: tuple[float, float] = (0.5, 0.5)
    spread_radius: float = 0.0
    spread_middle: float = 0.0
    turn: float = 0.0
    tilt: tuple[float, float] = (0.0, 0.0)
    shift: tuple[float, float] = (0.0, 0.0)
    z_scale: float = 1.0
    pixel: float = 0.008
    size: int = 220
    noise: float = 20e-6
    lost: float = 0.01
    rim: float = 0.006
    spikes: int = 10
    dirt: int = 4
    hexagonal: bool = False
    bowls: bool = False
    scallop: tuple[float, float] = (0.0, 0.0)  # rms, period
    seed: int = 0
    rounds: int = 40  # most of them to where a pixel meets a tilted part
    cells: dict[tuple[int, int], tuple[float, float, float]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.random = np.random.default_rng(self.seed)
        side = self.size * self.pixel
        reach = int(side / min(self.pitch)) + 2
        for i in range(-reach, reach + 1):
            for j in range(-reach, reach + 1):
                x, y = self.random.normal(0.0, self.spread_middle, 2) if self.spread_middle else (0.0, 0.0)
                r = self.radius * (
                    1.0 + (self.random.normal(0.0, self.spread_radius) if self.spread_radius else 0.0)
                )
                self.cells[i, j] = (float(x), float(y), float(r))

    def steps(self) -> np.ndarray:
        """Columns: steps of the lattice."""
        p, q = self.pitch
        return (
            np.array([[p, 0.5 * p], [0.0, 0.75**0.5 * p]])
            if self.hexagonal
            else np.array([[p, 0.0], [0.0, q]])
        )

    def surface(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Height of the part, and the distance to the nearest seam."""
        steps = self.steps()
        near = np.rint(np.linalg.solve(steps, np.stack([x, y]).reshape(2, -1))).astype(int)
        best, second = np.full(x.size, np.inf), np.full(x.size, np.inf)
        who = near.copy()
        for di in (-1, 0, 1):
            for dj in (-1, 0, 1):
                cell = near + np.array([[di], [dj]])
                far = np.hypot(*(np.stack([x, y]).reshape(2, -1) - steps @ cell))
                closer = far < best
                second = np.where(closer, best, np.minimum(second, far))
                who[:, closer] = cell[:, closer]
                best = np.where(closer, far, best)
        numbers = np.array([self.cells.get((i, j), (0.0, 0.0, self.radius)) for i, j in who.T])
        u, v = np.stack([x, y]).reshape(2, -1) - steps @ who - numbers[:, :2].T
        c = 1.0 / numbers[:, 2]
        rr = u * u + v * v
        z = -c * rr / (1.0 + np.sqrt(1.0 - (1.0 + self.conic) * c * c * rr)) - self.astigmatism * (
            u * u - v * v
        )
        if self.scallop[0]:
            z = z + self.scallop[0] * np.sqrt(2.0) * np.cos(2.0 * np.pi * x.ravel() / self.scallop[1])
        seam = (second**2 - best**2) / (2.0 * min(self.pitch))
        return (-z if self.bowls else z).reshape(x.shape), seam.reshape(x.shape)

    def heights(self) -> np.ndarray:
        """Heights (rows, columns) in millimetres as the instrument gives them, NaN where a point was lost."""
        at = (np.arange(self.size) - self.size / 2.0) * self.pixel
        qx, qy = np.meshgrid(at, at)
        a, b = self.tilt
        turn = _about(2, self.turn) @ _about(0, a) @ _about(1, b)
        shift = np.array([*self.shift, 0.0])
        qz = np.zeros_like(qx)
        for _ in range(self.rounds):
            p = np.einsum("ji,jkl->ikl", turn, np.stack([qx, qy, qz]) - shift[:, None, None])
            z, seam = self.surface(p[0], p[1])
            step = (z - p[2]) / turn[2, 2]
            qz = qz + step
            if np.abs(step).max() < 1e-12:
                break
        out = self.z_scale * (qz + (self.random.normal(0.0, self.noise, qz.shape) if self.noise else 0.0))
        out[self.random.random(out.shape) < self.lost] = np.nan
        out[seam < self.rim] = np.nan
        for _ in range(self.spikes):
            out[tuple(self.random.integers(0, self.size, 2))] += 5e-4
        for _ in range(self.dirt):
            r, c = self.random.integers(0, self.size, 2)
            out[r : r + 4, c : c + 4] += 2e-3 * self.random.random(
                (len(out[r : r + 4]), out[r : r + 4, c : c + 4].shape[1])
            )
        return out

    def write(self, path: Path) -> Path:
        """Write a cloud (.xyz), or an NPY file and its scales next to it; its path."""
        z = self.heights()
        if path.suffix == ".xyz":
            row, column = np.nonzero(np.isfinite(z))
            table = np.column_stack([column * self.pixel, row * self.pixel, z[row, column]])
            np.savetxt(path, table, fmt=("%.6f", "%.6f", "%.9f"), header="unit mm")
            return path
        np.save(path, z)
        scales = {"pixel_mm": self.pixel, "z_step_mm": 1.0, "row_0": "bottom"}
        path.with_name(path.name + ".json").write_text(json.dumps(scales))
        return path


def _about(axis: int, angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    found = np.eye(3)
    i, j = [(1, 2), (2, 0), (0, 1)][axis]
    found[i, i] = found[j, j] = c
    found[i, j], found[j, i] = -s, s
    return found
