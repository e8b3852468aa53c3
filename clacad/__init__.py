"""clacad: design, make and verify generalized confocal lenslet arrays.

One design file goes in; exact solids, watertight meshes and a ray-traced proof come out.
Public names resolve lazily (PEP 562): importing clacad loads neither a CAD kernel nor a compiler.

>>> import clacad
>>> window = clacad.prescribe(clacad.load("paper-base"))
"""

import sys

if (
    getattr(sys, "argv", [])[:1] == ["-m"] and not sys.flags.safe_path
):  # some `python -m` looks for its module
    if sys.orig_argv[-len(sys.argv)].removeprefix("-m") == "clacad":
        # The current folder is first on the path: a json.py left there would be run. Before this not even
        # __future__ may be imported. Should the package itself lie in that folder, it goes last.
        _here = sys.path.pop(0)
        if _here not in sys.path and __file__.startswith((f"{_here}/clacad", f"{_here}\\clacad")):
            sys.path.append(_here)

from importlib import import_module

TYPE_CHECKING = False  # as type checkers read it; the module typing would be half of what the package loads
if TYPE_CHECKING:
    from typing import Any

__version__ = "0.2.0"

with open(__file__.removesuffix("c") + "i", encoding="utf-8") as _stub:  # __init__.pyi lists the names once
    _HOME = {line.split()[3]: line.split()[1] for line in _stub if line.startswith("from ")}

__all__ = sorted(_HOME)


def __getattr__(name: str) -> "Any":
    """Import a public name from its home module when it is first used."""
    if name not in _HOME:
        raise AttributeError(f"module 'clacad' has no attribute {name!r}")
    value = getattr(import_module(_HOME[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
