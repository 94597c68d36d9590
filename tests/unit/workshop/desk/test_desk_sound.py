"""Sound that a take has given, blocks for the page, drawings, and acts that are refused: worked out by hand."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import tonewood as tw
from tonewood.errors import ScoreError, TonewoodError
from tonewood.sound.render.options import RenderOptions
from tonewood.workshop.desk import views
from tonewood.workshop.desk.advice import Adviser
from tonewood.workshop.desk.desk import Desk
from tonewood.workshop.desk.knobs import _many, _under, groups, knobs, shown
from tonewood.workshop.desk.playback import DeskSound, PageProgress, _stereo
from tonewood.workshop.desk.server import BLOCK, DeskServer
from tonewood.workshop.desk.session import DeskSession
from tonewood.workshop.desk.take import LeveledTakes, PhraseTake, Ringing


class Tone:
    """A renderer of two channels, 1 and 2, without end; its engine gives 3 W of sound."""

    def __init__(self, *given: Any, **named: Any):
        self.engine, self.at = SimpleNamespace(), 0

    def blocks(self, piece: int) -> Iterator[Any]:
        while True:
            self.at += piece
            yield np.tile([1.0, 2.0], (piece, 1))

    def snapshot(self) -> int:
        return self.at

    def take_over(self, checkpoint: int) -> None:
        self.at = checkpoint


@pytest.fixture
def take(monkeypatch: pytest.MonkeyPatch) -> PhraseTake:
    place = "tonewood.workshop.desk.take."
    monkeypatch.setattr(f"{place}Renderer", Tone)
    monkeypatch.setattr(f"{place}stored", lambda engine, at: Ringing(at, {}, 0.0, 3.0))
    monkeypatch.setattr(f"{place}with_hands", lambda model, hands: SimpleNamespace(instrument=hands))
    return PhraseTake("score", SimpleNamespace(instrument="i"), RenderOptions(fs=8000), {})  # type: ignore[arg-type]


def test_energy_of_sound_adds_up_also_over_a_fork(take: PhraseTake) -> None:
    """3 W over 2048 frames at 8 kHz are 0.768 J; what a take rang after the frame of the fork is not the fork's."""
    take.ensure(9 * 2048)
    other, at = take.forked(6000, "o", {})  # type: ignore[arg-type, misc]
    assert at == 3 * 2048
    other.ensure(at + 2048)
    for one, count in ((take, 9), (other, 4)):
        assert [m.frame for m in one.moments] == [2048 * k for k in range(1, count + 1)]
        assert [m.sound for m in one.moments] == pytest.approx([0.768 * k for k in range(1, count + 1)])


def test_sixteen_checkpoints_and_one_minute_are_kept(take: PhraseTake) -> None:
    take.ensure(20 * 2048)
    assert [at // 2048 for at, _ in take._checkpoints] == list(range(5, 21))
    assert take.moments.maxlen == 2048
    assert len(take.sound()) == 938 * 512  # pieces of 512 up to 60 s
    assert take.sound()[-1].tolist() == [1.0, 2.0]


@pytest.mark.parametrize("fault", [ScoreError, ValueError])
def test_a_phrase_that_cannot_be_played_leaves_the_one_before(
    monkeypatch: pytest.MonkeyPatch, fault: type[Exception]
) -> None:
    made: list[Any] = []

    def refuse(*given: Any) -> None:
        made.append(given)
        raise fault("too high")

    monkeypatch.setattr("tonewood.workshop.desk.take.PhraseTake", refuse)
    scores = iter(("first", "second", "again", "third"))
    phrase: Any = SimpleNamespace(asked={"kind": "chord"}, score=lambda instrument: next(scores))
    takes = LeveledTakes(phrase, "i", "options")  # type: ignore[arg-type]
    takes.gain_db = 5.0
    with pytest.raises(fault, match="too high"):
        takes.choose("notes", "A2", 90.0, "i", "model")  # type: ignore[arg-type]
    assert made == [("second", "model", "options", {})]
    assert (takes.score, takes.gain_db, phrase.asked) == ("first", 5.0, {"kind": "chord"})
    takes.choose("notes", "A2", 90.0, "i", None)  # type: ignore[arg-type]
    assert (takes.score, takes.gain_db) == ("third", None)
    assert phrase.asked == {"kind": "notes", "notes": "A2", "velocity": 90.0}


def test_left_and_right_of_one_two_and_three_channels() -> None:
    block = np.array([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]])
    for channels, right in ((1, [1, 4]), (2, [2, 5]), (3, [2, 5])):
        assert _stereo(block[:, :channels]).T.tolist() == [[1, 4], right]


