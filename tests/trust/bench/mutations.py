"""What is done to a file before it is handed in: to its triangles, its instances, its text, its solids, its manifest."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from trust.spoiling import Change, document_of, glb, model_changed

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Move = Callable[[Floats], Floats]
"""Vertices (v, 3) of a file, millimetres, in; their new positions out."""

# -- triangles ------------------------------------------------------------------------------------------


def moved(by: Move) -> Change:
    """The same triangles over moved vertices."""
    return lambda vertices, triangles: (by(vertices), triangles)


def scaled(factor: float) -> Change:
    """Everything larger by a factor, in every direction."""
    return moved(lambda v: v * factor)


def shifted(*step: float) -> Change:
    """Everything elsewhere."""
    return moved(lambda v: v + np.array(step))


def turned(axis: tuple[float, float, float], degrees: float) -> Change:
    """Everything turned about an axis through the origin."""
    return moved(lambda v: v @ rotation(axis, degrees).T)


def rotation(axis: tuple[float, float, float], degrees: float) -> Floats:
    """Rotation (3, 3) about an axis."""
    x, y, z = np.array(axis) / np.linalg.norm(axis)
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    angle = np.radians(degrees)
    return np.asarray(np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross)


def noisy(micrometres: float) -> Change:
    """Heights off by so much rms, each point of the surface by its own."""

    def by(vertices: Floats) -> Floats:
        points, which = np.unique(vertices, axis=0, return_inverse=True)
        off = np.random.default_rng(0).normal(scale=1e-3 * micrometres, size=len(points))
        return vertices + np.column_stack([np.zeros((len(vertices), 2)), off[which.ravel()]])

    return moved(by)


def mirrored(vertices: Floats, triangles: Ints) -> tuple[Floats, Ints]:
    """The mirror image, a proper solid."""
    return vertices * [-1.0, 1.0, 1.0], triangles[:, ::-1].copy()


def inside_out(vertices: Floats, triangles: Ints) -> tuple[Floats, Ints]:
    """Every facet turned over."""
    return vertices, triangles[:, ::-1].copy()


def one_missing(vertices: Floats, triangles: Ints) -> tuple[Floats, Ints]:
    """A facet in the middle of the file left out."""
    return vertices, np.delete(triangles, len(triangles) // 2, axis=0)


def one_turned(vertices: Floats, triangles: Ints) -> tuple[Floats, Ints]:
    """A facet turned over."""
    triangles = triangles.copy()
    triangles[len(triangles) // 2] = triangles[len(triangles) // 2, ::-1]
    return vertices, triangles


def one_doubled(vertices: Floats, triangles: Ints) -> tuple[Floats, Ints]:
    """A facet twice, another not at all."""
    return vertices, np.concatenate([triangles[:-1], triangles[:1]])


def without(where: Callable[[Floats], NDArray[np.bool_]]) -> Change:
    """The facets left out that a function of the corners (t, 3, 3) selects."""
    return lambda vertices, triangles: (vertices, triangles[~where(vertices[triangles])])


def walls(corners: Floats) -> NDArray[np.bool_]:
    """Which facets are vertical."""
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return np.asarray(np.abs(across[:, 2]) <= 0.05 * np.linalg.norm(across, axis=1))


def inside(
    cell: tuple[float, float], half: float, low: float, high: float
) -> Callable[[Floats], NDArray[np.bool_]]:
    """Which points (v, 3) lie inside a square about a middle, in a range of heights."""

    def told(points: Floats) -> NDArray[np.bool_]:
        across = np.abs(points[:, :2] - np.array(cell)).max(axis=1)
        return np.asarray((across < half * (1.0 - 1e-4)) & (points[:, 2] > low) & (points[:, 2] < high))

    return told


def steeper(part: Callable[[Floats], NDArray[np.bool_]], factor: float, rim: float) -> Change:
    """Relief of a part of the surface times a factor, from the height of its rim: a wrong radius."""

    def by(vertices: Floats) -> Floats:
        vertices, chosen = vertices.copy(), part(vertices)
        vertices[chosen, 2] = rim + factor * (vertices[chosen, 2] - rim)
        return vertices

    return moved(by)


def dented(at: tuple[float, float], low: float, high: float, radius: float, depth: float) -> Change:
    """A soft dent of a radius and depth, millimetres, in the part between two heights."""

    def by(vertices: Floats) -> Floats:
        vertices = vertices.copy()
        r2 = ((vertices[:, :2] - np.array(at)) ** 2).sum(axis=1) / radius**2
        chosen = (r2 < 1.0) & (vertices[:, 2] > low) & (vertices[:, 2] < high)
        vertices[chosen, 2] += depth * (1.0 - r2[chosen]) ** 2
        return vertices

    return moved(by)


def part_moved(part: Callable[[Floats], NDArray[np.bool_]], *step: float) -> Change:
    """A part of the file elsewhere."""

    def by(vertices: Floats) -> Floats:
        return vertices + part(vertices)[:, None] * np.array(step)

    return moved(by)


def part_turned(part: Callable[[Floats], NDArray[np.bool_]], degrees: float) -> Change:
    """A part of the file turned about the sheet's normal."""

    def by(vertices: Floats) -> Floats:
        chosen = part(vertices)
        vertices = vertices.copy()
        vertices[chosen] = vertices[chosen] @ rotation((0.0, 0.0, 1.0), degrees).T
        return vertices

    return moved(by)


