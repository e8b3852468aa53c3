"""Levers: keys of a design, each with the direction of its change, that may mend a check."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final


@dataclass(frozen=True, slots=True)
class Lever:
    """One key and the direction of its change.

    key : str
    way : "up", "down", "word", "aim" or "shape"
        A shape has no nearest sufficient value: too much is as bad as too little.
    """

    key: str
    way: str


FARTHER = Lever("pair.separation", "up")
CLOSER = Lever("pair.separation", "down")
FINER = Lever("lattice.pitch", "down")
COARSER = Lever("lattice.pitch", "up")
THICKER = Lever("pair.thickness", "up")
THINNER = Lever("pair.thickness", "down")
WEB = Lever("pair.web", "up")
WIDER_NECK = Lever("body.neck", "up")
BORDER = Lever("body.border", "up")
SEAM = Lever("lattice.seam", "up")
LESS_SEAM = Lever("lattice.seam", "down")
RECIPE = Lever("pair.confocal", "word")
BICONIC = Lever("pair.surface", "word")
CONIC = Lever("pair.conic", "shape")
TURNED = Lever("pair.curved", "word")
APERTURE = Lever("lattice.aperture", "word")
AIM = Lever("lattice.aperture", "aim")
FIELD_LENS = Lever("pair.field_lens", "word")

SHARPER = (RECIPE, FARTHER, BICONIC, FINER, TURNED, APERTURE)
"""For a law that is not met sharply enough."""

WHOLE = (THICKER, FARTHER, FINER)
"""For bodies that lack material."""

FLATTER = (FARTHER, FINER, BICONIC)
"""For lenses that are too steep."""

UNBUILT: Final = (FARTHER, FINER, THICKER, THINNER, LESS_SEAM, RECIPE)
"""Levers of a design that cannot be built."""

WORDS: Final[Mapping[str, tuple[str | bool, ...]]] = {
    "pair.field_lens": (True,),
    "pair.confocal": ("exact", "best"),
    "pair.surface": ("biconic",),
    "pair.curved": ("outside", "inside"),
    "lattice.aperture": ("centred", "aligned"),
}
"""Trial words of a key."""

FORMS: Final[Mapping[str, tuple[str, ...]]] = {
    "pair.confocal": ("biconvex", "plano"),
    "pair.surface": ("plano", "slab"),
    "pair.curved": ("plano",),
    "pair.conic": ("biconvex", "plano", "slab"),
    "pair.web": ("biconvex",),
    "pair.thickness": ("biconvex", "plano"),
}
"""Forms of the pair that have the key, or accept it without another one."""
