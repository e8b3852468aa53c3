"""Hashes of small exports under one set of versions: what "same bytes" means from one day to the next.

    python tests/trust/golden.py            compare with tests/trust/golden.json
    python tests/trust/golden.py --renew    write it again: after a change that is meant to change bytes

The record is a lock: it holds for the versions it names and for no others. `clacad`'s own version is among them
only as a remark: while it stays the same, so must the bytes. The library behind numpy's products of matrices takes
another kernel on another make of processor, which changes last bits of float64 formats; so the files are made by a
process in which that choice is fixed.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import subprocess
import sys
import tempfile
import tomllib
import zlib
from hashlib import sha256
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

RECORD = Path(__file__).with_name("golden.json")
FORMATS = (
    "stl",
    "stl-parts",
    "3mf",
    "ply",
    "glb",
    "sag",
    "tiff",
    "png",
    "xyz",
    "table",
    "mask",
    "step",
    "zmx",
)
SLAB = {
    "format": 1, "name": "slab", "unit": "mm", "law": {"eta": [-0.5, -1.0], "delta": [0.01, -0.02], "euler": [30.0, 0.5, 20.0]},
    "pair": {"form": "slab", "separation": 10.0, "index": 1.5}, "lattice": {"pitch": 0.5, "count": [2, 2]},
}  # fmt: skip
PAIR = {
    "format": 1, "name": "pair", "unit": "mm", "law": {"eta": [-0.5, -0.5]},
    "pair": {"form": "biconvex", "separation": 10.0, "index": 1.5}, "lattice": {"pitch": 0.5, "count": [3, 2], "seam": 0.04},
}  # fmt: skip
HEXAGONS = {
    "format": 1, "name": "hexagons", "unit": "um", "law": {"eta": [-1.0, -1.0]},
    "pair": {"form": "plano", "separation": 2000.0, "index": 1.5},
    "lattice": {"kind": "hexagonal", "pitch": 100.0, "count": [2, 2]},
}  # fmt: skip


def versions() -> dict[str, str]:
    """What bytes may depend on: the packages that compute, the compressor, the processor's widest arithmetic."""
    from numpy._core._multiarray_umath import __cpu_features__ as features

    widest = next((name for name in ("AVX512_SKX", "AVX512F", "AVX2", "NEON") if features.get(name)), "plain")
    named = {"machine": f"{platform.machine()} {widest}", "zlib": zlib.ZLIB_RUNTIME_VERSION}
    for package in ("numpy", "build123d", "cadquery-ocp", "cadquery-ocp-novtk", "manifold3d"):
        try:
            named[package] = version(package)
        except PackageNotFoundError:
            named[package] = "none"
    return named | {"python": ".".join(platform.python_version_tuple()[:2])}


KERNELS = {"AVX512_SKX": "SkylakeX", "AVX512F": "SkylakeX", "AVX2": "Haswell"}
"""Widest arithmetic of the processor → name of the kernels for products of matrices."""


def hashes() -> dict[str, str]:
    """SHA-256 of every file of the small designs, manifests included, made in a process of its own."""
    widest = versions()["machine"].split()[-1]
    fixed = {"OPENBLAS_CORETYPE": KERNELS[widest]} if widest in KERNELS else {}
    done = subprocess.run(
        [sys.executable, __file__, "--hashes"],
        env=os.environ | fixed,
        capture_output=True,
        text=True,
        check=True,
    )
    return dict(json.loads(done.stdout))


def _made() -> dict[str, str]:
    from clacad.design import Design
    from clacad.exporting.run import export

    found: dict[str, str] = {}
    for source in (SLAB, PAIR, HEXAGONS):
        design = Design.from_dict(tomllib.loads(Design.from_dict(source).canonical_toml()))
        with tempfile.TemporaryDirectory() as folder:
            export(design, folder, formats=FORMATS, quads=4)
            for path in sorted(Path(folder).iterdir()):
                if path.name != "run.json":
                    found[f"{design.name}/{path.name}"] = sha256(path.read_bytes()).hexdigest()
    return found


def record() -> dict[str, Any]:
    return dict(json.loads(RECORD.read_text()))


def main() -> int:
    """Compare, or renew."""
    parser = argparse.ArgumentParser(description="Hashes of small exports.")
    parser.add_argument("--renew", action="store_true", help="write the record anew")
    parser.add_argument("--hashes", action="store_true", help="print the hashes made in this very process")
    asked = parser.parse_args()
    if asked.hashes:
        sys.stdout.write(json.dumps(_made()))
        return 0
    if asked.renew:
        kept = {"versions": versions(), "files": hashes()}
        RECORD.write_text(json.dumps(kept, indent=1, sort_keys=True) + "\n")
        return 0
    kept, now = record(), hashes()
    changed = sorted(
        name for name in kept["files"].keys() | now.keys() if kept["files"].get(name) != now.get(name)
    )
    same = kept["versions"] == versions()
    sys.stdout.write(
        f"versions {'as' if same else 'other than'} recorded; {len(changed)} of {len(now)} files differ\n"
    )
    sys.stdout.write("".join(f"  {name}\n" for name in changed))
    return int(bool(changed) and same)


if __name__ == "__main__":
    sys.exit(main())
