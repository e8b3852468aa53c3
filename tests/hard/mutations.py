"""Replace each stable form by its textbook form and see that a named test fails.

    python tests/hard/mutations.py                 run all, print the table, exit 1 if a mutation survives
    python tests/hard/mutations.py NAME ...        only some
    python tests/hard/mutations.py --write         run all and record tests/hard/mutations.md

Every mutation is made in a private copy of the package and its tests, in a new temporary folder; the files
themselves are never touched. Each run compiles kernels into a cache of its own.
"""

from __future__ import annotations

import os
import re
import resource
import shlex
import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
MEMORY = 8 << 30
PAGE = ROOT / "tests" / "hard" / "mutations.md"


@dataclass(frozen=True)
class Mutation:
    """One stable form and the textbook form put in its place."""

    name: str
    file: str
    stable: str
    textbook: str
    tests: str = "tests/hard/test_hard_table.py -k stored_case"


STORED = "tests/hard/test_hard_table.py -k stored_case"
HARD, SURFACE, LAW = (
    "tests/hard/test_hard_kernels.py",
    "tests/optics/test_surface.py",
    "tests/optics/test_law.py",
)
NORMAL, TANGENT, STEP = (f"{SURFACE} -k {word}" for word in ("normal", "nearly_tangent", "small_index_step"))
KERNELS, LATTICE = f"{HARD} -k 'compiled_surfaces or kernel_tells'", "tests/sheet/test_lattice.py"
SHEETS = f"{HARD} -k 'sheet and numpy'"
SHAPE, QUADRIC, MEETING, BICONIC = (
    f"clacad/optics/surface/{n}.py" for n in ("sag_and_normal", "roots", "intersection", "roots")
)
MODEL, IMAGING, EXACT, TURN = (
    f"clacad/optics/law/{n}.py" for n in ("refraction", "imaging", "orientation", "orientation")
)
POLYNOMIAL, TERMS = (f"clacad/optics/surface/{n}.py" for n in ("roots", "sag_and_normal"))
TWIN, PATCHES = "clacad/tracing/compiled/even_polynomial.py", "clacad/solid/lens_faces.py"
EVEN = "tests/optics/test_even_polynomial.py"
SEARCH = "clacad/optimising/face_search.py"
AIM, FIT = "clacad/optimising/aim.py", "clacad/optics/fit.py"
ASKED, TRAPS = "tests/optimising/test_what_is_asked.py", "tests/optimising/test_optimise.py"
SCALAR, LAUNCH, TRACE = (
    "clacad/tracing/compiled/face.py",
    "clacad/tracing/reference/launch.py",
    "clacad/optics/sequence.py",
)

PLACES, LIKE, OWN, MIRROR = (
    "clacad/sheet/cell_places.py",
    "clacad/sheet/like_cell.py",
    "clacad/tracing/compiled/array_cells.py",
    "clacad/effects/engine/nonsequential.py",
)
AIMED, MADE = "clacad/prescription/aimed_cells.py", "tests/prescription/test_aimed_cells.py"
MESH, TRIANGLES = "clacad/tracing/facets/own_sheet.py", "tests/tracing/test_own_mesh.py"
FACETS, LOOKED_UP = "clacad/tracing/facets/compiled_tiles.py", f"{TRIANGLES} -k 'looked_up and aimed-facet'"
DIFFERING = "tests/hard/test_hard_differing.py"
FAR_OUT, ROWS = (
    f"{DIFFERING} -m '' -k '({chosen}) and numpy'" for chosen in ("2e4 and 8000", "kappa or curl")
)
OWN_ETA, SIZES = "tests/sheet/test_cells_of_own_eta.py", "clacad/prescription/cells.py"
SHARP = "tests/sheet/test_sharp_pairs.py"
FIGURES = f"{DIFFERING} -m '' -k 'numpy and eta'"
ALIKE, ITS_KERNEL = (
    f"{DIFFERING} -k 'like_one or wide_as or farthest'",
    f"{DIFFERING} -m '' -k 'numba and (kappa or curl or hexagonal or .9975)'",
)

JOINTS, BOUND = f"{DIFFERING} -k 'numpy and (joints or film) and not 10'", "tests/mesh/test_plates_mesh.py"
FIXTURES, SCENES = "tests/exporting/test_fixtures_of_plates.py", "tests/rendering/test_pov_plates.py -m ''"
FIXED = f"{FIXTURES} -k stop"
WHITE = "tests/light/test_white_light.py"

