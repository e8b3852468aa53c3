"""The whole part against its process: material, height and width, by hand."""

from __future__ import annotations

from math import sqrt

import pytest

from clacad import verify
from clacad.cli import main
from clacad.design import Design, DesignError
from clacad.design.process_profiles import profiles
from clacad.explain.look_up import explain
from clacad.optics.material.catalogue import find
from clacad.prescription.prescribe import prescribe
from clacad.sheet.feasibility import feasibility
from clacad.verification import design_checks

PLAIN = {
    "format": 1, "name": "slab", "unit": "mm", "law": {"eta": [-1.0, -1.0]},
    "pair": {"form": "slab", "separation": 2.0, "material": "PMMA"}, "lattice": {"pitch": 0.5, "count": 4},
}  # fmt: skip


def judged(process, material="PMMA", separation=2.0, count=4, unit="mm", lattice=None, **check):
    pair = {"form": "slab", "separation": separation}
    pair |= {"index": material} if isinstance(material, float) else {"material": material}
    wave = {"OrmoComp": "589.3 nm", "Germanium": "10.6 um"}.get(material)
    made = Design.from_dict(PLAIN | {
        "pair": pair | ({"wavelength": wave} if wave else {}), "check": {"process": process} | check,
        "lattice": PLAIN["lattice"] | {"count": count} | (lattice or {}),
    })  # fmt: skip
    window = prescribe(made)
    return {c.id: c for c in design_checks(made, window, feasibility(window, *made.viewing_places))}


@pytest.mark.parametrize(
    ("process", "material", "state"),
    [
        ("diamond-turning", "PMMA", "pass"), ("diamond-turning", "Germanium", "pass"), ("diamond-turning", "Zeonex", "pass"),
        ("diamond-turning", "N-BK7", "fail"), ("diamond-turning", "Fused silica", "fail"), ("diamond-turning", "IP-Dip", "fail"),
        ("two-photon", "IP-Dip", "pass"), ("two-photon", "OrmoComp", "pass"), ("two-photon", "PMMA", "fail"),
        ("sla", "Acrylate resin", "pass"), ("sla", "PMMA", "fail"), ("greyscale", "SU-8", "pass"), ("moulding", "PC", "pass"),
        ("moulding", "P-SK57", "pass"), ("moulding", "N-BK7", "fail"),
    ],
)  # fmt: skip
def test_a_process_works_its_materials_and_fails_the_others(process, material, state):
    found = judged(process, material)["workable"]
    assert (found.code, found.state, found.value) == ("CL325", state, find(material).name)


def test_a_material_that_cannot_be_worked_names_what_can():
    assert "greyscale or moulding works it" in judged("two-photon", "PC")["workable"].sentence
    sentence = judged("diamond-turning", "N-BK7")["workable"].sentence
    assert "no process known here works it" in sentence
    # n(550 nm) = 1.5185: PMMA 1.494, Zeonex 1.533, Optorez 1.511, Low Styrene 1.521
    assert "diamond-turning works Low Styrene (n = 1.521, here 1.519)" in sentence


def test_the_workshop_may_say_itself_which_materials_it_works():
    found = judged("diamond-turning", "N-BK7", materials=["BK7", "PMMA"])["workable"]
    assert found.state == "pass"
    assert found.source == "design file"
    assert judged("none", "PC", materials=["PMMA"])["workable"].state == "fail"
    with pytest.raises(
        DesignError, match=r"check\.materials.*unknown material 'glas'|unknown material 'glas'"
    ):
        judged("diamond-turning", materials=["glas"])


def test_a_bare_index_and_no_process_say_nothing_of_the_material():
    assert "workable" not in judged("diamond-turning", 1.5)
    assert not {"workable", "part_height", "part_width"} & set(judged("none", "N-BK7"))


