"""Errors of exports and readers, each with the exit status of the command line."""

from __future__ import annotations

from collections.abc import Mapping
from errno import EAGAIN, EMFILE, ENFILE
from typing import Any


class ExportError(Exception):
    """Failure of an export; `exit_status` is the exit status of the command line."""

    exit_status = 70


class CannotWrite(ExportError):
    """A file could not be written (disk full, read-only folder, a folder where a file should be)."""

    exit_status = 4


class ExportRefused(CannotWrite):
    """Writing would overwrite something that an earlier export does not own."""


class UnknownFormat(ExportError, ValueError):
    """An unknown format was requested."""

    exit_status = 2


class BadRequest(ExportError, ValueError):
    """Quads or roles that cannot be understood, or for a format that has none."""

    exit_status = 2


class NotPossible(ExportError):
    """A file that is impossible for this design (a frame without a gap, a baffle without walls)."""

    exit_status = 2


class ExportIncomplete(ExportError):
    """Some files could not be made; the others were published, and `manifest` lists them.

    failures : mapping of format to ExportError
    manifest : Manifest. Manifest of the published files.
    """

    def __init__(self, failures: Mapping[str, ExportError], manifest: Any) -> None:
        super().__init__("; ".join(f"{name}: {error}" for name, error in failures.items()))
        self.failures = dict(failures)
        self.manifest = manifest
        self.exit_status = next(iter(failures.values())).exit_status


class LimitRefused(ExportError):
    """The work would exceed a limit; the message gives the number and two ways to stay below it."""

    exit_status = 3


LIMITS_OF_THE_SYSTEM = {
    EMFILE: "this process may open no more files; ulimit -n raises that",
    ENFILE: "the system can open no more files",
    EAGAIN: "the system starts no more processes; ulimit -u raises that",
}
"""System error number of an exceeded system limit → its description."""


def refused_by_system(error: OSError, what: str) -> LimitRefused | None:
    """Refusal for a system error of an exceeded limit, None for other errors; `what` could not be done."""
    why = LIMITS_OF_THE_SYSTEM.get(error.errno or 0)
    return None if why is None else LimitRefused(f"{what}: {why}")


class WorkerDied(ExportError):
    """The process that did the native work ended without an answer.

    sentence : What happened, in one sentence.
    details : Last lines of the process's error stream; for a log, not for the user.
    over_budget : Whether it ended because it exceeded its memory or processor time.
    """

    def __init__(self, sentence: str, details: str = "", *, over_budget: bool = False) -> None:
        super().__init__(sentence)
        self.details = details
        self.over_budget = over_budget


class UnreadableFile(ExportError, ValueError):
    """A file does not match its name, is truncated, or is malicious."""

    exit_status = 1


class OverBudget(UnreadableFile):
    """A file exceeds its reader's budget of bytes, items or processor seconds; it may still be valid."""

    exit_status = 3


class FileDisagrees(ExportError):
    """A written file differs from the design when read back."""

    exit_status = 1
