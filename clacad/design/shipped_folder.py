"""Folder of the paper's designs and scenes, which are shipped with the package.

Their source is the folder `designs` of the repository. An installed package contains them as its own folder
of that name, created when the wheel is built. In a checkout, installed as editable or not at all, they lie
next to the package.
"""

from __future__ import annotations

from pathlib import Path

_PACKAGE = Path(__file__).resolve().parents[1]


def shipped_designs() -> Path:
    """Folder of the shipped design files; their scenes lie in its subfolder `scenes`.

    Raises
    ------
    FileNotFoundError
        The package was taken out of its repository without the designs.
    """
    for folder in (_PACKAGE / "designs", _PACKAGE.parent / "designs"):
        if (folder / "scenes").is_dir():
            return folder
    raise FileNotFoundError(
        f"{_PACKAGE / 'designs'}: the designs that come with clacad are not there; install it anew"
    )
