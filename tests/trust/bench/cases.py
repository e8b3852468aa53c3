"""The cases of the bench: a file, how it is handed in, and the verdict that is optically right.

`right` is one of

* master: it may be made; passed as optical master, exit status 0
* shape: good to look at, light misses the law; shape only (exit status 0 only where it was declared a preview)
* unfit: light misses the law, or the file is damaged; any word but a pass, or refused
* fail: damaged; failed, or refused
* withheld: nothing was judged; not judged, or failed, or refused
* scan: a measured surface of a good part; passed as scan
* light: master or unfit, as the independent tracer finds in the triangles of the file
* either: so near the design that light cannot distinguish it; only its not crashing is tested
"""

from __future__ import annotations

import json
import time
import tomllib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any

from trust.bench import mutations as mu
from trust.bench import readers, tracer
from trust.running import TINY
from trust.spoiling import Change, changed, model_changed

from clacad.design import Design
from clacad.exporting.run import export
from clacad.prescription.prescribe import prescribe
from clacad.verification import verify

RAYS = 8192
FINE, COARSE = 32, 8
MESHES = ("stl", "ply", "glb", "3mf")

SLAB = TINY.replace('"tiny"', '"part"').replace("[2, 2]", "[3, 3]")
PAIR = SLAB.replace('"slab"', '"biconvex"\nthickness = "auto"').replace("[0.01, -0.02]", "[0.0, 0.0]")
TILTED = SLAB.replace("[0.01, -0.02]", "[0.01, -0.02]\neuler = [30.0, 1.0, 20.0]")
HEXAGONAL = SLAB.replace("-0.5, -1.0", "-0.5, -0.5").replace("pitch", 'kind = "hexagonal"\npitch')
WIDE = """
[check]
law_rms = "60 mrad"
law_bias = "60 mrad"
eta = 0.2
delta = 0.05
confocality = 0.03
throughput = 0.5
"""
BLOCK = SLAB.replace("-0.5, -1.0", "-0.5, -0.5").replace("3, 3", "10, 10") + WIDE
THIN = SLAB.replace("10.0", "3.0").replace("3, 3", "20, 20").replace("-0.5, -1.0", "-0.5, -0.5") + WIDE
KITS = {"slab": SLAB, "pair": PAIR, "tilted": TILTED, "hexagonal": HEXAGONAL, "block": BLOCK, "thin": THIN}
FINE_OF = {"block": 16, "thin": 8, "hexagonal": 16}
"""Quads at which a kit's mesh is a master, where not 32."""


@dataclass(frozen=True, eq=False)
class Kit:
    """A small design and what was written from it."""

    design: Design
    window: Any
    optic: tracer.Optics
    home: Path
    fine: int

    @cache  # noqa: B019 - a kit lives as long as the test run
    def files(self, quads: int, formats: tuple[str, ...] = MESHES, **options: Any) -> dict[str, bytes]:
        """Files of an export by name, its manifest among them."""
        folder = self.home / "-".join(
            [str(quads), *formats, *(f"{k}{v}" for k, v in sorted(options.items()))]
        )
        export(self.design, folder, formats=formats, quads=quads, **options)
        return {path.name: path.read_bytes() for path in folder.iterdir() if path.name != "run.json"}

    def mesh(self, format: str, quads: int | None = None) -> tuple[str, bytes, bytes]:
        """Name, bytes and manifest of a mesh file."""
        made = self.files(quads or self.fine)
        return f"part.{format}", made[f"part.{format}"], made["manifest.json"]

    def step(self, **options: Any) -> tuple[str, bytes, bytes]:
        """Name, bytes and manifest of a STEP file."""
        made = self.files(4, ("step",), **options)
        return "part.step", made["part.step"], made["manifest.json"]

    @property
    def height(self) -> tuple[float, float]:
        """Lowest and highest point, mm."""
        low, high = self.window.z_range
        return float(low), float(high)

    @property
    def middle(self) -> float:
        """Height halfway: between the bodies of a pair, inside a slab."""
        return self.optic.split[0] if self.optic.split else 0.5 * sum(self.height)

    def back_cell(self, i: int, j: int) -> tuple[float, float]:
        """Middle of the back cell i, j cells from the middle one."""
        x, y = self.optic.centres[1] + self.optic.pitch * [i, j]
        return float(x), float(y)

    def back_lens(self, i: int, j: int) -> Callable[..., Any]:
        """Points of the back of a slab that lie inside a cell."""
        return mu.inside(self.back_cell(i, j), 0.5 * self.optic.pitch[0], self.middle, 1e3)

    @property
    def rim(self) -> float:
        """Lowest height of the back of a slab, about."""
        return float(self.optic.faces[-1][1][5][2]) - 0.03


