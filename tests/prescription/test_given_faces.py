"""Given prescriptions: built unchanged, the same on every path, refused where they are no lens; goldens re-traced."""

from __future__ import annotations

import json
import tomllib
from math import inf, radians
from pathlib import Path

import numpy as np
import pytest

from clacad import Design, DesignError, Fate, Rays, load, plan_effects, prescribe, trace
from clacad.base.sobol import sobol
from clacad.optics.surface import Biconic, EvenPolynomial, Quadric

DESIGNS = Path(__file__).parents[2] / "designs"
GOLDEN = json.loads((Path(__file__).parents[1] / "data" / "optimised.json").read_text())["cases"]

SLAB = {
    "format": 1,
    "name": "given",
    "unit": "mm",
    "law": {"eta": [-1.0, -1.0]},
    "pair": {
        "form": "slab",
        "separation": 10.0,
        "index": 1.5,
        "prescription": "given",
        "face": [{"radius": 2.5, "conic": -4 / 9}, {"radius": [2.5, 2.5], "conic": [-4 / 9, -4 / 9]}],
    },
    "lattice": {"kind": "square", "pitch": 0.5, "count": [4, 4]},
}


def changed(**pair):
    data = json.loads(json.dumps(SLAB))
    data["pair"] |= pair
    return data


def as_given(design):
    """The same design with the faces that its recipe found written down."""
    window = prescribe(design)
    faces = [
        {"radius": [1.0 / c if c else "inf" for c in (s.curvature_x, s.curvature_y)],
         "conic": [s.conic_x, s.conic_y] if isinstance(s, Biconic) else [s.kappa / c - 1.0 if c else 0.0 for c in (s.curvature_x, s.curvature_y)]}
        for s in (face.surface for face in window.faces)
    ]  # fmt: skip
    data = json.loads(json.dumps(dict(design.given)))
    for key in ("confocal", "surface", "conic", "depth"):
        data["pair"].pop(key, None)
    if design.pair.form != "slab":
        data["pair"]["thickness"] = list(window.recipe["T"])
    data["pair"] |= {"prescription": "given", "face": faces}
    return Design.from_dict(data), window


@pytest.mark.parametrize("name", ["paper-a-covered", "plano", "slab", "galilean", "tilted"])
def test_the_faces_a_recipe_found_give_the_same_sheet_when_they_are_given(name):
    design = load(DESIGNS / f"{name}.toml")
    given, window = as_given(design)
    built = prescribe(given)
    for one, two in zip(built.faces, window.faces, strict=True):
        assert one.array == two.array
        np.testing.assert_allclose(one.vertex, two.vertex, rtol=1e-9, atol=1e-12)
        np.testing.assert_array_equal(one.rotation, two.rotation)
        x, y = np.random.default_rng(0).uniform(-0.4, 0.4, (2, 40)) * min(window.lattice.pitch)
        np.testing.assert_allclose(one.surface.sag(x, y), two.surface.sag(x, y), rtol=1e-12, atol=1e-18)
    np.testing.assert_allclose(built.recipe["f"], window.recipe["f"], rtol=1e-9)


@pytest.mark.parametrize("name", [pytest.param("paper-a-covered", marks=pytest.mark.slow), "slab"])
def test_effects_are_planned_for_given_faces_as_for_those_a_recipe_found(name):
    """Reflections by the number of faces there are, ghosts by the field: no effect depends on how a face was found."""
    design = load(DESIGNS / f"{name}.toml")
    one, two = (plan_effects(which).rows for which in (design, as_given(design)[0]))
    assert [(row.effect, row.state) for row in one] == [(row.effect, row.state) for row in two]
    for a, b in zip(one, two, strict=True):
        assert (a.angle, a.radiance) == pytest.approx((b.angle, b.radiance), rel=1e-6, abs=1e-15)


