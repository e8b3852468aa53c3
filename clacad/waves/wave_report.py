"""Report of waves through one telescopelet: numbers, JSON, picture with the rays along both lens axes.

Results of waves and rays as rows of text.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from clacad.base.drawn_figure import drawn, inline_svg, no_formula
from clacad.base.interactive import Tabular, columns_of
from clacad.base.text import digits, mrad_list, nm_text
from clacad.base.types import Floats, Pair2
from clacad.waves.exit_pupil import FarField, Marginal, RaySpread

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


SIZE = (9.6, 4.2)
STYLE = {"font.size": 9.0, "svg.hashsalt": "clacad", "svg.fonttype": "path"}
INK, WAVES, IDEAL, RAYS = "#1c2733", "#1b6ca8", "#8b98a5", "#c2571a"

LOBES = 4.0
"""Least number of widths λ/w shown on either side of the law."""

BINS = 60
"""Number of bins of the rays' histogram."""


@dataclass(frozen=True, eq=False)
class WaveReport(Tabular):
    """Light of one direction through one telescopelet, as waves and as rays.

    design : str
    wavelength : float, metres
    slope : (x, y)
        Slope of the incident light along lens x and y.
    fresnel : (x, y)
        Fresnel numbers along the middle of the field.
    slit : (x, y), radians
        λ over the lit width of lens 2.
    order : (x, y), radians
        Angles between the directions into which identical cells send coherent light, λ/p on a square lattice.
    field_lens : bool
    exact, thin : FarField or None
        Pupil method and angular spectrum; None where it could not be computed.
    rays : RaySpread
        By exact trace through the surfaces.
    thin_share, thin_share_of_rays : float
        Light to the partner through ideal lenses as waves (NaN where not computed), and as rays.
    refused : mapping of way to sentence
    cell : (i, j) or None
            The lit cell of a non-uniform sheet: the one by which the sheet is judged.
        tried : int
            Number of cells of which it is the worst.
    """

    design: str
    wavelength: float
    slope: Pair2
    fresnel: Pair2
    slit: Pair2
    order: Pair2
    field_lens: bool
    exact: FarField | None
    thin: FarField | None
    rays: RaySpread
    thin_share: float
    thin_share_of_rays: float
    refused: dict[str, str]
    cell: tuple[int, int] | None = None
    tried: int = 0

    @property
    def far_field(self) -> FarField:
        """The valid far field: the pupil's wherever it was computed."""
        found = self.exact or self.thin
        assert found is not None, "one of them was computed, or `wave` raised"
        return found

    @property
    def share(self) -> float:
        """Share of the light on lens 1's optical zone that leaves through the partner.

        It includes aberration and diffraction: the share of rays through the exact surfaces times the change
        by waves through ideal lenses.
        """
        change = self.thin_share / self.thin_share_of_rays if np.isfinite(self.thin_share) else 1.0
        return self.thin_share if self.exact is None else min(1.0, self.rays.share * change)

    def picture(self, format: Literal["png", "svg"] = "png") -> bytes:
        """Far field along both lens axes, waves over rays, as the bytes of a picture."""
        return drawn(format, SIZE, lambda figure: draw(figure, self), STYLE)

    def __repr__(self) -> str:
        way, number = self.far_field.way, min(self.fresnel)
        return f"WaveReport({self.design!r}, {way}, Fresnel number {number:.3g}, share {self.share:.3g})"

    def to_columns(self) -> dict[str, Any]:
        """One row for each method and lens axis: share, Strehl ratio, angles in radians."""
        ways = (("exact", self.exact, self.share), ("thin", self.thin, self.thin_share))
        rows: list[dict[str, Any]] = [
            {
                "method": f"waves, {name}",
                "lens": axis,
                "share": share,
                "strehl": far.strehl,
                "middle_off_law": one.middle,
                "fwhm": one.width,
                "half_energy": one.half_energy,
            }
            for name, far, share in ways
            if far is not None
            for axis, one in zip("xy", far.marginals, strict=True)
        ]
        for axis, off, half in zip("xy", self.rays.mean, self.rays.half_energy, strict=True):
            rows.append({"method": "rays, exact", "lens": axis, "share": self.rays.share})
            rows[-1] |= {"middle_off_law": off, "half_energy": half}
        return columns_of(rows)

    def _picture(self) -> str:
        return inline_svg(self.picture("svg").decode())

    def to_dict(self) -> dict[str, Any]:
        """Plain JSON: radians and metres."""
        return {
            "design": self.design,
            "wavelength": self.wavelength,
            "slope": list(self.slope),
            "fresnel_number": list(self.fresnel),
            "slit": list(self.slit),
            "order": list(self.order),
            "field_lens": self.field_lens,
            "share": self.share,
            "way": self.far_field.way,
            "exact": None if self.exact is None else self.exact.to_dict(),
            "thin": None if self.thin is None else self.thin.to_dict() | {"share": self.thin_share},
            "rays": self.rays.to_dict(),
            "thin_share_of_rays": self.thin_share_of_rays,
            "refused": dict(self.refused),
            "cell": None if self.cell is None else list(self.cell),
            "tried": self.tried,
        }


