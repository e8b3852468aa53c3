"""The paper's figures and movies as rows with requirements on rendered pictures.

Each row names its scenes and defines what is measured on the coordinate screen. Expected numbers are the
closed forms of the paper's section 3 with the camera at D = 20 (Hamilton & Courtial 2009). Tolerances cover
two effects of real lenslets: the finite separation (turned at z = s instead of 0: up to 1 %) and aberration.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from clacad.base.sign_changes import bisect
from clacad.base.types import Floats
from clacad.rendering.screen_measure import ScreenMap, fitted, ghost_shifts, measure
from clacad.scene import Scene


@dataclass(frozen=True, slots=True)
class AtlasFinding:
    """One measured number with its expected value."""

    what: str
    measured: float
    expected: float
    tolerance: float

    @property
    def passed(self) -> bool:
        """Whether it lies within the tolerance."""
        return bool(abs(self.measured - self.expected) <= self.tolerance)

    def to_dict(self) -> dict[str, Any]:
        """Plain values."""
        return {
            "what": self.what,
            "measured": self.measured,
            "expected": self.expected,
            "tolerance": self.tolerance,
            "passed": self.passed,
        }


Loader = Callable[[str], Scene]

D = 20.0
"""Distance of the camera, tiles."""

RAYS = 230
"""Rays across a measured picture: not a multiple of the lens pitch."""


@dataclass(frozen=True, slots=True)
class Figure:
    """One figure or movie: its scenes and what is measured.

    row : Number in the list of the paper's claims.
    scenes : tuple of (scene file stem, label)
    check : callable(loader) → findings
    ghosts_marked : Whether ghosts are drawn in one colour, and its pictures labelled with their content.
    drawn : tuple of (file stem, label, callable that gives a PNG). Pictures that are no view of a scene.
    circled : Stems of the scenes in whose pictures a circle marks the piece, as the paper does where it is
        very small.
    """

    row: str
    title: str
    says: str
    scenes: tuple[tuple[str, str], ...]
    check: Callable[[Loader], Iterator[AtlasFinding]]
    movie: bool = False
    ghosts_marked: bool = False
    drawn: tuple[tuple[str, str, Callable[[], bytes]], ...] = ()
    circled: tuple[str, ...] = ()

    def owns(self, movie: str) -> bool:
        """Whether a movie of this title belongs to the figure: both begin with its number."""
        return movie.startswith(self.title.split(":")[0])


def _map(scene: Scene, z: float) -> ScreenMap:
    return measure(scene, z, RAYS, compiled=True)


def _turned(scene: Scene, k: int, degrees: float) -> Scene:
    """The scene with one Euler angle of its sheet set."""
    return scene.replace({f"sheet.set.law.euler.{k}": degrees})


DIRECT = {
    "eta_x = -0.25": 0.875,
    "eta_x = -0.5": 0.875,
    "eta_x = -1": 0.766,
    "eta_x = -2": 0.4375,
    "phi = 45": 0.914,
    "theta = 0.5": 0.895,
    "theta = 1": 0.840,
}
"""Share of the sheet's light through corresponding lenslets: mean of the closed form, x times y."""


def _share(what: str, found: ScreenMap) -> AtlasFinding:
    return AtlasFinding(
        f"{what}: share of light through corresponding lenslets", found.direct, DIRECT[what], 0.03
    )


def _squash(load: Loader) -> Iterator[AtlasFinding]:
    for ratio in (0.25, 0.5, 1.0, 2.0):
        found = _map(load(f"fig2-eta-{ratio:g}"), 10.0)
        label = f"eta_x = -{ratio:g}"
        for axis, name, value in ((0, "x", ratio), (1, "y", 1.0)):
            what = f"{label}, z = 10: 1/stretch in {name}"
            yield AtlasFinding(what, float(found.matrix[axis, axis]), 1.0 - 10.0 / (D * value), 0.04)
        yield _sheared(label, found.matrix)
        yield _share(label, found)
    for ratio, axis, expected in ((0.25, 1, 2.0), (1.0, 0, 2.0), (2.0, 0, 1.5)):
        shift = np.abs(ghost_shifts(load(f"fig2-eta-{ratio:g}"), 10.0, RAYS, compiled=True)[:, axis])
        what = f"eta_x = -{ratio:g}, z = 10: how far to the side in {'xy'[axis]} a ghost shows things"
        first = float(np.median(shift[(shift > 0.5 * expected) & (shift < 1.5 * expected)]))
        yield AtlasFinding(what, first, expected, 0.05)  # z p/(f1 abs(eta))


