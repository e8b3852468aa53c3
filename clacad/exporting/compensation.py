"""What files are changed by so that a process makes the part: shrinkage, sink and corrections."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from clacad.base.types import Floats
from clacad.design.process import Process, process_of
from clacad.optics.fit import degree_pairs
from clacad.sheet.cell_places import ALONG, LensForm, of_middle, places_in_rows
from clacad.sheet.shrunk import bent_window, grown_window, growth
from clacad.sheet.window import changed_faces
from clacad.storage.errors import BadRequest

if TYPE_CHECKING:
    from clacad.design import Design
    from clacad.sheet.window import Face, Window


@dataclass(frozen=True, slots=True)
class Compensation:
    """Changes of a file against the part.

    process : Name of the profile.
    shrinkage : Along x, y and z: part = file × (1 − s).
    thickness : Shrinkage of the distances between faces.
    sink : length. Depth by which the middle of a lenslet sinks.
    command : Forms that corrections add to the lenses of the first and the last face, as `form_rows`.
    """

    process: str
    shrinkage: tuple[float, float, float]
    thickness: float
    sink: float
    command: tuple[Floats | None, Floats | None] = (None, None)

    @property
    def plain(self) -> Compensation:
        """The same without the forms of corrections."""
        return replace(self, command=(None, None))

    def window(self, window: Window) -> Window:
        """The sheet as files hold it. Raises CannotShrink."""
        apart = growth((self.thickness,) * 3)[2]
        for face, rows in zip((window.faces[0], window.faces[-1]), self.command, strict=True):
            if rows is not None:
                window = _with_form(window, face, rows)
        return bent_window(grown_window(window, growth(self.shrinkage), apart), self.sink)

    @property
    def cut_as_insert(self) -> bool:
        """Whether a tool cuts the negative of the part."""
        return Process(self.process).cut_as_insert

    @property
    def uniform(self) -> bool:
        """Whether the part is the file at another size, which turns no ray."""
        bent = self.sink or any(rows is not None for rows in self.command)
        return len({*self.shrinkage, self.thickness}) == 1 and not bent

    def to_dict(self, scale: float) -> dict[str, Any]:
        """Entry of a file in the manifest; `scale`: millimetres per design unit."""
        return {
            "process": self.process,
            "shrinkage": list(self.shrinkage),
            "thickness": self.thickness,
            "sink": self.sink * scale,
        }


HEAD, TERMS = 4, ALONG * (ALONG + 1) // 2
"""Numbers before the coefficients in a row of forms; number of polynomials to degree 8."""


def form_rows(half: Floats, count: Sequence[int], shared: Floats, own: Floats) -> Floats:
    """Rows (1 + m, 49) of the forms of a face: half the cell (2,), cells of the sheet (2,),
    coefficients (45,) of all lenses along z; then cell i, j, two zeros, and the
    coefficients that its lens has besides, from `own` (m, 47).
    """
    first = np.array([[*half, *count, *shared]])
    return np.vstack([first, np.insert(own.reshape(-1, 2 + TERMS), [2, 2], 0.0, axis=1)])


def form_name(side: str) -> str:
    """Name of the file of the forms of a side."""
    return f"form-{side}.npy"


def _with_form(window: Window, face: Face, rows: Floats) -> Window:
    """The window with a face whose lenses have forms; cells of the window are the central ones."""
    (i, j), products = zip(*degree_pairs(TERMS)), np.zeros((len(rows), ALONG, ALONG))
    products[:, i, j] = rows[:, HEAD:]
    (half, count), (shared, *others) = (
        (rows[0, :2], rows[0, 2:HEAD].astype(int)),
        products.reshape(-1, ALONG**2),
    )
    own = None
    if len(rows) > 1:
        cells = rows[1:, :2].astype(int)
        table = np.zeros((*count, ALONG**2))
        table[places_in_rows(window.lattice, cells), cells[:, 1]] = others
        own = of_middle(table, window.lattice.count, window.lattice)
    form = LensForm(half, shared, own)
    bodies = changed_faces(window.bodies, lambda one: replace(one, form=form) if one is face else one)
    return replace(window, bodies=bodies)


def _read_forms(folder: Path) -> tuple[Floats | None, Floats | None]:
    """Forms of front and back that `clacad correct` wrote. Raises BadRequest."""
    found: list[Floats | None] = []
    for side in ("front", "back"):
        path = folder / form_name(side)
        try:
            rows = np.load(path, allow_pickle=False) if path.exists() else None
            if rows is not None and (
                rows.ndim != 2 or rows.shape[1] != HEAD + TERMS or not np.isfinite(rows).all()
            ):
                raise ValueError("it holds no rows of coefficients")
        except (ValueError, OSError, EOFError) as error:
            raise BadRequest(f"process.command: {path.name} cannot be read: {str(error)[:80]}") from error
        found.append(rows)
    if all(rows is None for rows in found):
        raise BadRequest(
            f"process.command: {folder} holds no {form_name('front')}; clacad correct -o writes it"
        )
    return found[0], found[1]


def compensation_of(design: Design) -> Compensation:
    """Compensation for the process of a design: section [process] over the defaults of `check.process`."""
    process = process_of(design)
    folder, command = design.process.command, (None, None)
    forms = command if folder is None else _read_forms(Path(design.path).parent / folder)
    sink = process.sink / design.unit_m
    return Compensation(process.name, process.shrinkage, process.thickness, sink, forms)


def nose_of(design: Design) -> float | None:
    """Radius (length) of the nose of a design's process; None where it has no tool."""
    return process_of(design).nose / design.unit_m or None
