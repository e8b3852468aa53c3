"""Seconds forecast against seconds taken: writes forecast.md.

    python tests/benchmarks/forecast.py

Every command runs in a process of its own, against a cache of rates that starts empty: once or twice at another
size to learn, then at the size that is judged. Seconds are processor seconds of the whole work as the
command counts them.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from clacad.rates import Rates

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
DESIGNS = ROOT / "designs"
Command = Sequence[str]


def commands(out: Path) -> list[tuple[str, str, list[Command], Command]]:
    """Name, task, runs to learn from, the run that is judged."""
    design = str(DESIGNS / "paper-a-covered.toml")

    def export(format: str, cells: str, quads: str, *more: str) -> Command:
        return (
            "export",
            design,
            "-o",
            str(out / "x"),
            "--format",
            format,
            "--cells",
            cells,
            "--quads",
            quads,
            "-q",
            *more,
        )

    def verify(rays: int, *files: str) -> Command:
        return ("verify", design, "-q", "--rays", str(rays), *files)

    def accuracy(rays: int) -> Command:
        return ("accuracy", str(DESIGNS / "plano.toml"), "-q", "--rays", str(rays))

    def render(pixels: int) -> Command:
        scene = str(DESIGNS / "scenes" / "fig1b.toml")
        return ("render", scene, "-o", str(out / "p.png"), "--overwrite", "-q", "--pixels", str(pixels))

    files = ("--files", str(out / "x"))
    return [
        ("export stl", "export stl", [export("stl", "10x10", "8"), export("stl", "20x20", "8")], export("stl", "30x30", "8")),
        ("export ply", "export ply", [export("ply", "10x10", "8")], export("ply", "20x20", "16")),
        ("export step", "export step", [export("step", "5x5", "4"), export("step", "10x10", "4")], export("step", "16x16", "4")),
        ("export png", "export png", [export("png", "10x10", "4")], export("png", "25x25", "4")),
        ("verify, no files", "verify", [verify(4096)], verify(131072)),
        ("verify, files", "verify mesh", [export("stl", "5x5", "8"), verify(65536, *files), export("stl", "15x15", "8")],
         verify(65536, *files)),
        ("accuracy", "accuracy", [accuracy(5000)], accuracy(20000)),
        ("render", "render auto auto numpy", [render(60), render(120)], render(200)),
    ]  # fmt: skip


def run(command: Command, cache: Path) -> None:
    """Run one command against a cache."""
    environment = os.environ | {"CLACAD_CACHE_DIR": str(cache), "PYTHONPATH": str(ROOT)}
    subprocess.run([sys.executable, "-m", "clacad", *command], env=environment, check=False, cwd=ROOT,
                   stdout=subprocess.DEVNULL)  # fmt: skip


def judged(name: str, task: str, learn: Sequence[Command], last: Command, folder: Path) -> str:
    """One line of the table."""
    cache = folder / "cache"
    os.environ["CLACAD_CACHE_DIR"] = str(cache)
    for command in learn:
        run(command, cache)
    before = Rates.here()
    run(last, cache)
    noted = Rates.here().tasks.get(task, ())
    if len(noted) <= len(before.tasks.get(task, ())):
        return f"| {name} | {len(noted)} | – | – | – | not noted |"
    modelled, took = noted[-1]
    span = before.span(task, modelled)
    off = span.middle / took - 1.0
    inside = "yes" if span.low <= took <= span.high else "no"
    return f"| {name} | {span.seen} | {span} | {took:.2f} | {off:+.0%} | {inside} |"


def main() -> None:
    """Run everything and write the table."""
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        rows = []
        for one in commands(folder):
            rows.append(judged(*one, folder))
            print(rows[-1], flush=True)
        machine = json.loads(next((folder / "cache").glob("rates-*.json")).read_text())["machine"]
    head = [
        "# Seconds forecast and seconds taken", "",
        f"Made by `python tests/benchmarks/forecast.py` on {machine['cores']} x86-64 cores shared with other work. The cache of rates starts",
        "empty and has seen each task at smaller sizes only; *forecast* is what is said before the run, *off* its middle "
        "against the run.", "",
        "| task | runs seen | forecast | taken, s | off | in the range |", "|---|---|---|---|---|---|",
    ]  # fmt: skip
    (HERE / "forecast.md").write_text("\n".join([*head, *rows, ""]), encoding="utf-8")


if __name__ == "__main__":
    main()
