"""Reading of untrusted paths: regular files only, within the budget of each reader.

Only regular files are opened, so that no read blocks. One table has the limits of each reader: bytes, items
and processor seconds. Readers enforce them (`clacad.storage.reading`) and `clacad doctor` prints them.

Libraries that read a settings file of the current folder are imported without it. numba reads
`.numba_config.yaml` there, which can name the folder that compiled code is loaded from; matplotlib reads
`matplotlibrc`, which changes pictures.
"""

from __future__ import annotations

import os
import stat
import sys
from collections.abc import Mapping
from contextlib import chdir, nullcontext
from dataclasses import dataclass
from errno import EFBIG, EINVAL
from importlib import import_module
from math import inf
from types import MappingProxyType, ModuleType
from typing import IO, TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    import numpy as np

KINDS: Final = (
    (stat.S_ISFIFO, "a pipe"),
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
    (stat.S_ISSOCK, "a socket"),
    (stat.S_ISDIR, "a folder"),
)
"""File types other than a regular file that a path may name."""


def require_regular(path: str | os.PathLike[str]) -> None:
    """Refuse a path that names no regular file, without opening it: opening a pipe would block.

    Raises OSError: The path does not exist, may not be inspected, or names another file type; `strerror`
        describes it.
    """
    _refuse_other(os.stat(path).st_mode, os.fspath(path))


def read_regular(path: str | os.PathLike[str], most: int) -> bytes:
    """Read a whole regular file.

    most : Limit in bytes; a larger file is refused unread.
    Raises OSError: As `require_regular`; errno EFBIG where the file is larger than `most`.
    """
    require_regular(path)
    descriptor = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
    with os.fdopen(descriptor, "rb") as stream:
        found = os.fstat(descriptor)  # the opened file, even if the path names another one by now
        _refuse_other(found.st_mode, os.fspath(path))
        data = stream.read(most + 1) if found.st_size <= most else b""
    if found.st_size > most or len(data) > most:
        raise OSError(EFBIG, f"it has more than {most} bytes", os.fspath(path))
    return data


def _refuse_other(mode: int, name: str) -> None:
    if not stat.S_ISREG(mode):
        kind = next((words for is_so, words in KINDS if is_so(mode)), "something else")
        raise OSError(EINVAL, f"it is {kind}, not a file", name)


MEGABYTE = 1_000_000
GIGABYTE = 1000 * MEGABYTE


@dataclass(frozen=True, slots=True)
class Budget:
    """Limits of one reader.

    files : Files it reads, in words.
    bytes : Size of the file; for a packed file also the unpacked size.
    items : Most items of the kind `item` in one file; None where a library reads the file and counts nothing.
    item : Kind of the counted items, in the plural.
    seconds : Processor seconds that reading any file may take. None where bytes and items limit the time,
        because the file is read in one go or row by row as it is used.
    seconds_per_megabyte : Additional processor seconds per megabyte of the file.
    memory : int or None, bytes
        Address space of the reading process, for a reader that runs in its own process.
    memory_per_byte : Additional bytes of address space per byte of the file.
    """

    files: str
    bytes: int
    items: int | None
    item: str
    seconds: float | None = 60.0
    seconds_per_megabyte: float = 2.0
    memory: int | None = None
    memory_per_byte: int = 0

    def seconds_for(self, size: int) -> float:
        """Processor seconds that a file of `size` bytes may take; infinite where there is no limit."""
        if self.seconds is None:
            return inf
        return self.seconds + self.seconds_per_megabyte * size / MEGABYTE

    def memory_for(self, size: int) -> int | None:
        """Address space in bytes for reading a file of `size` bytes; None where there is no limit."""
        return None if self.memory is None else self.memory + self.memory_per_byte * size