class Kits:
    """The kits, made when they are first used."""

    def __init__(self, home: Path) -> None:
        self.home, self._made = home, dict[str, Kit]()

    def __getitem__(self, name: str) -> Kit:
        if name not in self._made:
            design = Design.from_dict(tomllib.loads(KITS[name]))
            window = prescribe(design)
            fine = FINE_OF.get(name, FINE)
            self._made[name] = Kit(design, window, tracer.optics(design, window), self.home / name, fine)
        return self._made[name]


Make = Callable[[Kit, Path], Path]


@dataclass(frozen=True, eq=False)
class Case:
    """One file handed in.

    name : what, of which file, how
    kit : name of the design
    right : the verdict that is optically right; see above
    make : writes it into an empty folder and returns what to hand in
    options : of `verify`
    declared : whether it is a preview that was declared to be one
    warns : check that must at least warn
    """

    name: str
    kit: str
    right: str
    make: Make
    options: dict[str, Any] = field(default_factory=dict)
    declared: bool = False
    warns: str = ""


# -- how it is handed in --------------------------------------------------------------------------------


def _alone(folder: Path, name: str, data: bytes) -> Path:
    (folder / name).write_bytes(data)
    return folder / name


def _vouched(folder: Path, name: str, data: bytes, manifest: bytes, **stated: Any) -> Path:
    (folder / name).write_bytes(data)
    (folder / "manifest.json").write_bytes(mu.vouched(manifest, name, data, **stated))
    return folder


def _delivered(how: str, folder: Path, name: str, data: bytes, manifest: bytes) -> Path:
    return _alone(folder, name, data) if how == "alone" else _vouched(folder, name, data, manifest)


def _spoilt(format: str, how: str, change: Callable[[Kit], Change], quads: int | None = None) -> Make:
    """A mesh file with its triangles changed."""

    def make(kit: Kit, folder: Path) -> Path:
        name, data, manifest = kit.mesh(format, quads)
        return _delivered(how, folder, name, changed(name, data, change(kit)), manifest)

    return make


def _bytes(format: str, how: str, change: Callable[[bytes], bytes], quads: int | None = None) -> Make:
    """A mesh file with its bytes changed."""

    def make(kit: Kit, folder: Path) -> Path:
        name, data, manifest = kit.mesh(format, quads)
        made = change(data)
        assert made != data
        return _delivered(how, folder, name, made, manifest)

    return make


# -- cases ----------------------------------------------------------------------------------------------

HOW = ("alone", "forged")


def _copies() -> Iterator[Case]:
    for kit in ("slab", "pair", "tilted", "hexagonal"):
        for format in MESHES if kit in ("slab", "pair") else ("stl", "3mf"):
            for how in HOW:
                yield Case(f"copy: {kit} {format} {how}", kit, "master", _same(format, how))
    for kit in ("slab", "pair"):
        for format in MESHES:
            for how in HOW:
                coarse = _same(format, how, COARSE)
                yield Case(f"coarse: {kit} {format} {how}", kit, "shape", coarse)
            said = _same(format, "forged", COARSE, role="shape-preview", role_declared=True)
            yield Case(f"coarse, declared in its manifest: {kit} {format}", kit, "shape", said, declared=True)
    for format in ("stl", "glb"):
        yield Case(f"coarse, declared when handed in: {format}", "slab", "shape", _same(format, "alone", COARSE),
                   {"role": "preview"}, declared=True)  # fmt: skip
        yield Case(f"coarse, said to be a master: {format}", "slab", "unfit", _same(format, "forged", COARSE,
                   role="optical-master", role_declared=True))  # fmt: skip
        yield Case(f"fine, declared a preview when handed in: {format}", "slab", "shape", _same(format, "alone"),
                   {"role": "preview"}, declared=True)  # fmt: skip
        yield Case(f"coarse, declared a preview, judged as a master: {format}", "slab", "unfit",
                   _same(format, "forged", COARSE, role="shape-preview", role_declared=True), {"role": "master"})  # fmt: skip


def _same(format: str, how: str, quads: int | None = None, **stated: Any) -> Make:
    def make(kit: Kit, folder: Path) -> Path:
        name, data, manifest = kit.mesh(format, quads)
        return (
            _alone(folder, name, data) if how == "alone" else _vouched(folder, name, data, manifest, **stated)
        )

    return make


