"""Worker process for native code: a crash becomes an error message, and a deadlock can be ended.

CAD kernels end the process on a full disk, on lack of memory, and ignore Ctrl-C while they compute.
A `Worker` runs named functions in a freshly started interpreter: own process group, own limits, and
results as JSON lines over a pipe that nothing else writes to. The parent waits on that pipe only.

Module path of child processes: it never includes the current folder.
"""

from __future__ import annotations

import json
import os
import pickle
import select
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

import clacad
from clacad.base.text import size_in
from clacad.storage import errors
from clacad.storage.errors import WorkerDied

if TYPE_CHECKING:
    from clacad.base.types import Progress
    from clacad.storage.reading import Spending


def module_path() -> list[str]:
    """Module folders of this process without the current folder; the package's own is appended if missing."""
    path = [entry for entry in sys.path if entry]
    home = os.path.dirname(os.path.dirname(os.path.abspath(clacad.__file__)))
    return path if home in path else [*path, home]


@contextmanager
def safe_children() -> Iterator[None]:
    """Within the block, Python processes started by libraries exclude the current folder from their path."""
    before = os.environ.get("PYTHONSAFEPATH")
    os.environ["PYTHONSAFEPATH"] = "1"
    try:
        yield
    finally:
        if before is None:
            del os.environ["PYTHONSAFEPATH"]
        else:
            os.environ["PYTHONSAFEPATH"] = before


_LONGEST_LINE = 64 << 20
_BOOT = (
    "import json,sys;sys.path[:]=json.loads(sys.argv[1]);from clacad.storage.worker import"
    " serve;serve(int(sys.argv[2]),int(sys.argv[3]),*json.loads(sys.argv[4]))"
)


MEMORY_SHARE = 0.8
"""Share of the free memory that one process may use."""

WAITS, START = 3, 60.0
"""Seconds to wait per second of processor time, and a constant in addition: other programs run too."""


def free_memory() -> int:
    """Bytes of available memory; a container's limit is respected."""
    available = 1 << 62
    try:
        for line in Path("/proc/meminfo").read_text().splitlines():
            if line.startswith("MemAvailable:"):
                available = int(line.split()[1]) * 1024
    except (OSError, ValueError, IndexError):
        if hasattr(os, "sysconf") and "SC_PHYS_PAGES" in os.sysconf_names:
            available = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    try:
        limit = int(Path("/sys/fs/cgroup/memory.max").read_text())
        used = int(Path("/sys/fs/cgroup/memory.current").read_text())
        available = min(available, max(0, limit - used))
    except (OSError, ValueError):
        pass
    return available


def worker_memory() -> int:
    """Address space of a worker, bytes: the free memory, but never less than OCC itself maps."""
    return max(4_000_000_000, int(MEMORY_SHARE * free_memory()))


def limited_worker(spent: Spending) -> Worker:
    """Worker that may read one untrusted file: memory and processor time limited by its reader's budget."""
    most = worker_memory()
    allowed = spent.budget.memory_for(spent.size)
    seconds = spent.budget.seconds_for(spent.size)
    return Worker(memory=most if allowed is None else min(most, allowed), cpu=max(1, int(seconds)))


def longest_wait(spent: Spending) -> float:
    """Seconds after which a worker that has not answered is ended."""
    return START + WAITS * spent.budget.seconds_for(spent.size)


_LIVE: set[int] = set()
"""Process groups of the workers of this process."""


def end_all() -> None:
    """Kill every worker of this process and their children, before this process ends."""
    for group in tuple(_LIVE):
        with suppress(OSError):
            os.killpg(group, signal.SIGKILL)