BUDGETS: Mapping[str, Budget] = MappingProxyType(
    {
        "stl": Budget("binary STL", 20 * GIGABYTE, 400_000_000, "facets", seconds_per_megabyte=0.5),
        "stl-ascii": Budget("ASCII STL", GIGABYTE, 20_000_000, "facets"),
        "3mf": Budget("3MF, unpacked", GIGABYTE, 60_000_000, "vertices, triangles and components"),
        "ply": Budget(
            "binary PLY", 10 * GIGABYTE, 100_000_000, "vertices and facets", 60.0, 0.5, 3 * GIGABYTE, 10
        ),
        "ply-ascii": Budget("ASCII PLY", GIGABYTE, 100_000_000, "numbers", 60.0, 2.0, 3 * GIGABYTE, 30),
        "glb": Budget("GLB", 4 * GIGABYTE, 500_000_000, "vertices, corners and places"),
        "obj": Budget("OBJ", GIGABYTE, 20_000_000, "vertices, normals and triangles"),
        "step": Budget("STEP, by the CAD kernel", 24 * MEGABYTE, None, "", 120.0, 20.0, 3 * GIGABYTE, 100),
        "step-text": Budget(
            "STEP, by its text", 4 * GIGABYTE, 100_000_000, "statements", 120.0, 4.0, 3 * GIGABYTE, 20
        ),
        "brep": Budget("BREP, by the CAD kernel", 200 * MEGABYTE, None, "", 120.0, 20.0, 3 * GIGABYTE, 100),
        "tiff": Budget("height maps (TIFF)", 5 * GIGABYTE, 1 << 30, "pixels", None),
        "png": Budget("height maps (PNG)", 2 * GIGABYTE, 1 << 29, "pixels"),
        "points": Budget(
            "points with or without normals (xyz)",
            10 * GIGABYTE,
            100_000_000,
            "points",
            seconds_per_megabyte=4.0,
        ),
        "topography": Budget(
            "height maps of instruments (X3P, SDF, NPY, TIFF, PNG)",
            GIGABYTE,
            1 << 27,
            "points",
            memory=3 * GIGABYTE,
            memory_per_byte=40,
        ),
        "grid-sag": Budget("grid sag (dat)", 200 * MEGABYTE, 4_100_000, "nodes", seconds_per_megabyte=4.0),
        "pose-table": Budget(
            "tables of poses (CSV)", 4 * GIGABYTE, 40_000_000, "lines", seconds_per_megabyte=8.0
        ),
        "calibration": Budget("calibrations of doses (CSV)", 4 * MEGABYTE, 65_536, "levels", None),
        "surface-table": Budget("tables of surfaces and heights (JSON)", 64 * MEGABYTE, None, "", None),
        "mask": Budget("masks (SVG, DXF)", GIGABYTE, 20_000_000, "places and points"),
        "gds": Budget(
            "masks of grey levels (GDSII)",
            10 * GIGABYTE,
            1_000_000_000,
            "records",
            120.0,
            20.0,
            3 * GIGABYTE,
            100,
        ),
        "prescription": Budget("sequential prescriptions (ZMX)", MEGABYTE, 20_000, "lines"),
        "rays": Budget("rays (npz), unpacked", 80 * GIGABYTE, 1_000_000_000, "rays", None),
        "picture": Budget(
            "pictures (PNG, JPEG, WebP, TIFF, BMP, GIF)", 500 * MEGABYTE, 1 << 27, "pixels", None
        ),
        "outline": Budget("outlines of plates (DXF)", 8 * MEGABYTE, 1_000_000, "lines", None),
        "design": Budget("designs and scenes (TOML, JSON)", 1 << 20, 200_000, "lines and keys", None),
        "cell-table": Budget("tables of cells (CSV, NPZ)", GIGABYTE, 10_000_000, "cells", None),
        "manifest": Budget("manifests (JSON)", 16 << 20, 20_000, "files", None),
    }
)
"""Reader → its limits.

Limits of bytes and items are the same on every machine; seconds are many times the need of a legitimate file.
"""


SETTINGS = {"numba": ".numba_config.yaml", "matplotlib": "matplotlibrc"}
"""Library → settings file that it looks for."""


def without_settings(library: str) -> ModuleType:
    """Import a library of `SETTINGS`; a library imported before keeps the settings it has read.

    The current folder changes during the import, but only where it contains such a file.
    """
    if library in sys.modules:
        return import_module(library)
    hidden = os.path.lexists(SETTINGS[library])
    with chdir(os.path.dirname(__file__)) if hidden else nullcontext():
        module = import_module(library)
    if library == "numba":
        module.core.config._config_fname = ""  # numba looks again at each compilation
        _without_blas()
    return module


def _without_blas() -> None:
    """Let numba load SciPy's linear algebra (.3 s) with the first kernel that uses it, not with any."""
    linalg: Any = import_module("numba.np.linalg")
    check = linalg.ensure_blas

    def ensure() -> None:
        if hasattr(sys.modules.get("numba.np.arraymath"), "_HAVE_BLAS"):  # else it is being loaded
            check()

    linalg.ensure_blas = ensure


def array_head(stream: IO[bytes]) -> tuple[tuple[int, ...], bool, np.dtype[Any]]:
    """Shape, Fortran order and type of the array of an .npz archive that follows in the stream.

    Raises ValueError: The stream holds no such header; the message is one line.
    """
    import re
    from tokenize import TokenError

    from numpy.lib import format as npy

    from clacad.base.text import array_lengths, printable

    try:
        version = npy.read_magic(stream)
        read = npy.read_array_header_1_0 if version == (1, 0) else npy.read_array_header_2_0
        shape, fortran, kind = read(stream)
    except (ValueError, TypeError, SyntaxError, MemoryError, TokenError) as error:
        said = re.sub(
            r" on line \d+: <ast\.[^>]*>", "", str(error).partition("\n")[0]
        )  # an address differs from run to run
        raise ValueError(printable(said)[:160]) from None
    lengths = array_lengths(shape)
    if lengths is None:
        raise ValueError(f"its shape is {printable(str(shape))[:80]}, not whole numbers >= 0")
    return lengths, bool(fortran), kind
