"""The sound of the desk: takes, exchanges, forks, reports and energy, by values worked out by hand."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from desk_by_hand import FS, Take, sounding

from tonewood.sound.live.instrument import Live
from tonewood.workshop.desk.desk import Desk
from tonewood.workshop.desk.playback import ComparedTakes, DeskSound, PageProgress
from tonewood.workshop.desk.take import PhraseTake, Ringing, stored


class Keys(Live):
    """Keys that sound 1, 2, 3, ... in one channel."""

    def __init__(self) -> None:
        self.at, self.released = 0, 0

    def process(self, frames: int) -> Any:
        self.at += frames
        return np.arange(self.at - frames + 1, self.at + 1, dtype=float)[:, None]

    def all_off(self) -> None:
        self.released += 1


FALL = 1 - np.arange(30) / 30


def left(sound: DeskSound, frames: int) -> Any:
    out = sound.read(frames)[0]
    np.testing.assert_allclose(out[:, 1], -out[:, 0], atol=1e-6)
    return out[:, 0]


def test_another_take_comes_in_while_the_one_before_falls_in_30_ms() -> None:
    sound = sounding(1.0, at=20)
    sound.swap(Take(2.0), serial=7)  # type: ignore[arg-type]
    np.testing.assert_allclose(left(sound, 40), 2.0 + np.r_[FALL, np.zeros(10)], rtol=1e-6)
    assert (sound.serial, sound.at) == (7, 40)
    sound.swap(Take(2.0))  # type: ignore[arg-type]
    assert sound.serial == 7


def test_a_take_that_goes_on_rises_at_the_same_frame() -> None:
    sound = sounding(1.0, at=20)
    sound.swap(Take(3.0), goes_on=True)  # type: ignore[arg-type]
    assert sound.at == 20
    found = np.concatenate([left(sound, 10), left(sound, 30)])  # a rise over two blocks
    np.testing.assert_allclose(found, 3.0 * np.r_[1 - FALL, np.ones(10)] + np.r_[FALL, np.zeros(10)], atol=1e-6)
    sound.swap(Take(3.0, 25), goes_on=True)  # type: ignore[arg-type]
    assert sound.at == 25


@pytest.mark.parametrize("loop", [True, False])
def test_a_phrase_ends_or_begins_again_within_a_block(loop: bool) -> None:
    sound = sounding(1.0, frames=100)
    sound.loop = loop
    out, what = sound.read(130)
    assert (out[:, 0] == np.r_[np.ones(100), np.full(30, float(loop))]).all()
    assert (sound.playing, sound.at) == (loop, 30 if loop else 100)
    assert (what["frame"], what["place"], what["playing"]) == (0, 0, loop)
    assert sound.take.begun == 1 + loop  # type: ignore[union-attr]


def test_an_empty_phrase_ends() -> None:
    sound = sounding(1.0, frames=0)
    assert not sound.read(10)[0].any()
    assert not sound.playing


def test_a_sound_that_is_stopped_falls_and_its_keys_are_released() -> None:
    sound, keys = sounding(1.0, at=50), Keys()
    sound.live = keys
    sound.stop()
    sound.live = None
    assert keys.released == 1
    np.testing.assert_allclose(left(sound, 31), np.r_[FALL, 0.0], atol=1e-6)
    assert not sound.playing
    sound.start(again=False)
    assert (sound.playing, sound.at) == (True, 50)
    empty = DeskSound(FS)
    empty.start()
    assert not empty.playing


def test_a_and_b_are_exchanged_over_30_ms_at_their_gains() -> None:
    sound = sounding(9.0, at=20)
    pair = ComparedTakes((Take(1.0), Take(2.0)), (1.0, 0.5), ("this design", "the start"))  # type: ignore[arg-type]
    assert pair.state() == {"names": ["A: this design", "B: the start"], "which": 0, "blind": False}
    sound.compare(pair)
    rise = 1 - FALL
    np.testing.assert_allclose(left(sound, 30), 9 * FALL + rise, rtol=1e-5)
    sound.switch(0)
    np.testing.assert_allclose(left(sound, 10), 1.0)
    sound.switch(1)
    np.testing.assert_allclose(left(sound, 40), np.r_[FALL + rise, np.ones(10)], rtol=1e-6)  # 2 at a gain of 0.5
    assert sound.at == 100
    sound.switch(2)
    assert pair.which == 1
    sound.compare(None)
    assert sound.pair is None
    other = replace(pair, blind=True, order=(1, 0))
    assert other.state() == {"names": ["X", "Y"], "which": 0, "blind": True}
    assert replace(other, blind=False, which=0).state()["which"] == 1
    assert replace(other, blind=False).state()["names"] == ["B: the start", "A: this design"]


def test_keys_that_are_exchanged_fall_and_the_last_four_fades_are_kept() -> None:
    sound = DeskSound(FS)
    sound.exchange_live(Keys())
    assert (sound.read(5)[0] == np.tile(np.arange(1, 6)[:, None], 2)).all()
    sound.exchange_live(None)
    np.testing.assert_allclose(sound.read(31)[0][:, 0], np.r_[np.arange(6, 36) * FALL, 0.0], rtol=1e-6)
    for value in range(6):
        sound._fade_out(Take(float(value)), 0, 1.0)  # type: ignore[arg-type]
    assert [f.source.value for f in sound._fading] == [2.0, 3.0, 4.0, 5.0]  # type: ignore[union-attr]
    sound.read(30)
    assert sound._fading == []


@pytest.mark.parametrize("block", [7, 30, 40])
def test_a_take_that_falls_goes_on_from_where_it_was(block: int) -> None:
    """The same in blocks of any length: frames 20 to 49 of a take that counts them, at its gain."""

    class Counting(Take):
        def read(self, start: int, frames: int) -> Any:
            return np.arange(start, start + frames, dtype=np.float32)[:, None] * np.float32([1.0, -1.0])

    sound = sounding(0.0)
    sound._fade_out(Counting(0.0), 20, 0.5)  # type: ignore[arg-type]
    found = np.concatenate([left(sound, block) for _ in range(-(-40 // block))])[:40]
    np.testing.assert_allclose(found, np.r_[0.5 * np.arange(20, 50) * FALL, np.zeros(10)], rtol=1e-6)
    assert sound._fading == []


def test_effects_of_a_take_have_their_times_and_costs() -> None:
    """Of switched effects what they cost a second of sound: their own steps, and those of the loads where they run."""
    rates = SimpleNamespace(mode=2e-9, running={"bend": 1e-6}, load={"bend": 1e-7, "ring": 3e-7})
    usage = SimpleNamespace(
        costs=SimpleNamespace(rates=lambda: rates), loads={"bend": {"A": 5.0, "B": 7.0}, "ring": {"A": 2.0}}
    )
    switchings = {name: SimpleNamespace(on=on) for name, on in (("bend", {"B", "A"}), ("ring", {"A"}), ("none", {"A"}))}
    reports = [
        SimpleNamespace(name=n, title=n.upper(), component=c, seconds_active=s, seconds_saved=1.5)
        for n, c, s in (("bend", "A", 0.25), ("bend", "B", 0.12345), ("ring", "A", 0.5), ("plain", "A", 1.0))
    ]
    fake: Any = SimpleNamespace(
        model=SimpleNamespace(n_modes=100, fs=96000.0), frames=24000, fs=48000,
        renderer=SimpleNamespace(
            engine=SimpleNamespace(usage=usage, switchings=switchings), summary=lambda: SimpleNamespace(effects=reports)
        ),
    )  # fmt: skip
    whole, bend, ring, plain = PhraseTake.effects(fake)
    assert (whole["title"], whole["active"], whole["on"], whole["saved"]) == ("100 modes", {"": 0.5}, None, 0.0)
    assert whole["cost"] == pytest.approx(2e-9 * 100 * 48000)
    assert (bend["title"], bend["active"], bend["saved"]) == ("BEND", {"A": 0.25, "B": 0.123}, 3.0)
    assert (bend["on"], bend["cost"]) == (["A", "B"], pytest.approx((1e-6 + 12 * 1e-7) * 96000))
    assert (ring["on"], ring["cost"]) == (["A"], pytest.approx(2 * 3e-7 * 96000))
    assert (plain["on"], plain["cost"]) == (None, None)
    switchings["bend"].on = set()
    assert PhraseTake.effects(fake)[1]["cost"] == 0.0


def test_a_fork_is_joined_at_its_frame() -> None:
    sound = sounding(1.0, at=20)
    sound.fork(Take(5.0), 33, 4)  # type: ignore[arg-type]
    out, what = sound.read(20)
    assert (out[:, 0] == np.r_[np.ones(13), np.full(7, 5.0)]).all()
    assert (what["serial"], sound.serial) == (4, 4)
    sound.fork(Take(6.0), 90, 5)  # type: ignore[arg-type]
    sound.start()  # from its beginning, with the newest
    assert (sound.take.value, sound.serial, sound.at) == (6.0, 5, 0)  # type: ignore[union-attr]


def test_frames_that_a_page_has_not_heard_are_sent_again(monkeypatch: pytest.MonkeyPatch) -> None:
    now = [10.0]
    monkeypatch.setattr("tonewood.workshop.desk.playback.time.monotonic", lambda: now[0])
    sound = sounding(1.0, frames=400)
    page = sound.listen(2.0)
    assert (page.reported, page.unheard, sound.unheard) == (12.0, 0, 0)
    sound.read(200)
    assert (page.sent, page.unheard) == (200, 200)
    page.report(50)
    assert (page.unheard, page.reported) == (150, 10.0)
    now[0] = 10.125
    assert page.unheard == 25  # it has heard 0.125 s more
    now[0] = 10.9
    assert page.unheard == 0
    now[0] = 10.03125  # 119 are unheard, 40 of these are on their way
    assert (page.unheard, sound.unheard) == (119, 79)
    sound.swap(Take(2.0, 400))  # type: ignore[arg-type]
    out, what = sound.read(50)
    assert what["place"] == 121
    np.testing.assert_allclose(out[:, 0], 2.0 + np.r_[FALL, np.zeros(20)], rtol=1e-6)
    assert page.sent == 171
    assert sound.unheard == 20  # a fade is not cut: from 151 on
    page.report(171)
    assert sound.unheard == 0


def test_a_report_is_trusted_for_half_a_second(monkeypatch: pytest.MonkeyPatch) -> None:
    now = [10.0]
    monkeypatch.setattr("tonewood.workshop.desk.playback.time.monotonic", lambda: now[0])
    page = PageProgress(FS, 0.0)
    page.sent = 2000
    unheard = []
    for time in (9.0, 10.25, 10.5, 10.75):
        now[0] = time
        unheard.append(page.unheard)
    assert unheard == [2000, 1750, 1500, 1500]


def test_what_no_page_has_heard_is_taken_back_when_it_is_stopped(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of 200 frames that were sent 40 are on their way; then the fade of 30 is not taken back."""
    monkeypatch.setattr("tonewood.workshop.desk.playback.time.monotonic", lambda: 10.0)
    sound = sounding(1.0, frames=400)
    page = sound.listen(0.0)
    sound.read(200)
    sound.stop()
    assert (page.sent, sound.at, sound.unheard) == (40, 40, 0)
    sound.read(110)
    assert (page.sent, sound.unheard) == (150, 80)
    page.report(120)
    assert sound.unheard == 0


