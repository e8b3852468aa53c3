"""Commands with hostile input: run in forks, judged by their status, streams, files and seconds.

python tests/trust/attacks/judge_commands.py FIRST COUNT [STEP [KEPT [LEFT_OUT]]]
    prints counts, the slowest, and what went wrong; KEPT: a folder where good files are kept; LEFT_OUT: commands, with commas between
"""

from __future__ import annotations

import os
import re
import shutil
import sys
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

if __name__ == "__main__":
    sys.path[:0] = [str(Path(__file__).parents[2]), str(Path(__file__).parents[3])]

from trust.attacks import hostile_commands as hostile
from trust.attacks.forks import Forks

CPU, WALL = 20, 300
"""Processor seconds that a command may take, and seconds after which it counts as hung on a busy machine."""

SETS = {
    "shape": {"o.toml", "o.cells.csv", "o.png"}, "optimise": {"o.toml"}, "image": {"o.png"}, "explore": {"o.html"}, "wave": {"o.png"},
    "accuracy": {"o.svg"}, "check": {"o.toml"}, "trace": {"o.npz"}, "render": {"o.png", "o-without.png"},
    "sweep": {"o/sweep.csv", "o/sweep.png"}, "tolerance": {"o/tolerances.json", "o/tolerances.csv", "o/tolerances.png"},
}  # fmt: skip
"""What belongs together where a command was done."""

RESUMED = ("o/sweep.checkpoint", "o/tolerances.checkpoint")
"""What a study that was not done goes on from."""

WARNED = re.compile(r"^\S+\.py:\d+: \w*Warning|^Traceback|^  File \"", re.M)


MADE = {
    "good": "export t.toml -o good --format stl,ply,glb,3mf --quads 2",
    "stacked": "stack t.toml t.toml --gap 3 --rays 64 --quads 2 -o stacked",
    "swept": "sweep t.toml --vary lattice.pitch=0.4,0.5 --rays 64 --workers 1 -o swept",
    "tolerated": "tolerance t.toml --samples 2 --rays 64 --workers 1 -o tolerated --set tolerances.radius=0.01",
}  # fmt: skip
"""Folder of good files -> the line that writes it."""

WARMED = ("stack", "accuracy", "verify", "render", "atlas", "optimise")
"""Commands that load or compile kernels: each is run once before it is attacked."""


def write_given(given: Path) -> None:
    """Write what every command finds."""
    import numpy as np
    from PIL import Image

    for name, text in hostile.DESIGNS.items():
        (given / f"{name}.toml").write_text(text)
    (given / "scene.toml").write_text(hostile.SCENE)
    (given / "stack-scene.toml").write_text(hostile.STACK_SCENE)
    (given / "p.dxf").write_text(hostile.DXF)
    (given / "cells.csv").write_text(hostile.CELLS)
    (given / "points.csv").write_text(hostile.POINTS)
    np.savez(
        given / "rays.npz",
        position=[[0.1, 0.1, -1.0]] * 3,
        direction=[[0.0, 0.0, 1.0]] * 3,
        wavelength=[5.5e-7] * 3,
    )
    Image.fromarray(np.arange(48, dtype=np.uint8).reshape(4, 4, 3)).save(given / "photo.png")
    places = ((a / 10, b / 10) for a in range(-5, 6) for b in range(-5, 6))
    (given / "cloud.xyz").write_text("".join(f"{x} {y} 0 0 0 1\n" for x, y in places))


def prepare(given: Path, forks: Forks, numbers: Iterable[int]) -> None:
    """Write what the commands of some inputs are given; run once what needs kernels, so that they are compiled.

    Raises
    ------
    AssertionError
        A line that nothing is wrong with was not done.
    """
    write_given(given)
    points = {hostile.aimed_at(number) for number in numbers}
    sources = {hostile.READERS[where][0].partition("/")[0] for what, where in points if what == "file"}
    commands = {hostile.command_of(number) for number in numbers}
    sources |= {"good"} if "verify" in commands else set()
    lines = [MADE[folder] for folder in MADE if folder in sources]
    lines += [
        f"{hostile.COMMANDS[name][0]} --overwrite".replace("DESIGN", "t.toml")
        for name in WARMED
        if name in commands
    ]
    lines += ["trace t.toml rays.npz --rung mesh --mesh good/tiny.stl -o o.npz --overwrite"] * (
        "good" in sources
    )
    scratch = given.parent / "scratch"
    scratch.mkdir()
    for line in lines:
        answer = forks.run(_request(tuple(line.split()), given, scratch, given.parent / "said", 600))
        if answer["status"] not in (0, 1):
            raise AssertionError(f"{line}: {answer}\n{(given.parent / 'said').read_text()}")
    if "good" in sources:
        (given / "good" / "tiny.obj").write_text(hostile.OBJ)
    for path in given.iterdir():  # what the lines above wrote as examples is no input
        if path.name == "o" or path.name.startswith(("o.", "o-")):
            shutil.rmtree(path) if path.is_dir() else path.unlink()


def _request(words: tuple[str, ...], folder: Path, scratch: Path, said: Path, cpu: int) -> dict[str, Any]:
    return {"words": list(words), "folder": str(folder), "scratch": str(scratch), "said": str(said), "cpu": cpu, "wall": max(WALL, cpu)}  # fmt: skip


