"""Files of sheets with a field lens: masters that pass, and files of slightly other ones that light distinguishes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from trust.bench import mutations

import clacad
from clacad import load, prescribe
from clacad.optics.surface import resized
from clacad.solid.solids import solids

DESIGNS = Path(__file__).parents[2] / "designs"


def sheet(name, cells=3, **keys):
    """A shipped design of few cells with a field lens and keys changed, a.b written a__b."""
    changes = {key.replace("__", "."): value for key, value in keys.items()}
    few = {"pair.field_lens": True, "lattice.count": [cells, cells]}
    return load(DESIGNS / f"{name}.toml").replace(few | changes)


def failing(report):
    return {check.id for check in report.checks if check.state == "fail"}


@pytest.mark.slow
def test_two_plates_are_written_and_judged_as_masters(tmp_path):
    design = sheet("window-100mm")
    made = clacad.export(design, tmp_path, formats=["step", "sag"])
    assert made
    report = clacad.verify(design, files=tmp_path)
    assert failing(report) == set()
    assert {verdict.word for verdict in report.verdicts} == {"passed as optical master"}
    solids = next(
        check for check in report.checks if check.id == "readable" and check.subject.endswith(".step")
    )
    assert "2 solids" in solids.sentence


@pytest.mark.ci_cases("two plates, offset", "tilted", "slab of three bodies, offset")
@pytest.mark.slow
@pytest.mark.parametrize(
    "design",
    [
        sheet("paper-a-covered"),
        sheet("window-100mm", law__eta=[-0.5, -0.5], law__delta=[0.01, 0.03], check__process="none"),
        sheet("paper-a-covered", law__eta=[-1.0, -1.0], law__euler=[0.0, 3.0, 0.0]),
        sheet("plano", law__delta=[0.02, -0.01]),
        sheet("window-100mm", law__eta=[-0.5, -1.0], law__delta=[0.01, 0.02], check__process="none"),
    ],
    ids=["biconvex", "two plates, offset", "tilted", "plano, offset", "slab of three bodies, offset"],
)
def test_every_form_is_written_and_judged_as_master(tmp_path, design):
    clacad.export(design, tmp_path, formats=["step"])
    report = clacad.verify(design, files=tmp_path, rays=4096)
    assert [verdict.word for verdict in report.verdicts] == ["passed as optical master"]
    assert not [check for check in report.checks if check.state == "fail" and check.subject.endswith(".step")]


@pytest.mark.slow
@pytest.mark.parametrize(
    "other",
    [
        {"pair.field_lens": False},
        {"pair.field": {"gap": 0.5}},
        {"law.eta": [-1.05, -1.05]},
    ],
    ids=["no field lens", "a wide gap", "another law"],
)
def test_light_tells_the_file_of_another_sheet(tmp_path, other):
    design = sheet("window-100mm")
    clacad.export(design.replace(other), tmp_path, formats=["step"])
    report = clacad.verify(design, files=next(tmp_path.glob("*.step")), rays=4096)
    assert failing(report)


# -- written files that were changed: the manifest vouches for them, what is in them does not ----------------------


def weaker_by_a_fiftieth(window):
    """The sheet whose field faces have radii 2 % larger."""

    def grown(face):
        return replace(face, surface=resized(face.surface, 1.02)) if face.array == 2 else face

    return replace(
        window, bodies=tuple(replace(b, front=grown(b.front), back=grown(b.back)) for b in window.bodies)
    )


def changed(window):
    """Solids of changed sheets, and a check that must fail of each."""
    made = solids(window)
    first, field, *last = [solid.wrapped for solid in made]
    yield [first, mutations.carried(field, (0, 0, 1), 0.0, 0.005, 0.0, 0.0), *last], "faithful_rms"  # 5 µm
    yield [first, mutations.carried(field, (0, 0, 1), 0.0, 0.0, 0.0, 0.005), *last], "shape"
    yield [solid.wrapped for solid in solids(weaker_by_a_fiftieth(window))], "faithful_rms"
    yield [first, *last], "solids"
    if not last:
        return
    field_z, last_z = (0.5 * (b.min.Z + b.max.Z) for b in (s.bounding_box() for s in made[1:]))
    lift = last_z - field_z
    swapped = [mutations.carried(field, (0, 0, 1), 0.0, 0.0, 0.0, lift), mutations.carried(last[0], (0, 0, 1), 0.0, 0.0, 0.0, -lift)]  # fmt: skip
    yield [first, *swapped], "shape"
    over = mutations.carried(mutations.carried(field, (1, 0, 0), 180.0), (0, 0, 1), 0.0, 0.0, 0.0, 2.0 * field_z)  # fmt: skip
    yield [first, over, *last], "file_law_rms"
    yield [first, mutations.carried(field, (0, 0, 1), 90.0), *last], "file_law_rms"


@pytest.mark.parametrize(
    "name",
    [
        pytest.param("window-100mm", marks=pytest.mark.slow),
        *(pytest.param(name, marks=pytest.mark.long) for name in ("paper-a-covered", "plano", "slab")),
    ],
)
def test_a_changed_field_lens_fails_however_its_manifest_vouches(tmp_path, name):
    design = (
        sheet("window-100mm", law__eta=[-0.5, -1.0], check__process="none") if name == "slab" else sheet(name)
    )
    clacad.export(design, tmp_path, formats=["step"])
    path, manifest = next(tmp_path.glob("*.step")), tmp_path / "manifest.json"
    honest, cases = manifest.read_bytes(), list(changed(prescribe(design)))
    assert len(cases) == (4 if name == "window-100mm" else 7)
    for shapes, check in cases:
        data = mutations.step_bytes(mutations.compound(shapes), tmp_path)
        path.write_bytes(data)
        manifest.write_bytes(mutations.vouched(honest, path.name, data))
        report = clacad.verify(design, files=tmp_path, rays=4096)
        assert [verdict.word for verdict in report.verdicts] == ["failed"], check
        assert check in failing(report)


@pytest.mark.slow
def test_the_field_faces_in_the_file_are_the_closed_form_and_the_bytes_are_the_same_again(tmp_path):
    """Points of the patches by the CAD kernel against the conics of the crossed cylinders, K = −n²; files made twice."""
    from OCP.BRepAdaptor import BRepAdaptor_Surface
    from OCP.BRepCheck import BRepCheck_Analyzer
    from OCP.GeomAbs import GeomAbs_SurfaceType
    from OCP.TopAbs import TopAbs_ShapeEnum
    from OCP.TopExp import TopExp_Explorer
    from OCP.TopoDS import TopoDS

    design = sheet("paper-a-covered")
    for folder in ("one", "two"):
        clacad.export(design, tmp_path / folder, formats=["step", "stl-parts"])
    files = sorted(path.name for path in (tmp_path / "one").iterdir())
    assert {f"{design.name}.{body}.stl" for body in ("array1", "field", "array2")} <= set(files)
    for name in files:
        if name != "run.json":  # which records how long it took
            assert (tmp_path / "one" / name).read_bytes() == (tmp_path / "two" / name).read_bytes(), name
    window = prescribe(design)
    n, pitch = window.bodies[1].index, 1e3 * window.lattice.pitch[0]
    shape = mutations.read_solid(next((tmp_path / "one").glob("*.step")).read_bytes(), tmp_path)
    assert BRepCheck_Analyzer(shape).IsValid()
    field = mutations.solids_of(shape)[1]
    explorer, seen = TopExp_Explorer(field, TopAbs_ShapeEnum.TopAbs_FACE), 0
    while explorer.More():
        surface = BRepAdaptor_Surface(TopoDS.Face(explorer.Current()))
        explorer.Next()
        if surface.GetType() == GeomAbs_SurfaceType.GeomAbs_Plane:
            continue
        u = np.linspace(surface.FirstUParameter(), surface.LastUParameter(), 7)[1:-1]
        v = np.linspace(surface.FirstVParameter(), surface.LastVParameter(), 7)[1:-1]
        points = [surface.Value(float(a), float(b)) for a in u for b in v]
        x, y, z = np.array([[p.X(), p.Y(), p.Z()] for p in points]).T
        front = abs(z.mean() - 1e3 * window.faces[2].vertex[2]) < abs(
            z.mean() - 1e3 * window.faces[3].vertex[2]
        )
        across, face, side = (y, window.faces[2], 1) if front else (x, window.faces[3], -1)
        radius = 1e3 / (face.surface.curvature_y if front else face.surface.curvature_x)
        # (n − 1) f_F, thin; lenses as thick as the paper's change it a little
        assert radius == pytest.approx((n - 1.0) * 50.0 * (0.25 if front else 0.16), rel=0.1)
        local = across - pitch * np.round(across / pitch)
        sag = local**2 / (radius * (1.0 + np.sqrt(1.0 - (1.0 - n**2) * local**2 / radius**2)))
        np.testing.assert_allclose(z, 1e3 * face.vertex[2] + side * sag, atol=1e-9)
        seen += 1
    assert seen == 18
