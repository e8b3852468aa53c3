"""Position of lens 2 for which the mean exit direction of its cell's light is that of the law.

Paraxial rays place lens 2 for light along the axis. Oblique light hits it off its vertex, and coma and
distortion bias the exit direction. Each cell has its own vertex, so the vertex is moved until the mean exit
direction of the light of the cell's field centre is the expected one: a 2 × 2 secant on the exact trace
(Broyden 1965), many cells at once.

Light of one slope finds the same lenses in every cell. The move is therefore a smooth function of the slope
alone, or, where the law varies and the light does not, of δ (and η) alone, or of both. Up to `DIRECT` cells
the move is solved for each cell. Beyond, it is solved for a subset of cells; a polynomial through these gives
the rest and is checked against cells that it was not fitted to. Cells of a rough table that no polynomial
follows are solved one by one.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import count

import numpy as np

from clacad.base.sobol import sobol
from clacad.base.types import Floats, Ints, Pair2
from clacad.base.vectors import to_sheet, to_surface
from clacad.design.sections import LATTICE
from clacad.optics.rays import Fate
from clacad.optics.sequence import Interface, cross, launch, pass_on, unit_directions
from clacad.optics.surface.sag_and_normal import simplest, stretched
from clacad.prescription.radii import NoSuchLens
from clacad.sheet.face_order import refractions
from clacad.sheet.like_cell import interfaces
from clacad.sheet.volume_and_extent import FIELD
from clacad.sheet.window import Window

RAYS = 64
"""Sobol points over a quarter of the light of a cell;
with their mirror images in x, in y and in both: 256 rays.
"""

BRACKET = 0.3
"""Greatest move of a vertex, as part of the pitch."""

SHARE = 0.25
"""Additional allowed move, as part of the displacement by the varying law."""

STEPS = 24
"""Most steps of the secant; 5 to 8 suffice."""

CLOSE = 1e-13
"""Tolerance of the mean direction (radians): rounding error of a mean of 256."""

DIRECT = 400
"""Greatest number of cells that are solved one by one."""

LADDER = ((260, 11), (700, 17))
"""Number of fitted slopes and total degree of the polynomial;
the second entry is used where the first misses.
"""

OWN_DIRECT = 2000
OWN_LADDER = ((1000, 9), (1900, 12))
"""Number of fitted cells and total degree for lenses of many sizes, where moves are functions of η too."""

WIDE_LADDER = ((1000, 6),)
"""Number of fitted cells and total degree where slope and law are independent: four or five variables."""

MOST_DIRECT, BATCH = 100_000, 500
"""Greatest number of cells that are solved one by one where no polynomial follows them, and together."""

HELD_OUT = 40
"""Number of other slopes that the polynomial is checked against."""

FIT = 1e-9
"""Tolerance of the polynomial at a checked vertex, as part of the pitch:
2e-10 rad for a window of 0.5 mm pitch.
"""

WAY_OUT = 'a viewer or image farther away, a smaller sheet, or pair.offset = "paraxial"'

GRID = 2.0**-40
"""Grid to which vertices are rounded, as part of the pitch.

