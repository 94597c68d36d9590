"""The desk in a browser: knobs turned by a script, and the sound that comes back."""

from __future__ import annotations

import json
import os
import resource
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
import yaml

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


def tonewood(arguments: list[str]) -> None:
    subprocess.run([sys.executable, "-m", "tonewood", *arguments], check=True, stdout=subprocess.DEVNULL)


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
        wanted = tw.render(tmp_path / "desk_phrase.mid", changed, options=options).samples[:, 0].astype(np.float32)
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


def test_a_blind_comparison_is_heard_and_revealed() -> None:
    """X and Y are heard without a name, in the order that Reveal tells; the louder design is turned down."""
    with opened("monochord") as (address, _), driven(1280) as browser:
        ready(browser, address)
        browser.run("return desk.act('set', {path: 'exciters.pluck.from_bridge', value: 0.4})")
        browser.until("desk.state.heard === 1 && desk.state.making === null")
        browser.click("#blind")
        browser.click("#compare")
        buttons = "[...document.querySelectorAll('#pair button')].map(b => b.textContent)"
        assert browser.until(f"desk.state.pair && {buttons}", 60) == ["X", "Y", "Reveal", "End"]
        assert "LU" not in browser.run(f"return {STATUS}")
        browser.click("#play")
        browser.until("desk.sound.meter.heard > 9600")
        pressed = "[...document.querySelectorAll('#pair button')].findIndex(b => b.ariaPressed === 'true')"
        first = browser.run(f"return {pressed}")
        browser.run("desk.sound.record(true)")
        other = 1 - first
        browser.click(f"#pair button:nth-child({other + 1})")
        browser.until(f"{pressed} === {other}")
        browser.until("desk.sound.recorded.length * 128 > 48000", 60)
        found = sounds(browser)[:, 0]
        # no gap: while the phrase rings no 10 ms are silent
        loud = np.sqrt(np.mean(found[: len(found) // 480 * 480].reshape(-1, 480) ** 2, axis=1))
        assert loud[:80].min() > 1e-5
        browser.click("#pair button:nth-child(3)")
        names = browser.until(f"!desk.state.pair.blind && {buttons}")
        assert sorted(name[:2] for name in names[:2]) == ["A:", "B:"]
        assert {"this design", "the start"} == {name[3:] for name in names[:2]}
        browser.click("#pair button:nth-child(3)")
        browser.until("desk.state.pair === null")


def test_all_of_the_page_is_reached_by_keys_and_the_focus_is_seen() -> None:
    """Tab comes to every field, button and end of a brace that can be used, and shows where it is."""
    wanted = (
        "[...document.querySelectorAll('button, input, select, textarea, summary, [tabindex=\"0\"]')]"
        ".filter(e => !e.disabled && e.checkVisibility() && e.getClientRects().length)"
    )
    with opened("classical_guitar") as (address, _), driven(1280) as browser:
        ready(browser, address)
        browser.until(
            "document.querySelectorAll('.knob input').length > 5 && document.querySelector('#open button')", 60
        )
        browser.until("document.querySelectorAll('#peaks button').length > 3")
        time.sleep(1.0)
        browser.run(
            f"window.wanted = {wanted}; window.reached = new Set(); window.unseen = []; document.activeElement.blur()"
        )
        for _ in range(browser.run("return wanted.length") + 5):
            browser.press("Tab")
            browser.run(
                "const e = document.activeElement, s = getComputedStyle(e);"
                "if (e === document.body) return;"
                "reached.add(e);"
                "if (s.outlineStyle === 'none' || parseFloat(s.outlineWidth) < 2) unseen.push(e.outerHTML)"
            )
        missed = "return wanted.filter(e => e.isConnected && !reached.has(e)).map(e => e.outerHTML.slice(0, 120))"
        assert browser.run(missed) == []
        assert browser.run("return unseen") == []
        # canvases are pictures: what a click on them does, buttons beside them do
        browser.run("document.querySelector('#peaks button').focus()")
        browser.press("Enter")
        browser.until("document.getElementById('shape_h').textContent.includes('Hz')")
        # a tuned damper from the form, by keys alone
        browser.run("document.getElementById('mass_frequency').focus()")
        browser.press(*"212")
        browser.press("Enter")
        added = browser.until("desk.state.added.length === 1 && desk.state.added[0]")
        assert (added["mass"], added["frequency"], added["q"]) == (0.01, 212, 5)


def test_memory_of_page_and_server_is_flat_over_a_thousand_changes(record_property: Any) -> None:
    """Live JavaScript heap after a collection, and resident memory of the server, while the phrase plays."""
    with opened("monochord") as (address, process), driven(1280) as browser:
        ready(browser, address)
        browser.click("#play")
        browser.until("desk.sound.meter.heard > 4800")

        def turn(times: int) -> tuple[float, float]:
            browser.run(
                f"window.turned = 0; (async () => {{ for (let i = 0; i < {times}; i++, turned++) {{"
                "await desk.act('set', {path: 'exciters.pluck.from_bridge', value: 0.05 + 2e-4 * i});"
                "if (!(i % 20)) await desk.act('set', {path: 'strings.A2.linear_density', value: 4e-3 + 1e-6 * i});"
                "}})()"
            )
            browser.until(f"window.turned === {times}", 1800)
            browser.until("desk.state.making === null", 60)
            browser._call("/goog/cdp/execute", {"cmd": "HeapProfiler.collectGarbage", "params": {}})
            heap = browser._call("/goog/cdp/execute", {"cmd": "Runtime.getHeapUsage", "params": {}})["usedSize"]
            pages = int(Path(f"/proc/{process.pid}/statm").read_text(encoding="ascii").split()[1])
            return heap / 1e6, pages * resource.getpagesize() / 1e6

        before = turn(200)
        after = turn(1000)
        record_property("MB of the page and the server, before and after", [*before, *after])
        print(f"page {before[0]:.1f} to {after[0]:.1f} MB, server {before[1]:.0f} to {after[1]:.0f} MB")
        assert after[0] - before[0] < 5.0
        assert after[1] - before[1] < 40.0


#: a plate of two modes and a string, as in papers on the method
PLATE = {
    "schema": "tonewood-instrument/2",
    "name": "plate_of_two_modes",
    "title": "A string on a plate of two modes",
    "licence": "CC0-1.0",
    "sources": {},
    "provenance": {"*": {"kind": "authored"}},
    "body": {
        "plugin": "modal_table",
        "table": "plate.csv",
        "shapes": "points",
        "points": {"bridge": {"direction": "z"}},
    },
    "strings": {
        "s": {
            "plugin": "stiff_string", "note": "G3", "length": 0.65, "tension": 60.0, "linear_density": 9e-4,
            "bending_stiffness": 6e-5, "loss": {"law": "sigma", "sigma0": 0.5, "sigma1": 1e-4}, "end": "body.bridge",
        }
    },
    "exciters": {"pluck": {"plugin": "pluck_ramp", "from_bridge": 0.2, "ramp_time": 0.05, "force": 1.0}},
    "playing": {"velocity": {"parameter": "pluck.force", "low": 1.0, "high": 1.0}},
    "outputs": [
        {"name": "bridge", "plugin": "point_pickup", "quantity": "velocity", "at": "body.bridge", "full_scale": 1.0}
    ],
}  # fmt: skip


def test_a_student_sees_the_constraint_force_and_keeps_the_plate(tmp_path: Path) -> None:
    """A bundle of one's own at the desk: the force at rest is the lever's, F (1 - a / L); what is saved is used."""
    folder = tmp_path / "plate_of_two_modes"
    folder.mkdir()
    (folder / "instrument.yaml").write_text(yaml.safe_dump(PLATE))
    (folder / "plate.csv").write_text("f_Hz,Q,modal_mass,bridge\n120,60,0.8,1\n260,60,0.5,1\n")
    with opened(str(folder)) as (address, _), driven(1280) as browser:
        ready(browser, address)
        label = "document.getElementById('force').getAttribute('aria-label')"
        assert "Force of s on the body: largest" in browser.until(f"{label}.includes('largest') && {label}")
        seen = browser.run(
            "return fetch('/api/view/force?argument=s', {headers: {'X-Desk-Token': location.hash.slice(1)}})"
            ".then(r => r.json())"
        )
        assert [m["freq"] for m in browser.run(
            "return fetch('/api/view/mobility', {headers: {'X-Desk-Token': location.hash.slice(1)}})"
            ".then(r => r.json()).then(d => d.modes)"
        )] == pytest.approx([120.0, 260.0])  # fmt: skip
        force = np.array(seen["force"])
        rest = round((seen["before"] - 1e-4) * seen["fs"])
        assert abs(force[rest]) == pytest.approx(1.0 * (1 - 0.2 / 0.65), rel=0.02)
        browser.run("return desk.act('set', {path: 'strings.s.tension', value: 62})")
        browser.run(f"document.getElementById('save_folder').value = {json.dumps(str(tmp_path / 'mine'))}")
        browser.click("#save button")
        browser.until("document.getElementById('said').textContent.includes('saved')", 60)
    tonewood(["compare", str(folder), str(tmp_path / "mine"), "--notes", "G3", "-o", str(tmp_path / "both.html")])
    assert "mine" in (tmp_path / "both.html").read_text(encoding="utf-8")
    batch = {
        "schema": "tonewood-batch/1", "name": "mine", "title": "Two plates", "seed": 1,
        "instruments": {"before": "plate_of_two_modes", "after": "mine"},
        "scores": {"note": {"phrase": [{"time": 0.0, "duration": 0.3, "note": 55}]}},
        "render": {"max_duration": 0.4},
    }  # fmt: skip
    (tmp_path / "batch.yaml").write_text(yaml.safe_dump(batch))
    tonewood(["batch", str(tmp_path / "batch.yaml"), "-o", str(tmp_path / "sounds")])
    assert len(list((tmp_path / "sounds").glob("stimuli/*.wav"))) == 2