def test_keys_are_sent_again_with_the_phrase() -> None:
    sound = sounding(0.0, frames=400)
    page = sound.listen(9.0)
    sound.exchange_live(Keys())
    assert sound.read(100)[0][-1, 0] == 100
    sound._take_back(30)
    assert (page.sent, sound.at) == (70, 70)
    assert sound.read(20)[0][:, 0].tolist() == list(range(71, 91))
    assert sound.read(20)[0][:, 0].tolist() == list(range(91, 111))
    sound._take_back(2000)
    sound._take_back(500)  # 2 s are kept: from 1 on, as none were before
    assert sound.read(3)[0][:, 0].tolist() == [1, 2, 3]


def test_the_load_is_a_smoothed_share_of_the_blocks_time(monkeypatch: pytest.MonkeyPatch) -> None:
    times = iter((0.0, 0.05, 1.0, 1.02, 2.0, 2.001))
    monkeypatch.setattr("tonewood.workshop.desk.playback.time.perf_counter", lambda: next(times))
    sound = DeskSound(FS)
    sound.read(100)  # half of 0.1 s
    assert (sound.meter.load, sound.meter.worst) == pytest.approx((0.025, 0.5))
    sound.read(100)
    assert (sound.meter.load, sound.meter.worst) == pytest.approx((0.025 + 0.05 * (0.2 - 0.025), 0.495))
    sound.read(100)
    assert sound.meter.worst == pytest.approx(0.495 * 0.99)


