"""A telescopelet as a sequential ZMX prescription: text that lens-design programs read.

Every face is a STANDARD or, with two radii, a BICONICX surface:
z = (cx x² + cy y²)/(1 + √(1 − (1+Kx) cx² x² − (1+Ky) cy² y²)),
which represents ellipsoids and biconics alike exactly (CURV and CONI are the y meridian's, PARM 1 the x
radius, PARM 2 its conic).
Between two frames are COORDBRK surfaces, each with at most one rotation (decentre and rotation about z,
rotation about x, rotation about z: the lens axes' Euler angles), so the order of tilts does not matter.
Angles turn y towards z and x towards y.
A glass is a model glass of Abbe number 0: its index at the stated wavelength, and no dispersion.
"""

from __future__ import annotations

from collections.abc import Iterator
from math import degrees, inf
from pathlib import Path

import numpy as np

from clacad.base.types import Floats
from clacad.base.units import millimetres
from clacad.formats.sequential.stations import (
    Station,
    from_own_cell,
    image_height,
    left_out,
    probe,
    pupil,
    refuse_other_light,
    stations,
    through_design,
    traced,
    wavelength_um,
)
from clacad.optics.law import euler_angles, rotation_degrees
from clacad.sheet.window import Window
from clacad.storage.atomic import safe_name
from clacad.storage.errors import NotPossible, UnreadableFile
from clacad.storage.reading import Spending

NO_WAY = "DISZ 0.0"
"""Thickness of a surface at the position of the next one; the only line that is filled in later."""

ROUNDING = 1e-15
"""Share of a position below which a decentre is the rounding error of rotated numbers."""


def write_zmx(window: Window, path: Path) -> None:
    """Write the prescription, ASCII with the line ends of the programs that read it."""
    text = "".join(f"{line}\r\n" for line in zmx_lines(window))
    path.write_bytes(text.encode("ascii", "replace"))


def zmx_lines(window: Window) -> Iterator[str]:
    """Lines of the file."""
    yield from ("VERS 140124 0 0", "MODE SEQ", f"NAME {safe_name(window.name)}, one telescopelet")
    yield (
        f"NOTE 0 Written by clacad: {window.form}, mm, light towards +z, the centre of lens 1's cell at x = y"
        " = 0."
    )
    yield from (f"NOTE 0 Not in this file: {sentence}." for sentence in left_out(window))
    yield from ("UNIT MM X W X CM MR CPMM", f"ENPD {pupil(window)!r}", "FTYP 0 0 1 1 0 0 0")
    yield from ("XFLN 0.0", "YFLN 0.0", "FWGN 1.0", f"WAVM 1 {wavelength_um(window)!r} 1.0", "PWAV 1")
    yield from _surfaces(window)


def _surfaces(window: Window) -> Iterator[str]:
    """SURF blocks: object at infinity, stop, each face after the breaks that lead into its frame, image."""
    upright = np.eye(3)
    place, turn = np.array([0.0, 0.0, window.z_range[0] * millimetres(window.unit)]), upright
    blocks = [
        ["TYPE STANDARD", "CURV 0.0", "DISZ INFINITY"],
        [
            "STOP",
            "TYPE STANDARD",
            "COMM before the first face",
            "CURV 0.0",
            NO_WAY,
            *_rim(0.5 * pupil(window)),
        ],
    ]
    goals = [(one.vertex, one.rotation, _face(one)) for one in stations(window)]
    end = ["TYPE STANDARD", "COMM image", "CURV 0.0", NO_WAY]
    for goal, wanted, block in [*goals, (np.array([0.0, 0.0, image_height(window)]), upright, end)]:
        same = np.array_equal(turn, wanted)
        if not same:
            blocks += _back(turn)
        step = (goal - place) @ (wanted if same else upright)
        step = np.where(np.abs(step) > ROUNDING * np.abs(goal).max(), step, 0.0)
        blocks[-1] = [f"DISZ {float(step[2])!r}" if line == NO_WAY else line for line in blocks[-1]]
        blocks += _breaks(float(step[0]), float(step[1]), upright if same else wanted)
        blocks.append(block)
        place, turn = goal, wanted
    for number, block in enumerate(blocks):
        yield f"SURF {number}"
        yield from (f"  {line}" for line in block)


def _breaks(x: float, y: float, turn: Floats) -> list[list[str]]:
    """COORDBRK blocks that decentre by x and y (mm), then rotate from the sheet's axes by R: z, x, z."""
    phi, theta, psi = (degrees(angle) for angle in euler_angles(turn))
    found = [_break((x, y), 5, psi)] if x or y or psi else []
    return found + [_break((0.0, 0.0), about, angle) for about, angle in ((3, theta), (5, phi)) if angle]


def _back(turn: Floats) -> list[list[str]]:
    """COORDBRK blocks that rotate back to the sheet's axes: inverse rotations in reverse order."""
    phi, theta, psi = (degrees(angle) for angle in euler_angles(turn))
    return [_break((0.0, 0.0), about, -angle) for about, angle in ((5, phi), (3, theta), (5, psi)) if angle]


def _break(decentre: tuple[float, float], about: int, angle: float) -> list[str]:
    values = {1: decentre[0], 2: decentre[1], 3: 0.0, 4: 0.0, 5: 0.0, 6: 0.0} | {about: angle}
    return ["TYPE COORDBRK", "CURV 0.0", NO_WAY, *(f"PARM {k} {v!r}" for k, v in values.items())]