def _sheared(label: str, matrix: Floats) -> AtlasFinding:
    """The larger of the two matrix elements that are 0 where x and y do not mix."""
    mixed = max((float(matrix[0, 1]), float(matrix[1, 0])), key=abs)
    return AtlasFinding(f"{label}: shear", mixed, 0.0, 0.005)


def _distance(load: Loader) -> Iterator[AtlasFinding]:
    """Fig. 3: stretch over the distance of a screen, and its poles."""
    scene = load("fig3-movie").at(0)
    for z in (2.0, 4.0, 5.0, 8.0, 10.0, 15.0, 30.0, 38.0):
        found = _map(scene, z).matrix
        yield AtlasFinding(
            f"z = {z:g}: 1/stretch in x", float(found[0, 0]), 1.0 - 4.0 * z / D, 0.01 + 0.005 * z
        )
        yield AtlasFinding(f"z = {z:g}: 1/stretch in y", float(found[1, 1]), 1.0 - z / D, 0.01 + 0.001 * z)
    for axis, name, pole, near in ((0, "x", 5.0, 1.0), (1, "y", 20.0, 2.0)):
        before, after = (float(_map(scene, pole + step).matrix[axis, axis]) for step in (-near, near))
        yield AtlasFinding(
            f"z = {pole - near:g}: sign of the stretch in {name}", float(np.sign(before)), 1.0, 0.0
        )
        yield AtlasFinding(
            f"z = {pole + near:g}: sign of the stretch in {name}", float(np.sign(after)), -1.0, 0.0
        )
        crossing = pole - near + 2.0 * near * before / (before - after)
        yield AtlasFinding(f"stretch in {name} changes sign at z", crossing, pole, 0.0125 * pole)
    yield from _before(scene)
    touching, leaving = (_map(scene, z) for z in (-0.001, 0.06))  # the sheet fills z = 0 to 0.05
    jump = float(np.abs(leaving.matrix - touching.matrix).max())
    yield AtlasFinding(
        "largest change of the view from just before the sheet to just behind it", jump, 0.0, 0.01
    )


def _before(scene: Scene) -> Iterator[AtlasFinding]:
    """A piece before the sheet looks as without a sheet."""
    found = _map(scene, -2.0)
    for axis, name in ((0, "x"), (1, "y")):
        what = f"z = -2, before the sheet: undistorted in {name}"
        yield AtlasFinding(what, float(found.matrix[axis, axis]), 1.0 - 2.0 / D, 1e-9)
    yield _sheared("z = -2, before the sheet", found.matrix)


def _offset(load: Loader) -> Iterator[AtlasFinding]:
    for stem, dx, dy in (
        ("0-0.01", 0.0, 0.01),
        ("0.005-0.01", 0.005, 0.01),
        ("0.01-0", 0.01, 0.0),
        ("m0.005-0.005", -0.005, 0.005),
    ):
        found = _map(load(f"fig4-delta-{stem}"), 10.0)
        x, y = found.appears_at(0.0, 0.0)
        label = f"delta = ({dx:g}, {dy:g})"
        yield AtlasFinding(f"{label}: axis point at z = 10 appears at x", float(x), 40.0 * dx, 0.015)
        yield AtlasFinding(f"{label}: axis point at z = 10 appears at y", float(y), -20.0 * dy, 0.008)
        yield _sheared(label, found.matrix)


def winding(maps: list[Floats]) -> float:
    """Degrees a picture turns while its maps (2, 2), sheet to screen, change, summed step by step."""
    total, last = 0.0, None
    for matrix in maps:
        up = np.linalg.solve(matrix, np.array([0.0, 1.0]))
        angle = math.degrees(math.atan2(-up[0], up[1]))
        if last is not None:
            total += (angle - last + 180.0) % 360.0 - 180.0
        last = angle
    return total


FAR = 1.0e4
"""Distance, tiles, at which a screen represents the horizon."""


def horizon_tilt(matrix: Floats) -> float:
    """Degrees from x, -90 to 90, at which a map (2, 2) shows the horizon.

    The horizon is the line on the sheet along which Y does not change.
    """
    return (math.degrees(math.atan2(-matrix[1, 0], matrix[1, 1])) + 90.0) % 180.0 - 90.0


