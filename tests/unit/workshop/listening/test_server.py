from __future__ import annotations

import io
import json
import os
import re
import signal
import socket
import subprocess
import sys
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler
from pathlib import Path
from typing import Any

import listening_fakes as fakes
import numpy as np
import pytest
import soundfile
from listening_fakes import made
from scipy.signal import hilbert

from browser import CHROMIUM, answering, listening, opened
from tonewood.sound.level.loudness import loudness
from tonewood.workshop.listening import server
from tonewood.workshop.listening.answer_file import answers_of
from tonewood.workshop.listening.definition import ListeningTest
from tonewood.workshop.listening.results import analyse

pytest.importorskip("uvicorn")
pytest.importorskip("starlette")

ROOT = Path(__file__).parent
JSON = {"Content-Type": "application/json"}


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@contextmanager
def served(test: ListeningTest, port: int, *drive: str) -> Iterator[subprocess.Popen]:
    command = [sys.executable, str(ROOT / "serve_in_process.py"), str(test.folder), str(port), *drive]
    process = subprocess.Popen(command, env=os.environ | {"PYTHONPATH": os.pathsep.join([str(ROOT), *sys.path])})
    try:
        while True:
            assert process.poll() is None
            try:
                urllib.request.urlopen(f"http://127.0.0.1:{port}/", timeout=5).read()
                break
            except urllib.error.URLError:
                time.sleep(0.02)
        yield process
    finally:
        process.kill()
        process.wait()


class Client:
    """A browser in a few lines."""

    def __init__(self, port: int):
        self.root = f"http://127.0.0.1:{port}"
        self.token = ""

    def raw(self, path: str, body: bytes | None = None) -> tuple[int, bytes, dict[str, str]]:
        try:
            with urllib.request.urlopen(
                urllib.request.Request(self.root + path, data=body, headers=JSON), timeout=30
            ) as reply:
                return reply.status, reply.read(), dict(reply.headers)
        except urllib.error.HTTPError as fault:
            return fault.code, fault.read(), dict(fault.headers)

    def json(self, path: str, data: Any = None) -> Any:
        status, raw, _ = self.raw(path, None if data is None else json.dumps(data).encode())
        assert status in (200, 201), raw
        return json.loads(raw)

    def begin(self, **asked: str) -> None:
        self.token = self.json("/api/session", asked)["token"]

    def step(self) -> dict[str, Any]:
        return self.json(f"/api/session/{self.token}")

    def sound(self, step: dict[str, Any], slot: str) -> np.ndarray:
        status, raw, _ = self.raw(f"/api/session/{self.token}/sound/{step['index']}/{slot}")
        assert status == 200
        return soundfile.read(io.BytesIO(raw), always_2d=True)[0]

    def answer(self, step: dict[str, Any]) -> dict[str, Any]:
        """The last of all choices, the largest of all ratings; every sound is heard."""
        for slot in step["slots"]:
            assert len(self.sound(step, slot))
        given: dict[str, Any] = {"index": step["index"], "seconds": 1.0, "plays": dict.fromkeys(step["slots"], 2)}
        if step["choices"]:
            given["choice"] = step["choices"][-1]["value"]
        top = {"mushra": 100, "bs1116": 5}.get(step["type"])
        if top:
            given["ratings"] = {slot: top for slot in step["slots"] if slot != step["open"]}
        given |= {"agreed": True, "spl_db": 70.0, "values": {"bright": 100.0, "plays": "much"}}
        return self.json(f"/api/session/{self.token}", given)["step"]


@pytest.fixture(scope="module")
def everything(tmp_path_factory: pytest.TempPathFactory) -> ListeningTest:
    return made(tmp_path_factory.mktemp("served"), fakes.ALL)


@pytest.mark.slow
def test_a_whole_test_is_taken_through_a_kill(everything: ListeningTest) -> None:
    port = free_port()
    client = Client(port)
    with served(everything, port) as server:
        client.begin(listener="07", language="de-AT,en")
        step = client.step()
        assert step["title"] == "Einwilligung"
        assert step["content"] == ["<b>Read</b> & agree"]  # set as text by the page
        for _ in range(9):
            step = client.answer(step)
        server.send_signal(signal.SIGKILL)
        server.wait()
    with served(everything, port):
        assert client.step() == step
        kinds = set()
        while step["type"] != "done":
            kinds.add(step["type"])
            step = client.answer(step)
        assert client.step()["type"] == "done"
    assert kinds >= {"abx", "ab", "afc", "paired_comparison", "rating", "staircase", "questionnaire", "finish"}
    (one,) = [a for a in answers_of(everything).listeners if a.listener == "07"]
    assert [r["index"] for r in one.records] == list(range(len(one.records)))
    assert one.header["language"] == "de"
    found = analyse(everything.folder, screening=False)
    assert found.unfinished == ()
    assert {page.kind for page in found.pages} >= {"mushra", "staircase", "rating"}
    (questions,) = [r for r in found.table.rows if r["item"] == "plays"]
    assert questions["response"] == "much"


