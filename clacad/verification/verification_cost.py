"""Cost of a verification in processor seconds, by a model of one reference machine; see
`clacad.base.machine_rates`.
"""

from __future__ import annotations

from collections.abc import Sequence

from clacad.judging.delivery import Subject

DESIGN, CONVERGENCE, MESH, SOLID, REPORT = 0.5, 2.0, 0.8, 3.0, 4.0
"""Seconds, each without the part that depends on size: a design, the convergence study, a mesh, a solid, a
report."""

PER_RAY, PER_FACET, PER_LIT, PER_BYTE = 4.8e-6, 1.1e-6, 8e-6, 1e-6
"""Seconds per ray of the main bundle, facet in a file, facet of the lit cells, and byte of a solid's text."""

FOUND, PER_FOUND = 0.2, 1.5e-6
"""Seconds to register a part without a manifest, and per facet of it; measured with 2,500 and 334,000
facets."""

MOST_LIT = 500_000
"""Facets of one cell up to which the time to light it increases."""


def seconds(rays: int, files: Sequence[Subject], report: bool = False) -> float:
    """Processor seconds of verifying a design with `rays` rays, and some files.

    Parameters
    ----------
    rays : int
    files : sequence of Subject
        Meshes cost their triangles, and one convergence study together; those without a manifest entry also
        cost
        registration; solids cost their text.
    report : bool
        Whether a report is written.
    """
    meshes = [subject for subject in files if subject.is_mesh]
    solids = [subject for subject in files if subject.is_solid]
    triangles = sum(MESH + PER_FACET * _facets(subject) + PER_LIT * _lit(subject) for subject in meshes)
    triangles += sum(FOUND + PER_FOUND * _facets(subject) for subject in meshes if _returned(subject))
    text = sum(SOLID + PER_BYTE * subject.bytes for subject in solids)
    once = DESIGN + PER_RAY * rays + (CONVERGENCE if meshes else 0.0) + (REPORT if report else 0.0)
    return once + triangles + text


def task(files: Sequence[Subject], report: bool = False) -> str:
    """Name under which the time of such a verification is recorded."""
    kinds = [
        name
        for name, is_one in (("mesh", "is_mesh"), ("step", "is_solid"))
        if any(getattr(s, is_one) for s in files)
    ]
    returned = ["returned"] if any(s.is_mesh and _returned(s) for s in files) else []
    return " ".join(["verify", *kinds, *returned, *(["report"] if report else [])])


def _returned(subject: Subject) -> bool:
    """Whether no manifest lists a file, so that its pose is unknown."""
    return not subject.entry


def _lit(subject: Subject) -> float:
    """Approximate facets of one cell, where its manifest gives the quads per side."""
    quads = subject.entry.get("quads")
    return min(8.0 * quads * quads, MOST_LIT) if isinstance(quads, int) else 0.0


def _facets(subject: Subject) -> float:
    """Facets that are examined: those stored in the file, each once regardless of its instances."""
    for key in ("triangles_stored", "triangles"):
        stated = subject.entry.get(key)
        if isinstance(stated, (int, float)) and stated > 0:
            return float(stated)
    return subject.bytes / (50.0 if subject.kind is None else subject.kind.bytes_a_facet)
