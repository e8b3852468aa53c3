"""Photographs in a scene: picture files read as linear light."""

from __future__ import annotations

import os
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from clacad.base.types import Floats
from clacad.storage.errors import OverBudget
from clacad.storage.reading import Spending

if TYPE_CHECKING:
    from PIL.Image import Image

FORMATS = ("PNG", "JPEG", "WEBP", "TIFF", "BMP", "GIF")
"""Formats that are opened; the library supports others, some of which start an interpreter."""

KEPT = 1 << 24
"""Largest number of pixels kept of a picture; larger ones are averaged over blocks, in linear light."""

_STRIP = 1 << 20
"""Pixels decoded at a time."""


class BadPicture(ValueError):
    """A file that is no picture, or a damaged one; exit status 2, like any other mistake in the input."""

    exit_status = 2


def decode(pixels: NDArray[Any]) -> Floats:
    """Linear light, 0 … 1, of sRGB-encoded bytes of any shape (…)."""
    table = np.arange(256) / 255.0
    table = np.where(table <= 0.04045, table / 12.92, ((table + 0.055) / 1.055) ** 2.4)
    return np.asarray(table[pixels])


def read_picture(path: str | os.PathLike[str]) -> Floats:
    """Linear light (h, w, 3) of a picture file, upright; transparent pixels are laid over black.

    Pictures of more than 2²⁴ pixels are averaged over blocks of 2 × 2, 3 × 3 …, so that fewer pixels are
    kept.

    Raises BadPicture: No picture of a supported format, truncated or damaged.
    Raises OverBudget: More bytes or pixels than are read.
    Raises OSError: No such file.
    """
    facts = os.stat(path)
    return _read(os.path.realpath(path), os.fspath(path), (facts.st_mtime_ns, facts.st_size, facts.st_ino))


@lru_cache(maxsize=1)
def _read(_real: str, path: str, _facts: tuple[int, ...]) -> Floats:
    """Read as `read_picture`, with a cache.

    A scene reads its photograph for every still; the last one is kept while its file is unchanged.
    """
    from PIL import ImageOps

    with opened_picture(path) as picture:
        ImageOps.exif_transpose(picture, in_place=True)
        picture.load()
        width, height = picture.size
        side = int(np.ceil(np.sqrt(width * height / KEPT)))
        rows = side * max(1, _STRIP // (side * width))
        light = np.empty((-(-height // side), -(-width // side), 3))
        for top in range(0, height, rows):
            strip = _means(_light(picture, top, min(top + rows, height)), side)
            light[top // side : top // side + len(strip)] = strip
    light.flags.writeable = False
    return light


def picture_size(path: str | os.PathLike[str]) -> tuple[int, int]:
    """Width and height of a picture file, pixels, after upright rotation. Errors: see `read_picture`."""
    with opened_picture(path) as picture:
        lies = picture.getexif().get(_ORIENTATION, 1) in (5, 6, 7, 8)
        return (picture.height, picture.width) if lies else (picture.width, picture.height)


_ORIENTATION = 0x0112


@contextmanager
def opened_picture(path: str | os.PathLike[str]) -> Iterator[Image]:
    """Open a picture whose size is allowed; any error of the library within the block becomes a refusal."""
    from PIL import Image, UnidentifiedImageError

    spent = Spending("picture", path)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # the library's own limit; clacad's is applied below
            with Image.open(path, formats=FORMATS) as picture:
                spent.count(picture.width * picture.height)
                yield picture
    except OverBudget:
        raise
    except (Image.DecompressionBombError, MemoryError) as error:
        raise OverBudget(f"{spent.name}: its pixels are too many ({error})") from error
    except Exception as error:  # the library's decoders raise nearly everything
        if isinstance(error, OSError) and error.errno is not None:
            raise
        words = (
            "no picture of a format that is read" if isinstance(error, UnidentifiedImageError) else str(error)
        )
        raise BadPicture(f"{os.fspath(path)}: {words[:200]} ({', '.join(FORMATS)} are read)") from error


def _light(picture: Image, top: int, bottom: int) -> Floats:
    """Linear light (k, w, 3) of some rows of a picture."""
    rows = picture.crop((0, top, picture.width, bottom))
    if not rows.has_transparency_data:
        return decode(np.asarray(rows.convert("RGB")))
    rgba = np.asarray(rows.convert("RGBA"))
    return decode(rgba[..., :3]) * (rgba[..., 3:] / 255.0)


def _means(light: Floats, side: int) -> Floats:
    """Means of blocks of side × side pixels; blocks at the right and lower edge may be smaller."""
    if side == 1:
        return light
    down, across = (np.arange(0, n, side) for n in light.shape[:2])
    sums = np.add.reduceat(np.add.reduceat(light, down, axis=0), across, axis=1)
    many = np.diff(down, append=light.shape[0])[:, None] * np.diff(across, append=light.shape[1])
    return np.asarray(sums / many[..., None])
