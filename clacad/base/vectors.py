"""Vectors in space: triangles of many at once, rows in turned axes, and axes across a direction.

Triangles are arrays (k, 3, 3) of their corners. Sums are written column by column: the result of
``numpy.cross`` of two edges in a third of its time.
"""

from __future__ import annotations

import numpy as np

from clacad.base.types import Floats, Pair2


def doubled_normals(corners: Floats) -> Floats:
    """Right-hand normals (k, 3) of triangles (k, 3, 3), as long as twice the triangle's area (length²)."""
    (ax, ay, az), (bx, by, bz), (cx, cy, cz) = np.ascontiguousarray(np.moveaxis(corners, 0, -1))
    ux, uy, uz = bx - ax, by - ay, bz - az
    vx, vy, vz = cx - ax, cy - ay, cz - az
    return np.stack([uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx]).T


def lengths(vectors: Floats) -> Floats:
    """Lengths (k,) of vectors (k, 3)."""
    x, y, z = vectors.T
    return np.asarray(np.sqrt(x * x + y * y + z * z))


def middles(corners: Floats) -> Floats:
    """Centroids (k, 3) of triangles (k, 3, 3)."""
    a, b, c = np.moveaxis(corners, 1, 0)
    return np.asarray((a + b + c) / 3.0)


def to_sheet(rotation: Floats | None, rows: Floats) -> Floats:
    """Rows (n, 3) rotated from surface axes to sheet axes by one rotation (3, 3) or by one each (n, 3, 3);
    summed in a fixed order for any number of rows.
    """
    if rotation is None:
        return rows
    x, y, z = rows[:, 0], rows[:, 1], rows[:, 2]
    columns = rotation if rotation.ndim == 2 else np.moveaxis(rotation, 0, -1)
    return np.stack([r[0] * x + r[1] * y + r[2] * z for r in columns], axis=-1)


def to_surface(rotation: Floats | None, rows: Floats) -> Floats:
    """Rows (n, 3) rotated from sheet axes to surface axes."""
    return rows if rotation is None else to_sheet(rotation.swapaxes(-1, -2), rows)


def rotated_by(about_x: float, about_y: float, about_z: float) -> Floats:
    """Rotation (3, 3) about the vector (x, y, z), by its length in radians (Rodrigues); no order of axes."""
    x, y, z = vector = np.array([about_x, about_y, about_z])
    angle = float(np.linalg.norm(vector))
    if angle == 0.0:
        return np.eye(3)
    half = 0.5 * angle
    across = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    first, second = np.sin(angle) / angle, 0.5 * (np.sin(half) / half) ** 2
    return np.asarray(np.eye(3) + first * across + second * (across @ across))


def unit(vector: Floats) -> Floats:
    """Return a vector (3,) at length 1."""
    return np.asarray(vector / np.linalg.norm(vector))


def axes_near(direction: Floats, axis: int = 0) -> tuple[Floats, Floats]:
    """Two unit vectors (3,) across a unit vector: the first as near to a coordinate axis as possible.

    The three are right-handed in the order first, second, direction.
    """
    first = unit(np.eye(3)[axis] - direction[axis] * direction)
    return first, np.cross(direction, first)


def axes_across(direction: Floats, axis: int | None = None) -> Floats:
    """Two unit vectors across a unit vector and across one another, as the columns of (3, 2).

    The first is also across a coordinate axis; None: the axis that is farthest from the direction.
    """
    aside = np.eye(3)[int(np.argmin(np.abs(direction))) if axis is None else axis]
    first = unit(np.cross(aside, direction))
    return np.stack([first, np.cross(direction, first)], axis=1)


def picture_axes(position: Floats, target: Floats, up: Floats) -> tuple[float, Floats, Floats]:
    """Distance from a camera to its target, and unit vectors (3,) to the right and up in its picture."""
    look = target - position
    distance = float(np.linalg.norm(look))
    ahead = look / distance
    right = unit(np.cross(ahead, up))
    return distance, right, np.cross(right, ahead)


def xy(values: Floats) -> Pair2:
    """First two components of an array (2,) or longer."""
    return float(values[0]), float(values[1])
