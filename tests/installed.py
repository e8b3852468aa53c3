"""The wheel, installed where nothing of the repository is, and run: on several Pythons, and with the least versions it allows.

Use: python tests/installed.py 3.11 3.12 3.13, or python tests/installed.py --lowest. No pytest: packages are fetched.
Ends with "N passed, N failed, N skipped" alone on a line.
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Callable
from pathlib import Path

from lowest_versions import lowest

ROOT = Path(__file__).parents[1]


class Failed(Exception):
    """What was not as it should be."""


def interpreter(version: str) -> str | None:
    """A Python of this version that starts: on the path, or among those that pyenv keeps."""
    kept = Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv")) / "versions"
    places = [shutil.which(f"python{version}"), *map(str, sorted(kept.glob(f"{version}.*/bin/python3")))]
    for place in filter(None, places):
        code = "import sys, venv; print(*sys.version_info[:2], sep='.')"
        told = subprocess.run([place, "-c", code], capture_output=True, text=True, check=False)
        if (told.returncode, told.stdout.strip()) == (0, version):
            return place
    return None


def run(*command: object, status: int = 0, cwd: Path | None = None) -> str:
    """Run a command; what it printed. Another exit status is a failure."""
    done = subprocess.run([*map(str, command)], capture_output=True, text=True, cwd=cwd, check=False)
    if done.returncode != status:
        raise Failed(f"{' '.join(map(str, command))}\n{done.stdout[-2000:]}{done.stderr[-2000:]}")
    return done.stdout


def main_job() -> str:
    """The commands of README.md that make and prove the paper's sheet, without the installation."""
    block = re.search(r"<!-- main -->\n```bash\n(.*?)```", (ROOT / "README.md").read_text(), re.DOTALL)
    assert block is not None
    return block[1].split("\n", 1)[1]


def holds_the_designs(wheel: Path) -> None:
    """The wheel's designs and scenes are the repository's, byte for byte; nothing else is installed next to the package."""
    home, name = ROOT / "designs", "clacad/designs/"
    files = (path for path in home.rglob("*") if path.is_file() and path.suffix not in (".py", ".pyc"))
    ours = {name + path.relative_to(home).as_posix(): path.read_bytes() for path in files}
    with zipfile.ZipFile(wheel) as archive:
        held = {one: archive.read(one) for one in archive.namelist() if one.startswith(name)}
        tops = {one.partition("/")[0] for one in archive.namelist()}
    if held != ours or len(tops) != 2:
        raise Failed(
            f"the wheel holds {sorted(tops)}, and {sorted(held.keys() ^ ours.keys())} differ from designs/"
        )


def works_anywhere(clacad: Path, place: Path) -> None:
    """Designs, files, the atlas and a verdict in a folder that holds nothing else."""
    if "Usage" not in run(clacad, "export", "--help", cwd=place):
        raise Failed("export --help shows no usage")
    run(clacad, "new", "sheet", cwd=place)
    run(clacad, "new", "figure", "--template", "fig3", cwd=place)
    if (place / "figure.toml").read_text() != (ROOT / "designs" / "fig3.toml").read_text().replace(
        "fig3", "figure", 1
    ):
        raise Failed("the template fig3 is not the design fig3")
    run(clacad, "check", "figure.toml", status=1, cwd=place)  # as the paper states it, lens 2 leaves gaps
    small = ("--set", "lattice.count=[3,3]", "-q")
    formats = ("--format", "step,3mf,stl", "--quads", "4", "--role", "preview")
    run(clacad, "export", "sheet.toml", "-o", "out", *formats, *small, cwd=place)
    run(clacad, "atlas", "-o", "atlas", "--rows", "F4", "--size", "32", "--samples", "1", "--no-movies", "--no-measure",
        "-q", cwd=place)  # fmt: skip
    run(clacad, "verify", "sheet.toml", "--files", "out", "-o", "report", "--rays", "4096", *small, cwd=place)
    for made in ("atlas/index.html", "atlas/fig4-delta-0-0.01.png", "report/report.html"):
        if not (place / made).stat().st_size:
            raise Failed(f"{made} is empty")


def does_the_main_job(clacad: Path, place: Path) -> None:
    """What README.md promises first, in a folder that holds the designs alone."""
    if "Usage" not in run(clacad, "export", "--help", cwd=place):
        raise Failed("export --help shows no usage")
    shutil.copytree(ROOT / "designs", place / "designs")
    run("bash", "-euc", main_job().replace(".venv/bin/clacad", str(clacad)), cwd=place)


def tried(what: str, python: str, wheel: Path, constraints: str, work: Callable[[Path, Path], None]) -> bool:
    """Install the wheel in an environment of its own, do the work, print the outcome; everything is gone afterwards."""
    with tempfile.TemporaryDirectory() as folder:
        away = Path(folder)
        (away / "place").mkdir()
        (away / "constraints.txt").write_text(constraints)
        try:
            run(python, "-m", "venv", away / "venv")
            run(away / "venv/bin/python", "-m", "pip", "install", "-q", "-c", away / "constraints.txt", wheel)
            work(away / "venv/bin/clacad", away / "place")
        except Failed as error:
            sys.stdout.write(f"{what}: FAILED\n{error}\n")
            return False
    sys.stdout.write(f"{what}: passed\n")
    return True


def main() -> int:
    """Try what was requested; 1 when anything failed."""
    parser = argparse.ArgumentParser(description="Install the wheel away from the repository, and run it.")
    parser.add_argument("versions", nargs="*", help="of Python, such as 3.12")
    parser.add_argument(
        "--lowest", action="store_true", help="the main job with the least versions that are allowed"
    )
    asked = parser.parse_args()
    for name in [name for name in os.environ if name.startswith(("PYTHON", "CLACAD_", "NUMBA_"))]:
        del os.environ[name]
    ended: list[bool] = []
    skipped = 0
    with tempfile.TemporaryDirectory() as folder:
        run(sys.executable, "-m", "pip", "wheel", "-q", "--no-deps", "-w", folder, ROOT)
        [wheel] = Path(folder).glob("clacad-*.whl")
        holds_the_designs(wheel)
        if asked.lowest:
            told = "".join(f"{line}\n" for line in lowest())
            ended.append(tried("least versions, main job", sys.executable, wheel, told, does_the_main_job))
        for version in asked.versions:
            python = interpreter(version)
            if python is None:
                sys.stdout.write(f"Python {version}: skipped, there is none here\n")
                skipped += 1
            else:
                ended.append(tried(f"Python {version}", python, wheel, "", works_anywhere))
    sys.stdout.write(f"{sum(ended)} passed, {len(ended) - sum(ended)} failed, {skipped} skipped\n")
    return int(not all(ended))


if __name__ == "__main__":
    sys.exit(main())
