"""The desk with models, takes and processes that cost nothing: who is asked for what, and when."""

from __future__ import annotations

import json
import threading
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tonewood.errors import TonewoodError
from tonewood.physics.coupling.connections import Connection, SpringDashpot
from tonewood.sound.render.options import RenderOptions
from tonewood.workshop.desk.ahead import Ahead
from tonewood.workshop.desk.desk import Desk
from tonewood.workshop.desk.making import DesignModels
from tonewood.workshop.desk.models import Wanted
from tonewood.workshop.desk.session import MOST_CHANGES, Design, DeskSession
from tonewood.workshop.desk.take import PIECE, PhraseTake, Ringing, with_hands

PLUCK, STRING = "exciters.pluck.force", "strings.A2.tension"


# -- takes ------------------------------------------------------------------------------------------------------------


class Renders:
    """A renderer of `length` frames that count up on the left, and count down on the right."""

    length = 9000

    def __init__(self, score: Any, instrument: Any, options: Any, model: Any):
        self.at, self.taken = 0, None
        self.engine = SimpleNamespace()

    def blocks(self, piece: int) -> Iterator[Any]:
        while self.at < self.length:
            n = min(piece, self.length - self.at)
            at = self.at + np.arange(n, dtype=float)
            self.at += n
            yield np.stack([at, -at, 0 * at], axis=1)

    def snapshot(self) -> int:
        return self.at

    def take_over(self, checkpoint: int) -> None:
        self.at = self.taken = checkpoint  # type: ignore[assignment]


@pytest.fixture
def take(monkeypatch: pytest.MonkeyPatch) -> PhraseTake:
    monkeypatch.setattr("tonewood.workshop.desk.take.Renderer", Renders)
    monkeypatch.setattr("tonewood.workshop.desk.take.stored", lambda engine, at: Ringing(at, {}, 0.0, None))
    monkeypatch.setattr(
        "tonewood.workshop.desk.take.with_hands", lambda model, hands: SimpleNamespace(instrument=hands)
    )
    return PhraseTake("score", SimpleNamespace(instrument="i"), RenderOptions(fs=8000), {"d": 1}, "coarse")  # type: ignore[arg-type]


def test_a_take_is_rendered_as_far_as_it_is_read(take: PhraseTake) -> None:
    assert (take.fs, take.frames, take.ended, take.foreign, PIECE) == (8000, 0, False, 0, 512)
    found = take.read(100, 500)
    assert found[:, 0].tolist() == list(range(100, 600))
    assert found[:, 1].tolist() == [-float(x) for x in range(100, 600)]
    assert take.frames == 1024
    assert take.read(8990, 100)[:, 0].tolist() == list(range(8990, 9000))
    assert (take.frames, take.ended) == (9000, True)
    assert len(take.read(9500, 10)) == 0
    assert len(take.sound()) == 9000
    assert [m.frame for m in take.moments] == [2048, 4096, 6144, 8192]
    assert all(m.sound is None for m in take.moments)  # the share of sound is not known


def test_a_take_of_any_length_is_kept(take: PhraseTake, monkeypatch: pytest.MonkeyPatch) -> None:
    """Room is made for 4 s at first, and doubled."""
    monkeypatch.setattr(Renders, "length", 70_000)
    found = take.read(0, 80_000)[:, 0]
    np.testing.assert_array_equal(found, np.arange(70_000, dtype=np.float32))
    assert take.sound().shape == (70_000, 2)


def test_a_take_goes_on_with_other_hands_at_a_checkpoint(take: PhraseTake) -> None:
    """The next of every 2048 frames, from 2500 on at 4096."""
    take.ensure(1000)
    forked = take.forked(2500, "other", {"e": 2})  # type: ignore[arg-type]
    assert forked is not None
    other, at = forked
    assert (at, other.frames, other.foreign, other.design, other.preview) == (4096, 4096, 4096, {"e": 2}, "coarse")
    assert other.model.instrument == "other"
    assert other.renderer.taken == 4096  # type: ignore[attr-defined]
    assert [m.frame for m in other.moments] == [2048, 4096]
    assert other.read(4000, 200)[:, 0].tolist() == list(range(4000, 4200))
    exact = take.forked(4096, "other", {})  # type: ignore[arg-type]
    assert exact is not None
    assert exact[1] == 4096
    assert take.forked(8193, "other", {}) is None  # type: ignore[arg-type]
    fresh = other.again()
    assert (fresh.foreign, fresh.frames, fresh.design, fresh.preview) == (0, 0, {"e": 2}, "coarse")
    assert take.again() is take


