"""Compiled kernels on disk, sealed: a truncated, changed or foreign file is compiled again, never loaded.

The compiler's own cache unpickles any file it finds and runs the machine code in it. A flipped bit, or a file
of another function or version, gives a wrong direction or a crash. Here each compiled signature is one file
with a checksum over its name, its sources and its content. There is no index that two processes could leave
inconsistent with the files. A program that may write this user's files can forge a seal, but could also
change the sources next to it. Files that belong to other users are not loaded.
"""

from __future__ import annotations

import os
import pickle
import warnings
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from hashlib import sha256
from pathlib import Path
from secrets import token_hex
from typing import Any

from clacad.base.untrusted_files import without_settings

numba = without_settings("numba")
FunctionCache: Any = numba.core.caching.FunctionCache

SOURCES = (
    "tracing/reference/*.py",
    "tracing/facets/*.py",
    "tracing/layout.py",
    "light/sums.py",
    "**/*compiled*.py",
    "**/compiled/*.py",
    "base/hashing.py",
    "base/kernel_cache.py",
    "optics/*.py",
    "optics/surface/*.py",
    "sheet/window.py",
    "sheet/edge_columns.py",
    "rendering/scene_arrays.py",
)
"""Source files of kernels: the kernels' own, and those whose constants are compiled in."""

SEAL = 32
"""Bytes of the checksum at the start of a file."""

PACKAGE = Path(__file__).parent.parent


class KernelsNotKept(UserWarning):
    """No folder for compiled kernels can be written to."""


@cache
def sources_digest() -> bytes:
    """Digest of all kernel sources: a kernel contains its callees, so each kernel depends on all sources."""
    digest = sha256(numba.__version__.encode())
    for path in sorted({path for pattern in SOURCES for path in PACKAGE.glob(pattern)}):
        digest.update(
            path.relative_to(PACKAGE).as_posix().encode() + b"\0" + sha256(path.read_bytes()).digest()
        )
    return digest.digest()


class SealedFiles:
    """Cache files of the compiled signatures of one function.

    name : Prefix of the names of its files.
    stamp : bytes. What compiled code of this function depends on besides its signature.
    """

    def __init__(self, folder: str, name: str, stamp: bytes) -> None:
        self._folder, self._name, self._stamp = folder, name, stamp

    def path(self, key: Any) -> str:
        """Path of the file of a signature; `key`: (signature, machine, digests of the function)."""
        told = sha256(repr(key[:2]).encode()).hexdigest()[:16]
        return os.path.join(self._folder, f"{self._name}.{told}.nbc")

    def load(self, key: Any) -> Any:
        """Data saved under exactly this key; None where no intact file is found."""
        path = self.path(key)
        with suppress(OSError), open(path, "rb") as stream:
            if not _trusted(stream.fileno()):
                return None
            seal, content = stream.read(SEAL), stream.read()
            if seal == self._seal(path, content):
                kept, data = pickle.loads(content)
                return data if kept == key else None
        return None

    def holds(self, key: Any) -> bool:
        """Whether an intact file exists at the path of such a signature."""
        path = self.path(key)
        with suppress(OSError), open(path, "rb") as stream:
            if _trusted(stream.fileno()):
                return stream.read(SEAL) == self._seal(path, stream.read())
        return False

    def save(self, key: Any, data: Any) -> None:
        """Save compiled code; a folder that cannot be written causes one warning, and compiling each time."""
        path = self.path(key)
        content = numba.core.serialize.dumps((key, data))
        draft = f"{path}.{token_hex(8)}"
        try:
            with open(draft, "wb") as stream:
                stream.write(self._seal(path, content) + content)
            os.replace(draft, path)
        except OSError:
            with suppress(OSError):
                os.unlink(draft)
            tell_not_kept()

    def flush(self) -> None:
        """Delete every signature of this function."""
        for path in Path(self._folder).glob(f"{self._name}.*.nbc"):
            path.unlink(missing_ok=True)

    def _seal(self, path: str, content: bytes) -> bytes:
        digest = sha256(self._stamp + os.path.basename(path).encode() + b"\0")
        digest.update(content)
        return digest.digest()


def _trusted(descriptor: int) -> bool:
    """Whether an open file belongs to this user, to root, or to the owner of this package."""
    if not hasattr(os, "geteuid"):
        return True
    return os.fstat(descriptor).st_uid in (os.geteuid(), 0, os.stat(__file__).st_uid)


class SealedCache(FunctionCache):  # type: ignore[misc]
    """The compiler's cache of one function, stored in sealed files.

    Raises RuntimeError: No folder can be written to.
    """

    def __init__(self, function: Callable[..., Any]) -> None:
        super().__init__(function)
        stamp = sources_digest() + repr(self._impl.locator.get_source_stamp()).encode()
        self._cache_file = SealedFiles(self._cache_path, self._impl.filename_base, stamp)


def keep(kernel: Any) -> Any:
    """Enable the cache of a kernel that was declared but not yet compiled; return the kernel."""
    if numba.config.DISABLE_JIT:  # the kernel is the plain function
        return kernel
    try:
        kernel._cache = SealedCache(kernel.py_func)
    except RuntimeError:  # the compiler found no writable folder
        tell_not_kept()
    return kernel


def is_kept(kernel: Any, arguments: tuple[Any, ...]) -> bool:
    """Whether code for arguments of these types is on disk, so that a call loads it instead of compiling."""
    cached = getattr(kernel, "_cache", None)
    if not isinstance(cached, SealedCache):
        return False
    types = tuple(kernel.typeof_pyval(argument) for argument in arguments)
    return cached._cache_file.holds((types, kernel.targetctx.codegen().magic_tuple()))


@cache
def tell_not_kept() -> None:
    """Warn, once, that every process compiles its kernels again."""
    text = (
        "compiled kernels cannot be kept: they are compiled again each time; set NUMBA_CACHE_DIR to a folder"
        " that can be written"
    )
    warnings.warn(text, KernelsNotKept, stacklevel=2)
