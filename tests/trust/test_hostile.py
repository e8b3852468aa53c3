"""A hostile user: any file, name, number or folder gives an error message and the right status."""

from __future__ import annotations

import os
import random
import zipfile
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from filesonly import only_files
from trust.running import TINY


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder full of files that are not what they should be, as the current folder."""
    (tmp_path / "folder").mkdir()
    (tmp_path / "t.toml").write_text(TINY)
    (tmp_path / "broken.toml").symlink_to("nowhere")
    (tmp_path / "link.toml").symlink_to("t.toml")
    (tmp_path / "empty.toml").write_bytes(b"")
    noise = random.Random(0).randbytes(5000)
    for name in (
        "noise.toml",
        "noise.stl",
        "noise.step",
        "noise.glb",
        "noise.3mf",
        "noise.obj",
        "noise.ply",
        "noise.npz",
    ):
        (tmp_path / name).write_bytes(noise)
    (tmp_path / "bom.toml").write_bytes(b"\xef\xbb\xbf" + TINY.encode())
    (tmp_path / "crlf.toml").write_bytes(TINY.replace("\n", "\r\n").encode())
    (tmp_path / "utf16.toml").write_text(TINY, encoding="utf-16")
    for name, old, new in (
        ("bidi.toml", '"tiny"', '"a\\nb\\u202eevil"'), ("traversal.toml", '"tiny"', '"../../evil"'),
        ("inf.toml", "pitch = 0.5", "pitch = 1e400"), ("nan.toml", "pitch = 0.5", "pitch = nan"),
        ("huge.toml", "separation = 10.0", "separation = 1e308"), ("tiniest.toml", "pitch = 0.5", "pitch = 5e-324"),
        ("count.toml", "[2, 2]", "[99999999999999999999999999999999, 2]"), ("deep.toml", "[2, 2]", "[" * 300),
    ):  # fmt: skip
        (tmp_path / name).write_text(TINY.replace(old, new))
    _rays(tmp_path)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def _rays(folder: Path) -> None:
    np.savez(folder / "rays.npz", position=[[0.0, 0.0, -1.0]] * 3, direction=[[0.0, 0.0, 1.0]] * 3)
    np.savez(
        folder / "objects.npz", position=np.array([[object()] * 3], dtype=object), direction=np.zeros((1, 3))
    )
    for name, shape in (("negative", (-5, 3)), ("endless", (10**18, 3)), ("cut", (5, 3)), ("flat", (15,))):
        header = BytesIO()
        np.lib.format.write_array_header_1_0(header, {"descr": "<f8", "fortran_order": False, "shape": shape})
        with zipfile.ZipFile(folder / f"{name}.npz", "w") as archive:
            for array in ("position.npy", "direction.npy"):
                archive.writestr(array, header.getvalue())
    data = bytearray((folder / "rays.npz").read_bytes())
    data[200] ^= 255
    (folder / "flipped.npz").write_bytes(data)
    data[200] ^= 255
    data[data.find(b"PK\x01\x02") + 8] |= 1
    (folder / "secret.npz").write_bytes(data)


READ = ["folder", "broken.toml", "empty.toml", "noise.toml", "utf16.toml", "bidi.toml", "traversal.toml", "inf.toml", "nan.toml",
        "huge.toml", "tiniest.toml", "count.toml", "deep.toml", "missing.toml", "/dev/null", "/dev/zero"]  # fmt: skip
LINES = [
    *((f"{command} {name}", 2) for name in READ for command in ("check", "effects", "export -o out")),
    *((f"trace t.toml {name}.npz -o out.npz", 2) for name in (
        "missing", "noise", "objects", "negative", "cut", "flat", "flipped", "secret")),
    ("trace t.toml endless.npz -o out.npz", 3), ("trace t.toml folder -o out.npz", 2), ("trace t.toml rays.npz -o folder", 4), ("trace t.toml rays.npz -o t.toml", 4),
    ("trace t.toml rays.npz -o /dev/null/x.npz", 4), ("trace t.toml rays.npz -o a\nb.npz", 4),
    ("trace t.toml rays.npz -o q.npz --effects magic", 2), ("trace t.toml rays.npz -o q.npz --rung glass", 2),
    ("trace t.toml rays.npz -o q.npz --rung mesh --mesh missing.stl", 2), ("trace t.toml rays.npz -o q.npz --rung mesh --mesh noise.stl", 2),
    ("trace t.toml rays.npz -o q.npz --rung mesh --quads 0", 2), ("trace t.toml rays.npz -o q.npz --rung mesh --normals up", 2),
    ("verify t.toml --rays 99999999999999999999", 2), ("verify t.toml --rays -1", 2), ("accuracy t.toml --rays 9e9", 2),
    ("accuracy t.toml --target nan", 2), ("verify t.toml --files folder", 2), ("verify t.toml --files broken.toml", 2),
    ("verify t.toml --files /dev/null", 2), ("export t.toml -o t.toml", 4), ("export t.toml -o out --quads 0", 2),
    ("export t.toml -o out --quads 99999999999 --format stl", 3), ("export t.toml -o out --slope-error nan", 2),
    ("export t.toml -o out --slope-error 1e-300 --format stl", 3), ("export t.toml -o out --cells 0x0", 2),
    ("export t.toml -o out --cells 99999999999x1", 3), ("export t.toml -o out --format stl,,exe", 2), ("export t.toml -o out --format ,", 2),
    ("check t.toml --set a.b.c=1", 2), ("check t.toml --set law=1", 2), ("check t.toml --set ==", 2), ("check t.toml --set law.eta=[[[[[", 2),
    ("new folder/../a\nb", 2), ("doctor missing", 1), ("render folder -o x.png", 2), ("render noise.toml -o x.png", 2),
    ("render t.toml noise.toml --preset eye -o x.png", 2),
]  # fmt: skip


@pytest.mark.parametrize(("line", "status"), LINES, ids=[repr(line)[1:-1] for line, _ in LINES])
def test_whatever_is_given_is_answered_by_a_sentence(
    place: Path, capsys: pytest.CaptureFixture[str], line: str, status: int
) -> None:
    from clacad.cli import main

    before = sorted(p.name for p in place.rglob("*"))
    assert main(line.split(" ")) == status
    told = capsys.readouterr()
    assert "Traceback" not in told.err
    assert "internal error" not in told.err
    assert (told.err + told.out).strip()
    assert "\x1b" not in told.err
    assert "\u202e" not in told.err, "a character that turns the line round"
    assert max(map(len, told.err.splitlines()), default=0) < 600
    assert sorted(p.name for p in place.rglob("*")) == before


@pytest.mark.daily_cases("crlf.toml")
@pytest.mark.parametrize("name", ["bom.toml", "crlf.toml", "link.toml"])
def test_harmless_oddities_are_read(place: Path, name: str) -> None:
    from clacad.cli import main

    assert main(["check", name, "-q"]) == 0


@pytest.mark.daily_cases("noise.glb", "noise.3mf", "noise.obj", "noise.ply")
@pytest.mark.parametrize(
    "name", ["noise.stl", "noise.step", "noise.glb", "noise.3mf", "noise.obj", "noise.ply"]
)
def test_a_file_of_noise_fails_its_checks(place: Path, name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    from clacad.design import load
    from clacad.verification import verify

    only_files(monkeypatch)
    (place / name).write_bytes((place / name).read_bytes()[: 0 if name == "noise.stl" else None])
    checks = verify(load("t.toml"), name, rays=256).checks
    assert {c.state for c in checks if c.id == "readable"} == {"fail"}


@pytest.mark.slow
def test_links_in_the_folder_are_not_followed_and_nothing_outside_is_touched(place: Path) -> None:
    """Every name the export will use is a link to something precious, or the folder is one."""
    from clacad.cli import main

    precious = place / "precious"
    precious.mkdir()
    out = place / "out"
    out.mkdir()
    for name in ("tiny.stl", "tiny.poses.csv", "tiny.surfaces.json", "manifest.json", "run.json"):
        (precious / name).write_text("precious")
        (out / name).symlink_to(precious / name)
    words = ["export", "t.toml", "-o", "out", "--format", "stl,table", "--quads", "2", "-q"]
    assert main(words) == 4
    assert main([*words, "--overwrite"]) == 0
    assert {p.read_text() for p in precious.iterdir()} == {"precious"}
    assert not any(p.is_symlink() for p in out.iterdir())
    os.symlink("out", "linked")
    assert main([word.replace("out", "linked") for word in words]) == 0
    assert Path("linked").is_symlink()


@pytest.mark.slow
def test_mutated_step_text_is_scanned_or_refused(tmp_path: Path) -> None:
    """The text is read before the kernel, in this process: it may not crash, hang or grow."""
    from clacad.design import load
    from clacad.exporting.run import export
    from clacad.formats.step.text_health import scan_step
    from clacad.storage.errors import ExportError

    (tmp_path / "t.toml").write_text(TINY)
    export(load(tmp_path / "t.toml"), tmp_path / "out", formats=("step",))
    good = (tmp_path / "out" / "tiny.step").read_bytes()
    path, chance = tmp_path / "x.step", random.Random(1)
    words = [b"#1", b"#99999999999999999999", b"1e999", b"nan", b"(", b")", b"'", b";", b"\0", b"$", b"*", b"/*", b"DATA;", b"=",
             b"B_SPLINE_SURFACE(2,2,"]  # fmt: skip
    outcomes: set[str] = set()
    for _ in range(150):
        data = bytearray(good)
        for _ in range(chance.randint(1, 6)):
            at = chance.randrange(len(data))
            data[at : at + chance.choice([0, 1, 40])] = chance.choice(words)
        path.write_bytes(bytes(data[: chance.randrange(1, len(data))] if chance.random() < 0.2 else data))
        try:
            scan_step(path)
            outcomes.add("read")
        except ExportError as error:
            outcomes.add("refused" if str(error).strip() else "refused without a word")
    assert "read" in outcomes
    assert "refused without a word" not in outcomes
