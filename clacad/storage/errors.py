"""What can stop an export, each with the exit status the command line returns for it."""

from __future__ import annotations

from collections.abc import Mapping
from errno import EAGAIN, EMFILE, ENFILE
from typing import Any


class ExportError(Exception):
    """An export that did not happen; `exit_status` is the command line's answer."""

    exit_status = 70


class CannotWrite(ExportError):
    """A file could not be written (disk full, read-only folder, a folder where a file should be)."""

    exit_status = 4


class ExportRefused(CannotWrite):
    """Writing would overwrite something that an earlier export does not own."""


class UnknownFormat(ExportError, ValueError):
    """A format was asked for that is not written."""

    exit_status = 2


class BadRequest(ExportError, ValueError):
    """Quads or roles that cannot be understood, or for a format that has none."""

    exit_status = 2


class NotPossible(ExportError):
    """A file that this design cannot have: a frame without a gap, a baffle without walls; the message says why."""

    exit_status = 2


class ExportIncomplete(ExportError):
    """Some of the files could not be made; the others were published, and `manifest` lists them.

    Parameters
    ----------
    failures : mapping of format to ExportError
    manifest : Manifest
        What was published.
    """

    def __init__(self, failures: Mapping[str, ExportError], manifest: Any) -> None:
        super().__init__("; ".join(f"{name}: {error}" for name, error in failures.items()))
        self.failures = dict(failures)
        self.manifest = manifest
        self.exit_status = next(iter(failures.values())).exit_status


class LimitRefused(ExportError):
    """The work would pass a limit; the message holds the number and two ways to get under it."""

    exit_status = 3


LIMITS_OF_THE_SYSTEM = {
    EMFILE: "this process may open no more files; ulimit -n raises that",
    ENFILE: "the system can open no more files",
    EAGAIN: "the system starts no more processes; ulimit -u raises that",
}
"""Numbers of the system's errors that say that a limit of its own was met, and how that is said."""


def refused_by_system(error: OSError, what: str) -> LimitRefused | None:
    """Give the refusal that an error of the system stands for, None if it met no limit; `what` could not be done."""
    why = LIMITS_OF_THE_SYSTEM.get(error.errno or 0)
    return None if why is None else LimitRefused(f"{what}: {why}")


class WorkerDied(ExportError):
    """The process that did the native work ended without an answer.

    Parameters
    ----------
    sentence : str
        What happened, in one sentence.
    details : str
        Last lines the process wrote to its error stream; for a log, not for the user.
    over_budget : bool
        Whether it ended because it took more memory or processor time than it was given.
    """

    def __init__(self, sentence: str, details: str = "", *, over_budget: bool = False) -> None:
        super().__init__(sentence)
        self.details = details
        self.over_budget = over_budget


class UnreadableFile(ExportError, ValueError):
    """A file is not what its name says, is cut short, or is built to harm its reader."""

    exit_status = 1


class OverBudget(UnreadableFile):
    """A file takes more bytes, items or processor seconds than its reader has; nothing says that it is wrong."""

    exit_status = 3


class FileDisagrees(ExportError):
    """A file that was written reads back as something other than the design."""

    exit_status = 1
