"""The ideal law of a generalized confocal lenslet array: how the sheet changes directions.

Per axis of the lenses, parallel rays of slope t leave with slope t' = (t − δ)/η. In the sheet frame
this is a homography of directions, d' ∝ A d with A = R M Rᵀ (Hamilton & Courtial 2009, eq. 6; 3-D
form after Oxburgh, White, Antoniou & Courtial 2014).
"""

from __future__ import annotations

from clacad.optics.law.imaging import apparent_map, image_planes, image_point, stretch, stretch_on_sheet
from clacad.optics.law.law import (
    Fit,
    Law,
    difference_of_laws,
    law_numbers,
    linear_numbers,
    with_linear_numbers,
)
from clacad.optics.law.orientation import angle_between, euler_angles, rotation, rotation_degrees
from clacad.optics.law.refraction import refract_2d, small_angle_2d

__all__ = [
    "Fit",
    "Law",
    "angle_between",
    "apparent_map",
    "difference_of_laws",
    "euler_angles",
    "image_planes",
    "image_point",
    "law_numbers",
    "linear_numbers",
    "refract_2d",
    "rotation",
    "rotation_degrees",
    "small_angle_2d",
    "stretch",
    "stretch_on_sheet",
    "with_linear_numbers",
]