def test_the_height_of_a_slab_is_that_from_vertex_to_vertex():
    """Two convex faces bulge outwards from their vertices inwards: the vertices are the extremes, n s apart."""
    index = find("IP-Dip").index(550e-9)
    low, high = (judged("two-photon", "IP-Dip", separation=s)["part_height"] for s in (2.0, 10.7))
    assert low.value == pytest.approx(2.0 * index, rel=1e-9)
    assert low.limit == pytest.approx(8.0)
    assert low.state == "pass"
    assert high.value == pytest.approx(10.7 * index, rel=1e-9)  # 16.6 mm
    assert high.state == "fail"
    assert high.code == "CL326"
    assert "greyscale makes parts" not in high.sentence  # 12 mm: too low, too
    assert "no other process known here makes such parts of this material" in high.sentence
    near = judged("two-photon", "IP-Dip", separation=4.6)["part_height"]
    assert near.state == "warn"
    assert "% of the limit" in near.sentence


def test_the_width_is_the_greater_side_and_a_failure_names_a_larger_machine():
    found = judged("diamond-turning", count=[440, 4])["part_width"]
    assert (found.code, found.state) == ("CL327", "fail")
    assert found.value == pytest.approx(220.0)
    assert "moulding makes parts up to 300 mm wide" in found.sentence
    assert judged("diamond-turning", count=[440, 4], part_width="0.5 m")["part_width"].state == "pass"
    assert judged("diamond-turning", part_height="1 mm")["part_height"].state == "fail"


def test_the_height_of_a_sheet_whose_cells_differ_is_that_of_all_its_cells():
    """Vertices of an aimed sheet stay in their planes: the height is again n s, and the width is that of array 2."""
    found = judged("moulding", count=8, lattice={"aperture": {"point": [0.0, 0.0, -100.0]}})
    assert found["part_height"].value == pytest.approx(2.0 * find("PMMA").index(550e-9), rel=1e-9)
    assert found["part_height"].limit == pytest.approx(25.0)
    assert found["part_width"].value >= 4.0


@pytest.mark.slow
def test_check_and_verify_fail_a_part_that_cannot_be_made(tmp_path, capsys):
    path = tmp_path / "glass.toml"
    path.write_text(
        'format = 1\nname = "glass"\nunit = "mm"\n[law]\neta = [-1, -1]\n[pair]\nform = "slab"\nseparation = 6\n'
        'material = "N-BK7"\n[lattice]\nkind = "square"\npitch = 0.5\ncount = [4, 4]\n[check]\nprocess = "diamond-turning"\n'
    )
    assert main(["check", str(path)]) == 1
    assert "workable" in capsys.readouterr().out
    report = verify(Design.from_dict(PLAIN | {
        "pair": PLAIN["pair"] | {"separation": 6.0, "material": "N-BK7"}, "check": {"process": "diamond-turning"},
    }))  # fmt: skip
    assert {c.id for c in report.checks if c.state == "fail"} == {"workable"}


@pytest.mark.parametrize("rules", [p for p in profiles() if p.name != "none"], ids=lambda p: p.name)
def test_a_process_is_explained_with_its_materials_height_and_width(rules):
    said = explain(rules.name).means
    assert f"parts up to {1e3 * rules.part_height:g} mm high" in said
    assert f"parts up to {1e3 * rules.part_width:g} mm wide" in said
    assert all(name in said for name in rules.materials if name not in {"plastic", "resin"})
    assert 0 < rules.part_height < 1
    assert rules.part_width < sqrt(0.5)


@pytest.mark.parametrize(
    ("material", "says"),
    [
        ("germanium", ("n = 4.0036 at 10.6 µm", "known from 2000 to 14000 nm", "5330 kg/m³", "dn/dT: 396e-6/K", "expansion: 6.1e-6/K")),
        ("COP", ("V_d = ", "1010 kg/m³", "dn/dT: -100e-6/K", "worked by diamond-turning")),
        ("OrmoComp", ("V_d is not published", "density: no published value", "dn/dT: no published value", "expansion: no published value")),
        ("N-BK7", ("V_d = 64.2", "worked by no process")),
    ],
)  # fmt: skip
def test_a_material_is_explained_with_all_that_is_published_of_it(material, says):
    entry = explain(material)
    assert all(words in entry.means for words in says), entry.means
    assert "From: " in entry.why