class Worker:
    """One child process that runs functions named "module:function" and answers in JSON.

    memory : Limit of the address space in bytes.
    cpu : Limit of processor time in seconds.
    preload : Modules to import at once, while the parent still prepares the work.

    Notes
    -----
    The next `run` restarts a dead worker. Use as a context manager: leaving it kills the child and all
    processes that it started.
    """

    def __init__(
        self, memory: int | None = None, cpu: int | None = None, preload: Sequence[str] = ()
    ) -> None:
        self._limits = (memory, cpu)
        self._preload = list(preload)
        self._process: subprocess.Popen[bytes] | None = None
        self._answers = -1
        self._pending = b""
        self._errors: IO[bytes] | None = None
        self._stage = "start"

    def __enter__(self) -> Worker:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    @property
    def pid(self) -> int | None:
        """Process id of the child, None when there is none."""
        return None if self._process is None else self._process.pid

    def start(self) -> None:
        """Start the child now, before there is work for it; returns at once."""
        if self._process is not None:
            return
        read_end, write_end = os.pipe()
        self._errors = _scratch()
        setup = json.dumps([*self._limits, self._preload])
        place = [str(write_end), str(os.getpid())]
        command = [sys.executable, "-P", "-c", _BOOT, json.dumps(module_path()), *place, setup]
        try:
            self._process = subprocess.Popen(
                command,
                stdin=subprocess.PIPE,
                stdout=self._errors,
                stderr=self._errors,
                pass_fds=(write_end,),
                start_new_session=True,
            )
        except OSError as error:
            os.close(read_end)
            self._errors.close()
            what = "the worker process could not be started"
            raise errors.refused_by_system(error, what) or WorkerDied(f"{what}: {error.strerror}") from error
        finally:
            os.close(write_end)
        _LIVE.add(self._process.pid)
        self._answers, self._pending, self._stage = read_end, b"", "start"

    def run(
        self,
        function: str,
        *arguments: Any,
        timeout: float | None = None,
        progress: Progress | None = None,
        **options: Any,
    ) -> Any:
        """Call `function` ("module:name") in the child and return its JSON-able result.

        arguments, options : passed on (pickled: they come from this program, never from a file)
        timeout : seconds after which the child is killed
        progress : receives the stages the function reports through `report_stage`
        Raises WorkerDied: The child crashed, ran out of memory or time, or answered nonsense.
        Raises CannotWrite, LimitRefused, UnreadableFile, OverBudget, FileDisagrees, ExportRefused,
            NotPossible: Raised by the function itself; the last for any other error that has an exit status
            of its own.
        """
        self.start()
        process = self._process
        assert process is not None
        assert process.stdin is not None
        deadline = None if timeout is None else time.monotonic() + timeout
        payload = pickle.dumps((function, arguments, options), protocol=pickle.HIGHEST_PROTOCOL)
        sender = threading.Thread(target=_send, args=(process.stdin, payload), daemon=True)
        answered = False
        try:
            sender.start()
            for message in self._messages(deadline, timeout):
                kind = message.get("kind")
                if kind == "stage":
                    self._stage = str(message.get("name"))
                    if progress is not None:
                        progress(self._stage, float(message.get("done", "nan")))
                elif kind in ("result", "error"):
                    answered = True
                    return _unwrapped(message)
                else:
                    raise self._died("answered nonsense")
        finally:
            if not answered:
                self.stop()
        raise AssertionError("unreachable: the stream of messages ends with an exception")

    def stop(self) -> None:
        """Kill the child and its process group; harmless when there is none."""
        process, self._process = self._process, None
        if process is None:
            return
        with suppress(ProcessLookupError, PermissionError):
            os.killpg(process.pid, signal.SIGKILL)
        _LIVE.discard(process.pid)
        if process.stdin is not None:
            with suppress(OSError):
                process.stdin.close()
        if process.returncode is None:
            process.wait()
        os.close(self._answers)
        if self._errors is not None:
            self._errors.close()

    def _messages(self, deadline: float | None, timeout: float | None) -> Iterator[dict[str, Any]]:
        """The child's messages as they arrive; raises at the deadline (monotonic s) or before."""
        while True:
            line, newline, rest = self._pending.partition(b"\n")
            if newline:
                self._pending = rest
                yield self._parsed(line)
                continue
            left = None if deadline is None else deadline - time.monotonic()
            if left is not None and left <= 0.0:
                raise self._died(f"did not finish within {timeout:g} s and was ended", over_budget=True)
            ready, _, _ = select.select([self._answers], [], [], left)
            if not ready:
                continue
            block = os.read(self._answers, 1 << 20)
            if not block:
                raise self._buried()
            self._pending += block
            if len(self._pending) > _LONGEST_LINE:
                raise self._died("answered nonsense without end")

    def _parsed(self, line: bytes) -> dict[str, Any]:
        try:
            message = json.loads(line)
        except (ValueError, RecursionError):
            message = None
        if not isinstance(message, dict):
            raise self._died("answered nonsense")
        return message

    def _died(self, what: str, *, over_budget: bool = False) -> WorkerDied:
        sentence = f"the worker process {what} (stage: {self._stage})"
        return WorkerDied(sentence, self._last_words(), over_budget=over_budget)

    def _buried(self) -> WorkerDied:
        """Error for a closed pipe: wait for the child and read its exit status and peak memory."""
        process = self._process
        assert process is not None
        peak = 0
        try:
            _, status, usage = os.wait4(process.pid, 0)
            process.returncode = os.waitstatus_to_exitcode(status)
            peak = usage.ru_maxrss * (1 if sys.platform == "darwin" else 1024)
        except ChildProcessError:
            process.wait()
        words = self._last_words()
        sentence, limited = _cause(process.returncode or 0, peak, self._limits, self._stage, words)
        return WorkerDied(sentence, words, over_budget=limited)

    def _last_words(self) -> str:
        if self._errors is None:
            return ""
        size = self._errors.seek(0, os.SEEK_END)
        self._errors.seek(max(0, size - 4000))
        return self._errors.read().decode("utf-8", "replace")


