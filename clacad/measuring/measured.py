"""The result of a measurement: lenslets, light and verdict of a part as an instrument measured it; files."""

from __future__ import annotations

import csv
import io
import json
import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from clacad.base.interactive import Tabular, columns_of
from clacad.base.text import mrad_text, percent_text, plain, table
from clacad.base.types import Floats
from clacad.base.units import millimetres
from clacad.checks.check import Check, short_table
from clacad.checks.file_kinds import CANNOT_SAY
from clacad.measuring.fit_lenslets import FIRST, NAMES, conic
from clacad.measuring.form_and_seams import Surface
from clacad.measuring.light_through_form import FormLight
from clacad.measuring.scales import Scale
from clacad.measuring.sides import Name, Side
from clacad.storage.atomic import canonical_json, write_set

if TYPE_CHECKING:
    from clacad.design import Design
    from clacad.sheet.window import Window

FORMAT = 1
Verdict = Literal["pass", "fail", "cannot say"]


@dataclass(frozen=True, eq=False)
class Measured(Tabular):
    """A made part as measured.

    Attributes
    ----------
    design : Design
    sides : mapping of "front", "back" to Surface
        Measured sides; the others are as designed.
    z_scale, lateral_scale : Scale
    light : FormLight
        Through the measured form.
    texture_share : float
        Share of light that the texture of the measured sides leaves undisturbed; NaN where its phase is
        above 1 rad.
    checks : tuple of Check
    """

    design: Design
    sides: Mapping[Name, Surface]
    z_scale: Scale
    lateral_scale: Scale
    light: FormLight
    texture_share: float
    checks: tuple[Check, ...]

    def __repr__(self) -> str:
        """Short table: numbers of each side, checks that did not pass, and the verdict last."""
        rows = [(name, f"R {r:.6g} +- {u:.2g}, K {k:+.3f}") for name, (r, u, k) in self.radii().items()]
        return "\n".join([self.design.name, table(rows), short_table(self.checks), self.summary])

    @property
    def subject(self) -> str:
        """Names of the files."""
        return ", ".join(dict.fromkeys(one.measured.name for one in self.sides.values()))

    @property
    def verdict(self) -> Verdict:
        """Whether light through the part obeys the law: the worst of the checks that are required."""
        needed = [one for one in self.checks if one.required]
        if any(one.state == "fail" for one in needed):
            return "fail"
        return "cannot say" if any(one.state == "not run" for one in needed) else "pass"

    @property
    def summary(self) -> str:
        """The verdict in a sentence."""
        light = self.light
        said = (
            f"{self.verdict}: light through the measured form leaves {mrad_text(light.rms, 3)} rms from the"
            f" law (between {mrad_text(light.low, 3, unit='')} and {mrad_text(light.high, 3)})"
        )
        doubt = [one.detail[CANNOT_SAY] for one in self.checks if CANNOT_SAY in one.detail]
        return f"{said}; {doubt[0]}" if doubt and self.verdict == "cannot say" else said

    def radii(self) -> dict[Name, tuple[float, float, float]]:
        """Mean radius of each side, its standard uncertainty, and mean conic constant."""
        return {name: mean_radius(one, self.u_radius) for name, one in self.sides.items()}

    @property
    def u_radius(self) -> float:
        """Relative standard uncertainty of radii that both scales cause."""
        return 0.5 * next(iter(self.sides.values())).lit.u_scale

    def to_columns(self) -> dict[str, Any]:
        """One row for each lenslet."""
        return columns_of(
            [
                {key: row[key] for key in row if key != "cell"} | _split(row)
                for name, one in self.sides.items()
                for row in _rows(name, one, self.u_radius)
            ]
        )

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready content: lengths in the design's unit, angles in radians, standard uncertainties as
        `u_…`.
        """
        first = next(iter(self.sides.values()))
        light = self.light
        found = {
            "format": FORMAT,
            "design": {"name": self.design.name, "sha256": self.design.sha256, "unit_m": self.design.unit_m},
            "lenslets": [r for n, one in self.sides.items() for r in _rows(n, one, self.u_radius)],
            **_pose(first),
            "sides": {name: self._side(name, one) for name, one in self.sides.items()},
            "z_scale": self.z_scale.value,
            "u_z_scale": 0.5 * self.z_scale.half,
            "z_scale_origin": self.z_scale.origin,
            "lateral_scale": self.lateral_scale.value,
            "u_lateral_scale": 0.5 * self.lateral_scale.half,
            "law_rms": light.rms,
            "u_law_rms": light.u_rms,
            "law_rms_range": [light.low, light.high],
            "law_rms_by_cell": light.by_cell,
            "cells_lit": [list(cell) for cell in light.cells],
            "formed_share": light.formed,
            "seam_share": light.seam,
            "texture_share": self.texture_share,
            "as_designed": [*(name for name in ("front", "back") if name not in self.sides), "bodies"],
            "verdict": self.verdict,
            "sentence": self.summary,
            "checks": [check.to_dict() for check in self.checks],
        }
        return dict(plain(found))

    def _side(self, name: Name, one: Surface) -> dict[str, Any]:
        """Numbers of one side."""
        radius, u, constant = mean_radius(one, self.u_radius)
        half = one.lenslets.aperture.reach.min()
        return {
            **_pose(one),
            "first_cell": list(one.lit.cells.first),
            "first_cell_known_by": list(one.lit.cells.known),
            "file": one.measured.name,
            "pixel": list(one.measured.pixel),
            "missing": one.measured.missing,
            "whole_lenslets": len(one.lenslets.index),
            "radius": radius,
            "u_radius": u,
            "conic": constant,
            "aperture": 2.0 * half,
            "sq": one.texture,
            "noise": one.noise,
            "lattice": [one.lenslets.lattice.origin, *one.lenslets.lattice.basis.T],
            "level": one.lenslets.level,
            "plane": one.lenslets.plane,
        }


def mean_radius(one: Surface, relative: float) -> tuple[float, float, float]:
    """Mean radius, its standard uncertainty, and mean conic constant of a side, each lenslet by its weight.

    relative : Standard uncertainty of all radii together that scales cause.
    """
    values, u = one.lenslets.values, one.lenslets.u
    weight = 1.0 / (u[:, 3] ** 2 + np.var(values[:, 3]))
    curvature = float(np.average(values[:, 3], weights=weight))
    own = float(np.sqrt(np.sum((weight * u[:, 3]) ** 2)) / weight.sum() / abs(curvature))
    weight = 1.0 / (u[:, 4] ** 2 + np.var(values[:, 4]))
    constant = float(np.average(values[:, 4], weights=weight))
    return 1.0 / curvature, float(np.hypot(own, relative)) / abs(curvature), constant


def _pose(one: Surface) -> dict[str, Any]:
    """Pitch, turn and tilt of a side with their standard uncertainties."""
    lens = one.lenslets
    turn, a, b = lens.pose
    middle, along = np.ones((len(lens.index), 1)), lens.lattice.basis[:, 0] / lens.pitch[0]
    spread = np.linalg.pinv(np.hstack([middle, lens.index]))[1:]
    u = np.linalg.norm(spread, axis=1) * np.sqrt(np.mean(lens.u[:, :2] ** 2))
    places = lens.index @ lens.lattice.basis.T @ np.array([along, [-along[1], along[0]]]).T
    tilts = np.linalg.norm(np.linalg.pinv(np.hstack([middle, places]))[:0:-1] * lens.u[:, 2], axis=1)
    x, y = lens.lattice.basis.T
    skew = float(np.arcsin(np.clip(x @ y / (np.linalg.norm(x) * np.linalg.norm(y)), -1.0, 1.0)))
    return {
        "pitch": list(lens.pitch),
        "u_pitch": u.tolist(),
        "turn": turn,
        "u_turn": float(u[0] / lens.pitch[0]),
        "tilt": [a, b],
        "u_tilt": tilts.tolist(),
        "skew": skew,
    }


def _rows(name: Name, one: Surface, relative: float) -> list[dict[str, Any]]:
    """One mapping for each lenslet of a side."""
    lens = one.lenslets
    values, u = lens.values, lens.u
    along = lens.lattice.basis[:, 0] / np.linalg.norm(lens.lattice.basis[:, 0])
    turn = np.array([[along[0], along[1]], [-along[1], along[0]]])
    middles = lens.index @ lens.lattice.basis.T @ turn.T + values[:, :2]
    own = one.lit.cells.of(lens.index)
    rows = []
    for k, (i, j) in enumerate(lens.index.tolist()):
        of = dict(zip(NAMES, values[k], strict=True))
        radius = 1.0 / of["curvature"] if of["curvature"] else float("nan")
        rows.append(
            {
                "side": name,
                "i": i,
                "j": j,
                "cell": own[k].tolist(),
                "x": middles[k, 0],
                "y": middles[k, 1],
                "z": of["z"],
                "radius": radius,
                "conic": of["conic"],
                "astigmatism": [2.0 * of["astigmatism"], 2.0 * of["astigmatism_45"]],
                "sq": one.sq[k],
                "u_x": u[k, 0],
                "u_y": u[k, 1],
                "u_z": u[k, 2],
                "u_radius": float(np.hypot(u[k, 3] * radius, relative)) * abs(radius),
                "u_conic": float(np.hypot(u[k, 4], 2.0 * relative * abs(1.0 + of["conic"]))),
                "u_astigmatism": [2.0 * u[k, 5], 2.0 * u[k, 6]],
                "u_sq": one.u_sq[k],
            }
        )
    return rows


def _split(row: Mapping[str, Any]) -> dict[str, Any]:
    """Astigmatism as single numbers, for tables."""
    (a, b), (u, v) = row["astigmatism"], row["u_astigmatism"]
    i, j = row["cell"]
    return {
        "cell_i": i,
        "cell_j": j,
        "astigmatism": a,
        "astigmatism_45": b,
        "u_astigmatism": u,
        "u_astigmatism_45": v,
    }


def facts_of(found: Measured) -> list[tuple[str, str]]:
    """Rows of a short result: the numbers of each side, the shares of light, and the scale of heights."""
    rows: list[tuple[str, str]] = []
    for name, (radius, u, constant) in found.radii().items():
        one = found.sides[name].lenslets
        text = f"{len(one.index)} lenslets, R {radius:.6g} ± {2.0 * u:.2g}, K {constant + 0.0:+.2f}, pitch"
        rows.append((name, f"{text} {one.pitch[0]:.7g}, {one.pitch[1]:.7g}"))
    light = found.light
    share = f"{percent_text(light.formed)} formed, {percent_text(light.seam)} met a seam"
    texture = percent_text(1.0 - found.texture_share, 2)
    rows.append(("light", f"{share}; texture disturbs {texture} of it"))
    return [*rows, ("z scale", str(found.z_scale))]


IsoRow = tuple[str, str, str, str]


def iso_rows(found: Measured) -> list[IsoRow]:
    """Rows in the terms of ISO 14880-1 and -4: name, unit, of the design, as measured, side by side."""
    unit = found.design.unit
    rows: list[IsoRow] = []
    for name, one in found.sides.items():
        rows += _iso_rows(name, one, unit, found)
    return rows


def _iso_rows(name: Name, one: Surface, unit: str, found: Measured) -> list[IsoRow]:
    lens, side = one.lenslets, one.lit.side
    radius, u, constant = mean_radius(one, found.u_radius)
    radii = 1.0 / lens.values[:, 3]
    off = lens.values[:, :2] - one.targets[:, :2]
    depth = lens.values[:, 3].mean() / one.targets[:, 3].mean() * side.sag
    wave = form_rms(one) * (side.body.index - 1.0)
    nano = found.design.unit_m * 1e9
    made = (
        f"{lens.pitch[0]:.7g}",
        f"{lens.pitch[1]:.7g}",
        f"{radius:.6g} ± {2.0 * u:.2g}",
        percent_text(float(np.std(radii / radii.mean())), 3, unit=""),
        f"{constant:.3f}",
        f"{depth:.5g}",
        f"{1e-3 * nano * float(np.sqrt(np.mean(np.sum((off - off.mean(axis=0)) ** 2, axis=1)))):.3g}",
        f"{radius / (side.body.index - 1.0):.6g}",
        f"{nano * one.texture:.3g}",
        f"{nano * wave:.3g}",
    )
    designed = _designed(name, side, one.targets, unit)
    return [(*row, value) for row, value in zip(designed, made, strict=True)]


def _designed(name: Name, side: Side, numbers: Floats, unit: str) -> list[tuple[str, str, str]]:
    """Rows of one side as designed; numbers (m, 7) of its lenslets."""
    radius, constant = 1.0 / float(numbers[:, 3].mean()), float(numbers[:, 4].mean())
    pitch = [float(np.hypot(*side.lattice.a1)), float(np.hypot(*side.lattice.a2))]
    spread = percent_text(float(np.std(numbers[:, 3]) * abs(radius)), 3, unit="")
    rows = [
        ("pitch x", unit, f"{pitch[0]:.6g}"),
        ("pitch y", unit, f"{pitch[1]:.6g}"),
        ("radius of curvature", unit, f"{radius:.6g}"),
        ("uniformity of the radius (standard deviation)", "%", spread),
        ("conic constant", "", f"{constant + 0.0:.3f}"),
        ("surface modulation depth", unit, f"{side.sag:.5g}"),
        ("lens middle positions (rms about the lattice)", "µm", "0"),
        ("focal length, as derived", unit, f"{radius / (side.body.index - 1.0):.6g}"),
        ("roughness Sq", "nm", ""),
        ("wavefront rms, from form", "nm", "0"),
    ]
    return [(f"{name}: {what}", of, value) for what, of, value in rows]


def iso_rows_of_design(design: Design, window: Window) -> list[tuple[str, str, str]]:
    """Rows in the terms of ISO 14880-1 and -4 of a design alone: name, unit, value; none of cylinders."""
    from clacad.measuring.sides import sides_of
    from clacad.storage.errors import NotPossible

    try:
        sides = sides_of(window, 1e-3 / design.unit_m)
    except NotPossible:
        return []
    return [
        row for name, side in sides.items() for row in _designed(name, side, side.lenslet[None], design.unit)
    ]


def form_rms(one: Surface) -> float:
    """Rms (length) of the form of all lenslets against the design's, without height, tilt and defocus."""
    lens = one.lenslets
    u, v = lens.aperture.grid(21)
    cells = one.lit.cells.of(lens.index)
    plane = np.column_stack([np.ones(len(u)), u, v, u * u + v * v])
    flat, forms, squares, side = np.linalg.pinv(plane), lens.forms(u, v), 0.0, one.lit.side
    for k in range(0, len(cells), FIRST):
        own = cells[k : k + FIRST]
        wanted = np.array([side.heights(cell, u, v) for cell in (own[:1] if side.alike else own)])
        off = conic(lens.values[k : k + FIRST], u, v, slopes=False)[0] - wanted
        off += lens.form[k : k + FIRST] @ forms.T
        squares += float(np.mean((off - off @ flat.T @ plane.T) ** 2, axis=1).sum())
    return float(np.sqrt(squares / len(cells)))


