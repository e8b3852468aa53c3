"""Files of rays for other programs: .npz archives, read in chunks and written with fixed dates."""

from __future__ import annotations

import zipfile
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

from clacad.base.text import printable
from clacad.base.untrusted_files import array_head, require_regular

if TYPE_CHECKING:
    import numpy as np

    from clacad.optics.rays import TraceResult

COLUMNS = ("position", "direction", "fate", "optical_path", "cell", "order", "surface", "flux")
"""Arrays of a file of results."""

DAMAGED = (zipfile.BadZipFile, zlib.error, RuntimeError, NotImplementedError, EOFError, OSError)
"""Errors of a zip file that is cut, changed, encrypted or packed in an unknown way."""


class BadRays(ValueError):
    """A file that holds no rays; exit status 2."""

    exit_status = 2


class RayFile:
    """Rays in an .npz archive, read in chunks whether or not the archive is compressed.

    Raises BadRays: It is no such archive, an array is missing or has the wrong shape or type.
    Raises OverBudget: More bytes or rays than are read.
    """

    def __init__(self, path: Path) -> None:
        from clacad.storage.archive import open_archive
        from clacad.storage.errors import OverBudget, UnreadableFile
        from clacad.storage.reading import Spending

        try:
            require_regular(path)
            spent = Spending("rays", path)
            self._archive = open_archive(path, spent, streamed=True)
        except OverBudget:
            raise
        except UnreadableFile as error:
            raise BadRays(f"{error}: not an .npz archive of rays") from None
        except OSError as error:
            raise BadRays(f"{path}: {(error.strerror or 'cannot be read').lower()}") from None
        names = {name.removesuffix(".npy"): name for name in self._archive.namelist()}
        for needed in ("position", "direction"):
            if needed not in names:
                raise BadRays(
                    f"{path} holds no array '{needed}'; it needs position (n, 3) and direction (n, 3)"
                )
        self._members: dict[str, str] = {
            key: names[key] for key in ("position", "direction", "wavelength") if key in names
        }
        lengths = {key: self._opened(key)[2] for key in self._members}
        if len(set(lengths.values())) > 1:
            counts = ", ".join(f"{key} {count}" for key, count in lengths.items())
            raise BadRays(f"{path}: the arrays differ in length: {counts}")
        self.count = lengths["position"]
        spent.count(self.count)

    def _opened(self, key: str) -> tuple[IO[bytes], np.dtype[Any], int]:
        """Stream at the first row, type, number of rows."""
        try:
            stream = self._archive.open(self._members[key])
            shape, fortran, kind = array_head(stream)
        except (*DAMAGED, ValueError) as error:
            why = printable(str(error).partition("\n")[0])[:160]
            raise BadRays(f"{self._archive.filename}: array '{key}': {why}") from None
        wanted = 1 if key == "wavelength" else 2
        good = len(shape) == wanted and (wanted == 1 or shape[1] == 3) and not (fortran and wanted == 2)
        if not good or shape[0] < 0 or kind.kind not in "fiu":
            form = "(n,)" if wanted == 1 else "(n, 3), C order"
            raise BadRays(
                f"{self._archive.filename}: '{key}' is {shape} of {kind}; it must be {form} of numbers"
            )
        return stream, kind, shape[0]

    def chunks(self, rows: int) -> Iterator[dict[str, np.ndarray[Any, np.dtype[np.float64]]]]:
        """Arrays of at most `rows` rows each, float64."""
        import numpy as np

        opened = {key: self._opened(key) for key in self._members}
        for first in range(0, self.count, rows):
            take = min(rows, self.count - first)
            chunk = {}
            for key, (stream, kind, _) in opened.items():
                width = 1 if key == "wavelength" else 3
                try:
                    data = stream.read(take * width * kind.itemsize)
                except DAMAGED as error:
                    raise BadRays(f"{self._archive.filename}: array '{key}': {error}") from None
                if len(data) != take * width * kind.itemsize:
                    raise BadRays(f"{self._archive.filename}: array '{key}' is cut short")
                values = np.frombuffer(data, dtype=kind).astype(np.float64)
                chunk[key] = values if width == 1 else values.reshape(-1, 3)
            yield chunk


def gather(target: Path, parts: dict[str, Path], sample: TraceResult, count: int) -> None:
    """Put the raw columns into an .npz archive with fixed dates."""
    import numpy as np

    with zipfile.ZipFile(target, "w", zipfile.ZIP_STORED, allowZip64=True) as archive:
        for name, part in parts.items():
            column = getattr(sample, name)
            info = zipfile.ZipInfo(f"{name}.npy", date_time=(1980, 1, 1, 0, 0, 0))
            with archive.open(info, "w", force_zip64=True) as stream, part.open("rb") as raw:
                header = {
                    "descr": np.lib.format.dtype_to_descr(column.dtype),
                    "fortran_order": False,
                    "shape": (count, *column.shape[1:]),
                }
                np.lib.format.write_array_header_2_0(stream, header)
                while block := raw.read(1 << 22):
                    stream.write(block)
            part.unlink()
