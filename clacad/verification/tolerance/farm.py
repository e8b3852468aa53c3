"""Execution of independent pieces of work with ordered results, and the file that keeps what is done.

Work runs in this process, on this machine's cores, or on a cluster. The local pool needs no further
software. With a scheduler's address the work goes to a running Dask cluster. The results do not depend on
which of them does the work.

Results are appended to a file in which the checksum of every line covers all lines before it. A line is a
checksum, a space and a JSON value. A killed run therefore leaves a prefix of the file of a complete run,
and a truncated, changed or moved line ends the prefix. The first line identifies the study.
"""

from __future__ import annotations

import fcntl
import json
import logging
import os
import signal
import sys
import threading
import warnings
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from hashlib import sha256
from math import inf, isnan, nan
from multiprocessing import active_children, get_context, parent_process
from pathlib import Path
from time import monotonic
from types import ModuleType, TracebackType
from typing import Any, Protocol, cast

from clacad import __version__
from clacad.base.text import plain, whole_number
from clacad.storage.errors import CannotWrite
from clacad.storage.worker import safe_children

Work = Callable[[str, Any], list[Any]]
"""Takes a study as text and a piece of it; a module-level function, which other processes can import."""

PER_WORKER = 3
"""Pieces queued ahead for each worker."""
PULSE = 1.0
"""Seconds between two checks of a cluster with an outstanding result."""
PATIENCE = 30.0
"""Seconds for which a cluster may have no worker: enough to restart one."""


class NoCluster(RuntimeError):
    """The scheduler does not answer, or the package that connects to it is not installed."""

    exit_status = 2


class WorkersLost(RuntimeError):
    """The workers are gone; delivered results are valid, the rest must be computed again."""

    exit_status = 4


class _Promise(Protocol):
    status: str

    def result(self, timeout: float | None = None) -> Any: ...


class _Client(Protocol):
    """Methods used of a Dask client."""

    def nthreads(self) -> dict[str, int]: ...


@dataclass(frozen=True, slots=True)
class Farm:
    """Executor of the work.

    Parameters
    ----------
    workers : int or None
        Processes on this machine; 1: this process itself; None: one per core (or the environment's
        CLACAD_THREADS).
    scheduler : str or None
        Address of a Dask scheduler, such as "tcp://10.0.0.1:8786", used in place of this machine.
    """

    workers: int | None = None
    scheduler: str | None = None

    def run(self, work: Work, study: str, pieces: Sequence[Any]) -> Iterator[list[Any]]:
        """Do `work(study, piece)` for every piece; results are in the order of the pieces.

        Raises
        ------
        NoCluster
            The scheduler does not answer, or the package that connects to it is missing.
        WorkersLost
            A process of this machine died; the scheduler disconnected, or no worker was left.
        """
        if not pieces:
            return
        if self.scheduler is not None:
            yield from _on_cluster(self.scheduler, work, study, pieces)
            return
        count = min(self.workers or cores(), len(pieces))
        if count <= 1:
            for piece in pieces:
                yield work(study, piece)
            return
        yield from _on_cores(count, work, study, pieces)


def cores() -> int:
    """Number of cores this process may use."""
    asked = whole_number(os.environ.get("CLACAD_THREADS", "")) or 0
    return asked if asked > 0 else len(os.sched_getaffinity(0))


def told(work: Work, study: str, piece: Any) -> tuple[str, list[Any]]:
    """The result with the version that computed it, since a cluster may run another version."""
    return __version__, work(study, piece)


def _on_cores(count: int, work: Work, study: str, pieces: Sequence[Any]) -> Iterator[list[Any]]:
    """Results of all pieces, in their order, from `count` processes of this machine."""
    others = {process.pid for process in active_children()}
    with safe_children(), _no_script():  # the pool starts a process that tracks semaphores
        pool = ProcessPoolExecutor(count, mp_context=get_context("spawn"), initializer=_settle)

    def submitted(piece: Any) -> Future[Any]:
        with safe_children(), _no_script():  # the pool starts workers when it gets work
            return pool.submit(told, work, study, piece)

    done = False
    try:
        yield from _in_order(submitted, pieces, count)
        done = True
    except BrokenProcessPool as error:
        raise WorkersLost("a worker process died (out of memory?)") from error
    finally:
        if not done:  # stopped early: end the workers, since the remaining pieces are not needed
            for process in active_children():
                if process.pid not in others:
                    process.kill()
        pool.shutdown(wait=done)


