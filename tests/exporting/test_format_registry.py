"""One module declares a format: nothing else in the package knows its word."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
from package_source import literals

import clacad
from clacad.exporting.formats import registry

PACKAGE = Path(clacad.__file__).parent
DESIGNS = PACKAGE.parent / "designs"
HOMES = {
    one.word: f"exporting/formats/{name}.py"
    for name in registry.MODULES
    for module in [__import__(f"clacad.exporting.formats.{name}", fromlist=["FORMATS"])]
    for one in (*module.FORMATS, *module.FILES)
}
"""Word of a format or of a kind of files → the module that declares it."""

CODECS = ("formats/", "exporting/drawing/", "exporting/pov/")
"""Files that write and read formats: they name what they read."""

SHARED = {
    "exporting/formats/registry.py": "names of the modules",
    "exporting/formats/format.py": "names of the families",
    "base/untrusted_files.py": "names of readers, each with its limits",
}
"""Files in which every word may occur: why."""

OTHER_MEANINGS = {
    "baffle": {"design/combinations.py", "explorer/page_facts.py", "exporting/fixtures/baffle.py"},  # the key body.baffle, the name of the part
    "cell-table": {"design/cell_table.py", "design/cell_table_rows.py", "exporting/run.py",
                   "report/pictures.py"},  # the reader of a design's table
    "drawing": {"sheet/representative_cells.py"},  # a purpose of cells
    "frame": {"exporting/fixtures/frame.py", "rendering/picture.py", "report/pictures.py",
              "scene/sections.py"},  # the key camera.frame, the name of the part
    "pins": {"design/model.py"},  # the key body.pins
    "png": {"base/drawn_figure.py", "cli/accuracy_command.py", "cli/option_values.py", "cli/steer_command.py",
            "report/measured_section.py", "report/scan_files.py", "imaging/shape.py",
            "imaging/image_by_rays.py", "report/pdf.py", "verification/accuracy/accuracy_plot.py",
            "judging/deviation_map.py", "verification/tolerance/study_files.py",
            "waves/wave_report.py"},  # pictures for people
    "sag": {"explain/look_up.py", "optics/surface/__init__.py",
            "sheet/feasibility/as_rows.py", "checks/design_kinds.py",
            "verification/stability/__init__.py",
            "verification/tolerance/parameter_sweep.py"},  # the height of a lens, its check and its limit
    "scene": {"cli/export_command.py", "design/sections.py", "scene/model.py", "scene/rules.py"},  # scene files
    "step": {"cli/export_command.py", "exporting/request.py",
             "cli/check_command.py", "cli/new_command.py",  # the command to run next
             "stacking/make_stack.py", "cli/stack_command.py",  # the option --step, a default
             "verification/accuracy/accuracy_plot.py", "verification/accuracy/accuracy_row.py",
             "verification/accuracy/measure_rungs.py",  # a rung
             "judging/damage.py", "sheet/feasibility/as_rows.py",
             "verification/tolerance/parameter_sweep.py",  # steps between cells
             "verification/run.py"},  # a task whose time is recorded
    "stl": {"exporting/request.py"},  # a default
    "table": {"cli/shape_command.py", "config/edit_text.py", "config/mistakes.py", "design/varying.py",
              "optics/material/catalogue.py", "optics/material/material.py", "report/pdf.py",
              "checks/file_kinds.py", "prescription/cells.py"},  # a check, a key, parts of TOML files, pages and formulas
    "tool": {"checks/design_kinds.py", "explain/look_up.py"},  # the check of the nose, a limit of processes
    "xyz": {"base/interactive.py", "sheet/shrunk.py", "cli/image_command.py", "paper/figure1.py", "judging/mesh_wholeness.py",
            "judging/registration.py"},  # the axes
}  # fmt: skip
"""Files in which a word means something else; one that is gone fails."""

TOY = '''"""Dots: the height of each face at the centre of the middle cell."""

from clacad.exporting.formats.format import FileKind, Reading
from clacad.exporting.formats.format import Forecast, Format


def heights(window, face):
    from clacad.sheet.bundle import central_cell
    from clacad.sheet.window import face_height
    import numpy as np

    middle = np.array([central_cell(window)])
    return face_height(window, face, np.zeros(1), np.zeros(1), middle)


def write(job):
    from clacad.formats.maps.sag import structured_faces

    records = []
    for body, face, label in structured_faces(job.window):
        path = job.stage.path(f"{job.stem}.{label}.dots")
        path.write_text("\\n".join(map(repr, heights(job.window, face).tolist())))
        records.append(job.record(path, "dots", bodies=[body.name]))
    return records


def forecast(meshes, quads, asked):
    return Forecast("dots", 20 * len(meshes.window.bodies), False, None, None, 0.1, (1000, 2000))


def misfit(file):
    found = [float(line) for line in file.path.read_text().split()]
    return abs(found[0] - heights(file.window, file.face)[0]) * file.scale, 1e-9, "a dot"


READINGS = {"dots": Reading(misfit)}
FORMATS = (Format("dots", "map", "dots of each face", write, forecast, lambda sheet, quads, asked: 0.1),)
FILES = (FileKind("dots", "map", (".dots",), readings=__name__),)
'''

PROGRAM = """
import sys
import clacad.exporting.formats
from clacad.exporting.formats import registry
clacad.exporting.formats.__path__.append(sys.argv[1])
registry.MODULES = (*registry.MODULES, "dots")
from clacad.cli import main
sys.exit(main(sys.argv[2:]))
"""


@pytest.fixture(scope="module")
def written() -> dict[str, set[str]]:
    """Word → files in which it is a literal, without those shared by all words and the codecs, which name what they read."""
    found: dict[str, set[str]] = {word: set() for word in HOMES}
    for path in PACKAGE.rglob("*.py"):
        name = path.relative_to(PACKAGE).as_posix()
        if name not in SHARED and not name.startswith(CODECS):
            for word in literals(path) & HOMES.keys():
                found[word].add(name)
    return found


@pytest.mark.parametrize("word", HOMES)
def test_a_word_is_written_in_the_module_of_its_format_alone(word: str, written: dict[str, set[str]]) -> None:
    assert written[word] - {HOMES[word]} == OTHER_MEANINGS.get(word, set())


def test_every_word_is_known_by_the_registry() -> None:
    assert registry.known(registry.words()) == registry.words()
    assert all(registry.format_of(word).word == word for word in registry.words())
    assert all(registry.kind_of(kind.word) is kind for kind in registry.kinds())


@pytest.mark.parametrize(
    "kind", [kind for kind in registry.kinds() if kind.family == "map"], ids=lambda k: k.word
)
def test_every_map_is_recognised_by_its_ending_and_compared_with_the_design(kind) -> None:
    assert all(registry.kind_ending(f"part.array1.front{end}") is kind for end in kind.ends)
    assert kind.reading.face or kind.reading.sheet


@pytest.mark.slow
def test_a_format_that_is_one_module_is_offered_explained_forecast_written_and_verified(
    tmp_path: Path,
) -> None:
    (tmp_path / "dots.py").write_text(TOY, encoding="utf-8")
    design, out = str(DESIGNS / "slab.toml"), tmp_path / "out"

    def run(*words: str, status: int = 0) -> str:
        done = subprocess.run(
            [sys.executable, "-c", PROGRAM, str(tmp_path), *words], capture_output=True, text=True
        )
        assert done.returncode == status, done.stderr
        return done.stdout

    assert "dots" in run("export", "--help")
    assert "Dots of each face" in run("explain", "dots")
    export = ("export", design, "-o", str(out), "--cells", "3x3", "--format", "dots")
    [row] = json.loads(run(*export, "--dry-run", "--json"))
    assert (row["format"], row["bytes"], row["role"]) == ("dots", 20, "optical-master")
    files = json.loads(run(*export, "--json"))["files"]
    assert [one["format"] for one in files] == ["dots", "dots"]
    verify = ("verify", design, "--files", str(out), "--rays", "512", "--json")
    checks = json.loads(run(*verify))["checks"]
    assert {one["state"] for one in checks if one["id"] == "shape"} == {"pass"}
    path = out / files[0]["name"]
    path.write_text(repr(float(path.read_text()) + 0.01))
    checks = json.loads(run("verify", design, "--files", str(path), "--rays", "512", "--json", status=1))[
        "checks"
    ]
    assert {one["state"] for one in checks if one["id"] == "shape"} == {"fail"}