DAMAGES: dict[str, tuple[str, Callable[[Kit], Change]]] = {
    "one facet missing": ("fail", lambda kit: mu.one_missing),
    "one facet turned": ("fail", lambda kit: mu.one_turned),
    "one facet doubled": ("fail", lambda kit: mu.one_doubled),
    "inside out": ("fail", lambda kit: mu.inside_out),
    "mirrored": ("fail", lambda kit: mu.mirrored),
    "noise of .1 um": ("light", lambda kit: mu.noisy(0.1)),
    "radius of the middle lens 1 % off": ("light", lambda kit: mu.steeper(kit.back_lens(0, 0), 1.01, kit.rim)),
    "radius of the middle lens 5 % off": ("light", lambda kit: mu.steeper(kit.back_lens(0, 0), 1.05, kit.rim)),
    "radius of a corner lens 5 % off": ("fail", lambda kit: mu.steeper(kit.back_lens(-1, 1), 1.05, kit.rim)),
    "a corner lens dented by 5 um": ("fail", lambda kit: mu.dented(kit.back_cell(1, 1), kit.middle, 1e3, 0.15, -5e-3)),
    "a lens left out": ("fail", lambda kit: mu.without(
        lambda corners: kit.back_lens(1, -1)(corners.mean(axis=1)))),
    "1 % too thick": ("light", lambda kit: mu.part_moved(mu.above(kit.middle), 0.0, 0.0, 0.01 * kit.height[1])),
}  # fmt: skip
"""Damage to a slab's triangles; right with a manifest that vouches for it and with none."""

POSES: dict[str, tuple[str, Callable[[Kit], Change]]] = {
    "moved by 5 mm": ("master", lambda kit: mu.shifted(5.0, 0.0, 0.0)),
    "moved by 10 um": ("master", lambda kit: mu.shifted(0.006, -0.008, 0.0)),
    "turned by 90 degrees": ("master", lambda kit: mu.turned((0.0, 0.0, 1.0), 90.0)),
    "turned by 63 degrees about an oblique axis": ("master", lambda kit: mu.turned((1.0, 2.0, 0.5), 63.0)),
    "shrunk by .05 %": ("master", lambda kit: mu.scaled(0.9995)),
    "shrunk by .2 %": ("fail", lambda kit: mu.scaled(0.998)),
    "grown by .2 %": ("fail", lambda kit: mu.scaled(1.002)),
}
"""Position and size of a part without a manifest: irrelevant for its light up to the limit of scale."""


def _triangles() -> Iterator[Case]:
    for what, (right, change) in DAMAGES.items():
        for format in MESHES:
            for how in HOW:
                yield Case(f"{what}: slab {format} {how}", "slab", right, _spoilt(format, how, change))
    for what, (right, change) in POSES.items():
        for format in MESHES:
            yield Case(f"{what}: slab {format}", "slab", right, _spoilt(format, "alone", change))
    for kit in ("block", "thin"):
        turn = POSES["turned by 63 degrees about an oblique axis"][1]
        yield Case(f"copy: {kit} stl", kit, "master", _same("stl", "alone"))
        yield Case(
            f"turned by 63 degrees about an oblique axis: {kit} stl",
            kit,
            "master",
            _spoilt("stl", "alone", turn),
        )
    for what in ("noise of .1 um", "inside out", "one facet missing"):
        yield Case(
            f"{what}, coarse: slab stl alone",
            "slab",
            "unfit",
            _spoilt("stl", "alone", DAMAGES[what][1], COARSE),
        )
    for format in ("stl", "ply"):
        yield Case(
            f"in inches: slab {format}",
            "slab",
            "master",
            _spoilt(format, "alone", lambda kit: mu.scaled(1 / 25.4)),
        )
        yield Case(
            f"in metres: slab {format}",
            "slab",
            "master",
            _spoilt(format, "alone", lambda kit: mu.scaled(1e-3)),
        )
        yield Case(f"25.4 times as large: slab {format} forged", "slab", "fail",
                   _spoilt(format, "forged", lambda kit: mu.scaled(25.4)))  # fmt: skip
    for how in HOW:
        inches = _bytes("3mf", how, lambda d: model_changed(d, lambda t: t.replace('"millimeter"', '"inch"')))
        yield Case(f"numbers in mm, called inches: 3mf {how}", "slab", "fail", inches)
        yield Case(f"drilled: slab stl {how}", "slab", "fail", _spoilt("stl", how, lambda kit: mu.drilled(
            kit.back_cell(1, 0), 0.1, kit.height[1])))  # fmt: skip
    yield Case("numbers and unit in inches: 3mf alone", "slab", "master", _inches)