def _roll(load: Loader) -> Iterator[AtlasFinding]:
    """Fig. 5: phi turns the pieces of the view; the horizon tilts."""
    scene = load("fig5-movie").at(0)
    turned = [_turned(scene, 0, phi) for phi in np.linspace(0.0, 180.0, 13)]
    for z, expected in ((3.0, 0.0), (10.0, 360.0), (15.0, 360.0), (30.0, 0.0)):
        maps = [_map(still, z).matrix for still in turned]
        yield AtlasFinding(
            f"phi 0 to 180: turn of a piece at z = {z:g}, degrees", abs(winding(maps)), expected, 1e-6
        )
    horizon = [_map(still, FAR).matrix for still in turned]
    yield AtlasFinding("phi 0 to 180: turn of the horizon, degrees", abs(winding(horizon)), 0.0, 1e-6)
    for phi, expected in ((0.0, 0.0), (26.57, -36.87), (90.0, 0.0), (153.43, 36.87), (180.0, 0.0)):
        tilt = horizon_tilt(_map(_turned(scene, 0, phi), FAR).matrix)
        yield AtlasFinding(f"phi = {phi:g}: tilt of the horizon, degrees", tilt, expected, 0.6)
    most = max(abs(horizon_tilt(matrix)) for matrix in horizon)
    amplitude = math.degrees(math.atan(0.75))
    yield AtlasFinding("largest tilt of the horizon over 13 angles, degrees", most, amplitude, 1.5)
    for phi in (26.57, 45.0, 135.0):
        values = np.sort(np.linalg.eigvals(_map(load(f"fig5-phi-{phi:g}"), 10.0).matrix).real)
        yield AtlasFinding(
            f"phi = {phi:g}, z = 10: 1/stretch along one direction", float(values[0]), -1.0, 0.04
        )
        yield AtlasFinding(f"phi = {phi:g}, z = 10: 1/stretch along the other", float(values[1]), 0.5, 0.04)
    yield _share("phi = 45", _map(load("fig5-phi-45"), 10.0))


def _tilt(load: Loader) -> Iterator[AtlasFinding]:
    """Fig. 6: theta moves the point where the axis appears."""
    for theta in (0.25, 0.5, 1.0):
        found = _map(load(f"fig6-theta-{theta:g}"), 10.0)
        x, y = found.appears_at(0.0, 0.0)
        angle = math.radians(theta)
        label = f"theta = {theta:g}"
        yield AtlasFinding(
            f"{label}: axis point at z = 10 appears at x", float(x), -45.0 * angle, 0.03 * theta
        )
        yield AtlasFinding(
            f"{label}: axis point at z = 10 appears at y", float(y), -5.0 * angle, 0.03 * theta
        )
        if label in DIRECT:
            yield _share(label, found)
    few, many = (
        _shift(load(f"fig6-theta-{theta:g}").replace({"sheet.rung": "law"})) for theta in (0.25, 1.0)
    )
    yield AtlasFinding(
        "homogeneous sheet: shift at theta = 1 over four times that at 0.25", many / (4.0 * few), 1.0, 0.002
    )
    scene = load("fig6-theta-0.5")
    plain = _turned(scene, 0, 0.0)
    x, y = _map(plain, 10.0).appears_at(0.0, 0.0)
    yield AtlasFinding("phi = 0, theta = 0.5: axis point at z = 10 appears at x", float(x), 0.0, 0.005)
    yield AtlasFinding(
        "phi = 0, theta = 0.5: axis point at z = 10 appears at y, not x", float(y), math.radians(20.0), 0.005
    )
    offset = plain.replace(
        {"sheet.set.law.euler": [0.0, 0.0, 0.0], "sheet.set.law.delta": [0.0, -math.radians(1.0)]}
    )
    same = float(_map(offset, 10.0).appears_at(0.0, 0.0)[1])
    yield AtlasFinding("phi = 0, theta = 0.5: y over that of delta_y = -2 theta", float(y) / same, 1.0, 0.01)


def _shift(scene: Scene) -> float:
    """Distance on the sheet at which the axis point at z = 10 is seen."""
    return float(np.hypot(*_map(scene, 10.0).appears_at(0.0, 0.0)))