def _cause(
    status: int, peak: int, limits: tuple[int | None, int | None], stage: str, words: str
) -> tuple[str, bool]:
    """Reason why a process ended, as a sentence, and whether a limit was the reason.

    peak : bytes; limits : (bytes, seconds of processor time)
    """
    memory, cpu = limits
    at = f" at about {size_in(peak, 'GB')}" if peak else ""
    limit = "" if memory is None else f" (limit {size_in(memory, 'GB')})"
    starved = memory is not None and (peak > 0.5 * memory or _wanted_memory(words))
    if status == -signal.SIGXCPU or (status == -signal.SIGKILL and cpu is not None and not starved):
        return f"the worker process used up its {cpu} s of processor time (stage: {stage})", True
    if starved and status != 0:
        return f"the worker process ran out of memory{at}{limit} (stage: {stage})", True
    if status == -signal.SIGKILL:
        return f"the worker process was killed{at}, most likely for lack of memory (stage: {stage})", False
    if status < 0:
        plain = {int(signal.SIGSEGV): "a segmentation fault", int(signal.SIGABRT): "an abort"}
        name = plain.get(-status) or signal.Signals(-status).name
        return f"the worker process crashed with {name}{at}{limit} (stage: {stage})", False
    return f"the worker process ended with status {status} without a result (stage: {stage})", False


def _wanted_memory(words: str) -> bool:
    """Whether the last lines of a process show that it ran out of memory."""
    signs = ("bad_alloc", "MemoryError", "cannot allocate memory", "failed to map segment")
    return any(sign.lower() in words.lower() for sign in signs)


def _scratch() -> IO[bytes]:
    """File for the child's error stream, in memory where the system supports it."""
    if hasattr(os, "memfd_create"):
        return os.fdopen(os.memfd_create("clacad-worker"), "w+b")
    return tempfile.TemporaryFile()


def _send(stream: IO[bytes], payload: bytes) -> None:
    with suppress(OSError, ValueError):  # a dead child: the reading side reports it
        stream.write(len(payload).to_bytes(8, "little") + payload)
        stream.flush()


_OWN_ERRORS = (
    "CannotWrite",
    "ExportRefused",
    "LimitRefused",
    "UnreadableFile",
    "FileDisagrees",
    "NotPossible",
    "OverBudget",
)


def _unwrapped(message: dict[str, Any]) -> Any:
    if message["kind"] == "result":
        return message.get("value")
    name, text = str(message.get("type")), str(message.get("text"))
    if name in _OWN_ERRORS:
        raise getattr(errors, name)(text)
    if name == "MemoryError" or _wanted_memory(text):
        sentence = f"the worker process ran out of memory {text}".rstrip()
        raise WorkerDied(sentence, str(message.get("trace")), over_budget=True)
    raise WorkerDied(f"the worker process failed: {name}: {text}", str(message.get("trace")))


ENDING = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))

AGAIN = 0.02
"""Seconds after which a dropped interruption is raised again."""


@contextmanager
def ended_by_signals() -> Iterator[None]:
    """Raise KeyboardInterrupt on SIGTERM and SIGHUP within the block, so that clean-up runs as for Ctrl-C.

    Applies only in the main thread and to signals with the default handler. Python drops an exception raised
    in a destructor or in a weak-reference callback, which every import runs at its end. An interruption
    dropped there is raised again after `AGAIN` seconds.
    """
    taken: dict[int, Any] = {}
    if threading.current_thread() is threading.main_thread():
        for number in ENDING:
            if signal.getsignal(number) in (signal.SIG_DFL, signal.default_int_handler):
                taken[number] = signal.signal(number, _interrupt)
    hook = sys.unraisablehook
    if taken:
        one = next(iter(taken))
        sys.unraisablehook = lambda lost: _again(one) if lost.exc_type is KeyboardInterrupt else hook(lost)
    try:
        yield
    finally:
        if taken:
            sys.unraisablehook = hook
        for number, handler in taken.items():
            signal.signal(number, handler)


