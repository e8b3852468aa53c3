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


DESIGN, CONVERGENCE, MESH, SOLID, REPORT = 0.5, 2.0, 0.8, 3.0, 4.0
"""Seconds of a design apart from its rays, of how facets converge, of a mesh and of a solid apart from their size, and of
a report.
"""

PER_RAY, PER_FACET, PER_LIT, PER_BYTE = 4.8e-6, 1.1e-6, 8e-6, 1e-6
"""Seconds of a ray of the main bundle, a facet in a file, a facet of the cells that are lit, a byte of a solid's text."""

FOUND, PER_FOUND = 0.2, 1.5e-6
"""Seconds of finding how a part lies that no manifest lists, and of a facet of it: of 2,500 and of 334,000 facets."""

MOST_LIT = 500_000
"""Facets of one cell up to which finer ones take longer to light."""


def seconds(rays: int, files: Sequence[Subject], report: bool = False) -> float:
    """Processor seconds of verifying a design with so many rays, and some files.

    Parameters
    ----------
    rays : int
    files : sequence of Subject
        Meshes cost their triangles, and once the study of how facets converge; returned ones are found besides; solids
        cost their text.
    report : bool
        Whether a report is written of it.
    """
    meshes = [subject for subject in files if subject.is_mesh]
    solids = [subject for subject in files if subject.is_solid]
    triangles = sum(MESH + PER_FACET * _facets(subject) + PER_LIT * _lit(subject) for subject in meshes)
    triangles += sum(FOUND + PER_FOUND * _facets(subject) for subject in meshes if _returned(subject))
    text = sum(SOLID + PER_BYTE * subject.bytes for subject in solids)
    once = DESIGN + PER_RAY * rays + (CONVERGENCE if meshes else 0.0) + (REPORT if report else 0.0)
    return once + triangles + text


def task(files: Sequence[Subject], report: bool = False) -> str:
    """Name under which such a verification is noted."""
    kinds = [
        name
        for name, is_one in (("mesh", "is_mesh"), ("step", "is_solid"))
        if any(getattr(s, is_one) for s in files)
    ]
    returned = ["returned"] if any(s.is_mesh and _returned(s) for s in files) else []
    return " ".join(["verify", *kinds, *returned, *(["report"] if report else [])])


def _returned(subject: Subject) -> bool:
    """Whether no manifest lists a file: how it lies is not known."""
    return not subject.entry


def _lit(subject: Subject) -> float:
    """Facets of one cell, about, where its manifest says how many quads a side it has."""
    quads = subject.entry.get("quads")
    return min(8.0 * quads * quads, MOST_LIT) if isinstance(quads, int) else 0.0


def _facets(subject: Subject) -> float:
    """Facets that are looked at: those in the file, however often they stand."""
    for key in ("triangles_stored", "triangles"):
        stated = subject.entry.get(key)
        if isinstance(stated, (int, float)) and stated > 0:
            return float(stated)
    return subject.bytes / BYTES_A_FACET.get(subject.format, 50.0)
