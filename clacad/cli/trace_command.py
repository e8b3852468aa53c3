"""Light through a sheet: `clacad trace`, `clacad wave` and `clacad effects`.

Rays of a file are traced into another file in chunks of bounded memory; one telescopelet's light is compared
with its rays as a wave; the effects that a scene or design requires are listed with reasons.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from clacad.base.text import count_text, mrad_text, short_size_text
from clacad.cli.command import (
    Command,
    OfDesign,
    Overridden,
    dry_run_option,
    flag,
    option,
    overwrite_option,
    required,
)
from clacad.cli.console import Brief, Console, Progress, facts, table
from clacad.cli.option_values import (
    BadOption,
    load_counted,
    parse_two_angles,
    parse_wavelength,
    picture_kind,
    words_of,
)

if TYPE_CHECKING:
    from clacad.design import Design
    from clacad.effects.engine.plan import Plan
    from clacad.formats.ray_file import RayFile
    from clacad.scene import Scene
    from clacad.waves import WaveReport


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


def run_trace(request: Trace, console: Console) -> int:
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
    alive = counts.get("ALIVE", 0) / max(1, rays.count)
    console.show(
        lambda: {"rays": rays.count, "fates": counts, "rung": request.rung, "file": str(request.out)},
        lambda: f"{rays.count} rays, rung {request.rung} -> {request.out}\n{table(rows)}",
        lambda: Brief(
            f"{design.name}: {alive:.4g} of {count_text(rays.count, 'ray')} pass, rung {request.rung}",
            (facts(rows), [("file", f"  wrote {request.out}")]),
        ),
    )
    return 0


@contextmanager
def _mesh_is_input(request: Trace) -> Iterator[None]:
    """Within the block a mesh that cannot be read, or of another sheet, is bad input."""
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
    """Refuse options with unknown words, or of another rung."""
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
        from clacad import effects as registry

        unknown = [name for name in request.effects if name not in registry.NAMES]
        if unknown:
            raise BadOption(f"--effects {unknown[0]}: it is one of {', '.join(registry.NAMES)}")


def _options(window: Any, request: Trace) -> dict[str, Any]:
    """Arguments of `trace` besides window and rays; a mesh is made, or read, here."""
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


TASK = "wave"


@dataclass(frozen=True, kw_only=True)
class Wave(OfDesign):
    """Light as a wave through one telescopelet: far field, Strehl ratio, share to the partner, its rays."""

    out: Path | None = option("-o, --out FILE", "Write the picture here, .png or .svg.")
    field: tuple[float, float] | None = option(
        "--field A[,B]",
        "Angles of the light off the middle of the field along x and y, e.g. '0.5 deg,0'; default the "
        "middle.",
        read=parse_two_angles,
    )
    wavelength: float | None = option(
        "--wavelength L", "Default the design's, e.g. '633 nm'.", read=parse_wavelength
    )
    field_lens: bool = flag(
        "--field-lens", "As if a lens at the common focus imaged lens 1 onto lens 2: ideal lenses only."
    )
    dry_run: bool = dry_run_option("Print grid and cost; write nothing.")
    overwrite: bool = overwrite_option()


def run_wave(request: Wave, console: Console) -> int:
    """Print far field, Strehl ratio and share of waves and rays, draw them with -o."""
    kind = picture_kind(request.out)
    design = load_counted(request.design, request.set)
    from clacad.storage.atomic import require_writable, write_content
    from clacad.waves.through_sheet import look, outlook, situation

    if request.out is not None:
        require_writable(request.out, overwrite=request.overwrite)
    lit = situation(design, request.field or (0.0, 0.0), request.wavelength, field_lens=request.field_lens)
    ahead = outlook(lit)
    if request.dry_run:
        console.show(lambda: {"forecast": ahead}, lambda: _forecast_text(ahead))
        return 0
    with console.progress() as progress, console.forecast(TASK, ahead["seconds"]) as span:
        progress.expect(span.middle)
        progress("sending waves through a telescopelet", None)
        found = look(lit, design.name)
    written = None if request.out is None else str(request.out)
    if request.out is not None:
        write_content(request.out, found.picture(kind), overwrite=request.overwrite)
    console.show(
        lambda: found.to_dict() | {"forecast": ahead, "file": written},
        lambda: wave_text(found) + ("" if written is None else f"\nwrote {written}"),
        lambda: _wave_brief(found, written),
    )
    return 0


def _forecast_text(ahead: dict[str, float]) -> str:
    return (
        f"{ahead['rays']:.0f} x {ahead['rays']:.0f} rays, a grid of {ahead['points']:.0f} points a side, "
        f"about {ahead['seconds']:.2g} s of processor time, {short_size_text(ahead['bytes'])} of memory; "
        "nothing is written"
    )


def _wave_brief(found: WaveReport, written: str | None) -> Brief:
    """Numbers of waves and rays, a column each."""
    from clacad.waves.wave_report import HEAD, head, rows, sentences

    columns = zip_longest(HEAD, *rows(found), fillvalue="")
    notes = [("note", f"  {text}") for text in sentences(found)]
    lines = [("file", f"  wrote {written}")] if written is not None else []
    return Brief(
        f"{found.design}: {head(found)}", (facts([*columns, ("angles in mrad, lens x, y", "")]), notes, lines)
    )


def wave_text(found: WaveReport) -> str:
    """Table of the numbers of waves and rays, angles in mrad along lens x and y."""
    from clacad.waves.wave_report import HEAD, head, rows, sentences

    return "\n".join(
        [
            f"{found.design}: {head(found)}",
            table([HEAD, *rows(found)]),
            "angles in mrad, lens x, y",
            *sentences(found),
        ]
    )


SIGNS = {"on": "on", "off": "-", "forced": "forced", "without": "LEFT OUT", "unknown": "unknown"}

T = TypeVar("T")


class NoPlan(ValueError):
    """An unknown effect, or a wavelength outside a material's data; exit status 2."""

    exit_status = 2


