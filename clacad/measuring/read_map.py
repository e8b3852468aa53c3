"""Height maps of instruments: X3P, SDF, clouds x y z, and NPY, TIFF or PNG with a JSON file next to them.

Every file is untrusted. Libraries read it in a worker process with limits of memory and time; only numbers
come back. All lengths are metres, the origin is the middle of the map.
"""

from __future__ import annotations

import json
import os
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, replace
from importlib.util import find_spec
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from clacad.base.text import printable
from clacad.base.types import Floats
from clacad.base.units import LENGTHS
from clacad.base.untrusted_files import read_regular, require_regular
from clacad.storage.errors import BadRequest, NotPossible, OverBudget, UnreadableFile, WorkerDied

if TYPE_CHECKING:
    from clacad.storage.reading import Spending

BUDGET = "topography"
LIBRARIES = {".x3p": "x3pio", ".sdf": "sdfio"}
"""Ending of a file → library that reads it, of the extra metrology."""

PICTURES = (".npy", ".tif", ".tiff", ".png")
"""Endings of files that need a JSON file with their scales."""

CLOUD = ".xyz"
MESHES = (".stl", ".ply", ".obj")
"""Endings of meshes, read as surfaces: their corners are the points of a map."""

ENDINGS = (*LIBRARIES, *PICTURES, CLOUD, *MESHES)
LONGEST_JSON = 1 << 16
FARTHEST = 1.0
"""Height (metres) from which a number marks a point that was not measured."""

LEAST, MOST = 1e-9, 1e-2
"""Range of the distance of neighbouring points of a map, metres."""

FILLED, GROWN = 0.6, 12
"""Share of squares that scattered points fill, 1 - 1/e of those of mean density; trials of their side."""


@dataclass(frozen=True, eq=False)
class MeasuredMap:
    """Measured points of one side of a part.

    name : File it was read from.
    points : (3, n) metres. x and y from the middle of the map, z out of the material; points not measured are
        left out.
    pixel : (2,) metres. Distance of neighbouring points along x and y.
    shape : (rows, columns) of the grid.
    regular : Whether the points lie on the grid; else they are a cloud, and the grid is one of its density.
    middle : (2,) metres. Place of its middle in the sheet, along the map's x and y; None where it is unknown.
    """

    name: str
    points: Floats
    pixel: tuple[float, float]
    shape: tuple[int, int]
    regular: bool = True
    middle: tuple[float, float] | None = None

    @property
    def missing(self) -> float:
        """Share of the grid without a point."""
        return max(0.0, 1.0 - float(self.points.shape[1]) / (self.shape[0] * self.shape[1]))

    def scaled(self, lateral: float, height: float) -> MeasuredMap:
        """The map in other units, or with its scales taken off: x and y over `lateral`, z over `height`."""
        points = self.points / np.array([[lateral], [lateral], [height]])
        pixel = (self.pixel[0] / lateral, self.pixel[1] / lateral)
        x, y = self.middle or (0.0, 0.0)
        middle = None if self.middle is None else (x / lateral, y / lateral)
        return replace(self, points=points, pixel=pixel, middle=middle)


def is_map(path: Path) -> bool:
    """Whether a file without a manifest is the height map of an instrument, by its ending and neighbours.

    A cloud is one where its first line names a unit: others are points of the design's own frame.
    """
    ending = path.suffix.lower()
    if ending in LIBRARIES or ending == ".npy":
        return True
    if ending == CLOUD:
        return _stated_unit(path) is not None
    return ending in PICTURES and _beside(path) is not None


