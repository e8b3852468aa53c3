"""Contents of a file for a workshop: one solid, one mesh, or a cell repeated; chosen by size, by `fused`, and reported."""

from __future__ import annotations

import zipfile
from pathlib import Path
from xml.etree import ElementTree

import pytest

import clacad
from clacad.cli.tables import files_text
from clacad.exporting.request import Request
from clacad.exporting.run import export
from clacad.storage.errors import BadRequest

DESIGN = Path(__file__).parents[2] / "designs" / "hexagonal.toml"


def tags(path):
    """Count of each tag in the model of a 3MF file, read as plain XML."""
    root = ElementTree.fromstring(zipfile.ZipFile(path).read("3D/3dmodel.model"))
    found = {}
    for element in root.iter():
        name = element.tag.split("}")[1]
        found[name] = found.get(name, 0) + 1
    return found


@pytest.mark.slow
def test_a_fused_3mf_is_one_mesh_a_body_with_the_volume_of_the_repeated_one(tmp_path):
    design = clacad.load(DESIGN).with_cells((3, 2))
    bodies = len(clacad.prescribe(design).bodies)
    one, many = (
        export(design, tmp_path / str(fused), ("3mf", "glb"), quads=4, fused=fused) for fused in (True, False)
    )
    single, repeated = (tags(made.path("3mf")) for made in (one, many))
    assert single["object"] == single["mesh"] == single["item"] == bodies
    assert "component" not in single
    assert repeated["component"] == 6 * bodies
    assert single["triangle"] > repeated["triangle"]
    entries = [next(e for e in made.files if e["format"] == "3mf") for made in (one, many)]
    assert entries[0]["volume"] == pytest.approx(entries[1]["volume"], rel=1e-9)
    assert [entry["mode"] for entry in entries] == ["fused", "instanced"]
    said = files_text(one.files), files_text(many.files)
    assert "one mesh each" in said[0]
    assert "each one cell repeated 6 times (--fused: one mesh each)" in said[1]


@pytest.mark.slow
def test_a_fused_step_is_one_solid_where_the_sheet_is_one_piece(tmp_path):
    from build123d import import_step

    design = clacad.load(DESIGN.with_name("slab.toml")).with_cells((2, 2))
    found = {}
    for name, options in {"fused": {"fused": True}, "instanced": {"step": "instanced"}}.items():
        manifest = export(design, tmp_path / name, ("step",), **options)
        found[name] = len(import_step(str(manifest.path("step"))).solids())
        assert f"{found[name]} solid" in files_text(manifest.files)
    assert found == {"fused": 1, "instanced": 4}


def test_fused_decides_about_step_and_contradicts_instanced():
    assert Request(fused=True).step == "fused"
    assert Request().step == "auto"
    with pytest.raises(BadRequest, match="one or the other"):
        Request(fused=True, step="instanced")