@dataclass(frozen=True, kw_only=True)
class Effects(Overridden):
    """Which physical effects the scene calls for, why, and what is left out."""

    scene: Path = required("SCENE", "Scene file; or a design file.")
    exact: bool = flag("--exact-bounds", "Measure every bound by a trace with and without the effect.")
    force: tuple[str, ...] = option("--force A,B", "Effects to switch on anyway.", (), read=words_of)
    without: tuple[str, ...] = option("--without A,B", "Effects to leave out anyway.", (), read=words_of)


def run_effects(request: Effects, console: Console) -> int:
    """Print the plan; of several sheets the plan of each."""
    from clacad.design import Design
    from clacad.exporting.limits import refuse_uncountable

    target = load_target(request.scene, request.set)
    for design in (target,) if isinstance(target, Design) else target.designs():
        refuse_uncountable(design)
    from clacad.effects import plan_effects

    if not isinstance(target, Design) and len(target.sheets) > 1:
        return _show_sheets(target, request, console)
    plan = _planned(
        lambda: plan_effects(target, exact=request.exact, force=request.force, without=request.without)
    )
    console.show(plan.to_dict, lambda: plan_text(plan), lambda: _plan_brief(plan))
    return 0


def _show_sheets(scene: Scene, request: Effects, console: Console) -> int:
    """Print the plan of each of several sheets, by its id."""
    from clacad.effects import plan_sheets
    from clacad.rendering.sheet_passage import stack_of

    still = scene.at(0) if scene.animation is not None else scene
    stack = stack_of(still)
    plans = _planned(
        lambda: plan_sheets(still, stack, exact=request.exact, force=request.force, without=request.without)
    )
    named = list(zip((one.id for one in stack.sheets), plans, strict=True))
    console.show(
        lambda: {"sheets": [{"id": name, **plan.to_dict()} for name, plan in named]},
        lambda: "\n\n".join(f"sheet {name}\n{plan_text(plan)}" for name, plan in named),
        lambda: Brief(f"{count_text(len(named), 'sheet')}", (facts((n, one.summary()) for n, one in named),)),
    )
    return 0


def _planned(plan: Callable[[], T]) -> T:
    """The plan; a request that has none is bad input."""
    try:
        return plan()
    except ValueError as error:
        raise NoPlan(str(error)) from error


def load_target(path: Path, overrides: tuple[str, ...]) -> Scene | Design:
    """Read a scene; a file with a [law] and no [sheet] is read as a design."""
    from clacad.config.toml_text import top_keys

    keys = top_keys(str(path))
    if "law" in keys and "sheet" not in keys:
        from clacad.design import load

        return load(path, overrides)
    from clacad.scene import load_scene

    return load_scene(path, overrides)


def plan_text(plan: Plan) -> str:
    """The plan as text: its rung, a table of effects, the predicted time."""
    rows = [["effect", "", "angle", "radiance", "cost", "why"]]
    for row in plan.rows:
        angle, radiance = _amount(1e3 * row.angle, " mrad"), _amount(100.0 * row.radiance, " %")
        rows.append([row.effect, SIGNS[row.state], angle, radiance, f"x{row.cost:.3g}", row.why])
    kind = "measured" if any(row.measured for row in plan.rows) else "first-order"
    return "\n".join(
        [
            f"rung {plan.rung}: {plan.rung_why}",
            f"what matters: {mrad_text(plan.angle, 3)}, {plan.radiance:.2%} of the light; {kind} bounds "
            "of what each effect changes:",
            table(rows),
            f"predicted time: {plan.cost:.3g} x the bare trace",
            plan.summary(),
        ]
    )


def _plan_brief(plan: Plan) -> Brief:
    """What is simulated and left out; each effect that matters or is not bounded; names of the others."""
    shown = [row for row in plan.rows if row.state != "off"]
    rows = [
        (
            row.effect,
            SIGNS[row.state],
            _amount(1e3 * row.angle, " mrad"),
            _amount(1e2 * row.radiance, " %"),
            row.why,
        )
        for row in shown
    ]
    off = ", ".join(row.effect for row in plan.rows if row.state == "off")
    cost = f"{plan.cost:.3g} x the bare trace"
    return Brief(plan.summary(), (facts(rows), facts([("not needed", off), ("predicted time", cost)])))


def _amount(value: float, unit: str) -> str:
    """A bound with its unit, or nothing for 0."""
    return f"{value:.3g}{unit}" if value else ""


COMMANDS = (
    Command("trace", "look", Trace, run_trace),
    Command("wave", "look", Wave, run_wave),
    Command("effects", "look", Effects, run_effects),
)
