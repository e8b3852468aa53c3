"""Files that a design or scene names: relative to its folder, and not to lead out of it."""

from __future__ import annotations

import os


def folder_of(path: str) -> str:
    """Folder that the files named in a file at this path are relative to."""
    return os.path.dirname(path) or "."


def outside(folder: str, name: str, levels: int = 0, whose: str = "design") -> str:
    """Return why a name may not be used ("" if it may): relative, inside the folder or `levels` above it.

    Links are followed first, so that none leads out.

    Parameters
    ----------
    folder, name : str
    levels : int
        0, 1 or more folders above may be reached.
    whose : str
        Word of the message: the file that names it.
    """
    if os.path.isabs(name) or "\0" in name or (len(name) > 1 and name[1] == ":"):
        return "is not a relative path"
    home = os.path.realpath(os.path.join(folder, *[os.pardir] * levels))
    real = os.path.realpath(os.path.join(folder, name))
    if os.path.commonpath([home, real]) != home:
        parents = ("", " and its parent", " and its parent folders")[min(levels, 2)]
        return f"lies outside the {whose}'s folder{parents}"
    return ""