def _swing(load: Loader) -> Iterator[AtlasFinding]:
    """Fig. 7: psi swings the view round."""
    start = math.atan2(-5.0, -45.0)
    radius = math.radians(0.5) * math.hypot(45.0, 5.0)
    movie = load("fig7-movie")
    assert movie.animation is not None
    first, last = (_map(movie.at(k), 10.0).matrix for k in (0, movie.animation.frames - 1))
    for psi in (45.0, 90.0, 180.0, 270.0):
        found = _map(load(f"fig7-psi-{psi:g}"), 10.0)
        x, y = found.appears_at(0.0, 0.0)
        yield AtlasFinding(f"psi = {psi:g}: distance of the apparent centre", math.hypot(x, y), radius, 0.008)
        turned = _around(math.degrees(math.atan2(y, x) - start) - psi)
        yield AtlasFinding(
            f"psi = {psi:g}: turn of the apparent centre beyond psi, degrees", turned, 0.0, 1.5
        )
        beyond = _around(_mirror(found.matrix) - _mirror(first) - 2.0 * psi)
        yield AtlasFinding(f"psi = {psi:g}: turn of the piece beyond 2 psi, degrees", beyond, 0.0, 0.5)
    yield AtlasFinding(
        "psi = 360 against 0: largest change of the map", float(np.abs(first - last).max()), 0.0, 1e-9
    )


def _around(degrees: float) -> float:
    """Normalise an angle to -180 … 180 degrees."""
    return (degrees + 180.0) % 360.0 - 180.0


def _mirror(matrix: Floats) -> float:
    """Degrees by which a mirrored map is turned: of its part that changes the sense of rotation."""
    return math.degrees(math.atan2(matrix[1, 0] + matrix[0, 1], matrix[0, 0] - matrix[1, 1]))


CENTRES = {
    3.0: (-0.195, 0.133),
    8.0: (0.175, -0.407),
    10.0: (0.044, -0.393),
    15.0: (-0.361, -0.688),
    38.0: (0.494, 0.243),
    60.0: (0.381, 0.143),
    FAR: (0.284, 0.065),
}
"""Positions on the sheet of Fig. 8 at which the axis point at z is seen."""

SEEN, UNSEEN = (3.0, 8.0, 10.0, 38.0, 60.0), (5.0, 5.5, 6.0, 15.0, 18.0, 20.0, 22.0)
"""Distances at which the axis point is seen on the sheet, and at which its position is outside the sheet."""

NEAR = 0.05
"""Distance from the axis, tiles, that counts as the axis point."""

HALF_SIDE = 0.5
"""Half side of the sheet, tiles."""


def _vanish(load: Loader) -> Iterator[AtlasFinding]:
    """Fig. 8: where points of the axis appear, and where they are not seen."""
    scene = load("fig8-z-60")
    for z, (x, y) in CENTRES.items():
        at = _map(scene, z).appears_at(0.0, 0.0)
        slack = 0.02 if z < 12.0 else 0.03
        label = "horizon" if z == FAR else f"z = {z:g}"
        yield AtlasFinding(f"{label}: apparent centre x", float(at[0]), x, slack)
        yield AtlasFinding(f"{label}: apparent centre y", float(at[1]), y, slack)
    yield from visibility(scene)
    for edge in unseen_zones(scene):
        near = 0.04 * edge
        before, after = (_reach(_map(scene, edge + step)) for step in (-near, near))
        crossing = edge - near + 2.0 * near * before / (before - after)
        yield AtlasFinding("the axis point crosses the sheet's edge at z", crossing, edge, 0.04 * edge)
    stretches = np.sort(np.linalg.eigvals(np.linalg.inv(_map(scene, 60.0).matrix)).real)
    yield AtlasFinding("z = 60: larger stretch", float(stretches[0]), -0.5, 0.02)
    yield AtlasFinding("z = 60: smaller stretch", float(stretches[1]), -0.0909, 0.005)
    yield from _before(load("fig8-movie").at(0))


def visibility(scene: Scene) -> Iterator[AtlasFinding]:
    """Whether the axis point is visible on the sheet of Fig. 8: light from it, counted in the picture."""
    for z in (*SEEN, *UNSEEN):
        share = _map(scene, z).shown(0.0, 0.0, NEAR)
        what, expected, slack = ("seen", 1.0, 0.5) if z in SEEN else ("not seen", 0.0, 0.05)
        yield AtlasFinding(
            f"z = {z:g}: light from the axis point over what an endless sheet shows: {what}",
            share,
            expected,
            slack,
        )


def _reach(found: ScreenMap) -> float:
    """Distance outside the sheet at which the axis point appears; negative on the sheet."""
    return float(np.abs(found.appears_at(0.0, 0.0)).max()) - HALF_SIDE


