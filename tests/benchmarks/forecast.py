"""Seconds forecast against seconds taken: writes forecast.md.

    python tests/benchmarks/forecast.py [word ...]

Every command runs in a process of its own, against a cache of rates that starts empty: once or twice at another
size to learn, then at the size that is judged. Seconds are processor seconds of the whole work as the
command counts them.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from math import inf
from pathlib import Path

import numpy as np

from clacad.base.machine_rates import Rates
from clacad.rendering.picture_cost import task as render_task
from clacad.scene import load_scene
from clacad.tracing.which_path import task as trace_task

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
DESIGNS = ROOT / "designs"
SCENE = DESIGNS / "scenes" / "fig1b.toml"
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

    def accuracy(name: str, rays: int, *changes: str) -> Command:
        keys = [word for change in changes for word in ("--set", change)]
        return ("accuracy", str(DESIGNS / f"{name}.toml"), "-q", "--rays", str(rays), *keys)

    aimed = ("lattice.aperture={point=[0,0,-400]}", "lattice.count=[30,30]", "check.process='none'")
    glens = ("law.varying={f_image=300}", "pair.offset='traced'", "check.process='none'")

    def render(pixels: int) -> Command:
        return ("render", str(SCENE), "-o", str(out / "p.png"), "--overwrite", "-q", "--pixels", str(pixels))

    def trace(rung: str, rays: int) -> Command:
        file = out / f"rays-{rays}.npz"
        if not file.exists():
            rng = np.random.default_rng(rays)
            start = np.column_stack([rng.uniform(-0.004, 0.004, (rays, 2)), np.full(rays, -0.01)])
            np.savez(file, position=start, direction=np.broadcast_to([0.0, 0.0, 1.0], (rays, 3)))
        return ("trace", design, str(file), "-o", str(out / "t.npz"), "--overwrite", "-q", "--rung", rung)

    files = ("--files", str(out / "x"))
    return [
        ("export stl", "export stl", [export("stl", "10x10", "8"), export("stl", "20x20", "8")], export("stl", "30x30", "8")),
        ("export ply", "export ply", [export("ply", "10x10", "8")], export("ply", "20x20", "16")),
        ("export step", "export step", [export("step", "5x5", "4"), export("step", "10x10", "4")], export("step", "16x16", "4")),
        ("export png", "export png", [export("png", "10x10", "4")], export("png", "25x25", "4")),
        ("verify, no files", "verify", [verify(4096)], verify(131072)),
        ("verify, files", "verify mesh", [export("stl", "5x5", "8"), verify(65536, *files), export("stl", "15x15", "8")],
         verify(65536, *files)),
        ("accuracy", "accuracy", [accuracy("plano", 5000)], accuracy("plano", 40000)),
        ("accuracy, another design", "accuracy", [accuracy("plano", 5000)], accuracy("paper-a-covered", 20000)),
        ("accuracy, aimed cells", "accuracy", [accuracy("plano", 5000)], accuracy("window-100mm", 20000, *aimed)),
        ("accuracy, a glens", "accuracy", [accuracy("plano", 5000)], accuracy("window-100mm", 20000, *glens)),
        ("render, small", drawn(120), [render(60), render(120)], render(200)),
        ("render, large", drawn(360), [render(360)], render(440)),
        ("trace, exact surfaces", traced("surfaces", 1_000_000), [trace("surfaces", 1_000_000)], trace("surfaces", 4_000_000)),
        ("trace, few rays", traced("surfaces", 50_000), [trace("surfaces", 50_000)], trace("surfaces", 300_000)),
        ("trace, facets", traced("mesh", 2_000_000), [trace("mesh", 1_000_000)], trace("mesh", 2_000_000)),
        ("trace, facets, few rays", traced("mesh", 50_000), [trace("mesh", 50_000)], trace("mesh", 300_000)),
    ]  # fmt: skip


def drawn(pixels: int) -> str:
    """Name under which the scene of a given width in pixels is recorded."""
    scene = load_scene(SCENE)
    return render_task(scene.replace({"camera.pixels": [pixels, pixels]}))


def traced(rung: str, rays: int) -> str:
    """Name under which a trace is noted."""
    return trace_task(rung, (), rays)


def run(command: Command) -> None:
    """Run one command in a process of its own."""
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    subprocess.run([sys.executable, "-m", "clacad", *command], env=environment, check=False, cwd=ROOT,
                   stdout=subprocess.DEVNULL)  # fmt: skip


def judged(name: str, task: str, learn: Sequence[Command], last: Command) -> tuple[str, float]:
    """One line of the table, and how far the middle of the forecast was off, as a share of what it took."""
    for command in learn:
        run(command)
    if not Rates.here().tasks.get(task):
        run(learn[-1])  # what compiles a kernel is not noted
    before = Rates.here()
    run(last)
    noted = Rates.here().tasks.get(task, ())
    if not noted or noted == before.tasks.get(task, ()):
        return f"| {name} | {len(noted)} | – | – | – | not noted |", inf
    modelled, took = noted[-1]
    span = before.span(task, modelled)
    off = span.middle / took - 1.0
    inside = "yes" if span.low <= took <= span.high else "no"
    return f"| {name} | {span.seen} | {span} | {took:.2f} | {off:+.0%} | {inside} |", abs(off)


HEAD = """# Seconds forecast and seconds taken

Made by `python tests/benchmarks/forecast.py` on {cores} x86-64 cores shared with other work (load {load:.0f}). The cache of rates
starts empty and has seen each task at smaller sizes only; *forecast* is what is said before the run, *off* its
middle against the run. "accuracy, another design" and those below it have seen the rows before them, of equal cells and two bodies. Off by more than 30 %: {far}.

| task | runs seen | forecast | taken, s | off | in the range |
|---|---|---|---|---|---|
"""


def kept_rows() -> dict[str, str]:
    """Rows of the existing table, by name."""
    file = HERE / "forecast.md"
    lines = file.read_text(encoding="utf-8").splitlines() if file.exists() else []
    rows = [line for line in lines if line.startswith("| ")][1:]
    return {line.split("|")[1].strip(): line for line in rows}


def write(rows: dict[str, str], names: Sequence[str]) -> None:
    """Write the table with the rows there are."""
    known = {name: rows[name] for name in names if name in rows}
    offs = [row.split("|")[5].strip().rstrip("%") for row in known.values()]
    far = sum(off == "–" or abs(int(off)) > 30 for off in offs)
    missing = [name for name in names if name not in rows]
    told = f"{far} of {len(known)}" + (f"; not measured: {', '.join(missing)}" if missing else "")
    head = HEAD.format(cores=os.cpu_count(), load=os.getloadavg()[1], far=told)
    (HERE / "forecast.md").write_text(head + "\n".join([*known.values(), ""]), encoding="utf-8")


def main() -> int:
    """Run everything and write the table, row by row; with words, measure again only the rows whose names contain one."""
    wanted, worst = sys.argv[1:], 0.0
    rows = kept_rows() if wanted else {}
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        os.environ["CLACAD_CACHE_DIR"] = str(folder / "cache")
        every = commands(folder)
        for one in every:
            if wanted and not any(word in one[0] for word in wanted):
                continue
            rows[one[0]], off = judged(*one)
            print(rows[one[0]], flush=True)
            write(rows, [other[0] for other in every])
            worst = max(worst, off)
    return int(worst > 0.3)


if __name__ == "__main__":
    sys.exit(main())
