"""Input of a block of camera rays: the stage, the sheet and how light passes it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from clacad.base.types import Floats
from clacad.rendering.scene_arrays import SceneArrays
from clacad.rendering.sheet_passage import Passage
from clacad.rendering.spectrum import SpectralLine
from clacad.scene.kinds import Rgb
from clacad.sheet.window import Window


@dataclass(frozen=True, eq=False)
class Viewing:
    """All data that a block of camera rays needs.

    Attributes
    ----------
    stage : SceneArrays
    window : Window
    passage : Passage
        How rays pass the sheet: rung, effects, which fates shine.
    lines : tuple of SpectralLine
        Wavelengths to trace and the contribution of each to the picture.
    scale : float
        Window lengths in one scene length.
    box : (2, 3) lengths, scene frame
        Around the sheet, with room to spare: rays that miss it miss the sheet.
    front : float, length
        Scene z up to which objects are before the sheet.
    opaque : bool
        Whether nothing is visible outside the sheet.
    present : bool
        Whether there is a sheet at all.
    before : bool
        Whether an object may be between camera and sheet.
    compiled : bool
        Compiled code or numpy.
    tables : Tables
        The stage for compiled code.
    tint : (red, green, blue)
        Linear transmission of what is seen through the sheet.
    pane : Pane or None
        The sheet for the single kernel `compiled.pixels.sample_all`, where that supports it.
    """

    stage: SceneArrays
    window: Window
    passage: Passage
    lines: tuple[SpectralLine, ...]
    scale: float
    box: Floats
    front: float
    opaque: bool
    present: bool
    before: bool
    compiled: bool
    tables: Any
    tint: Rgb
    pane: Any = None
