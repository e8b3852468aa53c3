"""Processor seconds and wall clock of what people call, each row in a process of its own.

    python tests/benchmarks/calls.py [ROW ...] [--against OTHER_TREE]
    python tests/benchmarks/calls.py --python [WORD ...] [--against OTHER_TREE]

Without rows all of them run; `--list` names them. A row runs with PYTHONPATH set to the tree, after the kernels of that tree
were compiled, and counts its whole process: starting Python, loading modules, and every process it starts itself. Of rows
that take less than ten seconds the best of three is reported. With `--against` each row runs once in this tree and once in the
other, in turns, so that both meet the same neighbours on a shared machine.

With `--python` the rows are those calls of the library, and of its peers, whose names hold a word: `call_rates.py`.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[2]
SHORT, TIMES = 10.0, 3
"""Seconds below which a row is measured several times."""

ENDED = (0, 1)
"""Exit statuses of a run that did its work; 1: a check failed."""


@dataclass(frozen=True)
class Row:
    """One call and what must be there before it.

    command : tuple of str
        Arguments of `clacad`, or a file to run with Python; {tree}, {out} and {given} are filled in.
    given : str
        Row whose output it reads; "" for none.
    fresh : bool
        Without compiled kernels, as on a fresh machine; run once.
    """

    command: tuple[str, ...]
    given: str = ""
    fresh: bool = False


@dataclass(frozen=True)
class Seconds:
    """What a run took: processor seconds with those of its children, wall clock, peak memory (bytes), bytes written."""

    processor: float
    wall: float
    memory: int
    written: int


def _export(design: str, *options: str) -> Row:
    return Row(("export", f"designs/{design}.toml", "-o", "{out}", "-q", *options))


def _verify(design: str, given: str, *options: str) -> Row:
    return Row(("verify", f"designs/{design}.toml", "--files", "{given}", "-q", *options), given)


def _check(design: str) -> Row:
    return Row(("check", f"designs/{design}.toml", "-q"))


def _picture(scene: str, fresh: bool = False) -> Row:
    return Row(
        ("render", f"designs/scenes/{scene}.toml", "-o", "{out}.png", "--overwrite", "-q"), fresh=fresh
    )


def _step(cells: int) -> Row:
    return _export(
        "paper-base", "--cells", f"{cells}x{cells}", "--format", "step", "--step", "instanced", "--force"
    )


ROWS: Mapping[str, Row] = {
    "check": _check("baffled"),
    "check-window": _check("window-100mm"),
    "check-covered": _check("paper-a-covered"),
    "export-step-10": _step(10),
    "export-step-100": _step(100),
    "export-step-200": _step(200),
    "export-step-1000": _step(1000),
    "verify-step-10": _verify("paper-base", "export-step-10", "--cells", "10x10"),
    "verify-step-100": _verify("paper-base", "export-step-100", "--cells", "100x100"),
    "verify-step-200": _verify("paper-base", "export-step-200", "--cells", "200x200"),
    "verify-step-1000": _verify("paper-base", "export-step-1000", "--cells", "1000x1000"),
    "export-3mf-200": _export("paper-base", "--format", "3mf", "--quads", "16"),
    "verify-3mf-200": _verify("paper-base", "export-3mf-200"),
    "export-3mf-1000": _export("paper-base", "--cells", "1000x1000", "--format", "3mf", "--quads", "16", "--force"),
    "verify-3mf-1000": _verify("paper-base", "export-3mf-1000", "--cells", "1000x1000"),
    "export-3mf-200-64": _export("paper-base", "--format", "3mf", "--quads", "64"),
    "verify-3mf-200-64": _verify("paper-base", "export-3mf-200-64"),
    "export-stl-200": _export("paper-base", "--format", "stl", "--quads", "8"),
    "verify-stl-200": _verify("paper-base", "export-stl-200"),
    "export-main": _export("paper-a-covered", "--format", "step,3mf,stl", "--quads", "3mf=auto,stl=4", "--role", "stl=preview"),
    "verify-main": _verify("paper-a-covered", "export-main", "-o", "{out}"),
    "verify-main-fresh": replace(_verify("paper-a-covered", "export-main", "-o", "{out}"), fresh=True),
    "picture": _picture("fig3-z-8"),
    "picture-fresh": _picture("fig3-z-8", fresh=True),
}  # fmt: skip
"""Name → what is run. Rows of a few seconds to minutes; one whose name another row gives runs first."""


def _filled(word: str, paths: Mapping[str, Path]) -> str:
    """Word with {name} replaced by a path; other braces are left, those of TOML."""
    for name, path in paths.items():
        word = word.replace(f"{{{name}}}", str(path))
    return word


def run(row: Row, tree: Path, out: Path, given: Path) -> Seconds:
    """Run a row once in a process of its own.

    Raises
    ------
    SystemExit
        It ended with a status which shows that it did not do its work.
    """
    words = [_filled(word, {"tree": tree, "out": out, "given": given}) for word in row.command]
    program = (
        [sys.executable, *words] if words[0].endswith(".py") else [sys.executable, "-m", "clacad", *words]
    )
    shutil.rmtree(out, ignore_errors=True)
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"} | {
        "PYTHONPATH": str(tree)
    }
    if row.fresh:
        environment["NUMBA_CACHE_DIR"] = tempfile.mkdtemp(dir=out.parent)
    began = time.monotonic()
    running = subprocess.Popen(
        program, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, cwd=tree, env=environment
    )
    assert running.stderr is not None
    words_said = running.stderr.read()
    _, status, used = os.wait4(running.pid, 0)
    running.returncode = os.waitstatus_to_exitcode(status)
    if running.returncode not in (ENDED if program[2] == "clacad" else (0,)):
        raise SystemExit(f"{' '.join(words)} ended with {running.returncode}: {words_said.decode()[-500:]}")
    written = sum(path.stat().st_size for path in out.glob("*")) if out.is_dir() else 0
    # the peak is that of the largest process: a child of this one, or one that it started
    return Seconds(used.ru_utime + used.ru_stime, time.monotonic() - began, used.ru_maxrss * 1024, written)


def best(rows: Mapping[str, Row], name: str, tree: Path, folder: Path) -> Seconds:
    """The least of several runs of a short row, the one run of a long one; what it reads is made first, once a tree."""
    row = rows[name]
    given = folder / row.given
    if row.given and not given.is_dir():
        run(rows[row.given], tree, given, folder)
    found = [run(row, tree, folder / name, given)]
    while len(found) < TIMES and found[0].processor < SHORT and not row.fresh:
        found.append(run(row, tree, folder / name, given))
    return min(found, key=lambda one: one.processor)


def line(name: str, found: Seconds, other: Seconds | None) -> str:
    """One row of the table."""
    words = f"| {name} | {found.processor:.2f} | {found.wall:.2f} | {found.memory / 1e6:.0f} | {found.written / 1e6:.2f} |"
    if other is not None:
        words += f" {other.processor:.2f} | {other.wall:.2f} | {other.memory / 1e6:.0f} | {other.processor / found.processor:.1f} |"
    return words


PYTHON_HEAD = (
    "| call (one core) | first: processor s | wall s | again: processor s | wall s | ns a ray | by |"
    "\n|---|---|---|---|---|---|---|"
)


THREADS = ("CLACAD_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS")
"""Environment variables that set the number of cores of this program and its peers."""


def called(name: str, tree: Path) -> dict[str, Any]:
    """What `call_rates.py` of this tree finds for a row, the program imported from another or this one."""
    script = Path(__file__).with_name("call_rates.py")
    environment = os.environ | dict.fromkeys(THREADS, "1") | {"PYTHONPATH": str(tree)}
    told = subprocess.run(
        [sys.executable, str(script), name], env=environment, cwd=tree, check=True, stdout=subprocess.PIPE, text=True
    )  # fmt: skip
    found: dict[str, Any] = json.loads(told.stdout.splitlines()[-1])
    return found


def python_line(found: Mapping[str, Any], by: str) -> str:
    """One row of the table of calls of the library."""
    if "left_out" in found:
        return f"| {found['row']} | left out: {found['left_out']} | | | | | |"
    again = min(found["best"], found["second"])
    seconds = [*found["first"], *again]
    cells = " | ".join(f"{one:.4f}" if one < 0.1 else f"{one:.2f}" for one in seconds)
    return f"| {found['row']} | {cells} | {1e9 * again[0] / found['rays']:.0f} | {found['peer'] or by} |"


def python_rows(words: Sequence[str], trees: Sequence[Path]) -> None:
    """Print the table of calls of the library: every row in this tree and, of its own calls, in the other."""
    from call_rates import ROWS as calls

    print(PYTHON_HEAD, flush=True)
    for name, (_, _, package) in calls.items():
        if words and not any(word in name for word in words):
            continue
        for tree, by in zip(trees, ("this tree", "before"), strict=False):
            if by == "this tree" or not (package or "sums, " in name):
                print(python_line(called(name, tree), by), flush=True)


def main(rows: Mapping[str, Row] = ROWS) -> None:
    """Run rows and print a table."""
    parser = argparse.ArgumentParser(description="Processor seconds and wall clock of what people call.")
    parser.add_argument("rows", nargs="*", metavar="ROW", help="default: all")
    parser.add_argument(
        "--against", type=Path, help="another tree of this program, measured in turns with this one"
    )
    parser.add_argument(
        "--python", action="store_true", help="calls of the library; ROW: words of their names"
    )
    parser.add_argument("--list", action="store_true", help="name the rows")
    asked = parser.parse_args()
    if asked.list:
        print("\n".join(rows))
        return
    trees = [ROOT] if asked.against is None else [ROOT, asked.against.resolve()]
    if asked.python:
        python_rows(asked.rows, trees)
        return
    head = "| row | processor s | wall s | peak MB | MB written |"
    head += " before: processor s | wall s | peak MB | ratio |" if len(trees) > 1 else ""
    print(f"{head}\n|{'---|' * (head.count('|') - 1)}", flush=True)
    with tempfile.TemporaryDirectory() as scratch:
        for name in asked.rows or rows:
            found = [
                best(rows, name, tree, _folder(Path(scratch), number)) for number, tree in enumerate(trees)
            ]
            print(line(name, found[0], found[1] if len(found) > 1 else None), flush=True)


def _folder(scratch: Path, number: int) -> Path:
    folder = scratch / str(number)
    folder.mkdir(exist_ok=True)
    return folder


if __name__ == "__main__":
    main()
