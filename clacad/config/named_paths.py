"""Files named in a design or scene: paths are relative to its folder and must not lead out of it."""

from __future__ import annotations

import os


def folder_of(path: str) -> str:
    """Folder to which file names in the file at `path` are relative."""
    return os.path.dirname(path) or "."


def outside(folder: str, name: str, levels: int = 0, whose: str = "design") -> str:
    """Return why a name is refused ("" if it is allowed): relative, inside the folder or `levels` above it.

    Links are resolved first, so that none leads out.

    Parameters
    ----------
    folder, name : str
    levels : int
        Number of parent folders that may be reached.
    whose : str
        Kind of the file that contains the name, for the message.
    """
    if os.path.isabs(name) or "\0" in name or (len(name) > 1 and name[1] == ":"):
        return "is not a relative path"
    home = os.path.realpath(os.path.join(folder, *[os.pardir] * levels))
    real = os.path.realpath(os.path.join(folder, name))
    if os.path.commonpath([home, real]) != home:
        parents = ("", " and its parent", " and its parent folders")[min(levels, 2)]
        return f"lies outside the {whose}'s folder{parents}"
    return ""
