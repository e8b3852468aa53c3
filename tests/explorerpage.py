"""An explorer page in a browser: its drawing and its text, as arrays and numbers."""

from __future__ import annotations

import base64
import json
import tomllib

import numpy as np

from clacad.design import Design
from clacad.explorer import explore

QUANTUM = 2.0 / 65535.0
"""Of a slope written as 16 bits of −1 … 1."""

NOWHERE = -32768
"""A cell that is none."""

STATE = "document.getElementById('explorer').dataset.state"


class Page:
    """One explorer page, opened in a browser of `tests/browser.py`."""

    def __init__(self, browser, folder, design):
        self.browser, self.file = browser, folder / "page.html"
        explore(design, self.file, overwrite=True)
        browser.ask("Page.navigate", url="about:blank")  # else a link would only change the fragment
        browser.ask(
            "Emulation.setDeviceMetricsOverride", width=200, height=200, deviceScaleFactor=1, mobile=False
        )
        browser.open(self.file)
        browser.wait("window.explorer !== undefined")

    def set(self, **changes):
        """Move sliders from where the design has them."""
        self.browser.run(f"explorer.reset(); explorer.set({json.dumps(changes)})")

    def design(self):
        """The design that the page hands out as TOML."""
        return Design.from_dict(tomllib.loads(self.browser.run("explorer.toml()")))

    def verdict(self):
        """Numbers of the verdict line."""
        return self.browser.run("explorer.verdict()")

    def _bytes(self, call, wide, tall):
        data = base64.b64decode(self.browser.run(call))
        return np.frombuffer(data, dtype=np.uint8).reshape(tall, wide, 4)[::-1].astype(np.int64)

    def picture(self, wide, tall):
        """Pixels (tall, wide, 3), 0 … 255."""
        return self._bytes(f"explorer.picture({wide}, {tall})", wide, tall)[..., :3]

    def debug(self, wide, tall):
        """Slopes (n, 2), cells met of array 2 and of array 1 (n, 2), fates (n,), of the pixels row by row."""
        first = [self._pairs(part, wide, tall) for part in range(4)]
        slope = np.stack([p[0] for p in first[:2]], axis=-1) * QUANTUM - 1.0
        last, entered = (np.stack([p[1] for p in two], axis=-1) + NOWHERE for two in (first[:2], first[2:]))
        return slope, last, entered, first[2][0]

    def _pairs(self, part, wide, tall):
        found = self._bytes(f"explorer.debug({part}, {wide}, {tall})", wide, tall).reshape(-1, 4)
        return found[:, 0] * 256 + found[:, 1], found[:, 2] * 256 + found[:, 3]

    def rays(self, wide, tall):
        """Start and directions (n, 3) through the middles of the pixels, sheet frame."""
        view = {name: np.array(v) for name, v in self.browser.run(f"explorer.camera({wide}, {tall})").items()}
        u = (2.0 * np.arange(wide) + 1.0) / wide - 1.0
        v = 1.0 - (2.0 * np.arange(tall) + 1.0) / tall
        across, high = (a.reshape(-1, 1) for a in np.meshgrid(u, v))
        direction = view["ahead"] + across * view["right"] + high * view["up"]
        return np.broadcast_to(view["eye"], direction.shape), direction
