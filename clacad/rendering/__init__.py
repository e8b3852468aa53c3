"""The view through the sheet: pictures and movies of scene files, and measurements on them.

`render` returns the linear light of a still as an array; `render_movie` yields frames.
`clacad.rendering.picture_files` writes files.
"""

from __future__ import annotations

from typing import Any

__all__ = ["Picture", "render", "render_movie", "view_through"]


def __getattr__(name: str) -> Any:
    """Import a public name on first use: importing the package alone loads nothing else."""
    if name in __all__:
        from clacad.rendering import picture

        return getattr(picture, name)
    raise AttributeError(f"module 'clacad.rendering' has no attribute {name!r}")
