"""Photographs in a scene: picture files read as linear light."""

from __future__ import annotations

import os
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clacad.base.types import Floats

LARGEST_PICTURE = 1 << 28
"""Pixels of a picture that is read at most."""


def decode(pixels: NDArray[Any]) -> Floats:
    """Linear light, 0 … 1, of sRGB-encoded bytes of any shape (…)."""
    table = np.arange(256) / 255.0
    table = np.where(table <= 0.04045, table / 12.92, ((table + 0.055) / 1.055) ** 2.4)
    return np.asarray(table[pixels])


def read_picture(path: str | os.PathLike[str]) -> Floats:
    """Linear light (h, w, 3) of a picture file; transparent pixels are laid over black.

    Raises
    ------
    OSError
        No such file, no picture, or one of more than 2²⁸ pixels.
    """
    from PIL import Image, ImageOps

    with Image.open(path) as picture:
        if picture.width * picture.height > LARGEST_PICTURE:
            raise OSError(f"{path}: {picture.width} x {picture.height} pixels are too many")
        upright = ImageOps.exif_transpose(picture) or picture
        rgba = np.asarray(upright.convert("RGBA"))
    return decode(rgba[..., :3]) * (rgba[..., 3:] / 255.0)
