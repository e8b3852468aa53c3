"""Inputs of every step of judging a file: the design, the file's name and role, and the ray count."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from clacad.base.types import Progress, silent
from clacad.exporting.roles import Role

if TYPE_CHECKING:
    from clacad.design import Design


@dataclass(frozen=True, eq=False)
class Inspection:
    """One file under judgement.

    design : Design
        Gives the law and the limits.
    name : str
        File name, the subject of the checks.
    rays : int
        Ray count of the main bundle through the file.
    progress : callable
        (stage, done 0 … 1).
    role : Role
        Purpose of the file.
    stated : mapping
        Its entry in a manifest; empty without one.
    """

    design: Design
    name: str
    rays: int
    progress: Progress = silent
    role: Role = Role.MASTER
    stated: Mapping[str, Any] = field(default_factory=dict)

    @property
    def common(self) -> dict[str, Any]:
        """Fields that all checks of a file share."""
        return {"where": "file", "subject": self.name}