def above(height: float) -> Callable[[Floats], NDArray[np.bool_]]:
    """Which points lie above a height."""
    return lambda points: points[:, 2] > height


def exchanged(height: float, low: float, high: float) -> Change:
    """Two bodies change places along z: the one above a height moves down, the one below moves up."""

    def by(vertices: Floats) -> Floats:
        upper = vertices[:, 2] > height
        vertices = vertices.copy()
        top, bottom = vertices[upper, 2], vertices[~upper, 2]
        vertices[upper, 2] = top - 0.5 * (top.min() + top.max()) + low
        vertices[~upper, 2] = bottom - 0.5 * (bottom.min() + bottom.max()) + high
        return vertices

    return moved(by)


def only(where: Callable[[Floats], NDArray[np.bool_]]) -> Change:
    """Facets that a function of the middle (t, 3) selects; the others are left out."""
    return lambda vertices, triangles: (vertices, triangles[where(vertices[triangles].mean(axis=1))])


def drilled(at: tuple[float, float], radius: float, height: float) -> Change:
    """A round hole through everything, closed as a solid is."""

    def change(vertices: Floats, triangles: Ints) -> tuple[Floats, Ints]:
        import manifold3d

        points, which = np.unique(vertices, axis=0, return_inverse=True)
        body = manifold3d.Manifold(manifold3d.Mesh64(points, which.ravel()[triangles].astype(np.uint64)))
        tool = manifold3d.Manifold.cylinder(3.0 * height, radius, circular_segments=48)
        left = (body - tool.translate((*at, -height))).to_mesh64()
        return np.asarray(left.vert_properties[:, :3]), np.asarray(left.tri_verts, dtype=np.int64)

    return change


# -- files that repeat a cell, and normals -----------------------------------------------------------------


def nodes_changed(data: bytes, change: Callable[[list[Any]], Any]) -> bytes:
    """A GLB file with the nodes that have a translation changed."""
    document, binary = document_of(data)
    change([node for node in document["nodes"] if "translation" in node])
    return glb(document, binary)


_COMPONENT = r'<component objectid="(\d+)" transform="1 0 0 0 1 0 0 0 1 (\S+) (\S+) (\S+)"/>\n'


def places_changed(data: bytes, change: Callable[[re.Match[str]], str], times: int = 1) -> bytes:
    """A 3MF file with its first instances changed."""

    def model(text: str) -> str:
        text, count = re.subn(_COMPONENT, change, text, count=times)
        assert count == times
        return text

    return model_changed(data, model)


def place_moved(step: float) -> Callable[[re.Match[str]], str]:
    """An instance moved along x, millimetres."""
    return lambda m: m[0].replace(f" {m[2]} ", f" {float(m[2]) + step!r} ", 1)


def glb_normals(data: bytes, change: Callable[[Floats], Floats]) -> bytes:
    """A GLB file with the normals of its first mesh changed."""
    document, binary = document_of(data)
    accessor = document["accessors"][document["meshes"][0]["primitives"][0]["attributes"]["NORMAL"]]
    start = document["bufferViews"][accessor["bufferView"]].get("byteOffset", 0) + accessor.get(
        "byteOffset", 0
    )
    stored = np.frombuffer(binary, "<f4", 3 * accessor["count"], start).reshape(-1, 3)
    made = change(stored.astype(np.float64)).astype("<f4").tobytes()
    return glb(document, binary[:start] + made + binary[start + len(made) :])