@pytest.mark.parametrize(
    ("sent", "heard", "at", "playing", "firm", "unheard"),
    [
        (0, 0, 500, True, 0, 0),
        (500, 100, 500, True, 0, 360),  # 40 of 400 are on their way
        (500, 470, 500, True, 0, 0),
        (500, 100, 50, True, 0, 50),  # of one pass of the phrase
        (500, 100, 50, False, 0, 360),
        (500, 100, 500, True, 300, 200),  # behind a fade
    ],
)
def test_frames_that_can_be_taken_back(
    monkeypatch: pytest.MonkeyPatch, sent: int, heard: int, at: int, playing: bool, firm: int, unheard: int
) -> None:
    monkeypatch.setattr("tonewood.workshop.desk.playback.time.monotonic", lambda: 10.0)
    sound = DeskSound(1000)
    assert sound.unheard == 0  # nobody listens
    page = sound.listen(0.0)
    page.sent = sent
    page.report(heard)
    sound.at, sound.playing, sound._firm = at, playing, firm
    assert sound.unheard == unheard
    assert PageProgress(1000, 3.0).reported == 13.0


def test_blocks_wait_for_the_page_and_end_when_it_is_silent(monkeypatch: pytest.MonkeyPatch) -> None:
    """Blocks of 512 at 48 kHz, up to 0.1 s ahead: ten; 6 s after the last report, none."""
    now, waits = [0.0], list[float]()
    sound = DeskSound(48000)
    for module in ("playback", "server"):
        monkeypatch.setattr(f"tonewood.workshop.desk.{module}.time.monotonic", lambda: now[0])

    async def sleep(seconds: float) -> None:
        waits.append(seconds)
        now[0] += 30.0

    server = DeskServer(SimpleNamespace(playback=sound), token="t")  # type: ignore[arg-type]
    monkeypatch.setattr("tonewood.workshop.desk.server.asyncio.sleep", sleep)

    async def sent() -> int:
        return len([block async for block in server._blocks(0)])

    assert asyncio.run(sent()) == 10
    assert BLOCK == 512
    assert waits == pytest.approx([10 * 512 / 48000 - 0.1])
    server.closing = True
    assert asyncio.run(sent()) == 0


def test_rings_of_a_drawing_have_160_points_and_those_of_a_shape_120() -> None:
    ring = np.stack([np.linspace(0, 1, 481), np.zeros(481)], axis=1)
    body = SimpleNamespace(drawing=SimpleNamespace(outline=ring, hole=None))
    bar = {"start": [0, 0], "stop": [1, 0], "width": 0.01, "height": 0.02}
    instrument: Any = SimpleNamespace(resolved={"body": {"braces": {"b": bar}, "bridge": {"width": 1}}}, body=body)
    shown = views.drawing(instrument)
    assert shown is not None
    assert [p[0] for p in shown["rings"][0]] == [float(f"{x:.4g}") for x in np.linspace(0, 1, 481)[::3]]
    assert (len(shown["rings"]), shown["bridge"]) == (1, None)
    assert shown["braces"] == [{"name": "b", "start": [0, 0], "stop": [1, 0], "width": 0.01}]
    instrument.body = None
    assert views.drawing(instrument)["rings"] == []  # type: ignore[index]


def test_groups_of_parts_that_are_there() -> None:
    values = {
        "strings": {"a": {"length": 1.0, "n": 0, "on": True}, "b": {"length": 2.0, "n": 0, "on": True}}, "exciters": {},
        "body": {"points": {"p": {"x": 1}}, "plain": {"x": 1}, "q": 3.0}, "outputs": [{"name": "o"}], "effects": {},
        "tuning": {"freq": 440.0}, "stops": None,
    }  # fmt: skip
    instrument: Any = SimpleNamespace(resolved=values)
    assert groups(instrument) == ["strings.*", "strings.a", "strings.b", "body", "body.points", "tuning", "outputs.o"]
    assert [_many(part) for part in ({"a": {}}, {"a": 1}, {}, 3, [{}])] == [True, False, False, False, False]
    assert _under(values, "outputs.o") == {"name": "o"}
    assert (_under(values, "outputs.x.y"), _under(values, "body.q"), _under(values, "body.q.r")) == ({}, 3.0, {})
    assert knobs(instrument, "none") == []


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({}, "act: is None"),
        ({"act": ["set"]}, r"act: is \['set'\]"),
        ({"act": "pick"}, "pick: a value is missing or of another type"),
        ({"act": "pick", "which": "x"}, "pick: a value is missing or of another type"),
        ({"act": "advise_take"}, "take: there is no design yet"),
    ],
)
def test_acts_that_cannot_be_done(given: dict[str, Any], said: str) -> None:
    desk: Any = SimpleNamespace(playback=DeskSound(1000), adviser=SimpleNamespace(overrides={}))
    with pytest.raises(TonewoodError, match=said):
        DeskServer(desk, token="t")._done(given)


