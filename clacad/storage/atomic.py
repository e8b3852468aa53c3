"""Atomic writer of all files: a final name holds either the old file or the complete new one.

Files are written into a private folder `.clacad-<pid>-<start>-<random>` inside the target folder,
flushed to the disk, read back by the caller's own check, and only then renamed. A set of files is sealed by
renaming the complete `manifest.json` inside the private folder, or an empty file where there is no manifest.
If this process dies after sealing, the next writer into the folder finishes the publication. If it dies
before sealing, the next writer removes the remains.
"""

from __future__ import annotations

import json
import os
import re
import secrets
import shutil
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from clacad.base.untrusted_files import read_regular
from clacad.storage.errors import CannotWrite, ExportRefused, OverBudget, refused_by_system
from clacad.storage.reading import Overheard, Spending
from clacad.storage.staging import BUSY, OLD, Unfinished, exchange, flush, undisturbed

MANIFEST = "manifest.json"
RUN_FACTS = "run.json"
_SEALED = "sealed-manifest.json"
_SEALED_SET = "sealed-set"
_PRIVATE = re.compile(r"\.clacad-(\d+)-(\d+)-[0-9a-f]+\Z")
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._+-]{0,199}\Z")


def safe_name(text: str) -> str:
    """Turn a design's name into a file name: letters, digits, '.', '_', '+', '-', at most 100 of them.

    >>> safe_name("../Größe 1")
    'Gr-e-1'
    """
    name = re.sub(r"[^A-Za-z0-9._+]+", "-", text).strip("-.")[:100].strip("-.")
    name = name.lstrip("_+")
    return name if _NAME.match(name) else "sheet"


def file_hash(path: Path) -> str:
    """SHA-256 of a file, hexadecimal; memory is one megabyte."""
    return Overheard(path).hexdigest()


def read_manifest(folder: Path, name: str = MANIFEST) -> dict[str, Any] | None:
    """Read the manifest of `folder`; None if no export wrote one.

    Raises OverBudget: The manifest has more bytes, or lists more files, than its budget.
    """
    try:
        spent = Spending("manifest", folder / name)
        found = json.loads(read_regular(folder / name, spent.budget.bytes))
    except OverBudget:
        raise
    except (OSError, ValueError, RecursionError):
        return None
    if not isinstance(found, dict) or found.get("format") != 1 or not isinstance(found.get("files"), list):
        return None
    spent.count(len(found["files"]))
    return found


_OPEN: set[Path] = set()
"""Private folders of this process."""


def abandon_all() -> None:
    """Remove the private folders of this process before it ends, after any publication in progress."""
    with suppress(RuntimeError):
        if BUSY.acquire(timeout=10.0):
            for private in tuple(_OPEN):
                if not _sealed(private):
                    shutil.rmtree(private, ignore_errors=True)


