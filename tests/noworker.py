"""Read PLY files in this process: starting another for each of many examples takes long."""

from __future__ import annotations

import pytest

from clacad.formats.mesh import ply


class NoWorker:
    """In place of a worker: calls the function in this process."""

    def __enter__(self) -> NoWorker:
        return self

    def __exit__(self, *_: object) -> None: ...

    def run(self, function: str, *arguments: object, timeout: float) -> object:
        return getattr(ply, function.partition(":")[2])(*arguments)


def without_worker(monkeypatch: pytest.MonkeyPatch) -> None:
    """Read PLY files without a process of their own."""
    monkeypatch.setattr(ply, "limited_worker", lambda spent: NoWorker())
