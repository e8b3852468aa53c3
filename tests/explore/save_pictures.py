"""Save the picture of every preset of the explorer, for `test_every_preset_looks_as_it_did`.

Usage: python tests/explore/save_pictures.py; look at them before they are kept.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import numpy as np

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE.parent), str(HERE)]


def main() -> None:
    """Draw them all."""
    import browser
    from explorerpage import Page
    from PIL import Image
    from test_explorer_page import PICTURES, PRESETS, SIDE, shipped

    PICTURES.mkdir(exist_ok=True)
    opened = browser.Browser()
    try:
        page = Page(opened, Path(tempfile.mkdtemp()), shipped("paper-a-covered"))
        for number, (_, changes) in enumerate(PRESETS):
            page.set(**changes)
            Image.fromarray(page.picture(SIDE, SIDE).astype(np.uint8)).save(
                PICTURES / f"{number}.png", optimize=True
            )
    finally:
        opened.close()


if __name__ == "__main__":
    main()
