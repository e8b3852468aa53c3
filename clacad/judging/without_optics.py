"""Checks of a delivery as a whole: files without optics, files withheld from judgement, and missing bodies.

A manifest is an unverified claim. It may call a file a frame or a coupon, but a file withheld from judgement
by light cannot make a delivery pass, and a file with the measurements of the design is not a frame.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clacad.base.units import millimetres
from clacad.checks.check import Check, default, derived
from clacad.checks.file_kinds import BODIES, CLOSED, DELIVERY, READABLE, VOLUME, unreadable
from clacad.exporting.fixtures.baffle import WALLS, baffle_meshes
from clacad.exporting.formats.registry import formats, without_optics
from clacad.exporting.formats.sequential import ZMX
from clacad.exporting.roles import Role
from clacad.formats.mesh.file_mesh import FileMesh
from clacad.formats.sequential.stations import from_own_cell, traced
from clacad.judging.delivery import Inspection, Subject, part_kind
from clacad.judging.file_light import WHITE_RAYS, lines_of, white_check
from clacad.judging.map_file import described, kind_of_map
from clacad.judging.unit_and_cells import FACTORS, SAME_EXTENT
from clacad.light.compare import WhiteLight
from clacad.light.measure import measure
from clacad.optics.rays import TraceResult
from clacad.sheet.bundle import Bundle, RequestedLaw, bundle
from clacad.sheet.feasibility import body_range
from clacad.sheet.like_cell import interfaces, lit_by
from clacad.sheet.volume_and_extent import whole_extent
from clacad.sheet.window import Window
from clacad.storage.errors import ExportError
from clacad.tracing.trace import trace

SAME_VOLUME = 1e-6
"""Relative difference of volume up to which a non-optical part has the volume its manifest states."""


@dataclass(frozen=True, slots=True)
class Reason:
    """Reason why a file is not judged by light.

    note : Text in the list of files.
    withheld : Why the file should have been judged; "" for a file that has no optics.
    """

    note: str
    withheld: str = ""


def is_fixture(name: str) -> bool:
    """Whether a name, numbered or not, is that of a part that exports write in addition to the optics."""
    return any(name.rstrip("0123456789") in one.bodies for one in formats())


def no_optics(window: Window, subject: Subject) -> Reason | None:
    """Reason why a file of a manifest has no optics; None for a file with optics."""
    names, named = {body.name for body in window.bodies}, set(subject.bodies)
    if without_optics(subject.format) and not (subject.is_mesh or part_kind(subject.path)):
        return Reason("no part of the optics: judged by its bytes")
    if not (subject.is_mesh or subject.is_solid or kind_of_map(subject) is not None):
        return Reason(
            "not judged",
            f"the manifest calls it {subject.format!r}, which is no format of an export: nothing of it was"
            " judged",
        )
    if subject.role is not Role.OTHER and (not named or named & names):
        return None
    if named & names or not all(map(is_fixture, named)):
        listed = ", ".join(sorted(named))
        return Reason(
            "not judged",
            f"the manifest lists {listed} in it, and keeps it from being judged by light; the design has"
            f" {', '.join(sorted(names))}",
        )
    if _measures_as(window, subject):
        return Reason(
            "not judged",
            f"the manifest says it is {', '.join(sorted(named))}, but it measures as the design does: it was"
            " not judged by light",
        )
    return Reason("no part of the optics: judged by its bytes and shape")


def _measures_as(window: Window, subject: Subject) -> bool:
    """Whether a file is as large as the design or one of its bodies, in any unit and orientation."""
    try:
        box = _box(subject)
    except (ExportError, OSError, ValueError):
        return False
    x0, x1, y0, y1 = whole_extent(window)
    heights = [window.z_range[1] - window.z_range[0]]
    heights += [high - low for low, high in (body_range(window, body) for body in window.bodies)]
    size = np.sort(box)
    for height in heights:
        want = np.sort([x1 - x0, y1 - y0, height]) * window.unit
        if any((np.abs(size * metres / want - 1.0) <= SAME_EXTENT).all() for _, metres in FACTORS):
            return True
    return False


def _box(subject: Subject) -> NDArray[np.float64]:
    """Extents (3,) of a file, in its unit."""
    if subject.is_solid:
        from clacad.formats.step.text_health import scan_step

        points = scan_step(subject.path).points.lookup().values
        return np.asarray(np.ptp(points, axis=0))
    from clacad.formats.mesh.readers import read_mesh

    return _extent(read_mesh(subject.path))


def _extent(mesh: FileMesh) -> NDArray[np.float64]:
    """Extents (3,) of a mesh; instances count by the corners of their boxes."""
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for part in mesh.parts:
        inner = [part.corners(k, k + 65536).reshape(-1, 3) for k in range(0, part.facet_count, 65536)]
        ends = np.stack(
            [np.min([c.min(axis=0) for c in inner], axis=0), np.max([c.max(axis=0) for c in inner], axis=0)]
        )
        corners = np.array(
            [[ends[i, 0], ends[j, 1], ends[k, 2]] for i in (0, 1) for j in (0, 1) for k in (0, 1)]
        )
        places = np.einsum("cx,pxy->pcy", corners, part.placements[:, :3]) + part.placements[:, None, 3]
        low, high = np.minimum(low, places.min(axis=(0, 1))), np.maximum(high, places.max(axis=(0, 1)))
    return np.asarray(high - low)


def judge_other(asked: Inspection, window: Window, subject: Subject, reason: Reason) -> list[Check]:
    """Judge a non-optical file by its shape, and report a file that is withheld from judgement.

    A prescription is also judged in white light, where the design judges it.
    """
    common: dict[str, Any] = {"where": "file", "subject": subject.name}
    if reason.withheld:
        return [DELIVERY.check("fail", f"{subject.name}: {reason.withheld}", **common)]
    try:
        return [*_shape(window, subject, common), *_white_light(asked, window, subject)]
    except (ExportError, OSError, ValueError) as error:
        return [unreadable(error, **common)]


def _white_light(asked: Inspection, window: Window, subject: Subject) -> Iterator[Check]:
    """Law error in white light through a prescription, by the indices of the design's materials."""
    spec = asked.design.check
    if subject.format != ZMX or spec.law_white is None:
        return
    from clacad.formats.sequential.zmx import read_zmx

    sheet, read = described(window, subject), read_zmx(subject.path)

    def send(lit: Bundle) -> TraceResult:
        index = [face.index_after for face in interfaces(lit_by(sheet, lit.rays))]
        faces = [replace(one, index=n) for one, n in zip(read, index, strict=True)]
        start, direction = from_own_cell(sheet, lit)
        low = np.array([0.0, 0.0, sheet.z_range[0] * millimetres(sheet.unit)])
        return replace(trace(sheet, lit.rays, path="size"), direction=traced(faces, start - low, direction))

    lit, law = bundle(sheet, WHITE_RAYS, spec.field, spec.field_centre), RequestedLaw.of(sheet)
    lines = lines_of(asked.design, sheet)
    white = WhiteLight(measure(send, lit, law), measure(send, lit, law, lines), lines)
    yield white_check(asked, white, "faces, with the indices of the design's materials,")


