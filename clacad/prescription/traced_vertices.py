"""Where lens 2 must stand for the light of its cell to leave, in the mean, as the law asks.

Paraxial rays place lens 2 for light along the axis. Light that comes aslant meets it off its vertex, and coma and
distortion bias what leaves. As each cell has a vertex of its own, it is moved until the mean exit direction of the
light of the cell's field centre is the asked one: a 2 × 2 secant on the exact trace (Broyden 1965), many cells at once.

Light of one slope finds the same lenses in every cell, so the move is a smooth function of the slope alone; where the law
varies and the light does not, of δ (and η) alone. Up to `DIRECT` cells it is solved for each; beyond, for a spread of them, and a polynomial through these gives the rest, held to
cells that it was not made from.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from clacad.base.sobol import sobol
from clacad.base.types import Floats, Ints, Pair2
from clacad.optics.rays import Fate
from clacad.optics.sequence import Interface, cross, launch, pass_on, unit_directions
from clacad.prescription.radii import NoSuchLens
from clacad.sheet.telescopelet import interfaces
from clacad.sheet.window import Window

RAYS = 64
"""Sobol points over a quarter of the light of a cell; their mirror images in x, in y and in both make 256 rays."""

BRACKET = 0.3
"""Part of the pitch within which a vertex is looked for."""

SHARE = 0.25
"""Part more of the way that a varying law has moved it already."""

STEPS = 24
"""Most steps of the secant; 5 to 8 do."""

CLOSE = 1e-13
"""Mean direction (radians) that counts as the asked one: what rounding leaves of a mean of 256."""

DIRECT = 400
"""Cells up to which each is solved for."""

LADDER = ((260, 11), (700, 17))
"""Slopes through which a polynomial goes, and its degree in both together: the second where the first misses."""

OWN_DIRECT = 2000
OWN_LADDER = ((1000, 9), (1900, 12))
"""The same of lenses of many sizes, where moves are functions of η too."""

HELD_OUT = 40
"""Other slopes that it is held to."""

FIT = 1e-9
"""Part of the pitch by which it may miss a vertex that it was held to: 2e-10 rad for a window of 0.5 mm pitch."""

WAY_OUT = 'a viewer or image farther away, a smaller sheet, or pair.offset = "paraxial"'

GRID = 2.0**-40
"""Part of the pitch that vertices are whole multiples of: coarser than what the order of sums changes, so that bytes repeat."""


@dataclass(frozen=True, eq=False)
class OwnLenses:
    """Lenses of cells that differ in size.

    Parameters
    ----------
    sizes : (2, m)
        Of lens 1 and lens 2, against the window's.
    fill : (m,)
        Part of the cell whose light lens 2 can take.
    """

    sizes: Floats
    fill: Floats


@dataclass(frozen=True, eq=False)
class CellLight:
    """Light of the field centre of cells, and what it shall do.

    Parameters
    ----------
    slopes : (m, 2)
        In air, before the sheet.
    asked : (m, 3) unit
        Directions that it shall leave in.
    first : (m, 2) lengths
        How far lens 2 of each cell stands, by paraxial rays, from where the window has it.
    variable : (m, 2)
        What moves are smooth functions of.
    key : str
        Key of the design to blame.
    climb : (along x, along y)
        How far lens 2 rises on its way, as `VertexChange.slope`.
    own : OwnLenses or None
        None: the lenses of all cells are alike.
    """

    slopes: Floats
    asked: Floats
    first: Floats
    variable: Floats
    key: str = "lattice.aperture"
    climb: Pair2 = (0.0, 0.0)
    own: OwnLenses | None = None

    def of(self, rows: Ints) -> CellLight:
        """The light of some cells, by their places (k,) in the list."""
        return replace(
            self,
            slopes=self.slopes[rows],
            asked=self.asked[rows],
            first=self.first[rows],
            variable=self.variable[rows],
            own=None if self.own is None else OwnLenses(self.own.sizes[:, rows], self.own.fill[rows]),
        )


def traced_moves(window: Window, slopes: Floats) -> Floats:
    """How far lens 2 must move from where paraxial rays have it, for light of each slope.

    Parameters
    ----------
    window : Window
        Of equal cells, lens 2 where paraxial rays have it.
    slopes : (m, 2)
        Of the light of the field centre of each cell, in air.

    Returns
    -------
    (m, 2) lengths

    Raises
    ------
    NoSuchLens
        No vertex within `BRACKET` does it, or light is lost on the way.
    """
    asked = _unit(window.law.refract(np.column_stack([slopes, np.ones(len(slopes))])))
    return moves_of(window, CellLight(slopes, asked, np.zeros(slopes.shape), slopes))


def moves_of(window: Window, light: CellLight) -> Floats:
    """How far lens 2 must move from where paraxial rays have it, (m, 2), lengths; see `traced_moves`."""
    if light.own is None:
        return _moves_of(window, light)
    moves = np.empty(light.first.shape)
    whole = light.own.fill == 1.0
    for rows in (
        np.flatnonzero(whole),
        np.flatnonzero(~whole),
    ):  # where lens 2 takes a part the light of a cell is another
        if len(rows):
            moves[rows] = _moves_of(window, light.of(rows))
    return moves


def _moves_of(window: Window, light: CellLight) -> Floats:
    """The same of light that moves are smooth functions of."""
    grid = GRID * min(window.lattice.pitch)
    if len(light.slopes) <= (DIRECT if light.own is None else OWN_DIRECT):
        return np.asarray(np.rint(_solved(window, light) / grid) * grid)
    for nodes, degree in LADDER if light.own is None else OWN_LADDER:
        moves, missed = _by_polynomial(window, light, nodes, degree)
        if missed <= FIT * min(window.lattice.pitch):
            return np.asarray(np.rint(moves / grid) * grid)
    raise NoSuchLens(
        f"the vertices of lens 2 change too sharply from cell to cell to be told within {FIT:g} of the pitch",
        key=light.key, code="CL123", hint=WAY_OUT,
    )  # fmt: skip


def _by_polynomial(window: Window, light: CellLight, count: int, degree: int) -> tuple[Floats, float]:
    """Moves (m, 2) by a polynomial through `count` of them, and by how much it misses others at most."""
    variable = light.variable
    order = np.argsort(sobol(len(variable), 1)[:, 0], kind="stable")
    middle, reach = variable.mean(axis=0), np.ptp(variable, axis=0) / 2.0
    reach = np.where(reach == 0.0, 1.0, reach) if light.own is not None else reach.max() or 1.0
    far = variable - middle if light.own is None else (variable - middle) / reach
    outer = np.argsort(-(far**2).sum(axis=1), kind="stable")[: count // 5]
    nodes = np.unique(np.concatenate([outer, order[: count - len(outer)]]))
    held = np.setdiff1d(order[count : count + 2 * HELD_OUT], nodes)[:HELD_OUT]
    solved = _solved(window, light.of(np.concatenate([nodes, held])))
    scaled = (variable - middle) / reach
    terms, *_ = np.linalg.lstsq(_powers(scaled[nodes], degree), solved[: len(nodes)], rcond=None)
    moves = np.asarray(_powers(scaled, degree) @ terms)
    judged = held if light.own is None else np.concatenate([nodes, held])
    return moves, float(np.abs(moves[judged] - solved[len(solved) - len(judged) :]).max(initial=0.0))


def _powers(t: Floats, degree: int) -> Floats:
    """Products of Chebyshev polynomials (m, k) of total degree up to `degree` at points (m, 2) or (m, 3)."""
    x, y, *more = (np.polynomial.chebyshev.chebvander(column, degree) for column in t.T)
    flat = [(x[:, i] * y[:, j], degree - i - j) for i in range(degree + 1) for j in range(degree + 1 - i)]
    if not more:
        return np.column_stack([one for one, _ in flat])
    return np.column_stack([one * more[0][:, k] for one, rest in flat for k in range(rest + 1)])


def _solved(window: Window, light: CellLight) -> Floats:
    """Moves (m, 2) of lens 2, each by a secant of its own, all traced together."""
    seq, points, owners = interfaces(window), _cell_points(window, light.own), _owners(window)
    slopes, asked = light.slopes, light.asked
    if not np.isfinite(asked).all():
        raise NoSuchLens("the law gives no direction for light of this slope", light.key, code="CL123")
    focal = np.array(window.thin.focal_length[1])
    inverse = np.zeros((len(slopes), 2, 2))
    turned = window.thin.rotation[:2, :2]
    inverse[:] = turned @ np.diag(np.where(np.isfinite(focal), focal, 0.0)) @ turned.T
    if light.own is not None:
        inverse *= light.own.sizes[1][:, None, None]
    move = np.zeros((len(slopes), 2))
    allowed = BRACKET * min(window.lattice.pitch) + SHARE * np.abs(light.first).max(axis=1)
    error = _bias(seq, owners, points, light, light.first + move)
    for _ in range(STEPS):
        if not np.isfinite(error).all():
            break
        if np.abs(error).max() <= CLOSE:
            return move
        step = -np.einsum("kij,kj->ki", inverse, error)
        step = np.where(np.abs(error).max(axis=1, keepdims=True) <= CLOSE, 0.0, step)
        beyond = (
            np.abs(move + step) > allowed[:, None]
        )  # aslant the first step, as by paraxial rays, is too long
        step = np.where(beyond, np.copysign(allowed[:, None], step) - move, step)
        after = _bias(seq, owners, points, light, light.first + move + step)
        inverse = _broyden(inverse, step, after - error)
        move, error = move + step, after
    worst = int(np.argmax(np.where(np.isfinite(error), np.abs(error), np.inf).max(axis=1)))
    raise NoSuchLens(
        f"no place of lens 2 within {BRACKET:g} of the pitch sends the light of slope "
        f"({slopes[worst, 0]:.4g}, {slopes[worst, 1]:.4g}) where the law asks",
        key=light.key, code="CL123", hint=WAY_OUT,
    )  # fmt: skip


def _broyden(inverse: Floats, step: Floats, change: Floats) -> Floats:
    """Inverse Jacobians (m, 2, 2) that also give the last steps (m, 2) for the last changes (m, 2)."""
    seen = np.einsum("kij,kj->ki", inverse, change)
    along = np.einsum("ki,kij->kj", step, inverse)
    scale = np.einsum("ki,ki->k", step, seen)
    moved = np.abs(scale) > 0.0
    add = np.einsum("ki,kj->kij", step - seen, along) / np.where(moved, scale, 1.0)[:, None, None]
    return np.where(moved[:, None, None], inverse + add, inverse)


def _bias(
    seq: list[Interface], owners: list[int | None], points: Floats, light: CellLight, move: Floats
) -> Floats:
    """Mean exit direction less the asked one, x and y, (m, 2); lens 2 of each of m cells moved by `move`."""
    slopes, asked, climb = light.slopes, light.asked, light.climb
    m, n = len(slopes), points.shape[-2]
    ray = np.repeat(np.column_stack([slopes, np.ones(m)]), n, axis=0)
    low = min(interface.vertex[2] for interface in seq) - 4.0 * float(np.abs(points).max())
    at = np.broadcast_to(points, (m, n, 2)).reshape(-1, 2)
    start = np.column_stack([at + low * ray[:, :2], np.full(m * n, low)])
    direction, scaled = unit_directions(ray)
    offset, travelled = launch(start, scaled, seq[0].vertex)
    slide = np.repeat(np.column_stack([move, move @ np.array(climb)]), n, axis=0)
    for k, interface in enumerate(seq):
        if k:
            offset, travelled = pass_on(offset, seq[k - 1].vertex, interface.vertex), np.zeros(m * n)
            here, before = (owners[number] == 1 for number in (k, k - 1))
            offset = offset + (int(before) - int(here)) * slide
        size = _size_at(interface, owners[k], light, n)
        crossing = cross(interface, offset / size, direction, travelled / size[..., 0])
        offset, direction = (
            crossing.offset * size,
            np.where((crossing.fate == Fate.ALIVE)[:, None], crossing.direction, np.nan),
        )
    mean = _unit(direction.reshape(m, n, 3).mean(axis=1))
    return np.asarray((mean - asked)[:, :2])


def _size_at(interface: Interface, owner: int | None, light: CellLight, n: int) -> Floats:
    """Sizes (m n, 1) of the lenses that n rays of each of m cells meet, (1, 1) of 1 where these are alike."""
    if light.own is None or owner not in (0, 1):
        return np.ones((1, 1))
    return np.repeat(light.own.sizes[owner], n)[:, None]


def _cell_points(window: Window, own: OwnLenses | None = None) -> Floats:
    """Points (256, 2), or (m, 256, 2) of cells of their own, where the light of a cell that lens 2 can take crosses z = 0, from
    the cell's centre, lengths.
    """
    fill = min(1.0, *(1.0 / abs(one) for one in (window.law.eta_x, window.law.eta_y)))
    quarter = (1.0 if own is not None else fill) * window.lattice.over_cell(sobol(RAYS, 2))
    points = np.concatenate([quarter * signs for signs in ((1, 1), (-1, 1), (1, -1), (-1, -1))])
    return points if own is None else own.fill[:, None, None] * points


def _owners(window: Window) -> list[int | None]:
    """The array that each face of `interfaces` moves with."""
    return [
        other.array if face.array is None else face.array
        for body in window.bodies
        for face, other in ((body.front, body.back), (body.back, body.front))
    ]


def _unit(rows: Floats) -> Floats:
    return np.asarray(rows / np.linalg.norm(rows, axis=-1, keepdims=True))