def glb_without_normals(data: bytes) -> bytes:
    """A GLB file that leaves normals to its reader."""
    document, binary = document_of(data)
    for mesh in document["meshes"]:
        for primitive in mesh["primitives"]:
            del primitive["attributes"]["NORMAL"]
    return glb(document, binary)


def ply_normals(data: bytes, change: Callable[[Floats], Floats]) -> bytes:
    """A PLY file, x y z nx ny nz in doubles, with its normals changed."""
    head, mark, body = data.partition(b"end_header\n")
    found = re.search(rb"element vertex (\d+)", head)
    assert found is not None
    assert re.findall(rb"property double (\w+)", head) == [b"x", b"y", b"z", b"nx", b"ny", b"nz"]
    table = np.frombuffer(body, "<f8", 6 * int(found[1])).reshape(-1, 6).copy()
    table[:, 3:] = change(table[:, 3:])
    return head + mark + table.tobytes() + body[table.nbytes :]


def leaning(degrees: float) -> Callable[[Floats], Floats]:
    """Normals turned about x."""
    return lambda normals: normals @ rotation((1.0, 0.0, 0.0), degrees).T


def across_negated(normals: Floats) -> Floats:
    """Normals with x and y negated: still unit vectors, still outward, of a surface curved the other way."""
    return normals * [-1.0, -1.0, 1.0]


# -- the text of a STEP file ----------------------------------------------------------------------------


def pole_lifted(text: str, by: float) -> str:
    """The middle pole of one lens patch lies too high."""
    grids = re.findall(r"B_SPLINE_SURFACE\(2,2,(\(\(.*?\)\)),\.UNSPECIFIED", text)
    name = grids[0].split(",")[4].strip("()")
    line = next(line for line in text.splitlines() if line.startswith(f"{name}=CARTESIAN_POINT"))
    x, y, z = line.rpartition("(")[2].rstrip(");").split(",")
    return text.replace(line, f"{name}=CARTESIAN_POINT('',({x},{y},{float(z) + by!r}));")


def patches_exchanged(text: str) -> str:
    """Two lens patches have each other's poles."""
    one, _, other, *_ = re.findall(r"B_SPLINE_SURFACE\(2,2,(\(\(.*?\)\)),\.UNSPECIFIED", text)
    return text.replace(one, "@").replace(other, one).replace("@", other)


def face_left_out(text: str) -> str:
    """A shell lacks a face."""
    return re.sub(r"(CLOSED_SHELL\('[^']*',\()#\d+,", r"\1", text, count=1)


def face_turned(text: str) -> str:
    """A lens face looks inward."""
    lens = re.search(r"ADVANCED_FACE\('lens',\(#\d+\),#\d+,\.([TF])\.\)", text)
    assert lens is not None
    return text.replace(lens[0], f"{lens[0][:-4]}.{({'T': 'F', 'F': 'T'})[lens[1]]}.)")


def in_metres(text: str) -> str:
    """The numbers of a file in millimetres, called metres."""
    return text.replace(".MILLI.,.METRE.", "$,.METRE.")


def numbers_times(text: str, factor: float) -> str:
    """Every point further out by a factor."""

    def grown(found: re.Match[str]) -> str:
        return found[1] + ",".join(repr(factor * float(v)) for v in found[2].split(",")) + ")"

    return re.sub(r"(=CARTESIAN_POINT\('[^']*',\()([^,()]+,[^,()]+,[^,()]+)\)", grown, text)


def _placement(text: str, usage: str) -> tuple[str, str]:
    """Line of the placement of an instance, and the line of its point."""
    later = text[text.index(f"NEXT_ASSEMBLY_USAGE_OCCURRENCE('{usage}'") :]
    found = re.search(r"ITEM_DEFINED_TRANSFORMATION\('','',#\d+,(#\d+)\)", later)
    assert found is not None
    place = re.search(rf"^{found[1]}=AXIS2_PLACEMENT_3D\('',(#\d+),.*$", text, re.M)
    assert place is not None
    point = re.search(rf"^{place[1]}=CARTESIAN_POINT.*$", text, re.M)
    assert point is not None
    return place[0], point[0]


def instance_moved(text: str, usage: str, *step: float) -> str:
    """An instance is placed elsewhere, millimetres."""
    _, line = _placement(text, usage)
    name, _, numbers = line.rpartition("(")
    x, y, z = (float(v) + s for v, s in zip(numbers.rstrip(");").split(","), step, strict=True))
    return text.replace(line, f"{name}({x!r},{y!r},{z!r}));")