def read_map(
    path: str | os.PathLike[str],
    unit: str | None = None,
    side: Literal["front", "back"] | None = None,
) -> MeasuredMap:
    """Read a height map.

    unit : Length unit of a cloud that states none.
    side : Side of a closed mesh that is read.
    Raises NotPossible: The library that reads it is not installed.
    Raises UnreadableFile, OverBudget, OSError: As every reader of untrusted files.
    Raises BadRequest: A scale that the file does not hold is not stated.
    """
    from clacad.storage.reading import Spending

    path = Path(path)
    ending = path.suffix.lower()
    if ending not in ENDINGS:
        raise UnreadableFile(f"{path.name}: no height map by its name; {', '.join(ENDINGS)} are read")
    if unit is not None and unit not in LENGTHS:
        raise BadRequest(f"unit {printable(unit)[:40]}: it is one of {', '.join(LENGTHS)}")
    require_regular(path)
    if ending == CLOUD:
        return _cloud(path, unit)
    if ending in MESHES:
        return _mesh(path, unit, side)
    library = LIBRARIES.get(ending)
    if library is not None and find_spec(library) is None:
        raise NotPossible(
            f"{path.name}: {ending[1:].upper()} is read by the package {library}\n  install it with: pip"
            ' install "clacad[metrology]"'
        )
    scales = _scales(path) if ending in PICTURES else {}
    spent = Spending(BUDGET, path)
    z, pixel = _in_worker(path, ending, spent)
    if scales:
        z, pixel = _scaled(path, z, scales)
    return _on_grid(path, z, pixel)


def _in_worker(path: Path, ending: str, spent: Spending) -> tuple[Floats, tuple[float, float]]:
    """Heights (rows, columns) of a file and its pixel, as a worker process reads them."""
    from clacad.storage.atomic import scratch_folder
    from clacad.storage.worker import limited_worker, longest_wait

    with scratch_folder() as folder, limited_worker(spent) as worker:
        target = Path(folder) / "z.npy"
        try:
            pixel = worker.run(
                f"{__name__}:load", str(path), ending, str(target), timeout=longest_wait(spent)
            )
        except WorkerDied as error:
            raise (OverBudget if error.over_budget else UnreadableFile)(f"{path.name}: {error}") from error
        z = np.load(target, allow_pickle=False)
    spent.count(z.size)
    return z, (float(pixel[0]), float(pixel[1]))


def load(path: str, ending: str, target: str) -> tuple[float, float]:
    """Read, in the worker, heights (rows, columns) into the file `target`; their pixel (metres), 0 if
    unknown.

    Raises UnreadableFile.
    """
    readers = {".x3p": _load_x3p, ".sdf": _load_sdf, ".npy": _load_npy}
    try:
        z, pixel = readers.get(ending, _load_picture)(path)
        if z.ndim != 2 or min(z.shape) < 2:
            raise UnreadableFile(f"it holds {' x '.join(map(str, z.shape)) or 'single'} heights: no surface")
        if z.dtype.kind not in "fiu":
            raise UnreadableFile(f"its values are of type {z.dtype}, not numbers")
    except MemoryError:
        raise
    except Exception as error:  # libraries raise what they like on damaged bytes
        words = printable(str(error).partition("\n")[0])[:200]
        raise UnreadableFile(f"{os.path.basename(path)}: {words}") from None
    np.save(target, np.ascontiguousarray(z), allow_pickle=False)
    return pixel


Loaded = tuple[Any, tuple[float, float]]


def _load_x3p(path: str) -> Loaded:
    import x3pio

    found = x3pio.read(path)
    if type(found).__name__ != "Surface" or len(found.layers) != 1 or not found.is_regular_grid:
        raise UnreadableFile("one layer on a regular grid is read; this X3P file holds something else")
    layer = found.layers[0]
    if np.abs(np.asarray(layer.placement.rotation) - np.eye(3)).max() > 1e-12:
        raise UnreadableFile(
            "its record of axes states a rotation, which is not applied: store the map without it"
        )
    return np.asarray(layer.z), (float(found.header.x.increment), float(found.header.y.increment))


def _load_sdf(path: str) -> Loaded:
    import sdfio

    found = sdfio.read(path)
    return np.asarray(found.data), (float(found.header.x_scale), float(found.header.y_scale))


