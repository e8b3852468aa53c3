"""Compiled kernels on disk: only what this very program wrote, whole, is ever loaded."""

from __future__ import annotations

import os
import pickle
import random
import subprocess
import sys
import warnings
from collections.abc import Callable
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from typing import Any

import numba
import pytest

from clacad.base import kernel_cache
from clacad.base.kernel_cache import KernelsNotKept, SealedFiles

KERNEL = "from clacad.base.compiled import entry\n\n\n@entry\ndef scaled(x):\n    return {factor} * x\n"
KEY = (("float64",), ("a machine", "x86"), ("digest of a function",))
DATA = {"code": bytes(range(256)) * 2, "name": "scaled"}


@pytest.fixture
def files(tmp_path: Path) -> SealedFiles:
    kept = SealedFiles(str(tmp_path), "module.scaled-4", b"made from these sources")
    kept.save(KEY, DATA)
    return kept


class Bomb:
    """Unpickling it leaves a file."""

    def __init__(self, marker: Path) -> None:
        self.marker = marker

    def __reduce__(self) -> tuple[Callable[..., Any], tuple[Any, ...]]:
        return Path.touch, (self.marker,)


def test_what_was_saved_is_loaded_and_one_file_is_all_there_is(files: SealedFiles, tmp_path: Path) -> None:
    assert files.load(KEY) == DATA
    assert [p.suffix for p in tmp_path.iterdir()] == [".nbc"]
    files.flush()
    assert files.load(KEY) is None


def test_no_bit_may_fall_over_and_no_byte_be_missing(
    files: SealedFiles, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = Path(files.path(KEY))
    good = path.read_bytes()
    monkeypatch.setattr(pickle, "loads", lambda content: pytest.fail("it was unpickled"))
    for at in range(len(good)):
        path.write_bytes(good[:at] + bytes([good[at] ^ 1 << at % 8]) + good[at + 1 :])
        assert files.load(KEY) is None
    for length in range(len(good)):
        path.write_bytes(good[:length])
        assert files.load(KEY) is None
    path.write_bytes(good + b"\0")
    assert files.load(KEY) is None


def test_a_stranger_s_file_is_not_even_unpickled(files: SealedFiles, tmp_path: Path) -> None:
    path, marker = Path(files.path(KEY)), tmp_path / "run"
    bomb = pickle.dumps((KEY, Bomb(marker)))
    for content in (bomb, bytes(32) + bomb, b"", random.Random(0).randbytes(5000)):
        path.write_bytes(content)
        assert files.load(KEY) is None
    other = SealedFiles(str(tmp_path), "module.scaled-4", b"made from other sources")
    other.save(KEY, Bomb(marker))
    assert files.load(KEY) is None
    assert not marker.exists()
    other.load(KEY)
    assert marker.exists(), "the bomb would have gone off"


def test_a_whole_file_is_loaded_only_as_what_it_is(files: SealedFiles, tmp_path: Path) -> None:
    """Files that changed places: between two signatures, and between two functions."""
    whole = (("float32",), *KEY[1:])
    files.save(whole, {"code": b"another"})
    one, two = Path(files.path(KEY)), Path(files.path(whole))
    assert one != two
    one.write_bytes(two.read_bytes())
    assert files.load(KEY) is None
    changed = (*KEY[:2], ("digest of a changed function",))
    assert files.path(changed) == files.path(KEY)
    files.save(KEY, DATA)
    assert files.load(changed) is None
    stranger = SealedFiles(str(tmp_path), "module.other-9", b"made from these sources")
    Path(stranger.path(KEY)).write_bytes(one.read_bytes())
    assert stranger.load(KEY) is None


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() != 0, reason="only root may give files away")
def test_a_file_that_belongs_to_another_user_is_not_opened(files: SealedFiles) -> None:
    os.chown(files.path(KEY), 54321, -1)
    assert files.load(KEY) is None


