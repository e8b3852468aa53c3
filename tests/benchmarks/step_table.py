"""Measure STEP writing: fused and instanced sheets of growing size, beside the Boolean route.

    python tests/benchmarks/step_table.py [--design FILE] [--sizes 10 50 100 200] [--boolean 5]

Prints a Markdown table. Every row runs in a process of its own, so that its peak memory is its own.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT))


def written(design: str, n: int, mode: str, pcurves: bool) -> dict[str, float]:
    """Write one sheet of n × n cells; what it took."""
    import clacad
    from clacad.export.step import write_step

    window = clacad.prescribe(clacad.load(design)).with_cells((n, n))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "sheet.step"
        start = time.process_time()
        facts = write_step(window, path, mode=mode, pcurves=pcurves)
        seconds = time.process_time() - start
    return {"seconds": seconds, "megabytes": facts["bytes"] / 1e6, "faces": facts["faces"],
            "solids": facts["solids"], "memory": _peak()}  # fmt: skip


def by_booleans(n: int) -> dict[str, float]:
    """The obvious route: intersect a prism with two spheres for every cell, fuse the cells, export."""
    import build123d as b

    pitch, radius, thickness = 0.5, 1.0, 0.2
    start = time.process_time()
    lens = b.Pos(0, 0, radius - thickness / 2) * b.Sphere(radius) & b.Pos(
        0, 0, thickness / 2 - radius
    ) * b.Sphere(radius)
    lens &= b.Box(pitch, pitch, 1.0)
    cells = [b.Pos(i * pitch, j * pitch, 0) * lens for i in range(n) for j in range(n)]
    sheet = cells[0].fuse(*cells[1:]) if n > 1 else cells[0]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "sheet.step"
        b.export_step(sheet, str(path))
        size = path.stat().st_size
    return {"seconds": time.process_time() - start, "megabytes": size / 1e6, "faces": len(sheet.faces()),
            "solids": len(sheet.solids()), "memory": _peak()}  # fmt: skip


def _peak() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def _apart(*arguments: object) -> dict[str, float]:
    command = [sys.executable, __file__, "--row", *map(str, arguments)]
    return json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--design", default=str(ROOT / "designs" / "tilted.toml"))
    parser.add_argument("--sizes", type=int, nargs="+", default=[10, 50, 100, 200])
    parser.add_argument("--boolean", type=int, default=5, help="largest sheet to build by Booleans (0: none)")
    parser.add_argument("--row", nargs="+", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.row:
        kind, n, *rest = options.row
        result = (
            by_booleans(int(n)) if kind == "boolean" else written(rest[0], int(n), kind, rest[1] == "True")
        )
        sys.stdout.write(json.dumps(result))
        return
    out = sys.stdout
    out.write("| N × N | route | CPU s | MB | faces | solids | peak MB |\n|---|---|---|---|---|---|---|\n")
    rows = [(f"fused{'' if curves else ', no parameter curves'}", n, ("fused", n, options.design, curves))
            for n in options.sizes for curves in (True, False)]  # fmt: skip
    rows += [("instanced", n, ("instanced", n, options.design, True)) for n in options.sizes]
    rows += [("Booleans", n, ("boolean", n)) for n in (2, 5, 10) if n <= options.boolean]
    for name, n, arguments in rows:
        row = _apart(*arguments)
        out.write(f"| {n} | {name} | {row['seconds']:.2f} | {row['megabytes']:.2f} | {row['faces']:.0f} "
                  f"| {row['solids']:.0f} | {row['memory']:.0f} |\n")  # fmt: skip
        out.flush()


if __name__ == "__main__":
    main()
