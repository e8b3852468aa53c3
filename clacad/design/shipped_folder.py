"""Where the designs and scenes of the paper lie: they come with the package.

They have one home, the folder `designs` of the repository. An installed package holds them as its own folder of that
name, put there when the wheel is built; in a checkout, installed as editable or not at all, they lie beside the package.
"""

from __future__ import annotations

from pathlib import Path

_PACKAGE = Path(__file__).resolve().parents[1]


def shipped_designs() -> Path:
    """Folder of the shipped design files; the scenes that belong to them lie in its `scenes`.

    Raises
    ------
    FileNotFoundError
        The package was taken out of its repository without them.
    """
    for folder in (_PACKAGE / "designs", _PACKAGE.parent / "designs"):
        if (folder / "scenes").is_dir():
            return folder
    raise FileNotFoundError(
        f"{_PACKAGE / 'designs'}: the designs that come with clacad are not there; install it anew"
    )