class Stage:
    """Private folder whose files become visible all together, or not at all.

    Use as a context manager: any exit from the block removes the private folder.

    folder : Final folder of the files. Made if missing. A symbolic link to a folder is followed.
    overwrite : Whether files that are in no manifest of clacad may be replaced.
    Raises CannotWrite: The folder cannot be made or written to.
    """

    def __init__(self, folder: str | os.PathLike[str], overwrite: bool = False) -> None:
        self.folder = Path(folder)
        self.overwrite = overwrite
        self._private: Path | None = None
        self._lock: int | None = None
        self._torn = False
        self._found: dict[str, tuple[int, ...] | None] = {}
        self._replaceable: set[str] = set()

    def __enter__(self) -> Stage:
        with translated(self.folder):
            if self.folder.exists() and not self.folder.is_dir():
                raise CannotWrite(f"{self.folder} is a file; a folder is needed there")
            self.folder.mkdir(parents=True, exist_ok=True)
            self.folder = self.folder.resolve()
            sweep(self.folder)
            self._found = {MANIFEST: _identity(self.folder / MANIFEST)}
            self._private = self.folder / _private_name()
            _OPEN.add(self._private)
            try:
                self._private.mkdir(mode=0o700)
                self._lock = _locked(self._private)
            except BaseException:
                self.__exit__()
                raise
        return self

    def __exit__(self, *_: object) -> None:
        if self._private is not None:
            if not self._torn:
                shutil.rmtree(self._private, ignore_errors=True)
            _OPEN.discard(self._private)
        if self._lock is not None:
            os.close(self._lock)
        self._private = self._lock = None

    def path(self, name: str, *, replace: bool = False) -> Path:
        """Private path at which to write the file with the final name `name`.

        replace : Whether a file of that name may be replaced, regardless of its writer.
        Raises CannotWrite: The name is not a plain file name, or the existing file may not be replaced
            (ExportRefused).
        """
        assert self._private is not None, "a Stage is used inside its with block"
        if not _NAME.match(name):
            raise CannotWrite(f"{name!r} is not a file name this program writes")
        self._found.setdefault(name, _identity(self.folder / name))
        if replace:
            self._replaceable.add(name)
        self._may_replace(name)
        return self._private / name

    def written(self) -> list[Path]:
        """Files in the private folder."""
        return [] if self._private is None else sorted(self._private.iterdir())

    def _may_replace(self, name: str) -> None:
        """Refuse to overwrite a folder, or a file that no export of clacad wrote."""
        target = self.folder / name
        if not os.path.lexists(target):
            return
        if target.is_dir() and not target.is_symlink():
            raise CannotWrite(f"{target} is a folder; the file {name} cannot take its place")
        if self.overwrite or name in self._replaceable:
            return
        if target.is_symlink():
            raise ExportRefused(
                f"{target} is a symbolic link that no export made; remove it or ask to overwrite"
            )
        with _publishing(self.folder):  # between a publication's files and its manifest nothing owns them
            manifest = read_manifest(self.folder)
            own = manifest is not None and (name in (MANIFEST, RUN_FACTS) or owns(manifest, target))
            if own or not os.path.lexists(target):
                return
        raise ExportRefused(
            f"{target} exists and is not (or no longer) what an export wrote there; "
            "choose another folder, move the file away, or ask to overwrite"
        )

    def publish(
        self, manifest: Mapping[str, Any] | None = None, extra: Mapping[str, Any] | None = None
    ) -> None:
        """Make every file in the private folder visible; the manifest comes last.

        manifest : written as `manifest.json`; None publishes the files alone
        extra : run facts, written as `run.json`, outside the promise of equal bytes
        """
        assert self._private is not None, "a Stage is used inside its with block"
        with translated(self.folder):
            if extra is not None:
                self._write_json(self.path(RUN_FACTS), extra)
            names = sorted(p.name for p in self._private.iterdir())
            for name in names:
                flush(self._private / name)
            if manifest is None and len(names) < 2:  # one file is renamed by one system call
                with undisturbed(), _publishing(self.folder):
                    self._refuse_rivals(names)
                    exchange(self._private, self.folder, names, [])
                    flush(self.folder)
                return
            draft, seal = self._private / "draft", _SEALED_SET
            if manifest is None:
                draft.touch()
            else:
                draft, seal = self.path(MANIFEST), _SEALED
                self._write_json(draft, manifest)
            flush(draft)
            flush(self._private)
            with undisturbed(), _publishing(self.folder):
                self._refuse_rivals(names if manifest is None else [MANIFEST, *names])
                os.replace(draft, self._private / seal)  # from here on a killed publication is finished later
                flush(self._private)
                self._torn = True
                try:
                    _finish(self._private, self.folder)
                    self._torn = False
                except Unfinished:
                    raise
                except OSError:
                    self._torn = False
                    raise

    def _refuse_rivals(self, names: Iterable[str]) -> None:
        """Refuse to overwrite files that appeared since this stage began; called under the folder's lock.

        Replacement of foreign files may be requested. The manifest of a faster export may not be replaced:
        files that it lists would be lost.
        """
        for name in names:
            target = self.folder / name
            kept = name == MANIFEST or not (self.overwrite or name in self._replaceable)
            if kept and self._found.get(name) != _identity(target):
                raise ExportRefused(
                    f"{target} was written by another program meanwhile: what it wrote stays, and nothing of"
                    " this was published; do it again, or choose another folder"
                )

    @staticmethod
    def _write_json(path: Path, value: Mapping[str, Any]) -> None:
        path.write_text(canonical_json(value), encoding="utf-8", newline="\n")


