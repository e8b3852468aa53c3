"""Non-sequential trace: light followed face by face, with walls, total reflection and split paths.

Rays travel in packets that share a state: upwards or downwards, at which body, inside its material or
outside. `clacad.tracing.reference.column` finds the first hit of each; downward packets live in the mirrored
window, where they travel upwards too. At a face a packet is refracted, reflected, split or ended.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from clacad.base.types import Bools, Floats, Ints, Rows
from clacad.optics.ledger import ABOVE, ASIDE, BACK, BACK_LAND, FRONT, FRONT_LAND, WALL, RayColumns
from clacad.optics.rays import Rays
from clacad.optics.surface import refract
from clacad.optics.surface.fresnel_coefficients import deviation, reflected
from clacad.sheet.face_order import lined_surfaces
from clacad.sheet.window import IDENTITY, Body, Face, Window
from clacad.tracing.layout import BodyPlan, Layout, lay_out, lenses, sheet_position
from clacad.tracing.reference import launch as honeycomb
from clacad.tracing.reference.column import Event, first_change
from clacad.tracing.reference.face import NUDGE, lens_normals, on_line, wall_normals
from clacad.tracing.reference.launch import Beam, box_span, launch, on_to, sheet_xy, to_array

FLIP = np.diag([1.0, 1.0, -1.0])


def mirrored(window: Window) -> Window:
    """The mirror image of a window in the plane z = 0: bodies in reverse order, arrays keep their numbers.

    Every surface is even in its own x and y, so the mirror image is that surface on its other side with
    the rotation F R F, F = diag(1, 1, −1), again a proper one. For tracing only: `law`, `thin` and `recipe`
    still describe the original window.
    """
    low, high = window.z_range
    joined = (False, *(body.joined for body in window.bodies[:0:-1]))
    bodies = tuple(
        _mirrored_body(body, joint) for body, joint in zip(reversed(window.bodies), joined, strict=True)
    )
    land = window.land
    if land.lined >= 0:
        land = replace(land, lined=2 * len(bodies) - 1 - land.lined)
    return replace(window, bodies=bodies, z_range=(-high, -low), land=land)


def _mirrored_body(body: Body, joined: bool) -> Body:
    return replace(body, front=_mirrored_face(body.back), back=_mirrored_face(body.front), joined=joined)


def _mirrored_face(face: Face) -> Face:
    x, y, z = face.vertex
    turned = IDENTITY if face.untilted else FLIP @ face.rotation @ FLIP
    return Face(
        surface=replace(face.surface, side=-face.surface.side),
        vertex=(x, y, -z),
        rotation=turned,
        array=face.array,
        land=None if face.land is None else -face.land,
        change=None if face.change is None else face.change.mirrored,
        sunk=face.sunk,
    )


State = tuple[bool, int, bool]

MARGIN = 64
"""Largest number of faces of a path beyond those of the sheet: a guard, far above that of relevant light."""


@dataclass(frozen=True, slots=True)
class Rules:
    """Rules at interfaces.

    walls : Pass walls and faces hit from their wrong side; else the light ends there.
    total : Go on after total internal reflection at a face; else the light ends there.
    losses : Fresnel: 1 − R is transmitted, and R is reflected.
    order : Largest number of partial reflections in a path; 0: nothing is split.
    faces : Largest number of faces after the first wall or total reflection.
    attenuation : one a body, 1/length
    media : refractive index before the first face and behind each
    coating, ratio : see `clacad.optics.surface.fresnel_coefficients.reflected`
    """

    walls: bool = False
    total: bool = False
    losses: bool = False
    order: int = 0
    faces: int = 8
    attenuation: tuple[float, ...] = ()
    media: tuple[float, ...] = ()
    coating: str = "none"
    ratio: float = 1.0


@dataclass(frozen=True, eq=False)
class Packet(RayColumns):
    """m rays of one state.

    beam : Its rows are row numbers of the launched rays.
    flux : (m,)
    path : (m,) lengths. Optical path from the start.
    position : (m, 3) sheet frame, last point hit
    gate : (m, 2) lengths, gate_cell : (m, 2) ints
        Point where the ray last left a body, relative to the cell it was in; for the baffle.
    gated : (m,) bool. Whether it has crossed the gap between the arrays since then.
    bounces : (m,) ints. Partial reflections so far.
    faces : (m,) ints. Number of faces hit.
    astray : (m,) ints. Number of faces hit since the first wall or total reflection; 0 before.
    """

    beam: Beam
    flux: Floats
    path: Floats
    position: Floats
    gate: Floats
    gate_cell: Ints
    gated: Bools
    bounces: Ints
    faces: Ints
    astray: Ints

    def __len__(self) -> int:
        return len(self.flux)


Cause = Literal["forward", "front", "wall", "total", "opaque", "aside", "cut", "absorbed"]
CAUSES: tuple[Cause, ...] = ("forward", "front", "wall", "total", "opaque", "aside", "cut", "absorbed")


@dataclass(frozen=True, eq=False)
class NonsequentialLight:
    """Result of a non-sequential trace.

    parent : (m,) ints. Launched ray of each piece of light.
    position, direction : (m, 3), sheet frame
    flux, optical_path : (m,)
    front : (m,) bool. Whether it left on the side it came from.
    bounces : (m,) ints. Number of partial reflections on its way.
    share : dict of (n,) arrays. For every launched ray, the share of its light by outcome; the shares sum to
        1. "forward" and "front" left the sheet; "wall", "total" and "opaque" ended there; "aside" left
        sideways; "absorbed" was absorbed; "cut" lay beyond the largest number of reflections or faces.
    """

    parent: Rows
    position: Floats
    direction: Floats
    flux: Floats
    optical_path: Floats
    front: Bools
    bounces: Ints
    share: dict[str, Floats]


def trace_nonsequential(window: Window, rays: Rays, rows: Rows, rules: Rules) -> NonsequentialLight:
    """Follow the light of some rays until it has left the sheet or ended.

    rows : (k,) ints. Rays that hit the sheet.
    rules : Its `indices` are one refractive index a body.
    """
    walk = _Packets(window, rays, rules)
    with np.errstate(all="ignore"):
        walk.launch(rows)
        walk.run()
    return walk.result()


class _Packets:
    """Packets under way and light that has left. Used once, inside `trace_nonsequential`."""

    def __init__(self, window: Window, rays: Rays, rules: Rules) -> None:
        self.rules = rules
        self.rays = rays
        self.layouts = {True: lay_out(window), False: lay_out(mirrored(window))}
        self.waiting: dict[State, list[Packet]] = {}
        self.out: list[tuple[Packet, bool]] = []
        self.share = {cause: np.zeros(len(rays)) for cause in CAUSES}
        self.limit = 2 * len(window.bodies) + MARGIN

    # -- start and end

    def launch(self, rows: Rows) -> None:
        """Put the launched rays `rows` (k,) before the first body; those that miss it end."""
        body = self.layouts[True].bodies[0]
        beam, carried = launch(self.layouts[True], body, self.rays.position, self.rays.direction, rows)
        beam = to_array(self.layouts[True], beam, body.arrays[0])
        m = len(beam)
        zero, none = np.zeros(m, dtype=np.int64), np.zeros((m, 2), dtype=np.int64)
        packet = Packet(
            beam,
            np.ones(m),
            carried,
            self.rays.position[beam.rows],
            np.zeros((m, 2)),
            none,
            np.zeros(m, dtype=bool),
            zero,
            zero,
            zero,
        )
        beside = np.setdiff1d(rows, beam.rows)
        self.share["aside"][beside] += 1.0
        self.out.append((packet.take(zero[:0]), True))  # nothing, in columns
        self.put((True, 0, False), packet)

    def put(self, state: State, packet: Packet) -> None:
        """Queue a packet for its next step, in the cells of its body's first array."""
        if not len(packet):
            return
        layout = self.layouts[state[0]]
        array = layout.bodies[state[1]].arrays[0]
        if packet.beam.array != array:
            packet = replace(packet, beam=to_array(layout, packet.beam, array))
        self.waiting.setdefault(state, []).append(packet)

    def end(self, cause: Cause, packet: Packet, flux: Floats | None = None) -> None:
        """Count the light of a packet, or `flux` (m,) of it, as ended."""
        np.add.at(self.share[cause], packet.beam.rows, packet.flux if flux is None else flux)

    def run(self) -> None:
        """Step packets until the queue is empty."""
        while self.waiting:
            state = min(self.waiting)
            packet = Packet.joined(self.waiting.pop(state))
            worn = (packet.faces > self.limit) | (packet.astray > self.rules.faces)
            if worn.any():
                self.end("cut", packet.take(worn))
                packet = packet.take(~worn)
            if len(packet):
                self.step(state, packet)

    def result(self) -> NonsequentialLight:
        """The light that has left, and the outcome of the rest."""
        whole = Packet.joined([packet for packet, _ in self.out])
        up = np.concatenate([np.full(len(packet), up) for packet, up in self.out])
        x, y, z = whole.beam.direction.T
        return NonsequentialLight(
            parent=whole.beam.rows,
            position=whole.position,
            direction=np.column_stack([x, y, np.where(up, z, -z)]),
            flux=whole.flux,
            optical_path=whole.path,
            front=~up,
            bounces=whole.bounces,
            share={str(cause): value for cause, value in self.share.items()},
        )

    # -- one step

    def step(self, state: State, packet: Packet) -> None:
        """Carry a packet to its first hit in its body, or out of it."""
        up, number, inside = state
        layout = self.layouts[up]
        body = layout.bodies[number]
        event = first_change(layout, body, packet.beam, inside)
        if not inside and layout.window.baffle is not None:
            packet, event = self.stopped(layout, number, packet, event)
        if inside:
            packet = self.absorbed(up, number, packet, event.distance)
        aside = event.kind == ASIDE
        self.end("aside", packet.take(aside))
        risen = event.kind == ABOVE
        if risen.any():
            # a ray that rose past a body keeps its last point; `leave` adds the gap
            self.leave(up, number, packet.take(risen))
        met = np.flatnonzero(~(aside | risen))
        if len(met):
            self.meet(state, packet.take(met), event.take(met))

    def absorbed(self, up: bool, number: int, packet: Packet, length: Floats) -> Packet:
        """The packet after lengths (m,) inside a body."""
        if not self.rules.attenuation:
            return packet
        rate = self.rules.attenuation[number if up else len(self.layouts[True].bodies) - 1 - number]
        flux = packet.flux * np.exp(-rate * length)
        self.end("absorbed", packet, packet.flux - flux)
        return replace(packet, flux=flux)

    def stopped(self, layout: Layout, number: int, packet: Packet, event: Event) -> tuple[Packet, Event]:
        """End rays that the honeycomb before a body stops."""
        of, array = layout.bodies[max(number - 1, 0)].arrays[-1], layout.bodies[number].arrays[0]
        met = event.starts[array] + event.distance[:, None] * packet.beam.direction[:, :2]
        share = honeycomb.reach(layout, (of, array), packet.gate, met, event.cells[array] - packet.gate_cell)
        blocked = packet.gated & np.isfinite(share)
        self.end("opaque", packet.take(blocked))
        on = ~blocked
        return packet.take(on), event.take(on)

    def leave(self, up: bool, number: int, packet: Packet) -> None:
        """Move from the space over a body to the next body, or out of the sheet."""
        layout = self.layouts[up]
        if number + 1 == len(layout.bodies):
            self.end("forward" if up else "front", packet)
            self.out.append((packet, up))
            return
        body = layout.bodies[number + 1]
        beam, gap = on_to(layout, packet.beam, layout.bodies[number], body)
        enter, leave = box_span(layout, body, sheet_xy(layout, beam), beam.direction)
        span = (body.high - body.low) / beam.direction[:, 2]
        reaches = (enter <= leave) & (leave >= 0.0) & (enter <= span) & np.isfinite(gap)
        stray: Cause = "aside" if layout.window.baffle is None else "opaque"
        self.end(stray, packet.take(~reaches))
        late = np.where(enter > 0.0, enter, 0.0)
        step = late[:, None] * beam.direction
        gate, gate_cell = packet.beam.local, packet.beam.cell
        beam = replace(beam, local=beam.local + step[:, :2], z=beam.z + step[:, 2])
        beam = to_array(layout, beam, body.arrays[0])
        moved = replace(
            packet,
            beam=beam,
            path=packet.path + gap + late,
            gate=gate,
            gate_cell=gate_cell,
            gated=np.ones(len(packet), dtype=bool),
        )
        self.put((up, number + 1, False), moved.take(reaches))

    # -- interfaces

    def meet(self, state: State, packet: Packet, event: Event) -> None:
        """End rays that may not continue; carry the rest to the interface and divide it."""
        up, number, inside = state
        layout = self.layouts[up]
        land = np.isin(event.kind, (FRONT_LAND, BACK_LAND))
        stops = land & layout.window.land.opaque | at_line(layout, number, packet.beam, event)
        if stops.any():
            self.end("opaque", packet.take(stops))
            packet, event = packet.take(~stops), event.take(~stops)
        right = (BACK, BACK_LAND) if inside else (FRONT, FRONT_LAND)
        astray = ~np.isin(event.kind, right)
        if not self.rules.walls and astray.any():
            self.end("wall", packet.take(astray))
            packet, event, astray = packet.take(~astray), event.take(~astray), astray[~astray]
        if not len(packet):
            return
        body = layout.bodies[number]
        normal = normals_met(layout, body, packet, event)
        packet = arrived(layout, body, packet, event, up, self.index(state))
        was = packet.astray
        packet = replace(packet, faces=packet.faces + 1, astray=np.where((was > 0) | astray, was + 1, 0))
        bad = ~np.isfinite(normal[:, 2])
        if bad.any():  # beyond the equator of a lens, where no face is
            self.end("wall", packet.take(bad))
            packet, normal, astray, event = packet.take(~bad), normal[~bad], astray[~bad], event.take(~bad)
        nudge = np.where((event.kind == WALL)[:, None], NUDGE * layout.halves.max() * normal[:, :2], 0.0)
        bodies = layout.bodies
        joined = inside and number + 1 < len(bodies) and bodies[number + 1].joined
        at_joint = np.isin(event.kind, (BACK, BACK_LAND)) & joined
        across = (up, number, not inside)
        if not at_joint.any():
            self.divide((state, across), packet, normal, astray, nudge)
            return
        for rows, beyond in ((at_joint, (up, number + 1, True)), (~at_joint, across)):
            if rows.any():
                hit = packet.take(rows)
                self.divide((state, beyond), hit, normal[rows], astray[rows], nudge[rows])

    def index(self, state: State) -> float:
        """Refractive index where packets of a state travel."""
        up, number, inside = state
        number = number if up else len(self.layouts[True].bodies) - 1 - number
        return self.rules.media[2 * number + 1] if inside else 1.0

    def divide(
        self, sides: tuple[State, State], packet: Packet, normal: Floats, astray: Bools, nudge: Floats
    ) -> None:
        """Send transmitted and reflected light on from interface normals (m, 3).

        sides : states before the interface and beyond it; nudge : (m, 2), over a wall
        """
        state, beyond = sides
        n1, n2 = self.index(state), self.index(beyond)
        ray = packet.beam.direction
        cos = np.maximum((ray * normal).sum(axis=1), 0.0)
        through, _ = refract(ray, normal, cos, n1, n2)
        total = np.isnan(through[:, 0])
        back = ray - 2.0 * cos[:, None] * normal
        lost = np.zeros(len(packet))
        if self.rules.losses:
            s, p = reflected(deviation(ray, through), n1, n2, self.rules.coating, self.rules.ratio)
            lost = np.where(total, 0.0, 0.5 * (s + p))
        passing = ~total
        sent = packet.take(passing)
        sent = replace(sent, flux=sent.flux * (1.0 - lost[passing]))
        if beyond[1] != state[1]:  # through a joint
            bodies = self.layouts[state[0]].bodies
            rise = bodies[beyond[1]].level - bodies[state[1]].level
            sent = replace(sent, beam=replace(sent.beam, z=sent.beam.z - rise))
        self.send(beyond, sent, through[passing], nudge[passing])
        goes = total & (astray | self.rules.total)
        self.end("total", packet.take(total & ~goes))
        turned = packet.take(goes)
        turned = replace(turned, astray=np.maximum(turned.astray, 1))
        self.send(state, turned, back[goes], -nudge[goes])
        if self.rules.losses:
            child = packet.take(passing)
            child = replace(child, flux=child.flux * lost[passing], bounces=child.bounces + 1)
            kept = child.bounces <= self.rules.order
            self.end("cut", child.take(~kept))
            self.send(state, child.take(kept), back[passing][kept], -nudge[passing][kept])

    def send(self, state: State, packet: Packet, direction: Floats, nudge: Floats) -> None:
        """Start rays with new directions (m, 3), in the window in which they travel upwards."""
        if not len(packet):
            return
        up, number, inside = state
        packet = replace(
            packet, beam=replace(packet.beam, direction=direction, local=packet.beam.local + nudge)
        )
        climbs = direction[:, 2] > 0.0
        self.put(state, packet.take(climbs))
        falls = packet.take(~climbs)
        other = len(self.layouts[True].bodies) - 1 - number
        here, there = self.layouts[up].bodies[number].level, self.layouts[not up].bodies[other].level
        turned = replace(
            falls.beam, z=-(falls.beam.z + here) - there, direction=falls.beam.direction * (1.0, 1.0, -1.0)
        )
        self.put((not up, other, inside), replace(falls, beam=turned))


