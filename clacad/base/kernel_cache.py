"""Compiled kernels on disk, sealed: what was cut, changed or left there by others is compiled again, never loaded.

The compiler's own cache unpickles what it finds and runs the machine code in it, so a bit that fell over is a wrong
direction or a crash, and a file of another function or version is, too. Here each compiled signature is one file: a
checksum over where it stands, what it was made from, and its content. There is no index that two processes could
leave disagreeing with the files. Whoever may write to this user's files can forge a seal, but also the sources beside it;
files that belong to other users are not opened.
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

from clacad.base.foreign_settings import without_settings

numba = without_settings("numba")
FunctionCache: Any = numba.core.caching.FunctionCache

SOURCES = (
    "tracing/reference/*.py", "tracing/triangles/*.py", "tracing/layout.py", "tracing/ledger.py", "**/*compiled*.py", "**/compiled/*.py",
    "optics/*.py", "optics/surface/*.py", "sheet/window.py", "sheet/edge_columns.py", "rendering/scene_arrays.py",
)  # fmt: skip
"""Files that kernels are made of: their own, and those whose constants are compiled in."""

SEAL = 32
"""Bytes of the checksum at the head of a file."""

PACKAGE = Path(__file__).parent.parent


class KernelsNotKept(UserWarning):
    """No folder for compiled kernels can be written to."""


@cache
def sources_digest() -> bytes:
    """Digest of all kernel sources: a kernel keeps the callees it was compiled with, so each hangs on all of them."""
    digest = sha256(numba.__version__.encode())
    for path in sorted({path for pattern in SOURCES for path in PACKAGE.glob(pattern)}):
        digest.update(
            path.relative_to(PACKAGE).as_posix().encode() + b"\0" + sha256(path.read_bytes()).digest()
        )
    return digest.digest()


class SealedFiles:
    """Files of the compiled signatures of one function.

    Parameters
    ----------
    folder : str
    name : str
        What the names of its files begin with.
    stamp : bytes
        What compiled code of this function hangs on besides its signature.
    """

    def __init__(self, folder: str, name: str, stamp: bytes) -> None:
        self._folder, self._name, self._stamp = folder, name, stamp

    def path(self, key: Any) -> str:
        """Where a signature is kept; `key`: (signature, machine, digests of the function)."""
        told = sha256(repr(key[:2]).encode()).hexdigest()[:16]
        return os.path.join(self._folder, f"{self._name}.{told}.nbc")

    def load(self, key: Any) -> Any:
        """What was saved under this very key, None where nothing whole is found."""
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
        """Whether a whole file stands where such a signature is kept."""
        path = self.path(key)
        with suppress(OSError), open(path, "rb") as stream:
            if _trusted(stream.fileno()):
                return stream.read(SEAL) == self._seal(path, stream.read())
        return False

    def save(self, key: Any, data: Any) -> None:
        """Keep compiled code; where it cannot be written that is said once, and it is compiled again next time."""
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
        """Forget every signature of this function."""
        for path in Path(self._folder).glob(f"{self._name}.*.nbc"):
            path.unlink(missing_ok=True)

    def _seal(self, path: str, content: bytes) -> bytes:
        digest = sha256(self._stamp + os.path.basename(path).encode() + b"\0")
        digest.update(content)
        return digest.digest()


def _trusted(descriptor: int) -> bool:
    """Whether an open file is of this user, of root, or of the owner of this package."""
    if not hasattr(os, "geteuid"):
        return True
    return os.fstat(descriptor).st_uid in (os.geteuid(), 0, os.stat(__file__).st_uid)


class SealedCache(FunctionCache):  # type: ignore[misc]
    """The compiler's cache of one function, over sealed files.

    Raises
    ------
    RuntimeError
        No folder can be written to.
    """

    def __init__(self, function: Callable[..., Any]) -> None:
        super().__init__(function)
        stamp = sources_digest() + repr(self._impl.locator.get_source_stamp()).encode()
        self._cache_file = SealedFiles(self._cache_path, self._impl.filename_base, stamp)


def keep(kernel: Any) -> Any:
    """Let a kernel that was declared, not yet compiled, keep what will be compiled of it; return it."""
    if numba.config.DISABLE_JIT:  # it is the plain function
        return kernel
    try:
        kernel._cache = SealedCache(kernel.py_func)
    except RuntimeError:  # the compiler found no folder it may write to
        tell_not_kept()
    return kernel


def is_kept(kernel: Any, arguments: tuple[Any, ...]) -> bool:
    """Whether code for arguments of these types is on disk, so that calling the kernel loads and does not compile it."""
    cached = getattr(kernel, "_cache", None)
    if not isinstance(cached, SealedCache):
        return False
    types = tuple(kernel.typeof_pyval(argument) for argument in arguments)
    return cached._cache_file.holds((types, kernel.targetctx.codegen().magic_tuple()))


@cache
def tell_not_kept() -> None:
    """Warn, once, that kernels are compiled again by every process."""
    text = "compiled kernels cannot be kept: they are compiled again each time; set NUMBA_CACHE_DIR to a folder that can be written"
    warnings.warn(text, KernelsNotKept, stacklevel=2)
