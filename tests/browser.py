"""A page opened in headless Chromium, and its reports."""

from __future__ import annotations

import base64
import json
import os
import shutil
import socket
import subprocess
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from queue import Queue
from threading import Thread
from typing import Any
from urllib.parse import unquote

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
CHROMEDRIVER = shutil.which("chromedriver")
#: axe-core (npm): `npm install --no-save axe-core`, or the file that the variable names
AXE = Path(os.environ.get("AXE_CORE", "node_modules/axe-core/axe.min.js"))
TAGS = ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "wcag22aa", "best-practice"]
#: WebDriver's name of an element's reference, and of keys
_ELEMENT = "element-6066-11e4-a52e-4f735466cecf"
KEYS = {
    "Tab": "\ue004",
    "Enter": "\ue007",
    "Right": "\ue014",
    "Left": "\ue012",
    "Down": "\ue015",
    "Space": " ",
    "End": "\ue010",
    "Home": "\ue011",
}
_OPTIONS = ("--headless", "--no-sandbox", "--disable-gpu", "--autoplay-policy=no-user-gesture-required")


@contextmanager
def answering(handler: type[BaseHTTPRequestHandler]) -> Iterator[int]:
    """A port at which a handler answers."""
    server = ThreadingHTTPServer(("127.0.0.1", 0), handler)
    Thread(target=server.serve_forever, daemon=True).start()
    try:
        yield server.server_port
    finally:
        server.shutdown()
        server.server_close()


@contextmanager
def listening() -> Iterator[tuple[int, Queue[str]]]:
    """A port, and the words that pages ask it for: it plays in real time, whatever the browser's clock does."""
    reported: Queue[str] = Queue()

    class Listener(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            reported.put(unquote(self.path[1:]))
            self.send_response(204)
            self.end_headers()

        def log_message(self, format: str, *args: object) -> None:
            """Says nothing."""

    with answering(Listener) as port:
        yield port, reported


@contextmanager
def opened(page: Path | str, profile: Path) -> Iterator[None]:
    """A browser that shows a page, a file or an address."""
    address = page if isinstance(page, str) else page.as_uri()
    command = [
        str(CHROMIUM), *_OPTIONS, "--remote-debugging-port=0", f"--user-data-dir={profile}", address,
    ]  # fmt: skip
    browser = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        yield
    finally:
        browser.kill()
        browser.wait()


def dom(page: Path, profile: Path) -> str:
    """The document after its scripts have run."""
    command = [str(CHROMIUM), *_OPTIONS, f"--user-data-dir={profile}", "--dump-dom", page.as_uri()]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=120)
    return done.stdout


class Driven:
    """A browser that takes keys and clicks by the WebDriver protocol."""

    def __init__(self, port: int, width: int, height: int):
        self.root = f"http://127.0.0.1:{port}/session"
        options = {"args": [*_OPTIONS, "--disable-background-networking"], "binary": str(CHROMIUM)}
        wanted = {"capabilities": {"alwaysMatch": {"browserName": "chrome", "goog:chromeOptions": options}}}
        self.root += "/" + self._call("", wanted)["sessionId"]
        size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": width < 600}
        self._call("/goog/cdp/execute", {"cmd": "Emulation.setDeviceMetricsOverride", "params": size})

    def _call(self, path: str, body: Any = None, method: str = "POST") -> Any:
        data = None if method != "POST" else json.dumps(body or {}).encode()
        asked = urllib.request.Request(self.root + path, data=data, method=method)
        try:
            with urllib.request.urlopen(asked, timeout=60) as reply:
                return json.loads(reply.read())["value"]
        except urllib.error.HTTPError as fault:
            raise AssertionError(fault.read().decode()[:500]) from None

    def open(self, address: str) -> None:
        self._call("/url", {"url": address})

    def run(self, script: str) -> Any:
        """The value that a script returns; promises are waited for."""
        return self._call("/execute/sync", {"script": script, "args": []})

    def until(self, script: str, seconds: float = 30.0) -> Any:
        """The value of an expression, once it is true."""
        ends = time.monotonic() + seconds
        while not (found := self.run(f"return {script}")):
            assert time.monotonic() < ends, (script, self.run("return document.body.innerText"))
            time.sleep(0.03)
        return found

    def click(self, selector: str) -> None:
        found = self._call("/element", {"using": "css selector", "value": selector})[_ELEMENT]
        self._call(f"/element/{found}/click")

    def press(self, *keys: str) -> None:
        """Keys for the element that has the focus."""
        events = [{"type": kind, "value": KEYS.get(key, key)} for key in keys for kind in ("keyDown", "keyUp")]
        self._call("/actions", {"actions": [{"type": "key", "id": "keys", "actions": events}]})

    def picture(self, path: Path) -> None:
        """The whole page as PNG."""
        params = {"format": "png", "captureBeyondViewport": True}
        shown = self._call("/goog/cdp/execute", {"cmd": "Page.captureScreenshot", "params": params})
        path.write_bytes(base64.b64decode(shown["data"]))

    def colours(self, scheme: str) -> None:
        """Show pages in light or dark colours."""
        features = [{"name": "prefers-color-scheme", "value": scheme}]
        self._call("/goog/cdp/execute", {"cmd": "Emulation.setEmulatedMedia", "params": {"features": features}})

    def close(self) -> None:
        self._call("", method="DELETE")


def violations(browser: Driven) -> list[str]:
    """Rules of axe that the page breaks."""
    if not AXE.exists():
        return []
    browser.run(AXE.read_text() + "; return 1")
    found = browser.run(f"return axe.run({{runOnly: {{type: 'tag', values: {TAGS}}}}}).then(r => r.violations)")
    return [f"{v['id']}: {v['nodes'][0]['html']}" for v in found]


@contextmanager
def driven(width: int, height: int = 900) -> Iterator[Driven]:
    """A browser of a window's size."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    process = subprocess.Popen([str(CHROMEDRIVER), f"--port={port}"], stdout=subprocess.DEVNULL)
    try:
        ends = time.monotonic() + 30
        while True:
            try:
                urllib.request.urlopen(f"http://127.0.0.1:{port}/status", timeout=5).read()
                break
            except urllib.error.URLError:
                assert time.monotonic() < ends
                time.sleep(0.05)
        browser = Driven(port, width, height)
        try:
            yield browser
        finally:
            browser.close()
    finally:
        process.kill()
        process.wait()
