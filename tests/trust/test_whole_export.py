"""A whole export: repeated anywhere, judged right afterwards."""

from __future__ import annotations

import os
import socket
from hashlib import sha256
from pathlib import Path

import pytest
from trust.running import TINY, clacad

from clacad.design import Design
from clacad.export import export
from clacad.verify import verify

ALL = "stl,stl-parts,3mf,ply,glb,sag,tiff,png,xyz,table,mask"


def tiny() -> Design:
    import tomllib

    return Design.from_dict(tomllib.loads(TINY))


@pytest.fixture(scope="session")
def design(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("design") / "tiny.toml"
    path.write_text(TINY)
    return path


def contents(folder: Path) -> dict[str, str]:
    """Hash of every file but the run facts."""
    return {
        p.name: sha256(p.read_bytes()).hexdigest() for p in sorted(folder.iterdir()) if p.name != "run.json"
    }


# -- repeated --------------------------------------------------------------------------------------

CIRCUMSTANCES: dict[str, dict[str, str]] = {
    "hash seed, one thread, far east": {
        "PYTHONHASHSEED": "1", "CLACAD_THREADS": "1", "TZ": "Pacific/Auckland", "LANG": "C", "LC_ALL": "C",
    },
    "other hash seed, two threads, decimal comma": {
        "PYTHONHASHSEED": "4242", "CLACAD_THREADS": "2", "TZ": "America/Caracas", "LANG": "de_DE.UTF-8",
        "LC_ALL": "de_DE.UTF-8", "USER": "somebody", "HOME": "/", "SOURCE_DATE_EPOCH": "1",
    },
}  # fmt: skip


@pytest.mark.parametrize("formats", ["step", ALL], ids=["solid", "all others"])
def test_the_bytes_do_not_depend_on_circumstances(design: Path, tmp_path: Path, formats: str) -> None:
    found = []
    for k, changes in enumerate(CIRCUMSTANCES.values()):
        here = tmp_path / f"folder {k}" / ("ä" * k)
        here.mkdir(parents=True)
        out = here / "out"
        name = os.path.relpath(design, here) if k else design
        target = "out" if k else out
        ended = clacad(
            "export", name, "-o", target, "--format", formats, "--quads", "4", "-q", cwd=here, **changes
        )
        assert ended.status == 0, ended.err
        found.append(contents(out))
    assert found[0] == found[1]
    assert len(found[0]) > (1 if formats == "step" else 20)


# -- judged afterwards ------------------------------------------------------------------------------


def test_thin_bodies_far_apart_are_0(tmp_path: Path) -> None:
    """float32 moves the far body's plane by half a spacing as a whole: much of a thin body, and no fault."""
    apart = Design.from_dict({
        "format": 1, "name": "apart", "unit": "m", "law": {"eta": [1.3, 1.3], "delta": [-0.02, 0.013]},
        "pair": {"form": "plano", "separation": 0.0525, "index": 1.767}, "lattice": {"pitch": 0.0014, "count": [2, 2]},
    })  # fmt: skip
    export(apart, tmp_path, formats=("stl",), quads=16)
    checks = verify(apart, tmp_path, rays=2048).checks
    assert [c.state for c in checks if c.id == "volume"] == ["pass"]


# -- alone -----------------------------------------------------------------------------------------


def test_no_test_can_reach_another_machine() -> None:
    with pytest.raises(Exception, match="look-up"):
        socket.create_connection(("example.org", 80), timeout=1)
    with socket.socket() as plain, pytest.raises(Exception, match="connect"):
        plain.connect(("192.0.2.1", 80))
