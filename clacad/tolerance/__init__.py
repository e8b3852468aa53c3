"""What fabrication gets wrong, and what it does to light: tolerances, sensitivities, yield; and parameter sweeps.

`tolerance` perturbs the window as built (array poses, radii, index, thickness, roughness), traces it, and says in
the words of lenslet sheets what happens: image shift, moiré, residual power, blur, throughput. `sweep` does the
same for any keys of the design. Both run point by point on an executor and resume from a checkpoint. Names resolve
when first used.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from clacad.tolerance.checkpoint import Checkpoint, OtherStudy
    from clacad.tolerance.errors import NoTolerances
    from clacad.tolerance.farm import Farm
    from clacad.tolerance.grid import Sweep, parse_vary, sweep
    from clacad.tolerance.measures import MEASURES, Bench, bench
    from clacad.tolerance.misalign import as_made, telescopelet
    from clacad.tolerance.plot import plot_sweep, plot_tolerances
    from clacad.tolerance.sources import Parameter, draw, parameters
    from clacad.tolerance.study import Study, tolerance
    from clacad.tolerance.write import read_study, write_study, write_sweep

_HOME = {
    "Checkpoint": "checkpoint", "OtherStudy": "checkpoint", "NoTolerances": "errors", "Farm": "farm",
    "MEASURES": "measures", "Bench": "measures", "bench": "measures", "Parameter": "sources", "draw": "sources",
    "parameters": "sources", "plot_sweep": "plot", "plot_tolerances": "plot", "Study": "study",
    "tolerance": "study", "Sweep": "grid", "parse_vary": "grid", "sweep": "grid", "as_made": "misalign",
    "telescopelet": "misalign", "read_study": "write", "write_study": "write", "write_sweep": "write",
}  # fmt: skip

__all__ = [
    "MEASURES", "Bench", "Checkpoint", "Farm", "NoTolerances", "OtherStudy", "Parameter", "Study", "Sweep", "as_made",
    "bench", "draw", "parameters", "parse_vary", "plot_sweep", "plot_tolerances", "read_study", "sweep",
    "telescopelet", "tolerance", "write_study", "write_sweep",
]  # fmt: skip


def __getattr__(name: str) -> Any:
    """Import a public name from its module when it is first used."""
    if name not in _HOME:
        raise AttributeError(f"module 'clacad.tolerance' has no attribute {name!r}")
    return getattr(import_module(f"clacad.tolerance.{_HOME[name]}"), name)
