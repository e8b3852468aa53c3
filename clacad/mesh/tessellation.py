"""Make watertight meshes of a window, by slope error or by quads per cell side."""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil

from clacad.mesh.body_mesh import BodyMesh, Mesh, no_plain
from clacad.mesh.cell_template import TemplateMaker
from clacad.mesh.facet_error import facet_errors
from clacad.mesh.integer_heights import NONE, CellLevels, merge_steps, z_step
from clacad.mesh.land_triangles import make_plain
from clacad.mesh.prototile import make_prototile
from clacad.mesh.tiled import Tiled
from clacad.sheet.need_window import need_equal_cells, need_window
from clacad.sheet.window import Body, Window
from clacad.topology.build_complex import cell_complex, saddle_count
from clacad.topology.cannot_build import CannotBuild, refuse_buried_land
from clacad.topology.complex_parts import CellComplex

COARSEST = 1e-2  # largest step of heights, in body thicknesses
MOST_QUADS = 2048  # a prototile of 17 M triangles


def tessellate(
    window: Window, slope_error: float | None = None, quads: int | None = None, merge: float | None = None,
    saddle_bevel: float = 0.0,
) -> Mesh:  # fmt: skip
    """Mesh every body of a window, watertight by construction.

    Exactly one of `slope_error` and `quads` must be given.

    Parameters
    ----------
    window : Window
    slope_error : float, optional
        Largest rms angle allowed between facet and exact normal (radians).
    quads : int, optional
        Grid steps along each side of a cell's optical zone.
    merge : length, optional
        Steps between neighbours below this height are closed. Default: four z steps.
    saddle_bevel : length, optional
        Width of the bevels that give real contact to columns which only touch at a saddle. Default 0: none;
        the columns keep separate vertices and the surface is exact.

    Returns
    -------
    Mesh

    Raises
    ------
    TypeError
        A design in place of the window.
    ValueError
        Neither or both were given; the slope error would need more than 2048 quads a side; a lenslet's surface ends
        inside its cell; a cell reaches beyond the outline; a bevel is too wide or too narrow.
    """
    need_window(window, "tessellate", ", quads=16")
    if saddle_bevel > 0.0:
        need_equal_cells(
            window, "a bevel at saddles", "without them columns that touch keep vertices of their own"
        )
    if (slope_error is None) == (quads is None):
        raise ValueError("tessellate needs exactly one of slope_error (radians) and quads (per cell side)")
    if quads is None:
        assert slope_error is not None
        quads = forecast_quads(window, slope_error)
    if quads < 1:
        raise ValueError(f"quads = {quads}: at least 1 is needed")
    bodies = tuple(mesh_body(window, body, quads, merge, saddle_bevel) for body in window.bodies)
    return Mesh(window, bodies, quads)


def mesh_body(
    window: Window, body: Body, quads: int, merge: float | None = None, saddle_bevel: float = 0.0
) -> BodyMesh:
    """Mesh one body; see `tessellate`."""
    parts = _parts(window, body, merge, saddle_bevel)
    tiled = tuple(parts.tiled(n, quads) for n in range(len(parts.cells.tilings)))
    tiles = [one.maker.tile for one in tiled]
    ringed = window.outline is not None and all(abs(level) != NONE for tile in tiles for level in tile.land)
    if len(tiled) > 1 and not ringed:
        raise CannotBuild(
            "CL134",
            f"body {body.name!r} needs land on both faces out to its outline: give body.border a width",
        )
    plain = make_plain(window, tiled, parts.step) if ringed else no_plain()
    return BodyMesh(
        body.name,
        window,
        body,
        tiled,
        ringed,
        plain,
        parts.step,
        saddle_count(parts.cells),
        window.lattice.cell_count * sum(tile.bevel_volume() for tile in tiles),
    )


@dataclass(frozen=True, eq=False)
class _Parts:
    """A body's complex and the z lattice its meshes use."""

    window: Window
    body: Body
    cells: CellComplex
    step: float
    gap: int
    bevel: float

    def tiled(self, number: int, quads: int) -> Tiled:
        """One tiling: with one prototile, or with one per cell."""
        tiling = self.cells.tilings[number]
        make = CellLevels(self.window, self.body, self.cells, tiling, self.step, self.gap, self.bevel)
        lattice = self.window.lattice_of(tiling.array)
        faces = [self.body.front, self.body.back]
        mine = [face for face, here in zip(faces, make.meshed()) if here and face.change is not None]
        if not mine:
            return Tiled(TemplateMaker(make_prototile(make, quads), lattice), tiling.shift, lattice)
        from clacad.mesh.own_cells import OwnTemplates  # not needed for uniform sheets

        own = OwnTemplates(make, quads)
        i, j = next(
            row[0] for n in range(self.window.lattice.count[1]) if len(row := self.window.lattice.row(n))
        ).tolist()
        return Tiled(own.at((i, j)), tiling.shift, lattice, own)


def _parts(window: Window, body: Body, merge: float | None, bevel: float = 0.0) -> _Parts:
    refuse_buried_land(body.front, body.back)
    step = z_step(window)
    thick = abs(body.back.vertex[2] - body.front.vertex[2])
    if step > COARSEST * thick > 0.0:
        raise CannotBuild(
            "CL137",
            f"heights near z = {max(map(abs, window.z_range)):.3g} are multiples of {step:.3g} in a float32 file, and "
            f"body {body.name!r} is {thick:.3g} thick: no mesh holds it; STEP does, or a shorter pair.separation",
        )
    gap = merge_steps(merge, step)
    cells = cell_complex(window, body, merge=gap * step, spacing=0.0)
    return _Parts(window, body, cells, step, gap, bevel)


def count_facets(window: Window, quads: int) -> int:
    """Exact number of triangles of the mesh with this number of quads, without expanding it."""
    return tessellate(window, quads=quads).facet_count


def forecast_bytes(window: Window, quads: int) -> int:
    """Size of the binary STL files of all bodies together (84 bytes each, and 50 per triangle)."""
    return 84 * len(window.bodies) + 50 * count_facets(window, quads)


def slope_error_at(window: Window, quads: int) -> float:
    """The slope error (radians) of the mesh with this number of quads."""
    worst = 0.0
    for body in window.bodies:
        parts = _parts(window, body, None)
        for n in range(len(parts.cells.tilings)):
            judged = parts.tiled(n, quads).judged(window, body)
            worst = max(worst, *(facet_errors(maker.tile, one)[0] for maker, one in judged))
    return worst


def forecast_quads(window: Window, slope_error: float) -> int:
    """Fewest quads per cell side whose slope error does not exceed the given one (radians).

    Raises
    ------
    ValueError
        More than 2048 would be needed.
    """
    if not slope_error > 0.0:
        raise ValueError(f"slope_error = {slope_error}: must be positive (radians)")
    probe = 8
    guess = max(1, ceil(probe * slope_error_at(window, probe) / slope_error))
    while guess <= MOST_QUADS:
        found = slope_error_at(window, guess)
        if found <= slope_error:
            while guess > 1 and slope_error_at(window, guess - 1) <= slope_error:
                guess -= 1
            return guess
        guess = max(guess + 1, ceil(guess * found / slope_error * 0.999))
    raise ValueError(
        f"a slope error of {slope_error:.3g} rad needs more than {MOST_QUADS} quads a cell side "
        f"({guess}); {slope_error_at(window, 64):.3g} rad takes 64"
    )
