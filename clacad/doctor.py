"""What this installation can do: packages, kernels, memory, disk, caches; each a finding with a sentence.

A finding fails when clacad cannot do what it promises, warns when it can but slowly or not everything, and is
absent when it concerns an extra that was not installed.
"""

from __future__ import annotations

import os
import platform
import re
import sys
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from hashlib import sha1
from importlib import metadata
from pathlib import Path
from typing import Any, Literal

from clacad.base.text import size_in

State = Literal["ok", "warn", "fail", "absent"]

LEAST_MEMORY = 2_000_000_000
"""Free memory below which OCC is likely to starve, bytes."""

LEAST_SPEED = 10e6
"""Writing speed below which the disk decides how long an export takes, bytes per second."""

PROBE_BYTES = 32 << 20
OCC_SECONDS = 120.0
_REQUIREMENT = re.compile(r"\s*([A-Za-z0-9._-]+)\s*([^;]*?)\s*(?:;\s*extra\s*==\s*['\"]([^'\"]+)['\"]\s*)?\Z")


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """One thing that was looked at.

    topic : packages, kernel, memory, disk, cache, rates, threads, fonts or readers.
    state : "ok", "warn", "fail" or "absent"
    value : float, int or None. What was found; bytes, seconds or bytes per second where it is a number.
    sentence : What it means, and what to do about it if it is not ok.
    """

    topic: str
    name: str
    state: State
    value: str | float | int | None
    sentence: str

    def to_dict(self) -> dict[str, Any]:
        """Return the finding as JSON holds it."""
        return asdict(self)


def examine(folder: str | os.PathLike[str] = ".") -> tuple[Diagnosis, ...]:
    """Look at this installation and at one folder.

    folder : Where files would be written. A private folder of 32 MiB is made there and removed again.
    """
    return (
        *_versions(),
        *_packages(),
        *_occ(),
        *_memory(),
        *_disk(Path(folder)),
        *_cache(),
        *_rates(),
        *_threads(),
        *_fonts(),
        *_readers(),
    )


def sound(findings: tuple[Diagnosis, ...]) -> bool:
    """Return whether nothing failed."""
    return all(finding.state != "fail" for finding in findings)


def _versions() -> Iterator[Diagnosis]:
    from clacad import __version__

    yield Diagnosis("packages", "clacad", "ok", __version__, "")
    old = sys.version_info < (3, 11)
    yield Diagnosis(
        "packages",
        "python",
        "fail" if old else "ok",
        platform.python_version(),
        (
            "3.11 or later is needed"
            if old
            else f"{platform.python_implementation()}, {platform.system()} {platform.machine()}"
        ),
    )


# -- packages ---------------------------------------------------------------------------------------


def _packages() -> Iterator[Diagnosis]:
    """Each package that clacad needs or can use: version found against the versions that will do."""
    for name, bounds, extra in requirements():
        if extra == "test":
            continue
        found = _installed(name)
        wanted = f"{name}{bounds}"
        install = f"pip install '{wanted}'" if extra is None else f"pip install 'clacad[{extra}]'"
        if found is None:
            state: State = "fail" if extra is None else "absent"
            purpose = "needed" if extra is None else f"extra '{extra}'"
            yield Diagnosis("packages", name, state, None, f"not installed ({purpose}): {install}")
        elif not satisfies(found, bounds):
            yield Diagnosis(
                "packages", name, "fail" if extra is None else "warn", found, f"{bounds} is needed: {install}"
            )
        else:
            yield Diagnosis("packages", name, "ok", found, bounds if extra is None else f"extra '{extra}'")


def requirements() -> list[tuple[str, str, str | None]]:
    """Name, version bounds and extra of every package the project names; sorted, needed ones first."""
    try:
        lines = metadata.requires("clacad") or []
    except metadata.PackageNotFoundError:
        lines = _from_checkout()
    found = [(m[1], m[2], m[3]) for m in map(_REQUIREMENT.match, lines) if m]
    return sorted(set(found), key=lambda r: (r[2] is not None, r[2] or "", r[0]))


def _from_checkout() -> list[str]:
    """Requirements of a source tree that was never installed."""
    import tomllib

    try:
        text = (Path(__file__).parents[1] / "pyproject.toml").read_text(encoding="utf-8")
        project = tomllib.loads(text)["project"]
    except (OSError, KeyError, tomllib.TOMLDecodeError):
        return []
    extras = project.get("optional-dependencies", {})
    return [*project["dependencies"], *(f"{r}; extra == '{e}'" for e, rs in extras.items() for r in rs)]


def _installed(name: str) -> str | None:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None