MUTATIONS = [
    # -- non-uniform sheets
    Mutation("places: centres rounded", PLACES, "two_product(2.0 * i - (n1 - 1), 0.5 * lattice.pitch[0])", "pair((2.0 * i - (n1 - 1)) * (0.5 * lattice.pitch[0]))", FAR_OUT),
    Mutation("places: gradient transposed", PLACES, "[xx * x + xy * y, yx * x + yy * y]", "[xx * x + yx * y, xy * x + yy * y]", ROWS),
    Mutation("places: the table forgotten", PLACES, "return change if self.table is None else", "return change if True else", ROWS),
    Mutation("places: rows of hexagons as of squares", PLACES, "return index[..., 0] + index[..., 1] // 2 if lattice.hexagonal else index[..., 0]\n", "return index[..., 0]\n", ROWS),
    Mutation("places: the lattice's pitch for every array", PLACES, "pitch=base.pitch if self.pitch is None else self.pitch,", "pitch=base.pitch,", ROWS),
    Mutation("places: farthest lenses in one direction", PLACES, "(2.0 * np.pi / DIRECTIONS)", "0.0", ALIKE),
    Mutation("places: the first cell of each row alone", PLACES, "cells[[0, *(last[:-1] + 1), *last]]", "cells[[0, *(last[:-1] + 1)]]", ALIKE),
    Mutation("like a cell: the law of the middle", LIKE, "law=window.law_at(index)", "law=window.law", ALIKE),
    Mutation("like a cell: thin lens 2 where the middle has it", LIKE, "+= apart - np.asarray(pair.shift)", "+= 0.0 * apart", ALIKE),
    Mutation("like a cell: thin lens 2 not moved in its cell", LIKE, "+= [float(v) for v in lenses[1].apex]", "+= 0.0 * apart[0]", ALIKE),
    Mutation("like a cell: cells 2 of thin lenses in the middle's place", LIKE, "offset=(x, y, z), shift=xy(apart))", "offset=(x, y, z))", ALIKE),
    Mutation("like a cell: lenses where the middle has them", LIKE, "back=window.in_cell(body.back, index)", "back=replace(body.back, change=None)", ALIKE),
    Mutation("like a cell: partners in the middle's place", LIKE, "xy(window.centres(k, index) - first)", "window.shifts[k]", ALIKE),
    Mutation("like a cell: never wider", LIKE, "max(scales) if widest", "1.0 if widest", ALIKE),
    Mutation("like a cell: always wider", LIKE, "if widest else 1.0", "if True else 1.0", ALIKE),
    Mutation("like a cell: one direction", "clacad/sheet/representative_cells.py", "(2.0 * np.pi / SIDES)", "0.0", ALIKE),
    Mutation("kernel: gradient transposed", OWN, "return xx * x + xy * y, yx * x + yy * y", "return xx * x + yx * y, xy * x + yy * y", ITS_KERNEL),
    Mutation("kernel: rows of hexagons as of squares", OWN, "int(i) + int(j) // 2 if", "int(i) if", ITS_KERNEL),
    Mutation("kernel: the table forgotten", OWN, "if which >= 0:\n        _add_tabled", "if which > 99:\n        _add_tabled", ITS_KERNEL),
    Mutation("kernel: hexagons' centres by columns of squares", OWN, "return (i - grid.across) + grid.skew * j, j", "return i - grid.across, j", ITS_KERNEL),
    Mutation("kernel: another pitch as if it were the same", OWN, "two_sum(one.pitch, -two.pitch)", "(0.0, 0.0)", ITS_KERNEL),
    Mutation("kernel: cells of lens 1 in every array", OWN, "cell[i] += a", "cell[i] += 0.0 * a", ITS_KERNEL),
    Mutation("sizes: a lens seen from a larger one", PLACES, "vx + (x - vx) / self.size", "vx + (x - vx) * self.size", OWN_ETA),
    Mutation("sizes: heights of the face's one lens", PLACES, "(z - self.vertex[2]) * self.size", "(z - self.vertex[2])", OWN_ETA),
    Mutation("sizes: rays start as the sheet has them", "clacad/tracing/reference/face.py", "start / places.size[:, None]", "start", FIGURES),
    Mutation("sizes: rays end where the face's one lens has them", "clacad/tracing/reference/face.py", "distance * places.size\n", "distance\n", FIGURES),
    Mutation("sizes: thin lenses of one focal length", "clacad/tracing/reference/thin.py", "p / size, q / size_y", "p, q", OWN_ETA),
    Mutation("sizes: lens 2 as large as lens 1", SIZES, "first * (etas / eta)", "first", OWN_ETA),
    Mutation("sizes: thick lenses as thin ones", SIZES, "thick_lenses(design)\n", "False\n", OWN_ETA),
    Mutation("sizes: a thickness for the law's lens alone", "clacad/prescription/cell_heights.py", "for one in _bodies_that_differ(window, body):\n        spare", "for one in [body]:\n        spare", f"{OWN_ETA} -k least_radius"),
    Mutation("sizes: given lenses by those of thin ones", SIZES, "base = _thick_pair(recipe, ratios_of(window.law)[axis])", "base = _thick_pair(recipe, 2 * ratios_of(window.law)[axis])", OWN_ETA),
    Mutation("sharp: thin lenses by principal planes", "clacad/prescription/sharp_pairs.py", 'and design.pair.confocal == "exact"', "and True", f"{SHARP} -k thin_recipe"),
    Mutation("sharp: lenses around a field lens as without one", "clacad/prescription/sharp_pairs.py", "lensed = design.pair.focus, bool(design.pair.field_lens)", "lensed = design.pair.focus, False", f"{SHARP} -k every_pair_with_a_field_lens"),
    Mutation("sharp: lens 2 behind a field lens where the afocal one lies", "clacad/prescription/sharp_pairs.py", "(offset - cell) * np.divide(focal, afocal)", "(offset - cell)", f"{SHARP} -k every_pair_with_a_field_lens"),
    Mutation("sizes: field lenses of all cells at one height", PLACES, "rise = rise + tabled(self.lift, lattice, index, 0.0)", "pass", f"{OWN_ETA} -k field_lens_of_each_cell"),
    Mutation("sizes: plates behind thin lenses of one separation", SIZES, "over = (separation - (1.0 - 1.0 / index) * first) / (1.0 / index - every)", "over = separation / (1.0 - every)", f"{OWN_ETA} -k field_lens_of_each_cell"),
    Mutation("sizes: lens 2 moves with its cell as in the law's", SIZES, "_pulled(targets, targets.sizes.field.pull, field, lens_turn, ways)", "0.0 * table", f"{OWN_ETA} -k chief_rays_of_steered"),
    Mutation("sizes: shares of light by the law's field lens", "clacad/sheet/vignetting.py", "arrivals(cells, slopes, apart, index)", "arrivals(cells, slopes, apart)", f"{OWN_ETA} -k field_lenses_keep"),
    Mutation("sizes: plates of neighbours that touch", SIZES, "if apart > room:", "if apart > 2.0 * room:", f"{OWN_ETA} -k would_touch"),
    Mutation("sharp: the best radii for parallel light", "clacad/prescription/best_recipe.py", "RequestedLaw.of(window).expected(lit)", "window.law.refract(lit.rays.direction)", f"{SHARP} -k best"),
    Mutation("sharp: tilted pairs of one size", "clacad/prescription/sharp_pairs.py", "apart = np.asarray(centres @ window.law.rotation[:2, 2])", "apart = np.zeros(len(centres))", f"{SHARP} -k lens_equation"),
    Mutation("sharp: cells 2 of tilted pairs where uniform ones lie", SIZES, "table = table - kept * _followed(placed.placements[1], placed, targets.cells)", "table = table + 0.0 * kept", f"{SHARP} -k own_distance"),
    Mutation("sharp: the image of tilted lenses along the normal", "clacad/verification/light/special_checks.py", "(x / z, y / z, along) if along == -inf else (x * along, y * along, z * along)", "(0.0, 0.0, along)", f"{SHARP} -k upright"),
    Mutation("sharp: steered cells where unsteered ones lie", "clacad/prescription/sharp_pairs.py", "CellPlacement(window.placements[1].shift, pitch, turn)", "CellPlacement((0.0, 0.0), pitch, turn)", f"{SHARP} -k steered"),
    Mutation("leaning: lens 2 over the law's axis", SIZES, "lean += frames @ (place @ turn) - place", "pass", f"{OWN_ETA} -k leans_by_its_own"),
    Mutation("leaning: field faces across the law's axis", SIZES, "share * (new - old) + height * tilt", "share * (new - old)", f"{OWN_ETA} -k leans_by_its_own"),
    Mutation("leaning: plane faces without astigmatism", "clacad/prescription/bodies.py", "(level**2 / air**3 - 1.0 / air)", "(0.0 * air)", f"{OWN_ETA} -k least_power"),
    Mutation("two eta: arrays spread as for one", SIZES, "own.pull[0], xy(over[0]", "0.0, xy(over[0]", f"{OWN_ETA} -k grow_over"),
    Mutation("sizes: neighbours in one direction", SIZES, "lattice.steps[: len(lattice.steps) // 2]", "lattice.steps[:0]", OWN_ETA),
    Mutation("sizes: the law of the sheet in every cell", "clacad/sheet/cell_places.py", "index), d, own, self", "index), d, None, self", OWN_ETA),
    Mutation("sizes: one light for every cell", "clacad/prescription/cells.py", "np.minimum(1.0, 1.0 / np.abs(ratio).max(axis=1))", "np.ones(len(ratio))", f"{OWN_ETA} -k mean_of_the_light"),
    Mutation("vertex: given up where the first step is too long", "clacad/prescription/traced_vertices.py",
             "step = np.where(beyond, np.copysign(allowed[:, None], step) - move, step)", "step = np.where(beyond, np.nan, step)", f"{DIFFERING} -k bracket"),
    # -- joints and plates
    Mutation("joint: air in it", "clacad/sheet/face_order.py", "inside[number] if body.joined else 1.0]", "1.0]", JOINTS),
    Mutation("joint: heights of the body before", "clacad/tracing/reference/surfaces.py", "replace(beam, z=beam.z - (body.level - layout.bodies[b - 1].level))", "beam", JOINTS),
    Mutation("kernel: heights of the body before a joint", "clacad/tracing/compiled/straight_path.py", "oz -= body[slot.LEVEL] - bodies[b - 1, slot.LEVEL]", "oz -= 0.0 if body[slot.JOINED] != 0.0 else body[slot.LEVEL] - bodies[b - 1, slot.LEVEL]", f"{DIFFERING} -m '' -k 'numba and joints and aimed'"),
    Mutation("joint: the body behind it on the other side", "clacad/sheet/window.py", "surface=other_side(self.surface)", "surface=self.surface", f"{BOUND} -k volume_of_its_listed_faces"),
    Mutation("joint: a face of one body only", "clacad/sheet/face_order.py", "if side or not body.joined", "if True", "tests/prescription/test_face_list.py -k nearly_equal_media"),
    Mutation("baffle: channels of the first array in every gap", "clacad/exporting/fixtures/baffle.py", "body.arrays[-1 if side > 0 else 0]", "body.arrays[0]", FIXED),
    Mutation("baffle: sheared from the far face of a plate", "clacad/exporting/fixtures/baffle.py", "(body.back if side > 0 else body.front).vertex[2]", "(body.front if side > 0 else body.back).vertex[2]", FIXED),
    Mutation("pins: the first gap in every gap", "clacad/exporting/fixtures/frame.py", "zip(pins.heights[3:-1:2], pins.heights[4::2], strict=True)", "[(z1, z2)] * (len(pins.heights) // 2 - 2)", f"{FIXTURES} -k sleeve"),
    Mutation("names: media that are exchanged", "clacad/judging/mesh_wholeness.py", "index[said] != index[body]", "index[said] < 0.0", f"{BOUND} -k exchange"),
    Mutation("names: heights of objects as stored", "clacad/judging/mesh_wholeness.py", "z = points @ place[:3] + place[3]", "z = points[..., 2]", f"{BOUND} -k exchange"),
    Mutation("POV: the other sheet of a concave face", "clacad/exporting/pov/pov_solids.py", "if not other or (s.kappa > 0.0 and not concave):", "if True:", SCENES),
    # -- what aimed sheets are made of, and their triangles
    Mutation("aimed: scaled the other way", AIMED, "scale = 1.0 - k / z", "scale = 1.0 + k / z", f"{MADE} -k vertices_and_shares"),
    Mutation("aimed: scaled for light near the axis", AIMED, "k = float((np.array(landing((float(a[0]), float(a[1])))) - still) @ a / (a @ a))",
             "k = float(np.array(landing((1e-3, 0.0)))[0] * 1e3)", f"{MADE} -k outermost"),
    Mutation("aimed: a point beside the axis forgotten", AIMED, "shift = still + k * np.array([x, y]) / z", "shift = still", f"{MADE} -k vertices_and_shares"),
    Mutation("aimed: lenses stay in the middle of their cells", AIMED, "((kept * (1.0 - gx), 0.0), (0.0, kept * (1.0 - gy)))", "((0.0, 0.0), (0.0, 0.0))",
             f"{MADE} -k vertices_and_shares"),
    Mutation("mesh: what passes array 2 beside it is land", MESH, "missed[rows[~over]] = True", "missed[rows[~over]] = False", f"{TRIANGLES} -k has_missed"),
    Mutation("mesh: cells of array 1 in every array", MESH, "_cells(window, face.array, at", "_cells(window, 0, at", f"{TRIANGLES} -k scaled_array"),
    Mutation("mesh: places less their array's rounded", MESH, "two_sum(at[:, 0], -dx), two_sum(at[:, 1], -dy)", "(at[:, 0] - dx, 0.0), (at[:, 1] - dy, 0.0)",
             f"{TRIANGLES} -k scaled_array"),
    Mutation("mesh: the end at a wall is a face met", MESH, "(hits[f] != end).any(axis=1)", "True", f"{TRIANGLES} -m '' -k 'kernels_count'"),
    Mutation("mesh: a body is risen past at its foot", MESH, "body.level + body.high", "body.level + body.low", f"{TRIANGLES} -m '' -k 'kernels_count'"),
    Mutation("mesh: heights of the first point at every corner", FACETS, "own.height[first + own.corner[facet, 1]]", "own.height[first]", LOOKED_UP),
    Mutation("mesh: the level forgotten", FACETS, "level = z - sheet.bodies", "level = z - 0.0 * sheet.bodies", LOOKED_UP),
    Mutation("mesh: single cells as the regular one", MESH, "self.rare.append(self._single(batch, n))", "self.rare.append(self.tile)", f"{TRIANGLES} -m '' -k 'looked_up and (rims or figures)'"),
    Mutation("mesh: a ghost within array 1 forgotten", MESH, "order_of(walkers)", "walkers.last - walkers.first", f"{TRIANGLES} -m '' -k 'kernels_count'"),
    # -- colour
    Mutation("index: extrapolated beyond its range", "clacad/optics/material/material.py", "    if outside.any():\n", "    if False:\n", "tests/optics/test_material.py"),
    Mutation("layers: V of the lenses' material forgotten", "clacad/prescription/face_list.py", "return dn / (n * (n - 1.0)) / gain", "return (dm / (m - 1.0) - dn / n) / gain", STORED),
    Mutation("layers: changes of the index, not over n", "clacad/prescription/face_list.py", "gain = dm / m - dn / n", "gain = dm - dn", STORED),
    Mutation("colour: powers of the design's line", "clacad/light/compare.py", "part = 1.0 - face.index_before / face.index_after", "part = 1.0 - round(face.index_before, 2) / round(face.index_after, 2)", WHITE),
    Mutation("floor: right in the first line", "clacad/light/compare.py", "middle = order[int(np.searchsorted(np.cumsum(weight[order]), 0.5 * weight.sum()))]", "middle = order[0]", f"{WHITE} -k window_of_100_mm"),
    # -- sag and normal
    Mutation("sag: R - sqrt(R² - r²)", SHAPE, "surface.side * lateral_square(surface, x, y) / (1.0 + slope_root(surface, x, y))",
             "surface.side * (1.0 - slope_root(surface, x, y)) * lateral_square(surface, x, y) / (1.0 - slope_root(surface, x, y) ** 2)"),
    Mutation("sag: radicand not in pairs near the equator", SHAPE, "equator = np.abs(radicand) < 0.5", "equator = np.abs(radicand) < -1.0"),
    Mutation("sag: saddle's square not in pairs", SHAPE, "if np.any(cx * cy < 0):\n        in_x", "if False:\n        in_x"),
    Mutation("sag: 1 + K rounded", SHAPE, "in_x = pair_product(two_sum(1.0, surface.conic_x), two_product(cx, cx))",
             "in_x = pair((1.0 + surface.conic_x) * cx * cx)"),
    Mutation("normal: length by squares", SHAPE, "np.hypot(np.hypot(g[..., 0], g[..., 1]), g[..., 2])", "np.sqrt(g[..., 0] ** 2 + g[..., 1] ** 2 + (1.0 - np.sqrt(1.0 - g[..., 2] ** 2)) ** 2)", NORMAL),
    # -- intersection
    Mutation("root: (-b ± sqrt(b² - ac))/a", QUADRIC, "adds = sign_root * b <= 0", "adds = (a == 0) & (b <= np.inf)"),
    Mutation("root: never the other form", QUADRIC, "adds = sign_root * b <= 0", "adds = b <= np.inf"),
    Mutation("root: discriminant never in pairs", QUADRIC, "CANCELS = 1e3", "CANCELS = np.inf", TANGENT),
    Mutation("root: discriminant from the carried point", QUADRIC, "pick(start, rows), pick(ray, rows))\n    root", "pick(base, rows), pick(ray, rows))\n    root", TANGENT),
    Mutation("root: not carried to the vertex plane", QUADRIC, "t = np.where(flat, -z / N, -(x * L + y * M + z * N) / square)", "t = np.zeros_like(x)\n    flat = np.zeros(x.shape, dtype=bool)"),
    Mutation("root: always carried to the vertex plane", QUADRIC, "STEEPEST = 0.25", "STEEPEST = 0.0"),
    Mutation("root: sign of N forgotten", QUADRIC, "sign_root = np.where(N < 0, -side, side) * root", "sign_root = side * root"),
    Mutation("hit: far half counts", MEETING, "misses = ~((gz > 0) & np.isfinite(distance) & np.isfinite(root))", "misses = ~(np.isfinite(distance) & np.isfinite(root))"),
    Mutation("hit: negative distance counts", TRACE, "behind = distance < -BEHIND * extent", "behind = distance < -np.inf * extent"),
    Mutation("biconic: far sheet told by height alone", BICONIC, "return np.asarray((height >= -rounding) & (height <= np.abs(q) + rounding))", "return np.asarray(np.abs(height) <= np.abs(q) + rounding)"),
    Mutation("biconic: no quartic", BICONIC, "if rows.size:", "if rows.size < 0:"),
    Mutation("biconic: Newton stops at 1e-3", BICONIC, "SETTLED = 2.0**-34", "SETTLED = 1e-3"),
    # -- refraction
    Mutation("Snell: q - µ r", MEETING, "g = np.where((w == 0) & (total == 0), 0.0, w / total)", "g = (q - incident) / (gx * gx + gy * gy + gz * gz)", STEP),
    Mutation("Snell: 1 - µ²", MEETING, "w = (n2 - n1) / n2 * ((n2 + n1) / n2)", "w = 1.0 - mu * mu", STEP),
    Mutation("Snell: cosine by Pythagoras", MEETING, "q = np.sqrt((gx * gx + gy * gy + gz * gz) * w + incident * incident)",
             "size2 = gx * gx + gy * gy + gz * gz\n        q = np.sqrt(size2) * np.sqrt(1.0 - mu * mu * (1.0 - root * root / size2))"),
    # -- sequences and launch
    Mutation("sequence: vertex added, then the next one taken off", TRACE, "return np.asarray((offset + low) + high)", "return np.asarray((offset + np.asarray(left)) - np.asarray(entered))"),
    Mutation("sequence: start minus vertex rounded", TRACE, "offset[:, i] = pair_sum((high[far, i], low[far, i]), moved)[0]", "offset[:, i] = high[far, i] + t * d[:, i]"),
    Mutation("sequence: the far start is not carried", TRACE, "FAR = 1024.0", "FAR = np.inf"),
    Mutation("sequence: direction scaled by its length squared", TRACE, "_, exponent = np.frexp(largest(direction))", "exponent = np.zeros(len(direction), dtype=int)"),
    Mutation("launch: plane step in double", LAUNCH, "return quotient, rest[0] / scaled[:, 2]", "return quotient, 0.0 * rest[0]", f"{HARD} -k distance_of_the_source"),
    Mutation("launch: lateral step in double", LAUNCH, "return pair_sum(pair_product((high, low), pair(along)), pair(x))", "return x + high * along, 0.0 * x", SHEETS),
    # -- cells
    Mutation("cell: rounded product", "clacad/sheet/lattice.py", "high, low = two_product(k, step)\n    a, lost_a", "high, low = k * step, 0.0\n    a, lost_a"),
    Mutation("cell: floor alone", "clacad/sheet/lattice.py", "guess = guess + (local >= half) - (local < -half)", "guess = guess + 0.0 * half"),
    Mutation("cell: hexagons by rounding alone", "clacad/sheet/pattern.py", "for _ in range(4):  # a nearest-row", "for _ in range(0):  # a nearest-row", LATTICE),
    Mutation("cell: relative to the sheet's centre", "clacad/sheet/pattern.py", "high, low = two_product(k, step)\n    return np.asarray((x - high) - low)", "return np.asarray(((x + 1024.0) - k * step) - 1024.0)", SHEETS),
    # -- law
    Mutation("law: t - δ rounded", MODEL, "m = total + (total_error - product_error)", "m = total"),
    Mutation("law: slopes without scaling", MODEL, "shift = _HEADROOM - np.frexp(np.where(answered, largest, 1.0))[1]", "shift = 0 * np.frexp(np.where(answered, largest, 1.0))[1]"),
    Mutation("law: no headroom for tiny errors", MODEL, "_HEADROOM = 500", "_HEADROOM = 0"),
    Mutation("law: no common scale", MODEL, "return np.ldexp(x, e_x - top), np.ldexp(y, e_y - top), np.ldexp(z, -top)", "return np.ldexp(x, e_x), np.ldexp(y, e_y), z"),
    Mutation("law: hemisphere of the lens not asked", MODEL, "x, y, z = _times(r.swapaxes(0, 1), x, y, z)\n        answered &= z > 0.0", "x, y, z = _times(r.swapaxes(0, 1), x, y, z)"),
    Mutation("law: exit not judged", MODEL, "x, y, z = _times(r, x, y, z)\n    answered &= z > 0.0", "x, y, z = _times(r, x, y, z)"),
    Mutation("rotation: cos 90° = 6e-17", TURN, "if angle in (turns * (pi / 2), radians(90.0 * turns)):", "if angle == 0.0:", LAW),
    Mutation("rotation: φ and ψ turned one by one at θ = 0", TURN, "if st == 0.0:", "if False:", "tests/hard/test_hard.py -k turns_that_cancel"),
    Mutation("angle: acos of the scalar product", EXACT, "angle = np.arctan2(sine, np.sum(p * q, axis=1))",
             "angle = np.arccos(np.clip(np.sum(p * q, axis=1) / np.sqrt(np.sum(p * p, axis=1) * np.sum(q * q, axis=1)), -1.0, 1.0))"),
    Mutation("angle: cross product rounded", EXACT, "difference_of_products(p[:, i], q[:, j], p[:, j], q[:, i])", "p[:, i] * q[:, j] - p[:, j] * q[:, i]"),
    Mutation("stretch: D + z/η", IMAGING, "numerator * eta / (total + (rest + low))", "numerator / (camera_distance + z / eta)"),
    Mutation("stretch: Dη + z rounded twice", IMAGING, "numerator * eta / (total + (rest + low))", "numerator * eta / total"),
    # -- exact products
    Mutation("two_product: no error term", "clacad/base/pairs.py", "return product, np.asarray(low)", "return product, np.zeros_like(low)"),
    Mutation("two_sum: no error term", "clacad/base/pairs.py", "return total, np.asarray((a - (total - part_b)) + (b - part_b))", "return total, np.zeros_like(total)"),
    # -- compiled kernels
    Mutation("kernel: root by the textbook", SCALAR, "if signed * b <= 0.0:\n        return c / (signed - b), root", "if a == 0.0:\n        return c / (signed - b), root", KERNELS),
    Mutation("kernel: discriminant never in pairs", SCALAR, "if b * b > CANCELS * abs(disc):", "if b * b < 0.0:", KERNELS),
    Mutation("kernel: not carried", SCALAR, "    if N * N >= STEEPEST * STEEPEST * square:\n        t = -z / N\n        return t, (x + t * L, y + t * M, 0.0)\n    t = -(x * L + y * M + z * N) / square\n",
             "    t = 0.0 * square\n", KERNELS),
    Mutation("kernel: far sheet told by height alone", SCALAR, "if -rounding <= level <= abs(q) + rounding:", "if abs(level) <= abs(q) + rounding:", KERNELS),
    Mutation("kernel: q - µ r", SCALAR, "return weight / (sqrt(square * weight + incident * incident) + incident)", "return (sqrt(square * weight + incident * incident) - incident) / square", KERNELS),
    Mutation("kernel: 1 - µ²", SCALAR, "weight = (n2 - n1) / n2 * ((n2 + n1) / n2)", "weight = 1.0 - mu * mu", KERNELS),
    # -- even polynomials
    Mutation("polynomial: the end of the real base forgotten", POLYNOMIAL, "first, last = _real_stretch(surface, base, up)",
             "first, last = _real_stretch(surface, base, up)\n    first, last = np.full_like(first, -np.inf), np.full_like(last, np.inf)", STORED),
    Mutation("polynomial: Newton unguarded", POLYNOMIAL, "usable = (onward > 0.0) & np.isfinite(step) & (low <= step) & (step <= high)",
             "usable = np.isfinite(step)", EVEN),
    Mutation("polynomial: no halving", POLYNOMIAL, "np.where(bracketed, 0.5 * (low + high), beyond)", "beyond", EVEN),
    Mutation("polynomial: a small step is a root", POLYNOMIAL, " & (np.abs(gap) <= CLOSE * size)", "", STORED),
    Mutation("polynomial: Newton stops at 1e-3", POLYNOMIAL, "SETTLED = 2.0**-34", "SETTLED = 1e-3", STORED),
    Mutation("polynomial: w of a hit from its place", POLYNOMIAL, "UPRIGHT = 0.7", "UPRIGHT = -1.0", STORED),
    Mutation("polynomial: slopes of the terms without w", SHAPE, "gx - surface.side * w * px", "gx - surface.side * px", EVEN),
    Mutation("even terms: powers first", TERMS, "height = xx * (xx * (xx * (a * xx + b * yy)", "height = a * (xx * xx * xx * xx) + xx * (xx * (xx * (b * yy)", STORED),
    Mutation("even terms: slope of y⁶ as of x² y⁴", TERMS, "2.0 * c * yy)\n    py = xx * (2.0 * b * xx + 4.0 * c * yy) + yy * (6.0 * d * yy)", "2.0 * c * yy)\n    py = xx * (2.0 * b * xx + 4.0 * c * yy) + yy * (4.0 * d * yy)", EVEN),
    Mutation("kernel: slopes of the terms without w", TWIN, "side * w * (x * px)", "side * (x * px)", KERNELS),
    Mutation("kernel: the end of the real base forgotten", TWIN, "if not first <= last:\n        return nan", "first, last = -inf, inf", KERNELS),
    Mutation("kernel: order 8 read from order 6", TWIN, "a, b, c, d = faces[row, slot.A80]", "a, b, c, d = faces[row, slot.A60]", KERNELS),
    Mutation("patch: degree 4 whatever the terms", PATCHES, "return (surface.degree if isinstance(surface, EvenPolynomial) else None) or 4", "return 4",
             "tests/solid/test_polynomial_patches.py"),
    # -- the search
    Mutation("search: a ray that is lost costs nothing", FIT, "off[seen.fate != Fate.ALIVE] = LOST", "off[seen.fate != Fate.ALIVE] = 0.0", f"{TRAPS} -k trap_1"),
    Mutation("search: Newton's step without damping", FIT, "np.sqrt(damping) * units", "0.0 * units", f"{TRAPS} -k least_squares"),
    Mutation("search: weights not of squares", AIM, "sqrt(weight / total))", "weight / total)", f"{ASKED} -k shares_of_the_squares"),
    Mutation("search: a tolerance is taken for a standard deviation", AIM, "error.half / of_sigma", "error.half", f"{ASKED} -k drawn_at_random"),
    Mutation("search: a handful of rays is enough", AIM, "FEWEST = 4", "FEWEST = 0", f"{ASKED} -k too_few"),
    Mutation("search: slopes of tolerances from one side", AIM, "0.5 * (ends[0] - ends[1])", "ends[0]", f"{ASKED} -k drawn_at_random"),
    Mutation("search: higher orders stay whatever they give", SEARCH, "self.best.rms > WORTH * before.rms", "self.best.rms > 2.0 * before.rms",
             f"{ASKED} -m '' -k less_than_a_tenth"),
    Mutation("search: seconds in the history", SEARCH, "(self.evaluation, self.rms)", "(int(1e3 * monotonic()), self.rms)", f"{ASKED} -k change_no_byte"),
    Mutation("search: no walls at all", SEARCH, "if slack[tightest] < 0.0:", "if slack[tightest] < -inf:", f"{TRAPS} -k no_room"),
]  # fmt: skip