def test_energy_of_modes_is_that_of_oscillators() -> None:
    """E = (v^2 + w^2 q^2) / 2 by mode; power of sound 2 sigma s E; components that are driven have none."""

    def component(q: list[float], v: list[float], w: list[float], radiated: list[float] | None = None) -> Any:
        shown = {} if radiated is None else {"radiated": radiated}
        basis = SimpleNamespace(
            motion=(1.0, 0.0, 1.0, 1.0, 0.0, 1.0), stiffness=np.square(w), is_real=True, n_modes=len(w),
            damping_rate=np.array([3.0, 5.0][: len(w)]), metadata=shown,
        )  # fmt: skip
        return SimpleNamespace(basis=basis, modes=np.array([q, v]))

    parts = {
        "A.0": component([1.0, 0.5], [2.0, 0.0], [3.0, 4.0]),  # (4 + 9) / 2 + 4 / 2
        "A.1": component([0.0], [2.0], [3.0]),  # 2
        "B.0": component([1.0], [0.0], [2.0]),  # 2
        "finger": component([1.0], [0.0], [2.0]),
        "body": component([0.0, 1.0], [4.0, 0.0], [9.0, 2.0], [0.5, 0.1]),  # 8, 2
        "microphones": component([9.0], [9.0], [9.0]),
    }
    owners = {"A.0": "A", "A.1": "A", "B.0": "B", "microphones": "A"}
    layout = SimpleNamespace(driven=[name == "microphones" for name in parts], owners=owners)
    system = SimpleNamespace(
        names=list(parts), compiled=list(parts.values()), layout=layout, modes_of=lambda state, name: state[name].modes
    )
    engine = SimpleNamespace(system=system, state=parts, model=SimpleNamespace(strings={"A": 0, "B": 0}))
    found = stored(engine, 77)  # type: ignore[arg-type]
    assert found == Ringing(77, {"A": 10.5, "B": 2.0}, 10.0, 2 * 3 * 0.5 * 8 + 2 * 5 * 0.1 * 2)
    parts["body"].basis.metadata = {}
    assert stored(engine, 0).sound is None  # type: ignore[arg-type]
    parts["A.0"].basis.is_real = False
    assert stored(engine, 0).strings["A"] == 2.0  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("serial", "heard", "preview", "known"),
    [(2, 2, "", True), (2, 3, "", True), (2, 1, "", False), (2, 2, "coarse", False), (0, 0, "", False)],
)
def test_a_preview_is_not_wanted_once_its_exact_sound_is_heard(
    serial: int, heard: int, preview: str, known: bool
) -> None:
    sounding = SimpleNamespace(take=SimpleNamespace(preview=preview), serial=heard)
    wanted, desk = SimpleNamespace(serial=serial), SimpleNamespace(playback=sounding)
    assert Desk._exact_known(desk, wanted) is known  # type: ignore[arg-type]
    desk.playback = SimpleNamespace(take=None, serial=heard)
    assert not Desk._exact_known(desk, wanted)  # type: ignore[arg-type]
