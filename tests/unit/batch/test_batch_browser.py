from __future__ import annotations

from pathlib import Path

import batch_fakes as fakes
import pytest
from batch_fakes import FakeRenderer

from browser import CHROMIUM, listening, opened
from tonewood.batch.runner import run_batch

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


@pytest.mark.validate
@pytest.mark.skipif(CHROMIUM is None, reason="needs Chromium")
def test_the_audition_page_plays_and_shows(tmp_path: Path) -> None:
    path = fakes.write(tmp_path, fakes.manifest(pages=[{"type": "html"}]))
    report = run_batch(path, tmp_path / "out", FakeRenderer())
    page = tmp_path / "out" / "audition.html"
    probed = page.with_name("probed.html")
    with listening() as (port, reported):
        probed.write_text(page.read_text().replace("</body>", PROBE % port))
        with opened(probed, tmp_path / "profile"):
            played, seconds, width = reported.get(timeout=120).split()
    assert played == "played"
    assert float(seconds) == pytest.approx(report.files[0].frames / 48000, abs=0.02)
    assert width == "700"
