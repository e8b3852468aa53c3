"""Verify the files of a stack: every sheet as a master of its design, and light through all."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from clacad.base.types import Floats, Progress
from clacad.base.units import millimetres
from clacad.checks.check import Check, State, default, other, passed, wrong
from clacad.checks.file_kinds import INTEGRITY, SHAPE, STACK_LIGHT, unreadable
from clacad.exporting.formats.registry import longest_wait, reading_worker
from clacad.exporting.roles import Role
from clacad.exporting.tessellations import Meshes, instanceable
from clacad.formats.mesh.compare_triangles import compare_mesh
from clacad.formats.step.rays_through_faces import crossings
from clacad.judging.delivery import Inspection
from clacad.judging.step_file import DIRECTION_LIMIT, judge_solid
from clacad.judging.step_light import FACE_RAYS, OCC_RAYS, SECONDS
from clacad.optics.law import angle_between
from clacad.optics.rays import Fate, Rays
from clacad.stacking.assembly import mesh_of_sheet, places
from clacad.storage.atomic import file_hash, read_manifest
from clacad.storage.errors import BadRequest, ExportError
from clacad.tracing.through_stack import StackTrace, StackTracer, launched

if TYPE_CHECKING:
    from clacad.design import Design
    from clacad.sheet.stack import Stack

RAYS = 64
"""Number of rays through the written assembly; each is tested against the faces of many cells."""

MARGIN = 0.6
"""Distance (pitches) around the rays within which faces are read."""


REMEDY = "`clacad stack … -o DIR` writes them"


def judge_stack(
    stack: Stack, designs: Sequence[Design], files: Path, field: float, progress: Progress
) -> list[Check]:
    """Verify the written files of a stack.

    designs : sequence of Design, of its sheets
    files : The folder, or one of its files.
    field : radians. Of the light through all sheets.
    Raises BadRequest: There is no file of a stack.
    """
    folder = files if files.is_dir() else files.parent
    manifest = read_manifest(folder) or {}
    stated = {str(entry.get("name")): entry for entry in manifest.get("files", ()) if isinstance(entry, dict)}
    wanted = [files] if files.is_file() else [folder / name for name in sorted(stated)]
    subjects = [path for path in wanted if path.suffix.lower() in (".step", ".stp", ".glb")]
    if not subjects:
        raise BadRequest(f"{files}: there is no STEP or GLB file of a stack; {REMEDY}")
    checks: list[Check] = []
    for path in subjects:
        entry = stated.get(path.name, {})
        if not path.is_file():
            gone = FileNotFoundError(f"{path} is not there")
            checks.append(unreadable(gone, where="file", subject=path.name))
            continue
        checks += _same_bytes(path, entry)
        if path.suffix.lower() == ".glb":
            checks.append(_judge_facets(stack, path, entry))
        else:
            checks += _judge_faces(stack, designs, path, entry, field, progress)
    return checks


def _same_bytes(path: Path, entry: Mapping[str, Any]) -> list[Check]:
    """Whether a file that a manifest vouches for is as it was written."""
    if not entry.get("sha256"):
        return []
    found = file_hash(path)
    same = found == entry["sha256"]
    state: State = "pass" if same else "fail"
    sentence = f"its bytes are {'' if same else 'not '}those that were written"
    return [INTEGRITY.check(state, sentence, found[:16], str(entry["sha256"])[:16], subject=path.name)]


def _judge_faces(
    stack: Stack,
    designs: Sequence[Design],
    path: Path,
    entry: Mapping[str, Any],
    field: float,
    progress: Progress,
) -> list[Check]:
    """A STEP file: each sheet of it, and light through all."""
    checks: list[Check] = []
    told = entry.get("sheets", ())
    for one, design, place in zip(stack.sheets, designs, places(stack), strict=True):
        stated = next((s for s in told if isinstance(s, dict) and s.get("name") == one.id), {})
        asked = Inspection(design, f"{path.name} sheet {one.id}", FACE_RAYS, progress, Role.MASTER, stated)
        checks += judge_solid(asked, one.window, path, place)[0]
    progress("tracing through the assembly", 0.9)
    return [*checks, _light_through(stack, path, field)]


def _light_through(stack: Stack, path: Path, field: float) -> Check:
    """The same rays through the faces of the file and through the exact surfaces, all sheets."""
    common: dict[str, Any] = {"where": "file", "subject": path.name, "unit": "rad"}
    sent, exact = _through_exact(stack, field)
    if not len(sent):
        return STACK_LIGHT.not_run("no light gets through all sheets of the stack", **common)
    mm = millimetres(stack.unit)
    low, high = _column(stack, exact)
    faces = [
        crossing for one in stack.sheets for crossing in crossings(one.window, one.window.bodies, one.z * mm)
    ]
    try:
        with reading_worker(path) as worker:
            found = worker.run(
                OCC_RAYS,
                str(path),
                sent.position * mm,
                sent.direction,
                faces,
                (low * mm).tolist(),
                (high * mm).tolist(),
                timeout=SECONDS + longest_wait(path),
            )
    except (ExportError, OSError) as error:
        return STACK_LIGHT.not_run(f"no light could be sent through its faces: {error}", **common)
    through = np.array(found["end"], dtype=int) == 0
    if not through.all():
        sentence = (
            f"{int((~through).sum())} of {len(through)} rays end inside the assembly that pass the exact"
            " sheets"
        )
        return STACK_LIGHT.check("fail", sentence, float((~through).sum()), 0.0, **common)
    worst = float(angle_between(np.array(found["direction"]), exact.direction).max())
    sentence = (
        f"{len(through)} rays through the {len(faces)} faces of all {len(stack.sheets)} sheets leave"
        f" within {worst:.3g} rad of those through the exact surfaces"
    )
    return STACK_LIGHT.judge(worst, DIRECTION_LIMIT, sentence, limit_source=default("1e-6 rad"), **common)


def _through_exact(stack: Stack, field: float) -> tuple[Rays, StackTrace]:
    """Rays that pass every sheet through partners, and what becomes of them."""
    tracer = StackTracer(stack, "surfaces", path="size")
    sent = launched(stack, 64 * RAYS, field)
    rows = np.flatnonzero(tracer(sent).fate == Fate.ALIVE)[:RAYS]
    chosen = Rays(sent.position[rows], sent.direction[rows])
    return chosen, tracer(chosen)


def _column(stack: Stack, exact: StackTrace) -> tuple[Floats, Floats]:
    """Column of x and y, low (2,) and high (2,), that holds all cells rays go through, stack's lengths."""
    corners = []
    for one, (_, result) in zip(stack.sheets, exact.passed, strict=True):
        window = one.window
        met = (
            result.cell,
            result.cell + result.order,
            result.cell,
        )  # of a field lens, where there is one, the first's
        for cells, shift in zip(met, window.shifts):
            centres = window.lattice.centres(np.unique(cells, axis=0).astype(np.int64)) + np.asarray(shift)
            reach = MARGIN * 2.0 * window.lattice.circumradius
            corners += [(centres - reach) * one.scale, (centres + reach) * one.scale]
    every = np.concatenate(corners)
    return every.min(axis=0), every.max(axis=0)


