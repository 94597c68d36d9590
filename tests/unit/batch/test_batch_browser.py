from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import batch_fakes as fakes
import pytest
from batch_fakes import FakeRenderer

from tonewood.batch.runner import run_batch

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")

PROBE = """
<script>
const audio = document.querySelector("audio"), picture = document.querySelector("img");
picture.loading = "eager";
audio.muted = true;
const report = () => document.body.setAttribute("data-probe",
  [audio.currentTime > 0.1, audio.duration.toFixed(2), picture.complete && picture.naturalWidth].join(" "));
audio.addEventListener("timeupdate", report);
audio.addEventListener("error", () => document.body.setAttribute("data-probe", "audio error"));
audio.play().catch(fault => document.body.setAttribute("data-probe", "refused: " + fault));
</script>
</body>
"""


@pytest.mark.validate
@pytest.mark.skipif(CHROMIUM is None, reason="needs Chromium")
def test_the_audition_page_plays_and_shows(tmp_path: Path) -> None:
    path = fakes.write(tmp_path, fakes.manifest(pages=[{"type": "html"}]))
    report = run_batch(path, tmp_path / "out", FakeRenderer())
    page = tmp_path / "out" / "audition.html"
    probed = page.with_name("probed.html")
    probed.write_text(page.read_text().replace("</body>", PROBE))
    command = [
        str(CHROMIUM), "--headless", "--no-sandbox", "--disable-gpu", "--dump-dom",
        "--autoplay-policy=no-user-gesture-required", "--virtual-time-budget=8000",
        f"--user-data-dir={tmp_path / 'profile'}", probed.as_uri(),
    ]  # fmt: skip
    shown = subprocess.run(command, capture_output=True, text=True, timeout=120, check=True).stdout
    found = re.search(r'data-probe="([^"]*)"', shown)
    assert found is not None
    played, seconds, width = found.group(1).split()
    assert played == "true"
    assert float(seconds) == pytest.approx(report.files[0].frames / 48000, abs=0.02)
    assert width == "700"
