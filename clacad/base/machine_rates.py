"""Run times measured on this machine, kept in the user's cache, and forecasts computed from them.

A task's seconds are first modelled from its size with the constants of one reference machine. The seconds the
task took, divided by the modelled seconds, are recorded. The next forecast is the model times the recorded
ratio of tasks of about its size. Only messages and forecasts read the cache file; no written byte depends on
it. A file that is missing, broken or not writable only widens the forecast.
"""

from __future__ import annotations

import json
import math
import os
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path

from clacad.base.text import span_text
from clacad.base.untrusted_files import read_regular

FORMAT = 1
KEPT = 12
"""Observations kept per task, the newest; older ones describe another state of the machine."""

LEAST = 0.02
"""Seconds below which a run is not recorded: the clock and first calls dominate the work."""

MOST_BYTES = 200_000
UNSEEN = math.log(2.5)
"""Half width (natural logarithm) of a forecast for a task never run here: how much machines differ."""

OTHERS_SEEN = math.log(1.7)
"""Half width (natural logarithm) where the machine's speed is known from other tasks only."""

SEEN = math.log(1.28)
"""Least half width (natural logarithm): runs of one task on one machine differ by this factor."""

FAR = 0.12
"""Half width added per factor e between the requested size and the nearest recorded size."""

Clock = Callable[[], float]
Noted = tuple[float, float]
"""Modelled seconds and measured seconds."""


@dataclass(frozen=True, slots=True)
class Span:
    """A forecast: seconds as a range.

    low, high : processor seconds
    seen : Number of recorded runs of this task on this machine.
    """

    low: float
    high: float
    seen: int = 0

    @property
    def middle(self) -> float:
        """Geometric mean of low and high, seconds."""
        return math.sqrt(self.low * self.high)

    def __str__(self) -> str:
        """Return the range as text: "12–20 s", "3–5 min"."""
        return span_text(self.low, self.high)


def total(spans: Sequence[Span]) -> Span:
    """Range of several tasks in sequence; `seen` is that of the task seen least."""
    return Span(
        sum(s.low for s in spans), sum(s.high for s in spans), min((s.seen for s in spans), default=0)
    )


@dataclass(frozen=True, eq=False)
class Rates:
    """Recorded run times of tasks on one machine.

    path : Cache file; None keeps nothing.
    tasks : mapping of task to a sequence of (modelled, taken) seconds, oldest first
    """

    path: Path | None = None
    tasks: Mapping[str, tuple[Noted, ...]] = field(default_factory=dict)

    @classmethod
    def here(cls) -> Rates:
        """Rates of this machine, this version and this number of threads."""
        folder = cache_folder()
        if folder is None:
            return cls()
        path = folder / f"rates-{machine_key()}.json"
        return cls(path, _read(path))

    def span(self, task: str, modelled: float) -> Span:
        """Forecast the time of a task from its modelled seconds (> 0)."""
        noted = self.tasks.get(task, ())
        if not noted:
            others = [math.log(took / model) for rows in self.tasks.values() for model, took in rows]
            factor, width = (_median(others), OTHERS_SEEN) if others else (0.0, UNSEEN)
            return _around(modelled, factor, width, 0)
        distance = [abs(math.log(modelled / model)) for model, _ in noted]
        factors = [math.log(took / model) for model, took in noted]
        newest = len(noted) - 1
        weights = [0.85 ** (newest - k) / (0.2 + d) ** 2 for k, d in enumerate(distance)]
        factor = _median(factors, weights)
        spread = _median([abs(f - factor) for f in factors], weights)
        width = max(SEEN, 1.5 * spread) + FAR * min(distance)
        return _around(modelled, factor, min(width, UNSEEN), len(noted))

    def note(self, task: str, modelled: float, took: float) -> None:
        """Record the time of a task; do nothing where the cache cannot be written."""
        if self.path is None or not (_positive(modelled) and _positive(took)) or took < LEAST:
            return
        tasks = dict(_read(self.path))  # another process may have recorded a run since
        tasks[task] = (*tasks.get(task, ()), (float(modelled), float(took)))[-KEPT:]
        _write(self.path, tasks)

    @contextmanager
    def noting(self, task: str, modelled: float, clock: Clock | None = None) -> Iterator[None]:
        """Record the processor seconds of the block, unless it raises."""
        tick = clock or processor_seconds
        began = tick()
        yield
        self.note(task, modelled, tick() - began)

    def calibrate(self, clock: Clock | None = None) -> float:
        """Time a fixed piece of work (best of 3) and record it: forecasts of tasks never run here use it."""
        tick = clock or time.process_time
        best = math.inf
        for _ in range(3):
            began = tick()
            _reference_work()
            best = min(best, tick() - began)
        self.note(MACHINE, REFERENCE, best)
        return best


