"""Numbers, headers and meshes of untrusted files that once ended in an internal error: each is refused with its reason."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
from trust.attacks.hostile_commands import AIMED, DRAWN, DXF, LONG, npy, npz
from trust.running import TINY

from clacad.base.text import array_lengths, beyond_64_bits, whole_number
from clacad.cli import main


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with a design, a design with a drawn outline, and rays."""
    (tmp_path / "t.toml").write_text(TINY)
    (tmp_path / "aimed.toml").write_text(AIMED)
    (tmp_path / "drawn.toml").write_text(DRAWN)
    (tmp_path / "p.dxf").write_text(DXF)
    np.savez(tmp_path / "rays.npz", position=[[0.0, 0.0, -1.0]], direction=[[0.0, 0.0, 1.0]])
    monkeypatch.chdir(tmp_path)
    return tmp_path


def said(capsys: pytest.CaptureFixture[str], *words: str) -> tuple[int, str]:
    capsys.readouterr()
    status = main(list(words))
    return status, capsys.readouterr().err


def test_whole_numbers_are_ascii_digits_that_64_bits_hold() -> None:
    assert [whole_number(text) for text in ("0", "007", "12", 18 * "9")] == [0, 7, 12, 10**18 - 1]
    assert {
        whole_number(text)
        for text in ("", "-1", "+1", " 1", "²", "٣", "１", "1_0", "0x1", "1.", 19 * "9", LONG)
    } == {None}
    assert whole_number("-5", signed=True) == -5
    assert whole_number("--5", signed=True) is None
    assert [beyond_64_bits(value) for value in (2**63, [1, {"a": 2**64}], -(2**63) - 1, True)] == [
        False,
        True,
        True,
        False,
    ]
    assert array_lengths((0, 3)) == (0, 3)
    assert {array_lengths(shape) for shape in ((True, 3), (1.0, 3), (-1, 3), [1, 3], 3, (2**63, 3))} == {None}


@pytest.mark.parametrize(("wavelength", "shown"), [(1e-9, "1 nm"), (1.0, "1 m"), (1e300, "1e+300 m")])
def test_rays_of_a_wavelength_that_no_index_is_known_at_are_refused_with_the_range(
    place: Path, capsys: pytest.CaptureFixture[str], wavelength: float, shown: str
) -> None:
    np.savez("x.npz", position=[[0.0, 0.0, -1.0]], direction=[[0.0, 0.0, 1.0]], wavelength=[wavelength])
    status, text = said(capsys, "trace", "t.toml", "x.npz", "-o", "o.npz")
    assert status == 2
    assert f"wavelength {shown}" in text
    assert "from 435.8 to 1052 nm" in text
    assert not Path("o.npz").exists()


@pytest.mark.parametrize(
    "shape", ["(True, 3)", "(1.0, 3)", "(False, 3)", f"({LONG}, 3)", "[1, 3]", "(10**30, 3)"]
)
def test_rays_whose_header_states_no_whole_numbers_are_refused(
    place: Path, capsys: pytest.CaptureFixture[str], shape: str
) -> None:
    head = f"{{'descr': '<f8', 'fortran_order': False, 'shape': {shape}, }}"
    data = {name: npy(head, np.array([[0.0, 0.0, 1.0]]).tobytes()) for name in ("position", "direction")}
    Path("x.npz").write_bytes(npz(**data))
    status, text = said(capsys, "trace", "t.toml", "x.npz", "-o", "o.npz")
    assert (status, "array 'position'" in text) == (2, True)
    assert " at 0x" not in text
    assert not Path("o.npz").exists()


def test_a_mesh_without_triangles_fails_verify_and_is_bad_input_to_trace(
    place: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    Path("x.stl").write_bytes(bytes(80) + struct.pack("<I", 0))
    status, text = said(
        capsys, "trace", "t.toml", "rays.npz", "--rung", "mesh", "--mesh", "x.stl", "-o", "o.npz"
    )
    assert (status, "x.stl holds no triangles" in text) == (2, True)
    from clacad.formats.mesh.readers import read_mesh
    from clacad.storage.errors import UnreadableFile

    with pytest.raises(UnreadableFile, match="no triangles") as caught:
        read_mesh(Path("x.stl"))
    assert caught.value.exit_status == 1


@pytest.mark.parametrize(
    ("old", "new", "complaint"),
    [("\n42\n", "\n--5\n", "not a group code"), ("70\n4\n", f"70\n{LONG}\n", "$INSUNITS"), ("70\n4\n", "70\n²\n", "$INSUNITS")],
    ids=["code", "digits", "superscript"],
)  # fmt: skip
def test_a_drawing_with_numbers_that_are_none_is_refused(
    place: Path, capsys: pytest.CaptureFixture[str], old: str, new: str, complaint: str
) -> None:
    Path("p.dxf").write_text(DXF.replace(old, new, 1))
    status, text = said(capsys, "check", "drawn.toml")
    assert (status, complaint in text) == (2, True)


@pytest.mark.parametrize("words", [
    ("image", "t.toml", "--rung", ""), ("image", "t.toml", "--rung", ","), ("export", "t.toml", "-o", "o", "--cells", LONG),
    ("check", "t.toml", "--set", f"lattice.pitch={LONG}"), ("check", "t.toml", "--set", f"lattice.count.{LONG}=1"),
    ("check", "t.toml", "--set", f"lattice.count=0x{LONG}"), ("sweep", "t.toml", "--vary", f"lattice.pitch=1:2:{LONG}"),
    ("sweep", "t.toml", "--vary", f"lattice.pitch={LONG}:2:3"), ("explain", LONG), ("explain", f"CL{LONG}"), ("explain", "²"),
], ids=lambda words: " ".join(word[:24] for word in words))  # fmt: skip
def test_a_number_of_5000_digits_and_a_rung_that_is_none_are_refused_in_lines_that_can_be_read(
    place: Path, capsys: pytest.CaptureFixture[str], words: tuple[str, ...]
) -> None:
    status, text = said(capsys, *words)
    assert status == 2
    assert "internal error" not in text
    assert max(map(len, text.splitlines())) <= 500


def test_a_design_file_with_5000_digits_is_refused_without_python_s_words(
    place: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    Path("t.toml").write_text(TINY.replace("pitch = 0.5", f"pitch = {LONG}"))
    status, text = said(capsys, "check", "t.toml")
    assert (status, "digits" in text, "set_int_max" in text) == (2, True, False)


def test_a_value_after_an_option_may_leave_out_the_0_before_a_point(place: Path) -> None:
    from clacad.config.edit_text import parse

    assert parse("tolerances.radius=.01") == ("tolerances.radius", 0.01)
    assert parse("lattice.pitch=-.5") == ("lattice.pitch", -0.5)


@pytest.mark.slow
def test_the_search_for_keys_that_fix_a_design_ends_in_its_seconds_with_the_nearest_found(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A limit that no change reaches: without an end of time it went on for a minute."""
    import tomllib

    from clacad.advice import fewest_keys
    from clacad.design import Design

    design = Design.from_dict(tomllib.loads(TINY), ['check.law_rms="1e-12 mrad"'])
    monkeypatch.setattr(fewest_keys, "SECONDS", 0.5)
    found = fewest_keys.fix(design)
    assert not found.passes
    assert 0 < found.tried < fewest_keys.TRIALS
    assert found.judged is not None
