"""`clacad trace`: rays from a file through the window and back into a file, in chunks of bounded memory."""

from __future__ import annotations

import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

from clacad.base.regular_file import require_regular
from clacad.base.text import printable
from clacad.cli.announce_cost import forecast
from clacad.cli.console import Progress, show_json, show_text, table
from clacad.cli.design_commands import load_counted

if TYPE_CHECKING:
    import numpy as np

    from clacad.optics.rays import TraceResult

CHUNK = 1_000_000
COLUMNS = ("position", "direction", "fate", "optical_path", "cell", "order", "surface", "flux")


DAMAGED = (zipfile.BadZipFile, zlib.error, RuntimeError, NotImplementedError, EOFError, OSError)
"""What a zip file raises that is cut, changed, encrypted or packed in an unknown way."""


class BadRays(ValueError):
    """A file that holds no rays; exit status 2."""

    exit_status = 2


@dataclass(frozen=True, slots=True)
class TraceRequest:
    """What to trace and how."""

    rays: Path
    out: Path
    rung: str
    effects: tuple[str, ...]
    mesh: Path | None
    quads: int
    normals: str
    overwrite: bool


class RayFile:
    """Rays in an .npz archive, read in chunks whether or not the archive is compressed.

    Parameters
    ----------
    path : Path

    Raises
    ------
    BadRays
        It is no such archive, an array is missing or has the wrong shape or type.
    OverBudget
        More bytes or rays than are read.
    """

    def __init__(self, path: Path) -> None:
        from clacad.storage.archive import open_archive
        from clacad.storage.errors import OverBudget, UnreadableFile
        from clacad.storage.spending import Spending

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
        from clacad.base.npy_header import array_head

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


def trace_file(path: Path, overrides: list[str], request: TraceRequest, *, json: bool, quiet: bool) -> int:
    """Trace every ray of a file; prints how many met which fate."""
    design = load_counted(path, overrides)
    from clacad.prescription.prescribe import prescribe
    from clacad.storage.atomic import write_file

    window = prescribe(design)
    rays = RayFile(request.rays)
    counts: dict[str, int] = {}
    progress = Progress(quiet=quiet)

    with forecast(*_cost(request, rays.count, 2 * len(window.bodies)), quiet=quiet), _mesh_is_input(request):
        options = _options(window, request)

        def write(private: Path) -> None:
            _write(private, rays, window, options, counts, progress)

        write_file(request.out, write, overwrite=request.overwrite)
    progress.done()
    if json:
        show_json({"rays": rays.count, "fates": counts, "rung": request.rung, "file": str(request.out)})
    else:
        rows = [(name, str(n), f"{n / max(1, rays.count):.4%}") for name, n in counts.items() if n]
        show_text(f"{rays.count} rays, rung {request.rung} -> {request.out}\n{table(rows)}", quiet=quiet)
    return 0


@contextmanager
def _mesh_is_input(request: TraceRequest) -> Iterator[None]:
    """Within the block a mesh that cannot be read, or is none of this sheet, is bad input; what needs more room is not.

    Raises
    ------
    BadRays
    """
    from clacad.storage.errors import OverBudget, UnreadableFile

    try:
        yield
    except OverBudget:
        raise
    except UnreadableFile as error:
        raise BadRays(f"--mesh {request.mesh}: {error}") from error


def _cost(request: TraceRequest, rays: int, faces: int) -> tuple[str, float]:
    """Task and modelled seconds, for the forecast."""
    from clacad.tracing.trace_cost import task, trace_seconds

    mesh = request.mesh
    size = mesh.stat().st_size if mesh is not None and mesh.is_file() else 0
    return (
        task(request.rung, request.effects, rays, faces, from_file=mesh is not None),
        trace_seconds(rays, request.rung, request.effects, faces, size),
    )


def _refuse_options(request: TraceRequest) -> None:
    """Refuse options that are no words known here, or not of this rung.

    Raises
    ------
    BadRays
    """
    if request.rung not in ("law", "thin", "surfaces", "mesh"):
        raise BadRays(f"--rung {request.rung}: it is one of law, thin, surfaces, mesh")
    if request.normals not in ("facet", "vertex"):
        raise BadRays(f"--normals {request.normals}: it is facet or vertex")
    if request.rung != "mesh":
        facets = "facets" in request.effects
        given = {
            "--mesh": request.mesh is not None,
            "--normals vertex": request.normals == "vertex" and not facets,
        }
        for option in (name for name, on in given.items() if on):
            raise BadRays(f"{option}: it is for --rung mesh, not {request.rung}")
    if request.mesh is not None and not request.mesh.is_file():
        raise BadRays(f"{request.mesh}: there is no such file")
    if request.effects:
        from clacad.effects import registry

        unknown = [name for name in request.effects if name not in registry.NAMES]
        if unknown:
            raise BadRays(f"--effects {unknown[0]}: it is one of {', '.join(registry.NAMES)}")


def _options(window: Any, request: TraceRequest) -> dict[str, Any]:
    """Arguments of `trace` besides window and rays; a mesh is made, or read, here.

    Raises
    ------
    BadRays
    """
    _refuse_options(request)
    options: dict[str, Any] = {"rung": request.rung, "effects": request.effects}
    if request.rung == "mesh":
        from clacad.mesh import tessellate

        options["normals"] = request.normals
        options["mesh"] = tessellate(window, quads=request.quads) if request.mesh is None else request.mesh
    return options


def _write(
    private: Path,
    rays: RayFile,
    window: Any,
    options: dict[str, Any],
    counts: dict[str, int],
    progress: Progress,
) -> None:
    """Trace chunk by chunk into one raw file a column, then gather them into the archive."""
    import numpy as np

    from clacad.optics.rays import Rays
    from clacad.tracing.tracer import Tracer

    tracer = Tracer(window, path="size", **options)
    parts = {name: private.with_name(f"{private.name}.{name}") for name in COLUMNS}
    streams = {name: part.open("wb") for name, part in parts.items()}
    try:
        done = 0
        for chunk in rays.chunks(CHUNK):
            result = tracer(Rays(chunk["position"], chunk["direction"], chunk.get("wavelength")))
            for name, count in result.counts().items():
                label = getattr(name, "name", str(name))
                counts[label] = counts.get(label, 0) + int(count)
            for name, stream in streams.items():
                stream.write(getattr(result, name).tobytes())
            done += len(chunk["position"])
            progress("tracing", done / rays.count)
            last = result
    finally:
        for stream in streams.values():
            stream.close()
    if rays.count == 0:
        last = tracer(Rays(np.empty((0, 3)), np.empty((0, 3))))
    _gather(private, parts, last, rays.count)


def _gather(target: Path, parts: dict[str, Path], sample: TraceResult, count: int) -> None:
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
