"""Sources of limits as data, with their text: the design file, a default, a process profile, or another
limit.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import Enum
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from clacad.design import Design
    from clacad.design.process_profiles import ProcessProfile


class Origin(Enum):
    """Kinds of sources of a limit."""

    OWN_KEY = "the key of [check] that has the check's name, or its default"
    OTHER_KEY = "made from another key of [check], or from its default"
    DESIGN = "the design file gives it"
    DEFAULT = "this program's own"
    PROFILE = "a process profile"
    DERIVED = "made from what was forecast or stated"
    OTHER = "as its words say"


@dataclass(frozen=True, slots=True)
class LimitSource:
    """Source of a limit.

    origin : Origin
    what : str
        Key, name of the profile, or text of what the limit is derived from.
    basis : str
        Basis of a process profile.
    given : bool
        Whether the design file gives the key; only known after `known_to`.
    """

    origin: Origin = Origin.OWN_KEY
    what: str = ""
    basis: str = ""
    given: bool = False

    def known_to(self, design: Design, check_id: str) -> LimitSource:
        """Copy that records whether the design file gives the key of the limit, or the key it derives
        from.
        """
        if self.origin not in (Origin.OWN_KEY, Origin.OTHER_KEY):
            return self
        key = check_id if self.origin is Origin.OWN_KEY else self.what
        return replace(self, given=key in design.given.get("check", {}))

    @property
    def heading(self) -> str:
        """Text without the basis of a process profile."""
        file_or_default = "design file" if self.given else "default"
        return {
            Origin.OWN_KEY: file_or_default,
            Origin.OTHER_KEY: f"derived from {self.what} ({file_or_default})",
            Origin.DESIGN: "design file",
            Origin.DEFAULT: f"default: {self.what}" if self.what else "default",
            Origin.PROFILE: f"process profile {self.what}",
            Origin.DERIVED: f"derived: {self.what}",
            Origin.OTHER: self.what,
        }[self.origin]

    def __str__(self) -> str:
        """Text for the page and JSON."""
        return f"{self.heading}: {self.basis}" if self.basis else self.heading


OWN_KEY = LimitSource()
DESIGN_FILE = LimitSource(Origin.DESIGN)
DEFAULT = LimitSource(Origin.DEFAULT)


def from_key(name: str) -> LimitSource:
    """Source of a limit derived from another key of [check]."""
    return LimitSource(Origin.OTHER_KEY, name)


def from_profile(rules: ProcessProfile) -> LimitSource:
    """Source of a limit from a process profile."""
    return LimitSource(Origin.PROFILE, rules.name, rules.source)


def default(words: str) -> LimitSource:
    """Source of a default limit of this program."""
    return LimitSource(Origin.DEFAULT, words)


def derived(words: str) -> LimitSource:
    """Source of a limit derived from a forecast or a statement."""
    return LimitSource(Origin.DERIVED, words)


def other(words: str) -> LimitSource:
    """Source of a limit of any other kind."""
    return LimitSource(Origin.OTHER, words)