It is coarser than the effect of the order of sums, so that bytes repeat.
"""


@dataclass(frozen=True, eq=False)
class OwnLenses:
    """Lenses of cells with different sizes.

    sizes : (2 + k, m). Scale factors of lens 1, lens 2, and the k faces of the field lens in the order of the
        light, relative to the window's; k = 0: these are alike.
    aspect : (2 + k, m) or None. Curvature of each along y over that of the scaled lens; None: 1 for all.
    fill : (m,). Part of the cell whose light lens 2 can accept.
    turns : (m, 3, 3) or None. Lens → sheet of all lenses; None: the window's.
    """

    sizes: Floats
    aspect: Floats | None
    fill: Floats
    turns: Floats | None = None

    def of(self, rows: Ints) -> OwnLenses:
        """Lenses of some cells, by their indices (k,) in the list."""
        aspect = None if self.aspect is None else self.aspect[:, rows]
        turns = None if self.turns is None else self.turns[rows]
        return OwnLenses(self.sizes[:, rows], aspect, self.fill[rows], turns)


@dataclass(frozen=True, eq=False)
class CellLight:
    """Light of the field centre of cells, and its expected exit directions.

    slopes : (m, 2). Slopes in air, before the sheet.
    `asked` : (m, 3) unit. Expected exit directions.
    first : (m, 2) lengths. Paraxial displacement of lens 2 of each cell from the window's lens 2.
    variable : (m, 2 ... 5). Variables of which moves are smooth functions.
    key : Key of the design that errors name.
    climb : (2,) or (m, 2). Rise of lens 2 per lateral displacement, as `VertexChange.slope`.
    own : None: the lenses of all cells are alike.
    slides : (k, m, 3) lengths or None
        Displacement of each face of each cell from the window's besides, relative to lens 1.
    copies : 4: the light of a cell is the same after a quarter turn, as its lenses are.
    """

    slopes: Floats
    asked: Floats
    first: Floats
    variable: Floats
    key: str = LATTICE.aperture
    climb: Floats | Pair2 = (0.0, 0.0)
    own: OwnLenses | None = None
    slides: Floats | None = None
    copies: int = 1

    def of(self, rows: Ints) -> CellLight:
        """Light of some cells, by their indices (k,) in the list."""
        return replace(
            self,
            slopes=self.slopes[rows],
            asked=self.asked[rows],
            first=self.first[rows],
            variable=self.variable[rows],
            climb=self.climb if isinstance(self.climb, tuple) else self.climb[rows],
            own=None if self.own is None else self.own.of(rows),
            slides=None if self.slides is None else self.slides[:, rows],
        )


def traced_moves(window: Window, slopes: Floats, slides: Floats | None = None) -> Floats:
    """Moves of lens 2 from its paraxial position, for light of each slope.

    window : Uniform, lens 2 at its paraxial position.
    slopes : (m, 2). Slopes in air of the light of the field centre of each cell.
    slides : (k, m, 3) lengths or None. Displacements of faces, as in `CellLight`.
    Returns (m, 2) lengths.
    Raises NoSuchLens: No vertex within `BRACKET` gives the law, or light is lost on the way.
    """
    asked = _unit(window.law.refract(np.column_stack([slopes, np.ones(len(slopes))])))
    return moves_of(window, CellLight(slopes, asked, np.zeros(slopes.shape), slopes, slides=slides))


def moves_of(window: Window, light: CellLight) -> Floats:
    """Moves of lens 2 from its paraxial position, (m, 2), lengths; see `traced_moves`."""
    if light.own is None:
        return _moves_of(window, light)
    moves = np.empty(light.first.shape)
    whole = light.own.fill == 1.0
    for rows in (
        np.flatnonzero(whole),
        np.flatnonzero(~whole),
    ):  # where lens 2 accepts only a part, the light of a cell differs
        if len(rows):
            moves[rows] = _moves_of(window, light.of(rows))
    return moves


def _moves_of(window: Window, light: CellLight) -> Floats:
    """Moves (m, 2), lengths, of light for which they are a smooth function of `CellLight.variable`."""
    grid = GRID * min(window.lattice.pitch)
    number, many = len(light.slopes), light.variable.shape[1] > 2
    if number <= (OWN_DIRECT if many else DIRECT):
        return np.asarray(np.rint(_solved(window, light) / grid) * grid)
    for nodes, degree in {2: LADDER, 3: OWN_LADDER}.get(light.variable.shape[1], WIDE_LADDER):
        moves, missed = _by_polynomial(window, light, nodes, degree)
        if missed <= FIT * min(window.lattice.pitch):
            return np.asarray(np.rint(moves / grid) * grid)
    if number > MOST_DIRECT:
        raise NoSuchLens(
            f"the vertices of lens 2 change too sharply between cells to be found within {FIT:g} of the"
            " pitch",
            key=light.key,
            code="CL123",
            hint=WAY_OUT,
        )
    batches = np.split(np.arange(number), range(BATCH, number, BATCH))
    moves = np.concatenate([_solved(window, light.of(rows), moves[rows]) for rows in batches])
    return np.asarray(np.rint(moves / grid) * grid)


def _by_polynomial(window: Window, light: CellLight, count: int, degree: int) -> tuple[Floats, float]:
    """Moves (m, 2) by a polynomial through `count` of them, and its greatest error at others."""
    variable = light.variable
    order = np.argsort(sobol(len(variable), 1)[:, 0], kind="stable")
    middle, reach = variable.mean(axis=0), np.ptp(variable, axis=0) / 2.0
    many = variable.shape[1] > 2
    reach = np.where(reach == 0.0, 1.0, reach) if many else reach.max() or 1.0
    far = (variable - middle) / reach if many else variable - middle
    outer = np.argsort(-(far**2).sum(axis=1), kind="stable")[: count // 5]
    nodes = np.unique(np.concatenate([outer, order[: count - len(outer)]]))
    held = np.setdiff1d(order[count : count + 2 * HELD_OUT], nodes)[:HELD_OUT]
    solved = _solved(window, light.of(np.concatenate([nodes, held])))
    scaled = (variable - middle) / reach
    terms, *_ = np.linalg.lstsq(_powers(scaled[nodes], degree), solved[: len(nodes)], rcond=None)
    moves = np.asarray(_powers(scaled, degree) @ terms)
    judged = np.concatenate([nodes, held]) if many else held
    return moves, float(np.abs(moves[judged] - solved[len(solved) - len(judged) :]).max(initial=0.0))


def _powers(t: Floats, degree: int) -> Floats:
    """Products of Chebyshev polynomials (m, k) of total degree up to `degree` at points (m, 2 ... 5)."""
    first, *more = (np.polynomial.chebyshev.chebvander(column, degree) for column in t.T)
    flat = [(first[:, i], degree - i) for i in range(degree + 1)]
    for column in more:
        flat = [(one * column[:, k], rest - k) for one, rest in flat for k in range(rest + 1)]
    return np.column_stack([one for one, _ in flat])


def _solved(window: Window, light: CellLight, start: Floats | None = None) -> Floats:
    """Moves (m, 2) of lens 2, each by its own secant iteration from `start`, all traced together."""
    seq, points, owners = interfaces(window), _cell_points(window, light.own, light.copies), _owners(window)
    if light.own is None or light.own.aspect is None:  # a quadric is stretched otherwise than its biconic
        seq = [replace(one, surface=simplest(one.surface)) for one in seq]
    slopes, asked = light.slopes, light.asked
    if not np.isfinite(asked).all():
        raise NoSuchLens("the law gives no direction for light of this slope", light.key, code="CL123")
    inverse = _paraxial(window, light)
    far = light.first if light.slides is None else light.first + light.slides[owners.index(1), :, :2]
    allowed = BRACKET * min(window.lattice.pitch) + SHARE * np.abs(far).max(axis=1)
    move = np.clip(0.0 if start is None else start, -allowed[:, None], allowed[:, None]) + np.zeros((1, 2))
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
        )  # for oblique light the first (paraxial) step is too long
        step = np.where(beyond, np.copysign(allowed[:, None], step) - move, step)
        after = _bias(seq, owners, points, light, light.first + move + step)
        inverse = _broyden(inverse, step, after - error)
        move, error = move + step, after
    worst = int(np.argmax(np.where(np.isfinite(error), np.abs(error), np.inf).max(axis=1)))
    raise NoSuchLens(
        f"no place of lens 2 within {BRACKET:g} of the pitch sends the light of slope "
        f"({slopes[worst, 0]:.4g}, {slopes[worst, 1]:.4g}) where the law asks",
        key=light.key,
        code="CL123",
        hint=WAY_OUT,
    )


def _paraxial(window: Window, light: CellLight) -> Floats:
    """Moves of lens 2 per change of the exit slope (m, 2, 2): its focal lengths along its axes, lengths."""
    own, focal = light.own, np.array(window.thin.focal_length[1])
    focal = np.tile(np.where(np.isfinite(focal), focal, 0.0), (len(light.slopes), 1))
    turned = window.thin.rotation[:2, :2]
    if own is not None:
        focal *= own.sizes[1][:, None]
        if own.aspect is not None:
            focal[:, 1] /= own.aspect[1]
        turned = turned if own.turns is None else own.turns[:, :2, :2]
    return np.asarray((turned * focal[:, None]) @ turned.swapaxes(-1, -2))


def _broyden(inverse: Floats, step: Floats, change: Floats) -> Floats:
    """Updated inverse Jacobians (m, 2, 2) that map the last changes (m, 2) to the last steps (m, 2)."""
    seen = np.einsum("kij,kj->ki", inverse, change)
    along = np.einsum("ki,kij->kj", step, inverse)
    scale = np.einsum("ki,ki->k", step, seen)
    moved = np.abs(scale) > 0.0
    add = np.einsum("ki,kj->kij", step - seen, along) / np.where(moved, scale, 1.0)[:, None, None]
    return np.where(moved[:, None, None], inverse + add, inverse)


def _bias(
    seq: list[Interface], owners: list[int | None], points: Floats, light: CellLight, move: Floats
) -> Floats:
    """Mean exit direction minus the expected, x and y, (m, 2); lens 2 of m cells moved by `move`."""
    slopes, asked = light.slopes, light.asked
    m, n = len(slopes), points.shape[-2]
    ray = np.repeat(np.column_stack([slopes, np.ones(m)]), n, axis=0)
    low = min(interface.vertex[2] for interface in seq) - 4.0 * float(np.abs(points).max())
    at = np.broadcast_to(points, (m, n, 2)).reshape(-1, 2)
    start = np.column_stack([at + low * ray[:, :2], np.full(m * n, low)])
    direction, scaled = unit_directions(ray)
    offset, travelled = launch(start, scaled, seq[0].vertex)
    slide = np.repeat(_slides(owners, move, light), n, axis=1)
    numbers = _numbers(owners)
    sizes = _sizes(numbers, light, n)
    turns = None if light.own is None or light.own.turns is None else np.repeat(light.own.turns, n, axis=0)
    for k, interface in enumerate(seq):
        if k:
            offset, travelled = pass_on(offset, seq[k - 1].vertex, interface.vertex), np.zeros(m * n)
            offset = offset + slide[k - 1] - slide[k]
        size = sizes[k]
        number = numbers[k]
        if light.own is not None and light.own.aspect is not None and number < len(light.own.aspect):
            aspect = np.repeat(light.own.aspect[number], n)
            interface = replace(interface, surface=stretched(interface.surface, aspect))
        turn = None if owners[k] is None else turns
        if turn is not None:  # each lens is crossed in its own axes
            interface = replace(interface, rotation=None)
        at, ray = to_surface(turn, offset / size), to_surface(turn, direction)
        crossing = cross(interface, at, ray, travelled / size[..., 0])
        offset, direction = (
            to_sheet(turn, crossing.offset) * size,
            np.where((crossing.fate == Fate.ALIVE)[:, None], to_sheet(turn, crossing.direction), np.nan),
        )
    mean = _unit(direction.reshape(m, n, 3).mean(axis=1))
    return np.asarray((mean - asked)[:, :2])


def _slides(owners: list[int | None], move: Floats, light: CellLight) -> Floats:
    """Displacement (k, m, 3) of every face of m cells, with lens 2 moved by `move` (m, 2)."""
    found = np.zeros((len(owners), len(move), 3)) if light.slides is None else light.slides.copy()
    climb = np.array(light.climb)
    rise = move @ climb if climb.ndim == 1 else (move * climb).sum(axis=1)
    found[[k for k, owner in enumerate(owners) if owner == 1]] += np.column_stack([move, rise])
    return found


def field_moves(window: Window, placed: Window, cells: Ints) -> Floats:
    """Displacement (k, m, 3), relative to lens 1, of the faces of a field lens in `cells` (m, 2) of a placed
    window; 0 of other faces.

    window : the uniform window that it was placed from
    """
    faces = [
        (old, new)
        for (_, old, *_), (_, new, *_) in zip(*map(refractions, (window.bodies, placed.bodies)), strict=True)
    ]
    found = np.zeros((len(faces), len(cells), 3))
    for moved, (old, new) in zip(found, faces, strict=True):
        if new.array == FIELD:
            moved += placed.vertices(new, cells) - old.vertex
            moved[:, :2] += placed.centres(FIELD, cells) - placed.centres(0, cells) - window.shifts[FIELD]
    return found


def _numbers(owners: list[int | None]) -> list[int]:
    """Row of each face in `OwnLenses`, or one beyond its last for a plane under the whole sheet."""
    fields = count(FIELD)
    return [len(owners) + 2 if one is None else next(fields) if one == FIELD else one for one in owners]


def _sizes(numbers: list[int], light: CellLight, n: int) -> list[Floats]:
    """Scale factors of every face hit by n rays of m cells, (m n, 1) each; (1, 1) of 1 if alike."""
    own = () if light.own is None else light.own.sizes
    return [np.repeat(own[k], n)[:, None] if k < len(own) else np.ones((1, 1)) for k in numbers]


def _cell_points(window: Window, own: OwnLenses | None = None, copies: int = 1) -> Floats:
    """Points (256, 2), or (m, 256, 2) for cells of different sizes, at z = 0 of the light that lens 2 can
    accept, relative to the cell's centre, lengths.
    """
    fill = min(1.0, *(1.0 / abs(one) for one in (window.law.eta_x, window.law.eta_y)))
    quarter = (1.0 if own is not None else fill) * window.lattice.over_cell(sobol(RAYS, 2))
    if copies == 4:
        quarter = np.concatenate([quarter[: RAYS // 2], quarter[: RAYS // 2, ::-1]])
    points = np.concatenate([quarter * signs for signs in ((1, 1), (-1, 1), (1, -1), (-1, -1))])
    return points if own is None else own.fill[:, None, None] * points


def _owners(window: Window) -> list[int | None]:
    """Array with whose lenses each face of `interfaces` moves; None for planes under the whole sheet."""
    return [face.array for _, face, _, _ in refractions(window.bodies)]


def _unit(rows: Floats) -> Floats:
    return np.asarray(rows / np.linalg.norm(rows, axis=-1, keepdims=True))