def draw(figure: Figure, found: WaveReport) -> None:
    """Draw on a given figure."""
    for k, axes in enumerate(figure.subplots(1, 2)):
        axis(axes, found, k)
    one = "one telescopelet" if found.cell is None else f"cell ({found.cell[0]}, {found.cell[1]})"
    figure.suptitle(
        no_formula(
            f"{found.design}: {one}'s far field at {nm_text(found.wavelength)}, Fresnel number"
            f" {min(found.fresnel):.3g}"
        ),
        fontsize=10,
    )


def axis(axes: Axes, found: WaveReport, k: int) -> None:
    """Draw one lens axis, k = 0 or 1, on given axes."""
    rays = found.rays.off[:, k]
    reach = max(LOBES * found.slit[k], 1.2 * float(np.abs(rays).max(initial=0.0)))
    scale = found.slit[k]
    for far, name, colour, line in (
        (found.exact, "waves, exact surfaces", WAVES, "-"),
        (found.thin, "waves, ideal lenses", IDEAL, "--"),
    ):
        if far is not None:
            shown = _within(far.marginals[k], reach)
            axes.plot(1e3 * shown[0], scale * shown[1], line, color=colour, lw=1.3, label=name)
    counts, edges = np.histogram(rays, BINS, (-reach, reach))
    height = counts / max(1, len(rays)) / (edges[1] - edges[0]) * scale
    axes.stairs(height, 1e3 * edges, color=RAYS, fill=True, alpha=0.25, label="rays, exact surfaces")
    if height.max(initial=0.0) > 2.0:  # rays of a good pair share one direction: keep the waves visible
        axes.set_ylim(0.0, 2.0)
    axes.axvline(0.0, color=INK, lw=0.6)
    axes.set_xlabel(f"off the law along lens {'xy'[k]} / mrad")
    axes.set_ylabel("light a λ/w")
    axes.legend(fontsize=7, loc="upper right")


def _within(one: Marginal, reach: float) -> tuple[Floats, Floats]:
    kept = np.abs(one.off) <= reach
    return one.off[kept], one.density[kept]


HEAD = (
    "",
    "share to the partner",
    "Strehl ratio",
    "middle off the law, mrad",
    "full width, half max., mrad",
    "through the peak, mrad",
    "half of the light in, mrad",
)
"""Head of `rows`; the last four columns in mrad, along lens x and lens y."""


def rows(found: WaveReport) -> list[tuple[str, ...]]:
    """Waves through exact surfaces and ideal lenses, as far as computed, then rays; see `HEAD`."""
    told: list[tuple[str, ...]] = []
    for far, name, share in (
        (found.exact, "waves, exact surfaces", found.share),
        (found.thin, "waves, ideal lenses", found.thin_share),
    ):
        if far is not None:
            one, through = far.marginals, far.sections
            told.append(
                (
                    name,
                    digits(share, count=4),
                    digits(far.strehl, count=4),
                    mrad_list([m.middle for m in one], 4),
                    mrad_list([m.width for m in one], 4),
                    mrad_list([m.width for m in through], 4),
                    mrad_list([m.half_energy for m in one], 4),
                )
            )
    rays = found.rays
    told.append(
        (
            "rays, exact surfaces",
            digits(rays.share, count=4),
            "",
            mrad_list(rays.mean, 4),
            "",
            "",
            mrad_list(rays.half_energy, 4),
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
        f"{one}{nm_text(found.wavelength)}, slope {x:.4g}, {y:.4g} along lens x, y; Fresnel number "
        f"{digits(min(found.fresnel), count=4)}; holds here: {found.far_field.way}"
    )


def sentences(found: WaveReport) -> list[str]:
    """Sentences that accompany the rows: the slit, the rays' error, orders, and what was not computed."""
    cells = "equal" if found.cell is None else "neighbouring"
    return [
        (
            "widths are of the light summed over the other axis; that through the peak is of a section"
            " through the brightest direction"
        ),
        "Strehl ratio: peak over that of the light that meets the partner, were its wave front flat",
        (
            f"λ/w of what is lit of lens 2: {mrad_list(found.slit, 4)} mrad; rays alone miss the law by"
            f" {mrad_list([found.rays.rms], 4)} mrad rms"
        ),
        (
            f"in coherent light {cells} cells send orders λ/p = {mrad_list(found.order, 4)} mrad apart: the"
            " law is met to ± half of that"
        ),
        *(f"not computed, {way}: {why}" for way, why in found.refused.items()),
    ]