def instance_turned(text: str, usage: str, degrees: float) -> str:
    """An instance is turned about the sheet's normal."""
    line, _ = _placement(text, usage)
    angle = np.radians(degrees)
    direction = f"#9999999=DIRECTION('',({float(np.cos(angle))!r},{float(np.sin(angle))!r},0.));\n"
    return text.replace(line, direction + re.sub(r",#\d+\);$", ",#9999999);", line))


def instance_left_out(text: str, usage: str) -> str:
    """An instance is not there."""
    start = text.rindex("\n", 0, text.index(f"NEXT_ASSEMBLY_USAGE_OCCURRENCE('{usage}'")) + 1
    last = text.index("CONTEXT_DEPENDENT_SHAPE_REPRESENTATION", start)
    return text[:start] + text[text.index("\n", last) + 1 :]


def instance_on_another(text: str, usage: str, other: str) -> str:
    """An instance is placed where another one is too."""
    (_, one), (_, two) = _placement(text, usage), _placement(text, other)
    return text.replace(one, one.partition("=")[0] + "=" + two.partition("=")[2])


# -- solids by the CAD kernel ---------------------------------------------------------------------------


def read_solid(data: bytes, folder: Path) -> Any:
    """Shape of a STEP file."""
    from OCP.STEPControl import STEPControl_Reader

    path = folder / "before.step"
    path.write_bytes(data)
    reader = STEPControl_Reader()
    reader.ReadFile(str(path))
    reader.TransferRoots()
    path.unlink()
    return reader.OneShape()


def solids_of(shape: Any) -> list[Any]:
    """Solids of a shape, from the lowest up."""
    from OCP.Bnd import Bnd_Box
    from OCP.BRepBndLib import BRepBndLib
    from OCP.TopAbs import TopAbs_ShapeEnum
    from OCP.TopExp import TopExp_Explorer

    found, explorer = [], TopExp_Explorer(shape, TopAbs_ShapeEnum.TopAbs_SOLID)
    while explorer.More():
        box = Bnd_Box()
        BRepBndLib.Add_s(explorer.Current(), box)
        found.append((box.CornerMin().Z(), len(found), explorer.Current()))
        explorer.Next()
    return [solid for _, _, solid in sorted(found, key=lambda row: row[:2])]


def compound(solids: list[Any]) -> Any:
    """One shape of several."""
    from OCP.BRep import BRep_Builder
    from OCP.TopoDS import TopoDS_Compound

    whole, builder = TopoDS_Compound(), BRep_Builder()
    builder.MakeCompound(whole)
    for solid in solids:
        builder.Add(whole, solid)
    return whole


@contextmanager
def _unit(name: str) -> Iterator[None]:
    from OCP.Interface import Interface_Static

    Interface_Static.SetCVal_s("write.step.unit", name)
    try:
        yield
    finally:
        Interface_Static.SetCVal_s("write.step.unit", "MM")


def step_bytes(shape: Any, folder: Path, unit: str = "MM") -> bytes:
    """STEP file of a shape as another program writes it: "MM", "INCH" or "M"."""
    from OCP.STEPControl import STEPControl_StepModelType, STEPControl_Writer

    path = folder / "after.step"
    writer = STEPControl_Writer()
    with _unit(unit):
        writer.Transfer(shape, STEPControl_StepModelType.STEPControl_AsIs)
        writer.Write(str(path))
    data = path.read_bytes()
    path.unlink()
    return data


def brep_bytes(shape: Any, folder: Path) -> bytes:
    """BREP file of a shape."""
    from OCP.BRepTools import BRepTools

    path = folder / "after.brep"
    BRepTools.Write_s(shape, str(path))
    data = path.read_bytes()
    path.unlink()
    return data


