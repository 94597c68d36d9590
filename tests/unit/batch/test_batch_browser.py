from __future__ import annotations

import shutil
import subprocess
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from queue import Queue
from threading import Thread
from typing import ClassVar
from urllib.parse import unquote

import batch_fakes as fakes
import pytest
from batch_fakes import FakeRenderer

from tonewood.batch.runner import run_batch

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")

PROBE = """
<script>
const audio = document.querySelector("audio"), picture = document.querySelector("img");
const tell = words => new Image().src = "http://127.0.0.1:%d/" + encodeURIComponent(words);
picture.loading = "eager";
audio.muted = true;
audio.addEventListener("timeupdate", () => {
  if (audio.currentTime > 0.1 && picture.complete)
    tell(["played", audio.duration.toFixed(2), picture.naturalWidth].join(" "));
});
audio.addEventListener("error", () => tell("audio error"));
audio.play().catch(fault => tell("refused: " + fault));
</script>
</body>
"""


class Listener(BaseHTTPRequestHandler):
    """Keeps what the page tells: it plays in real time, whatever the browser's clock for scripts does."""

    reported: ClassVar[Queue[str]] = Queue()

    def do_GET(self) -> None:
        self.reported.put(unquote(self.path[1:]))
        self.send_response(204)
        self.end_headers()

    def log_message(self, format: str, *args: object) -> None:
        """Says nothing."""


@pytest.mark.validate
@pytest.mark.skipif(CHROMIUM is None, reason="needs Chromium")
def test_the_audition_page_plays_and_shows(tmp_path: Path) -> None:
    path = fakes.write(tmp_path, fakes.manifest(pages=[{"type": "html"}]))
    report = run_batch(path, tmp_path / "out", FakeRenderer())
    page = tmp_path / "out" / "audition.html"
    probed = page.with_name("probed.html")
    server = ThreadingHTTPServer(("127.0.0.1", 0), Listener)
    Thread(target=server.serve_forever, daemon=True).start()
    probed.write_text(page.read_text().replace("</body>", PROBE % server.server_port))
    command = [
        str(CHROMIUM), "--headless", "--no-sandbox", "--disable-gpu", "--remote-debugging-port=0",
        "--autoplay-policy=no-user-gesture-required", f"--user-data-dir={tmp_path / 'profile'}", probed.as_uri(),
    ]  # fmt: skip
    browser = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        played, seconds, width = Listener.reported.get(timeout=120).split()
    finally:
        browser.kill()
        browser.wait()
        server.shutdown()
        server.server_close()
    assert played == "played"
    assert float(seconds) == pytest.approx(report.files[0].frames / 48000, abs=0.02)
    assert width == "700"