def _shape(window: Window, subject: Subject, common: dict[str, Any]) -> list[Check]:
    """Checks of a non-optical file: readable, closed, of the stated volume; a baffle of the design's."""
    if subject.is_solid and subject.kind is not None and subject.kind.text_budget:
        from clacad.formats.step.text_health import scan_step

        scan = scan_step(subject.path)
        loose = scan.open_edges + scan.dangling
        sentence = f"{scan.open_edges} edges have one face, {scan.dangling} references lead nowhere"
        state = CLOSED.check("fail" if loose else "pass", sentence, float(loose), 0.0, **common)
        return [READABLE.check("pass", f"{scan.solids} solids with {scan.faces} faces", **common), state]
    if subject.kind is not None and (reading := subject.kind.reading.sheet) is not None:
        _, _, what = reading(described(window, subject), subject.path)
        return [READABLE.check("pass", what, required=False, **common)]
    if not subject.is_mesh:
        return [READABLE.check("pass", "judged by its bytes", required=False, **common)]
    from clacad.formats.mesh.measure import measure
    from clacad.formats.mesh.readers import read_mesh

    found = measure(read_mesh(subject.path).chunks())
    checks = [
        READABLE.check("pass", f"{found.facets} facets", **common),
        CLOSED.check("pass", "every edge is met once in each direction", **common)
        if found.closed
        else CLOSED.check("fail", "the surface is not closed or not consistently wound", **common),
    ]
    honeycombs = {} if window.baffle is None else {one.name: one for one in baffle_meshes(window)}
    if (named := [honeycombs[name] for name in subject.bodies if name in honeycombs]) and found.closed:
        want = sum(one.volume() for one in named) * millimetres(window.unit) ** 3
        text = f"it encloses {found.volume:.9g} mm³, the walls between the channels {want:.9g} mm³"
        off, source = abs(found.volume / want - 1.0), default(f"{WALLS:g} relative")
        checks.append(VOLUME.judge(off, WALLS, text, unit="relative", limit_source=source, **common))
        return checks
    stated = subject.entry.get("volume")
    if isinstance(stated, (int, float)) and stated > 0.0:
        text = f"it encloses {found.volume:.9g}, {stated:.9g} stated"
        checks.append(
            VOLUME.judge(
                abs(found.volume / stated - 1.0),
                SAME_VOLUME,
                text,
                unit="relative",
                limit_source=derived("stated volume of the file"),
                **common,
            )
        )
    return checks


def whole_delivery(
    window: Window, judged: Iterable[tuple[Subject, Role, Sequence[str] | None]]
) -> list[Check]:
    """Judge whether any file was judged by light, and report bodies that no file holds.

    judged : (file, role it was judged as, names of the bodies in it or None where its manifest gives them)
    """
    held: set[str] = set()
    optical = 0
    names = [body.name for body in window.bodies]
    for subject, role, present in judged:
        if role is Role.OTHER or not subject.sha256:
            continue
        optical += 1
        held |= set(present if present is not None else subject.bodies or names)
    if not optical:
        text = (
            "no file of this delivery was judged by light: nothing says that a part made from it obeys"
            " the law"
        )
        return [DELIVERY.not_run(text, where="file")]
    lacking = [name for name in names if name not in held]
    if not lacking:
        return []
    text = (
        f"no file holds {' or '.join(lacking)}: the light was traced with"
        f" {'it' if len(lacking) == 1 else 'them'} taken from the design"
    )
    return [BODIES.check("warn", text, ", ".join(sorted(held)), ", ".join(names), required=False)]
