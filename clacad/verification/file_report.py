"""A judged file, and the evidence gathered on it."""

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
    """A judged file with its identity and the evidence gathered on it.

    window : Window or None
        Window with the cells of the file; None where they are the design's.
    present : names of the bodies in it, or None for all
    role : Role or None
        Role as judged, where it differs from the declared one.
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
        """Role under which the file was judged."""
        return self.subject.role if self.role is None else self.role
