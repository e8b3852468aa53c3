"""A tiny client of a headless Chromium: opens a page from disk, listens to it, drags on it, takes pictures."""

from __future__ import annotations

import base64
import contextlib
import io
import json
import os
import shutil
import subprocess
import tempfile
import time
from pathlib import Path

import numpy as np

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")
FLAGS = (
    "--headless=new", "--no-first-run", "--no-default-browser-check", "--disable-extensions", "--hide-scrollbars",
    "--disable-background-networking", "--disable-component-update", "--disable-sync", "--disable-dev-shm-usage",
    "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--remote-debugging-port=0",
    "--remote-allow-origins=*", "--window-size=1180,900",
)  # fmt: skip


def find():
    """Path of a browser, or None."""
    return next((path for name in NAMES if (path := shutil.which(name))), None)


class Browser:
    """One headless browser with one page; events are kept as they come."""

    def __init__(self, flags=()):
        from websockets.sync.client import connect

        self.folder = tempfile.mkdtemp(prefix="browser-")
        alone = ["--no-sandbox"] if hasattr(os, "geteuid") and os.geteuid() == 0 else []
        self.process = subprocess.Popen(
            [find(), *FLAGS, *alone, *flags, f"--user-data-dir={self.folder}", "about:blank"],
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )  # fmt: skip
        port, path = self._port()
        self.open_things = contextlib.ExitStack()
        self.socket = self.open_things.enter_context(
            connect(f"ws://127.0.0.1:{port}{path}", max_size=1 << 28)
        )
        self.number, self.events, self.session = 0, [], None
        target = self.ask("Target.createTarget", url="about:blank")["targetId"]
        self.session = self.ask("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.ask(f"{domain}.enable")

    def _port(self):
        where = Path(self.folder) / "DevToolsActivePort"
        for _ in range(300):
            if where.exists() and len(lines := where.read_text().splitlines()) == 2:
                return lines
            time.sleep(0.1)
        raise TimeoutError("the browser does not open its port")

    def ask(self, method, **parameters):
        """Send one command and give its result."""
        self.number += 1
        message = {"id": self.number, "method": method, "params": parameters}
        if self.session:
            message["sessionId"] = self.session
        self.socket.send(json.dumps(message))
        while True:
            answer = json.loads(self.socket.recv(timeout=150))
            if answer.get("id") == self.number:
                if "error" in answer:
                    raise RuntimeError(f"{method}: {answer['error']}")
                return answer["result"]
            self.events.append(answer)

    def open(self, path):
        """Open a file and wait until it is there."""
        self.events.clear()
        self.ask("Page.navigate", url=Path(path).resolve().as_uri())
        self.wait("document.readyState === 'complete' && location.href !== 'about:blank'")

    def run(self, expression):
        """Value of an expression in the page."""
        result = self.ask("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        if "exceptionDetails" in result:
            raise RuntimeError(result["exceptionDetails"])
        return result["result"].get("value")

    def wait(self, condition, seconds=150.0):
        """Wait until a condition holds in the page."""
        end = time.monotonic() + seconds
        while not self.run(condition):
            if time.monotonic() > end:
                raise TimeoutError(condition)
            time.sleep(0.05)

    def complaints(self):
        """What the page wrote to its console, and what went wrong in it."""
        self.run("1")  # all messages that were pending have arrived
        found = []
        for event in self.events:
            if event.get("method") in (
                "Runtime.exceptionThrown",
                "Runtime.consoleAPICalled",
                "Log.entryAdded",
            ):
                found.append(json.dumps(event["params"])[:400])
        return found

    def requests(self):
        """Addresses requested, other than the page's own and what the page holds itself."""
        self.run("1")
        asked = [
            e["params"]["request"]["url"]
            for e in self.events
            if e.get("method") == "Network.requestWillBeSent"
        ]
        return [url for url in asked if not url.startswith(("data:", "blob:"))]

    def mouse(self, kind, x, y):
        """Send one event of the left button."""
        pressed = 0 if kind == "mouseReleased" else 1
        self.ask(
            "Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", buttons=pressed, clickCount=1
        )

    def drag(self, start, end):
        """Press, move in steps, release."""
        self.mouse("mousePressed", *start)
        for part in np.linspace(0.2, 1.0, 5):
            self.mouse("mouseMoved", *(np.array(start) + part * (np.array(end) - np.array(start))))
        self.mouse("mouseReleased", *end)

    def key(self, name):
        """Press and release a key."""
        for kind in ("keyDown", "keyUp"):
            self.ask("Input.dispatchKeyEvent", type=kind, key=name, code=name)

    def picture(self, box=None, whole=False):
        """Pixels (h, w, 3) of the window, of a box (x, y, width, height), or of the whole page."""
        from PIL import Image

        parameters = {"format": "png", "captureBeyondViewport": whole or box is not None}
        if whole:
            size = self.ask("Page.getLayoutMetrics")["cssContentSize"]
            box = (0, 0, size["width"], size["height"])
        if box is not None:
            parameters["clip"] = dict(zip(("x", "y", "width", "height"), box)) | {"scale": 1}
        data = base64.b64decode(self.ask("Page.captureScreenshot", **parameters)["data"])
        return np.asarray(Image.open(io.BytesIO(data)).convert("RGB")).astype(int)

    def close(self):
        """End the browser and forget what it kept."""
        with contextlib.suppress(Exception):
            self.session = None
            self.ask("Browser.close")
        self.open_things.close()
        self.process.terminate()
        self.process.wait(20)
        shutil.rmtree(self.folder, ignore_errors=True)
