"""The desk over HTTP: what is refused, what is heard, what is said when something goes wrong."""

from __future__ import annotations

import asyncio
import json
import re
import signal
import struct
import subprocess
import sys
import time
import urllib.request
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

pytest.importorskip("starlette")
pytest.importorskip("uvicorn")

import tonewood as tw
import tonewood.authoring as ta
from tonewood.errors import BundleError
from tonewood.sound.render.options import RenderOptions
from tonewood.workshop.desk import models
from tonewood.workshop.desk.ahead import Ahead
from tonewood.workshop.desk.desk import TAIL, Desk
from tonewood.workshop.desk.phrase import LONGEST
from tonewood.workshop.desk.server import DeskServer
from tonewood.workshop.desk.session import DeskSession
from tonewood.workshop.desk.take import PhraseTake, Ringing

HOST = (b"host", b"127.0.0.1:8137")


class Client:
    """Requests to an application in this process."""

    def __init__(self, server: DeskServer):
        self.server, self.application = server, server.application()

    def ask(
        self, path: str, body: Any = None, *, token: str | None = "", headers: tuple[tuple[bytes, bytes], ...] = (HOST,)
    ) -> tuple[int, Any]:
        """Status, and the reply as JSON or bytes."""
        token = self.server.token if token == "" else token
        given = [*headers, (b"content-type", b"application/json")]
        given += [] if token is None else [(b"x-desk-token", token.encode())]
        path, _, query = path.partition("?")
        scope = {
            "type": "http", "method": "GET" if body is None else "POST", "path": path, "raw_path": path.encode(),
            "query_string": query.encode(), "headers": given, "http_version": "1.1", "scheme": "http",
            "server": ("127.0.0.1", 8137), "client": ("127.0.0.1", 1),
        }  # fmt: skip
        raw = body if isinstance(body, bytes) else json.dumps(body).encode()
        sent: list[dict[str, Any]] = []

        async def receive() -> dict[str, Any]:
            return {"type": "http.request", "body": b"" if body is None else raw, "more_body": False}

        async def send(message: dict[str, Any]) -> None:
            sent.append(message)

        asyncio.run(self.application(scope, receive, send))
        content = b"".join(m.get("body", b"") for m in sent)
        kind = dict(sent[0]["headers"]).get(b"content-type", b"")
        return sent[0]["status"], json.loads(content) if kind == b"application/json" else content

    def act(self, name: str, /, **values: Any) -> dict[str, Any]:
        status, reply = self.ask("/api/act", {"act": name, **values})
        assert status == 200, reply
        return reply


def until(true: Callable[[], Any], seconds: float = 120.0) -> Any:
    ends = time.monotonic() + seconds
    while not (found := true()):
        assert time.monotonic() < ends
        time.sleep(0.01)
    return found


@pytest.fixture
def desk() -> Iterator[Desk]:
    made = Desk(DeskSession("monochord"))
    until(lambda: made.playback.take)
    yield made
    made.close()


@pytest.fixture
def client(desk: Desk) -> Client:
    return Client(DeskServer(desk))


