"""Gain of a search for parts as made: array 2 displaced by 1 µm, rotated and tilted by 0.1 mrad.

Each error is applied alone, with either sign, and the squares are added: the expected value for independent
errors. The results are those of the telescopelet at the sheet's centre. Towards the corners of a large sheet,
a rotated array is displaced by far more than 1 µm; that effect is reported separately.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import sqrt
from typing import Any, Final

import numpy as np

from clacad.base.text import mrad_text
from clacad.base.types import Floats
from clacad.design import Design
from clacad.prescription.prescribe import prescribe
from clacad.verification.tolerance import Bench, bench

ASIDE: Final = 1e-6
"""Displacement (metres) of array 2 along x and along y."""

TURNED: Final = 1e-4
"""Rotation (radians) of array 2 about the sheet's normal, and tilt about x and y."""

RAYS: Final = 128
"""Rays of a bundle."""

SURVIVES: Final = 0.5
"""Share of the gain above which it counts as surviving."""

NONE_LEFT: Final = 1.1
"""Gain below which none counts as left."""

MEASURES: Final = ("law_rms", "blur", "image_shift")


@dataclass(frozen=True, slots=True)
class AsMade:
    """One design, perfect and as made; radians.

    law_rms, made_rms : rms error to the law
    blur, made_blur : rms spread of parallel light over a cell
    shift : displacement of the image
    corner : displacement of the image at the sheet's corners by the rotation alone
    """

    law_rms: float
    made_rms: float
    blur: float
    made_blur: float
    shift: float
    corner: float


@dataclass(frozen=True, slots=True)
class GainAsMade:
    """Before and after, perfect and as made."""

    before: AsMade
    after: AsMade

    @property
    def gain(self) -> float:
        """Factor by which the error of the perfect part is reduced."""
        return self.before.law_rms / self.after.law_rms

    @property
    def made_gain(self) -> float:
        """Factor by which the error of parts as made is reduced."""
        return self.before.made_rms / self.after.made_rms

    def sentence(self) -> str:
        """Sentence on whether the gain survives."""
        if self.made_gain >= SURVIVES * self.gain:
            word = f"the gain survives: {self.made_gain:.3g} of {self.gain:.3g} times"
        elif self.made_gain > NONE_LEFT:
            word = f"the gain survives in part: {self.made_gain:.3g} of {self.gain:.3g} times"
        else:
            word = f"the gain of {self.gain:.3g} times is lost"
        before, after = self.before, self.after
        return (
            f"With array 2 aside by 1 µm, turned and tilted by 0.1 mrad, {word}. The error to the law is then"
            f" {mrad_text(before.made_rms, 3, unit='')} before and {mrad_text(after.made_rms, 3)} after, of"
            f" which {mrad_text(after.shift, 3)} is the image aside, which no face can take away; parallel"
            f" light spreads by {mrad_text(before.made_blur, 3, unit='')} before and"
            f" {mrad_text(after.made_blur, 3)} after. At the corners of this sheet the turn alone"
            f" moves the image by {mrad_text(after.corner, 3)}, for any the faces."
        )

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers, radians."""
        made = {
            name: {key: getattr(one, key) for key in AsMade.__slots__}
            for name, one in (("before", self.before), ("after", self.after))
        }
        return {**made, "sentence": self.sentence()}


def gain_as_made(before: Design, after: Design) -> GainAsMade:
    """Measure both designs, perfect and as made, by the measures of `clacad tolerance`."""
    return GainAsMade(_as_made(before), _as_made(after))


def _as_made(design: Design) -> AsMade:
    everywhere = bench(design, prescribe(design), RAYS)
    table = replace(everywhere, places=everywhere.places[:1])
    aside = ASIDE / design.unit_m
    errors = {
        "decentre.2.x": aside,
        "decentre.2.y": aside,
        "rotation": TURNED,
        "tilt.x": TURNED,
        "tilt.y": TURNED,
    }
    nominal = _squares(table, {})
    added = [
        0.5 * (_squares(table, {name: size}) + _squares(table, {name: -size})) - nominal
        for name, size in errors.items()
    ]
    made = np.sqrt(nominal + np.maximum(0.0, added).sum(axis=0))
    corner = _squares(everywhere, {"rotation": TURNED})[0] - _squares(everywhere, {})[0]
    rms, blur, _ = np.sqrt(nominal).tolist()
    return AsMade(rms, float(made[0]), blur, float(made[1]), float(made[2]), sqrt(max(0.0, float(corner))))


def _squares(table: Bench, errors: Mapping[str, float]) -> Floats:
    """Squares of the measures of a part made with these errors, (3,)."""
    found = table.measured(errors)
    return np.array([found[measure] for measure in MEASURES]) ** 2