def _interrupt(*_: object) -> None:
    raise KeyboardInterrupt


def _again(number: int) -> None:
    """Interrupt the main thread from another thread, after the code that dropped the exception has ended."""
    timer = threading.Timer(AGAIN, _signal_main_thread, (number,))
    timer.daemon = True
    timer.start()


def _signal_main_thread(number: int) -> None:
    main = threading.main_thread().ident
    if signal.getsignal(number) is not _interrupt or main is None:
        return
    if hasattr(signal, "pthread_kill"):  # wakes the thread if it waits
        signal.pthread_kill(main, number)
    else:
        signal.raise_signal(number)


# -- the child's side ------------------------------------------------------------------------
_answer_stream: IO[bytes] | None = None


def report_stage(name: str, done: float = float("nan")) -> None:
    """Report the current stage to the parent; does nothing outside a worker."""
    if _answer_stream is not None:
        _answer({"kind": "stage", "name": name, "done": done})


def serve(answers: int, parent: int, memory: int | None, cpu: int | None, preload: Sequence[str]) -> None:
    """Run the child: limits, preloading, then one call after another until the parent goes away."""
    global _answer_stream  # the one pipe of this process; native code cannot reach it through stdout
    _die_with_parent(parent)
    _answer_stream = os.fdopen(answers, "wb", buffering=0)
    import resource
    from importlib import import_module

    if memory is not None:
        _limit(resource.RLIMIT_AS, memory, memory)
    if cpu is not None:
        _limit(resource.RLIMIT_CPU, cpu, cpu + 1)
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    for module in preload:
        with suppress(ImportError, MemoryError):  # the call that needs it reports the failure
            import_module(module)
    requests = sys.stdin.buffer
    while len(head := requests.read(8)) == 8:
        _answer(_called(pickle.loads(requests.read(int.from_bytes(head, "little")))))


def _limit(kind: int, soft: int, hard: int) -> None:
    """Limit this process; a lower limit set by the user stays, since only the system may raise it."""
    import resource

    most = resource.getrlimit(kind)[1]
    if most != resource.RLIM_INFINITY:
        soft, hard = min(soft, most), min(hard, most)
    resource.setrlimit(kind, (soft, hard))


def _called(request: tuple[str, tuple[Any, ...], dict[str, Any]]) -> dict[str, Any]:
    """Answer to one call: a message with its result or its exception."""
    import traceback
    from importlib import import_module

    name, arguments, options = request
    module, _, function = name.partition(":")
    try:
        value = getattr(import_module(module), function)(*arguments, **options)
        return {"kind": "result", "value": value}
    except OSError as error:
        text = f"{error.filename or function}: {(error.strerror or str(error)).lower()}"
        return {"kind": "error", "type": "CannotWrite", "text": text, "trace": traceback.format_exc()}
    except Exception as error:  # a failure of any type must reach the parent as a message
        text = str(error).strip().partition("\n")[0][:500]
        status = getattr(error, "exit_status", None)  # an error that has one is meant for the user
        name = (
            type(error).__name__ if status is None or type(error).__name__ in _OWN_ERRORS else "NotPossible"
        )
        return {"kind": "error", "type": name, "text": text, "trace": traceback.format_exc()}


def _answer(message: dict[str, Any]) -> None:
    assert _answer_stream is not None
    data = json.dumps(message).encode() + b"\n"
    view = memoryview(data)
    while view:
        view = view[_answer_stream.write(view) :]


def _die_with_parent(parent: int) -> None:
    """Arrange that the end of the parent ends this process, even inside a native call (Linux)."""
    if sys.platform.startswith("linux"):
        import ctypes

        with suppress(OSError, AttributeError):
            ctypes.CDLL(None).prctl(1, signal.SIGKILL, 0, 0, 0)  # 1 = PR_SET_PDEATHSIG
    if os.getppid() != parent:  # the parent died before the line above
        os._exit(0)
