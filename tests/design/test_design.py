"""The design file: what is read, what is kept, what is refused."""

from __future__ import annotations

import json
import math
import pickle
import subprocess
import sys
import tomllib
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

import clacad.design as cd
from clacad.design import Design, DesignError, load

DESIGNS = Path(__file__).parents[2] / "designs"

GOOD = {
    "format": 1,
    "name": "good",
    "unit": "mm",
    "law": {"eta": [-0.5, -1.0], "euler": [45.0, 0.5, 90.0]},
    "pair": {"form": "biconvex", "separation": 10.0, "index": 1.5},
    "lattice": {"pitch": 0.5, "count": [40, 30]},
}


def changed(**sections):
    """GOOD with some keys changed: section={key: value}, value None removes the key."""
    made = json.loads(json.dumps(GOOD))
    for section, keys in sections.items():
        if not isinstance(keys, dict):
            made[section] = keys
            continue
        part = made.setdefault(section, {})
        part.update(keys)
        for key in [key for key, value in part.items() if value is None]:
            del part[key]
    return made


def design(**sections):
    return Design.from_dict(changed(**sections))


def codes(**sections):
    with pytest.raises(DesignError) as caught:
        design(**sections)
    return [(mistake.code, mistake.key) for mistake in caught.value.mistakes]


# --- reading -----------------------------------------------------------------------------------------------


def test_a_design_keeps_what_was_written_and_fills_in_the_defaults():
    made = design()
    assert (made.name, made.unit, made.unit_m) == ("good", "mm", 0.001)
    assert made.law_spec.euler_degrees == (45.0, 0.5, 90.0)
    assert made.pair.thickness == "auto"
    assert made.pair.wavelength == 550e-9
    assert made.lattice.pitch == (0.5, 0.5)
    assert made.lattice.aperture == "centred"
    assert made.check.law_rms == 0.003
    assert made.check.field == math.radians(1.0)
    assert made.check.confocality == 0.002


def test_the_law_of_a_design_is_exact_at_right_angles():
    rotation = design(law={"euler": [90.0, 0.0, 180.0]}).law.rotation
    np.testing.assert_array_equal(rotation, [[0, 1, 0], [-1, 0, 0], [0, 0, 1]])


def test_the_law_of_a_design_turns_about_the_axes_asked_for():
    fixed = design(law={"euler": [10.0, 20.0, 30.0]}).law
    moving = design(law={"euler": [30.0, 20.0, 10.0], "euler_axes": "moving"}).law
    np.testing.assert_allclose(fixed.rotation, moving.rotation, atol=1e-15)


@pytest.mark.parametrize(
    ("text", "unit", "exact"),
    [
        ("250 um", "mm", Fraction(1, 4)),
        ("0.1 mm", "m", Fraction(1, 10**4)),
        ("1 in", "mm", Fraction(254, 10)),
        ("3 mm", "100 mm", Fraction(3, 100)),
        ("7e3 nm", "um", Fraction(7)),
        ("  12.5µm ", "mm", Fraction(125, 10**4)),
        ("12.5 μm", "mm", Fraction(125, 10**4)),
        (".5cm", "2 cm", Fraction(1, 4)),
    ],
)
def test_a_length_with_a_unit_is_the_nearest_float_to_its_exact_value(text, unit, exact):
    assert design(unit=unit, pair={"separation": text}).pair.separation == float(exact)


@pytest.mark.parametrize(
    ("text", "degrees"),
    [
        ("10 deg", 10.0),
        ("30 arcmin", 0.5),
        ("36arcsec", 0.01),
        ("1 rad", 180 / math.pi),
        ("1 mrad", 0.18 / math.pi),
    ],
)
def test_an_angle_with_a_unit_becomes_degrees_for_the_euler_angles(text, degrees):
    assert design(law={"euler": [0.0, text, 0.0]}).law_spec.euler_degrees[1] == pytest.approx(
        degrees, rel=1e-15
    )


@pytest.mark.parametrize(("value", "metres"), [(632.8, 632.8e-9), ("0.55 um", 550e-9), ("1550 nm", 1550e-9)])
def test_a_bare_wavelength_is_in_nanometres(value, metres):
    assert design(pair={"wavelength": value}).pair.wavelength == metres


def test_a_limit_in_percent_is_a_ratio():
    assert design(check={"eta": "2 %"}).check.eta == 0.02


