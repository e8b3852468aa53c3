"""One browser for all tests of the explorer."""

from __future__ import annotations

import importlib.util
from collections.abc import Iterator

import browser
import pytest


@pytest.fixture(scope="session")
def chromium() -> Iterator[browser.Browser]:
    """A headless Chromium; tests are skipped where there is none."""
    if browser.find() is None or importlib.util.find_spec("websockets") is None:
        pytest.skip("no Chromium on the path, or no package websockets to talk to it")
    opened = browser.Browser()
    yield opened
    opened.close()
