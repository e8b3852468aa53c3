"""Checks of an imaging sheet: where the image of the requested point lies, and how narrow it is there."""

from __future__ import annotations

from collections.abc import Iterator
from math import hypot, inf, isfinite, sqrt
from typing import TYPE_CHECKING

import numpy as np

from clacad.base.types import Pair2
from clacad.checks.check import Check
from clacad.checks.light_kinds import IMAGE_POINT, SPOT
from clacad.imaging.image_by_rays import image, lens_plane
from clacad.optics.law.imaging import spot_widths
from clacad.sheet.window import Window
from clacad.verification.light.law_checks import Lit

if TYPE_CHECKING:
    from clacad.design import Design

RAYS = 16_384
NEAR = 0.01
"""Allowed error of the image point over the image distance, where the image of a cell is narrower."""
SPREAD = 1.5
"""Limit over the combined width that the cells, the limit of the law's error and diffraction cause."""


def asked_image(design: Design) -> tuple[tuple[float, float, float], float] | None:
    """Point that a design images, and its image's distance behind array 2 (lengths); None for other designs.

    A sheet of two focal lengths has no image point, and an image at infinity has no distance.
    """
    spec, planes = design.law_spec.varying, design.pair.focus
    if spec is None and planes is None:
        return None
    if spec is not None and spec.conjugates is not None:
        planes = spec.conjugates
    if planes is not None:
        return ((0.0, 0.0, planes.object), planes.image) if isfinite(planes.image) else None
    if (
        spec is not None
        and spec.f_image is not None
        and spec.f_image[0] == spec.f_image[1]
        and isfinite(spec.f_image[0])
    ):
        return (0.0, 0.0, -inf), spec.f_image[0]
    return None


def image_checks(lit: Lit) -> Iterator[Check]:
    """Judge the image of the point on the axis; no checks for a design that images no point."""
    design, window = lit.design, lit.window
    asked = asked_image(design)
    if asked is None:
        return
    source, distance = asked
    found = image(window, source, ("surfaces",), RAYS)
    (one,) = found.rungs
    if not np.isfinite(one.found.point).all():
        yield from (
            kind.not_run("no light of the requested point gets through") for kind in (IMAGE_POINT, SPOT)
        )
        return
    place = one.found.point - (0.0, 0.0, lens_plane(window, "surfaces"))
    across = one.found.point[:2] - one.predicted.point[:2]
    off = hypot(*across.tolist(), float(place[2]) - distance)
    text = f"{RAYS} Sobol rays over all cells, of which {one.found.rays} get through"
    unit = design.unit
    width = found.width
    assert width is not None  # an imaging design has no table
    limit = max(*width, NEAR * abs(distance))
    yield IMAGE_POINT.judge(
        off,
        limit,
        f"light of the requested point meets {place[2]:.6g} {unit} behind array 2 at ({place[0]:.3g},"
        f" {place[1]:.3g}), {off:.3g} {unit} from where the law has it ({distance:.6g})",
        unit=unit,
        bundle=text,
        detail={"found": place.tolist(), "share": one.share},
    )
    narrow = _allowed(design, window, width, distance)
    worst = max(range(2), key=lambda k: one.found.spot[k] / narrow[k])
    yield SPOT.judge(
        one.found.spot[worst],
        narrow[worst],
        f"there it is {one.found.spot[0]:.4g}, {one.found.spot[1]:.4g} {unit} wide (rms in x and y); cells"
        f" alone leave {width[worst] / sqrt(12.0):.4g}",
        unit=unit,
        bundle=text,
        detail={"spot": list(one.found.spot), "width": list(width)},
    )


def _allowed(design: Design, window: Window, width: Pair2, distance: float) -> Pair2:
    """Largest rms width of the image along x and y (lengths) within the limits of the design."""
    waves = design.pair.wavelength / design.unit_m
    _, _, wave = spot_widths(window.law, window.lattice.pitch, abs(distance), 0.0, waves)
    x, y = (
        SPREAD * sqrt(w * w / 12.0 + (design.check.law_rms * distance) ** 2 + d * d)
        for w, d in zip(width, wave, strict=True)
    )
    return x, y
