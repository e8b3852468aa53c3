"""Results of waves and rays as rows of text."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from clacad.base.digits import digits

if TYPE_CHECKING:
    from clacad.waves.wave_report import WaveReport

HEAD = (
    "",
    "share to the partner",
    "Strehl ratio",
    "middle off the law",
    "full width, half max.",
    "through the peak",
    "half of the light in",
)
"""Head of `rows`; the last four columns in mrad, along lens x and lens y."""


def mrad(values: Sequence[float]) -> str:
    """Radians as milliradians with four digits."""
    return ", ".join(digits(1e3 * v, count=4) for v in values)


def rows(found: WaveReport) -> list[tuple[str, ...]]:
    """Waves through the exact surfaces and through ideal lenses, as far as computed, then rays; see `HEAD`."""
    told: list[tuple[str, ...]] = []
    for far, name, share in (
        (found.exact, "waves, exact surfaces", found.share),
        (found.thin, "waves, ideal lenses", found.thin_share),
    ):
        if far is not None:
            one, through = far.marginals, far.sections
            told.append(
                (name, digits(share, count=4), digits(far.strehl, count=4), mrad([m.middle for m in one]),
                 mrad([m.width for m in one]), mrad([m.width for m in through]), mrad([m.half_energy for m in one]))
            )  # fmt: skip
    rays = found.rays
    told.append(
        (
            "rays, exact surfaces",
            digits(rays.share, count=4),
            "",
            mrad(rays.mean),
            "",
            "",
            mrad(rays.half_energy),
        )
    )
    return told


def head(found: WaveReport) -> str:
    """Cell (of a non-uniform sheet), wavelength, direction, Fresnel number, and the valid method."""
    x, y = found.slope
    one = (
        ""
        if found.cell is None
        else f"cell ({found.cell[0]}, {found.cell[1]}), the worst of {found.tried} tried, "
    )
    return (
        f"{one}{1e9 * found.wavelength:.4g} nm, slope {x:.4g}, {y:.4g} along lens x, y; Fresnel number "
        f"{digits(min(found.fresnel), count=4)}; holds here: {found.far_field.way}"
    )


def sentences(found: WaveReport) -> list[str]:
    """Sentences that accompany the rows: the slit, the rays' error, orders, and what was not computed."""
    cells = "equal" if found.cell is None else "neighbouring"
    return [
        "widths are of the light summed over the other axis; that through the peak is of a section through the brightest direction",
        "Strehl ratio: peak over that of the light that meets the partner, were its wave front flat",
        f"λ/w of what is lit of lens 2: {mrad(found.slit)} mrad; rays alone miss the law by {mrad([found.rays.rms])} mrad rms",
        f"in coherent light {cells} cells send orders λ/p = {mrad(found.order)} mrad apart: the law is met to ± half of that",
        *(f"not computed, {way}: {why}" for way, why in found.refused.items()),
    ]