def satisfies(version: str, bounds: str) -> bool:
    """Return whether a version lies within bounds such as ">=1.3,<1.5"; only leading numbers count.

    >>> satisfies("2.10.1", ">=2.9"), satisfies("1.5.0", ">=1.3,<1.5")
    (True, False)
    """
    have = _numbers(version)
    for bound in filter(None, (part.strip() for part in bounds.split(","))):
        match = re.match(r"(>=|<=|==|!=|<|>)\s*(\S+)", bound)
        if match is None:
            continue
        want = _numbers(match[2])
        width = max(len(have), len(want))
        a, b = (n + (0,) * (width - len(n)) for n in (have, want))
        holds = {">=": a >= b, "<=": a <= b, "==": a == b, "!=": a != b, "<": a < b, ">": a > b}
        if not holds[match[1]]:
            return False
    return True


def _numbers(version: str) -> tuple[int, ...]:
    match = re.match(r"\d+(?:\.\d+)*", version)
    return tuple(int(part) for part in match[0].split(".")) if match else ()


# -- kernel, fonts ---------------------------------------------------------------------------------


def probe_occ() -> dict[str, Any]:
    """Load OCC and judge one solid; runs in a worker."""
    from OCP.BRepCheck import BRepCheck_Analyzer
    from OCP.BRepPrimAPI import BRepPrimAPI_MakeBox

    solid = BRepPrimAPI_MakeBox(1.0, 2.0, 3.0).Solid()
    return {"valid": bool(BRepCheck_Analyzer(solid).IsValid())}


def _occ() -> Iterator[Diagnosis]:
    """Whether OCC loads in a process of its own and makes a valid box, and how long that takes."""
    from clacad.storage.errors import ExportError
    from clacad.storage.worker import Worker

    began = time.monotonic()
    try:
        with Worker() as worker:
            found = worker.run("clacad.doctor:probe_occ", timeout=OCC_SECONDS)
    except ExportError as error:
        yield Diagnosis("kernel", "CAD kernel", "fail", None, f"{error}; STEP files cannot be written")
        return
    seconds = round(time.monotonic() - began, 2)
    if found["valid"]:
        yield Diagnosis(
            "kernel", "CAD kernel", "ok", seconds, "loads in a process of its own and builds a solid"
        )
    else:
        yield Diagnosis("kernel", "CAD kernel", "fail", seconds, "loads, but finds its own box invalid")


def _fonts() -> Iterator[Diagnosis]:
    """The one font of plots and reports travels with matplotlib; it is looked for without loading
    matplotlib.
    """
    from importlib.util import find_spec

    spec = find_spec("matplotlib")
    roots = list(spec.submodule_search_locations or []) if spec is not None else []
    for root in roots:
        font = Path(root) / "mpl-data" / "fonts" / "ttf" / "DejaVuSans.ttf"
        if font.is_file():
            yield Diagnosis("fonts", "DejaVu Sans", "ok", str(font), "text of plots and reports")
            return
    yield Diagnosis(
        "fonts",
        "DejaVu Sans",
        "warn",
        None,
        "not found: text in plots falls back to another font, and "
        "pictures are no longer the same bytes as elsewhere",
    )


# -- memory, threads, disk, cache ---------------------------------------------------------------------


def _memory() -> Iterator[Diagnosis]:
    from clacad.storage.worker import free_memory

    free = free_memory()
    low = free < LEAST_MEMORY
    yield Diagnosis(
        "memory",
        "free",
        "warn" if low else "ok",
        free,
        (
            "the CAD kernel may starve: close other programs, or export with fewer --cells"
            if low
            else "exports that would take more than 80 % of it are refused beforehand"
        ),
    )


def _threads() -> Iterator[Diagnosis]:
    from clacad.tracing.compiled.threads import thread_count

    asked = os.environ.get("CLACAD_THREADS")
    try:
        count = thread_count(None)
    except ValueError as error:
        yield Diagnosis("threads", "threads", "fail", asked, str(error))
        return
    origin = "CLACAD_THREADS" if asked else "one for each core; CLACAD_THREADS sets another number"
    yield Diagnosis("threads", "threads", "ok", count, origin)


