"""Slabs of layers: thicknesses by their two conditions, light in white, and refusals with numbers."""

from __future__ import annotations

import re

import pytest
from mpmath import mp, mpf

from clacad import Design, DesignError, prescribe
from clacad.advice import judge
from clacad.light.compare import paraxial
from clacad.optics.material.catalogue import find
from clacad.optics.material.material import Material
from clacad.prescription.face_list import as_listed, inner_share
from clacad.prescription.radii import NoSuchLens
from clacad.sheet.like_cell import in_light

F, C = 486.1e-9, 656.3e-9


def slab(layers=("silica", "N-SF6", "silica"), eta=(-1, -1), **pair):
    return Design.from_dict({
        "format": 1, "name": "layers", "unit": "mm", "law": {"eta": list(eta)},
        "pair": {"form": "slab", "layers": list(layers), "separation": 10, "wavelength": 546.1, **pair},
        "lattice": {"pitch": 0.5, "count": [12, 12]}, "check": {"field": "1 deg"},
    })  # fmt: skip


@pytest.mark.parametrize("eta", [(-1, -1), (-0.25, -1), (0.5, 0.5), (-1, 1)])
def test_thicknesses_keep_the_pair_afocal_in_three_lines_at_every_eta(eta):
    """By matrices: C vanishes at the design wavelength, to first order in the outer lines; one glass is far off."""
    sheet = prescribe(slab(eta=eta, conic=[-0.469, -0.469]))
    alone = {"form": "slab", "separation": 10, "material": "silica", "wavelength": 546.1}
    one = prescribe(Design.from_dict({**slab(eta=eta).given, "pair": alone}))
    for axis in (0, 1):
        power = {wave: paraxial(in_light(sheet, wave))[axis][1, 0] for wave in (546.1e-9, F, C)}
        plain = paraxial(in_light(one, F))[axis][1, 0] - paraxial(in_light(one, C))[axis][1, 0]
        assert abs(power[546.1e-9]) < 1e-14
        assert abs(power[F] - power[C]) <= 0.03 * abs(plain)
        assert paraxial(sheet)[axis][1, 1] == pytest.approx(1.0 / eta[axis], rel=1e-12)
        assert paraxial(sheet)[axis][0, 1] == pytest.approx(10.0, rel=1e-12)


@pytest.mark.parametrize(
    ("layers", "inner", "most"),
    [(("silica", "N-SF6", "silica"), 0.77, 0.028), (("N-BK7", "N-SF6", "N-BK7"), 0.83, 0.0242)],
)
def test_white_light_through_flat_joints_keeps_to_the_law(layers, inner, most):
    """Another program found .025 and .022 mrad with 77 % and 83 % of the air-equivalent length in N-SF6."""
    design = slab(layers)
    body = prescribe(design).bodies[1]
    assert (body.back.vertex[2] - body.front.vertex[2]) / body.index / 10 == pytest.approx(inner, abs=0.012)
    white = next(check for check in judge(design).light if check.id == "law_white")
    assert 1e3 * white.value <= most
    assert white.detail["lines"][1]["share"] >= 0.718


@pytest.mark.parametrize(
    ("eta", "most", "before"),
    [
        ((-0.25, -1), 0.103, 0.452),
        ((0.5, 0.5), 0.0085, 0.0228),
        ((-0.5, -0.5), 0.054, 0.117),
        ((-1, 1), 0.0164, 0.0164),
        ((-2, -1), 0.0194, 0.0197),
    ],
)
def test_faces_whose_conics_are_not_given_follow_the_law_better_in_white_light(eta, most, before):
    """Another program reached .101 and .008 mrad at the first two; −1/n² leaves `before`."""
    index = float(find("silica").index(546.1e-9))
    white = [
        next(check for check in judge(design).light if check.id == "law_white")
        for design in (slab(eta=eta), slab(eta=eta, conic=[-1 / index**2] * 2))
    ]
    assert 1e3 * white[0].value <= most
    assert 1e3 * white[1].value == pytest.approx(before, rel=0.02)
    assert as_listed(slab(eta=eta)) == as_listed(slab(eta=eta))
    faces = as_listed(slab(eta=eta, conic=[-0.3, -0.4])).pair.face
    assert [face.conic for face in faces if not face.plane] == [(-0.3, -0.4)] * 2
    own = [face for face in as_listed(slab(eta=eta)).pair.face if not face.plane]
    assert eta[0] != eta[1] or all(face.radius[0] == face.radius[1] for face in own)


def test_faces_of_layers_are_solved_for_the_lines_of_the_design():
    """Three quarters of the weight at F move the least mean error to the faces that are better there."""
    lines = [{"wavelength": 486.1, "weight": 9}, {"wavelength": 656.3}]
    blue = slab(eta=(0.5, 0.5)).replace("light.spectrum", lines)
    faces = as_listed(slab(eta=(0.5, 0.5))).replace("light.spectrum", lines)
    light = [
        next(check for check in judge(design).light if check.id == "law_white") for design in (blue, faces)
    ]
    first, second = ([line["law_rms"] for line in one.detail["lines"]] for one in light)
    assert first[0] < second[0]
    assert light[0].value < light[1].value


