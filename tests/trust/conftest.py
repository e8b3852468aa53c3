"""What the tests of this folder share."""

from __future__ import annotations

from pathlib import Path

import pytest
from trust.running import TINY


@pytest.fixture
def design(tmp_path: Path) -> Path:
    """A file of a small design."""
    path = tmp_path / "tiny.toml"
    path.write_text(TINY)
    return path
