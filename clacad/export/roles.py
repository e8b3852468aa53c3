"""What a file is for: parts are made from a master, a preview is looked at, a scan was measured, the rest is other.

Parts are made from an optical master, so light through it must obey the law. A preview is for looking, quoting and fit
checks. A scan is a measured surface: judged, never called fit for making. Everything else (baffle, frame, coupon,
pictures' scenes) carries no light of the law.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum


class Role(StrEnum):
    """What a file is for; the words stand in manifests and reports."""

    MASTER = "optical-master"
    PREVIEW = "shape-preview"
    SCAN = "scan"
    OTHER = "other"


WORDS: Mapping[str, Role] = {
    "master": Role.MASTER, "preview": Role.PREVIEW, "scan": Role.SCAN,
    "optical-master": Role.MASTER, "shape-preview": Role.PREVIEW,
}  # fmt: skip
"""Words by which a role is declared; nobody declares "other"."""

NOT_OPTICAL = frozenset({"baffle", "frame", "coupon", "pov", "scene"})
"""Formats and bodies that carry no light of the law, by the words of manifests."""