def golden_design(case):
    """A golden prescription as a design file's dictionary."""
    faces = []
    for face in case["faces"]:
        terms = {(i, j): v for i, j, v in face["polynomial"]}
        faces.append({"radius": [1.0 / c for c in face["curvature"]], "conic": face["conic"]})
        if terms:
            faces[-1]["a4"] = [terms[2, 0], terms[1, 1], terms[0, 2]]
    z = [face["vertex_z"] for face in case["faces"]]
    slab = len(faces) == 2
    pair = {"form": "slab" if slab else "biconvex", "prescription": "given", "face": faces,
            "separation": case["separation"], "index": case["faces"][0]["index_after"]}  # fmt: skip
    if not slab:
        pair["thickness"] = [z[1] - z[0], z[3] - z[2]]
    lattice = {"kind": "square", "pitch": case["pitch"], "count": [5, 5]}
    return {"format": 1, "name": "golden", "unit": "mm" if slab else "m", "law": {"eta": case["eta"]}, "pair": pair,
            "lattice": lattice, "check": {"field": "1 deg"}}  # fmt: skip


def light(window, field, count):
    """Rays as the goldens have them: even over the cell on the plane of the first vertex, even in solid angle."""
    u = sobol(count, 4)
    pitch = np.array(window.lattice.pitch)
    lift = (1.0 - np.cos(field)) * u[:, 2]
    radius, azimuth = np.sqrt(lift * (2.0 - lift)), 2.0 * np.pi * u[:, 3]
    direction = np.column_stack([radius * np.cos(azimuth), radius * np.sin(azimuth), 1.0 - lift])
    first = window.faces[0].vertex[2]
    start = np.column_stack([(u[:, :2] - 0.5) * pitch, np.full(count, first)])
    back = window.z_range[0] - pitch[0] - first
    return Rays(start + direction * (back / direction[:, 2:]), direction)


@pytest.mark.daily_cases(
    "numpy-window-100mm R,K @1.0",
    "numba-paper-a-covered bending + A4",
    "numba-paper-a-covered paraboloid, bending + A4",
    "numpy-window-100mm R free, sphere @1.0",
    "numba-paper-a-covered radii + conics, both faces of a lens alike",
    "numpy-window-100mm as designed",
    "numba-window-100mm R free, sphere @1.0",
    "numba-window-100mm as designed",
    "numba-window-100mm R,K @1.0",
)
@pytest.mark.parametrize("case", GOLDEN, ids=[case["name"] for case in GOLDEN])
@pytest.mark.parametrize("path", ["numpy", "numba"])
def test_golden_prescriptions_re_traced(case, path):
    window = prescribe(Design.from_dict(golden_design(case)))
    for result in case["results"]:
        rays = light(window, radians(result["field_deg"]), 16384)
        seen = trace(window, rays, path=path)
        good = (seen.fate == Fate.ALIVE) & (seen.order == 0).all(axis=1)
        asked = rays.direction * np.array([*(1.0 / np.array(case["eta"])), 1.0])  # t' = t/η
        asked /= np.linalg.norm(asked, axis=1)[:, None]
        error = 2.0 * np.arcsin(0.5 * np.linalg.norm(seen.direction - asked, axis=1))[good]
        assert 1e3 * np.sqrt(np.mean(error**2)) == pytest.approx(result["law_rms_mrad"], rel=0.02)
        assert good.mean() == pytest.approx(result["throughput"], abs=0.004)


def test_polynomial_faces_give_both_paths_the_same_fates_and_directions():
    window = prescribe(
        Design.from_dict(golden_design(next(c for c in GOLDEN if "paraboloid, bending" in c["name"])))
    )
    assert all(isinstance(face.surface, EvenPolynomial) for face in window.faces)
    rays = light(window, 0.3, 4000)
    one, two = (trace(window, rays, path=path, record=True) for path in ("numpy", "numba"))
    assert len(np.unique(one.fate)) >= 3
    for column in ("fate", "cell", "order", "surface"):
        np.testing.assert_array_equal(getattr(one, column), getattr(two, column), column)
    for column in ("position", "direction", "optical_path", "hits"):
        np.testing.assert_allclose(
            getattr(one, column), getattr(two, column), rtol=0, atol=1e-13, err_msg=column
        )


