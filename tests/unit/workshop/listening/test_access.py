"""A test taken by keyboard alone at a phone's and a desk's width, every page looked at by axe."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import listening_fakes as fakes
import pytest
from listening_fakes import made
from test_server import free_port, served

from browser import CHROMEDRIVER, CHROMIUM, Driven, driven, violations
from tonewood.workshop.listening.answer_file import answers_of

pytestmark = [
    pytest.mark.validate,
    pytest.mark.skipif(CHROMIUM is None or CHROMEDRIVER is None, reason="needs Chromium and chromedriver"),
]
RATED = {"loop": "region", "waveform": True}
PAGES: list[dict[str, Any]] = [
    {"type": "headphones", "trials": 2, "attempts": 1, "failed": "go_on"},
    *(
        page | RATED if page["type"] in ("mushra", "bs1116") else page
        for page in fakes.ALL
        if page["type"] != "training"
    ),
    {"type": "finish", "back": {"code": "TW-{id}", "address": "https://crowd.example/done?cc={code}&who={listener}"}},
]
INDEX = "Number(document.getElementById('page').dataset.index ?? -1)"


def overflow(browser: Driven) -> int:
    """Pixels by which the page is wider than its window."""
    return int(browser.run("return document.documentElement.scrollWidth - window.innerWidth"))


def focused(browser: Driven) -> str:
    return str(browser.run("const e = document.activeElement; return `${e.tagName} ${e.type || ''} ${e.name || ''}`"))


def begin(browser: Driven, port: int, query: str = "") -> None:
    """Open the test, and its first page."""
    browser.open(f"http://127.0.0.1:{port}/{query}")
    browser.until("document.getElementById('next')")
    browser.click("#next")
    browser.until(f"{INDEX} === 0")


def answered(browser: Driven, kind: str) -> None:
    """Answer a page with keys alone."""
    if kind == "consent":
        browser.press("Tab", "Space")
    elif kind == "questionnaire":
        browser.press("Tab", "4", "Tab", "Space")
    elif kind == "level":
        browser.press("Tab", "Space", "Tab", "Tab", "7", "0", "Tab")
    elif kind in ("mushra", "bs1116", "rating"):
        inputs = browser.run("return main.querySelectorAll('input.unset').length")
        for _ in range(40):
            if browser.run("return document.activeElement.matches('input.unset')"):
                browser.press("End" if kind == "bs1116" else "Enter")
                inputs -= 1
            if not inputs:
                break
            browser.press("Tab")
    if not browser.run("return sounds !== null && step.slots.length > 0"):
        return
    if browser.run("return step.sequence"):
        browser.press("p")
        browser.until("step.slots.every(enough)")
        browser.press("1")
        return
    for slot in browser.run("return step.slots"):
        for _ in range(100):
            if browser.run(f"return enough('{slot}')"):
                break
            if not browser.run(f"return sounds.playing === '{slot}'"):
                browser.press("r" if slot == "reference" else slot.lower())
    if browser.run("return main.querySelector('.choice') !== null"):
        browser.press("1")


@pytest.mark.parametrize("width", [375, 1280])
def test_a_whole_test_is_taken_by_keys_at_a_width(tmp_path: Path, width: int) -> None:
    test = made(tmp_path, PAGES)
    port = free_port()
    kinds: set[str] = set()
    pictures = Path(os.environ["PICTURES"]) if "PICTURES" in os.environ else None
    with served(test, port), driven(width) as browser:
        browser.open(f"http://127.0.0.1:{port}/?listener=P1&quick=1&language=en")
        browser.until("document.getElementById('next')")
        assert violations(browser) == []
        browser.press("Tab", "Tab", "Space")
        last = -1
        while browser.until(f"document.getElementById('done') || {INDEX} !== {last}"):
            if browser.run("return document.getElementById('done') !== null"):
                break
            last, kind = browser.run(f"return [{INDEX}, document.getElementById('page').dataset.type]")
            if kind not in kinds:
                assert violations(browser) == [], kind
                assert overflow(browser) <= 0, kind
                assert browser.run("return document.activeElement.tagName") == "H2"
                kinds.add(kind)
            answered(browser, kind)
            if pictures is not None:
                browser.picture(pictures / f"{width}_{kind}.png")
            browser.press("Enter")
            browser.until(f"{INDEX} !== {last} || document.getElementById('message').textContent")
            assert browser.run("return document.getElementById('message').className") in ("", "right")
        assert violations(browser) == []
        (one,) = answers_of(test).listeners
        code = f"TW-{one.header['token'][:8]}"
        assert browser.run("return document.querySelector('.code').textContent") == code
        address = browser.run("return document.getElementById('return').href")
        assert address == f"https://crowd.example/done?cc={code}&who=P1"
        if pictures is not None:
            browser.picture(pictures / f"{width}_done.png")
    assert kinds == {page["type"] for page in PAGES}
    assert one.records[-1]["type"] == "finish"
    heard = [share for r in one.records if r["slots"] for share in r["answer"]["heard"].values()]
    assert min(heard) >= 0.5


def test_ratings_survive_a_reload_and_half_a_sound_is_not_enough(tmp_path: Path) -> None:
    page = {"type": "mushra", "group_by": ["pluck"], "reference": {"damping": "complex"}, "listen": 1.0, "plays": 9}
    test = made(tmp_path, [page])
    port = free_port()
    with served(test, port), driven(1280) as browser:
        begin(browser, port)
        browser.run("""
            for (const [k, input] of main.querySelectorAll('input[type=range]').entries()) {
              input.value = 10 * k + 5; input.dispatchEvent(new Event('input'));
            }
            sounds.play('A'); setTimeout(() => sounds.stop(), 80); return 1""")
        browser.until("sounds.share('A') > 0.1 && !sounds.sources")
        share = browser.run("return sounds.share('A')")
        assert share < 0.9
        browser.click("#next")
        assert "Still to hear: Reference, A" in browser.until("document.getElementById('message').textContent")
        browser.open(f"http://127.0.0.1:{port}/")
        browser.until("document.getElementById('kept')")
        browser.click("#next")
        browser.until(f"{INDEX} === 0")
        values = browser.run("return [...main.querySelectorAll('.slider input')].map(i => [i.value, i.className])")
        assert values == [[str(10 * k + 5), ""] for k in range(len(values))]
        assert browser.run("return [sounds.plays.A, sounds.share('A')]") == [1, pytest.approx(share, abs=0.02)]
        browser.run("for (let k = 0; k < 20; k++) sounds.play('A'); return 1")
        assert browser.run("return sounds.plays.A") == 9  # no more than the page allows
        # the listener has the answers deleted
        browser.run("document.querySelector('#own details').open = true; return 1")
        browser.click("#delete")
        browser.click("#withdraw")
        browser.until("document.getElementById('withdrawn')")
    assert answers_of(test).listeners == ()
    assert (test.folder / "answers" / "withdrawn.log").read_text().count("\n") == 1


@pytest.mark.parametrize("kind", ["abx", "afc"])
def test_a_listener_goes_on_when_no_play_is_left(tmp_path: Path, kind: str) -> None:
    """Each sound is stopped before enough of it was heard, as often as it may be played."""
    test = made(tmp_path, [{"type": kind, "pairs": {"pluck": ["near", "far"]}, "plays": 1, "listen": 1.0}])
    port = free_port()
    with served(test, port), driven(1280) as browser:
        begin(browser, port, "?quick=1")
        browser.click(".choice input")
        for slot in [1] if kind == "afc" else browser.run("return step.slots"):
            browser.click("#next")
            assert "Still to hear" in browser.until("document.getElementById('message').textContent")
            browser.run(f"{'sounds.sequence(step.slots)' if kind == 'afc' else f'sounds.play({slot!r})'}; return 1")
            browser.until(f"sounds.plays['{slot}'] === 1 && sounds.share('{slot}') > 0.05")
            browser.run("sounds.stop(); return 1")
        browser.click("#next")
        browser.until(f"{INDEX} === 1")
    (one,) = answers_of(test).listeners
    heard = one.records[0]["answer"]["heard"]
    assert 0 < min(heard.values() if kind == "abx" else [heard["1"]]) < 0.9


def test_a_number_that_cannot_be_read_is_not_passed_over(tmp_path: Path) -> None:
    """A field with such text has an empty value, as one that is left out."""
    age = {"name": "age", "label": "Age", "kind": "number", "optional": True, "low": 5, "high": 120}
    test = made(tmp_path, [{"type": "questionnaire", "questions": [age]}, *fakes.ALL[-3:-2]])
    port = free_port()
    with served(test, port), driven(1280) as browser:
        begin(browser, port, "?quick=1&language=en")
        for text, told in [("3-4", "Please write a number."), ("3", "values.age: 3 is not a number from 5 to 120")]:
            browser.run("const [i] = document.getElementsByName('age'); i.value = ''; i.focus(); return 1")
            browser.press(*text)
            browser.click("#next")
            browser.until("document.getElementById('message').textContent")
            assert browser.run("return document.getElementById('message').textContent") == told
        browser.run("const [i] = document.getElementsByName('age'); i.value = ''; i.focus(); return 1")
        browser.press("3", "4")
        browser.click("#next")
        browser.until(f"{INDEX} === 1")
    (one,) = answers_of(test).listeners
    assert one.records[0]["answer"]["values"] == {"age": 34}


@pytest.mark.parametrize(("low", "high"), [(0.0, 0.9), (-2.0, 0.6), (3.589, 23.7837), (1.0, 7.0)])
def test_both_ends_of_a_scale_can_be_given(tmp_path: Path, low: float, high: float) -> None:
    scales = [{"name": f"s{k}", "label": "Warmth", "low": low, "high": high} for k in range(2)]
    test = made(tmp_path, [{"type": "rating", "scales": scales, "listen": 0.0}])
    port = free_port()
    with served(test, port), driven(1280) as browser:
        begin(browser, port, "?quick=1")
        for slot in browser.run("return step.slots"):
            browser.run(f"sounds.play('{slot}'); sounds.stop(); return 1")
        for key, name in [("Home", "s0"), ("End", "s1")]:
            browser.run(f"document.getElementsByName('{name}')[0].focus(); return 1")
            browser.press(key)
        browser.click("#next")
        browser.until(f"{INDEX} === 1")
    (one,) = answers_of(test).listeners
    assert one.records[0]["answer"]["values"] == {"s0": low, "s1": high}