def test_effects_of_a_take_and_their_cost(take: PhraseTake) -> None:
    """5 modes of 2 us at 8 kHz; an effect that costs 1 ms while it runs, 3 ms for each of its load of 0.5."""
    take.frames, take.model = 4000, SimpleNamespace(n_modes=5, fs=8000)  # type: ignore[assignment]
    rates = SimpleNamespace(mode=2e-6, running={"a": 1e-3}, load={"a": 3e-3})
    usage = SimpleNamespace(costs=SimpleNamespace(rates=lambda: rates), loads={"a": {"x": 0.5, "y": 9.0}})
    switchings = {"a": SimpleNamespace(on={"x"}), "b": SimpleNamespace(on=set())}
    reports = [
        SimpleNamespace(name="a", title="A", component=c, seconds_active=s, seconds_saved=v)
        for c, s, v in (("x", 0.12345, 1.0), ("y", 0.5, 2.0))
    ] + [SimpleNamespace(name="b", title="B", component="x", seconds_active=0.0, seconds_saved=0.0)]
    take.renderer = SimpleNamespace(  # type: ignore[assignment]
        engine=SimpleNamespace(usage=usage, switchings=switchings), summary=lambda: SimpleNamespace(effects=reports)
    )
    modes, a, b = take.effects()
    assert modes == {"title": "5 modes", "active": {"": 0.5}, "on": None, "cost": pytest.approx(2e-6 * 5 * 8000),
                     "saved": 0.0}  # fmt: skip
    assert a == {"title": "A", "active": {"x": 0.123, "y": 0.5}, "on": ["x"], "saved": 3.0,
                 "cost": pytest.approx((1e-3 + 3e-3 * 0.5) * 8000)}  # fmt: skip
    assert b == {"title": "B", "active": {"x": 0.0}, "on": None, "cost": None, "saved": 0.0}
    switchings["a"].on = set()
    assert take.effects()[1] | {"active": 0} == {"title": "A", "active": 0, "on": [], "saved": 3.0, "cost": 0.0}


# -- models -----------------------------------------------------------------------------------------------------------


class Maker:
    """A maker of models that notes what it is asked for."""

    def __init__(self, options: Any, fault: Any, kept: Any):
        self.fault, self.wants, self.closed = fault, list[Any](), False

    @property
    def busy(self) -> Any:
        return self.wants[-1] if self.wants else None

    def want(self, wanted: Any) -> None:
        self.wants.append(wanted)

    def forget(self) -> None:
        self.wants.clear()

    def close(self) -> None:
        self.closed = True


class Timer:
    """A timer that is let go by hand."""

    made: list[Timer] = []  # noqa: RUF012

    def __init__(self, seconds: float, call: Any, given: Any):
        self.seconds, self.call, self.given = seconds, call, given

    def start(self) -> None:
        Timer.made.append(self)


class Beside:
    """A process beside the sound that notes what it makes."""

    def __init__(self, source: str, fs: int, *, allow_code: bool):
        self.made, self.turned, self.stopped = list[Any](), list[Any](), 0

    def make(self, design: Any, then: Any) -> None:
        self.made.append((design, then))

    def turn_to(self, design: Any) -> None:
        self.turned.append(design)

    def stop(self) -> None:
        self.stopped += 1