# -- the file ------------------------------------------------------------------------------------------------------


def test_the_canonical_text_reads_back_and_holds_no_key_of_the_recipes():
    design = Design.from_dict(changed(face=[{"radius": ["inf", -2.5], "a4": [0.1, 0.0, "2 1/mm^3"]}, {"radius": 2.5}],
                                      vertex=[0.01, 0.0]))  # fmt: skip
    text = design.canonical_toml()
    assert Design.from_dict(tomllib.loads(text)) == design
    assert design.pair.face[0].radius == (inf, -2.5)
    assert design.pair.face[0].a4 == (0.1, 0.0, 2.0)
    for key in ("confocal =", "surface =", "depth ="):
        assert key not in text


def test_a_derived_design_says_nothing_of_given_faces():
    text = load(DESIGNS / "paper-a-covered.toml").canonical_toml()
    assert "prescription" not in text
    assert "face" not in text.replace("surface", "")
    explicit = load(DESIGNS / "paper-a-covered.toml", ['pair.prescription="derived"'])
    assert explicit.sha256 == load(DESIGNS / "paper-a-covered.toml").sha256


def test_faces_in_tables_of_their_own_and_an_override_of_one_radius(tmp_path):
    path = tmp_path / "given.toml"
    path.write_text(
        'format = 1\nname = "given"\nunit = "mm"\n[law]\neta = [-1, -1]\n[pair]\nform = "slab"\nseparation = 10\nindex = 1.5\n'
        'prescription = "given"\n[[pair.face]]\nradius = 2.5\n[[pair.face]]\nradius = [2.5, inf]\nconic = [-1, 0]\n'
        '[lattice]\nkind = "square"\npitch = 0.5\ncount = 4\n'
    )
    assert load(path).pair.face[1].radius == (2.5, inf)
    design = load(path, ["pair.face.0.radius=[3, 4]", "pair.face.1.conic=-0.5"])
    assert design.pair.face[0].radius == (3.0, 4.0)
    assert design.pair.face[1].conic == (-0.5, -0.5)
    with pytest.raises(DesignError, match="list of 2: no element 2"):
        load(path, ["pair.face.2.radius=3"])
    path.write_text(path.read_text().replace("radius = 2.5\n", "radius = 0\n"))
    with pytest.raises(DesignError) as told:
        load(path)
    assert "given.toml:12:10" in str(told.value)
    assert "radius = inf" in str(told.value)


def test_a_coefficient_in_other_units_is_converted_exactly():
    for text, value in (("2e9 1/m^3", 2.0), ("2e-9 1/um3", 2.0), ("3 1/mm³", 3.0), ("-1 1/cm^3", -1e-3)):
        face = {"radius": 2.5, "a4": [text, 0, 0]}
        assert Design.from_dict(changed(face=[face, face])).pair.face[0].a4[0] == pytest.approx(
            value, rel=1e-15
        )


