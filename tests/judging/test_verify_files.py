"""Files made wrong on purpose are distinguished from right ones, regardless of what else is in the folder."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from filesonly import only_files
from oracle.plain_mesh import facets, sheet_facets, write_stl

from clacad.design import Design
from clacad.exporting.run import export
from clacad.judging.delivery import list_files
from clacad.judging.registration import place
from clacad.prescription.prescribe import prescribe
from clacad.verification import CannotRegister, passed, verify

DESIGN = Design.from_dict({
    "format": 1, "name": "good", "unit": "m", "law": {"eta": [-0.25, -1.0], "delta": [0.01, 0.0]},
    "pair": {"form": "biconvex", "separation": 0.05, "thickness": "auto", "index": 1.5},
    "lattice": {"pitch": 0.005, "count": [5, 4]},
})  # fmt: skip
RAYS = 8192
MM = 1e3


@pytest.fixture(scope="module")
def soup():
    return sheet_facets(prescribe(DESIGN), 8)


@pytest.fixture(autouse=True)
def _only_files(monkeypatch):
    """What does not depend on files is tested by itself: here it is done once, and refinement left out."""
    only_files(monkeypatch)


def judged(tmp_path, triangles, design=DESIGN, name="part.stl", **options):
    path = tmp_path / name
    write_stl(path, triangles * MM)
    return verify(design, path, rays=RAYS, **options)


def failed(report):
    return {c.id for c in report.checks if c.state == "fail"}


def with_manifest(folder, design=DESIGN):
    """Seal all files of a folder as an export would."""
    from clacad.storage.atomic import canonical_json, file_hash

    files = [
        {"name": p.name, "sha256": file_hash(p), "bytes": p.stat().st_size, "format": "stl-binary", "unit": "mm",
         "bodies": ["array1", "array2"]}
        for p in sorted(folder.glob("*.stl"))
    ]  # fmt: skip
    window = {"cells_written": list(design.lattice.count)}
    (folder / "manifest.json").write_text(
        canonical_json(
            {
                "format": 1,
                "design": {"name": design.name, "sha256": design.sha256},
                "window": window,
                "files": files,
            }
        )
    )


LIGHT = {
    f"file_{what}" for what in ("law_rms", "law_bias", "law_eta", "law_delta", "confocality", "throughput")
}


@pytest.mark.slow
def test_a_coarse_file_that_is_the_design_is_a_shape_only(tmp_path, soup):
    report = judged(tmp_path, soup)
    assert report.word == "shape only"
    assert report.exit_status == 1
    assert {"file_law_rms"} <= failed(report) <= LIGHT
    assert "mrad" in report.verdict()
    assert {c.id for c in report.checks} >= LIGHT


@pytest.mark.slow
def test_a_coarse_file_declared_as_a_preview_is_accepted_as_a_shape(tmp_path, soup):
    report = judged(tmp_path, soup, role="preview")
    assert failed(report) == set()
    assert report.word == "shape only"
    assert report.verdict().startswith("shape only")
    assert report.exit_status == 0
    assert {
        "closed",
        "volume",
        "shape",
        "faithful_rms",
        "faithful_eta",
        "faithful_delta",
        "scale",
        "pieces",
    } <= {c.id for c in report.checks if c.state == "pass"}


@pytest.mark.ci_cases("eta_x off by 2 %", "radii of another index")
@pytest.mark.slow
@pytest.mark.parametrize(("change", "culprit"), [
    pytest.param({"law.eta": [-0.255, -1.0]}, "faithful_eta", id="eta_x off by 2 %"),
    pytest.param({"law.eta": [-0.25, -1.02]}, "faithful_eta", id="eta_y off by 2 %"),
    pytest.param({"law.delta": [-0.01, 0.0]}, "pose", id="delta of the other sign"),
    pytest.param({"pair.index": 1.52}, "faithful_eta", id="radii of another index"),
])  # fmt: skip
def test_a_file_of_another_design_fails_by_name(tmp_path, change, culprit):
    wrong = sheet_facets(prescribe(DESIGN.replace(change)), 8)
    report = judged(tmp_path, wrong, cells=(5, 4))
    assert not report.passed
    assert culprit in failed(report)


@pytest.mark.ci_cases("facet dropped", "inside out", "grown by 0.3 %")
@pytest.mark.daily_cases("empty")
@pytest.mark.parametrize(("spoil", "culprit"), [
    pytest.param(lambda t: np.delete(t, 100, axis=0), "closed", id="facet dropped"),
    pytest.param(lambda t: np.concatenate([t[:77], t[77:78, ::-1], t[78:]]), "closed", id="facet flipped"),
    pytest.param(lambda t: t[:, ::-1], "volume", id="inside out"),
    pytest.param(lambda t: t * [1.0, 1.0, 1.01], "shape", id="stretched in z"),
    pytest.param(lambda t: t * 1.003, "scale", id="grown by 0.3 %"),
    pytest.param(lambda t: t * [-1.0, 1.0, 1.0], "volume", id="mirrored"),
    pytest.param(lambda t: t[len(t) // 2 :], "pieces", id="half is missing"),
    pytest.param(lambda t: t[:0], "readable", id="empty"),
])  # fmt: skip
def test_a_spoilt_file_fails_by_name(tmp_path, soup, spoil, culprit):
    folder = tmp_path / "export"
    folder.mkdir()
    write_stl(folder / "part.stl", spoil(soup) * MM)
    with_manifest(folder)  # a manifest that vouches for the spoilt bytes: only their content can show it
    report = verify(DESIGN, folder, rays=RAYS)
    assert not report.passed
    assert culprit in failed(report)


@pytest.mark.daily_cases("emptied", "cut short")
@pytest.mark.parametrize("spoil", [
    pytest.param(lambda b: b[: len(b) // 2], id="cut short"),
    pytest.param(lambda b: b[:-1] + bytes([b[-1] ^ 1]), id="one bit"),
    pytest.param(lambda b: b"", id="emptied"),
])  # fmt: skip
def test_bytes_that_are_not_those_written_fail_integrity(tmp_path, soup, spoil):
    path = tmp_path / "part.stl"
    write_stl(path, soup * MM)
    with_manifest(tmp_path)
    path.write_bytes(spoil(path.read_bytes()))
    for files in (tmp_path, path):  # the folder, or the file in it
        report = verify(DESIGN, files, rays=RAYS)
        assert "integrity" in failed(report)
        assert report.exit_status == 1


def test_a_file_scaled_a_thousandfold_fails(tmp_path, soup):
    write_stl(tmp_path / "part.stl", soup * MM * 1000.0)
    with_manifest(tmp_path)
    report = verify(DESIGN, tmp_path, rays=RAYS)
    assert "scale" in failed(report)


def test_a_missing_file_fails_and_is_named(tmp_path, soup):
    write_stl(tmp_path / "part.stl", soup * MM)
    with_manifest(tmp_path)
    (tmp_path / "part.stl").unlink()
    report = verify(DESIGN, tmp_path, rays=RAYS)
    check = next(c for c in report.checks if c.id == "integrity")
    assert check.state == "fail"
    assert check.subject == "part.stl"


def test_a_cut_file_without_manifest_cannot_be_read_and_nothing_after_it_is_green(tmp_path, soup):
    path = tmp_path / "part.stl"
    write_stl(path, soup * MM)
    path.write_bytes(path.read_bytes()[:-1000])
    report = verify(DESIGN, path, rays=RAYS)
    about = {c.id: c.state for c in report.checks if c.subject == "part.stl"}
    assert about["readable"] == "fail"
    assert {about[name] for name in ("closed", "volume", "shape", "faithful_rms", "faithful_eta")} == {
        "not run"
    }
    assert report.exit_status == 1


@pytest.mark.slow
def test_a_manifest_of_another_design_is_said_and_the_files_are_still_judged(tmp_path, soup):
    write_stl(tmp_path / "part.stl", soup * MM)
    with_manifest(tmp_path, DESIGN.replace({"name": "other"}))
    report = verify(DESIGN, tmp_path, rays=RAYS, role="preview")
    assert next(c for c in report.checks if c.id == "design").state == "warn"
    assert report.passed


@pytest.mark.daily_cases("0.03937007874015748-in")
@pytest.mark.parametrize(("unit", "word"), [(1.0, "mm"), (1e-3, "m"), (1.0 / 25.4, "in")])
def test_unit_and_cells_are_found_without_a_manifest(tmp_path, soup, unit, word):
    from clacad.formats.mesh.readers import read_mesh

    path = tmp_path / "part.stl"
    write_stl(path, soup * MM * unit)
    placed = place(DESIGN, list_files(path).hashed().subjects[0], read_mesh(path), None)
    assert placed.window.lattice.count == (5, 4)
    assert placed.pose.factor * unit * MM == pytest.approx(1.0)
    assert placed.pose.unit == word
    assert f"read in {word}, 5 x 4 cells" in placed.note


@pytest.mark.slow
def test_fewer_cells_than_designed_are_found(tmp_path):
    part = DESIGN.with_cells((3, 2))
    report = judged(tmp_path, sheet_facets(prescribe(part), 8), role="preview")
    assert report.passed
    assert "3 x 2 cells" in next(c.sentence for c in report.checks if c.id == "readable")


def test_something_else_is_no_part_of_this_design(tmp_path, soup):
    with pytest.raises(CannotRegister, match=r"measures .* mm"):
        judged(tmp_path, soup * [1.0, 1.0, 3.0])


@pytest.mark.slow
def test_one_body_of_two_is_judged_against_that_body(tmp_path):
    window = prescribe(DESIGN)
    report = judged(tmp_path, facets(window, window.bodies[1], 8), role="preview")
    assert report.passed
    assert next(c for c in report.checks if c.id == "bodies").state == "warn"
    assert "array1 taken from the design" in next(c.sentence for c in report.checks if c.id == "readable")


@pytest.mark.slow
def test_every_required_check_that_does_not_run_fails_the_report(tmp_path, soup):
    report = judged(tmp_path, soup, role="preview")
    assert passed(report.checks)
    for k, check in enumerate(report.checks):
        if check.required:
            gone = (*report.checks[:k], replace(check, state="not run", value=None), *report.checks[k + 1 :])
            assert not passed(gone), check.id
            assert replace(report, checks=gone).exit_status == 1


@pytest.mark.slow
def test_the_same_files_give_the_same_json(tmp_path, soup):
    first, second = (judged(tmp_path, soup, role="preview").to_json() for _ in range(2))
    assert first == second
    assert json.loads(first)["passed"] is True
    assert str(tmp_path) not in first


def test_nothing_there_is_said_plainly(tmp_path):
    with pytest.raises(FileNotFoundError):
        verify(DESIGN, tmp_path / "none", rays=RAYS)
    with pytest.raises(FileNotFoundError, match="no manifest"):
        verify(DESIGN, tmp_path, rays=RAYS)


# -- what a manifest withholds -------------------------------------------------------------------------


def sealed(tmp_path, soup, **told):
    """A folder whose manifest contradicts the one file in it."""
    write_stl(tmp_path / "part.stl", soup * MM)
    with_manifest(tmp_path)
    path = tmp_path / "manifest.json"
    manifest = json.loads(path.read_text())
    manifest["files"] = told["files"] if "files" in told else [manifest["files"][0] | told]
    path.write_text(json.dumps(manifest))
    return tmp_path


@pytest.mark.parametrize("told", [
    {"bodies": ["frame"]}, {"bodies": ["x"]}, {"bodies": ["spacer"]}, {"format": "blob"}, {"format": "coupon"}, {"files": []},
    {"role": "other"}, {"role": "other", "bodies": ["coupon"]},
], ids=str)  # fmt: skip
def test_a_manifest_that_keeps_a_file_from_the_light_passes_nothing(tmp_path, soup, told):
    report = verify(DESIGN, sealed(tmp_path, soup, **told), rays=RAYS)
    assert report.word == "not judged"
    assert report.exit_status == 1
    assert {c.id for c in report.checks if c.state in ("fail", "not run") and c.required} == {"delivery"}


@pytest.mark.parametrize("files", [[{}], [7], [{"name": None}]], ids=str)
def test_an_entry_that_names_no_file_fails(tmp_path, soup, files):
    report = verify(DESIGN, sealed(tmp_path, soup, files=files), rays=RAYS)
    assert report.word == "failed"
    assert "integrity" in failed(report)


@pytest.mark.slow
def test_a_role_is_declared_for_a_format_or_a_file_and_for_nothing_else(tmp_path, soup):
    assert judged(tmp_path, soup, role={"stl": "preview"}).exit_status == 0
    assert judged(tmp_path, soup, role={"part.stl": "preview"}).exit_status == 0
    with pytest.raises(ValueError, match="ply"):
        judged(tmp_path, soup, role={"ply": "preview"})
    with pytest.raises(ValueError, match="draft"):
        judged(tmp_path, soup, role="draft")


@pytest.mark.slow
def test_a_preview_of_a_manifest_counts_as_declared_only_where_it_was(tmp_path, soup):
    for declared, status in ((True, 0), (False, 1)):
        told = {"role": "shape-preview", "role_declared": declared}
        report = verify(DESIGN, sealed(tmp_path, soup, **told), rays=RAYS)
        assert (report.word, report.exit_status) == ("shape only", status)
        assert failed(report) == set()


@pytest.mark.slow
def test_a_thin_sheet_whose_steps_are_closed_on_purpose_keeps_its_volume(tmp_path):
    """Twelve steps of less than a nanometre in plates 9 µm thick: 1.6e-8 of their volume, and nothing is wrong."""
    thin = Design.from_dict({
        "format": 1, "name": "thin", "unit": "um",
        "law": {"eta": [-1.9780287328263166, -1.3573234770625056],
                "euler": [64.77035801904802, 0.12297237488719004, -161.37747648584093], "euler_axes": "fixed"},
        "pair": {"form": "plano", "separation": 4506.298149886586, "curved": "outside", "material": "PMMA"},
        "lattice": {"kind": "rectangular", "pitch": [127.99756841609715, 103.35026271817053], "count": [4, 4]},
    })  # fmt: skip
    manifest = export(thin, tmp_path, formats=("step",))
    assert manifest.files[0]["merged_steps"] == 12
    volume = next(c for c in verify(thin, tmp_path, rays=RAYS).checks if c.id == "volume")
    assert volume.state == "pass"
    assert 1e-9 < abs(volume.value) / 0.001864294501938 < 1e-7  # mm³, the design's by quadrature
