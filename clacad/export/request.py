"""What was asked of an export."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any, Literal

EXTRAS = ("step_schema", "pcurves", "saddle_bevel", "gpu_instancing", "grey_levels")


@dataclass(frozen=True, slots=True)
class Request:
    """What was asked of an export; see `clacad.export.export`."""

    formats: tuple[str, ...]
    slope_error: float | Literal["auto"] = "auto"
    quads: int | None = None
    step: Literal["auto", "fused", "instanced"] = "auto"
    cells: tuple[int, int] | None = None
    overwrite: bool = False
    force: bool = False
    step_schema: Literal["ap242", "ap214"] = "ap242"
    pcurves: bool = True
    saddle_bevel: float = 0.0
    gpu_instancing: bool = False
    grey_levels: int = 64

    def to_dict(self) -> dict[str, Any]:
        """Options as the manifest keeps them; those that few ask for only where they were asked for."""
        plain = {
            "formats": list(self.formats), "slope_error": self.slope_error, "quads": self.quads, "step": self.step,
            "cells": None if self.cells is None else list(self.cells),
        }  # fmt: skip
        usual = {field.name: field.default for field in fields(self)}
        asked = {name: getattr(self, name) for name in EXTRAS}
        return plain | {name: value for name, value in asked.items() if value != usual[name]}