def test_points_that_may_bear_a_mass_and_a_design_that_is_taken() -> None:
    done: list[Any] = []
    points = {"a": SimpleNamespace(driven=True), "b": SimpleNamespace(driven=False)}
    session: Any = SimpleNamespace(
        instrument=SimpleNamespace(body=SimpleNamespace(points=lambda: points)), set_all=done.append,
        set=lambda path, value, dragging=False: done.append((path, value, dragging)), save=done.append,
    )  # fmt: skip
    desk: Any = SimpleNamespace(
        session=session, adviser=SimpleNamespace(overrides={"body.x": 1.5}), change=lambda act: act(session),
        phrase=SimpleNamespace(file="p.mid"),
    )  # fmt: skip
    server = DeskServer(desk, token="t")
    assert server._points(SimpleNamespace()) == ["a"]  # type: ignore[arg-type]
    assert server._done({"act": "advise_take"}).startswith("The design that was found is on view")
    server._done({"act": "set", "path": "p", "value": [1]})
    server._done({"act": "set", "path": "p", "value": 2, "dragging": 1})
    server._done({"act": "strings", "name": "ej46"})
    assert server._done({"act": "save", "folder": "f"}) == f"saved in {Path('f').resolve()}: tonewood render p.mid -i f"
    assert done == [{"body.x": 1.5}, ("p", [1], False), ("p", 2, True), ("strings_from", "ej46", False), Path("f")]
    with pytest.raises(TonewoodError, match="'none'"):
        server._done({"act": "strings", "name": "none"})


@pytest.mark.parametrize(("gain", "words"), [(None, "--gain=0 "), (-3.5, "--gain=-3.5 ")])
def test_the_command_of_a_desk_has_no_gain_until_a_take_was_measured(gain: float | None, words: str) -> None:
    session = DeskSession("monochord")
    desk: Any = SimpleNamespace(
        session=session, takes=SimpleNamespace(gain_db=gain), phrase=SimpleNamespace(file="p.mid"), adviser=Adviser()
    )
    shown = Desk._shown_session(desk)
    assert shown["command"].startswith("tonewood render p.mid -i monochord --level calibrated " + words)
    assert (shown["undo"], shown["redo"], shown["changes"], shown["snapshots"]) == (False, False, [], [])
    session.set("strings.A2.tension", 60.0)
    session.keep("one")
    shown = Desk._shown_session(desk)
    assert (shown["undo"], shown["changes"]) == (True, [{"path": "strings.A2.tension", "value": 60.0}])
    assert shown["snapshots"] == [{"name": "one", "changes": ["strings.A2.tension=60.0"]}]


def test_energy_of_sound_is_counted_from_where_it_is_known(take: PhraseTake, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a body that does not know it none; the fork's, which does, begins at 0."""
    place = "tonewood.workshop.desk.take."
    monkeypatch.setattr(f"{place}stored", lambda engine, at: Ringing(at, {}, 0.0, None))
    take.ensure(9 * 2048)
    assert {m.sound for m in take.moments} == {None}
    other, at = take.forked(6000, "o", {})  # type: ignore[arg-type, misc]
    monkeypatch.setattr(f"{place}stored", lambda engine, at: Ringing(at, {}, 0.0, 3.0))
    other.ensure(at + 2048)
    assert [m.sound for m in other.moments] == [None, None, None, pytest.approx(0.768)]


def test_a_factor_on_all_strings_shows_what_it_was_changed_to() -> None:
    guitar = tw.load_instrument("classical_guitar")
    for change, value in (({"scale": 1.25}, 1.25), ({"add": 2.0}, 1.0), (7.0, 1.0)):
        rows = {row["path"]: row for row in shown(guitar, guitar, {"strings.*.tension": change}, "strings.*")}
        assert (rows["strings.*.tension"]["value"], rows["strings.*.tension"]["start_value"]) == (value, 1.0)
        assert {row["value"] for path, row in rows.items() if path != "strings.*.tension"} == {1.0}