def at_line(layout: Layout, number: int, beam: Beam, event: Event) -> Bools:
    """Which rays of a beam meet a face of a body on its opaque line, (m,)."""
    lined = [side for side in (0, 1) if 2 * number + side in lined_surfaces(layout.window)]
    if not lined:
        return np.zeros(len(beam.direction), dtype=bool)
    on = np.isin(event.kind, [((FRONT, FRONT_LAND), (BACK, BACK_LAND))[side] for side in lined])
    return on & on_line(layout, sheet_xy(layout, beam) + event.distance[:, None] * beam.direction[:, :2])


def normals_met(layout: Layout, body: BodyPlan, packet: Packet, event: Event) -> Floats:
    """Unit normals (m, 3) at the hits, on the side the rays go to."""
    ray = packet.beam.direction
    step = event.distance[:, None] * ray
    points = {array: start + step[:, :2] for array, start in event.starts.items()}
    z = packet.beam.z + step[:, 2]
    normal = np.zeros((len(packet), 3))
    normal[:, 2] = 1.0
    for kind, face in ((FRONT, body.front), (BACK, body.back)):
        on = event.kind == kind
        if face.array is not None and on.any():
            places = lenses(layout, face, event.cells[face.array][on])
            normal[on] = lens_normals(face, points[face.array][on], z[on], places)
    at_wall = event.kind == WALL
    if at_wall.any():
        xy = sheet_xy(layout, packet.beam) + step[:, :2]
        chosen = {array: point[at_wall] for array, point in points.items()}
        normal[at_wall, :2] = wall_normals(layout, body, ray[at_wall], chosen, xy[at_wall])
        normal[at_wall, 2] = 0.0
    backwards = (ray * normal).sum(axis=1) < 0.0
    return np.where(backwards[:, None], -normal, normal)


def arrived(layout: Layout, body: BodyPlan, packet: Packet, event: Event, up: bool, index: float) -> Packet:
    """Rays at their hits, in the cells of the body's first array, after a medium of index `index`."""
    array, beam = body.arrays[0], packet.beam
    local = event.starts[array] + event.distance[:, None] * beam.direction[:, :2]
    z = beam.z + event.distance * beam.direction[:, 2]
    for kind, face in ((FRONT_LAND, body.front), (BACK_LAND, body.back)):
        z = np.where(event.kind == kind, face.land, z)
    at = Beam(beam.rows, array, event.cells[array], local, z, beam.direction)
    position = sheet_position(layout, array, at.cell, local, z + body.level)
    position[:, 2] *= 1.0 if up else -1.0
    path = packet.path + index * event.distance
    gated = np.zeros(len(packet), dtype=bool)
    return replace(packet, beam=at, path=path, position=position, gated=gated)