@pytest.mark.slow
def test_the_command_serves_this_computer_only(everything: ListeningTest) -> None:
    command = [sys.executable, "-m", "tonewood", "serve", str(everything.folder), "--port", "0"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        address = process.stdout.readline().strip()
        assert re.fullmatch(r"http://127\.0\.0\.1:\d+/", address)
        with urllib.request.urlopen(address, timeout=30) as reply:
            assert b"test.js" in reply.read()
        port = int(address.rsplit(":", 1)[1].strip("/"))
        with socket.socket() as other, pytest.raises(OSError, match="in use"):
            other.bind(("127.0.0.1", port))  # it is taken here,
        with socket.socket() as other:
            other.bind(("127.0.0.2", port))  # and nowhere else
        process.send_signal(signal.SIGINT)
        assert process.wait(timeout=30) == 0
        assert process.stderr is not None
        ended = f"tonewood: the server has ended; answers are in {everything.folder / 'answers'}"
        assert ended in process.stderr.read().splitlines()
    finally:
        process.kill()
        process.wait()


@pytest.mark.slow
def test_nothing_but_the_pages_can_be_reached(everything: ListeningTest) -> None:
    port = free_port()
    client = Client(port)
    secret = (everything.folder / "key.json").read_bytes()
    with served(everything, port):
        client.begin()
        names = ("key.json", "test.json", "manifest.json", "answers", "answers/", "stimuli/", "work/", "static/")
        places = ["", "static/", "static/..%2f", "static/%2e%2e/%2e%2e/", "api/", f"api/session/{client.token}/"]
        for place in places:
            for name in (*names, *(f"..%2f{n}" for n in names), "../key.json", "texts.json"):
                status, raw, headers = client.raw(f"/{place}{name}")
                assert status in (400, 404, 405), (place, name)
                assert secret[:200] not in raw
                assert headers["content-security-policy"].startswith("default-src 'self'")
        code = everything.trials[0].stimuli[0]
        base = f"/api/session/{client.token}"
        for path in (
            f"{base}/sound/0/{code}",
            f"{base}/sound/0/A",
            f"{base}/sound/5/A",
            f"{base}/sound/0/..%2fkey.json",
        ):
            assert client.raw(path)[0] == 404, path
        for token in ("0" * 32, "..%2fkey", "x"):
            assert client.raw(f"/api/session/{token}")[0] == 404
        for body in (b"{", b"[]", b'"x"', b"[" * 60_000, b"x" * 70_000):
            status, raw, _ = client.raw(base, body)
            assert status == 400, body[:9]
            assert b"error" in raw
        status, raw, _ = client.raw(base, json.dumps({"index": 0, "agreed": False}).encode())
        assert (status, json.loads(raw)["error"]) == (400, "agreed: the test goes on only with it")
        assert client.step()["index"] == 0


def test_an_answer_sent_twice_counts_once(everything: ListeningTest) -> None:
    port = free_port()
    client = Client(port)
    with served(everything, port):
        client.begin()
        given = {"index": 0, "agreed": True}
        first = client.json(f"/api/session/{client.token}", given)
        again = client.json(f"/api/session/{client.token}", given)
        assert first["step"] == again["step"]
        assert again["step"]["index"] == 1


def test_the_tone_is_as_loud_as_the_sounds(everything: ListeningTest) -> None:
    port = free_port()
    client = Client(port)
    with served(everything, port):
        client.begin(language="xx")
        step = client.answer(client.answer(client.step()))
        assert step["type"] == "level"
        tone = client.sound(step, "tone")
        assert loudness(tone, 48000)[0] == pytest.approx(-23.0, abs=0.1)
        spectrum = np.abs(np.fft.rfft(tone[:, 0]))
        assert np.argmax(spectrum) == 2 * 1000
        assert spectrum[2000] > 1e4 * np.median(spectrum)


@pytest.mark.slow
def test_sounds_of_a_staircase_are_of_its_level(tmp_path: Path) -> None:
    test = made(tmp_path, [fakes.STAIRS | {"reversals": 4, "longest": 7, "start": 4.0}])
    port = free_port()
    client = Client(port)
    with served(test, port):
        client.begin()
        step, level = client.step(), 4.0
        while step["type"] == "staircase":
            pitches = {}
            for slot in step["slots"]:
                sound = client.sound(step, slot)[:, 0]
                phase = np.unwrap(np.angle(hilbert(sound)))[700:3000]
                pitches[slot] = 48000 * np.polyfit(np.arange(len(phase)), phase, 1)[0] / (2 * np.pi)
            odd = max(pitches, key=lambda slot: pitches[slot])
            assert 100 * (pitches[odd] / min(pitches.values()) - 1) == pytest.approx(level, rel=0.02)
            status, raw, _ = client.raw(
                f"/api/session/{client.token}", json.dumps({"index": step["index"], "choice": odd}).encode()
            )
            assert status == 200
            reply = json.loads(raw)
            assert reply["feedback"]["right"]
            step = reply["step"]
            records = answers_of(test).listeners[0].records
            level = records[-1]["level"] / (2.0 if len(records) % 2 == 0 else 1.0)


@pytest.mark.validate
@pytest.mark.skipif(CHROMIUM is None, reason="needs Chromium")
def test_a_whole_test_is_taken_in_a_browser_through_a_kill(tmp_path: Path) -> None:
    test = made(tmp_path, fakes.ALL)
    port = free_port()

    def records() -> list[dict[str, Any]]:
        found = answers_of(test).listeners
        return found[0].records if found else []

    address = f"http://127.0.0.1:{port}/?listener=script&quick=1"
    with served(test, port, "drive") as server, opened(address, tmp_path / "profile"):
        while len(records()) < 8:
            time.sleep(0.05)
        server.send_signal(signal.SIGKILL)
        server.wait()
        before = records()
        with served(test, port, "drive"):
            ends = time.monotonic() + 300
            while not records() or records()[-1]["type"] != "finish":
                assert time.monotonic() < ends, records()[-1:]
                time.sleep(0.1)
    (one,) = answers_of(test).listeners
    assert one.records[: len(before)] == before
    assert [r["index"] for r in one.records] == list(range(len(one.records)))
    heard = [r for r in one.records if r["slots"]]
    assert all(min(r["answer"]["plays"].values()) >= 1 for r in heard)
    assert analyse(test.folder, screening=False).unfinished == ()


@contextmanager
def cut_off(port: int) -> Iterator[tuple[int, set[str]]]:
    """A relay of a port that breaks each sound off half-way the first time: its port, and the addresses broken off."""
    cut: set[str] = set()

    class Relay(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.pass_on(None)

        def do_POST(self) -> None:
            self.pass_on(self.rfile.read(int(self.headers["Content-Length"])))

        def pass_on(self, body: bytes | None) -> None:
            status, data, headers = Client(port).raw(self.path, body)
            self.send_response(status)
            for name in ("content-type", "content-security-policy"):
                if name in headers:
                    self.send_header(name, headers[name])
            self.send_header("Content-Length", str(len(data)))
            self.end_headers()
            whole = "/sound/" not in self.path or self.path in cut
            self.wfile.write(data if whole else data[: len(data) // 2])
            if not whole:
                cut.add(self.path)

        def log_message(self, format: str, *args: object) -> None:
            """Says nothing."""

    with answering(Relay) as relayed:
        yield relayed, cut


@pytest.mark.validate
@pytest.mark.skipif(CHROMIUM is None, reason="needs Chromium")
def test_a_sound_that_breaks_off_is_asked_for_again(tmp_path: Path) -> None:
    test = made(tmp_path, [{"type": "abx", "pairs": {"damping": ["complex", "block"]}}])
    port = free_port()

    def finished() -> bool:
        found = answers_of(test).listeners
        return bool(found) and [r["type"] for r in found[0].records[-1:]] == ["finish"]

    with (
        served(test, port, "drive"),
        cut_off(port) as (relayed, cut),
        opened(f"http://127.0.0.1:{relayed}/?listener=script&quick=1", tmp_path / "profile"),
    ):
        ends = time.monotonic() + 120
        while not finished():
            assert time.monotonic() < ends, answers_of(test)
            time.sleep(0.1)
    assert len(cut) >= 3


def said(test: ListeningTest, count: int) -> list[Any]:
    """The words that a page's script reported, when there are so many."""
    path, ends = test.folder / "said", time.monotonic() + 120
    while True:
        words = [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []
        if len(words) >= count:
            return words
        assert time.monotonic() < ends, words
        time.sleep(0.1)


@pytest.mark.validate
@pytest.mark.skipif(CHROMIUM is None, reason="needs Chromium")
def test_the_address_decides_whose_session_it_is(tmp_path: Path) -> None:
    test = made(tmp_path, [{"type": "instructions"}, {"type": "instructions", "name": "second"}, {"type": "html"}])
    port = free_port()
    with served(test, port, "listeners"), opened(f"http://127.0.0.1:{port}/?listener=P01", tmp_path / "profile"):
        *words, _ = said(test, 9)
    assert [(w["act"], w["name"], w["kept"], w["done"]) for w in words] == [
        ("start", "P01", False, False), ("look", "P02", False, False), ("look", "P01", True, False),
        ("look", "", False, False), ("other", "P01", True, False), ("look", "P01", True, False),
        ("finish", "P03", False, False), ("look", None, False, True),
    ]  # fmt: skip
    assert words[4]["after"] == {"address": "", "name": ""}
    assert words[6]["offers"]
    assert sorted(a.listener for a in answers_of(test).listeners if a.records) == ["P03"]


@pytest.mark.validate
@pytest.mark.skipif(CHROMIUM is None, reason="needs Chromium")
@pytest.mark.parametrize("blocked", [True, False])
def test_a_test_is_taken_where_the_browser_keeps_nothing(tmp_path: Path, blocked: bool) -> None:
    """With site data blocked, as a user may set it, the script's access to the store is an error."""
    test = made(tmp_path, [{"type": "instructions"}, {"type": "instructions", "name": "second"}, {"type": "html"}])
    port, profile = free_port(), tmp_path / "profile"
    settings = {"profile": {"default_content_setting_values": {"cookies": 2 if blocked else 1}}}
    (profile / "Default").mkdir(parents=True)
    (profile / "Default" / "Preferences").write_text(json.dumps(settings))
    with served(test, port, "blocked"), opened(f"http://127.0.0.1:{port}/?listener=P01", profile):
        begun, ended = said(test, 2)
    assert begun == {"fault": "SecurityError" if blocked else ""}
    assert ended == {"words": "", "offers": True}
    (one,) = answers_of(test).listeners
    assert (one.listener, one.records[-1]["type"]) == ("P01", "finish")


@pytest.mark.validate
@pytest.mark.skipif(CHROMIUM is None, reason="needs Chromium")
def test_a_page_whose_sound_cannot_be_made_stops_in_words(tmp_path: Path) -> None:
    test = made(tmp_path, [fakes.STAIRS])
    port = free_port()
    with served(test, port, "stopped"), opened(f"http://127.0.0.1:{port}/?language=en", tmp_path / "profile"):
        (words,) = said(test, 1)
    assert "The test cannot go on" in words
    assert "A sound of this page cannot be made." in words
    assert "Try again" in words


FADE = """
<script src="players.js"></script>
<script>
const tell = words => { new Image().src = "http://127.0.0.1:%d/" + encodeURIComponent(words); };
(async () => {
  const fs = 48000, stops = 0.25, found = {};
  for (const act of ["stop", "halt", "sequence"]) {
    const context = new OfflineAudioContext(1, fs, fs);
    const resume = context.resume.bind(context);
    context.resume = () => {};
    const buffer = context.createBuffer(1, fs, fs), sine = buffer.getChannelData(0);
    for (let i = 0; i < fs; i++) sine[i] = 0.5 * Math.sin(2 * Math.PI * 440 * i / fs + 0.3);
    const sounds = new Sounds(context, { A: buffer, B: buffer });
    if (act === "sequence") sounds.sequence(["A", "B"]); else sounds.start("A");
    context.suspend(stops).then(() => { if (act === "halt") sounds.halt(); else sounds.stop(); resume(); });
    const heard = (await context.startRendering()).getChannelData(0);
    const at = Math.round(stops * fs), last = heard.findLastIndex(v => v !== 0);
    let step = 0;
    for (let i = at - 100; i < fs; i++) step = Math.max(step, Math.abs(heard[i] - heard[i - 1]));
    found[act] = { step, lasts: (last - at) / fs, before: Math.max(...heard.slice(at - 200, at)) };
  }
  tell(JSON.stringify(found));
})().catch(fault => tell("fault: " + fault));
</script>
"""


@pytest.mark.validate
@pytest.mark.skipif(CHROMIUM is None, reason="needs Chromium")
def test_a_sound_that_is_stopped_fades(tmp_path: Path) -> None:
    players = Path(server.__file__).with_name("static") / "players.js"
    (tmp_path / "players.js").write_text(players.read_text())
    page = tmp_path / "fade.html"
    with listening() as (port, reported):
        page.write_text(FADE % port)
        with opened(page, tmp_path / "profile"):
            found = json.loads(reported.get(timeout=60))
    for name, act in found.items():
        assert act["before"] == pytest.approx(0.5, rel=1e-3)  # it was loud
        # no step is larger than the sine's own, 0.5 sin(2 pi 440 / fs), and that of the ramp over 20 ms
        assert act["step"] < 0.5 * 2 * np.pi * 440 / 48000 + 0.5 / (0.02 * 48000), name
        assert 0.005 < act["lasts"] < 0.05
