"""Files of a measured part: its numbers, one row for each lenslet, and its deviation maps."""

from __future__ import annotations

import csv
import io
import json
import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from clacad.base.units import millimetres
from clacad.measuring.form_and_seams import Surface
from clacad.measuring.measured import Measured
from clacad.storage.atomic import canonical_json, write_set

NUMBERS, TABLE = "measured.json", "lenslets.csv"


def write_measured(found: Measured, folder: str | os.PathLike[str], *, overwrite: bool = False) -> list[Path]:
    """Write measured.json, lenslets.csv and the deviation map of each side; their paths.

    A deviation map is a NPY file of heights in the design's unit, out of the material, NaN where no whole
    lenslet was measured, with its scales in a JSON file next to it: `clacad` reads it as it reads a map.

    Raises CannotWrite, ExportRefused.
    """
    contents: dict[str, str | bytes] = {NUMBERS: canonical_json(found.to_dict()), TABLE: _table(found)}
    for name, one in found.sides.items():
        contents |= dict(_deviation(f"deviation-{name}.npy", one, found.design.unit_m))
    write_set(folder, contents, overwrite=overwrite, replace=_ours)
    return [Path(folder) / name for name in contents]


def _table(found: Measured) -> str:
    """One row for each lenslet, names of the columns first."""
    columns = {name: one for name, one in found.to_columns().items() if not name.startswith("law_")}
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows(zip(*columns.values(), strict=True))
    return text.getvalue()


def _deviation(name: str, one: Surface, unit_m: float) -> Iterator[tuple[str, str | bytes]]:
    """Map of the measured surface less the design's, and its scales."""
    data = io.BytesIO()
    np.save(data, one.deviation.astype(np.float32), allow_pickle=False)
    yield name, data.getvalue()
    scale = millimetres(unit_m)
    told = {
        "pixel_mm": [pixel * scale for pixel in one.measured.pixel],
        "z_step_mm": scale,
        "z_at_0_mm": 0.0,
        "row_0": "bottom",
    }
    yield f"{name}.json", json.dumps(told, indent=1, sort_keys=True) + "\n"


def _ours(path: Path) -> bool:
    """Whether a file was written by an earlier run next to its measured.json."""
    try:
        with (path.parent / NUMBERS).open(encoding="utf-8") as stream:
            return '"law_rms_by_cell"' in stream.read(1 << 20)
    except (OSError, UnicodeDecodeError):
        return False