def copied(target):
    """The package and its tests in a folder of their own."""
    skip = shutil.ignore_patterns("__pycache__", "*.nbi", "*.nbc", ".hypothesis")
    for part in ("clacad", "tests", "designs"):
        shutil.copytree(ROOT / part, target / part, ignore=skip)
    shutil.copy(ROOT / "pyproject.toml", target)


def bounded():
    """A mutation may allocate all the memory there is; it gets eight gigabytes."""
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))


def tested(mutation, workplace):
    """Names of the tests that fail with the mutation in place."""
    cache = workplace / "numba"
    shutil.rmtree(cache, ignore_errors=True)
    environment = os.environ | {
        "PYTHONPATH": str(workplace),
        "NUMBA_CACHE_DIR": str(cache),
        "PYTHONDONTWRITEBYTECODE": "1",
    }
    command = [sys.executable, "-m", "pytest", "-q", "--no-header", "--tb=no", "-rfE", "--maxfail=1", "-p", "no:cacheprovider",
               "-m", "not long",
               *shlex.split(mutation.tests)]  # fmt: skip
    run = subprocess.run(command, cwd=workplace, env=environment, capture_output=True, text=True, timeout=900,
                         preexec_fn=bounded)  # fmt: skip
    return re.findall(r"^(?:FAILED|ERROR) (\S+?::.*?)(?: - .*)?$", run.stdout, re.MULTILINE), run


