"""What a verification costs in processor seconds, by a model of one reference machine; see `clacad.base.machine_rates`."""

from __future__ import annotations

from collections.abc import Sequence

from clacad.verification.files.find_files import Subject

BYTES_A_FACET = {
    "stl-binary": 50.0,
    "stl": 50.0,
    "stl-ascii": 260.0,
    "ply": 43.0,
    "obj": 90.0,
    "3mf": 10.0,
    "glb": 25.0,
}


def seconds(rays: int, files: Sequence[Subject]) -> float:
    """Processor seconds of verifying a design with so many rays, and some files.

    Parameters
    ----------
    rays : int
    files : sequence of Subject
        Meshes cost their triangles, and once the study of how facets converge; solids their text.
    """
    meshes = [subject for subject in files if subject.is_mesh]
    solids = [subject for subject in files if subject.is_solid]
    once = 3.3 if meshes else 0.0
    triangles = sum(0.6 + 5.3e-6 * _facets(subject) for subject in meshes)
    return 0.5 + 4.8e-6 * rays + once + triangles + sum(0.85 + 1.0e-6 * subject.bytes for subject in solids)


def task(files: Sequence[Subject]) -> str:
    """Name under which such a verification is noted."""
    kinds = [
        name
        for name, is_one in (("mesh", "is_mesh"), ("step", "is_solid"))
        if any(getattr(s, is_one) for s in files)
    ]
    return " ".join(["verify", *kinds])


def _facets(subject: Subject) -> float:
    stated = subject.entry.get("triangles")
    if isinstance(stated, (int, float)) and stated > 0:
        return float(stated)
    return subject.bytes / BYTES_A_FACET.get(subject.format, 50.0)