def _load_npy(path: str) -> Loaded:
    return np.load(path, allow_pickle=False), (0.0, 0.0)


def _load_picture(path: str) -> Loaded:
    from PIL import Image

    Image.MAX_IMAGE_PIXELS = None  # the worker's memory is the limit
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # damaged tags that nobody needs
        with Image.open(path, formats=("TIFF", "PNG")) as picture:
            if picture.mode not in ("I;16", "I;16B", "I;16L", "F", "I"):
                raise UnreadableFile(f"pixels of kind {picture.mode}; 16-bit or float heights are read")
            return np.array(picture), (0.0, 0.0)


def _on_grid(path: Path, z: Floats, pixel: tuple[float, float]) -> MeasuredMap:
    """The map of heights (rows, columns) in metres, NaN where not measured, row 0 at the least y."""
    for step in pixel:
        if not LEAST <= step <= MOST:
            raise UnreadableFile(f"{path.name}: points {step:g} m apart; 1 nm to 10 mm are believed")
    known = np.abs(z) < FARTHEST
    if not known.any():
        raise UnreadableFile(f"{path.name}: no point of it was measured")
    row, column = np.nonzero(known)
    middle = 0.5 * np.array(z.shape)
    points = np.empty((3, len(row)))
    points[0], points[1] = (column - middle[1]) * pixel[0], (row - middle[0]) * pixel[1]
    points[2] = z[known]
    return MeasuredMap(path.name, points, pixel, (z.shape[0], z.shape[1]))


# -- scales next to a picture

LARGEST = 1e300
"""Number of a JSON file above which it is no scale."""

KEYS = ("pixel_U", "z_step_U", "z_at_0_U", "z_at_1_U", "invalid", "row_0")
"""Keys of the JSON file; U is a length unit."""


def _beside(path: Path) -> Path | None:
    """The JSON file with the scales of a picture, or None."""
    both = (path.with_name(path.name + ".json"), path.with_suffix(".json"))
    return next((one for one in both if one.is_file()), None)


def _scales(path: Path) -> dict[str, Any]:
    """Checked content of the JSON file next to a picture, lengths in metres."""
    beside = _beside(path)
    if beside is None:
        raise BadRequest(
            f"{path.name} holds no scales: {path.name}.json must state them, such as"
            ' {"pixel_um": 4, "z_step_nm": 0.4, "z_at_1_um": 0, "invalid": 0, "row_0": "top"}'
        )
    try:
        told = json.loads(read_regular(beside, LONGEST_JSON))
    except (ValueError, RecursionError) as error:
        raise UnreadableFile(f"{beside.name}: not JSON ({printable(str(error))[:80]})") from None
    if not isinstance(told, dict):
        raise UnreadableFile(f"{beside.name}: not a JSON object of scales")
    found: dict[str, Any] = {"invalid": None, "row_0": "bottom"}
    for name, value in told.items():
        key, number = _scale(beside, str(name), value)
        found[key] = number
    for key in ("pixel", "z_step"):
        if key not in found:
            raise UnreadableFile(f"{beside.name}: {key}_um is not stated; its keys are {', '.join(KEYS)}")
    return found


def _scale(beside: Path, name: str, value: Any) -> tuple[str, Any]:
    """Key and value of one entry, lengths in metres."""
    key, _, unit = name.rpartition("_")
    if name == "row_0" and value in ("top", "bottom"):
        return name, value
    if name == "invalid" and (value is None or _is_number(value)):
        return name, value
    if key in ("pixel", "z_step", "z_at_0", "z_at_1") and unit in LENGTHS:
        numbers = value if isinstance(value, list) and key == "pixel" else [value]
        if len(numbers) in (1, 2) and all(map(_is_number, numbers)):
            metres = [float(one) * float(LENGTHS[unit]) for one in numbers]
            return key, (metres[0], metres[-1]) if key == "pixel" else metres[0]
    raise UnreadableFile(
        f"{beside.name}: {printable(name)[:40]} = {printable(str(value))[:40]} is not read; its keys are"
        f" {', '.join(KEYS)}"
    )