def _around(modelled: float, factor: float, width: float, seen: int) -> Span:
    return Span(modelled * math.exp(factor - width), modelled * math.exp(factor + width), seen)


def _median(values: Sequence[float], weights: Sequence[float] | None = None) -> float:
    """Weighted median: one outlier among several runs does not count."""
    each = [1.0] * len(values) if weights is None else list(weights)
    order = sorted(range(len(values)), key=lambda k: values[k])
    half, below = 0.5 * sum(each), 0.0
    for k in order:
        below += each[k]
        if below >= half:
            return values[k]
    return values[order[-1]]


def _positive(value: object) -> bool:
    return isinstance(value, (int, float)) and math.isfinite(value) and value > 0.0


# -- the clock -------------------------------------------------------------------------------------


def processor_seconds() -> float:
    """Processor seconds of this process and its ended children: the cost of work at any load."""
    used = os.times()
    return used.user + used.system + used.children_user + used.children_system


def processor_seconds_now() -> float:
    """`processor_seconds` plus those of children that still run, where the system reports them."""
    running = 0.0
    with suppress(OSError, ValueError):
        for listed in Path("/proc/self/task").glob("*/children"):
            running += sum(seconds_of(int(pid), 0.0) for pid in listed.read_text().split())
    return processor_seconds() + running


def seconds_of(pid: int | None, otherwise: float) -> float:
    """Processor seconds of a running process so far; `otherwise` where the system does not report them."""
    with suppress(OSError, ValueError, IndexError, AttributeError):
        text = Path(f"/proc/{pid}/stat").read_text()
        fields = text.rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
    return otherwise


# -- the machine and its file ----------------------------------------------------------------------


def cache_folder() -> Path | None:
    """Folder of the user's cache; CLACAD_CACHE_DIR names another; empty disables the cache."""
    named = os.environ.get("CLACAD_CACHE_DIR")
    if named is not None:
        return Path(named) if named else None
    with suppress(RuntimeError):  # no home folder
        if sys.platform == "win32":
            return Path(os.environ.get("LOCALAPPDATA") or Path.home() / "AppData" / "Local") / "clacad"
        if sys.platform == "darwin":
            return Path.home() / "Library" / "Caches" / "clacad"
        return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "clacad"
    return None


def machine() -> dict[str, str]:
    """Facts that rates depend on: version, processor, cores, requested threads."""
    import platform

    from clacad import __version__

    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return {
        "version": __version__,
        "processor": _processor(),
        "cores": str(cores),
        "threads": os.environ.get("CLACAD_THREADS", ""),
        "python": platform.python_version(),
    }


def _processor() -> str:
    import platform

    with suppress(OSError):
        for line in Path("/proc/cpuinfo").read_text(errors="replace").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()


def machine_key() -> str:
    """Short name of the machine, for a file name."""
    from hashlib import sha256

    return sha256(json.dumps(machine(), sort_keys=True).encode()).hexdigest()[:16]


def _read(path: Path) -> dict[str, tuple[Noted, ...]]:
    """Observations of a file; none where it is missing, too large or malformed."""
    try:
        found = json.loads(read_regular(path, MOST_BYTES))
    except (OSError, ValueError, RecursionError):
        return {}
    if (
        not isinstance(found, dict)
        or found.get("format") != FORMAT
        or not isinstance(found.get("tasks"), dict)
    ):
        return {}
    kept: dict[str, tuple[Noted, ...]] = {}
    for task, rows in found["tasks"].items():
        good = [
            (float(row[0]), float(row[1]))
            for row in (rows if isinstance(rows, list) else ())
            if isinstance(row, list) and len(row) == 2 and all(map(_positive, row))
        ]
        if good:
            kept[str(task)] = tuple(good[-KEPT:])
    return kept


def _write(path: Path, tasks: Mapping[str, tuple[Noted, ...]]) -> None:
    """Replace the file by a complete one, or leave it as it is."""
    import secrets

    text = json.dumps({"format": FORMAT, "machine": machine(), "tasks": tasks}, indent=1, sort_keys=True)
    draft = path.with_name(f"{path.name}.{os.getpid()}-{secrets.token_hex(4)}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        draft.write_text(text, encoding="utf-8")
        os.replace(draft, path)
    except OSError:
        with suppress(OSError):
            draft.unlink()


# -- the machine's speed ----------------------------------------------------------------------------

MACHINE = "machine"
REFERENCE = 0.033
"""Processor seconds of `_reference_work` on the reference machine of the models."""


def _reference_work() -> int:
    """Dictionary, float and text work, similar to most exports."""
    kept: dict[str, float] = {}
    for k in range(60_000):
        kept[f"{k % 997} {k * 0.1!r}"] = math.sqrt(k) / (k + 1.0)
    return len(kept)
