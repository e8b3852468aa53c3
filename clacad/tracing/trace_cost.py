"""Processor seconds of tracing a file of rays, by a model of one reference machine; see
`clacad.base.machine_rates`.
"""

from __future__ import annotations

from collections.abc import Sequence

from clacad.tracing.which_path import IDEAL_FACES, worth_compiled

FIXED = 0.03
"""Seconds for opening archives and assembling the result."""

COMPILED = 0.7
"""Seconds for loading the compiler and the kernels it cached."""

PER_RAY = {"law": 3.5e-7, "thin": 4.2e-7, "surfaces": 4.2e-7, "mesh": 5e-7}
"""Seconds for reading, tracing and writing a ray."""

PLAIN = {"law": 1.7e-6, "thin": 2.0e-6, "surfaces": 2.6e-6, "mesh": 3.0e-6}
"""Seconds for a ray where there are too few rays for compiled kernels."""

PER_EFFECT = 2e-6
PER_BYTE = 4e-7
"""Seconds for each byte of a file of triangles: read, sorted into a tree."""


def trace_seconds(
    rays: int, rung: str, effects: Sequence[str] = (), faces: int = 4, mesh_bytes: int = 0
) -> float:
    """Processor seconds of a trace.

    Parameters
    ----------
    rays : int
    rung : "law", "thin", "surfaces" or "mesh"
    effects : sequence of str
    faces : int
        Refracting surfaces of the sheet.
    mesh_bytes : int
        Size of the file of triangles, if there is one.
    """
    plain = _in_numpy(rung, effects, rays, faces, mesh_bytes > 0)
    fixed = FIXED + (0.0 if plain else COMPILED)
    each = (PLAIN if plain else PER_RAY).get(rung, PER_RAY["surfaces"])
    return fixed + rays * (each + PER_EFFECT * len(effects)) + PER_BYTE * mesh_bytes


def task(
    rung: str, effects: Sequence[str] = (), rays: int = 0, faces: int = 4, from_file: bool = False
) -> str:
    """Name under which such a trace is recorded: everything that affects the time of a ray."""
    plain = _in_numpy(rung, effects, rays, faces, from_file)
    parts = ["trace", rung, "numpy" if plain else "", "file" if from_file else "", *sorted(effects)]
    return " ".join(part for part in parts if part)


def _in_numpy(rung: str, effects: Sequence[str], rays: int, faces: int, from_file: bool) -> bool:
    """Whether the rays are too few for compiled kernels; ideal rungs with effects have none, facets of a file
    only those.
    """
    if rung in ("law", "thin"):
        return bool(effects) or not worth_compiled(rays, IDEAL_FACES)
    return not (from_file or worth_compiled(rays, faces))
