"""Fabrication errors and their effect on light: tolerances, sensitivities, yield; and parameter sweeps.

`tolerance` perturbs the window as built (array poses, radii, index, thickness, roughness) and traces it. It
reports the results in the terms of lenslet sheets: image shift, moiré, residual power, blur, throughput.
`sweep` varies any keys of the design instead. Both run point by point on an executor and resume from a
checkpoint. Names resolve when first used.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from clacad.formats.study_file import read_study

if TYPE_CHECKING:
    from clacad.verification.tolerance.farm import Checkpoint, Farm, OtherStudy
    from clacad.verification.tolerance.light_measures import MEASURES, Bench, bench
    from clacad.verification.tolerance.misaligned import Parameter, as_made, draw, parameters, telescopelet
    from clacad.verification.tolerance.parameter_sweep import Sweep, parse_vary, sweep
    from clacad.verification.tolerance.study import NoTolerances, Study, tolerance
    from clacad.verification.tolerance.study_files import (
        plot_sweep,
        plot_tolerances,
        write_study,
        write_sweep,
    )

_HOMES = {
    "farm": ("Checkpoint", "Farm", "OtherStudy"),
    "light_measures": ("MEASURES", "Bench", "bench"),
    "misaligned": ("Parameter", "as_made", "draw", "parameters", "telescopelet"),
    "parameter_sweep": ("Sweep", "parse_vary", "sweep"),
    "study": ("NoTolerances", "Study", "tolerance"),
    "study_files": ("plot_sweep", "plot_tolerances", "write_study", "write_sweep"),
}

__all__ = [
    "MEASURES",
    "Bench",
    "Checkpoint",
    "Farm",
    "NoTolerances",
    "OtherStudy",
    "Parameter",
    "Study",
    "Sweep",
    "as_made",
    "bench",
    "draw",
    "parameters",
    "parse_vary",
    "plot_sweep",
    "plot_tolerances",
    "read_study",
    "sweep",
    "telescopelet",
    "tolerance",
    "write_study",
    "write_sweep",
]


def __getattr__(name: str) -> Any:
    """Import a public name from its module when it is first used."""
    home = next((module for module, names in _HOMES.items() if name in names), None)
    if home is None:
        raise AttributeError(f"module 'clacad.verification.tolerance' has no attribute {name!r}")
    return getattr(import_module(f"clacad.verification.tolerance.{home}"), name)
