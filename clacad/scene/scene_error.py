"""Mistakes in a scene file, with the mistake types, codes and places used for designs."""

from __future__ import annotations

from clacad.config.design_error import DesignError


class SceneError(DesignError):
    """A scene that cannot be accepted; holds every mistake found, including those of its design."""

    exit_status = 2
