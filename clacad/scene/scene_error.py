"""What is wrong with a scene file; the same mistakes, codes and places as for designs."""

from __future__ import annotations

from clacad.config.design_error import DesignError


class SceneError(DesignError):
    """A scene that cannot be accepted; holds every mistake that was found, those of its design included."""

    exit_status = 2