def heard(desk: Desk, frames: int) -> np.ndarray[Any, np.dtype[np.float32]]:
    return np.concatenate([desk.playback.read(512)[0] for _ in range(-(-frames // 512))])[:frames]


def offline(desk: Desk, session: DeskSession) -> np.ndarray[Any, np.dtype[np.float32]]:
    """The render of a command line, in single precision."""
    options = RenderOptions(fs=48000, tail=TAIL, max_duration=LONGEST, gain_db=desk.state()["gain_db"])
    found = tw.render(desk.phrase.file, session.instrument, options=options).samples
    return np.stack([found[:, 0], found[:, -1]], axis=1).astype(np.float32)


@pytest.mark.parametrize("path", ["/api/state", "/api/stream", "/api/view/mobility", "/api/knobs/body", "/api/act"])
@pytest.mark.parametrize("token", [None, "wrong", "\N{SNOWMAN}"])
def test_without_the_token_nothing_is_given(client: Client, path: str, token: str | None) -> None:
    status, reply = client.ask(path, {"act": "undo"} if path == "/api/act" else None, token=token)
    assert status == 403
    assert "token" in reply["error"]


def test_other_hosts_and_pages_are_refused(client: Client) -> None:
    assert client.ask("/api/state", headers=((b"host", b"evil.example"),))[0] == 421
    assert client.ask("/api/state", headers=(HOST, (b"origin", b"http://evil.example")))[0] == 403
    assert client.ask("/api/state", headers=(HOST, (b"origin", b"http://127.0.0.1:8137")))[0] == 200
    assert client.ask("/static/..%2fserver.py")[0] == 404
    assert b"desk.js" in client.ask("/", token=None)[1]


@pytest.mark.parametrize(
    ("body", "said"),
    [
        (b"[]", "JSON object"),
        (b"x" * 70_000, "bytes"),
        (b"{", "JSON"),
        ({"act": "explode"}, "are allowed"),
        ({"act": ["set"]}, "are allowed"),
        ({"act": "set"}, "missing"),
        ({"act": "set", "path": "strings.A2.tension", "value": -5}, "strings.A2.tension"),
        ({"act": "set", "path": "strings.A2.tension", "value": 1e99}, "strings.A2.tension"),
        ({"act": "set", "path": "exciters.pluck.from_bridge", "value": 99}, "from_bridge"),
        ({"act": "set", "path": "nothing.here", "value": 1}, "nothing"),
        ({"act": "save", "folder": "/proc/desk"}, "cannot be made"),
        ({"act": "save", "folder": "x" * 5000}, "cannot be made: File name too long"),
        ({"act": "save", "folder": "~nobody_of_this_name/x"}, "folder: cannot be made: "),
        ({"act": "phrase", "kind": "notes", "notes": "H9"}, "H9"),
        ({"act": "phrase", "kind": "notes", "notes": "C0"}, "C0"),
        ({"act": "phrase", "kind": "file"}, "--phrase"),
        ({"act": "phrase", "kind": "chord", "velocity": 300}, "velocity"),
        ({"act": "key", "note": 1e9, "on": True}, "note"),
        ({"act": "key", "note": 10**400, "on": True}, "key"),
        ({"act": "phrase", "kind": "notes", "notes": "A2", "velocity": 10**400}, "phrase"),
        (b'{"act": "pick", "which": 1e400}', "pick"),
        ({"act": "strings", "name": "no_set"}, "no_set"),
        ({"act": "recall", "name": "never kept"}, "never kept"),
    ],
)
def test_what_cannot_be_done_is_said_in_one_line(client: Client, desk: Desk, body: Any, said: str) -> None:
    before = desk.state()
    status, reply = client.ask("/api/act", body)
    assert status == 400
    assert said in reply["error"]
    assert "\n" not in reply["error"]
    after = desk.state()
    assert {k: v for k, v in after.items() if k != "making"} == {k: v for k, v in before.items() if k != "making"}


@pytest.mark.parametrize("number", [10**400, 1e300, -(10**400)])
def test_numbers_of_a_report_that_no_page_sends_are_left_out(client: Client, desk: Desk, number: float) -> None:
    listener = desk.playback.listen(10.0)
    assert client.ask("/api/heard", {"stream": 0, "heard": number, "underruns": number}) == (200, {"stream": 0})
    assert listener.unheard >= 0
    assert desk.playback.meter.underruns == 0


def test_the_phrase_is_the_render_again_and_again(client: Client, desk: Desk) -> None:
    client.act("play", on=True)
    wanted = offline(desk, desk.session)
    assert np.array_equal(heard(desk, 2 * len(wanted)), np.concatenate([wanted, wanted]))


def test_another_model_is_heard_from_its_beginning(client: Client, desk: Desk) -> None:
    client.act("play", on=True)
    heard(desk, 9600)
    serial = client.act("set", path="strings.A2.linear_density", value=5e-3)["serial"]
    until(lambda: desk.playback.serial == serial)
    wanted = offline(desk, desk.session)
    found = heard(desk, len(wanted))
    fade = 1440
    assert np.array_equal(found[fade:], wanted[fade:])
    assert not np.array_equal(found[:fade], wanted[:fade])  # the one before fades


def test_hands_are_heard_while_the_string_rings_on(client: Client, desk: Desk) -> None:
    client.act("phrase", kind="notes", notes="A2 A2 A2", velocity=80)
    client.act("play", on=True, loop=True)
    before = offline(desk, desk.session)
    first = heard(desk, 4608)
    assert np.array_equal(first, before[:4608])
    reply = client.act("set", path="exciters.pluck.from_bridge", value=0.05)
    after = offline(desk, desk.session)
    rest = heard(desk, len(before) - 4608)
    assert desk.playback.serial == reply["serial"]
    # up to the second note nothing has changed; then the string, not yet at rest, is plucked elsewhere
    assert np.array_equal(rest[:4608], before[4608:9216])
    assert not np.allclose(rest[12000:], before[16608:], atol=1e-4)
    desk.playback.start()
    heard(desk, 1536)  # the one before fades
    assert np.array_equal(heard(desk, 20000), after[1536:21536])


def test_a_and_b_are_switched_without_a_gap_at_one_loudness(client: Client, desk: Desk) -> None:
    from tonewood.sound.level.loudness import BLOCK, loudest

    client.act("set", path="exciters.pluck.force", value=1.0)
    client.act("set", path="playing.velocity.high", value=30.0)
    until(lambda: desk.state()["making"] is None)
    client.act("compare", name="")
    pair = until(lambda: desk.playback.pair)
    levels = [loudest(t.sound().astype(float) * g, 48000, BLOCK) for t, g in zip(pair.takes, pair.gains, strict=True)]
    assert levels[0] == pytest.approx(levels[1], abs=1e-3)
    assert max(pair.gains) == 1.0
    client.act("play", on=True)
    heard(desk, 4608)
    at = desk.playback.at
    client.act("pick", which=1)
    found = heard(desk, 4608)
    a, b = (t.sound() * np.float32(g) for t, g in zip(pair.takes, pair.gains, strict=True))
    assert np.allclose(found[1536:], b[at + 1536 : at + 4608], atol=1e-6)
    step = np.abs(np.diff(np.concatenate([a[at - 1 : at], found])[:, 0])).max()
    assert step <= 1.1 * max(np.abs(np.diff(a[:, 0])).max(), np.abs(np.diff(b[:, 0])).max())
    assert client.act("compare", name=None)["pair"] is None


@pytest.mark.slow
def test_a_blind_comparison_tells_no_names_until_it_is_revealed(client: Client, desk: Desk) -> None:
    client.act("set", path="playing.velocity.high", value=30.0)
    orders = set()
    for _ in range(20):
        client.act("compare", name="", blind=True)
        pair = until(lambda: desk.playback.pair)
        state = desk.state()
        assert state["pair"]["names"] == ["X", "Y"]
        assert state["compared"] == ""
        orders.add(pair.order)
        assert "this design" in "".join(client.act("reveal")["pair"]["names"])
        client.act("compare", name=None)
    assert orders == {(0, 1), (1, 0)}


def test_keys_are_played_on_the_design(client: Client, desk: Desk) -> None:
    client.act("key", note="A2", on=True)
    assert np.abs(heard(desk, 9600)).max() > 1e-4
    assert desk.state()["dropped"] == []
    client.act("key", note=20, on=True)
    heard(desk, 2048)
    assert desk.state()["dropped"] != []
    client.act("key", note="A2", on=False)
    client.act("set", path="strings.A2.linear_density", value=5e-3)
    until(lambda: desk.state()["making"] is None)
    client.act("key", note="A2", on=True)
    assert np.abs(heard(desk, 9600)).max() > 1e-4


def test_a_model_that_cannot_be_made_is_said_and_the_sound_stays(
    client: Client, desk: Desk, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: Any) -> Any:
        raise BundleError("is too hard", key="body")

    take = desk.playback.take
    monkeypatch.setattr(models, "assembled", refuse)
    client.act("set", path="strings.A2.linear_density", value=5e-3)
    until(lambda: desk.state()["fault"])
    assert "too hard" in desk.state()["fault"]
    assert desk.playback.take is take
    monkeypatch.undo()
    assert client.act("undo")["fault"] == ""


@pytest.mark.slow
def test_a_slow_model_is_told_and_those_in_between_are_passed_over(
    client: Client, desk: Desk, monkeypatch: pytest.MonkeyPatch
) -> None:
    made, real = [], models.assembled

    def slow(instrument: Any, options: Any) -> Any:
        time.sleep(0.3)
        made.append(instrument.resolved["strings"]["A2"]["linear_density"])
        return real(instrument, options)

    monkeypatch.setattr(models, "assembled", slow)
    for i in range(10):
        reply = client.act("set", path="strings.A2.linear_density", value=(4.0 + 0.1 * i) * 1e-3, dragging=True)
    assert reply["making"] is not None
    until(lambda: desk.state()["making"] is None)
    assert len(made) <= 3
    assert made[-1] == pytest.approx(4.9e-3)
    assert desk.playback.serial == reply["serial"]


def test_a_preview_is_named_until_the_exact_sound_follows(monkeypatch: pytest.MonkeyPatch) -> None:
    plain = tw.load_instrument("monochord")
    monkeypatch.setattr(type(plain.body), "preview", {"freq_scale": 1.0})
    assert models.previewed(plain, plain) is None
    coarse = models.previewed(tw.load_instrument("drawn_guitar"), None)
    assert coarse is not None
    assert coarse[0].resolved["body"]["fmax"] == 1000.0
    assert "preview" in coarse[1]
    assert "fmax 1000" in coarse[1]


def test_undoing_a_preview_brings_the_start_back(client: Client, desk: Desk, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(type(desk.session.instrument.body), "preview", {"max_change": 0.09})
    monkeypatch.setattr("tonewood.workshop.desk.making._REST", 1e6)
    client.act("set", path="body.added", value=[{"at": "bridge", "mass": 0.02}])
    until(lambda: desk.state()["preview"])
    client.act("undo")
    until(lambda: not desk.state()["preview"])
    client.act("play", on=True)
    assert np.array_equal(heard(desk, 9600), offline(desk, desk.session)[:9600])


@pytest.mark.slow
def test_the_exact_model_follows_from_a_process_of_its_own(
    client: Client, desk: Desk, monkeypatch: pytest.MonkeyPatch, tmp_path: Any
) -> None:
    monkeypatch.setenv("TONEWOOD_CACHE", str(tmp_path))
    monkeypatch.setattr(type(desk.session.instrument.body), "preview", {"max_change": 0.09})
    monkeypatch.setattr("tonewood.workshop.desk.making._REST", 0.0)
    client.act("set", path="body.added", value=[{"at": "bridge", "mass": 0.02}])
    until(lambda: desk.state()["preview"])
    until(lambda: not desk.state()["preview"])
    assert desk.state()["making"] is None
    assert list(tmp_path.rglob("*")) != []
    client.act("play", on=True)
    assert np.array_equal(heard(desk, 9600), offline(desk, desk.session)[:9600])


def test_a_design_that_is_turned_away_from_is_not_made(desk: Desk, monkeypatch: pytest.MonkeyPatch) -> None:
    begun, called = Ahead("monochord", 48000, allow_code=False), []
    monkeypatch.delenv("TONEWOOD_CACHE", raising=False)
    begun.make(desk.session.design, lambda: called.append(1))
    process = begun._process
    assert process is not None
    begun.make(desk.session.design, lambda: called.append(2))
    assert begun._process is process
    desk.session.set("body.added", [{"at": "bridge", "mass": 0.02}])
    begun.turn_to(desk.session.design)
    assert process.wait(60) != 0
    time.sleep(0.1)
    assert called == []


def test_what_differs_is_not_told_of_a_coarse_preview(desk: Desk, monkeypatch: pytest.MonkeyPatch) -> None:
    assert desk.view("differences") == []
    coarse = ta.assemble(tw.load_instrument("monochord"), 48000)
    monkeypatch.setattr(Desk, "_seen", property(lambda self: coarse))
    assert "preview" in desk.view("differences")[0]


def test_the_stream_goes_to_the_newest_page_and_ends_with_it(client: Client, desk: Desk) -> None:
    server = client.server

    async def listened() -> tuple[list[bytes], list[bytes]]:
        desk.playback.start()
        first, second = [], []
        server._stream = 1
        async for block in server._blocks(1):
            first.append(block)
            if len(first) == 5:
                server._stream = 2
        async for block in server._blocks(2):
            second.append(block)
            if len(second) == 3:
                server.closing = True
        return first, second

    first, second = asyncio.run(listened())
    assert (len(first), len(second)) == (5, 3)
    frames, _, at, playing, place = struct.unpack("<5I", first[1][:20])
    assert (frames, at, playing, place) == (512, 512, 1, 512)
    got = np.concatenate([np.frombuffer(b[20:], dtype="<f4").reshape(-1, 2) for b in first + second])
    assert np.array_equal(got, offline(desk, desk.session)[: len(got)])


class Page:
    """A page that has `ahead` frames before it: it hears what was sent last for each place."""

    def __init__(self, desk: Desk, ahead: int):
        self.playback, self.ahead, self.heard = desk.playback, ahead, 0
        self.listener = desk.playback.listen(0.0)
        self.sound = np.zeros((0, 2), dtype=np.float32)

    def hear(self, frames: int) -> np.ndarray[Any, np.dtype[np.float32]]:
        self.heard += frames
        while self.listener.sent < self.heard + self.ahead:
            block, what = self.playback.read(512)
            assert what["place"] <= len(self.sound)
            self.sound = np.concatenate([self.sound[: max(what["place"], self.heard - frames)], block])
        self.listener.report(self.heard)
        return self.sound[self.heard - frames : self.heard]


def test_a_change_is_heard_before_sound_that_was_sent(
    desk: Desk, client: Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tonewood.workshop.desk.playback._TRUSTED", 0.0)
    client.act("phrase", kind="scale")
    page, before = Page(desk, 24000), offline(desk, desk.session)
    client.act("play", on=True)
    assert np.array_equal(page.hear(9600), before[:9600])
    client.act("set", path="exciters.pluck.from_bridge", value=0.2)
    found = page.hear(24000)
    same = (found == before[9600:33600]).all(axis=1)
    assert same[:1920].all()  # on its way to the page
    assert not same[16000:].any()  # the note at 0.5 s is plucked anew; all this had been sent
    client.act("set", path="strings.A2.linear_density", value=5e-3)
    until(lambda: desk.state()["making"] is None)
    begun, after = page.hear(20000), offline(desk, desk.session)
    start = 1920
    assert np.array_equal(begun[start + 1440 : start + 12000], after[1440:12000])


def test_keys_ring_on_while_a_phrase_is_sent_again(desk: Desk, client: Client, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tonewood.workshop.desk.playback._TRUSTED", 0.0)

    def keys(*, again: bool) -> np.ndarray[Any, np.dtype[np.float32]]:
        """Sound of a key beside the phrase, from 1440 frames after 4800 on, where the phrase may begin again."""
        desk.playback.stop()
        desk.playback.exchange_live(None)
        heard(desk, 4096)
        page = Page(desk, 9600)
        client.act("play", on=True)
        client.act("key", note="A2", on=True)
        page.hear(4800)
        if again:
            desk.playback.start()
        first = 0 if again else 4800 + 1920
        return page.hear(9600)[1920 + 1440 :] - desk.playback.take.sound()[first + 1440 : first + 7680]  # type: ignore[union-attr]

    plain = keys(again=False)
    assert np.abs(plain).max() > 1e-3
    assert np.allclose(keys(again=True), plain, atol=1e-6)


def test_a_page_that_hears_nothing_any_more_gets_nothing_any_more(
    client: Client, desk: Desk, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tonewood.workshop.desk.server._SILENT", 0.4)

    async def listened() -> int:
        desk.playback.start()
        client.server._stream = 1
        return len([block async for block in client.server._blocks(1)])

    assert asyncio.run(listened()) * 512 < 48000


def test_a_page_reports_what_it_hears_and_how_far_ahead_it_wants_to_be(client: Client, desk: Desk) -> None:
    server, listener = client.server, desk.playback.listen(5.0)
    server._stream = 3
    report = {"stream": 3, "heard": 512, "ahead": 0.5, "underruns": 2, "state": "no number"}
    assert client.ask("/api/heard", report) == (200, {"stream": 3})
    assert (listener._heard, server._ahead, desk.playback.meter.underruns) == (512, 0.5, 2)
    for asked, ahead in ((0.001, 0.03), (7.0, 1.0)):
        client.ask("/api/heard", report | {"ahead": asked})
        assert server._ahead == ahead
    client.ask("/api/heard", {"stream": 3})
    assert (listener._heard, server._ahead, desk.playback.meter.underruns) == (0, 1.0, 0)
    client.ask("/api/heard", report | {"stream": 2})  # of another page
    assert listener._heard == 0


def test_moments_are_those_after_a_frame_up_to_now(client: Client, desk: Desk, monkeypatch: pytest.MonkeyPatch) -> None:
    """Frames of moments are multiples of 2048; a sound of 3 W gives 3 * 2048 / 48000 J between two of them."""
    take = desk.playback.take
    assert take is not None
    fresh = PhraseTake(take.score, take.model, take.options, {})
    monkeypatch.setattr("tonewood.workshop.desk.take.stored", lambda engine, at: Ringing(at, {"A2": 1.0}, 2.0, 3.0))
    fresh.ensure(20000)
    assert [m.frame for m in fresh.moments] == [2048 * k for k in range(1, 11)]
    np.testing.assert_allclose([m.sound for m in fresh.moments], 3.0 * 2048 / 48000 * np.arange(1, 11))
    desk.playback.take, desk.playback.at = fresh, 4096
    for query, frames in (("", [2048, 4096, 6144, 8192]), ("?since=4096", [6144, 8192]), ("?since=-1", [2048])):
        found = client.ask(f"/api/moments{query}")[1]
        assert [m["frame"] for m in found["moments"]][: len(frames)] == frames
        assert len(found["moments"]) == (4 if query != "?since=4096" else 2)
    assert (found["frame"], found["seconds"]) == (4096, fresh.frames / 48000)
    assert found["effects"][0]["title"] == f"{take.model.n_modes} modes"
    assert found["effects"][0]["active"] == {"": fresh.frames / 48000}


def test_the_phrase_has_a_peak_of_4_db_below_full_scale(client: Client, desk: Desk) -> None:
    assert desk.playback.take is not None
    assert 20 * np.log10(np.abs(desk.playback.take.sound()).max()) == pytest.approx(-4.0, abs=0.06)
    client.act("phrase", kind="notes", notes="A2", velocity=1)
    assert 20 * np.log10(np.abs(desk.playback.take.sound()).max()) == pytest.approx(-4.0, abs=0.06)


def test_the_state_is_that_of_the_session(client: Client, desk: Desk) -> None:
    take = desk.playback.take
    assert take is not None
    begun = client.ask("/api/state")[1]
    expected = {
        "name": "monochord", "serial": 0, "heard": 0, "changes": [], "added": [], "undo": False, "redo": False,
        "snapshots": [], "making": None, "preview": "", "fault": "", "modes": take.model.n_modes,
        "channels": list(take.renderer.channels), "dropped": [], "playing": False, "loop": True,
        "phrase": {"kind": "chord", "notes": "", "velocity": 80}, "fs": 48000, "has_file": False, "compared": "",
        "pair": None, "gain_db": take.options.gain_db,
    }  # fmt: skip
    assert {key: begun[key] for key in expected} == expected
    assert f"--gain={begun['gain_db']:g} --tail=3" in begun["command"]
    client.act("set", path="exciters.pluck.force", value=1.5)
    client.act("keep", name="soft")
    client.act("set", path="exciters.pluck.force", value=2.5)
    after = client.act("undo")
    assert (after["undo"], after["redo"], after["serial"], after["heard"]) == (True, True, 3, 3)
    assert after["changes"] == [{"path": "exciters.pluck.force", "value": 1.5}]
    assert after["snapshots"] == [{"name": "soft", "changes": ["exciters.pluck.force=1.5"]}]
    assert client.act("loop", on=False)["loop"] is False
    assert client.act("play")["playing"] is True
    assert client.act("play", on=False, loop=True)["playing"] is False
    assert desk.playback.loop is True
    assert client.ask("/api/points")[1] == ["bridge"]
    assert client.act("forget", name="soft")["snapshots"] == []
    assert client.ask("/static/desk.css")[0] == 200
    assert client.ask("/static/desk.html")[0] == 404


@pytest.mark.validate
def test_memory_is_flat_over_a_thousand_changes(client: Client, desk: Desk) -> None:
    import resource

    def turn(times: int) -> float:
        for i in range(times):
            client.act("set", path="exciters.pluck.from_bridge", value=0.05 + 1e-4 * (i % 500))
            if i % 10 == 0:
                client.act("set", path="strings.A2.linear_density", value=(4.0 + 1e-3 * (i % 700)) * 1e-3)
                until(lambda: desk.state()["making"] is None)
                desk.view("mobility")
            desk.playback.read(512)
        with open("/proc/self/statm", encoding="ascii") as file:
            return int(file.read().split()[1]) * resource.getpagesize() / 1e6

    client.act("play", on=True)
    before = turn(300)
    after = turn(1000)
    assert after - before < 40.0


def test_views_are_given_and_unknown_ones_refused(client: Client, desk: Desk) -> None:
    assert client.ask("/api/view/mobility")[1]["n_modes"] == desk.view("mobility")["n_modes"]
    assert client.ask("/api/view/drawing") == (200, None)
    assert client.ask("/api/view/secrets")[0] == 400
    assert client.ask("/api/view/shape?argument=x")[0] == 400
    assert client.ask("/api/view/force?argument=Z9")[0] == 400
    assert client.ask("/api/knobs/none.such") == (200, [])
    assert client.ask("/api/knobs/stops")[1][1]["value"] == 24
    assert client.ask("/api/groups")[1][0] == "exciters.pluck"
    assert "bridge" in client.ask("/api/points")[1]
    force = np.array(client.ask("/api/view/force?argument=A2")[1]["force"])
    assert np.abs(force).max() > 0.0
    rings = desk.playback.moments(0)
    assert set(rings) >= {"moments", "effects", "load"}


@pytest.mark.slow
def test_a_design_is_found_beside_the_sound_and_taken(client: Client, desk: Desk) -> None:
    client.act("set", path="body.added", value=[{"at": "bridge", "mass": 0.01}])
    offered = client.ask("/api/state")[1]["advice"]["offered"]
    assert offered == "body.added.0.mass: 0 .. 0.05"
    advice = client.act("advise", targets="mode 1 = 180\n", free=offered)["advice"]
    assert advice["seconds"] is not None
    assert advice["command"].startswith("tonewood design monochord --set 'body.added=[")
    assert client.ask("/api/act", {"act": "advise", "targets": "T1 = 1", "free": offered})[0] == 400
    found = until(lambda: (a := client.ask("/api/state")[1]["advice"])["seconds"] is None and a)
    assert found["fault"] == ""
    assert any("mode 1 = 180" in line and "reached" in line for line in found["lines"])
    state = client.act("advise_take")
    mass = state["changes"][-1]
    assert mass["path"] == "body.added.0.mass"
    until(lambda: client.ask("/api/state")[1]["heard"] == state["serial"])
    assert mass["value"] == found["found"]["body.added.0.mass"] != 0.01
    assert client.act("undo")["changes"] == [{"path": "body.added", "value": [{"at": "bridge", "mass": 0.01}]}]


@pytest.mark.parametrize(
    ("targets", "free", "reason"),
    [
        ("", "body.added.0.mass: 0 .. 1", "there are 0; 1 to 40"),
        ("T2 = 100", "body.added.0.mass: 0 .. 1", "is no target"),
        ("mode 1 = 180", "body.added.0.mass 0 .. 1", r"PATH: LOW \.\. HIGH is allowed"),
        ("mode 1 = 180", "body.depth: 0 .. 1", "leads to no number"),
    ],
)
def test_wrong_lines_of_a_search_are_one_line(client: Client, targets: str, free: str, reason: str) -> None:
    client.act("set", path="body.added", value=[{"at": "bridge", "mass": 0.01}])
    status, reply = client.ask("/api/act", {"act": "advise", "targets": targets, "free": free})
    assert status == 400
    assert re.search(reason, reply["error"])
    assert client.ask("/api/act", {"act": "advise_take"}) == (
        400,
        {"error": "take: there is no design yet: look for one first"},
    )


def test_a_search_is_stopped(client: Client, desk: Desk) -> None:
    client.act("set", path="body.added", value=[{"at": "bridge", "mass": 0.01}])
    client.act("advise", targets="mode 1 = 180", free="body.added.0.mass: 0 .. 0.05")
    process = desk.adviser._process
    advice = client.act("advise_stop")["advice"]
    assert (advice["seconds"], advice["fault"], advice["found"]) == (None, "stopped", {})
    assert process is not None
    assert process.wait(20) != 0


@pytest.mark.slow
@pytest.mark.parametrize("name", [signal.SIGINT, signal.SIGTERM])
def test_a_desk_that_is_ended_while_a_page_hears_it_says_so_in_one_line(name: signal.Signals) -> None:
    command = [sys.executable, "-m", "tonewood", "desk", "monochord", "--port", "0"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        address, _, token = process.stdout.readline().strip().partition("#")
        asked = urllib.request.Request(f"{address}api/stream", headers={"X-Desk-Token": token})
        with urllib.request.urlopen(asked, timeout=60) as stream:
            assert len(stream.read(20)) == 20
            process.send_signal(name)
            said = process.communicate(timeout=60)[1]
    assert "Traceback" not in said
    assert said.count("\n") <= 1
