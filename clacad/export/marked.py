"""Meshes of bodies with name and arrow engraved: the sheet's own mesh, its border alone triangulated anew."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

from clacad.export.compare import Promise
from clacad.export.tessellation import Tessellation
from clacad.fixture.letters import Engraving
from clacad.fixture.mark import mark_place, pockets
from clacad.sheet import Window

if TYPE_CHECKING:
    from clacad.export.formats import Job
    from clacad.export.manifest import FileRecord
    from clacad.mesh import Mesh

SECONDS = 300.0
"""Time for the kernel to draw a few lines of text."""


@dataclass(frozen=True, eq=False)
class Engraved(Tessellation):
    """A tessellation whose bodies carry marks.

    Parameters
    ----------
    plain : Tessellation
        The same without.
    engravings : mapping
        Body name → what is sunk into it.
    """

    plain: Tessellation | None = None
    engravings: Mapping[str, Engraving] | None = None

    @cached_property
    def mesh(self) -> Mesh:
        """Mesh of the whole sheet with its marks."""
        from clacad.fixture.engrave import engraved_mesh

        assert self.plain is not None
        assert self.engravings is not None
        whole = self.plain.mesh
        bodies = tuple(engraved_mesh(body, self.engravings[body.name]) for body in whole.bodies)
        return replace(whole, bodies=bodies)

    def promise(self, instanced: bool, single: bool, bodies: Sequence[str] | None = None) -> Promise:
        """What a file of this mesh must be found to be: its volume less the letters', its floors in their room."""
        plain = super().promise(instanced, single, bodies)
        names = [body.name for body in self.window.bodies if bodies is None or body.name in bodies]
        places = tuple(pocket for pocket in pockets(self.window) if pocket.body in names)
        return replace(plain, added=plain.added - sum(self.taken(name) for name in names), pockets=places)

    def taken(self, name: str) -> float:
        """Volume of the letters of one body (length³): what the mesh lost, by its own divergence sum."""
        assert self.plain is not None
        before, after = (
            next(body for body in mesh.bodies if body.name == name) for mesh in (self.plain.mesh, self.mesh)
        )
        return before.volume() - after.volume()


def engraved(job: Job) -> Job:
    """The same job with a mesh that carries the marks.

    Raises
    ------
    NoFixture
        A body has no border, or one too narrow.
    WorkerDied
        The kernel could not draw the letters.
    """
    for body in job.window.bodies:
        mark_place(job.window, body)  # refused before anything is drawn
    job.progress("draw letters", 0.0)
    told: Mapping[str, Any] = job.worker.run(
        "clacad.export.marked:letters", job.window, timeout=SECONDS, progress=job.progress
    )
    drawn = {name: Engraving.from_dict(one) for name, one in told.items()}
    plain = job.tessellation
    return replace(
        job,
        tessellation=Engraved(plain.window, plain.quads, plain.saddle_bevel, plain=plain, engravings=drawn),
    )


def letters(window: Window) -> dict[str, Any]:
    """Draw the letters of every body in the worker: body name → outlines."""
    from clacad.fixture.letters import engravings

    return {name: one.to_dict() for name, one in engravings(window, window.name).items()}


def with_marks(record: FileRecord, job: Job) -> FileRecord:
    """The record of a file, with what was engraved: text, depth, volume taken, chords of the letters (mm)."""
    made = job.tessellation
    assert isinstance(made, Engraved)
    assert made.engravings is not None
    told = {
        name: {
            "text": made.engravings[name].text, "depth": made.engravings[name].depth,
            "volume": made.taken(name) * job.scale**3, "chord_error_max": made.engravings[name].chord,
        }
        for name in record.bodies
    }  # fmt: skip
    return replace(record, facts={**record.facts, "marks": told})