@pytest.mark.parametrize(
    ("written", "kept", "both"),
    [("auto", "auto", None), (0.3, 0.3, (0.3, 0.3)), ([0.3, "400 um"], (0.3, 0.4), (0.3, 0.4))],
)
def test_thickness_is_auto_or_one_length_or_one_for_each_lens(written, kept, both):
    pair = design(pair={"thickness": written}).pair
    assert (pair.thickness, pair.thicknesses) == (kept, both)


def test_a_single_count_means_a_square_and_a_single_pitch_a_square_cell():
    lattice = design(lattice={"count": 7, "pitch": "0.25 mm"}).lattice
    assert (lattice.count, lattice.pitch) == ((7, 7), (0.25, 0.25))


def test_an_absurd_count_is_read_and_left_to_the_limits():
    assert design(lattice={"count": 10**18}).lattice.count == (10**18, 10**18)


def test_without_a_seam_there_is_no_web_and_with_one_the_web_is_left_to_the_neck():
    assert design().pair.web == 0.0
    assert design(lattice={"seam": 0.04}).pair.web is None


@pytest.mark.parametrize("confocal", ["thin", "best"])
def test_recipes_that_are_not_confocal_by_construction_are_judged_by_a_wider_limit(confocal):
    assert design(pair={"confocal": confocal}).check.confocality == 0.02
    assert design(pair={"confocal": confocal}, check={"confocality": 0.004}).check.confocality == 0.004


def test_every_key_can_be_written_and_read_back():
    made = design(
        notes=["a remark"],
        law={"delta": [0.1, -0.2], "euler_axes": "moving"},
        pair={"thickness": [0.3, 0.4], "web": 0.05, "confocal": "best", "depth": [1.0, 2.0], "wavelength": 600},
        lattice={"kind": "rectangular", "pitch": [0.5, 0.6], "seam": 0.04, "outline": {"rectangle": [9, 8]},
                 "aperture": [0.01, -0.02], "land": "opaque"},
        body={"border": 1, "neck": 0.02, "baffle": True, "baffle_wall": 0.03, "frame": {"width": 2, "height": 5},
              "roughness": "5 nm", "slope_rms": "1 mrad"},
        check={"field": "0.5 deg", "field_centre": "normal", "process": "sla", "mesh_law_rms": "9 mrad",
               "edge": "0.3 mm", "neck": "20 um", "clearance": "0 mm",
               "allow": [{"code": "CL311", "reason": "seen"}]},
    )  # fmt: skip
    assert made.lattice.outline == cd.Outline("rectangle", (9.0, 8.0))
    assert made.body.frame == cd.Frame(2.0, 5.0)
    assert made.body.roughness == 5e-6
    assert made.check.edge == 0.3
    assert made.check.allow == (cd.Allowed("CL311", "seen"),)
    assert Design.from_dict(made.to_dict()) == made


# --- one design, one text ----------------------------------------------------------------------------------


def test_the_canonical_text_reads_back_as_an_equal_design_with_the_same_hash():
    made = design(unit="100 mm", pair={"separation": 1 / 3}, check={"edge": "0.1 mm", "law_rms": "0.1 deg"})
    again = Design.from_dict(tomllib.loads(made.canonical_toml()))
    assert again == made
    assert again.sha256 == made.sha256
    assert again.canonical_toml() == made.canonical_toml()


def test_the_hash_speaks_of_what_is_asked_not_of_how_it_is_written():
    assert design().sha256 == design(pair={"separation": "1 cm", "thickness": "auto", "web": 0.0}).sha256
    assert design().sha256 != design(pair={"separation": 10.000000000000002}).sha256
    assert design(law={"delta": [-0.0, 0.0]}).sha256 == design().sha256


def test_the_text_of_a_file_is_kept_verbatim_until_something_is_overridden():
    path = DESIGNS / "paper-base.toml"
    assert load(path).toml == path.read_text(encoding="utf-8")
    overridden = load(path, ["law.eta.0=-0.5"])
    assert tomllib.loads(overridden.toml)["law"]["eta"] == [-0.5, -1.0]


def test_designs_survive_pickling_and_can_be_hashed():
    made = design()
    assert pickle.loads(pickle.dumps(made)) == made
    assert len({made, design()}) == 1


