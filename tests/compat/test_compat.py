"""Files of format 1 stay readable forever, and keep their meaning.

The designs and the export in the folder of this file are never edited. A change of a number in `meaning.json` is a
change of what an existing design file makes, and needs a new `format`.

    python tests/compat/test_compat.py        print the meaning of every design, for a design that is added
"""

from __future__ import annotations

import json
import shutil
import sys
from pathlib import Path
from typing import Any

import pytest

import clacad

HERE = Path(__file__).parent
DESIGNS = sorted(HERE.glob("*.toml"))


def meaning(path: Path) -> dict[str, Any]:
    """Meaning of a design, in metres: surfaces, their positions, and their number."""
    window = clacad.prescribe(clacad.load(path))
    faces = [face for body in window.bodies for face in (body.front, body.back)]
    return {
        "unit": window.unit,
        "pitch": [p * window.unit for p in window.lattice.pitch],
        "count": list(window.lattice.count),
        "form": window.form,
        "index": [body.index for body in window.bodies],
        "curvature": [
            [face.surface.curvature_x / window.unit, face.surface.curvature_y / window.unit] for face in faces
        ],
        "vertex": [[v * window.unit for v in face.vertex] for face in faces],
        "shifts": [[s * window.unit for s in shift] for shift in window.shifts],
    }


def test_nothing_was_lost() -> None:
    assert {p.stem for p in DESIGNS} == set(json.loads((HERE / "meaning.json").read_text()))


@pytest.mark.parametrize("path", DESIGNS, ids=lambda p: p.stem)
def test_a_design_of_format_1_means_what_it_meant(path: Path) -> None:
    kept = json.loads((HERE / "meaning.json").read_text())[path.stem]
    found = json.loads(json.dumps(meaning(path)))
    assert set(found) == set(kept)
    for key, value in kept.items():
        if key in ("form", "count"):
            assert found[key] == value, key
            continue
        pairs = zip(_flat(found[key]), _flat(value), strict=True)
        assert all(a == pytest.approx(b, rel=1e-9, abs=1e-15) for a, b in pairs), key


def _flat(value: Any) -> list[float]:
    return [x for v in value for x in _flat(v)] if isinstance(value, list) else [float(value)]


@pytest.mark.slow
def test_an_export_of_format_1_is_recognised_and_owned(tmp_path: Path) -> None:
    """Its manifest vouches for its files, so that verify accepts them and a new export may replace them."""
    from clacad.formats.mesh.readers import read_mesh
    from clacad.storage.atomic import owns, read_manifest

    folder = tmp_path / "export"
    shutil.copytree(HERE / "export", folder)
    manifest = read_manifest(folder)
    assert manifest is not None
    assert {e["name"] for e in manifest["files"]} == {
        "tiny.stl",
        "tiny.3mf",
        "tiny.surfaces.json",
        "tiny.poses.csv",
    }
    assert all(owns(manifest, folder / e["name"]) for e in manifest["files"])
    for entry in manifest["files"]:
        if entry["format"] in ("stl-binary", "3mf"):
            mesh = read_mesh(folder / entry["name"])
            assert sum(len(rows) for rows in mesh.chunks()) == entry["triangles"]
    design = clacad.load(HERE / "export" / "tiny.design.toml")
    clacad.export(design, folder, formats=("stl",), quads=3)


def test_every_design_that_comes_with_the_program_keeps_its_hash() -> None:
    """A new key at its default is absent from the canonical text, so that exports made before stay known as theirs."""
    recorded = json.loads((HERE / "designs_sha256.json").read_text(encoding="utf-8"))
    designs = {path.name: path for path in sorted(HERE.parents[1].joinpath("designs").glob("*.toml"))}
    assert recorded.keys() <= designs.keys()
    assert {name: clacad.load(designs[name]).sha256 for name in recorded} == recorded


if __name__ == "__main__":
    sys.stdout.write(json.dumps({p.stem: meaning(p) for p in DESIGNS}, indent=1, sort_keys=True) + "\n")