def _is_number(value: Any) -> bool:
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return False
    return abs(value) < LARGEST and isfinite(value)


def _scaled(path: Path, values: Floats, told: Mapping[str, Any]) -> tuple[Floats, tuple[float, float]]:
    """Heights in metres of the values of a picture, row 0 at the least y."""
    if "z_at_0" in told and "z_at_1" in told:
        raise UnreadableFile(f"{path.name}: z_at_0 and z_at_1 are both stated")
    z = values.astype(np.float64)
    if told["invalid"] is not None:
        z[values == told["invalid"]] = np.nan
    first = 1.0 if "z_at_1" in told else 0.0
    with np.errstate(invalid="ignore", over="ignore"):  # what is not finite was not measured
        z = told.get("z_at_1", told.get("z_at_0", 0.0)) + (z - first) * told["z_step"]
    return (z[::-1] if told["row_0"] == "top" else z), told["pixel"]


# -- clouds --------------------------------------------------------------------------------------------------


def _stated_unit(path: Path) -> str | None:
    """Length unit that the first line of a cloud names: "# unit um"."""
    try:
        require_regular(path)
        with path.open("rb") as stream:
            words = stream.readline(200).decode("utf-8", "replace").split()
    except OSError:
        return None
    named = words[:1] == ["#"] and [word.strip("=:") for word in words[1:]]
    if not named or named[0] != "unit":
        return None
    return next((word for word in named[1:] if word in LENGTHS), None)


def _cloud(path: Path, unit: str | None) -> MeasuredMap:
    """Read points x y z; on a grid where all of them lie on one."""
    from clacad.formats.maps.sag import read_points

    word = _stated_unit(path) or unit
    if word is None:
        raise BadRequest(
            f"{path.name}: its unit is not known; state it, such as --unit um, or as a first line '# unit um'"
        )
    tables = [table[:, :3] for table in read_points(path)]
    if not tables:
        raise UnreadableFile(f"{path.name}: no points")
    points = np.concatenate(tables).T * float(LENGTHS[word])
    points = points[:, (np.abs(points) < [[np.inf], [np.inf], [FARTHEST]]).all(axis=0)]
    low, high = points[:2].min(axis=1, initial=np.inf), points[:2].max(axis=1, initial=-np.inf)
    if points.shape[1] < 16 or not (high > low).all():
        raise UnreadableFile(f"{path.name}: {points.shape[1]} points that span no area")
    return cloud_map(path.name, points)


def _mesh(path: Path, unit: str | None, side: Literal["front", "back"] | None) -> MeasuredMap:
    """Read the corners of a mesh: of a surface seen from outside, or of one side of a closed part."""
    from clacad.formats.mesh.readers import read_mesh

    mesh = read_mesh(path)
    metres = mesh.unit if unit is None else float(LENGTHS[unit])
    if metres is None:
        raise BadRequest(f"{path.name}: its unit is not known; state it, such as --unit mm")
    return surface_map(path.name, np.concatenate(list(mesh.chunks())) * metres, side)


def surface_map(name: str, corners: Floats, side: Literal["front", "back"] | None) -> MeasuredMap:
    """Map of the corners of facets (k, 3, 3), metres, that face one way; else of those on one side of a part.

    A front is seen from outside turned about x from how it lies in the sheet.
    """
    corners = corners.astype(np.float64)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = normal[:, 2]
    up = float(area[area > 0.0].sum()) / max(float(np.abs(area).sum()), 1e-300)
    down = up < 0.5
    if ONE_WAY < up < 1.0 - ONE_WAY:
        if side is None:
            raise UnreadableFile(
                f"{name}: {up:.0%} of it faces up: it is no surface of one side; state its side:"
                f" --side {name}=front, or leave out scales, to judge it as a whole part"
            )
        down = side == "front"
        outward = np.where(down, -area, area) > STEEP * np.linalg.norm(normal, axis=1)
        corners = _outermost(corners[outward], -1.0 if down else 1.0)
    points = np.unique(corners.reshape(-1, 3), axis=0).T
    if down:
        points = points * np.array([[1.0], [-1.0], [-1.0]])
    if points.shape[1] < 16 or not np.isfinite(points).all():
        raise UnreadableFile(f"{name}: {points.shape[1]} points that span no area")
    return cloud_map(name, points)