def _face(one: Station) -> list[str]:
    """Block of one face; its thickness is filled in later. NotPossible: even terms without revolution."""
    (cx, cy), (kx, ky) = one.curvature, one.conic
    if one.polynomial and not one.rotational:
        raise NotPossible(
            f"zmx: {one.name} has even terms that differ along x and y, which none of the surfaces written"
            " here holds; use format optiland"
        )
    kind = "EVENASPH" if one.polynomial else "STANDARD" if one.rotational else "BICONICX"
    lines = [f"TYPE {kind}", f"COMM {one.name}", f"CURV {cy!r}", NO_WAY]
    if one.index != 1.0:
        lines.append(f"GLAS ___BLANK 1 0 {one.index!r} 0.0 0.0 0 0 0 0 0")
    lines += _rim(min(np.hypot(*one.reach), 1e9)) if np.isfinite(one.reach[0]) else []
    lines.append(f"CONI {ky!r}")
    if kind == "EVENASPH":
        lines += ["PARM 1 0.0", f"PARM 2 {one.terms[0][0]!r}"]
        lines += [
            f"PARM {k} {terms[0]!r}" for k, terms in ((3, one.terms[1]), (4, one.terms[2])) if any(terms)
        ]
    if not one.rotational:
        lines += [f"PARM 1 {(1.0 / cx if cx else 0.0)!r}", f"PARM 2 {kx!r}"]
    return lines


def _rim(radius: float) -> list[str]:
    return [f'DIAM {float(radius)!r} 1 0 0 1 ""']


# -- reading back --------------------------------------------------------------------------------------


def read_zmx(path: Path) -> list[Station]:
    """Faces of a prescription in the frame of the surface after the object, from the text alone.

    Raises UnreadableFile: No text of surfaces, one of a kind that is not written here, or tilts about more
        than one axis in a break.
    Raises OverBudget.
    """
    spent = Spending("prescription", path)
    blocks: list[dict[str, list[str]]] = []
    with path.open("rb") as stream:
        for raw in spent.lines(stream):
            spent.count(1)
            words = raw.decode("ascii", "replace").split()
            if not words:
                continue
            if words[0] == "SURF":
                blocks.append({})
            elif blocks:
                key = f"PARM {words[1]}" if words[0] == "PARM" and len(words) > 2 else words[0]
                blocks[-1][key] = words[2:] if key != words[0] else words[1:]
    try:
        return list(_placed(blocks))
    except (ValueError, IndexError, KeyError) as error:
        raise UnreadableFile(f"{path.name}: no prescription as written here ({error})") from error


def _placed(blocks: list[dict[str, list[str]]]) -> Iterator[Station]:
    """Faces with their poses; breaks and thicknesses are processed in order."""
    if len(blocks) < 3:
        raise ValueError(f"{len(blocks)} surfaces")
    place, turn = np.zeros(3), np.eye(3)
    for number, block in enumerate(blocks[1:-1]):
        if block["TYPE"][0] == "COORDBRK":
            values = [_number(block, f"PARM {k}") for k in range(1, 7)]
            place = place + turn @ np.array([*values[:2], 0.0])
            turn = turn @ _turned(values[2:5])
        elif number:  # the first is the stop
            yield _read_face(block, place, turn)
        place = place + turn @ np.array([0.0, 0.0, _number(block, "DISZ")])


def _turned(tilts: list[float]) -> Floats:
    """Rotation (3, 3) of a break that turns about one axis."""
    x, y, z = tilts
    if y or (x and z):
        raise ValueError("a break that turns about more than one axis, or about y")
    return rotation_degrees(z, x, 0.0)


def _read_face(block: dict[str, list[str]], place: Floats, turn: Floats) -> Station:
    kind = block["TYPE"][0]
    if kind not in ("STANDARD", "BICONICX", "EVENASPH"):
        raise ValueError(f"a surface of type {kind}")
    cy, ky = _number(block, "CURV"), _number(block, "CONI")
    cx, kx = cy, ky
    if kind == "BICONICX":
        radius = _number(block, "PARM 1")
        cx, kx = (1.0 / radius if radius else 0.0), _number(block, "PARM 2")
    index = float(block["GLAS"][3]) if "GLAS" in block else 1.0
    r4, r6, r8 = (_number(block, f"PARM {k}") if kind == "EVENASPH" else 0.0 for k in (2, 3, 4))
    terms = (r4, 2.0 * r4, r4), (r6, 3.0 * r6, 3.0 * r6, r6), (r8, 4.0 * r8, 6.0 * r8, 4.0 * r8, r8)
    if kind == "EVENASPH" and _number(block, "PARM 1"):
        raise ValueError("an even asphere with a term of second order")
    name = " ".join(block.get("COMM", []))
    return Station(name, (cx, cy), (kx, ky), place, turn, index, (inf, inf), terms)


def _number(block: dict[str, list[str]], key: str) -> float:
    value = float(block[key][0]) if key in block else 0.0
    if not abs(value) < inf:
        raise ValueError(f"{key} is {value}")
    return value


def check_zmx(window: Window, path: Path) -> None:
    """Read a prescription back and send light through it: it must leave as through the design's own faces.

    Raises FileDisagrees, UnreadableFile.
    """
    start, direction = from_own_cell(window, probe(window))
    wanted, inside = through_design(window, start, direction)
    low = window.z_range[0] * millimetres(window.unit)
    found = traced(read_zmx(path), start - [0.0, 0.0, low], direction)
    refuse_other_light(path.name, wanted, found, inside)
