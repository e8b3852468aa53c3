"""One file that was judged, and the evidence gathered on it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from clacad.exporting.roles import Role
from clacad.sheet.window import Window
from clacad.verification.files.find_files import Subject
from clacad.verification.files.mesh_light import MeshEvidence


@dataclass(frozen=True, eq=False)
class FileReport:
    """One file that was judged: what it is, and the evidence gathered on it.

    window : Window or None
        With the cells of the file; None where they are the design's.
    present : names of the bodies in it, or None for all
    role : Role or None
        As it was judged, where that is not what it was handed in as.
    """

    subject: Subject
    note: str = ""
    mesh: MeshEvidence | None = None
    solid: Mapping[str, Any] | None = None
    window: Window | None = None
    present: tuple[str, ...] | None = None
    role: Role | None = None

    @property
    def judged_as(self) -> Role:
        """What it was judged as."""
        return self.subject.role if self.role is None else self.role