def canonical_json(value: Mapping[str, Any]) -> str:
    """JSON text with sorted keys, a unique form of each number, no NaN, and a final newline."""
    return json.dumps(value, sort_keys=True, indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def require_writable(path: str | os.PathLike[str], *, overwrite: bool = False) -> None:
    """Check before long work that a file can be written after it; nothing is left behind.

    Raises CannotWrite, ExportRefused: As `write_file` would.
    """
    path = Path(path)
    require_folder(path.parent)
    Stage(path.parent, overwrite=overwrite)._may_replace(path.name)


def require_folder(folder: str | os.PathLike[str]) -> None:
    """Check before long work that a folder can be made or written to; nothing is made. Raises CannotWrite."""
    place = Path(folder).absolute()
    while not os.path.lexists(place):
        place = place.parent
    with translated(Path(folder)):
        if not place.is_dir():
            raise CannotWrite(f"{place} is a file; a folder is needed there")
        sweep(place)
        probe = place / _private_name()  # the next run removes it if this process dies here
        probe.mkdir(mode=0o700)
        with suppress(FileNotFoundError):  # another machine removed it as abandoned
            probe.rmdir()


def write_file(
    path: str | os.PathLike[str],
    write: Callable[[Path], None],
    *,
    overwrite: bool = False,
    check: Callable[[Path], None] | None = None,
) -> None:
    """Write one file atomically.

    path : Final name; its folder is made if missing.
    write : callable(Path). Writes the file at the given private path.
    overwrite : Whether an existing file may be replaced.
    check : callable(Path) or None
        Reads the private file back; if it raises, the file at the final name is unchanged.
    Raises CannotWrite, ExportRefused.
    """
    path = Path(path)
    with Stage(path.parent, overwrite=overwrite) as stage:
        private = stage.path(path.name)
        with translated(path):
            write(private)
        flush(private)
        if check is not None:
            check(private)
        stage.publish()


def write_content(path: str | os.PathLike[str], content: str | bytes, *, overwrite: bool = False) -> None:
    """Write a text (UTF-8, unchanged) or bytes as one file, atomically; see `write_file`.

    Raises CannotWrite, ExportRefused.
    """
    write_file(path, lambda private: _write(private, content), overwrite=overwrite)


def _write(private: Path, content: str | bytes) -> None:
    # bytes of a file name that are not valid text are escaped
    private.write_bytes(content.encode(errors="backslashreplace") if isinstance(content, str) else content)


def write_set(
    folder: str | os.PathLike[str],
    contents: Mapping[str, str | bytes],
    *,
    overwrite: bool = False,
    replace: Callable[[Path], bool] = lambda _: False,
) -> None:
    """Write several files into one folder: all of them appear, or none.

    folder : Made if missing.
    contents : mapping of file name to text (UTF-8, unchanged) or bytes
    overwrite : Whether existing files may be replaced.
    replace : callable(Path) -> bool
        Whether an individual existing file may be replaced although `overwrite` is False.
    Raises CannotWrite, ExportRefused.
    """
    with Stage(folder, overwrite=overwrite) as stage, translated(stage.folder):
        for name, content in contents.items():
            _write(stage.path(name, replace=replace(stage.folder / name)), content)
        stage.publish()


@contextmanager
def scratch_folder(file: Path | None = None) -> Iterator[Path]:
    """Yield a private folder for temporary files; it is removed at the end, remains of dead processes first.

    file : File that the work reads. If it is staged, the folder lies in its stage, since an export writes
        nothing outside its own folder; otherwise it lies in the system's folder for temporary files.
    Raises CannotWrite.
    """
    staged = file is not None and _PRIVATE.match(file.parent.name) is not None
    place = file.parent if file is not None and staged else Path(tempfile.gettempdir())
    own: int | None = None
    private = place / _private_name()
    _OPEN.add(private)
    try:
        with translated(place):
            for left, lock in _abandoned(place):  # removed, never published: any user may write there
                shutil.rmtree(left, ignore_errors=True)
                os.close(lock)
            private.mkdir(mode=0o700)
            own = _locked(private)
        yield private
    finally:
        shutil.rmtree(private, ignore_errors=True)
        _OPEN.discard(private)
        if own is not None:
            os.close(own)


def owns(manifest: Mapping[str, Any], target: Path) -> bool:
    """Whether `target` is identical, byte for byte, to a file that this manifest lists."""
    for entry in manifest["files"]:
        if isinstance(entry, dict) and entry.get("name") == target.name:
            try:
                same_size = target.stat().st_size == entry.get("bytes")
                return same_size and file_hash(target) == entry.get("sha256")
            except OSError:
                return False
    return False


def sweep(folder: Path) -> None:
    """Finish or remove the remains of dead processes in `folder`.

    The files of a sealed private folder were all read back: they are published. Other private folders are
    removed.
    """
    for private, lock in _abandoned(folder):
        try:
            if _sealed(private):
                with _publishing(folder):
                    _finish(private, folder)
            shutil.rmtree(private, ignore_errors=True)
        finally:
            os.close(lock)


def _abandoned(folder: Path) -> Iterator[tuple[Path, int]]:
    """Private folders of dead processes, each with the lock now held on it.

    Folders of other users, of living processes (same id and start time), and folders locked by a process on
    another machine are skipped.
    """
    for private in sorted(folder.glob(".clacad-*")):
        match = _PRIVATE.match(private.name)
        if not match or private.is_symlink() or not private.is_dir():
            continue
        if _alive(int(match[1]), int(match[2]), private):
            continue
        try:
            lock = _locked(private)
        except (PermissionError, FileNotFoundError):  # another user's; gone meanwhile
            continue
        if lock is not None:
            yield private, lock


def _sealed(private: Path) -> bool:
    """Whether the publication of a private folder was begun and must be finished."""
    return any((private / seal).is_file() for seal in (_SEALED, _SEALED_SET))


def _finish(private: Path, folder: Path) -> None:
    """Carry out a sealed publication; may be repeated after any interruption.

    The caller holds the folder's lock. The old manifest is removed first, so that no manifest covers a
    mixture of two exports. A set without a manifest leaves the manifest of another export in the folder
    unchanged.
    """
    if (private / _SEALED_SET).exists():
        names = sorted(
            p.name for p in private.iterdir() if p.name != _SEALED_SET and not p.name.startswith(OLD)
        )
        exchange(private, folder, names, [])
        flush(folder)
        return
    gone = [MANIFEST] if os.path.lexists(folder / MANIFEST) else []
    gone += _dropped(private, folder)
    names = sorted(p.name for p in private.iterdir() if p.name != _SEALED and not p.name.startswith(OLD))
    exchange(private, folder, names, gone, (_SEALED, MANIFEST))
    flush(folder)


def _identity(path: Path) -> tuple[int, ...] | None:
    """Identity that distinguishes a file from its replacement; None where there is no file."""
    try:
        found = os.lstat(path)
    except FileNotFoundError:
        return None
    return found.st_dev, found.st_ino, found.st_size, found.st_mtime_ns


@contextmanager
def _publishing(folder: Path) -> Iterator[None]:
    """Hold the folder's lock, so that two exports into one folder publish in sequence."""
    lock = _locked(folder, wait=True)
    try:
        yield
    finally:
        if lock is not None:
            os.close(lock)


def _dropped(private: Path, folder: Path) -> list[str]:
    """Names of unchanged files of the previous export that the new one does not list, to be removed."""
    old = read_manifest(folder) or read_manifest(private, OLD + MANIFEST)
    if old is None:
        return []
    sealed = json.loads((private / _SEALED).read_text(encoding="utf-8"))
    kept = {entry["name"] for entry in sealed["files"]}
    names = [e["name"] for e in old["files"] if isinstance(e, dict) and isinstance(e.get("name"), str)]
    plain = [folder / name for name in names if name not in kept and _NAME.match(name) and name != MANIFEST]
    return [path.name for path in plain if path.is_file() and not path.is_symlink() and owns(old, path)]


@contextmanager
def translated(path: Path) -> Iterator[None]:
    """Turn an OSError inside the block into a `CannotWrite` whose message names the path and the cause."""
    try:
        yield
    except OSError as error:
        place = error.filename if isinstance(error.filename, str) else str(path)
        place = re.sub(r"/\.clacad-[0-9a-f-]+", "", place)
        what = f"cannot write {place}"
        why = (error.strerror or str(error)).lower()
        raise refused_by_system(error, what) or CannotWrite(f"{what}: {why}") from error


# -- whose private folder is it --------------------------------------------------------------


def _private_name() -> str:
    """Name of a private folder, which identifies its process."""
    return f".clacad-{os.getpid()}-{_start_time(os.getpid())}-{secrets.token_hex(6)}"


def _start_time(pid: int) -> int:
    """Start time of a process in clock ticks since boot; 0 where the system does not report it."""
    try:
        stat = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8", errors="replace")
    except OSError:
        return 0
    # The command name may hold spaces and brackets: fields count from the last bracket.
    return int(stat.rpartition(")")[2].split()[19])


def _alive(pid: int, started: int, private: Path) -> bool:
    if os.name != "posix":  # no harmless way to find out: a day-old folder counts as abandoned
        with suppress(OSError):
            return time.time() - private.stat().st_mtime < 86400.0
        return True
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        pass
    now = _start_time(pid)
    return now == 0 or now == started


def _locked(folder: Path, wait: bool = False) -> int | None:
    """Lock a folder for as long as the returned descriptor is open; None if another holds it.

    The lock separates machines or containers that share a disk, where process ids are meaningless.
    """
    if sys.platform == "win32":
        return os.open(os.devnull, os.O_RDONLY)
    import fcntl

    descriptor = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX if wait else fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(descriptor)
        return None
    except OSError:
        return descriptor  # file system without locks: only the process id is checked
    return descriptor