WRONG = {
    "a polynomial without unit": (changed(face=[{"radius": 2.5, "a4": ["3", 0, 0]}] * 2), "CL105", '"3 1/mm^3"'),
    "a length for a polynomial": (changed(face=[{"radius": 2.5, "a4": ["3 mm", 0, 0]}] * 2), "CL104", "1/mm^3"),
    "an unknown unit": (changed(face=[{"radius": 2.5, "a4": ["3 1/kg^3", 0, 0]}] * 2), "CL105", "1/mm^3"),
    "two coefficients": (changed(face=[{"radius": 2.5, "a4": [1, 2]}] * 2), "CL108", "x⁴"),
    "no radius": (changed(face=[{"conic": 0}] * 2), "CL103", "radius"),
    "a key no face has": (changed(face=[{"radius": 2.5, "a5": 1}] * 2), "CL102", "a4"),
    "one face of a slab": (changed(face=[{"radius": 2.5}]), "CL108", "2 tables"),
    "two faces of a biconvex pair": (changed(form="biconvex", thickness=0.3, face=[{"radius": 9}] * 2), "CL108", "4 tables"),
    "no faces": ({**changed(), "pair": {k: v for k, v in SLAB["pair"].items() if k != "face"}}, "CL108", "2 tables"),
    "faces that are not asked for": (changed(prescription="derived"), "CL113", "given"),
    "a recipe beside them": (changed(confocal="exact"), "CL112", "leave it out"),
    "a surface beside them": (changed(surface="biconic"), "CL112", "leave it out"),
    "an automatic thickness": (changed(form="biconvex", thickness="auto", face=[{"radius": 9}] * 4), "CL113", "thickness"),
    "a bent plane side": (changed(form="plano", thickness=1.0, face=[{"radius": 5}] * 4), "CL114", "radius = inf"),
}  # fmt: skip


@pytest.mark.parametrize("name", WRONG)
def test_a_mistake_is_told_once_with_a_way_out(name):
    data, code, way = WRONG[name]
    with pytest.raises(DesignError) as told:
        Design.from_dict(data)
    codes = {mistake.code for mistake in told.value.mistakes}
    assert code in codes
    assert way in str(told.value)


def test_a_conic_without_real_height_at_the_corner_is_refused_with_one_that_has():
    with pytest.raises(DesignError, match=r"face 1 has no real height over .* of its cell") as told:
        prescribe(Design.from_dict(changed(face=[{"radius": 2.5, "conic": 60.0}, {"radius": 2.5}])))
    text = str(told.value)
    limit = float(text.split("conic below [")[1].split(",")[0])
    assert limit < 60.0
    prescribe(Design.from_dict(changed(face=[{"radius": 2.5, "conic": limit - 0.1}, {"radius": 2.5}])))
    with pytest.raises(DesignError):
        prescribe(Design.from_dict(changed(face=[{"radius": 2.5, "conic": limit + 0.1}, {"radius": 2.5}])))


def test_faces_that_cross_over_their_cell_are_refused_with_the_thickness_that_parts_them():
    data = changed(form="biconvex", thickness=0.02, face=[{"radius": 2.5}] * 4)
    with pytest.raises(DesignError, match="faces 1 and 2 cross") as told:
        prescribe(Design.from_dict(data))
    more = float(str(told.value).split("more than ")[1].split()[0])
    prescribe(
        Design.from_dict(changed(form="biconvex", thickness=0.02 + 1.001 * more, face=[{"radius": 2.5}] * 4))
    )
    with pytest.raises(DesignError, match="cross"):
        prescribe(
            Design.from_dict(
                changed(form="biconvex", thickness=0.02 + 0.99 * more, face=[{"radius": 2.5}] * 4)
            )
        )


def test_a_lens_1_without_power_has_no_axis_to_offset():
    data = changed(face=[{"radius": "inf"}, {"radius": 2.5}])
    data["law"]["delta"] = [0.01, 0.0]
    with pytest.raises(DesignError, match="no power"):
        prescribe(Design.from_dict(data))
    data["pair"]["vertex"] = [0.05, 0.0]
    assert prescribe(Design.from_dict(data)).recipe["d"] == [0.05, 0.0]


def test_a_quadric_given_by_its_conic_constants_is_built_as_one():
    window = prescribe(
        Design.from_dict(
            changed(face=[{"radius": 2.5, "conic": -1}, {"radius": [2.0, 3.0], "conic": [-1, -1]}])
        )
    )
    assert window.faces[0].surface == Quadric(0.4, 0.4, 0.0, 1)
    assert window.faces[1].surface == Quadric(0.5, 1.0 / 3.0, 0.0, -1)
