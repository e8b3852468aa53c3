"""Many independent pieces of work: here, on the cores of this machine, or on a cluster; results in order.

The local pool needs nothing else to run. With a scheduler's address the same work goes to a running Dask cluster.
Which of them did it cannot be told from the results.
"""

from __future__ import annotations

import os
import signal
import threading
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from multiprocessing import active_children, get_context, parent_process
from typing import Any, Protocol

from clacad import __version__

Work = Callable[[str, Any], list[Any]]
"""Takes a study as text and a piece of it; a function of a module, so that other processes find it."""

PER_WORKER = 3
"""Pieces handed out ahead to each worker."""


class NoCluster(RuntimeError):
    """The scheduler, or the package that talks to it, is not there."""

    exit_status = 2


class Broken(RuntimeError):
    """A worker died."""

    exit_status = 70


class _Promise(Protocol):
    def result(self) -> Any: ...


@dataclass(frozen=True, slots=True)
class Farm:
    """Where work is done.

    Parameters
    ----------
    workers : int or None
        Processes on this machine; 1: this process itself; None: one a core (or the environment's CLACAD_THREADS).
    scheduler : str or None
        Address of a Dask scheduler, such as "tcp://10.0.0.1:8786", instead.
    """

    workers: int | None = None
    scheduler: str | None = None

    def run(self, work: Work, study: str, pieces: Sequence[Any]) -> Iterator[list[Any]]:
        """Do `work(study, piece)` for every piece; results come in the order of the pieces.

        Raises
        ------
        NoCluster
            The scheduler does not answer, or the package to speak with it is missing.
        Broken
            A worker died.
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
    """Cores this process may use."""
    asked = os.environ.get("CLACAD_THREADS", "")
    return int(asked) if asked.isdigit() and int(asked) > 0 else len(os.sched_getaffinity(0))


def told(work: Work, study: str, piece: Any) -> tuple[str, list[Any]]:
    """The result with the version that made it: a cluster may run another."""
    return __version__, work(study, piece)


def _on_cores(count: int, work: Work, study: str, pieces: Sequence[Any]) -> Iterator[list[Any]]:
    """Results of all pieces, in their order, from so many processes of this machine."""
    others = {process.pid for process in active_children()}
    pool = ProcessPoolExecutor(count, mp_context=get_context("spawn"), initializer=_settle)
    done = False
    try:
        yield from _in_order(lambda piece: pool.submit(told, work, study, piece), pieces, count)
        done = True
    except BrokenProcessPool as error:
        raise Broken(
            "a worker process died (out of memory?); the same command again goes on from there"
        ) from error
    finally:
        if not done:  # stopped on the way: nobody waits for pieces that nobody will take
            for process in active_children():
                if process.pid not in others:
                    process.kill()
        pool.shutdown(wait=done)


def _settle() -> None:
    """In a worker: leave Ctrl-C to the parent, and end when the parent ends, however it ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = parent_process()

    def follow() -> None:
        if parent is not None:
            parent.join()
            os._exit(1)

    threading.Thread(target=follow, daemon=True).start()


def _on_cluster(address: str, work: Work, study: str, pieces: Sequence[Any]) -> Iterator[list[Any]]:
    try:
        from distributed import Client
    except ImportError as error:
        raise NoCluster("--scheduler needs the package distributed: pip install 'clacad[dask]'") from error
    try:
        client = Client(address, timeout="5s", set_as_default=False)
    except (OSError, ValueError, TimeoutError) as error:
        raise NoCluster(f"no Dask scheduler answers at {address}") from error
    with client:
        count = max(1, sum(client.nthreads().values()))
        yield from _in_order(lambda piece: client.submit(told, work, study, piece, pure=False), pieces, count)


def _in_order(
    submit: Callable[[Any], Future[Any] | _Promise], pieces: Sequence[Any], count: int
) -> Iterator[list[Any]]:
    """Keep every worker busy, never hold more than a few results, give them in the order of the pieces."""
    waiting: deque[Any] = deque()
    rest = iter(pieces)
    while True:
        for piece in rest:
            waiting.append(submit(piece))
            if len(waiting) >= PER_WORKER * count:
                break
        if not waiting:
            return
        version, result = waiting.popleft().result()
        if version != __version__:
            raise NoCluster(f"a worker runs clacad {version}, this is {__version__}")
        yield result
