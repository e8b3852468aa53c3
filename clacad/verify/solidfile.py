"""Judge one STEP file: read again by a kernel in a process of its own, and held against the closed form."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from clacad.export.errors import ExportError
from clacad.feasibility import body_range
from clacad.sheet import Body, Window
from clacad.verify.checks import Check, judge, not_run
from clacad.verify.gather import Progress
from clacad.verify.meshshape import volume_of
from clacad.vignetting import focal_ratio

if TYPE_CHECKING:
    from pathlib import Path

    from clacad.design import Design

SHAPE_LIMIT = 1e-7
"""Largest distance of a lens face from the closed form, in pitches."""

DIRECTION_LIMIT = 1e-6
"""Largest direction error, radians."""

VOLUME_LIMIT = 1e-9
SECONDS = 1800.0


def judge_solid(
    design: Design, window: Window, path: Path, stated: Mapping[str, Any], progress: Progress
) -> tuple[list[Check], Mapping[str, Any]]:
    """Read a STEP file in a worker and judge what is found.

    Returns
    -------
    checks : list of Check
    found : mapping
        What the reader says; empty if it could not read.
    """
    from clacad.export.worker import Worker

    common: dict[str, Any] = {"where": "file", "subject": path.name}
    progress(f"reading {path.name}", 0.0)
    try:
        with Worker() as worker:
            found = worker.run(
                "clacad.export.step_record:read", str(path), window, timeout=SECONDS, progress=progress
            )
    except (ExportError, OSError) as error:
        checks = [Check("readable", "fail", f"it cannot be read: {error}", **common)]
        return checks + [
            not_run(name, "the file cannot be read", **common) for name in ("closed", "shape", "volume")
        ], {}
    checks = [Check("readable", "pass", f"{found['solids']} solids with {found['faces']} faces", **common)]
    checks += [_closed(found, common), _solids(found, stated, common)]
    checks += [_shape(design, window, found, stated, common), _file_rms(window, found, common)]
    checks.append(_volume(window, found, stated, common))
    return checks, found


def _closed(found: Mapping[str, Any], common: Mapping[str, Any]) -> Check:
    loose = int(found["open_edges"]) + int(found["dangling"])
    bad = found.get("valid") is False
    sentence = (
        "every edge belongs to two faces" if not loose else f"{found['open_edges']} edges have one face, "
        f"{found['dangling']} references lead nowhere"
    )  # fmt: skip
    if found["kernel"]:
        sentence += (
            "; the kernel finds every solid valid" if not bad else "; the kernel finds an invalid solid"
        )
    else:
        sentence += "; too large for the kernel, its text was read"
    return Check("closed", "fail" if loose or bad else "pass", sentence, float(loose), 0.0, **common)


def _solids(found: Mapping[str, Any], stated: Mapping[str, Any], common: Mapping[str, Any]) -> Check:
    count = found.get("kernel_solids", found["solids"])
    want = stated.get("solids")
    if want is None:
        return Check("solids", "not run", f"{count} solids; nothing says how many there should be", float(count),
                     required=False, **common)  # fmt: skip
    if not found["kernel"]:
        return Check("solids", "not run", f"{count} solids before placing, {want} stated; too large for the kernel",
                     float(count), required=False, **common)  # fmt: skip
    same = int(count) == int(want)
    return Check(
        "solids", "pass" if same else "fail", f"{count} solids, {want} stated", float(count), float(want),
        relation="=", **common,
    )  # fmt: skip


def _shape(
    design: Design,
    window: Window,
    found: Mapping[str, Any],
    stated: Mapping[str, Any],
    common: Mapping[str, Any],
) -> Check:
    errors = [float(found[k]) for k in ("patch_error", "lens_error") if found.get(k) is not None]
    if not errors:
        return not_run("shape", "no lens face was found to measure", unit="mm", **common)
    pitch = min(window.lattice.pitch) * window.unit * 1e3
    limit = SHAPE_LIMIT * pitch
    if (
        design.pair.surface == "biconic"
    ):  # a biconic has no exact rational patch: its fit is stated to 1e-6 of the pitch
        limit *= 10.0
    worst = max(errors)
    sentence = (
        f"lens faces lie up to {worst:.3g} mm off the closed form"
        f" ({found.get('patches', 0)} patches from the text, {found.get('lens_points', 0)} points by the kernel)"
    )
    return judge("shape", worst, limit, sentence, unit="mm", source="1e-7 of the pitch",
                 detail={"stated_merge": stated.get("merged_steps")}, **common)  # fmt: skip


def _file_rms(window: Window, found: Mapping[str, Any], common: Mapping[str, Any]) -> Check:
    """Direction error that the largest slope error of any patch can make."""
    slopes = [float(found[k]) for k in ("patch_slope_error", "lens_slope_error") if found.get(k) is not None]
    if not slopes:
        return not_run("faithful_rms", "no lens face was found to measure", unit="rad", **common)
    gain = 0.0
    smallest = min(abs(m) for m in focal_ratio(window.thin))
    for body in window.bodies:
        for face in (body.front, body.back):
            if face.array is not None:
                gain += ((body.index - 1.0) * (1.0 / smallest if face.array == 0 else 1.0)) ** 2
    value = max(slopes) * gain**0.5
    sentence = f"the largest slope error of a lens face, {max(slopes):.3g} rad, turns light by at most {value:.3g} rad"
    return judge("faithful_rms", value, DIRECTION_LIMIT, sentence, unit="rad", source="1e-6 rad", **common)


def _volume(
    window: Window, found: Mapping[str, Any], stated: Mapping[str, Any], common: Mapping[str, Any]
) -> Check:
    if not found["kernel"]:
        return not_run("volume", "too large for the kernel", required=False, unit="mm³", **common)
    bodies = _held(window, found)
    parts = [volume_of(window, body) for body in bodies]
    if any(p is None for p in parts):
        return not_run("volume", "the outline cuts through lenslets; no integral of the design is at hand",
                       required=False, unit="mm³", **common)  # fmt: skip
    cube = (window.unit * 1e3) ** 3
    want = sum(p.value for p in parts if p is not None) * cube
    error = sum(p.error for p in parts if p is not None) * cube
    got = float(found["volume"])
    room = VOLUME_LIMIT * want + error
    merged = int(stated.get("merged_steps", 0) or 0)
    if merged:
        # steps closed on purpose move vertices by less than the merge height of a nanometre or so
        room += 1e-8 * want
    detail = {"volume": got, "exact": want}
    whose = "the design" if len(bodies) == len(window.bodies) else " and ".join(body.name for body in bodies)
    sentence = f"the kernel finds {got:.12g} mm³, quadrature of {whose} {want:.12g} mm³"
    if engraved := float(found.get("engraved", 0.0)):
        sentence += f"; letters engraved in the border take {engraved:.6g} mm³"
        detail["engraved"] = engraved
    return judge(
        "volume", abs(got + engraved - want), room, sentence, unit="mm³", source="1e-9 relative", detail=detail, **common,
    )  # fmt: skip


def _held(window: Window, found: Mapping[str, Any]) -> tuple[Body, ...]:
    """The bodies whose heights the file reaches through; all where it reaches none (it lies elsewhere)."""
    low, high = (corner[2] / (window.unit * 1e3) for corner in found["box"])
    middles = [0.5 * sum(body_range(window, body)) for body in window.bodies]
    held = tuple(body for body, z in zip(window.bodies, middles, strict=True) if low < z < high)
    return held or window.bodies