def assembly_bytes(
    solids: list[Any], folder: Path, levels: int = 1, unit: str = "MM", step: float = 0.0
) -> bytes:
    """STEP file of an assembly: every solid a part, a number of levels deep, none of them at home.

    Each part is written away from its place and put back by its placements; `step` leaves the last one off by its value, mm.
    """
    from OCP.gp import gp_Trsf, gp_Vec
    from OCP.STEPCAFControl import STEPCAFControl_Writer
    from OCP.TCollection import TCollection_ExtendedString
    from OCP.TDocStd import TDocStd_Document
    from OCP.TopLoc import TopLoc_Location
    from OCP.XCAFDoc import XCAFDoc_DocumentTool

    def away(*by: float) -> Any:
        move = gp_Trsf()
        move.SetTranslation(gp_Vec(*by))
        return TopLoc_Location(move)

    document = TDocStd_Document(TCollection_ExtendedString("BinXCAF"))
    tool = XCAFDoc_DocumentTool.ShapeTool_s(document.Main())
    lifted = 0.5 * (levels - 1)  # every further level puts its content so much higher
    labels = [tool.AddShape(solid.Moved(away(1.0 + k, -2.0, 3.0)), False) for k, solid in enumerate(solids)]
    places = [away(-1.0 - k, 2.0, -3.0 - lifted) for k in range(len(solids))]
    places[-1] = away(-float(len(solids)), 2.0 + step, -3.0 - lifted)
    for _ in range(levels):
        whole = tool.NewShape()
        for label, place in zip(labels, places, strict=True):
            tool.AddComponent(whole, label, place)
        labels, places = [whole], [away(0.0, 0.0, 0.5)]
    tool.UpdateAssemblies()
    path = folder / "after.step"
    writer = STEPCAFControl_Writer()
    with _unit(unit):
        writer.Transfer(document)
        writer.Write(str(path))
    data = path.read_bytes()
    path.unlink()
    return data


def squeezed(shape: Any, factor: float) -> Any:
    """Every height times a factor: sags, thickness and gap alike."""
    from OCP.BRepBuilderAPI import BRepBuilderAPI_GTransform
    from OCP.gp import gp_GTrsf

    change = gp_GTrsf()
    change.SetValue(3, 3, factor)
    return BRepBuilderAPI_GTransform(shape, change, True).Shape()


def splined(shape: Any, tolerance: float) -> Any:
    """Every surface a polynomial B-spline, fitted within a tolerance, mm."""
    from OCP.BRepBuilderAPI import BRepBuilderAPI_NurbsConvert
    from OCP.GeomAbs import GeomAbs_Shape
    from OCP.ShapeCustom import ShapeCustom, ShapeCustom_RestrictionParameters

    plain = BRepBuilderAPI_NurbsConvert(shape, True).Shape()
    return ShapeCustom.BSplineRestriction_s(
        plain, tolerance, tolerance, 8, 64, GeomAbs_Shape.GeomAbs_C1, GeomAbs_Shape.GeomAbs_C1, True, True,
        ShapeCustom_RestrictionParameters(),
    )  # fmt: skip


def bored(shape: Any, at: tuple[float, float], radius: float) -> Any:
    """A round hole through everything."""
    from OCP.BRepAlgoAPI import BRepAlgoAPI_Cut
    from OCP.BRepPrimAPI import BRepPrimAPI_MakeCylinder
    from OCP.gp import gp_Ax2, gp_Dir, gp_Pnt

    tool = BRepPrimAPI_MakeCylinder(gp_Ax2(gp_Pnt(*at, -50.0), gp_Dir(0.0, 0.0, 1.0)), radius, 100.0).Shape()
    return BRepAlgoAPI_Cut(shape, tool).Shape()


def carried(shape: Any, axis: tuple[float, float, float], degrees: float, *step: float) -> Any:
    """A shape turned about an axis through the origin, and moved."""
    from OCP.BRepBuilderAPI import BRepBuilderAPI_Transform
    from OCP.gp import gp_Ax1, gp_Dir, gp_Pnt, gp_Trsf, gp_Vec

    turn, go = gp_Trsf(), gp_Trsf()
    turn.SetRotation(gp_Ax1(gp_Pnt(0.0, 0.0, 0.0), gp_Dir(*axis)), float(np.radians(degrees)))
    go.SetTranslation(gp_Vec(*step))
    return BRepBuilderAPI_Transform(shape, go.Multiplied(turn), True).Shape()


# -- manifests ------------------------------------------------------------------------------------------


def vouched(manifest: bytes, name: str, data: bytes, **stated: Any) -> bytes:
    """The manifest with this file's entry alone, its hash and size forged, and more that is stated."""
    document = json.loads(manifest)
    entry = next(e for e in document["files"] if e["name"] == name)
    document["files"] = [entry | {"sha256": sha256(data).hexdigest(), "bytes": len(data)} | stated]
    return json.dumps(document).encode()


def listing(manifest: bytes, entries: list[Mapping[str, Any]]) -> bytes:
    """The manifest with these entries, of any kind."""
    return json.dumps(json.loads(manifest) | {"files": entries}).encode()
