"""Levers: keys of a design, each with the direction of its change, that may mend a check."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

from clacad.design.sections import BODY, LATTICE, PAIR


@dataclass(frozen=True, slots=True)
class Lever:
    """One key and the direction of its change.

    way : "up", "down", "word", "aim" or "shape"
        A shape has no nearest sufficient value: too much is as bad as too little.
    """

    key: str
    way: str


FARTHER = Lever(PAIR.separation, "up")
CLOSER = Lever(PAIR.separation, "down")
FINER = Lever(LATTICE.pitch, "down")
COARSER = Lever(LATTICE.pitch, "up")
THICKER = Lever(PAIR.thickness, "up")
THINNER = Lever(PAIR.thickness, "down")
WEB = Lever(PAIR.web, "up")
WIDER_NECK = Lever(BODY.neck, "up")
BORDER = Lever(BODY.border, "up")
SEAM = Lever(LATTICE.seam, "up")
LESS_SEAM = Lever(LATTICE.seam, "down")
RECIPE = Lever(PAIR.confocal, "word")
BICONIC = Lever(PAIR.surface, "word")
CONIC = Lever(PAIR.conic, "shape")
TURNED = Lever(PAIR.curved, "word")
APERTURE = Lever(LATTICE.aperture, "word")
AIM = Lever(LATTICE.aperture, "aim")
FIELD_LENS = Lever(PAIR.field_lens, "word")

SHARPER = (RECIPE, FARTHER, BICONIC, FINER, TURNED, APERTURE)
"""For a law that is not met sharply enough."""

WHOLE = (THICKER, FARTHER, FINER)
"""For bodies that lack material."""

FLATTER = (FARTHER, FINER, BICONIC)
"""For lenses that are too steep."""

UNBUILT: Final = (FARTHER, FINER, THICKER, THINNER, LESS_SEAM, RECIPE)
"""Levers of a design that cannot be built."""

WORDS: Final[Mapping[str, tuple[str | bool, ...]]] = {
    PAIR.field_lens: (True,),
    PAIR.confocal: ("exact", "best"),
    PAIR.surface: ("biconic",),
    PAIR.curved: ("outside", "inside"),
    LATTICE.aperture: ("centred", "aligned"),
}
"""Trial words of a key."""

FORMS: Final[Mapping[str, tuple[str, ...]]] = {
    PAIR.confocal: ("biconvex", "plano"),
    PAIR.surface: ("plano", "slab"),
    PAIR.curved: ("plano",),
    PAIR.conic: ("biconvex", "plano", "slab"),
    PAIR.web: ("biconvex",),
    PAIR.thickness: ("biconvex", "plano"),
}
"""Forms of the pair that have the key, or accept it without another one."""