def test_conics_are_those_of_eta_minus_1_where_too_little_light_reaches_the_partner():
    design = slab(eta=(-0.5, -0.5)).replace("check.field", "20 deg")
    index = float(find("silica").index(546.1e-9))
    assert as_listed(design).pair.face[0].conic == pytest.approx((-1 / index**2,) * 2)


def test_layers_are_the_list_of_faces_they_are_solved_into():
    design = slab(conic=[-0.45, -0.45], offset="paraxial")
    first, second = prescribe(design), prescribe(as_listed(design))
    assert repr(first.faces) == repr(second.faces)
    assert first.form == "plates"
    assert Design.from_dict(design.to_dict()) == design
    assert as_listed(as_listed(design)) == as_listed(design)


@pytest.mark.parametrize(
    ("layers", "says"),
    [
        (("PMMA", "PS", "PMMA"), "needs 1.96 of the length in PS"),
        (("N-SF6", "silica", "N-SF6"), "needs -"),
        (("silica", "PMMA", "N-SF6"), "V = 68.* vanishes at eta = 0.376"),
        (("PMMA", "air", "PS"), "eta = 0.555 alone, and at no eta below 0"),
        (("PMMA", "air", "PMMA"), "no flat joint"),
        (("PMMA", "diffractive"), "has 0.8[78] zones over a cell"),
        (("PMMA", "unobtainium", "PMMA"), "unknown material"),
    ],
)
def test_layers_that_cannot_be_achromatic_are_refused_with_their_numbers(layers, says):
    with pytest.raises(DesignError, match=says):
        prescribe(slab(layers))


def plates(*media, eta=(-1, -1), check=("law_white", "0.1 mrad")):
    """Two plates: faces of radius 2 at 0, 1, 9 and 10 mm with these media behind them."""
    faces = [
        {"radius": radius, "z": z, "array": array, "behind": medium}
        for radius, z, array, medium in zip((2, -9, 9, -2), (0, 1, 9, 10), (1, 1, 2, 2), (*media, "air"))
    ]
    del faces[0]["z"]
    given = {**slab(eta=eta).given, "pair": {"form": "plates", "wavelength": 546.1, "face": faces}}
    return Design.from_dict({**given, "check": dict([check])})


def test_listed_plates_of_two_materials_across_air_are_refused_in_white_light_with_their_numbers():
    with pytest.raises(
        DesignError, match="V = 52.*V = 29.*eta = 0.5[0-9]+ alone, and at no eta below 0"
    ) as refused:
        plates("PMMA", "air", "PS")
    ratio = re.search(r"eta = ([0-9.]+) alone", str(refused.value))
    indices = [[float(find(m).index(w)) for w in (546.1e-9, F, C)] for m in ("PMMA", "PS")]
    v = [(n - 1) / (first - last) for n, first, last in indices]
    assert float(ratio[1]) == pytest.approx(v[1] / v[0], rel=2e-3)
    for allowed in (
        {"media": ("PMMA", "air", "PMMA")},
        {"media": ("PMMA", "air", "PS"), "eta": (0.5, 0.5)},
        {"media": ("PMMA", "air", "PS"), "check": ("law_rms", "3 mrad")},
    ):
        media = allowed.pop("media")
        assert plates(*media, **allowed).pair.form == "plates"


def test_a_diffractive_face_of_listed_plates_is_refused_with_its_zones():
    """10 mm of air between lenses of PMMA at p = .5 mm: fewer zones than a grating needs, as for a slab."""
    with pytest.raises(
        DesignError, match="has 0.[0-9]+ zones over a cell, and a grating needs 10"
    ) as refused:
        plates("PMMA", "air", "diffractive")
    length = 1.0 / float(find("PMMA").index(546.1e-9)) + 9.0
    assert f"not {0.25 / length:.2g}" in str(refused.value)


@pytest.mark.parametrize(
    ("key", "value"),
    [("material", "PMMA"), ("surface", "biconic"), ("thickness", 3), ("field_lens", True), ("form", "plano")],
)
def test_keys_that_layers_answer_are_refused(key, value):
    with pytest.raises(DesignError, match="layers"):
        slab(**{key: value})


@pytest.mark.parametrize("more", [1e-9, -1e-9, 1e-3, 5.0])
def test_the_inner_share_of_nearly_equal_dispersions_is_that_of_50_digits(more):
    """Both materials change their index over n alike but for 1e-9, where the share is largest."""
    design, lines = slab(), slab().light.lines
    glasses = [
        Material(name, "cauchy", (n, b, -2.0), (4e-7, 8e-7), "a test")
        for name, n, b in (("outer", 1.5, 0.005), ("inner", 1.8, 0.006 * (1.0 + more)))
    ]
    mp.dps = 50
    (n, dn), (m, dm) = (
        (mpf(float(one.index(546.1e-9))), mpf(float(one.index(min(lines)) - one.index(max(lines)))))
        for one in glasses
    )
    gain = dm / m - dn / n
    exact = (dn / (n - 1) - dn / n) / gain
    condition = float(abs(dm / m / gain)) + 1.0
    if 0.0 < exact < 1.0:
        assert abs(inner_share(design, *glasses) / float(exact) - 1.0) < 1e-15 * condition
        return
    with pytest.raises(NoSuchLens, match=re.escape(f"needs {float(exact):.3g} of the length")):
        inner_share(design, *glasses)
