"""A page opened in headless Chromium, and its reports."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from queue import Queue
from threading import Thread
from urllib.parse import unquote

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
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
