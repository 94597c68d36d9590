"""The desk in a browser: knobs turned by a script, and the sound that comes back."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import tonewood as tw
from browser import CHROMEDRIVER, CHROMIUM, Driven, driven, violations
from tonewood.sound.render.options import RenderOptions
from tonewood.workshop.desk.desk import TAIL
from tonewood.workshop.desk.phrase import LONGEST

pytestmark = [
    pytest.mark.validate,
    pytest.mark.skipif(CHROMIUM is None or CHROMEDRIVER is None, reason="needs Chromium and chromedriver"),
]
STATUS = "document.getElementById('status').textContent"
FAULT = "document.getElementById('fault').textContent"
#: sound that the worklet gave out, its channels one after the other
RECORDED = "return desk.sound.recorded.map(([l, r]) => [Array.from(l), Array.from(r)])"


@contextmanager
def opened(name: str, *options: str) -> Iterator[tuple[str, subprocess.Popen[str]]]:
    """Address of a desk, and its process."""
    command = [sys.executable, "-m", "tonewood", "desk", name, "--port", "0", *options]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    try:
        assert process.stdout is not None
        yield process.stdout.readline().strip(), process
    finally:
        process.kill()
        process.wait()


def ready(browser: Driven, address: str) -> None:
    browser.open(address)
    browser.until("window.desk?.state?.modes && desk.state.making === null", 120)


def sounds(browser: Driven) -> np.ndarray[Any, np.dtype[np.float32]]:
    pieces = browser.run(RECORDED)
    return np.concatenate([np.array(piece, dtype=np.float32).T for piece in pieces])


def test_the_sound_heard_is_the_render_and_knobs_are_heard(tmp_path: Path) -> None:
    with opened("monochord", "--folder", str(tmp_path)) as (address, _), driven(1280) as browser:
        ready(browser, address)
        browser.click("#play")
        browser.until("desk.sound.meter.heard > 24000")
        browser.run("desk.sound.record(true)")
        path = "strings.A2.linear_density"
        browser.run(f"desk.act('set', {{path: '{path}', value: 0.005}})")
        browser.until("desk.sound.toSound !== null", 60)
        serial = browser.run("return desk.state.serial")
        assert serial == 1
        browser.until("desk.sound.recorded.length * 128 > 96000", 60)
        found = sounds(browser)
        changed = tw.load_instrument("monochord").replace({path: 0.005})
        gain = browser.run("return desk.state.gain_db")
        options = RenderOptions(tail=TAIL, max_duration=LONGEST, gain_db=gain)
        wanted = tw.render(tmp_path / "phrase.mid", changed, options=options).samples[:, 0].astype(np.float32)
        # after the fade of the sound before, a second of the phrase stands in the recording, sample for sample
        piece, n = wanted[2400 : 2400 + 24000], 24000
        starts = np.flatnonzero(found[: len(found) - n, 0] == piece[0])
        assert any(np.array_equal(found[at : at + n, 0], piece) for at in starts)


def test_what_goes_wrong_is_said_in_words(tmp_path: Path) -> None:
    with opened("monochord") as (address, process), driven(1280) as browser:
        ready(browser, address)
        browser.run("desk.act('set', {path: 'strings.A2.tension', value: -4})")
        assert "strings.A2.tension" in browser.until(FAULT)
        command = browser.run("return document.getElementById('command').value")
        process.send_signal(signal.SIGKILL)
        assert "does not answer" in browser.until(f"{FAULT}.includes('answer') && {FAULT}")
        assert browser.run("return document.getElementById('command').value") == command
    with opened("monochord") as (address, _), driven(1280) as browser:
        browser.open(address.partition("#")[0] + "#wrong")
        assert "token" in browser.until(FAULT)


def test_the_newest_page_has_the_sound() -> None:
    with opened("monochord") as (address, _), driven(1280) as one, driven(800) as two:
        for page in (one, two):
            ready(page, address)
            page.click("#play") if page is one else page.run("desk.sound.start(desk.state.fs)")
            page.until("desk.sound.meter.heard > 4000", 60)
        one.until("!desk.sound.on", 60)
        assert two.run("return desk.sound.on")
        two.run("desk.act('set', {path: 'strings.A2.tension', value: 80})")
        one.until("desk.state.changes.length === 1")


@pytest.mark.parametrize("width", [1280, 800])
def test_the_page_fits_and_every_field_has_a_name(width: int) -> None:
    with opened("classical_guitar") as (address, _), driven(width) as browser:
        ready(browser, address)
        browser.until("document.querySelectorAll('.knob input').length > 5")
        assert browser.run("return document.documentElement.scrollWidth - window.innerWidth") <= 0
        nameless = browser.run(
            "return [...document.querySelectorAll('input, select, textarea, button, canvas')].filter(e => "
            "!(e.labels?.length || e.ariaLabel || e.textContent.trim() || e.placeholder)).map(e => e.outerHTML)"
        )
        assert nameless == []
        browser.run("for (const box of document.querySelectorAll('details')) box.open = true")
        browser.until("document.querySelectorAll('.knob input').length > 100")
        for scheme in ("light", "dark"):
            browser.colours(scheme)
            assert violations(browser) == []
        # by keys alone: a knob is turned, and taken back
        browser.run("document.querySelector('.knob input[type=range]').focus()")
        browser.press("Right", "Right")
        browser.until("desk.state.changes.length === 1")
        browser.run("document.getElementById('undo').focus()")
        browser.press("Enter")
        browser.until("desk.state.changes.length === 0")


@pytest.mark.parametrize("name", ["classical_guitar"])
def test_times_from_a_knob_to_its_sound(name: str, record_property: Any) -> None:
    """Times are recorded, not judged."""
    with opened(name) as (address, _), driven(1280) as browser:
        ready(browser, address)
        browser.click("#play")
        browser.until("desk.sound.meter.heard > 48000", 60)
        times: dict[str, list[float]] = {"hands": [], "strings": []}
        for i in range(5):
            for kind, path, value in (
                ("hands", "exciters.pluck.from_bridge", 0.08 + 0.005 * i),
                ("strings", "strings.E2.linear_density", 6.3e-3 + 1e-4 * i),
            ):
                browser.run("desk.sound.toSound = null")
                browser.run(f"desk.act('set', {{path: '{path}', value: {value}}})")
                times[kind].append(float(browser.until("desk.sound.toSound", 60)))
                time.sleep(0.3)
        for kind, found in times.items():
            record_property(f"{name} {kind} ms", found)
            print(f"{name} {kind}: {', '.join(f'{t:.0f}' for t in found)} ms, load average {os.getloadavg()[0]:.1f}")
            assert len(found) == 5