@pytest.fixture
def making(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Models of a session, with what they said."""
    monkeypatch.setattr("tonewood.workshop.desk.making.ModelMaker", Maker)
    monkeypatch.setattr("tonewood.workshop.desk.making.Ahead", Beside)
    monkeypatch.setattr("tonewood.workshop.desk.making.threading.Timer", Timer)
    monkeypatch.setattr(
        "tonewood.workshop.desk.making.previewed",
        lambda instrument, known: (f"coarse {instrument}", "words") if instrument == "drawn" else None,
    )
    Timer.made.clear()
    told: list[Any] = []
    session: Any = SimpleNamespace(source="s", allow_code=False)
    made = DesignModels(
        session,
        RenderOptions(),
        None,
        lambda *x: told.append(("ready", *x)),
        lambda *x: told.append(("failed", *x)),  # type: ignore[arg-type]
    )
    return SimpleNamespace(models=made, told=told, exact=made._exact, quick=made._quick, ahead=made._ahead)


def test_a_body_that_is_known_is_made_exactly_at_once(making: Any) -> None:
    making.models.want(Design({"a": 1}, "plain"), 4)  # type: ignore[arg-type]
    (wanted,) = making.exact.wants
    assert (wanted.instrument, wanted.changes, wanted.serial, wanted.preview) == ("plain", {"a": 1}, 4, "")
    assert (making.quick.wants, making.models.busy) == ([], wanted)
    wanted.use("model", wanted)
    assert making.told == [("ready", "model", wanted)]
    assert Timer.made == []


def test_a_preview_comes_first_and_the_exact_model_when_the_hand_rests(making: Any) -> None:
    making.models.want(Design({"a": 1}, "drawn"), 4)  # type: ignore[arg-type]
    (coarse,) = making.quick.wants
    assert (coarse.instrument, coarse.preview, coarse.serial) == ("coarse drawn", "words", 4)
    assert (making.exact.wants, making.models.busy.instrument) == ([], "drawn")
    coarse.use("coarse model", coarse)
    assert making.told == [("ready", "coarse model", coarse)]
    (timer,) = Timer.made
    assert (timer.seconds, timer.given, timer.daemon) == (0.7, (4,), True)  # type: ignore[attr-defined]
    timer.call(3)  # of a change before
    assert making.ahead.made == []
    timer.call(4)
    ((design, then),) = making.ahead.made
    assert (design.instrument, design.changes) == ("drawn", {"a": 1})
    then()
    assert [w.instrument for w in making.exact.wants] == ["drawn"]
    then()  # it is wanted once
    assert len(making.exact.wants) == 1


def test_a_preview_that_cannot_be_made_is_told_and_the_exact_model_follows(making: Any) -> None:
    making.models.want(Design({}, "drawn"), 1)  # type: ignore[arg-type]
    (coarse,) = making.quick.wants
    making.quick.fault(coarse, "too coarse")
    assert making.told == [("failed", coarse, "too coarse")]
    Timer.made[0].call(1)
    assert len(making.ahead.made) == 1


def test_what_is_not_begun_is_forgotten(making: Any) -> None:
    making.models.want(Design({}, "drawn"), 1)  # type: ignore[arg-type]
    making.models.forget()
    assert (making.models.busy, making.ahead.stopped) == (None, 1)
    making.models._begin_exact(1)
    assert making.ahead.made == []
    making.models.want(Design({}, "plain"), 2)  # type: ignore[arg-type]
    making.models.want(Design({}, "drawn"), 3)  # type: ignore[arg-type]
    assert making.exact.wants == []  # another one takes its place
    making.models.close()
    assert (making.exact.closed, making.quick.closed, making.ahead.stopped) == (True, True, 2)


class Process:
    """A process that ends when it is let."""

    def __init__(self) -> None:
        self.text, self.ended, self.killed = "", threading.Event(), False

    def communicate(self, text: str) -> None:
        self.text = text
        assert self.ended.wait(60)

    def kill(self) -> None:
        self.killed = True
        self.ended.set()


def test_one_process_makes_the_models_of_one_body(monkeypatch: pytest.MonkeyPatch) -> None:
    processes: list[Process] = []
    called: list[int] = []

    def popen(words: list[str], *, text: bool, **_: Any) -> Process:
        assert text
        assert words[1:] == ["-P", "-m", "tonewood.workshop.desk.ahead"]
        processes.append(Process())
        return processes[-1]

    monkeypatch.setattr("tonewood.workshop.desk.ahead.cache_folder", lambda: Path())
    monkeypatch.setattr("tonewood.workshop.desk.ahead.subprocess.Popen", popen)
    ahead = Ahead("box", 44100, allow_code=True)

    def design(body: int) -> Any:
        return SimpleNamespace(instrument=SimpleNamespace(resolved={"body": body}), changes={"n": body})

    def end(*ended: Process) -> None:
        for process in ended:
            process.ended.set()
        for thread in threading.enumerate():
            if thread is not threading.current_thread() and getattr(thread, "_target", None) == ahead._wait:
                thread.join(60)

    ahead.make(design(1), lambda: called.append(1))
    ahead.make(design(1), lambda: called.append(2))  # the newest is told
    assert len(processes) == 1
    end(processes[0])
    assert called == [2]
    assert json.loads(processes[0].text) == {"source": "box", "fs": 44100, "allow_code": True, "changes": {"n": 1}}
    ahead.make(design(1), lambda: called.append(3))
    ahead.turn_to(design(1))
    assert not processes[1].killed
    ahead.make(design(2), lambda: called.append(4))
    assert processes[1].killed
    end(*processes[1:])
    assert called == [2, 4]
    ahead.stop()  # nothing is left to end


# -- the desk ---------------------------------------------------------------------------------------------------------


class Take:
    """A take that is rendered at once: one frame of a value, its loudness in LU."""

    peak, loud = 0.5, {"design": -20.0, "other": -26.0}

    def __init__(self, score: Any, model: Any, options: Any, design: Any, preview: str = ""):
        self.score, self.model, self.options, self.design, self.preview = score, model, options, design, preview
        self.ended, self.frames, self.fs, self.ensured = False, 5000, options.fs, 0
        self.moments: list[Ringing] = []
        self.renderer = SimpleNamespace(channels=["c"], dropped=[SimpleNamespace(reason=str(i)) for i in range(5)])
        self.forks: list[Any] = []

    def sound(self) -> Any:
        return np.array([[self.peak, -self.peak]])

    def ensure(self, frames: int) -> None:
        self.ensured = frames

    def loudness(self) -> float:
        return self.loud.get(str(self.model.name), 0.0)

    def forked(self, frame: int, instrument: Any, design: Any) -> Any:
        self.forks.append((frame, design))
        return Take(self.score, self.model, self.options, design), frame + 7

    def effects(self) -> list[Any]:
        return ["effects"]

    def again(self) -> Take:
        return self

    def read(self, start: int, frames: int) -> Any:
        return np.zeros((frames, 2), dtype=np.float32)


class Models:
    """Models of a session that are ready when a test says so."""

    def __init__(self, session: Any, options: Any, kept: Any, ready: Any, failed: Any):
        self.exact: Any = None
        self.ready, self.failed, self.busy, self.wanted, self.forgot = ready, failed, None, list[Any](), 0

    def want(self, design: Any, serial: int) -> None:
        self.wanted.append((design, serial))

    def forget(self) -> None:
        self.forgot += 1

    def close(self) -> None:
        self.closed = True


def model(name: str, instrument: Any) -> Any:
    system = SimpleNamespace(connections=(), dt=1 / 8000)
    return SimpleNamespace(
        name=name, instrument=instrument, n_modes=3, warnings=("w",), groups={"A2": 0}, system=system
    )


@pytest.fixture
def desk(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[Any]:
    place = "tonewood.workshop.desk.desk."
    monkeypatch.setattr("tonewood.workshop.desk.take.PhraseTake", Take)
    monkeypatch.setattr(f"{place}DesignModels", Models)
    monkeypatch.setattr(f"{place}ModelMaker", Maker)
    monkeypatch.setattr(f"{place}with_hands", lambda known, hands: model("hands", hands))
    made: Any = Desk(DeskSession("monochord"), folder=tmp_path, fs=8000)
    yield made
    made.close()


def ready(desk: Any, name: str = "design", preview: str = "") -> Any:
    """Let the newest design's model be ready."""
    design, serial = desk._models.wanted[-1]
    wanted = Wanted(design.instrument, design.changes, serial, lambda *_: None, preview)
    made = model(name, design.instrument)
    desk._models.ready(made, wanted)
    return made


def test_parts_that_touch_a_string_at_rest_are_told(desk: Any) -> None:
    """Partials and decays that the page shows leave them out."""
    made = ready(desk)
    touching = Connection("felt", (), SpringDashpot(damping=1.0), "attached", part="felt", owner="A2")
    made.system.connections = (touching,)
    made.instrument = SimpleNamespace(attachments={"felt": None})
    line = "left out: felt, which touches A2 at rest: pitch and decay of the sound differ from those stated here"
    assert desk.state()["warnings"] == ["w", line]


def test_the_first_model_is_heard_at_4_db_below_full_scale(desk: Any) -> None:
    assert [serial for _, serial in desk._models.wanted] == [0]
    assert (desk.state()["gain_db"], desk.state()["modes"]) == (None, None)
    with pytest.raises(TonewoodError, match="no model yet"):
        desk.view("mobility")
    with pytest.raises(TonewoodError, match="no model yet"):
        desk.key("A2", 80, on=True)
    made = ready(desk)
    take = desk.playback.take
    assert (take.model, desk._models.exact, take.ensured) == (made, made, 2 * 4096)
    assert take.options.gain_db == desk.state()["gain_db"] == 2.0  # 0.5 is -6.02 dB
    assert (desk.takes.options.tail, desk.takes.options.max_duration, desk.takes.options.fs) == (3.0, 60.0, 8000)
    state = desk.state()
    assert (state["modes"], state["warnings"], state["channels"]) == (3, ["w"], ["c"])
    assert state["dropped"] == ["0", "1", "2"]
    asked: list[Any] = []
    desk._views.view = lambda *given, **named: asked.append((*given, named)) or "seen"
    assert desk.view("differences") == "seen"
    assert desk.view("shape", "90", of_start=True) == "seen"
    assert asked == [
        (made, "differences", "", {"of_start": False, "exact": True}),
        (made, "shape", "90", {"of_start": True, "exact": True}),
    ]
    assert desk.state()["command"].split()[:2] == ["tonewood", "render"]
    assert "--gain=2 " in desk.state()["command"]


def test_a_silent_phrase_has_no_gain(desk: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Take, "peak", 0.0)
    ready(desk)
    assert desk.state()["gain_db"] == 0.0


def test_a_change_of_the_hands_forks_the_take_that_plays(desk: Any) -> None:
    ready(desk)
    assert desk.change(lambda session: session.set(PLUCK, 1.0)) == 1  # nothing plays: another take
    assert (desk.playback.serial, desk.playback.take.design, desk._models.forgot) == (1, {PLUCK: 1.0}, 1)
    assert desk._models.exact.name == "hands"
    desk.playback.start()
    desk.playback.read(100)
    before = desk.playback.take
    assert desk.change(lambda session: session.set(PLUCK, 2.0)) == 2
    assert before.forks == [(100, {PLUCK: 2.0})]
    joined, at, serial = desk.playback._joins
    assert (joined.design, at, serial) == ({PLUCK: 2.0}, 107, 2)
    assert [serial for _, serial in desk._models.wanted] == [0]
    for name, value in (("ended", True), ("preview", "coarse")):
        setattr(desk.playback.take, name, value)
        desk.change(lambda session: session.set(PLUCK, session.design.changes[PLUCK] + 0.1))
        assert desk.playback.take.design[PLUCK] != 2.0
        assert len(before.forks) == 1


def test_a_change_of_a_string_waits_for_its_model(desk: Any) -> None:
    ready(desk)
    desk.fault, desk._compared = "old", "old"
    assert desk.change(lambda session: session.set(STRING, 60.0)) == 1
    assert (desk.fault, desk.state()["compared"]) == ("", "")
    design, serial = desk._models.wanted[-1]
    assert (dict(design.changes), serial, desk.playback.serial) == ({STRING: 60.0}, 1, 0)
    desk._models.busy = SimpleNamespace(since=0.0)
    desk.change(lambda session: session.set(PLUCK, 1.0))  # hands, while a model is made
    assert [serial for _, serial in desk._models.wanted] == [0, 1, 2]
    desk._models.busy = None
    old = Wanted(design.instrument, design.changes, 1, lambda *_: None)
    desk._models.ready(model("old", design.instrument), old)
    assert desk.playback.take.model.name == "design"  # passed over
    desk._models.failed(old, "too hard")
    assert desk.fault == ""
    desk._models.failed(Wanted(design.instrument, {}, 2, lambda *_: None), "too hard")
    assert desk.fault == "no model of this design: too hard. The sound is still that of the design before."
    made = ready(desk)
    assert (desk.playback.take.model, desk.playback.serial) == (made, 2)


def test_a_change_that_changes_nothing_has_no_serial(desk: Any) -> None:
    ready(desk)
    assert desk.change(lambda session: session.keep("a")) == 0
    assert desk.change(lambda session: session.undo()) == 0
    assert len(desk._models.wanted) == 1


def test_a_change_that_cannot_be_made_is_taken_back(desk: Any) -> None:
    exact = ready(desk)

    def refuse(design: Any, serial: int) -> None:
        raise TonewoodError("no")

    desk._models.want = refuse
    with pytest.raises(TonewoodError):
        desk.change(lambda session: session.set(STRING, 60.0))
    assert (desk.serial, dict(desk.session.design.changes), desk.session.can_undo) == (0, {}, False)
    assert desk._models.exact is exact


def test_an_exact_model_goes_on_where_its_preview_plays(desk: Any) -> None:
    ready(desk)
    desk.change(lambda session: session.set(STRING, 60.0))
    ready(desk, "coarse", "preview: x")
    assert (desk.playback.take.preview, desk._models.exact.name) == ("preview: x", "design")
    assert desk.state()["preview"] == "preview: x"
    assert desk.view("differences") == [
        "a coarse preview is seen: what differs is told of the exact model, which follows"
    ]
    desk.playback.start()
    desk.playback.read(300)
    ready(desk, "exact")
    take = desk.playback.take
    assert (take.model.name, take.preview, desk.playback.at, take.ensured) == ("exact", "", 300, 300 + 2 * 4096)
    assert desk._models.exact.name == "exact"
    ready(desk, "late", "preview: x")  # the exact one is heard
    assert desk.playback.take is take
    desk.playback.stop()
    ready(desk, "again")
    assert desk.playback.at == 0  # nothing plays: from the beginning


def test_another_phrase_has_its_own_gain(desk: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    ready(desk)
    monkeypatch.setattr(Take, "peak", 0.25)
    desk.set_phrase("notes", "A2 B2", 100.0)
    assert (desk.serial, desk.playback.serial, desk.state()["gain_db"]) == (1, 1, 8.0)
    assert [n.note for n in desk.takes.score.notes] == [45, 47]
    assert desk.playback.take.score is desk.takes.score
    asked = {"kind": "notes", "notes": "A2 B2", "velocity": 100.0}
    assert desk.state()["phrase"] == asked
    with pytest.raises(TonewoodError):
        desk.set_phrase("notes", "H9")
    assert (desk.state()["phrase"], desk.serial) == (asked, 1)


@pytest.mark.parametrize(
    ("own", "other", "gains"), [(-20.0, -26.0, (10 ** (-6 / 20), 1.0)), (-23.0, -20.0, (1.0, 10 ** (-3 / 20)))]
)
def test_the_louder_of_two_designs_is_turned_down(
    desk: Any, monkeypatch: pytest.MonkeyPatch, own: float, other: float, gains: tuple[float, float]
) -> None:
    monkeypatch.setattr(Take, "loud", {"design": own, "other": other})
    with pytest.raises(TonewoodError, match="not ready yet"):
        desk.compare("")
    exact = ready(desk)
    desk.session.keep("kept")
    desk.compare("kept")
    assert desk.state()["compared"] == "both are brought to one loudness: kept is made"
    (wanted,) = desk._other.wants
    wanted.use(model("other", exact.instrument), wanted)
    pair = desk.playback.pair
    assert pair.gains == pytest.approx(gains)
    assert (pair.names, pair.order, pair.blind) == (("this design", "kept"), (0, 1), False)
    assert desk.state()["compared"] == f"A is {own - other:+.1f} LU from kept, taken out"
    desk.playback.pick(1)
    assert pair.which == 1
    desk.playback.pick(2)
    assert pair.which == 1
    desk.compare(None)
    assert (desk.playback.pair, desk.state()["compared"]) == (None, "")
    desk._models.busy = SimpleNamespace(since=0.0)
    with pytest.raises(TonewoodError, match="not ready yet"):
        desk.compare("")


@pytest.mark.parametrize(("drawn", "order"), [(1, (0, 1)), (0, (1, 0))])
def test_a_blind_pair_is_in_a_drawn_order(
    desk: Any, monkeypatch: pytest.MonkeyPatch, drawn: int, order: tuple[int, int]
) -> None:
    monkeypatch.setattr("tonewood.workshop.desk.playback.secrets.randbelow", lambda n: drawn)
    exact = ready(desk)
    desk.compare("", blind=True)
    wanted = desk._other.wants[-1]
    desk.serial += 1
    wanted.use(model("other", exact.instrument), wanted)
    assert desk.playback.pair is None  # the design has changed since
    desk.serial -= 1
    wanted.use(model("other", exact.instrument), wanted)
    assert (desk.playback.pair.order, desk.state()["compared"]) == (order, "")
    assert desk.state()["pair"]["names"] == ["X", "Y"]
    desk.playback.pick(1)
    assert desk.playback.pair.which == order[1]
    desk.playback.reveal()
    assert desk.state()["pair"]["names"] == [f"{'AB'[i]}: {('this design', 'the start')[i]}" for i in order]


def test_keys_play_the_take_s_model_at_its_gain(desk: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[Any] = []

    class Plays:
        def __init__(self, instrument: Any, options: Any, model: Any, prepare: bool):
            self.options, self.model, self.notes = options, model, list[Any]()
            assert not prepare  # the first key is not kept waiting
            self.player = SimpleNamespace(counters=SimpleNamespace(latest=[SimpleNamespace(reason=r) for r in "pq"]))
            made.append(self)

        def note_on(self, note: Any, velocity: float) -> None:
            self.notes.append((note, velocity))

        def note_off(self, note: Any) -> None:
            self.notes.append(note)

    monkeypatch.setattr("tonewood.workshop.desk.desk.Live", Plays)
    ready(desk)
    desk.key("A2", 80, on=False)  # nothing is pressed
    assert made == []
    desk.key("A2", 80.0, on=True)
    desk.key("A2", 0.0, on=False)
    desk.key(47, 90.0, on=True)
    (live,) = made
    assert live.notes == [("A2", 80.0), "A2", (47, 90.0)]
    assert (live.options.fs, live.options.gain_db, live.model) == (8000, 2.0, desk.playback.take.model)
    assert desk.state()["dropped"] == ["q", "0", "1", "2"]
    desk.change(lambda session: session.set(STRING, 60.0))
    ready(desk)
    desk.key(47, 90.0, on=False)
    assert len(made) == 1
    desk.key(47, 90.0, on=True)
    assert len(made) == 2


def test_moments_up_to_4096_frames_ahead(desk: Any) -> None:
    assert (desk.playback.moments(0)["moments"], desk.playback.moments(0)["seconds"]) == ([], 0.0)
    ready(desk)
    desk.playback.at = 1000
    desk.playback.take.moments = [Ringing(at, {}, 1.0, None) for at in (10, 11, 5096, 5097)]
    found = desk.playback.moments(10)
    assert [m["frame"] for m in found["moments"]] == [11, 5096]
    assert (found["frame"], found["effects"], found["seconds"]) == (1000, ["effects"], 5000 / 8000)
    assert (found["load"], found["worst"]) == (0.0, 0.0)


def test_a_model_that_is_made_is_told_with_its_seconds(desk: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tonewood.workshop.desk.desk.time.monotonic", lambda: 12.34)
    assert desk.state()["making"] is None
    desk._models.busy = SimpleNamespace(since=10.0)
    assert desk.state()["making"] == 2.3
    assert desk.view("drawing") is None


def test_the_last_500_changes_can_be_undone() -> None:
    assert MOST_CHANGES == 500
    session = DeskSession("monochord")
    session._past = [session.start] * 498
    for force in (1.0, 1.1, 1.2):
        session.set(PLUCK, force)
    assert len(session._past) == 500
    assert dict(session._past[-1].changes) == {PLUCK: 1.1}


def test_hands_of_another_instrument_on_a_model() -> None:
    from dataclasses import dataclass

    @dataclass
    class Of:
        instrument: Any
        exciters: Any = None
        default_exciter: str = ""

    session = DeskSession("monochord")
    known = Of(session.instrument.replace({"effects.mode": "none"}))
    other = session.instrument.replace({PLUCK: 3.0})
    found: Any = with_hands(known, other)  # type: ignore[arg-type]
    assert found.instrument.resolved["exciters"]["pluck"]["force"] == 3.0
    assert found.instrument.resolved["effects"]["mode"] == "none"
    assert (found.exciters, found.default_exciter) == (found.instrument.exciters, "pluck")