# -- files

NUMBERS, TABLE = "measured.json", "lenslets.csv"


def write_measured(found: Measured, folder: str | os.PathLike[str], *, overwrite: bool = False) -> list[Path]:
    """Write measured.json, lenslets.csv and the deviation map of each side; their paths.

    A deviation map is a NPY file of heights in the design's unit, out of the material, NaN where no whole
    lenslet was measured, with its scales in a JSON file next to it: `clacad` reads it as it reads a map.

    Raises CannotWrite, ExportRefused.
    """
    contents: dict[str, str | bytes] = {NUMBERS: canonical_json(found.to_dict()), TABLE: _table(found)}
    for name, one in found.sides.items():
        contents |= dict(_deviation(f"deviation-{name}.npy", one, found.design.unit_m))
    write_set(folder, contents, overwrite=overwrite, replace=_ours)
    return [Path(folder) / name for name in contents]


def _table(found: Measured) -> str:
    """One row for each lenslet, names of the columns first."""
    columns = {name: one for name, one in found.to_columns().items() if not name.startswith("law_")}
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows(zip(*columns.values(), strict=True))
    return text.getvalue()


def _deviation(name: str, one: Surface, unit_m: float) -> Iterator[tuple[str, str | bytes]]:
    """Map of the measured surface less the design's, and its scales."""
    data = io.BytesIO()
    np.save(data, one.deviation.astype(np.float32), allow_pickle=False)
    yield name, data.getvalue()
    scale = millimetres(unit_m)
    told = {
        "pixel_mm": [pixel * scale for pixel in one.measured.pixel],
        "z_step_mm": scale,
        "z_at_0_mm": 0.0,
        "row_0": "bottom",
    }
    yield f"{name}.json", json.dumps(told, indent=1, sort_keys=True) + "\n"


def _ours(path: Path) -> bool:
    """Whether a file was written by an earlier run next to its measured.json."""
    try:
        with (path.parent / NUMBERS).open(encoding="utf-8") as stream:
            return '"law_rms_by_cell"' in stream.read(1 << 20)
    except (OSError, UnicodeDecodeError):
        return False
