"""What a STEP file costs, by N: `python tests/benchmarks/step_table.py --into tests/benchmarks/step.md` writes the table.

Fused and instanced, with and without parameter curves, compared with the obvious route by Boolean operations of the CAD
kernel. Every row runs in a process of its own, so that its peak memory is its own; seconds are processor seconds, those
of a limit too: a busy machine takes longer, it does not stop a row earlier. Rows that are not requested stay as the
file has them.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT))

MARKS = ("<!-- table -->", "<!-- end of table -->")
HEAD = ("| design | N × N | route | build s | write s | MB | faces | solids | peak MB |\n"
        "|---|---|---|---|---|---|---|---|---|\n")  # fmt: skip
SIZES = (10, 50, 100, 200)
BARE = 100
"""Largest sheet that is also written without parameter curves."""
BOOLEAN_SECONDS = 600


class Nothing:
    """A writer that only counts: describing a sheet to it is building without writing."""

    def __init__(self) -> None:
        self._count = 0

    def vertex(self, *_: Any) -> int:
        """Count."""
        self._count += 1
        return self._count

    edge = surface = face = vertex


def written(design: str, n: int, mode: str, pcurves: bool) -> dict[str, float]:
    """Build, then build and write one sheet of n × n cells; what each took."""
    import clacad
    from clacad.formats.step.step_files import write_step
    from clacad.solid.solids import describe_body

    window = clacad.prescribe(clacad.load(design)).with_cells((n, n))
    again = clacad.prescribe(clacad.load(design)).with_cells((n, n))  # nothing kept from the first
    start = time.process_time()
    if mode == "fused":
        for body in window.bodies:
            describe_body(window, body, Nothing())
    build = time.process_time() - start
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "sheet.step"
        start = time.process_time()
        facts = write_step(again, path, mode=mode, pcurves=pcurves)
        total = time.process_time() - start
    if mode != "fused":
        build = 0.0  # one cell, one row: nothing to distinguish
    return {"build": build, "write": max(0.0, total - build), "megabytes": facts["bytes"] / 1e6,
            "faces": facts["faces"], "solids": facts["solids"], "memory": _peak()}  # fmt: skip


def by_booleans(n: int) -> dict[str, float]:
    """The obvious route: intersect a prism with two ellipsoids, tilted, for every cell, fuse the cells, export."""
    import build123d as b

    pitch, thickness = 0.5, 0.2
    start = time.process_time()
    ball = b.scale(b.Sphere(1.0), by=(1.0, 0.8, 1.0))
    ball = b.Rot(2.0, 0.0, 0.0) * ball
    lens = b.Pos(0, 0, 1.0 - thickness / 2) * ball & b.Pos(0, 0, thickness / 2 - 1.0) * ball
    lens &= b.Box(pitch, pitch, 1.0)
    cells = [b.Pos(i * pitch, j * pitch, 0) * lens for i in range(n) for j in range(n)]
    sheet = cells[0].fuse(*cells[1:]) if n > 1 else cells[0]
    build = time.process_time() - start
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "sheet.step"
        b.export_step(sheet, str(path))
        size = path.stat().st_size
    return {"build": build, "write": time.process_time() - start - build, "megabytes": size / 1e6,
            "faces": len(sheet.faces()), "solids": len(sheet.solids()), "memory": _peak()}  # fmt: skip


def _peak() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def _apart(*arguments: object, limit: int = 0) -> dict[str, float] | None:
    """Run one row in a process of its own; None if it reached its limit of processor seconds (0: none)."""
    command = [sys.executable, __file__, "--limit", str(limit), "--row", *map(str, arguments)]
    made = subprocess.run(command, check=False, capture_output=True, text=True)
    if limit and made.returncode == -signal.SIGXCPU:
        return None
    made.check_returncode()
    return json.loads(made.stdout)


def rows(designs: list[str], sizes: list[int], booleans: int, limit: int) -> Iterator[str]:
    """Lines of the table, one at a time."""
    for name in designs:
        design = str(ROOT / "designs" / f"{name}.toml")
        for mode, curves, route in (("fused", True, "fused"), ("fused", False, "fused, no parameter curves"),
                                    ("instanced", True, "instanced")):  # fmt: skip
            for n in [n for n in sizes if curves or n <= BARE]:
                yield _line(name, n, route, _apart(mode, n, design, curves))
    for n in (2, 5, 10):
        if n <= booleans:
            row = _apart("boolean", n, limit=limit)
            yield _line("ellipsoids, one body", n, "Booleans of the kernel", row, limit)


def _line(name: str, n: int, route: str, row: dict[str, float] | None, limit: int = 0) -> str:
    if row is None:
        return f"| {name} | {n} | {route} | > {limit}, stopped | | | | | |\n"
    build = f"{row['build']:.2f}" if row["build"] else "–"
    return (f"| {name} | {n} | {route} | {build} | {row['write']:.2f} | {row['megabytes']:.2f} | {row['faces']:.0f} "
            f"| {row['solids']:.0f} | {row['memory']:.0f} |\n")  # fmt: skip


def main() -> None:
    """Print the table, or write it into a file between its marks."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--designs", nargs="*", default=["tilted", "tilted-biconvex", "galilean"])
    parser.add_argument("--sizes", type=int, nargs="+", default=list(SIZES))
    parser.add_argument(
        "--boolean", type=int, default=10, help="largest sheet to build by Booleans (0: none)"
    )
    parser.add_argument(
        "--boolean-limit",
        type=int,
        default=BOOLEAN_SECONDS,
        help="processor seconds a sheet by Booleans may take",
    )
    parser.add_argument("--into", type=Path, help="Markdown file whose rows are replaced")
    parser.add_argument("--limit", type=int, default=0, help=argparse.SUPPRESS)
    parser.add_argument("--row", nargs="+", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.row:
        kind, n, *rest = options.row
        if options.limit:
            resource.setrlimit(resource.RLIMIT_CPU, (options.limit, resource.RLIM_INFINITY))
        result = (
            by_booleans(int(n)) if kind == "boolean" else written(rest[0], int(n), kind, rest[1] == "True")
        )
        sys.stdout.write(json.dumps(result))
        return
    sys.stdout.write(HEAD)
    for line in rows(options.designs, options.sizes, options.boolean, options.boolean_limit):
        sys.stdout.write(line)
        sys.stdout.flush()
        if options.into:
            _put(options.into, line)


def _put(path: Path, line: str) -> None:
    """Put one row into the table of a Markdown file, in the place of the row of the same design, size and route."""
    old = path.read_text(encoding="utf-8")
    table = old[old.index(MARKS[0]) : old.index(MARKS[1])]
    kept = {_key(row): row for row in table.splitlines(keepends=True) if row.startswith("| ")}
    kept.pop(_key(HEAD), None)
    kept[_key(line)] = line
    replace_between(path, MARKS, f"{HEAD}{''.join(kept.values())}\n{os.cpu_count()} processor cores.\n")


def _key(row: str) -> tuple[str, ...]:
    return tuple(cell.strip() for cell in row.split("|")[1:4])


def replace_between(path: Path, marks: tuple[str, str], text: str) -> None:
    """Put a text between two marks of a Markdown file."""
    old = path.read_text(encoding="utf-8")
    start, end = old.index(marks[0]) + len(marks[0]), old.index(marks[1])
    path.write_text(f"{old[:start]}\n\n{text}\n{old[end:]}", encoding="utf-8")


if __name__ == "__main__":
    main()
