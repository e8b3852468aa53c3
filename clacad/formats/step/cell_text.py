"""Text of plain cells (`clacad.solid.cell_arrays`): numbered by sums, written by templates.

Everything else of a body is written entity by entity (`clacad.formats.step.shell_text`), and so are the parts
that both share: vertices of mixed nodes, and edges between a plain cell and one that is not. Lengths in mm.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from clacad.base.types import Floats, Ints
from clacad.formats.step.part21 import Part21
from clacad.formats.step.shell_text import TextWriter
from clacad.solid.cell_arrays import ROWS, Bools, CellArrays, SharedParts
from clacad.solid.edge_classes import Plane
from clacad.solid.rational_conics import LensGeometry
from clacad.solid.shells import NodeVertices, Role

_WEIGHT = "%.13f"
_SHARE = "%.15f"
"""Parameters of a patch, 0 … 1."""

_POINT = "#%d=CARTESIAN_POINT('',({}));\n"
_EDGE = "#%d=EDGE_CURVE('',#%d,#%d,#%d,.T.);\n"


class SheetWriter(TextWriter):
    """A `TextWriter` that takes plain cells in arrays; see `clacad.solid.cell_arrays.CellWriter`."""

    def cells(self, cells: CellArrays, shared: SharedParts) -> tuple[Ints, Ints]:
        """Write all plain cells and borders: number of the cell that owns every face, and of the face."""
        text = _Text(self, cells, shared)
        skins = [_Skin(text, number) for number in range(len(cells.lenses))]
        owners, faces = [], []
        for at in range(0, len(cells.cells), ROWS):
            batch = np.arange(at, min(at + ROWS, len(cells.cells)))
            for skin in skins:
                _write_nodes(skin, batch)
                for owner, face in (_Lenses(skin, batch).write(), _write_walls(skin, batch)):
                    owners.append(owner)
                    faces.append(face)
        return np.concatenate(owners), np.concatenate(faces)

    def ring_faces(
        self, edges: Ints, senses: Sequence[str], surfaces: Ints, same_sense: bool, role: Role
    ) -> Ints:
        """Write faces of one loop each; their numbers (n,).

        edges : (n, k). Entities of the edges of every loop.
        senses : k of "T" or "F". Directions of the edges in the loops.
        surfaces : (n,). Entities of the surfaces.
        """
        many, k = edges.shape
        first = self.part.reserve(many * (k + 3)) + (k + 3) * np.arange(many)[:, None]
        number = first + np.arange(k + 3)
        uses = np.stack([number[:, :k], edges], axis=2).reshape(many, 2 * k)
        template = (
            "".join(f"#%d=ORIENTED_EDGE('',*,*,#%d,.{sense}.);\n" for sense in senses)
            + f"#%d=EDGE_LOOP('',({','.join(['#%d'] * k)}));\n#%d=FACE_OUTER_BOUND('',#%d,.T.);\n"
            + f"#%d=ADVANCED_FACE('{role}',(#%d),#%d,.{'T' if same_sense else 'F'}.);\n"
        )
        ring, bound, face = number[:, k], number[:, k + 1], number[:, k + 2]
        columns = (uses, ring, number[:, :k], bound, ring, face, bound, surfaces)
        _put(self.part, template, *columns)
        listed = len(self.faces) + np.arange(many)
        self.faces += face.tolist()
        self.roles += [role] * many
        return listed


class _Text:
    """What the lens faces of one tiling share."""

    def __init__(self, writer: SheetWriter, cells: CellArrays, shared: SharedParts) -> None:
        self.writer, self.part, self.cells, self.shared = writer, writer.part, cells, shared
        self.point = _POINT.format(",".join([f"%.{self.part.decimals}f"] * 3))
        sides = np.arange(len(cells.tile))
        self.half = len(sides) // 2
        forward = sides < self.half
        self.starts = np.where(forward, sides, (sides + 1) % len(sides))
        self.ends = np.where(forward, (sides + 1) % len(sides), sides)
        self.sector = np.array([ring.sector for ring in cells.rings])
        self.firsts = sorted({ring.cells[0][1] for ring in cells.rings})
        self._touched: dict[int, NodeVertices] = {}

    def node(self, number: int) -> NodeVertices:
        """Vertices of a mixed node, which are written one by one."""
        if number not in self._touched:
            kind, anchor = divmod(number, len(self.cells.cells))
            self._touched[number] = self.shared.node(anchor, self.firsts[kind])
        return self._touched[number]


def _put(part: Part21, template: str, *columns: Floats | Ints) -> None:
    """Write one copy of a template a row; columns (n,) or (n, k) in the order of its fields."""
    rows = np.column_stack(columns)
    if len(rows):
        part.raw((template * len(rows)) % tuple(rows.ravel().tolist()))


def _reserved(part: Part21, sizes: Ints) -> Ints:
    """First numbers of blocks of entities of the given sizes (any shape)."""
    flat = sizes.ravel()
    ends = np.cumsum(flat)
    first = part.reserve(int(ends[-1]) if len(ends) else 0)
    return np.asarray((first + ends - flat).reshape(sizes.shape))


class _Skin:
    """Entity numbers of one lens face of all cells.

    place : (nodes, sectors). Level of the cell in every sector.
    points, vertices, verticals : (nodes, levels). Point and vertex of every level, and the edge above it.
    surfaces : (n,). Surface of every cell; the nine poles of its patch come before it.
    shapes : (m,) or None. Representation of the parameter curve of every side, where all cells are alike.
    curves : (n, m). Parameter curve of every plain border of a cell; its parts come before it.
    own : (n, m) bool
        Which edges the cell writes: its own along a step, one for both where the lenses coincide.
    edges : (n, m)
        Edge along every plain border of a cell, whichever cell writes it; its parts come before it.
    """

    def __init__(self, text: _Text, number: int) -> None:
        cells, part = text.cells, text.part
        self.text, self.lens = text, cells.lenses[number]
        self.levels, self.borders = cells.skin_nodes[number], cells.skin_borders[number]
        self.back = self.lens.side < 0
        self._number_nodes()
        self.surfaces = _reserved(part, np.where(cells.plain, 10, 0)) + 9
        with_curves, alike = text.writer.with_curves, self.lens.alike
        self.shapes = _reserved(part, np.full(len(cells.tile), 5)) + 4 if with_curves and alike else None
        each = (1 if alike else 6) if with_curves else 0
        self.curves = _reserved(part, np.where(cells.borders, each, 0)) + each - 1
        self.own = cells.borders.copy()
        for k in range(text.half):
            across = np.where(cells.borders[:, k + text.half], cells.neighbours[:, k + text.half], 0)
            self.own[:, k + text.half] &= self.borders.stepped[across, k]
        self.edge_parts = 3 if with_curves else 2
        self.edges = _reserved(part, np.where(self.own, self.edge_parts + 1, 0)) + self.edge_parts
        for k in range(text.half):
            away = k + text.half
            other = cells.borders[:, away] & ~self.own[:, away]
            self.edges[other, away] = self.edges[cells.neighbours[other, away], k]

    def _number_nodes(self) -> None:
        cells, count = self.text.cells, self.levels.count
        self.place = self.levels.place.copy()
        sizes = np.where(cells.whole & ~cells.mixed, (2 + (count > 1)) * count, 0)
        base = _reserved(self.text.part, sizes)[:, None]
        level = np.arange(self.place.shape[1])
        self.points = base + level
        self.vertices = base + count[:, None] + level
        self.verticals = base + 2 * count[:, None] + 1 + level
        self._lowest = {node: self._take(node) for node in np.flatnonzero(cells.mixed).tolist()}

    def _take(self, node: int) -> int:
        """Take levels and vertices of a mixed node from its description; its lowest level on this face."""
        made, text = self.text.node(node), self.text
        levels = [pair[self.lens.face] for pair in made.levels.place]
        known = {level for level in levels if level is not None}
        low = min(known)
        self.place[node] = [0 if level is None else level - low for level in levels]
        for level in known:
            vertex = text.shared.vertex(made, level)
            self.points[node, level - low] = text.writer.points[vertex]
            self.vertices[node, level - low] = text.writer.vertices[vertex]
        return low

    def at_corner(self, cell: Ints, corner: Ints) -> tuple[Ints, Ints]:
        """Point and vertex of the lens of every cell at a corner."""
        node = self.text.cells.nodes[cell, corner]
        level = self.place[node, self.text.sector[corner]]
        return self.points[node, level], self.vertices[node, level]

    def rising(self, node: Ints, low: Ints, count: int, ray: int, forward: bool) -> Ints:
        """Vertical edges (n, count) of nodes above a level; `forward`: their direction in their faces."""
        edges: Ints = self.verticals[node[:, None], low[:, None] + np.arange(count)]
        for row in np.flatnonzero(self.text.cells.mixed[node]).tolist():
            at = int(node[row])
            for n in range(count):
                level = self._lowest[at] + int(low[row]) + n
                number = self.text.shared.vertical(self.text.node(at), level, ray)
                self.text.writer.use(number, forward, None, -1)
                edges[row, n] = self.text.writer.edges[number]
        return edges


# -- nodes ------------------------------------------------------------------------------------------


def _write_nodes(skin: _Skin, batch: Ints) -> None:
    """Vertices and vertical edges of the nodes whose first cell is in the batch."""
    cells, text = skin.text.cells, skin.text
    for kind, corner in enumerate(text.firsts):
        node = batch + kind * len(cells.cells)
        node = node[cells.whole[node] & ~cells.mixed[node]]
        place = cells.centres[node % len(cells.cells)] + cells.tile[corner]
        for count in range(1, skin.place.shape[1] + 1):
            chosen = skin.levels.count[node] == count
            _write_lines(skin, node[chosen], place[chosen], count)


def _write_lines(skin: _Skin, node: Ints, place: Floats, count: int) -> None:
    """Vertices and vertical edges of nodes with the same number of levels, at places (n, 2)."""
    text = skin.text
    template, columns = "", list[Floats | Ints]()
    for level in range(count):
        template += text.point + "#%d=VERTEX_POINT('',#%d);\n"
        point = skin.points[node, level]
        columns += [point, place, skin.levels.z[node, level], skin.vertices[node, level], point]
    if count > 1:
        line = skin.verticals[node, 0] - 1
        template += f"#%d=LINE('',#%d,#{text.writer.geometry.vector((0.0, 0.0, 1.0))});\n"
        columns += [line, skin.points[node, 0]]
        for level in range(count - 1):
            template += _EDGE
            ends = skin.vertices[node, level], skin.vertices[node, level + 1]
            columns += [skin.verticals[node, level], *ends, line]
    _put(text.part, template, *columns)


# -- lenses -----------------------------------------------------------------------------------------


class _Lenses:
    """Patches, borders and faces of the plain cells of a batch."""

    def __init__(self, skin: _Skin, batch: Ints) -> None:
        text = skin.text
        self._skin, self._text, self._cells = skin, text, text.cells
        self._batch = batch[text.cells.plain[batch]]
        tile = text.cells.tile
        self._made: LensGeometry = skin.lens.of(self._batch).geometry(tile[text.starts], tile[text.ends])

    def write(self) -> tuple[Ints, Ints]:
        """Write them: number of the cell that owns every face, and of the face."""
        if not len(self._batch):
            return self._batch, self._batch
        self._patches()
        if self._text.writer.with_curves:
            self._curves()
        self._edges()
        return self._faces()

    def _patches(self) -> None:
        rows = ",".join(["(#%d,#%d,#%d)"] * 3)
        weights = ",".join([f"({','.join([_WEIGHT] * 3)})"] * 3)
        template = self._text.point * 9 + (
            f"#%d=(BOUNDED_SURFACE()B_SPLINE_SURFACE(2,2,({rows}),.UNSPECIFIED.,.F.,.F.,.F.)"
            "B_SPLINE_SURFACE_WITH_KNOTS((3,3),(3,3),(0.,1.),(0.,1.),.UNSPECIFIED.)"
            f"GEOMETRIC_REPRESENTATION_ITEM()RATIONAL_B_SPLINE_SURFACE(({weights}))"
            "REPRESENTATION_ITEM('')SURFACE());\n"
        )
        surface, many = self._skin.surfaces[self._batch], len(self._batch)
        poles = np.empty((many, 9, 4))
        poles[:, :, 0] = surface[:, None] + np.arange(-9, 0)
        poles[:, :, 1:] = self._made.patch.reshape(-1, 9, 3)
        poles[:, :, 1:3] += self._cells.centres[self._batch][:, None]
        weight = np.broadcast_to(self._made.patch_weights.reshape(-1, 9), (many, 9))
        _put(self._text.part, template, poles.reshape(many, -1), surface, poles[:, :, 0], weight)

    def _curves(self) -> None:
        """Parameter curves of borders; their representations once a side where all cells are alike."""
        skin = self._skin
        cell, side = np.nonzero(self._cells.borders[self._batch])
        surface, number = skin.surfaces[self._batch[cell]], skin.curves[self._batch[cell], side]
        shape = number - 1
        if skin.shapes is None:
            self._shapes(cell, side, shape)
        else:
            shape = skin.shapes[side]
            if self._batch[0] == np.argmax(self._cells.plain):
                sides = np.arange(len(skin.shapes))
                self._shapes(np.zeros_like(sides), sides, skin.shapes)
        _put(self._text.part, "#%d=PCURVE('',#%d,#%d);\n", number, surface, shape)

    def _shapes(self, cell: Ints, side: Ints, last: Ints) -> None:
        """Curves along sides of cells in the parameters of their patches, and their representations."""
        template = _POINT.format(f"{_SHARE},{_SHARE}") * 3 + (
            f"#%d={_arc_text(f'1.,{_SHARE},{_SHARE}')};\n"
            f"#%d=DEFINITIONAL_REPRESENTATION('',(#%d),#{self._text.part.parameter_space});\n"
        )
        points = np.empty((len(cell), 3, 3))
        points[:, :, 0] = last[:, None] + np.arange(-4, -1)
        points[:, :, 1:] = self._made.curves[cell, side]
        weights = self._made.curve_weights[cell, side, 1:]
        _put(
            self._text.part,
            template,
            points.reshape(-1, 9),
            last - 1,
            points[:, :, 0],
            weights,
            last,
            last - 1,
        )

    def _edges(self) -> None:
        """Edges that the cells of the batch write."""
        skin, cells, text, made = self._skin, self._cells, self._text, self._made
        cell, side = np.nonzero(skin.own[self._batch])
        row, owner = np.zeros_like(cell) if skin.lens.alike else cell, self._batch[cell]
        number = skin.edges[owner, side]
        start, end = (skin.at_corner(owner, corner[side]) for corner in (text.starts, text.ends))
        inner = made.arcs[row, side, 1]
        inner = np.column_stack([inner[:, :2] + cells.centres[owner], inner[:, 2]])
        point, curve = number - skin.edge_parts, number - skin.edge_parts + 1
        template = text.point + f"#%d={_arc_text(f'1.,{_WEIGHT},1.')};\n"
        columns = [point, inner, curve, start[0], point, end[0], made.weights[row, side, 1]]
        ends = [number, start[1], end[1]]
        if not text.writer.with_curves:
            _put(text.part, template + _EDGE, *columns, *ends, curve)
            return
        alone = (side >= text.half) | skin.borders.stepped[owner, np.minimum(side, text.half - 1)]
        columns += [number - 1, curve, skin.curves[owner, side]]
        for which, uses in ((alone, 1), (~alone, 2)):
            chosen = [column[which] for column in columns]
            if uses == 2:
                k = side[which]
                chosen.append(skin.curves[cells.neighbours[owner[which], k], k + text.half])
            used = ",".join(["#%d"] * uses)
            middle = f"#%d=SURFACE_CURVE('',#%d,({used}),.PCURVE_S1.);\n"
            final = [column[which] for column in (*ends, number - 1)]
            _put(text.part, template + middle + _EDGE, *chosen, *final)

    def _faces(self) -> tuple[Ints, Ints]:
        """Faces: of cells with plain borders all round, then of the others one by one."""
        skin, cells, text = self._skin, self._cells, self._text
        sides = np.arange(len(cells.tile)) if skin.back else np.arange(len(cells.tile))[::-1]
        closed = cells.borders[self._batch].all(axis=1)
        whole, rest = self._batch[closed], self._batch[~closed]
        senses = ["T" if (k < text.half) == skin.back else "F" for k in sides]
        surfaces = skin.surfaces[whole]
        found = [text.writer.ring_faces(skin.edges[whole][:, sides], senses, surfaces, skin.back, "lens")]
        found += [self._face(cell, sides.tolist()) for cell in rest.tolist()]
        return np.concatenate([whole, rest]), np.concatenate(found)

    def _face(self, cell: int, sides: list[int]) -> Ints:
        """Face of a cell some of whose borders are described one by one."""
        skin, writer = self._skin, self._text.writer
        writer.round.append(None)
        writer.surfaces.append(int(skin.surfaces[cell]))
        edges, senses = [], []
        for k in sides:
            if self._cells.borders[cell, k]:
                edges.append(int(skin.edges[cell, k]))
                senses.append("T" if (k < self._text.half) == skin.back else "F")
                continue
            loop = self._text.shared.side(cell, k, skin.lens.face)
            for use in loop if skin.back else reversed(loop):
                forward = use.forward == skin.back
                writer.use(use.edge, forward, use.parameters, len(writer.surfaces) - 1)
                edges.append(writer.edges[use.edge])
                senses.append("T" if forward else "F")
        return writer.ring_faces(np.array([edges]), senses, skin.surfaces[[cell]], skin.back, "lens")


def _arc_text(weights: str) -> str:
    """A rational quadratic arc through three poles."""
    return (
        "(BOUNDED_CURVE()B_SPLINE_CURVE(2,(#%d,#%d,#%d),.UNSPECIFIED.,.F.,.F.)"
        "B_SPLINE_CURVE_WITH_KNOTS((3,3),(0.,1.),.UNSPECIFIED.)CURVE()GEOMETRIC_REPRESENTATION_ITEM()"
        f"RATIONAL_B_SPLINE_CURVE(({weights}))REPRESENTATION_ITEM(''))"
    )


# -- walls ------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Walls:
    """Walls along side k of cells: higher and lower edges, planes, whether the first cell is solid.

    node, low, span : (start, end), (n,) each
        Node at either end, the lower level there, and the number of levels up to the higher one.
    ray : (start, end). Ray of the walls round the nodes.
    """

    left: Ints
    right: Ints
    solid: Bools
    low_edge: Ints
    high_edge: Ints
    planes: Ints
    node: tuple[Ints, Ints]
    low: tuple[Ints, Ints]
    span: tuple[Ints, Ints]
    ray: tuple[int, int]


def _write_walls(skin: _Skin, batch: Ints) -> tuple[Ints, Ints]:
    """Walls of the plain borders whose first cell is in the batch: owners and numbers of their faces."""
    owners, faces = [batch[:0]], [batch[:0]]
    for k in range(skin.text.half):
        walls = _walls(skin, batch, k)
        kinds = np.column_stack([*walls.span, walls.solid])
        for near, far, solid in np.unique(kinds, axis=0).tolist():
            chosen = (kinds == (near, far, solid)).all(axis=1)
            up = skin.rising(walls.node[1][chosen], walls.low[1][chosen], far, walls.ray[1], bool(solid))
            down = skin.rising(walls.node[0][chosen], walls.low[0][chosen], near, walls.ray[0], not solid)
            edges = np.column_stack([walls.low_edge[chosen], up, walls.high_edge[chosen], down[:, ::-1]])
            senses = ["T"] + ["T"] * far + ["F"] + ["F"] * near
            if not solid:
                edges, senses = edges[:, ::-1], ["F" if sense == "T" else "T" for sense in senses[::-1]]
            planes = walls.planes[chosen]
            faces.append(skin.text.writer.ring_faces(edges, senses, planes, bool(solid), "wall"))
            owners.append(walls.left[chosen] if solid else walls.right[chosen])
    return np.concatenate(owners), np.concatenate(faces)


def _walls(skin: _Skin, batch: Ints, k: int) -> _Walls:
    text, cells, m = skin.text, skin.text.cells, len(skin.text.cells.tile)
    left = batch[cells.borders[batch, k] & skin.borders.stepped[batch, k]]
    right, high = cells.neighbours[left, k], skin.borders.high[left, k]
    own, other = skin.edges[left, k], skin.edges[right, k + text.half]
    nodes, lows, spans = [], [], []
    for end in (0, 1):
        corner, across = (k + end) % m, (k + text.half + 1 - end) % m
        node = cells.nodes[left, corner]
        levels = skin.place[node, text.sector[corner]], skin.place[node, text.sector[across]]
        nodes.append(node)
        lows.append(np.minimum(*levels))
        spans.append(np.abs(levels[0] - levels[1]))
    return _Walls(
        left,
        right,
        high == skin.back,
        np.where(high, other, own),
        np.where(high, own, other),
        _planes(text, left, k),
        (nodes[0], nodes[1]),
        (lows[0], lows[1]),
        (spans[0], spans[1]),
        (int(text.sector[k] - 1) % skin.place.shape[1], int(text.sector[(k + 1) % m])),
    )


def _planes(text: _Text, left: Ints, k: int) -> Ints:
    """Planes of walls along side k of cells; one for all walls that lie in it."""
    tile = text.cells.tile
    way = tile[(k + 1) % len(tile)] - tile[k]
    along = np.append(way / np.hypot(*way), 0.0)
    normal = np.array([along[1], -along[0], 0.0])
    start = text.cells.centres[left] + tile[k]
    distance = np.round(start @ normal[:2], text.part.decimals)
    _, first, kind = np.unique(distance, return_index=True, return_inverse=True)
    planes = [Plane(np.append(start[n], 0.0), normal, along) for n in first.tolist()]
    numbers = [text.writer.geometry.plane(plane, np.zeros(3)) for plane in planes]
    return np.array(numbers, dtype=np.int64)[kind]