def main(chosen, write):
    """Run, print, record."""
    mutations = [m for m in MUTATIONS if not chosen or any(word in m.name for word in chosen)]
    with tempfile.TemporaryDirectory(prefix="clacad-mutations-") as folder:
        workplace = Path(folder).resolve()
        assert ROOT not in (workplace, *workplace.parents)
        copied(workplace)
        probe = [sys.executable, "-c", "import clacad; print(clacad.__file__)"]
        used = subprocess.run(probe, cwd=workplace, env=os.environ | {"PYTHONPATH": str(workplace)}, capture_output=True, text=True)  # fmt: skip
        if not Path(used.stdout.strip()).is_relative_to(workplace):
            raise SystemExit(f"the copy is not what Python imports: {used.stdout}{used.stderr}")
        for tests in sorted({m.tests for m in mutations}):
            failed, run = tested(Mutation("none", "", "", "", tests), workplace)
            if failed or run.returncode:
                raise SystemExit(f"without any mutation {tests} fails: {failed}\n{run.stdout[-2000:]}")
        rows, survived = [], []
        for mutation in mutations:
            file = workplace / mutation.file
            text = file.read_text(encoding="utf-8")
            if text.count(mutation.stable) != 1:
                raise SystemExit(
                    f"{mutation.name}: its stable form stands {text.count(mutation.stable)} times in {mutation.file}"
                )
            file.write_text(text.replace(mutation.stable, mutation.textbook), encoding="utf-8")
            failed, run = tested(mutation, workplace)
            file.write_text(text, encoding="utf-8")
            caught = run.returncode != 0
            first = failed[0].split("::", 1)[1] if failed else "not even imported" if caught else "SURVIVED"
            print(f"{mutation.name:60s} {first}", flush=True)
            rows.append(f"| {mutation.name} | `{mutation.file}` | {first} |".replace("||", "\\|\\|"))
            survived += [] if caught else [mutation.name]
    if write:
        head = (
            "# Mutations\n\nEach stable form replaced by its textbook form in a private copy, and the first test that"
            " fails.\nWritten by `python tests/hard/mutations.py --write`.\n\n| mutation | file | first test that fails |\n|---|---|---|\n"
        )
        foot = f"\n{len(rows)} mutations, {len(survived)} survived.\n"
        PAGE.write_text(head + "\n".join(rows) + "\n" + foot, encoding="utf-8")
    print(f"{len(rows)} mutations, {len(survived)} survived: {survived}")
    return int(bool(survived))


if __name__ == "__main__":
    words = [word for word in sys.argv[1:] if not word.startswith("--")]
    raise SystemExit(main(words, "--write" in sys.argv[1:]))
