"""`clacad trace`: rays of a file through the window into another file, in chunks of bounded memory."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from clacad.cli.command import Command, OfDesign, option, overwrite_option, required
from clacad.cli.console import Console, Progress, table
from clacad.cli.option_values import BadOption, load_counted, words_of

if TYPE_CHECKING:
    from clacad.formats.ray_file import RayFile

CHUNK = 1_000_000
"""Rays traced at once."""


@dataclass(frozen=True, kw_only=True)
class Trace(OfDesign):
    """Trace a bundle of rays from a file, for other programs."""

    rays: Path = required(
        "RAYS.npz", "Arrays position (n, 3), direction (n, 3) and optionally wavelength (n,), metres."
    )
    out: Path = required("-o, --out OUT.npz", "File for the results.")
    rung: str = option("--rung WORD", "law, thin, surfaces or mesh.", "surfaces")
    effects: tuple[str, ...] = option("--effects A,B", "Effects to add; default none.", (), read=words_of)
    mesh: Path | None = option("--mesh FILE", "Rung mesh: triangles as written.")
    quads: int = option("--quads N", "Rung mesh without a file: quads per cell side.", 16, least=1, most=2048)
    normals: str = option("--normals WORD", "Rung mesh: facet or vertex.", "facet")
    overwrite: bool = overwrite_option()


def run(request: Trace, console: Console) -> int:
    """Trace every ray of a file; print the number of rays of each fate."""
    design = load_counted(request.design, request.set)
    from clacad.formats.ray_file import RayFile
    from clacad.prescription.prescribe import prescribe
    from clacad.storage.atomic import write_file

    window = prescribe(design)
    rays = RayFile(request.rays)
    counts: dict[str, int] = {}
    task, seconds = _cost(request, rays.count, 2 * len(window.bodies))
    with console.progress() as progress, console.forecast(task, seconds), _mesh_is_input(request):
        options = _options(window, request)

        def write(private: Path) -> None:
            _write(private, rays, window, options, counts, progress)

        write_file(request.out, write, overwrite=request.overwrite)
    rows = [(name, str(n), f"{n / max(1, rays.count):.4%}") for name, n in counts.items() if n]
    console.show(
        lambda: {"rays": rays.count, "fates": counts, "rung": request.rung, "file": str(request.out)},
        lambda: f"{rays.count} rays, rung {request.rung} -> {request.out}\n{table(rows)}",
    )
    return 0


@contextmanager
def _mesh_is_input(request: Trace) -> Iterator[None]:
    """Within the block a mesh that cannot be read, or of another sheet, is bad input.

    Raises
    ------
    BadOption
    """
    from clacad.storage.errors import OverBudget, UnreadableFile

    try:
        yield
    except OverBudget:
        raise
    except UnreadableFile as error:
        raise BadOption(f"--mesh {request.mesh}: {error}") from error


def _cost(request: Trace, rays: int, faces: int) -> tuple[str, float]:
    """Task and modelled seconds, for the forecast."""
    from clacad.tracing.which_path import task, trace_seconds

    mesh = request.mesh
    size = mesh.stat().st_size if mesh is not None and mesh.is_file() else 0
    return (
        task(request.rung, request.effects, rays, faces, from_file=mesh is not None),
        trace_seconds(rays, request.rung, request.effects, faces, size),
    )


def _refuse_options(request: Trace) -> None:
    """Refuse options with unknown words, or of another rung.

    Raises
    ------
    BadOption
    """
    if request.rung not in ("law", "thin", "surfaces", "mesh"):
        raise BadOption(f"--rung {request.rung}: it is one of law, thin, surfaces, mesh")
    if request.normals not in ("facet", "vertex"):
        raise BadOption(f"--normals {request.normals}: it is facet or vertex")
    if request.rung != "mesh":
        facets = "facets" in request.effects
        given = {
            "--mesh": request.mesh is not None,
            "--normals vertex": request.normals == "vertex" and not facets,
        }
        for option in (name for name, on in given.items() if on):
            raise BadOption(f"{option}: it is for --rung mesh, not {request.rung}")
    if request.mesh is not None and not request.mesh.is_file():
        raise BadOption(f"{request.mesh}: there is no such file")
    if request.effects:
        from clacad.effects import registry

        unknown = [name for name in request.effects if name not in registry.NAMES]
        if unknown:
            raise BadOption(f"--effects {unknown[0]}: it is one of {', '.join(registry.NAMES)}")


def _options(window: Any, request: Trace) -> dict[str, Any]:
    """Arguments of `trace` besides window and rays; a mesh is made, or read, here.

    Raises
    ------
    BadOption
    """
    _refuse_options(request)
    options: dict[str, Any] = dict(rung=request.rung, effects=request.effects)
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

    from clacad.effects.trace import Tracer
    from clacad.formats.ray_file import COLUMNS, gather
    from clacad.optics.rays import Rays

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
    gather(private, parts, last, rays.count)


COMMANDS = (Command("trace", "look", Trace, run),)
