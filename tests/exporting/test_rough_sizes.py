"""The quick size estimate of an export in `check` is near the close forecast, and loads nothing that writes."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

import clacad
from clacad.exporting.forecast import forecast, outlook
from clacad.exporting.formats.format import RoughSheet
from clacad.exporting.tessellations import Meshes
from clacad.prescription.prescribe import prescribe

ROOT = Path(__file__).parents[2]
NAMES = (
    "paper-base",
    "baffled",
    "plano",
    "hexagonal",
    "tilted-seam",
    "tilted-biconvex",
    "fig5-phi-45",
    "window-100mm",
)


def off(one: float, other: float) -> float:
    """Factor between two numbers."""
    return max(one, other) / min(one, other)


@pytest.mark.ci_cases("baffled", "tilted-biconvex", "window-100mm")
@pytest.mark.daily_cases("plano", "paper-base")
@pytest.mark.parametrize("name", NAMES)
def test_rough_sizes_are_near_the_close_ones(name: str) -> None:
    asked = clacad.load(ROOT / "designs" / f"{name}.toml")
    window = prescribe(asked)
    meshes = Meshes(window)
    step, threemf = forecast(meshes, ("step", "3mf"), 8)
    said = {row["format"]: row for row in outlook(window)}
    assert off(said["step"]["bytes"], step.bytes) < (2.0 if window.lattice.cell_count <= 2500 else 1.25)
    assert off(said["3mf"]["bytes"], threemf.bytes) < 1.5
    assert off(said["3mf"]["facets"], threemf.facets or 0) < 1.45
    sheet = RoughSheet.of_window(window)
    assert off(sheet.facets(64) * sheet.cells, meshes.facets(64)) < 1.1
    for rough in (sheet, RoughSheet.of_design(asked)):
        assert (rough.lenses, rough.bodies, rough.count, rough.hexagonal) == (
            sum(face.array is not None for face in window.faces), len(window.bodies), tuple(window.lattice.count), window.lattice.hexagonal,
        )  # fmt: skip


@pytest.mark.slow
def test_a_check_loads_no_mesher_no_solids_and_no_writer() -> None:
    program = (
        "import json, sys; from clacad.cli.check_command import CheckDesign, run_check; from clacad.cli.console import Console; "
        "from pathlib import Path; "
        "run_check(CheckDesign(design=Path('designs/plano.toml')), Console(quiet=True)); print(json.dumps(sorted(sys.modules)))"
    )
    loaded = json.loads(
        subprocess.run(
            [sys.executable, "-c", program], check=True, capture_output=True, text=True, cwd=ROOT
        ).stdout
    )
    heavy = (
        "clacad.mesh",
        "clacad.solid",
        "clacad.topology",
        "clacad.formats.step.step_files",
        "scipy",
        "numba",
        "manifold3d",
    )
    assert not [
        name for name in loaded if name in heavy or name.startswith(tuple(f"{one}." for one in heavy))
    ]


@pytest.mark.slow
@pytest.mark.parametrize(
    "aperture",
    [[0.01, 0.004], pytest.param({"point": [3, -2, -150]}, marks=pytest.mark.slow)],
    ids=["steered", "aimed"],
)
def test_the_step_file_of_a_round_slab_with_displaced_arrays_is_forecast(aperture) -> None:
    from clacad.exporting.formats.step import step_bytes
    from clacad.formats.step.step_files import step_text_length

    design = clacad.load(ROOT / "designs" / "window-100mm.toml").replace(
        {
            "lattice.outline": {"circle": 7},
            "lattice.count": [16, 16],
            "lattice.aperture": aperture,
            "check.process": "none",
        }
    )
    window = prescribe(design)
    assert off(step_bytes(window, "fused"), step_text_length(window, "fused")) < 1.3


@pytest.mark.parametrize("pitch", [0.495, 0.51])
def test_the_step_file_of_a_slab_whose_array_2_has_another_pitch_is_forecast(pitch) -> None:
    """The cell that is forecast has its partner aside; the plate of the sheet's arrays alone would cut it."""
    from clacad.exporting.formats.step import step_bytes
    from clacad.formats.step.step_files import step_text_length

    keys = {"format": 1, "name": "pitch", "unit": "mm", "law": {"eta": [-1.0, -1.0]},
            "pair": {"form": "slab", "separation": 10.0, "index": 1.49, "offset": "paraxial"},
            "lattice": {"pitch": 0.5, "count": [9, 2], "pitch_2": pitch}}  # fmt: skip
    window = prescribe(clacad.Design.from_dict(keys))
    assert off(step_bytes(window, "fused"), step_text_length(window, "fused")) < 1.5
