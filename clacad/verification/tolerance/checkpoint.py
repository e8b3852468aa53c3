"""Append-only file of results, in which the checksum of every line covers all lines before it.

A line is a checksum, a space and a JSON value. The checksum covers the line and the checksum before it. A
killed run
therefore leaves a prefix of the file of a complete run, and a truncated, changed or moved line ends the
prefix.
The first line identifies the study.
"""

from __future__ import annotations

import fcntl
import json
import os
from collections.abc import Iterable, Mapping
from hashlib import sha256
from math import inf, isnan, nan
from pathlib import Path
from types import TracebackType
from typing import Any

from clacad.base.text import plain
from clacad.storage.errors import CannotWrite

DIGITS = 16
"""Hexadecimal digits of a checksum: 64 bits."""


class OtherStudy(ValueError):
    """The checkpoint holds results of another study, or another process is writing it."""

    exit_status = 3


class Checkpoint:
    """Records 0, 1, 2 … of a study, stored in a file; use as a context manager.

    Parameters
    ----------
    path : path or None
        None stores nothing.
    header : mapping
        Identity of the records; a file with another header is refused.

    Attributes
    ----------
    records : list
        Records found in the file when it was opened.

    Raises
    ------
    OtherStudy, CannotWrite
    """

    def __init__(self, path: str | os.PathLike[str] | None, header: Mapping[str, Any]) -> None:
        self.path = None if path is None else Path(path)
        self.header = dict(header)
        self.records: list[Any] = []
        self._handle = -1
        self._sum = "0" * DIGITS

    def __enter__(self) -> Checkpoint:
        if self.path is None:
            return self
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self._handle = os.open(self.path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
        except OSError as error:
            raise CannotWrite(f"{self.path}: {error.strerror}") from error
        try:
            self._resume(self.path)
        except BaseException:
            os.close(self._handle)
            self._handle = -1
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._handle >= 0:
            os.close(self._handle)
            self._handle = -1

    def _resume(self, path: Path) -> None:
        """Lock the file for this process, read its valid prefix, and truncate the rest."""
        try:
            fcntl.flock(self._handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            raise OtherStudy(f"{path}: another process is writing it") from error
        with open(self._handle, "rb", closefd=False) as stream:
            found, good = self._read(stream.read())
        if not found and good:
            raise OtherStudy(f"{path}: not a checkpoint")
        header = plain(self.header, _word)
        if found and found[0] != header:
            other = [k for k in sorted(self.header) if found[0].get(k) != header[k]]
            raise OtherStudy(
                f"{path} holds results of another study ({', '.join(other) or 'more'} differ); take another"
                " folder, or --overwrite to begin again"
            )
        os.ftruncate(self._handle, good)
        os.lseek(self._handle, good, os.SEEK_SET)
        self.records = [_unfolded(record) for record in found[1:]]
        if not found:
            self._write([self.header])

    def _read(self, content: bytes) -> tuple[list[Any], int]:
        """Records of the valid prefix, and its length in bytes. A complete first line of another study: [],
        > 0.
        """
        records: list[Any] = []
        good = 0
        for line in content.splitlines(keepends=True):
            checksum, body = line[:DIGITS].decode("latin-1"), line[DIGITS + 1 :].rstrip(b"\n")
            if not line.endswith(b"\n") or checksum != _checksum(self._sum, body):
                if not records and line.endswith(b"\n"):
                    return [], len(line)
                break
            records.append(json.loads(body))
            self._sum = checksum
            good += len(line)
        return records, good

    def append(self, records: Iterable[Any]) -> None:
        """Append records; they are on the disk when this returns."""
        if self._handle >= 0:
            self._write(records)

    def _write(self, records: Iterable[Any]) -> None:
        lines = []
        for record in records:
            body = json.dumps(
                plain(record, _word), sort_keys=True, separators=(",", ":"), allow_nan=False
            ).encode()
            self._sum = _checksum(self._sum, body)
            lines.append(self._sum.encode() + b" " + body + b"\n")
        data = b"".join(lines)
        try:
            while data:
                data = data[os.write(self._handle, data) :]
            os.fsync(self._handle)
        except OSError as error:
            raise CannotWrite(f"{self.path}: {error.strerror}") from error


def _checksum(before: str, body: bytes) -> str:
    return sha256(before.encode() + body).hexdigest()[:DIGITS]


def _word(number: float) -> str | None:
    """JSON substitute for a number that JSON lacks: null for NaN, a word for an infinity."""
    return None if isnan(number) else repr(number)


def _unfolded(value: Any) -> Any:
    if isinstance(value, dict):
        return {k: _unfolded(v) for k, v in value.items()}
    if isinstance(value, list):
        return [_unfolded(v) for v in value]
    if value is None:
        return nan
    return {"inf": inf, "-inf": -inf}.get(value, value) if isinstance(value, str) else value
