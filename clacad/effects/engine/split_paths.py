"""Split paths of many rays: the compiled ones where lenses alone are met, the non-sequential trace for the rest."""

from __future__ import annotations

from typing import Any

import numpy as np

from clacad.base.types import Bools, Floats
from clacad.effects.engine.block import unit_rows
from clacad.effects.engine.block_order import around
from clacad.effects.engine.light_rays import LightRays, join_light
from clacad.effects.engine.nonsequential import trace_nonsequential
from clacad.effects.engine.nonsequential_rows import rules_for
from clacad.effects.engine.parameters import Setting
from clacad.effects.engine.passes import blocks, take_rays
from clacad.optics.rays import Fate, Rays, TraceResult
from clacad.optics.surface import Quadric
from clacad.sheet.window import Window
from clacad.tracing.layout import BodyPlan, FacePlan, Layout, lay_out


def reflected_paths(
    window: Window, rays: Rays, result: TraceResult, setting: Setting, compiled: bool
) -> LightRays:
    """Paths with at least one partial reflection, of the rays that meet the sheet.

    Parameters
    ----------
    rays : Rays
        n as launched.
    result : TraceResult
        What they did without splitting: n rows.
    setting : Setting
        With the effects that are on; `order` is the most reflections of a path.
    compiled : bool
        Where lenses alone were met, by compiled code that ends paths at steps, seams and edges.
    """
    left = result.fate < Fate.MISSED
    parts = []
    if compiled and known_to_compiled(window, setting):
        light, done = split_by_compiled(window, rays, setting)
        parts.append(light)
        left &= ~done
    every = np.arange(len(rays))
    for chosen, wavelength in blocks(rays, by_colour=True):
        rows = every[chosen]
        met = np.flatnonzero(left[rows])
        if not len(met):
            continue
        rules = rules_for(window, setting, wavelength, setting.order)
        out = trace_nonsequential(window, take_rays(rays, rows), met, rules)
        kept = out.bounces > 0
        parts.append(
            LightRays(rows[out.parent[kept]], out.position[kept], out.direction[kept], out.flux[kept])
        )
    nothing = LightRays(np.zeros(0, dtype=np.intp), np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0))
    return join_light(*parts) if parts else nothing


def known_to_compiled(window: Window, setting: Setting) -> bool:
    """Whether the compiled paths know all that the window has."""
    plain = all(isinstance(face.surface, Quadric) for face in window.faces)
    return plain and window.baffle is None and setting.order <= 2


def split_by_compiled(window: Window, rays: Rays, setting: Setting) -> tuple[LightRays, Bools]:
    """Split paths of the rays that went through lenses only, and which rays (n,) those are."""
    from clacad.effects.engine.compiled_split_paths import bounce_pass
    from clacad.tracing.compiled.packing import pack
    from clacad.tracing.trace import trace

    layout = lay_out(window)
    faces, lattice, runs = packed_faces(layout), packed_lattice(layout), pack(layout).rows
    done = np.zeros(len(rays), dtype=bool)
    parts = []
    every = np.arange(len(rays))
    for chosen, wavelength in blocks(rays, by_colour=True):
        part = take_rays(rays, chosen)
        result = trace(window, part, "surfaces", record=True, threads=1, path="numba")
        assert result.hits is not None
        assert result.directions is not None
        rows = np.flatnonzero(result.fate <= Fate.GHOST)
        done[every[chosen][rows]] = True
        rules = rules_for(window, setting, wavelength, setting.order)
        index = np.array(around(rules.indices))
        rates = np.array(rules.attenuation or (0.0,) * len(window.bodies))
        paths = len(faces) * (len(faces) + 1) // 2
        position, direction = np.empty((len(rows), paths, 3)), np.empty((len(rows), paths, 3))
        flux = np.zeros((len(rows), paths))
        layer = rules.ratio if setting.coating == "quarter-wave" else 0.0
        bounce_pass(
            faces, lattice, runs, index, rates, layer, setting.order, rows, unit_rows(part.direction), result.hits,
            result.directions, position, direction, flux,
        )  # fmt: skip
        lit = flux > 0.0
        parent = np.broadcast_to(every[chosen][rows][:, None], flux.shape)[lit]
        parts.append(LightRays(parent, position[lit], direction[lit], flux[lit]))
    return join_light(*parts), done


def packed_faces(layout: Layout) -> Floats:
    """Faces (2 × bodies, COLUMNS) as the kernel reads them, sheet frame."""
    from clacad.effects.engine import compiled_split_paths as slot

    rows = []
    for body in layout.bodies:
        for face in (body.front, body.back):
            rows.append(_face(slot, layout, face, body))
    return np.array(rows)


def _face(slot: Any, layout: Layout, face: FacePlan, body: BodyPlan) -> Floats:
    """One row (COLUMNS,) of `packed_faces`."""
    row = np.zeros(slot.COLUMNS)
    surface = face.surface
    assert isinstance(surface, Quadric)
    row[slot.CX], row[slot.CY], row[slot.KAPPA] = surface.curvature_x, surface.curvature_y, surface.kappa
    row[slot.SIDE] = surface.side
    row[slot.VX : slot.VZ + 1] = face.vertex
    row[slot.VZ] += body.level
    row[slot.STRUCTURED] = float(face.array is not None)
    if face.array is not None:
        row[slot.SHIFT_X : slot.SHIFT_Y + 1] = layout.window.shifts[face.array]
    row[slot.ROTATION : slot.ROTATION + 9] = (np.eye(3) if face.rotation is None else face.rotation).ravel()
    row[slot.LAND] = face.land + body.level
    row[slot.MID_X : slot.MID_Y + 1] = body.centre
    row[slot.HALF_X : slot.RADIUS + 1] = body.inner
    return row


def packed_lattice(layout: Layout) -> Floats:
    """The lattice (9,) as the kernel reads it: lengths, first centre, margin, cells, whether land is opaque."""
    lattice = layout.lattice
    pitch = lattice.pitch
    row = lattice.a2[1] if lattice.hexagonal else pitch[1]
    x, y = lattice.first_centre
    opaque = float(layout.window.land.opaque)
    return np.array([float(lattice.hexagonal), pitch[0], row, x, y, layout.margin, *lattice.count, opaque])
