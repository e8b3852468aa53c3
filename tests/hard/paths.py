"""Every path of the tracer through a hard sheet: the results of all, as a table.

python tests/hard/paths.py            print it, exit 1 where a path differs from the oracle and no reason is given
python tests/hard/paths.py --write    tests/hard/paths.md
"""

from __future__ import annotations

import sys
from ast import literal_eval
from functools import cache
from pathlib import Path

import numpy as np

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE.parent), str(HERE.parents[1])]

from hard.rays import HARD  # noqa: E402
from hard.sheets import SHEETS, window_of  # noqa: E402
from oracle import law as law_oracle  # noqa: E402
from oracle import sheet as sheet_oracle  # noqa: E402

from clacad import tessellate, trace  # noqa: E402
from clacad.optics.rays import Fate, Rays  # noqa: E402

PAGE = HERE / "paths.md"
QUADS = 32
"""Facets a cell side of the mesh path."""


def looked_at(window, rays, compiled):
    """The rays as the renderer sends them: only if the bounding box shows that they may hit the sheet."""
    from clacad.rendering.sheet_passage import Passage
    from clacad.rendering.view import may_cross, sheet_box

    passage = Passage("surfaces", (Fate.ALIVE, Fate.GHOST, Fate.LAND))
    beyond, result = passage.light(window, rays, compiled)
    if result.fate[0] != Fate.MISSED:
        assert may_cross(sheet_box(window), rays.position, rays.direction)[0]
    if result.fate[0] in (Fate.ALIVE, Fate.GHOST):
        assert np.array_equal(beyond.direction, result.direction)
        assert np.array_equal(beyond.position, result.position)
        assert beyond.parent.tolist() == [0]
    return result


@cache
def _faceted(changes):
    window = window_of(dict(literal_eval(changes)))
    return window, tessellate(window, quads=QUADS)


def faceted(case):
    """The sheet of a case and its mesh."""
    return _faceted(repr(case.changes))


def turned_by_facets(window, mesh):
    """Most that facets turn light: six times their rms slope error, on lens 2 multiplied by the telescope."""
    stretch = 1 + np.linalg.svd(window.law.matrix(), compute_uv=False)[0]
    return 6 * mesh.slope_error * stretch * max(body.index - 1 for body in window.bodies)


PATHS = {
    "numpy": lambda window, rays: trace(window, rays, path="numpy"),
    "numba": lambda window, rays: trace(window, rays, path="numba"),
    "renderer, numpy": lambda window, rays: looked_at(window, rays, False),
    "renderer, compiled": lambda window, rays: looked_at(window, rays, True),
}


def told(result):
    """Fate, cell and order of the one ray of a result."""
    return Fate(result.fate[0]).name, tuple(result.cell[0].tolist()), tuple(result.order[0].tolist())


def expected(case):
    """Fate by the oracle."""
    window, _ = faceted(case)
    return sheet_oracle.trace(window, case.start, case.direction).fate


def row(case):
    """Result of each path for a case: its name, fate by the oracle, then a word a path."""
    window, mesh = faceted(case)
    rays, fate = Rays([case.start], [case.direction]), expected(case)
    exact = trace(window, rays, path="numpy")
    words = [_word(told(run(window, rays))[0], fate, case.undecidable) for run in PATHS.values()]
    result = trace(window, rays, rung="mesh", mesh=mesh)
    if told(result) == told(exact):
        apart = float(law_oracle.angle(result.direction[0], exact.direction[0]))
        words.append(
            f"same, {apart:.1e} rad" if apart <= turned_by_facets(window, mesh) else "beyond its error"
        )
    else:
        words.append("undecidable" if case.facets or case.undecidable else "differs")
    return [case.name, fate, *words]


def _word(found, fate, undecidable):
    return "same" if found == fate else "undecidable" if undecidable else "differs"


def page():
    """The table and what it counts."""
    rows = [row(case) for case in SHEETS]
    head = ["case", "oracle", *PATHS, f"mesh, {QUADS} quads"]
    lines = ["| " + " | ".join(cells) + " |" for cells in (head, ["---"] * len(head), *rows)]
    why = [f"* **{case.name}**: {case.facets}" for case in SHEETS if case.facets]
    rim = [f"* **{case.name}** (every path): {case.why}" for case in SHEETS if case.undecidable]
    agree = sum(cells[-1].startswith("same") for cells in rows)
    return (
        "# Every path the same\n\n"
        "Rays through whole sheets: fate by the oracle in 60 digits, and what each path says; the mesh path also by how\n"
        "much its facets turn the light. Written by `python tests/hard/paths.py --write`.\n\n"
        + "\n".join(lines)
        + f"\n\nThe mesh path gives fate, cell and order of {agree} of {len(rows)} cases. Facets cannot decide the others, and why:\n\n"
        + "\n".join([*why, *rim])
        + f"\n\nThe {len(HARD)} rays through single surfaces (`rays.py`) have no mesh: facets are made of a window's cells, not of\n"
        "explicit surfaces. There the numpy and the compiled surfaces are held to the oracle\n"
        "(`tests/hard/test_hard_kernels.py`). Laws, heights, cells, angles and views have one implementation each.\n"
    )


def main(write):
    """Print or record."""
    text = page()
    if write:
        PAGE.write_text(text, encoding="utf-8")
    else:
        print(text)
    return int("differs" in text or "beyond its error" in text)


if __name__ == "__main__":
    raise SystemExit(main("--write" in sys.argv[1:]))
