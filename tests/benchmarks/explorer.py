"""What a frame of the explorer costs where there is no graphics card: writes explorer.md.

    python tests/benchmarks/explorer.py --into tests/benchmarks/explorer.md

Each row is the page of a design in headless Chromium that draws by software (SwiftShader through ANGLE): one ray a pixel, as
while a slider moves, at 512 x 512 pixels. 20 frames after 5 that are not counted, each waited for.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
from pathlib import Path
from statistics import median

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
DESIGNS = ("window-100mm", "paper-a-covered", "hexagonal", "tilted", "baffled")
SIDE, BEFORE, FRAMES = 512, 5, 20
AIM = 50.0

HEAD = """# What a frame of the explorer costs

    python tests/benchmarks/explorer.py --into tests/benchmarks/explorer.md

{side} × {side} pixels drawn without a graphics card (SwiftShader through ANGLE in headless Chromium), one ray a pixel as while a slider
moves; median of {frames} frames after {before}. Processor milliseconds are those of the process that draws, on all its threads;
the wall clock beside them is that of this machine: {cores} cores, others at work on it (load {load:.0f}). On {cores} cores of one's own
a frame takes between 1/{cores} of its processor time and all of it; the aim is {aim:.0f} ms.

| design | lattice | wall ms | processor ms | processor ms / {cores} | page, bytes |
|---|---|---:|---:|---:|---:|
"""


def seconds_of_drawing(root: int) -> float:
    """Processor seconds so far of the process, of all that a browser started, that draws."""
    parents, spent = {}, {}
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                fields = (entry / "stat").read_text().rpartition(")")[2].split()
                parents[int(entry.name)] = int(fields[1])
                if "--type=gpu-process" in (entry / "cmdline").read_text():
                    spent[int(entry.name)] = (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
            except OSError:  # it ended
                continue

    def ours(process: int) -> bool:
        return process == root or (process in parents and ours(parents[process]))

    return sum(seconds for process, seconds in spent.items() if ours(process))


def main() -> None:
    """Measure, print, and write if requested."""
    sys.path[:0] = [str(HERE.parent), str(ROOT)]
    import browser
    from explorerpage import Page

    import clacad

    parser = argparse.ArgumentParser(description="Milliseconds of the explorer's frames.")
    parser.add_argument("--into", type=Path, help="write the page here")
    into, cores, lines = parser.parse_args().into, os.cpu_count() or 1, []
    opened = browser.Browser()
    try:
        for name in DESIGNS:
            page = Page(opened, Path(tempfile.mkdtemp()), clacad.load(ROOT / f"designs/{name}.toml"))
            opened.wait("document.getElementById('explorer').dataset.state === 'fine'")
            opened.run(f"explorer.times({SIDE}, {BEFORE})")
            began = seconds_of_drawing(opened.process.pid)
            wall = median(opened.run(f"explorer.times({SIDE}, {FRAMES})"))
            spent = 1e3 * (seconds_of_drawing(opened.process.pid) - began) / FRAMES
            kind = opened.run("JSON.parse(document.getElementById('explorer').dataset.facts).kind")
            lines.append(
                f"| {name} | {kind} | {wall:.0f} | {spent:.0f} | {spent / cores:.0f} | {page.file.stat().st_size:,} |\n"
            )
            print(lines[-1], end="", flush=True)
    finally:
        opened.close()
    text = HEAD.format(
        side=SIDE, frames=FRAMES, before=BEFORE, cores=cores, load=os.getloadavg()[0], aim=AIM
    ) + "".join(lines)
    if into:
        into.write_text(text)


if __name__ == "__main__":
    main()
