"""Camera rays a second of the renderer and of POV-Ray on the same scene, one thread, in one run.

    python tests/benchmarks/render_rates.py

Both are given by the CPU time that a larger picture takes beyond a smaller one, so that reading, planning,
parsing and loading count for neither.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent))

from viewscenes import view_scene

from clacad.render import view_through

SIZES = (330, 1650)


def plain(pixels: int, rung: str):
    scene = view_scene("base", pixels, rung)
    return scene.replace({"effects.mode": "none", "effects.list": []}) if rung == "law" else scene


def mine(rung: str) -> float:
    """Rays a second."""
    view_through(plain(64, rung), threads=1, compiled=True)
    spent = []
    for pixels in SIZES:
        scene = plain(pixels, rung)
        best = 1e9
        for _ in range(3):
            start = time.process_time()
            view_through(scene, threads=1, compiled=True)
            best = min(best, time.process_time() - start)
        spent.append(best)
    return (SIZES[1] ** 2 - SIZES[0] ** 2) / (spent[1] - spent[0])


def povray() -> float:
    """Rays a second, user time of the process."""
    import os

    from clacad.export.pov import write_pov
    from clacad.prescription import prescribe

    spent = []
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "s.pov"
        scene = view_scene("base", SIZES[1])
        write_pov(prescribe(scene.design()), path, scene)
        for pixels in SIZES:
            before = os.times().children_user
            subprocess.run(
                ["povray", f"+I{path}", "+Os.ppm", f"+W{pixels}", f"+H{pixels}", "-A", "+FP16", "-D", "+WT1", "-GA"],
                check=True, capture_output=True, cwd=folder,
            )  # fmt: skip
            spent.append(os.times().children_user - before)
    return (SIZES[1] ** 2 - SIZES[0] ** 2) / (spent[1] - spent[0])


def main() -> None:
    """Print the table."""
    rates = {"surfaces, ghosts": mine("surfaces"), "law": mine("law")}
    peer = povray() if shutil.which("povray") else float("nan")
    print(f"{'POV-Ray 3.7':18} {peer / 1e6:7.2f} M rays/s")
    for name, rate in rates.items():
        print(f"{name:18} {rate / 1e6:7.2f} M rays/s   {rate / peer:6.1f} x")


if __name__ == "__main__":
    main()