def _inches(kit: Kit, folder: Path) -> Path:
    name, data, _ = kit.mesh("3mf")
    made = changed(name, data, mu.scaled(1 / 25.4))
    return _alone(folder, name, model_changed(made, lambda text: text.replace('"millimeter"', '"inch"')))


BETWEEN: dict[str, tuple[str, Callable[[Kit], Change]]] = {
    "gap 1 % too wide": ("light", lambda kit: mu.part_moved(mu.above(kit.middle), 0.0, 0.0, 0.1)),
    "gap 1 % too narrow": ("light", lambda kit: mu.part_moved(mu.above(kit.middle), 0.0, 0.0, -0.1)),
    "gap .02 % too wide": ("either", lambda kit: mu.part_moved(mu.above(kit.middle), 0.0, 0.0, 0.002)),
    "second body 60 um aside": ("light", lambda kit: mu.part_moved(mu.above(kit.middle), 0.06, 0.0, 0.0)),
    "second body turned by 4 degrees": ("light", lambda kit: mu.part_turned(mu.above(kit.middle), 4.0)),
}
"""What is wrong between two bodies that are good each."""


def _bodies() -> Iterator[Case]:
    for what, (right, change) in BETWEEN.items():
        for format in ("stl", "ply"):
            for how in HOW:
                yield Case(f"{what}: pair {format} {how}", "pair", right, _spoilt(format, how, change))
    swapped = lambda kit: mu.exchanged(kit.middle, 0.0, 10.0)  # noqa: E731
    for format in (
        "stl",
        "ply",
    ):  # lenses alike on both sides: it is the part turned over, if no manifest states how it lies
        for how, right in (("alone", "master"), ("forged", "fail")):
            yield Case(f"bodies exchanged: pair {format} {how}", "pair", right, _spoilt(format, how, swapped))
    first = mu.only(lambda middle: middle[:, 2] < 5.0)
    second = mu.only(lambda middle: middle[:, 2] > 5.0)
    for format in ("stl", "ply"):
        for label, kept in (("first", first), ("second", second)):
            make = _spoilt(format, "alone", lambda kit, kept=kept: kept)
            yield Case(f"the {label} body alone: pair {format}", "pair", "master", make, warns="bodies")
        yield Case(f"one body of two, said to be both: pair {format}", "pair", "fail",
                   _spoilt(format, "forged", lambda kit: first))  # fmt: skip
        make = _one_body_said(format)
        yield Case(
            f"one body of two, as its manifest says: pair {format}", "pair", "master", make, warns="bodies"
        )


def _one_body_said(format: str) -> Make:
    def make(kit: Kit, folder: Path) -> Path:
        name, data, manifest = kit.mesh(format)
        made = changed(name, data, mu.only(lambda middle: middle[:, 2] < 5.0))
        return _vouched(folder, name, made, manifest, bodies=["array1"], volume=None)

    return make


INSTANCES: dict[str, tuple[str, Callable[[bytes], bytes]]] = {
    "3mf: an instance moved by 4 % of the pitch": ("3mf", lambda d: mu.places_changed(d, mu.place_moved(0.02))),
    "3mf: a row of instances moved by 4 % of the pitch": ("3mf", lambda d: mu.places_changed(d, mu.place_moved(0.02), 3)),
    "3mf: an instance left out": ("3mf", lambda d: mu.places_changed(d, lambda m: "")),
    "3mf: an instance twice": ("3mf", lambda d: mu.places_changed(d, lambda m: 2 * m[0])),
    "glb: an instance moved by 4 % of the pitch": ("glb", lambda d: mu.nodes_changed(d, lambda n: _node(n[4], 0.02))),
    "glb: a row of instances moved by 4 % of the pitch": (
        "glb", lambda d: mu.nodes_changed(d, lambda n: [_node(one, 0.02) for one in n[:3]])),
    "glb: an instance on another": (
        "glb", lambda d: mu.nodes_changed(d, lambda n: n[1].update(translation=list(n[0]["translation"])))),
}  # fmt: skip
"""Cells that are written once and repeated in wrong places."""


def _node(node: dict[str, Any], step: float) -> None:
    node["translation"][0] += step