def _disk(folder: Path) -> Iterator[Diagnosis]:
    """Room in a folder, and how fast a file is written there."""
    from clacad.exporting.limits import free_disk
    from clacad.storage.atomic import Stage, translated
    from clacad.storage.errors import CannotWrite
    from clacad.storage.staging import flush

    if not folder.is_dir():
        yield Diagnosis("disk", "folder", "fail", str(folder), "no such folder")
        return
    free = free_disk(folder)
    full = free < 10 * PROBE_BYTES
    yield Diagnosis("disk", "free", "warn" if full else "ok", free, f"in {folder.absolute()}")
    try:
        with Stage(folder) as stage, translated(folder):
            path = stage.path("speed.bin")
            # not zeros: some disks compress, and nobody writes zeros
            block = os.urandom(1 << 20)
            began = time.monotonic()
            with path.open("wb") as stream:
                for _ in range(min(PROBE_BYTES, free // 4) >> 20):
                    stream.write(block)
            flush(path)
            speed = path.stat().st_size / max(1e-9, time.monotonic() - began)
    except CannotWrite as error:
        yield Diagnosis("disk", "writing", "fail", None, str(error))
        return
    slow = speed < LEAST_SPEED
    yield Diagnosis(
        "disk",
        "writing",
        "warn" if slow else "ok",
        round(speed),
        "bytes per second, flushed" + ("; slow: prefer a local folder" if slow else ""),
    )


def kernel_cache() -> tuple[Path | None, list[Path]]:
    """Folder that compiled kernels are kept in (None: nowhere), and the kernels there.

    The order is that of the compiler: NUMBA_CACHE_DIR, next to the source, the user's own cache.
    """
    beside = Path(__file__).parent / "tracing" / "compiled" / "__pycache__"
    named = os.environ.get("NUMBA_CACHE_DIR")
    home = os.environ.get("XDG_CACHE_HOME") or os.path.join(
        os.path.expanduser("~"), ".cache"
    )  # "~" without one
    for place in (Path(named),) if named else (beside, Path(home) / "numba"):
        if _writable(place):
            ours = [place] if place == beside else [place / name for name in _folders_of_package()]
            return place, sorted(path for folder in ours for path in folder.glob("*.nbc"))
    return None, []


def _folders_of_package() -> list[str]:
    """What the compiler calls the folders of this package's kernels in a place that packages share."""
    home = Path(__file__).resolve().parent
    folders = [
        folder for folder in (home, *home.rglob("*")) if folder.is_dir() and folder.name != "__pycache__"
    ]
    return [
        f"{folder.name}_{sha1(str(folder).encode(), usedforsecurity=False).hexdigest()}" for folder in folders
    ]


def _writable(folder: Path) -> bool:
    place = folder.absolute()
    while not place.exists() and place != place.parent:
        place = place.parent
    return place.is_dir() and os.access(place, os.W_OK | os.X_OK)


def _cache() -> Iterator[Diagnosis]:
    place, kept = kernel_cache()
    if place is None:
        yield Diagnosis(
            "cache",
            "kernels",
            "warn",
            None,
            "no folder for compiled kernels can be written: they are compiled "
            "again by every command; set NUMBA_CACHE_DIR to a folder that can",
        )
        return
    size = sum(path.stat().st_size for path in kept)
    many = (
        f"{len(kept)} compiled, {size_in(size, 'MB')}" if kept else "none yet; the first trace compiles them"
    )
    yield Diagnosis("cache", "kernels", "ok", str(place), many)


def _rates() -> Iterator[Diagnosis]:
    """What forecasts of seconds rest on: the machine's speed, and what each task took here."""
    from clacad.base.machine_rates import MACHINE, REFERENCE, Rates

    took = Rates.here().calibrate()
    rates = Rates.here()
    if rates.path is None or not rates.path.is_file():
        yield Diagnosis(
            "rates",
            "seconds seen",
            "warn",
            None,
            "are not kept: forecasts stay wide; set CLACAD_CACHE_DIR to a folder that can be written",
        )
    else:
        yield Diagnosis(
            "rates", "seconds seen", "ok", str(rates.path), "kept for forecasts; delete it to start again"
        )
    yield Diagnosis(
        "rates", "machine", "ok", round(took / REFERENCE, 2), "times the reference machine's seconds"
    )
    for task, noted in sorted(rates.tasks.items()):
        if task != MACHINE:
            model, last = noted[-1]
            now = rates.span(task, model)
            yield Diagnosis(
                "rates", task, "ok", round(last, 3), f"seconds of the last run of {len(noted)}; again {now}"
            )


def _readers() -> Iterator[Diagnosis]:
    """What each reader takes of a file; one that takes more is refused with exit status 3."""
    from clacad.base.untrusted_files import BUDGETS

    for name, budget in BUDGETS.items():
        said = [budget.files]
        if budget.items is not None:
            said.append(f"{budget.items:,} {budget.item}")
        if budget.seconds is not None:
            said.append(
                f"{budget.seconds:g} s of processor time and {budget.seconds_per_megabyte:g} s more a"
                " megabyte"
            )
        if budget.memory is not None:
            said.append(
                f"{size_in(budget.memory, 'MB', ',.0f')} of memory and {budget.memory_per_byte} bytes more a"
                " byte"
            )
        yield Diagnosis("readers", name, "ok", budget.bytes, "; ".join(said))
