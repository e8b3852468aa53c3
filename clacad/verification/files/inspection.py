"""What every step of judging a file needs to know: the design, the file's name and role, and how many rays to send."""

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
    """One file that is judged.

    design : Design
        What is asked, and the limits.
    name : str
        File name, the subject of the checks.
    rays : int
        Of the main bundle through it.
    progress : callable
        (stage, done 0 … 1).
    role : Role
        What the file is for.
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
        """What all checks of a file share."""
        return {"where": "file", "subject": self.name}
