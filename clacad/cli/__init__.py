"""The command line: one file a command, errors turned into exit statuses in one place."""

from __future__ import annotations

from clacad.cli.entry_point import main

__all__ = ["main"]
