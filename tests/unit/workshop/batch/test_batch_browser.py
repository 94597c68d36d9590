from __future__ import annotations

import json
from pathlib import Path

import batch_fakes as fakes
import pytest
from batch_fakes import FakeRenderer

from browser import CHROMIUM, listening, opened
from tonewood.workshop.batch.runner import run_batch

PROBE = """
<script>
const tell = words => { new Image().src = "http://127.0.0.1:%d/" + encodeURIComponent(words); };
(async () => {
  const wait = ms => new Promise(done => setTimeout(done, ms));
  const press = key => document.dispatchEvent(new KeyboardEvent("keydown", { key }));
  const blind = place.textContent.includes("damping=");
  press("a");
  while (!current) await wait(10);
  const { began, gains } = current, first = current.code;
  await wait(150);
  press("b");
  await wait(60);
  const second = current.code, gapless = current.began === began && current.gains === gains;
  const heard = Object.entries(gains).filter(([, gain]) => gain.value > 0.99).map(([code]) => code);
  const cursors = [...document.querySelectorAll(".cursor")].map(c => c.style.left);
  const duration = current.duration;
  document.getElementById("unblind").click();
  while (!names) await wait(10);
  const sort = document.getElementById("sort");
  sort.value = "damping";
  sort.dispatchEvent(new Event("change"));
  const figures = [...document.querySelector("section").querySelectorAll("figure")];
  const levels = figures.map(f => names[f.dataset.code].levels.damping);
  const image = document.querySelector(".picture img");
  image.loading = "eager";
  while (!image.complete) await wait(10);
  const open = place.textContent.includes("damping=");
  document.getElementById("unblind").click();
  tell(JSON.stringify({
    blind, open, again: place.textContent.includes("damping="), gapless, differ: first !== second,
    heard: heard.join() === second, cursors: new Set(cursors.slice(0, 6)).size, moved: parseFloat(cursors[0]) > 0,
    duration, levels, width: image.naturalWidth,
  }));
})().catch(fault => tell("fault: " + fault));
</script>
</body>
"""


@pytest.mark.validate
@pytest.mark.skipif(CHROMIUM is None, reason="needs Chromium")
def test_the_audition_page_switches_without_a_gap_and_hides_names(tmp_path: Path) -> None:
    path = fakes.write(tmp_path, fakes.manifest(pages=[{"type": "html"}], output={"pictures": True}))
    report = run_batch(path, tmp_path / "out", FakeRenderer())
    page = tmp_path / "out" / "audition.html"
    probed = page.with_name("probed.html")
    with listening() as (port, reported):
        probed.write_text(page.read_text().replace("</body>", PROBE % port))
        with opened(probed, tmp_path / "profile"):
            found = json.loads(reported.get(timeout=120))
    assert (found["blind"], found["open"], found["again"]) == (False, True, False)
    assert found["gapless"]
    assert found["differ"]
    assert found["heard"]
    assert (found["cursors"], found["moved"]) == (1, True)
    assert found["duration"] == pytest.approx(report.files[0].frames / 48000, abs=1e-4)
    assert found["levels"] == sorted(found["levels"])
    assert len(set(found["levels"])) == 3
    assert found["width"] == 700
