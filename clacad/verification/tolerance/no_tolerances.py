"""What a study refuses, each with its exit status."""

from __future__ import annotations


class NoTolerances(ValueError):
    """The design states nothing that could go wrong."""

    exit_status = 2


class CannotVary(ValueError):
    """A --vary that names no values, or no key."""

    exit_status = 2


class NoCluster(RuntimeError):
    """The scheduler, or the package that talks to it, is not there."""

    exit_status = 2