def test_json_is_a_second_syntax_for_the_same_design(tmp_path):
    (tmp_path / "good.json").write_text(json.dumps(GOOD))
    assert load(tmp_path / "good.json") == Design.from_dict(GOOD)


# --- changing ----------------------------------------------------------------------------------------------


def test_replace_changes_one_element_and_checks_the_result():
    made = design()
    assert made.replace({"law.eta.0": -2.0}).law_spec.eta == (-2.0, -1.0)
    assert made.replace({"pair.confocal": "thin"}).check.confocality == 0.02
    assert made.law_spec.eta == (-0.5, -1.0)
    with pytest.raises(DesignError, match=r"eta_x = 0"):
        made.replace({"law.eta.0": 0.0})


def test_replace_takes_one_key_and_its_value():
    made = design()
    assert made.replace("pair.separation", 12) == made.replace({"pair.separation": 12})
    assert made.replace("law.eta.0", -2.0).law_spec.eta == (-2.0, -1.0)
    with pytest.raises(DesignError, match=r"pair.separation"):
        made.replace("pair.separation")
    with pytest.raises(TypeError, match=r'"pair.separation", 12 or'):
        made.replace({"pair.separation": 12}, 12)
    with pytest.raises(TypeError, match=r'"pair.separation", 12 or'):
        made.replace([("pair.separation", 12)])


def test_replace_takes_numpy_numbers():
    assert design().replace({"law.eta": np.array([-1.5, -2.0])}).law_spec.eta == (-1.5, -2.0)


def test_a_design_with_other_cells_is_the_design_that_asks_for_them():
    made = design(lattice={"outline": {"circle": 9.0}}).with_cells((3, 5))
    assert made == design(lattice={"count": [3, 5]})
    assert made.replace({"law.eta.0": -0.25}).lattice.count == (3, 5)
    with pytest.raises(ValueError, match="at least 1 x 1"):
        made.with_cells((0, 5))


@pytest.mark.parametrize(
    ("text", "where", "value"),
    [
        ("law.eta=[-1.4,-1]", "law_spec.eta", (-1.4, -1.0)),
        ("law.eta.1=-2", "law_spec.eta", (-0.5, -2.0)),
        ("pair.confocal=thin", "pair.confocal", "thin"),
        ('pair.confocal="thin"', "pair.confocal", "thin"),
        ("pair.separation=12 mm", "pair.separation", 12.0),
        ("check.field = 0.5 deg", "check.field", math.radians(0.5)),
        ("lattice.outline.circle=9", "lattice.outline", cd.Outline("circle", (9.0, 9.0))),
        ("name=another one", "name", "another one"),
    ],
)
def test_an_override_sets_one_key(text, where, value):
    made = Design.from_dict(GOOD, [text])
    for part in where.split("."):
        made = getattr(made, part)
    assert made == value


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("law.etax=[1, 2]", "--set law.etax=[1, 2]: error CL102: unknown key law.etax; did you mean law.eta?\n"
                            "   | law.etax=[1, 2]\n   | ^^^^^^^^\n  allowed: in [law]: eta, delta, euler, euler_axes, varying"),
        ("pair.index=0.5", "--set pair.index=0.5: error CL106: pair.index = 0.5 is out of range\n"
                           "   | pair.index=0.5\n   |            ^^^\n  allowed: a number > 1, at most 10"),
        ("lattice.seam=0.9", "--set lattice.seam=0.9: error CL117: lattice.seam = 0.9 leaves no lens in a cell of "
                             "lattice.pitch = 0.5\n   | lattice.seam=0.9\n   |              ^^^\n"
                             "  allowed: below the pitch, 0.5"),
        ("law.eta.7=1", "--set law.eta.7=1: error CL118: law.eta is a list of 2: no element 7\n"
                        "   | law.eta.7=1\n   | ^^^^^^^^^"),
        ("name.x=1", "--set name.x=1: error CL118: name is a text: it has no part x\n   | name.x=1\n   | ^^^^^^"),
        ("law.eta=[1,", "--set law.eta=[1,: error CL118: the value of law.eta is not TOML\n"
                        "   | law.eta=[1,\n   |         ^^^\n  allowed: a number, \"text\", [list], true or false"),
        ("law.eta", '--set law.eta: error CL118: an override is written key.path=value\n'
                    '  allowed: such as "law.eta=[-1.4,-1]" or pair.form=slab'),
        ("a=1\nb=2", '--set a=1?b=2: error CL118: an override is written key.path=value\n'
                     '  allowed: such as "law.eta=[-1.4,-1]" or pair.form=slab'),
    ],
)  # fmt: skip
def test_a_bad_override_is_named_by_its_own_text(text, expected):
    with pytest.raises(DesignError) as caught:
        Design.from_dict(GOOD, [text])
    assert str(caught.value) == expected