@dataclass
class Tally:
    """How commands were answered.

    statuses : counts by command and status
    faults : sentences, each a command and what was wrong with its answer
    slowest : processor seconds and command, the slowest first
    """

    statuses: Counter[tuple[str, int]] = field(default_factory=Counter)
    faults: list[str] = field(default_factory=list)
    slowest: list[tuple[float, str]] = field(default_factory=list)

    def __str__(self) -> str:
        by_status = Counter[int]()
        for (_, status), count in self.statuses.items():
            by_status[status] += count
        seconds = sum(cpu for cpu, _ in self.slowest)
        slow = "\n".join(
            f"  {cpu:.1f} s  {name:.150}" for cpu, name in sorted(self.slowest, reverse=True)[:8]
        )
        return f"{by_status.total()} inputs, {seconds:.0f} processor seconds, statuses {dict(sorted(by_status.items()))}, {len(self.faults)} faults; slowest:\n{slow}"


def files_of(folder: Path) -> dict[str, bytes | str]:
    """What lies in a folder: name -> bytes, of a link where it leads."""
    return {
        path.relative_to(folder).as_posix(): os.readlink(path) if path.is_symlink() else path.read_bytes()
        for path in folder.rglob("*")
        if path.is_symlink() or path.is_file()
    }


def attack(numbers: Iterable[int], given: Path, place: Path, forks: Forks, loud: bool = False) -> Tally:
    """Run the inputs of some numbers, each in a folder of its own."""
    tally = Tally()
    for number in numbers:
        one = hostile.attack(number, given)
        folder, scratch, said = place / "folder", place / "scratch", place / "said"
        for old in (folder, scratch):
            shutil.rmtree(old, ignore_errors=True)
        shutil.copytree(given, folder, ignore=shutil.ignore_patterns("stacked", "swept", "tolerated"))
        scratch.mkdir(parents=True)
        (folder / "here").mkdir()
        for name, data in one.files.items():
            (folder / name).parent.mkdir(exist_ok=True)
            (folder / name).write_bytes(data)
        before = files_of(folder)
        answer = forks.run(_request(one.words, folder, scratch, said, CPU))
        text = said.read_text(errors="replace")
        wrong = [*of_answer(answer, text), *of_files(one.words, answer["status"], before, files_of(folder))]
        wrong += [f"{left.name} left in the temporary folder" for left in scratch.iterdir()]
        what, where = hostile.aimed_at(number)
        name = (
            f"{number} ({what} {where}) {' '.join(w if len(w) < 60 else w[:57] + '...' for w in one.words)!r}"
        )
        tally.statuses[one.words[0], answer["status"]] += 1
        tally.slowest.append((answer["cpu"], name))
        if wrong:
            tally.faults.append(f"{name}: {'; '.join(wrong)}: {text[-300:].strip()}")
            if loud:
                sys.stdout.write(f"{tally.faults[-1]}\n\n")
        if loud and (sum(tally.statuses.values()) % 50 == 0):
            sys.stdout.write(f"after number {number}: {tally}\n\n")
        sys.stdout.flush()
    return tally


def of_answer(answer: dict[str, Any], text: str) -> list[str]:
    """Faults in a status, in the output, and in the seconds."""
    status = answer["status"]
    wrong = [f"status {status} after {answer['cpu']:.0f} s"] if status not in (0, 1, 2, 3, 4) else []
    wrong += [f"says {found[0].strip()!r}" for found in [WARNED.search(text)] if found]
    wrong += ["internal error"] if "internal error" in text else []
    wrong += ["no word"] if status and not text.strip() else []
    wrong += ["an escape"] if "\x1b" in text or "\u202e" in text else []
    errors = [line for line in text.splitlines() if line.startswith("clacad:")]
    wrong += (
        ["a line of a thousand characters"] if status == 2 and max(map(len, errors), default=0) > 1000 else []
    )
    return wrong


def of_files(
    words: tuple[str, ...], status: int, before: dict[str, bytes | str], after: dict[str, bytes | str]
) -> list[str]:
    """What is wrong with the files: halves of a set, private folders, inputs that changed."""
    new = {name for name in after if after[name] != before.get(name)}
    wrong = [f"{name} is gone" for name in before if name not in after and not name.endswith(RESUMED)]
    wrong += [f"{name} was left" for name in new if "/.clacad-" in f"/{name}"]
    new -= set(RESUMED)
    if status >= 2 or status < 0:
        wrong += [f"{name} was written" for name in sorted(new)]
    elif (whole := SETS.get(words[0])) and new & whole and not whole <= set(after):
        wrong.append(f"of {sorted(whole)} only {sorted(new & whole)}")
    return wrong


if __name__ == "__main__":
    import tempfile

    first, count, step = (*map(int, sys.argv[1:4]), *(0, 100, 1)[len(sys.argv) - 1 :])
    left_out = sys.argv[5].split(",") if len(sys.argv) > 5 else []
    numbers = [n for n in range(first, first + count * step, step) if hostile.command_of(n) not in left_out]
    with tempfile.TemporaryDirectory() as name, Forks() as running:
        given = Path(sys.argv[4] if len(sys.argv) > 4 else name, "given")
        if not given.is_dir():
            given.mkdir(parents=True)
            prepare(given, running, numbers)
        found = attack(numbers, given, Path(name, "work"), running, loud=True)
    sys.stdout.write(f"{found}\n")