def test_where_nothing_can_be_written_that_is_said_once_and_nothing_is_left(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", full)
    kernel_cache.tell_not_kept.cache_clear()
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        for name in ("one", "two"):
            SealedFiles(str(tmp_path), name, b"").save(KEY, DATA)
    assert [w.category for w in said] == [KernelsNotKept]
    assert list(tmp_path.iterdir()) == []


# -- with a kernel ------------------------------------------------------------------------------------


def compiled(source: Path) -> Any:
    """The kernel of a file, as a process finds it that has just begun."""
    spec = spec_from_file_location(source.stem, source)
    assert spec is not None
    assert spec.loader is not None
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.scaled


@pytest.fixture
def source(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A file with one kernel, whose compiled code is kept in a folder of its own."""
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path / "kept"))
    path = tmp_path / "tiny.py"
    path.write_text(KERNEL.format(factor=3.0))
    return path


def test_a_kernel_is_compiled_once_for_each_signature_and_again_if_its_file_is_spoiled(source: Path) -> None:
    first = compiled(source)
    assert (first(2.0), sum(first.stats.cache_misses.values())) == (6.0, 1)
    again = compiled(source)
    assert (again(2.0), sum(again.stats.cache_hits.values())) == (6.0, 1)
    (kept,) = (source.parent / "kept").rglob("*.nbc")
    good = kept.read_bytes()
    for spoiled in (good[:-7], good[:900] + b"\xff" + good[901:], b""):
        kept.write_bytes(spoiled)
        healed = compiled(source)
        assert (healed(2.0), sum(healed.stats.cache_hits.values())) == (6.0, 0)
        assert sum(compiled(source).stats.cache_hits.values()) == 0
        assert kept.stat().st_size == len(good)


def test_a_kernel_is_compiled_again_when_any_source_of_kernels_is_another_whatever_the_clock_says(
    source: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert compiled(source)(2.0) == 6.0
    monkeypatch.setattr(kernel_cache, "sources_digest", lambda: b"a callee was changed")
    changed = compiled(source)
    assert (changed(2.0), sum(changed.stats.cache_hits.values())) == (6.0, 0)
    monkeypatch.undo()
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(source.parent / "kept"))
    source.write_text(KERNEL.format(factor=5.0))
    os.utime(source, (0.0, 0.0))
    assert compiled(source)(2.0) == 10.0


@pytest.mark.slow
def test_processes_that_compile_at_once_find_their_own_code(source: Path) -> None:
    """Four processes, two signatures each, in both orders; then all is loaded."""
    code = (
        "import sys; sys.path.insert(0, {folder!r}); import tiny\n"
        "print(*(tiny.scaled(x) for x in {numbers}), sum(tiny.scaled.stats.cache_hits.values()))"
    )
    place = {"NUMBA_CACHE_DIR": str(source.parent / "kept")}

    def started(numbers: str) -> subprocess.Popen[str]:
        line = [sys.executable, "-c", code.format(folder=str(source.parent), numbers=numbers)]
        environment = os.environ | place | {"PYTHONPATH": os.pathsep.join(p for p in sys.path if p)}
        return subprocess.Popen(line, stdout=subprocess.PIPE, text=True, env=environment)

    running = [started(numbers) for numbers in ("[2.0, 2j]", "[2j, 2.0]") * 2]
    told = [process.communicate(timeout=120)[0].split()[:2] for process in running]
    assert told == [["6.0", "6j"], ["6j", "6.0"]] * 2
    assert started("[2.0, 2j]").communicate(timeout=120)[0].split() == ["6.0", "6j", "2"]
    assert len(list((source.parent / "kept").rglob("*.*"))) == 2


def test_kernels_kept_in_a_place_that_packages_share_are_known_for_ours(tmp_path, monkeypatch):
    from numba.core.caching import UserProvidedCacheLocator

    from clacad.doctor import kernel_cache
    from clacad.formats.mesh import compiled_measure

    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    assert kernel_cache() == (tmp_path, [])
    folder = tmp_path / UserProvidedCacheLocator.get_suitable_cache_subpath(compiled_measure.__file__)
    for place, name in (
        (folder, "compiled_measure.add_facets-1.py311.0.nbc"),
        (tmp_path / "other_1", "f.nbc"),
    ):
        place.mkdir()
        (place / name).write_bytes(b"")
    assert [path.name for path in kernel_cache()[1]] == ["compiled_measure.add_facets-1.py311.0.nbc"]