def test_the_last_override_of_a_key_counts_and_is_the_one_named():
    assert Design.from_dict(GOOD, ["pair.index=0.5", "pair.index=1.7"]).pair.index == 1.7
    with pytest.raises(DesignError, match=r"--set pair.index=0.5"):
        Design.from_dict(GOOD, ["pair.index=1.7", "pair.index=0.5"])


# --- refusing ----------------------------------------------------------------------------------------------


def test_a_dictionary_has_no_file_so_its_mistakes_name_the_key_only():
    with pytest.raises(DesignError) as caught:
        design(law={"etta": [1, 2]}, pair={"index": 0.9})
    assert str(caught.value) == (
        "error CL102: unknown key law.etta; did you mean law.eta?\n"
        "  allowed: in [law]: eta, delta, euler, euler_axes, varying\n"
        "error CL106: pair.index = 0.9 is out of range\n"
        "  allowed: a number > 1, at most 10\n"
        "2 mistakes"
    )


def test_a_misspelt_key_is_one_mistake_not_a_missing_key_as_well():
    assert codes(lattice={"pitch": None, "picth": 0.5}) == [("CL102", "lattice.picth")]


def test_rules_speak_about_the_rest_of_a_design_whose_other_keys_are_wrong():
    found = codes(
        unit="parsec", law={"eta": [1.0, 1.0]}, pair={"form": "slab", "confocal": "thin", "index": "x"}
    )
    assert ("CL110", "law.eta") in found
    assert ("CL114", "pair.confocal") in found
    assert ("CL105", "unit") in found
    assert ("CL104", "pair.index") in found
    assert len(found) == 4


def test_one_meridian_without_power_is_the_cylindrical_sheet():
    assert design(law={"eta": [1.0, -0.5]}).law_spec.eta == (1.0, -0.5)


@pytest.mark.parametrize("pitch", ["99 nm", 9.9e-5])
def test_a_pitch_below_a_tenth_of_a_micrometre_is_refused(pitch):
    assert codes(lattice={"pitch": pitch}) == [("CL115", "lattice.pitch")]


def test_a_pitch_of_a_tenth_of_a_micrometre_is_taken():
    assert design(lattice={"pitch": "0.1 um"}).lattice.pitch == (1e-4, 1e-4)


@pytest.mark.parametrize(
    ("count", "outline", "fits"),
    [([39, 31], {"circle": 0.72}, True), ([39, 31], {"circle": 0.70}, False), ([39, 31], {"rectangle": [0.5, 0.5]}, True),
     ([39, 31], {"rectangle": [0.5, 0.49]}, False), (2, {"circle": 1.4}, False), (2, {"circle": 1.42}, True),
     ([2, 3], {"circle": 1.11}, False), ([2, 3], {"circle": 1.12}, True), (2, {"rectangle": [1.0, 0.9]}, False)],
)  # fmt: skip
def test_an_outline_holds_at_least_one_cell_where_the_count_puts_it(count, outline, fits):
    """Of an even number none lies in the middle: the nearest ones meet there."""
    keys = {"count": count, "outline": outline}
    if fits:
        assert design(lattice=keys).lattice.outline is not None
    else:
        assert codes(lattice=keys) == [("CL117", "lattice.outline")]


def test_a_material_is_known_and_its_index_reaches_the_wavelength():
    assert design(pair={"index": None, "material": "PMMA"}).pair.material == "PMMA"
    assert codes(pair={"index": None, "material": "unobtainium"}) == [("CL119", "pair.material")]
    assert codes(pair={"index": None, "material": "PMMA", "wavelength": 100}) == [
        ("CL119", "pair.wavelength")
    ]


@pytest.mark.parametrize(
    ("name", "says"),
    [("absent.toml", "no such file"), (".", "it is a folder"), ("nul\0l.toml", "zero byte")],
)
def test_a_file_that_cannot_be_read_is_a_sentence(tmp_path, name, says):
    with pytest.raises(DesignError, match=says) as caught:
        load(str(tmp_path / name))
    assert [mistake.code for mistake in caught.value.mistakes] == ["CL100"]