def _repeated() -> Iterator[Case]:
    for what, (format, change) in INSTANCES.items():
        for how in HOW:
            yield Case(f"{what}: pair {how}", "pair", "fail", _bytes(format, how, change))
    negated, lean = mu.across_negated, mu.leaning(5.0)
    for how in HOW:
        yield Case(f"normals negated in x and y: glb {how}", "slab", "fail", _bytes("glb", how, lambda d: mu.glb_normals(d, negated)))  # fmt: skip
        yield Case(f"normals negated in x and y: pair glb {how}", "pair", "fail", _bytes("glb", how, lambda d: mu.glb_normals(d, negated)))  # fmt: skip
        yield Case(f"normals leaning by 5 degrees: glb {how}", "slab", "fail", _bytes("glb", how, lambda d: mu.glb_normals(d, lean)))  # fmt: skip
        yield Case(
            f"without normals: glb {how}", "slab", "master", _bytes("glb", how, mu.glb_without_normals)
        )
        yield Case(f"normals negated in x and y: ply {how}", "slab", "fail", _bytes("ply", how, lambda d: mu.ply_normals(d, negated)))  # fmt: skip
        yield Case(f"normals leaning by 5 degrees: ply {how}", "slab", "fail", _bytes("ply", how, lambda d: mu.ply_normals(d, lean)))  # fmt: skip


# -- manifests ------------------------------------------------------------------------------------------


def _said(of: str, cut: int, change: Change | None = None, **stated: Any) -> Make:
    def make(kit: Kit, folder: Path) -> Path:
        name, data, manifest = kit.mesh(of, cut)
        made = data if change is None else changed(name, data, change)
        return _vouched(folder, name, made, manifest, **stated)

    return make


FORGERIES: dict[str, dict[str, Any]] = {
    'bodies ["frame"]': {"bodies": ["frame"]},
    'bodies ["x"]': {"bodies": ["x"]},
    "no bodies": {"bodies": []},
    'format "blob"': {"format": "blob"},
    'format "coupon"': {"format": "coupon"},
    'role "other"': {"role": "other", "role_declared": True},
    "an unknown role": {"role": "trust me", "role_declared": True},
}
"""Statements of a manifest about a file that is never looked at because of them."""


def _manifests() -> Iterator[Case]:
    for what, stated in FORGERIES.items():
        yield Case(
            f"manifest says {what}: coarse stl", "slab", "unfit or withheld", _said("stl", COARSE, **stated)
        )
        damaged = _said("stl", FINE, mu.one_missing, **stated)
        yield Case(f"manifest says {what}: damaged stl", "slab", "unfit or withheld", damaged)
    large = {"slope_error_rms": 0.5, "sag_error_max": 0.05, "quads": 1}
    for change, label in ((mu.noisy(0.1), "noisy"), (mu.mirrored, "mirrored")):
        yield Case(
            f"manifest states large errors: {label} stl", "slab", "unfit", _said("stl", FINE, change, **large)
        )
    yield Case("manifest states large errors: coarse stl", "slab", "unfit", _said("stl", COARSE, **large))
    yield Case("manifest states no errors: coarse stl", "slab", "unfit",
               _said("stl", COARSE, slope_error_rms=1e-9, sag_error_max=1e-9))  # fmt: skip
    for change, label in (
        (mu.one_missing, "a facet missing"),
        (mu.mirrored, "mirrored"),
        (mu.noisy(5.0), "noisy"),
    ):
        said = {"role": "shape-preview", "role_declared": True}
        yield Case(f"manifest says preview: {label}", "slab", "fail", _said("stl", FINE, change, **said))
    yield Case("manifest lists nothing", "slab", "withheld", _listing(lambda entry: []))
    yield Case("manifest lists an empty entry", "slab", "withheld", _listing(lambda entry: [{}]))
    yield Case(
        "manifest lists a name alone",
        "slab",
        "unfit or withheld",
        _listing(lambda entry: [{"name": "part.stl"}]),
    )
    yield Case(
        "manifest lists another file",
        "slab",
        "withheld",
        _listing(lambda entry: [entry | {"name": "other.stl"}]),
    )
    for format in MESHES:
        yield Case(f"bytes changed after the manifest: {format}", "slab", "fail", _stale(format))


def _listing(entries: Callable[[dict[str, Any]], list[Any]]) -> Make:
    def make(kit: Kit, folder: Path) -> Path:
        name, data, manifest = kit.mesh("stl", COARSE)
        (folder / name).write_bytes(data)
        entry = next(e for e in json.loads(manifest)["files"] if e["name"] == name)
        (folder / "manifest.json").write_bytes(mu.listing(manifest, entries(entry)))
        return folder

    return make