def _judge_facets(stack: Stack, path: Path, entry: Mapping[str, Any]) -> Check:
    """A GLB file: the facets of each sheet against its faces, by the grid the manifest states."""
    from clacad.formats.mesh.glb import read_glb

    common: dict[str, Any] = {"where": "file", "subject": path.name}
    quads = entry.get("quads")
    if not isinstance(quads, int) or not 1 <= quads <= 1024:
        return SHAPE.not_run("no manifest says of how many facets it is", required=False, **common)
    try:
        whole = read_glb(path)
        for one, place in zip(stack.sheets, places(stack), strict=True):
            promise = Meshes(one.window).at(quads).promise(instanced=instanceable(one.window), single=True)
            compare_mesh(mesh_of_sheet(whole, place), one.window, promise, f"sheet {one.id}")
    except ExportError as error:
        return SHAPE.check("fail", str(error), **common)
    sentence = (
        f"the facets of all {len(stack.sheets)} sheets lie on their faces, each sheet at its place in the"
        " stack"
    )
    return SHAPE.check("pass", sentence, limit_source=other("chords of the stated facets"), **common)


def verdict_text(checks: Sequence[Check]) -> str:
    """Verdict in one line: every sheet a master, or the checks that fail."""
    if passed(checks):
        return "passed: every sheet as an optical master, and light through all of them"
    return f"failed: {', '.join(sorted({f'{check.id} ({check.subject})' for check in wrong(checks)}))}"