@contextmanager
def _no_script() -> Iterator[None]:
    """Within the block, new processes do not import the caller's script, which would run it again.

    Workers need only functions of the package, so that a script needs no ``if __name__ == "__main__"``.
    """
    script = sys.modules["__main__"]
    sys.modules["__main__"] = ModuleType("__main__")
    try:
        yield
    finally:
        sys.modules["__main__"] = script


def _settle() -> None:
    """Set up a worker: leave Ctrl-C and warnings to the parent, and end when the parent ends in any way."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    warnings.filterwarnings("ignore", message="compiled kernels cannot be kept")
    parent = parent_process()

    def follow() -> None:
        if parent is not None:
            parent.join()
            os._exit(1)

    threading.Thread(target=follow, daemon=True).start()


def _on_cluster(address: str, work: Work, study: str, pieces: Sequence[Any]) -> Iterator[list[Any]]:
    """Results of all pieces, in their order, from the workers of a Dask cluster."""
    try:
        from distributed import Client
    except ImportError as error:
        raise NoCluster("--scheduler needs the package distributed: pip install 'clacad[dask]'") from error
    with ExitStack() as ending:
        ending.enter_context(_hushed())
        try:
            client = ending.enter_context(Client(address, timeout="5s", set_as_default=False))
        except (OSError, ValueError, TimeoutError) as error:
            raise NoCluster(f"no Dask scheduler answers at {address}") from error
        count = max(1, sum(client.nthreads().values()))

        def submit(piece: Any) -> _Promise:
            try:
                return cast(_Promise, client.submit(told, work, study, piece, pure=False))
            except Exception as error:
                raise _gone(address) from error

        yield from _in_order(submit, pieces, count, lambda promise: _awaited(promise, client, address))


def _gone(address: str) -> WorkersLost:
    return WorkersLost(f"the scheduler at {address} was lost")


@contextmanager
def _hushed() -> Iterator[None]:
    """Silence the cluster's own logs; a lost cluster is reported in one sentence."""
    roots = ("distributed", "tornado")
    talking = [
        logger
        for name, logger in logging.root.manager.loggerDict.items()
        if name.partition(".")[0] in roots and isinstance(logger, logging.Logger) and not logger.disabled
    ]
    for logger in talking:
        logger.disabled = True
    try:
        yield
    finally:
        for logger in talking:
            logger.disabled = False


def _awaited(promise: _Promise, client: _Client, address: str) -> Any:
    """Wait for a result of a cluster; errors of the work itself propagate unchanged.

    Raises WorkersLost: The scheduler disconnected, no worker was left for `PATIENCE`, or the piece ended
        every worker that ran it.
    """
    from distributed import KilledWorker

    last = monotonic()
    while True:
        try:
            return promise.result(timeout=PULSE)
        except KilledWorker as error:
            raise WorkersLost("the workers died one after another (out of memory?)") from error
        except Exception as error:
            if promise.status == "error":  # raised by the work
                raise
            if not isinstance(error, TimeoutError):
                raise _gone(address) from error
        try:
            last = monotonic() if client.nthreads() else last
        except Exception as error:
            raise _gone(address) from error
        if monotonic() - last > PATIENCE:
            raise WorkersLost(f"the scheduler at {address} has had no worker for {PATIENCE:.0f} s")


def _taken(promise: _Promise) -> Any:
    return promise.result()


def _in_order(
    submit: Callable[[Any], Any], pieces: Sequence[Any], count: int, taken: Callable[[Any], Any] = _taken
) -> Iterator[list[Any]]:
    """Keep every worker busy, hold only a few results, and yield them in the order of the pieces."""
    waiting: deque[Any] = deque()
    rest = iter(pieces)
    while True:
        for piece in rest:
            waiting.append(submit(piece))
            if len(waiting) >= PER_WORKER * count:
                break
        if not waiting:
            return
        version, result = taken(waiting.popleft())
        if version != __version__:
            raise NoCluster(f"a worker runs clacad {version}, this is {__version__}")
        yield result


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
        """Records of the valid prefix, and its length, bytes. A whole first line of another study: [], >0."""
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