def _stale(format: str) -> Make:
    def make(kit: Kit, folder: Path) -> Path:
        name, data, manifest = kit.mesh(format)
        (folder / "manifest.json").write_bytes(mu.vouched(manifest, name, data))
        made = bytearray(data)
        made[-3] ^= 1
        (folder / name).write_bytes(bytes(made))
        return folder

    return make


# -- solids ---------------------------------------------------------------------------------------------

SMALL = "a pole lifted by 1e-4 of the pitch"
TEXTS: dict[str, Callable[[str], str]] = {
    SMALL: lambda text: mu.pole_lifted(text, 5e-5),
    "a pole lifted by 1 % of the pitch": lambda text: mu.pole_lifted(text, 5e-3),
    "lens patches exchanged": mu.patches_exchanged,
    "a face left out": mu.face_left_out,
    "a lens face turned over": mu.face_turned,
    "cut in half": lambda text: text[: len(text) // 2],
    "numbers in mm, called metres": mu.in_metres,
}
PLACES: dict[str, Callable[[str], str]] = {
    "a row moved by 4 % of the pitch": lambda text: mu.instance_moved(text, "array2 row 2", 0.02, 0.0, 0.0),
    "a cell in a row moved by 4 % of the pitch": lambda text: mu.instance_moved(
        text, "array1 2", 0.02, 0.0, 0.0
    ),
    "a row moved by 4 % of the pitch in z": lambda text: mu.instance_moved(
        text, "array2 row 3", 0.0, 0.0, 0.02
    ),
    "a row moved by 4 % of the pitch along its column": lambda text: mu.instance_moved(
        text, "array2 row 1", 0.0, 0.02, 0.0
    ),
    "a row turned by 2 degrees": lambda text: mu.instance_turned(text, "array2 row 2", 2.0),
    "a row left out": lambda text: mu.instance_left_out(text, "array2 row 2"),
    "a row on another": lambda text: mu.instance_on_another(text, "array1 row 1", "array1 row 2"),
}
LONG = {"step": "instanced", "cells": (2, 150)}


def _text(how: str, change: Callable[[str], str], **options: Any) -> Make:
    def make(kit: Kit, folder: Path) -> Path:
        name, data, manifest = kit.step(**options)
        made = change(data.decode())
        assert made != data.decode()
        return _delivered(how, folder, name, made.encode(), manifest)

    return make


def _solid(write: Callable[[Kit, Any, Path], bytes], name: str = "part.step", **options: Any) -> Make:
    """A file that another program made of ours."""

    def make(kit: Kit, folder: Path) -> Path:
        shape = mu.read_solid(kit.step(**options)[1], folder)
        return _alone(folder, name, write(kit, shape, folder))

    return make


def _as_written(how: str, format: str = "step", **options: Any) -> Make:
    def make(kit: Kit, folder: Path) -> Path:
        made = kit.files(4, (format,), **options)
        return _delivered(how, folder, f"part.{format}", made[f"part.{format}"], made["manifest.json"])

    return make


def _solids() -> Iterator[Case]:
    for kit in ("slab", "pair", "tilted", "hexagonal"):
        for how in HOW:
            yield Case(f"copy: {kit} step {how}", kit, "master", _as_written(how))
            yield Case(f"copy: {kit} brep {how}", kit, "master", _as_written(how, "brep"))
    for how in HOW:
        yield Case(f"copy: pair step instanced {how}", "pair", "master", _as_written(how, step="instanced"))
        yield Case(f"copy: pair step 2 x 150 {how}", "pair", "master", _as_written(how, **LONG))
        for what, change in TEXTS.items():
            # 12 nm in the middle of one lens turn light by .05 mrad: no defect but to a manifest that vouches for the bytes
            right = "master" if how == "alone" and what == SMALL else "fail"
            yield Case(f"{what}: slab step {how}", "slab", right, _text(how, change))
        for what, change in PLACES.items():
            yield Case(
                f"{what}: pair step instanced {how}", "pair", "fail", _text(how, change, step="instanced")
            )
        for row in (40, 77, 150):
            yield Case(f"row {row} of 150 moved by 4 % of the pitch: pair step {how}", "pair", "fail", _text(
                how, lambda text, row=row: mu.instance_moved(text, f"array1 row {row}", 0.02, 0.0, 0.0), **LONG))  # fmt: skip
    for unit in ("MM", "INCH", "M"):
        for kit in ("slab", "pair"):
            again = _solid(lambda kit, shape, folder, unit=unit: mu.step_bytes(shape, folder, unit))
            yield Case(f"written again in {unit}: {kit} step", kit, "master", again)
            for levels in (1, 3):
                yield Case(f"written again in {unit} as an assembly of {levels} levels: {kit} step", kit, "master",
                           _solid(_assembled(unit, levels)))  # fmt: skip
        wrong = _solid(_assembled(unit, 2, 0.06))
        yield Case(
            f"written again in {unit} as an assembly, one part 60 um aside: pair step", "pair", "fail", wrong
        )
        yield Case(f"written again in {unit}, the first body alone: pair step", "pair", "master",
                   _solid(_first_alone(unit)), warns="bodies")  # fmt: skip
    yield from _reworked()


def _assembled(unit: str, levels: int, step: float = 0.0) -> Callable[[Kit, Any, Path], bytes]:
    return lambda kit, shape, folder: mu.assembly_bytes(mu.solids_of(shape), folder, levels, unit, step)


def _first_alone(unit: str) -> Callable[[Kit, Any, Path], bytes]:
    return lambda kit, shape, folder: mu.step_bytes(mu.solids_of(shape)[0], folder, unit)


def _reworked() -> Iterator[Case]:
    for format in ("step", "brep"):
        name, write = f"part.{format}", mu.step_bytes if format == "step" else mu.brep_bytes

        def put(
            change: Callable[[Kit, Any], Any], name: str = name, write: Any = write, **options: Any
        ) -> Make:
            return _solid(lambda kit, shape, folder: write(change(kit, shape), folder), name, **options)

        yield Case(f"lenses fitted anew within 1e-7 mm: slab {format}", "slab", "master",
                   put(lambda kit, shape: mu.splined(shape, 1e-7)))  # fmt: skip
        yield Case(
            f"1 % flatter: slab {format}", "slab", "fail", put(lambda kit, shape: mu.squeezed(shape, 0.99))
        )
        yield Case(
            f"1 % flatter: pair {format}", "pair", "fail", put(lambda kit, shape: mu.squeezed(shape, 0.99))
        )
        yield Case(f"moved by 5 mm: slab {format}", "slab", "master",
                   put(lambda kit, shape: mu.carried(shape, (0.0, 0.0, 1.0), 0.0, 5.0, 0.0, 0.0)))  # fmt: skip
        yield Case(f"turned by 90 degrees: slab {format}", "slab", "master",
                   put(lambda kit, shape: mu.carried(shape, (0.0, 0.0, 1.0), 90.0, 0.0, 0.0, 0.0)))  # fmt: skip
        yield Case(f"turned by 63 degrees about an oblique axis: slab {format}", "slab", "master",
                   put(lambda kit, shape: mu.carried(shape, (1.0, 2.0, 0.5), 63.0, 1.0, 2.0, 3.0)))  # fmt: skip
        yield Case(
            f"a 4 x 4 piece: slab {format}", "slab", "master", put(lambda kit, shape: shape, cells=(4, 4))
        )
        yield Case(f"a 4 x 4 piece with a drilled hole: slab {format}", "slab", "fail",
                   put(lambda kit, shape: mu.bored(shape, (0.25, -0.25), 0.1), cells=(4, 4)))  # fmt: skip


# -- scans ----------------------------------------------------------------------------------------------


def _open(change: Callable[[Kit], Change] | None = None) -> Callable[[Kit], Change]:
    """Both faces without the sides, as they are measured."""

    def both(kit: Kit) -> Change:
        def made(vertices: Any, triangles: Any) -> Any:
            if change is not None:
                vertices, triangles = change(kit)(vertices, triangles)
            return mu.without(mu.walls)(vertices, triangles)

        return made

    return both


def _scans() -> Iterator[Case]:
    good = {
        "open": _open(),
        "open, noise of 5 nm": _open(lambda kit: mu.noisy(0.005)),
        "open, moved by 5 mm": _open(lambda kit: mu.shifted(5.0, 0.0, 0.0)),
    }
    bad = {
        "open, 1 % too thick": _open(DAMAGES["1 % too thick"][1]),
        "open, a corner lens dented by 20 um": _open(
            lambda kit: mu.dented(kit.back_cell(1, 1), kit.middle, 1e3, 0.2, -20e-3)),
        "open, mirrored": _open(lambda kit: mu.mirrored),
        "open, radius of the middle lens 5 % off": _open(DAMAGES["radius of the middle lens 5 % off"][1]),
    }  # fmt: skip
    for format in ("stl", "ply"):
        for options, label in (({"role": "scan"}, "declared"), ({}, "not declared")):
            for what, change in good.items():
                yield Case(
                    f"{what}, {label}: slab {format}",
                    "slab",
                    "scan",
                    _spoilt(format, "alone", change),
                    options,
                )
            for what, change in bad.items():
                yield Case(
                    f"{what}, {label}: slab {format}",
                    "slab",
                    "fail",
                    _spoilt(format, "alone", change),
                    options,
                )
        yield Case(
            f"closed, declared a scan: slab {format}",
            "slab",
            "scan",
            _same(format, "alone"),
            {"role": "scan"},
        )
        yield Case(f"closed, inside out, declared a scan: slab {format}", "slab", "either",
                   _spoilt(format, "alone", lambda kit: mu.inside_out), {"role": "scan"})  # fmt: skip
        for noise in (0.1, 0.3):
            noisy = _open(lambda kit, noise=noise: mu.noisy(noise))
            yield Case(f"open, noise of {noise} um, declared: slab {format}", "slab", "either",
                       _spoilt(format, "alone", noisy), {"role": "scan"})  # fmt: skip
    yield Case("open, a master by its manifest: slab stl", "slab", "fail", _spoilt("stl", "forged", _open()))


@cache
def every_case() -> tuple[Case, ...]:
    """All cases, in their order."""
    parts = (_copies, _triangles, _bodies, _repeated, _manifests, _solids, _scans)
    return tuple(case for part in parts for case in part())


# -- judging --------------------------------------------------------------------------------------------

PASSED = ("passed as optical master", "passed as scan", "passed")
WORDS = {
    "master": {"passed as optical master"}, "scan": {"passed as scan"}, "shape": {"shape only"}, "fail": {"failed", "refused"},
    "unfit": {"failed", "shape only", "refused"}, "withheld": {"not judged", "failed", "refused"},
    "unfit or withheld": {"failed", "shape only", "not judged", "refused"},
}  # fmt: skip


@dataclass(frozen=True)
class Outcome:
    """Result of a case.

    right : as settled by light, where the case left it to that
    word : of the verdict; "refused" where the file was not taken
    kind : "right", "false pass", "false fail", "wrong word" or "no warning"
    failed : ids of the checks that failed
    """

    case: Case
    right: str
    word: str
    status: int
    failed: tuple[str, ...]
    kind: str
    seconds: float

    def __str__(self) -> str:
        return f"{self.kind}: {self.case.name}: {self.word} ({self.status}; {', '.join(self.failed)}), right is {self.right}"


def settled(case: Case, kit: Kit, place: Path) -> str:
    """The verdict that is right, found by light where the case requires it."""
    if case.right != "light":
        return case.right
    path = place if place.is_file() else next(p for p in place.iterdir() if p.suffix[1:] in MESHES)
    found = tracer.measure(kit.optic, readers.triangles(path.name, path.read_bytes()))
    return "either" if found.near(0.1) else "master" if found.fit_for_making else "unfit"


def judged(case: Case, kits: Kits, folder: Path) -> Outcome:
    """Make a case in a new folder, hand it in, and compare the verdict with the right one."""
    kit = kits[case.kit]
    folder.mkdir()
    place = case.make(kit, folder)
    right = settled(case, kit, place)
    began = time.process_time()
    warned: set[str] = set()
    try:
        report = verify(kit.design, place, rays=RAYS, **case.options)
    except Exception as error:
        if not hasattr(error, "exit_status") and not isinstance(error, FileNotFoundError):
            raise  # no refusal but a defect
        word, status, failed = "refused", int(getattr(error, "exit_status", 2)), ()
    else:
        word, status = report.word, report.exit_status
        failed = tuple(dict.fromkeys(c.id for c in report.checks if c.state == "fail"))
        warned = {c.id for c in report.checks if c.state in ("warn", "fail")}
    outcome = Outcome(case, right, word, status, failed, "", time.process_time() - began)
    return replace(outcome, kind=_kind(case, outcome, warned))


def _kind(case: Case, outcome: Outcome, warned: set[str]) -> str:
    right, word, status = outcome.right, outcome.word, outcome.status
    if right == "either":
        return "right"
    declared = right == "shape" and case.declared
    if word in PASSED and (
        right not in ("master", "scan") or (right == "scan") != (word == "passed as scan")
    ):
        return "false pass"
    if status == 0 and right not in ("master", "scan") and not declared:
        return "false pass"
    if status != 0 and (right in ("master", "scan") or declared):
        return "false fail"
    if word not in WORDS[right]:
        return "wrong word"
    return "no warning" if case.warns and case.warns not in warned else "right"