def test_a_file_name_that_is_nearly_right_gets_a_suggestion(tmp_path):
    (tmp_path / "window.toml").write_text("")
    with pytest.raises(DesignError, match=r"did you mean .*window\.toml\?"):
        load(tmp_path / "windwo.toml")


def test_a_file_beyond_16_megabytes_is_refused_unread(tmp_path):
    path = tmp_path / "big.toml"
    with path.open("wb") as file:
        file.truncate(16 * 2**20 + 1)
    with pytest.raises(DesignError, match="too large"):
        load(path)


def test_a_byte_order_mark_is_no_mistake(tmp_path):
    path = tmp_path / "bom.toml"
    path.write_bytes(b"\xef\xbb\xbf" + (DESIGNS / "slab.toml").read_bytes())
    assert load(path) == load(DESIGNS / "slab.toml")


def test_a_reason_found_later_is_placed_at_the_key_it_belongs_to():
    made = load(DESIGNS / "paper-base.toml")
    error = DesignError.at(made, "pair.thickness", "too thin", hint="thickness >= 0.00089")
    (mistake,) = error.mistakes
    line = (DESIGNS / "paper-base.toml").read_text(encoding="utf-8").split("\n")[mistake.line - 1]
    assert line[mistake.column - 1 :].startswith("0.0005")
    assert str(error).startswith(
        f"{DESIGNS / 'paper-base.toml'}:{mistake.line}:{mistake.column}: error CL120: too thin"
    )


# --- schema and templates ----------------------------------------------------------------------------------


def test_the_schema_beside_the_designs_is_the_schema_of_this_version():
    shipped = json.loads((DESIGNS / "clacad.schema.json").read_text(encoding="utf-8"))
    assert shipped == json.loads(json.dumps(cd.json_schema()))


def test_the_schema_knows_every_key_and_no_other():
    schema = cd.json_schema()
    assert schema["additionalProperties"] is False
    full = design().to_dict()
    for section in ("law", "pair", "lattice", "body", "check"):
        entry = schema["$defs"][section.capitalize()]
        assert entry["additionalProperties"] is False
        assert set(full[section]) <= set(entry["properties"])
    assert schema["$defs"]["Pair"]["properties"]["wavelength"]["default"] == 550.0
    assert schema["$defs"]["Check"]["properties"]["law_rms"]["default"] == "3 mrad"


@pytest.mark.parametrize("kind", sorted(cd.templates()))
def test_every_template_loads_as_it_stands(tmp_path, kind):
    text = cd.template("my sheet", kind)
    (tmp_path / "x.toml").write_text(text, encoding="utf-8")
    assert load(tmp_path / "x.toml").name == "my sheet"
    assert text.startswith("#:schema clacad.schema.json\n# ")


@pytest.mark.parametrize("kind", sorted(cd.templates()))
def test_the_keys_that_a_template_offers_in_comments_exist(kind):
    lines = cd.template("x", kind).split("\n")
    section, schema = "", cd.json_schema()
    for line in lines:
        if line.startswith("["):
            section = line.strip("[]").split("]")[0]
        offered = line.removeprefix("# ").partition(" = ")
        if section and line.startswith("# ") and offered[1] and offered[0].isidentifier():
            assert offered[0] in schema["$defs"][section.capitalize()]["properties"], line


def test_a_template_is_refused_for_a_name_no_design_can_have_or_a_kind_there_is_not():
    with pytest.raises(DesignError, match="must not hold '/'"):
        cd.template("../x")
    with pytest.raises(DesignError, match='did you mean "hexagonal"'):
        cd.template("x", "hexagon")


# --- cost --------------------------------------------------------------------------------------------------


def test_importing_the_design_module_loads_nothing_heavy_and_a_good_design_needs_no_parser_of_places():
    program = (
        "import sys, clacad.design as cd\n"
        "heavy = {'pydantic', 'tree_sitter', 'tree_sitter_toml', 'numpy', 'OCP', 'numba'}\n"
        "assert not heavy & set(sys.modules), heavy & set(sys.modules)\n"
        f"cd.load({str(DESIGNS / 'paper-base.toml')!r})\n"
        "assert not heavy & set(sys.modules), heavy & set(sys.modules)\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