def unseen_zones(scene: Scene) -> list[float]:
    """Distances z, ascending, at which by the law alone the axis point crosses the edge of the sheet.

    Rays through points x₀ leave with the law's slopes, X = x₀ + z · slope; their fit is affine in z.
    """
    offset, matrix = _slopes_of_law(scene)

    def reach(z: Floats) -> Floats:
        at = [np.linalg.solve(np.eye(2) + one * matrix, -one * offset) for one in z]
        return np.asarray(np.abs(at).max(axis=1) - HALF_SIDE)

    grid = np.arange(0.55, 60.0, 0.1)
    changes = np.flatnonzero(np.diff(np.sign(reach(grid))))
    return [float(z) for z in bisect(reach, grid[changes], grid[changes + 1])]


def _slopes_of_law(scene: Scene) -> tuple[Floats, Floats]:
    """Slopes behind the sheet of light from the camera, (2,) + (2, 2) x₀, fitted over crossing points x₀."""
    side = np.linspace(-HALF_SIDE, HALF_SIDE, 9)
    x0 = np.stack(np.meshgrid(side, side), axis=2).reshape(-1, 2)
    out = scene.design().law.refract(np.column_stack([x0, np.full(len(x0), D)]))
    offset, matrix, _, _ = fitted(x0, out[:, :2] / out[:, 2:])
    return offset, matrix


def piece_on_sheet(scene: Scene) -> tuple[Floats, float]:
    """Position (2,) on the sheet where the law shows the middle of the knight, and half the length of its
    larger image axis there.
    """
    piece = next(thing for thing in scene.objects if thing.id == "knight")
    offset, matrix = _slopes_of_law(scene)
    x, y, z = piece.at
    shown = np.linalg.inv(np.eye(2) + z * matrix)
    reach = float(np.linalg.svd(shown, compute_uv=False)[0])
    return np.asarray(shown @ (np.array([x, y]) - z * offset)), 0.5 * reach * float(np.max(piece.size))


FIGURES: tuple[Figure, ...] = (
    Figure(
        "F2",
        "Fig. 2: eta_x varied",
        "Squashed or stretched in x only; at eta_x = -1/2 the image lies at the camera: a smear.",
        tuple((f"fig2-eta-{e}", f"eta_x = -{e}, z = 10") for e in ("0.25", "0.5", "1", "2")),
        _squash,
    ),
    Figure(
        "F3",
        "Fig. 3: distance of the piece",
        "The stretch in x grows and changes its sign at z = 5, then that in y at z = 20.",
        tuple((f"fig3-z-{z.replace('-', 'm')}", f"z = {z}") for z in ("-2", "2", "4.5", "8", "15", "38")),
        _distance,
    ),
    Figure(
        "F4",
        "Fig. 4: offset axes",
        "The view shifts; there is no shear.",
        tuple(
            (f"fig4-delta-{d}", f"delta = {label}")
            for d, label in (
                ("0-0.01", "(0, 0.01)"),
                ("0.005-0.01", "(0.005, 0.01)"),
                ("0.01-0", "(0.01, 0)"),
                ("m0.005-0.005", "(-0.005, 0.005)"),
            )
        ),
        _offset,
    ),
    Figure(
        "F5",
        "Fig. 5: phi from 0 to 180 degrees",
        "The piece turns once round and distorts; the horizon only seesaws.",
        tuple((f"fig5-phi-{f}", f"phi = {f}") for f in ("26.57", "45", "90", "135", "153.43")),
        _roll,
    ),
    Figure(
        "F6",
        "Fig. 6: theta varied, phi = 45 degrees",
        "The view shifts sideways.",
        tuple((f"fig6-theta-{t}", f"theta = {t}") for t in ("0.25", "0.5", "1")),
        _tilt,
    ),
    Figure(
        "F7",
        "Fig. 7: psi from 0 to 360 degrees",
        "The view turns about the sheet's axis and distorts; it closes at 360 degrees.",
        tuple((f"fig7-psi-{p}", f"psi = {p}") for p in ("45", "90", "180", "270")),
        _swing,
    ),
    Figure(
        "F8",
        "Fig. 8: distance behind the more complex sheet",
        "At z = 60 the piece is very small.",
        tuple((f"fig8-z-{z}", f"z = {z}") for z in ("3", "8", "38", "60")),
        _vanish,
        circled=("fig8-z-60",),
    ),
)
"""Figures 2 to 8 of the paper."""

MOVIES: tuple[tuple[str, str], ...] = (
    ("fig3-movie", "Fig. 3: z from -2 to 38"),
    ("fig5-movie", "Fig. 5: phi from 0 to 180 degrees"),
    ("fig7-movie", "Fig. 7: psi from 0 to 360 degrees"),
    ("fig8-movie", "Fig. 8: z from -2 to 38"),
)
"""Scene and title of each movie."""
