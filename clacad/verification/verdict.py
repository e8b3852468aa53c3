"""The verdict on a delivery in a few words: a master passes by light alone; a preview is at most a shape.

`passed as optical master` means that light through that file obeys the law. A coarse mesh that approximates
the design faithfully is *shape only*: no defect, but no part should be made from it. A file not judged by
light cannot pass.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from clacad.base.text import mrad_text
from clacad.checks.check import RAYS_NEEDED, Check, wrong
from clacad.checks.file_kinds import DELIVERY, FAITHFUL_RMS, FILE_LAW_ETA, FILE_LAW_RMS, THROUGH_FILE
from clacad.exporting.roles import Role

Word = Literal[
    "passed",
    "passed as optical master",
    "passed as scan",
    "passed as tooling",
    "shape only",
    "failed",
    "not judged",
    "cannot say",
]
"""Verdicts; the first is for a design without files."""

GOOD: tuple[Word, ...] = ("passed", "passed as optical master", "passed as scan", "passed as tooling")


@dataclass(frozen=True, slots=True)
class FileVerdict:
    """Verdict on one file.

    role : Role under which it was judged.
    declared : Whether the role was declared by a person.
    word : "not judged" for a file without optics, or where fewer rays were requested than a verdict needs.
    rms, limit : float or None, radians
        Direction error to the law of light through the file, and its limit; None where no light was traced.
    sentence : Description of the file, or the reason why it failed.
    """

    name: str
    role: Role
    declared: bool
    word: Word
    rms: float | None
    limit: float | None
    sentence: str

    def row(self) -> tuple[str, str, str, str]:
        """Name, role, verdict, and the error of light through the file, of its limit ("" if not measured)."""
        light = ""
        if self.rms is not None and self.limit is not None:
            light = f"{mrad_text(self.rms, 3, unit='')} of {mrad_text(self.limit, 3)} rms"
        return self.name, self.role.value, self.word, light


def file_verdict(
    name: str, role: Role, declared: bool, mesh: bool, checks: Sequence[Check], cut: str
) -> FileVerdict:
    """Derive the verdict on one file from its checks.

    name, role, declared
    mesh : Whether it holds triangles: only those can be faithful and too coarse.
    checks : Checks of this file alone.
    cut : Fineness of a mesh ("in 4 quads a cell"), "" where unknown.
    """
    rms = FILE_LAW_RMS.first(checks)
    # for a scan the check judges the error without noise; the total error of the light includes it
    whole = None if rms is None else rms.detail.get("with_noise", rms.value)
    value = whole if isinstance(whole, float) else None
    limit = rms.limit if rms is not None and isinstance(rms.limit, float) else None
    bad = wrong(checks)
    faithful = mesh and any(c.kind is FAITHFUL_RMS and c.state != "not run" for c in checks)
    light = [c for c in checks if c.kind in THROUGH_FILE and c.state in ("fail", "warn")]
    word: Word
    if any(c.kind is DELIVERY for c in bad) or (bad and all(RAYS_NEEDED in c.detail for c in bad)):
        word = "not judged"
    elif role is Role.OTHER:
        word = "failed" if bad else "not judged"
    elif [c for c in bad if not (faithful and c.kind in THROUGH_FILE)]:
        word = "failed"
    elif role is Role.SCAN:
        word = "failed" if bad else "passed as scan"
    elif role is Role.TOOLING:
        word = "failed" if bad else "passed as tooling"
    elif bad or (role is Role.PREVIEW and (declared or light)):
        word = "shape only"  # an undeclared preview is a forecast: light may decide otherwise
    else:
        word = "passed as optical master"
    return FileVerdict(
        name, role, declared, word, value, limit, _sentence(word, bad, light, value, limit, cut)
    )


def _sentence(
    word: Word, bad: Sequence[Check], light: Sequence[Check], rms: float | None, limit: float | None, cut: str
) -> str:
    """Sentence that accompanies the word."""
    through = ""
    if rms is not None and limit is not None:
        through = (
            f"light through it is {mrad_text(rms, 3)} rms from the law (limit {mrad_text(limit, 3, unit='')})"
        )
    if word == "shape only":
        said = f"cut {cut}; " if cut else ""
        beyond = rms is not None and limit is not None and rms > limit
        said += (
            through.replace("is", "misses the law by", 1).replace(" from the law", "") if beyond else through
        )
        eta = FILE_LAW_ETA.first(light)
        if eta is not None and "measured" in eta.detail:
            said += _worst_eta(eta)
        return said or "a shape to look at"
    if word == "failed":
        return "; ".join(f"{c.id}: {c.sentence}" for c in bad[:3])
    if word == "not judged":
        return (
            "; ".join(c.sentence for c in bad[:2])
            or "it carries no light of the law: judged by its bytes and shape"
        )
    if word == "passed as scan":
        return f"{through}; a measured surface, not a file to make parts from"
    if word == "passed as tooling":
        return f"of the part that it makes: {through or 'every number is as it should be'}"
    return through or "every number in it is the design's"


def _worst_eta(eta: Check) -> str:
    """Text of the component of η with the largest error, with its value through the exact surfaces."""
    found, exact = eta.detail["measured"], eta.detail["exact"]
    k = max((0, 1), key=lambda axis: abs(found[axis] / exact[axis] - 1.0))
    return f", η_{'xy'[k]} {found[k]:.3g} for {exact[k]:.3g}"


def word_of(judged: Sequence[FileVerdict], checks: Sequence[Check]) -> Word:
    """Word for a whole delivery: that of its worst master; previews count only where nobody declared them.

    checks : All checks of the report, including those of no file.
    """
    names = {one.name for one in judged}
    if wrong(c for c in checks if c.subject not in names and c.kind is not DELIVERY):
        return "failed"
    words = {one.word for one in judged}
    if "failed" in words:
        return "failed"
    if wrong(c for c in checks if c.kind is DELIVERY):
        return "not judged"
    if "cannot say" in words:
        return "cannot say"
    optical = [one for one in judged if one.role is not Role.OTHER]
    if any(one.word == "not judged" for one in optical):
        return "not judged"
    if any(one.word == "shape only" and not settled(one) for one in optical):
        return "shape only"
    if any(one.word == "passed as optical master" for one in optical):
        return "passed as optical master"
    if any(one.word == "shape only" for one in optical):
        return "shape only"
    late: tuple[Word, ...] = ("passed as scan", "passed as tooling")
    return next((word for word in late if any(one.word == word for one in optical)), "not judged")


def settled(one: FileVerdict) -> bool:
    """Whether a file with the verdict shape only was declared as a preview."""
    return one.role is Role.PREVIEW and one.declared