STEEP = 0.3
"""Least cosine of the slope of a facet that is part of a side, not of a wall."""


def _outermost(corners: Floats, sign: float) -> Floats:
    """Facets (k, 3, 3) that no other lies above (`sign` 1) or below, in squares of a few facets."""
    if not len(corners):
        return corners
    middle = corners.mean(axis=1)
    size = 3.0 * float(np.sqrt(np.prod(np.ptp(corners[..., :2], axis=(0, 1))) / len(corners)))
    square = np.floor((middle[:, :2] - middle[:, :2].min(axis=0)) / max(size, 1e-300)).astype(np.int64)
    _, which = np.unique(square[:, 0] * (square[:, 1].max() + 1) + square[:, 1], return_inverse=True)
    top = np.full(which.max() + 1, -np.inf)
    np.maximum.at(top, which, sign * middle[:, 2])
    return np.asarray(corners[sign * middle[:, 2] >= top[which] - 2.0 * size])


ONE_WAY = 0.01
"""Part of the area of a surface that may face the other way: noise on steep places."""


def cloud_map(name: str, points: Floats, placed: bool = False) -> MeasuredMap:
    """Map of points (3, n), metres: on their grid where they have one, else of their mean density.

    placed : Whether their x and y are those of the sheet.
    """
    low, high = points[:2].min(axis=1), points[:2].max(axis=1)
    steps = [_step(points[k]) for k in (0, 1)]
    regular = all(step > 0.0 for step in steps)
    if not regular:
        steps = [_spread(points[:2], low, high)] * 2
    cells = (high - low) / np.clip(steps, LEAST, MOST)
    if not all(LEAST <= step <= MOST for step in steps) or cells.prod() > 64 * points.shape[1]:
        raise UnreadableFile(f"{name}: {points.shape[1]} points over {high - low} m are no map")
    count = np.rint(cells).astype(np.int64) + 1
    middle = low + 0.5 * count * steps
    centred = np.concatenate([points[:2] - middle[:, None], points[2:]])
    shape = int(count[1]), int(count[0])
    known = (float(middle[0]), float(middle[1])) if placed else None
    return MeasuredMap(name, centred, (steps[0], steps[1]), shape, regular, known)


def _spread(xy: Floats, low: Floats, high: Floats) -> float:
    """Side of the squares that scattered points (2, n) fill: of their mean density, larger where they lie in
    groups, as the corners of facets that are not merged; 0 where they lie on a line.
    """
    side = float(np.sqrt(np.prod(high - low) / xy.shape[1]))
    for _ in range(GROWN if side >= LEAST else 0):
        count = np.ceil((high - low) / side) + 1.0
        column, row = np.floor((xy - low[:, None]) / side)
        if len(np.unique(row * count[0] + column)) >= FILLED * np.prod((high - low) / side):
            break
        side *= np.sqrt(2.0)
    return side


def _step(values: Floats) -> float:
    """Spacing of values that are multiples of it from the least; 0 where they are not."""
    ordered = np.unique(values)
    if len(ordered) < 2 or len(ordered) > 0.5 * len(values):
        return 0.0
    step = float(np.median(np.diff(ordered)))
    off = (ordered - ordered[0]) / step
    return step if np.abs(off - np.rint(off)).max() < 0.01 else 0.0
