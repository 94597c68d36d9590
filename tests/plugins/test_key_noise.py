"""Noises of a piano's key: forces against momentum and published times, the board's share of its own mass."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import tonewood as tw
import tonewood.authoring as ta
from pianos import piano
from tonewood.errors import BundleError
from tonewood.instrument.contract.base import Exciter
from tonewood.instrument.contract.registry import plugin
from tonewood.performance.player.playing import perform
from tonewood.physics.energy.trace import EnergyTrace

#: kg, of the case and of the board in scripts/make_soundboard.py, which prints the latter
CASE, BOARD = 400.0, 16.6


def gesture(velocity: float, **values: Any) -> ta.Gesture:
    exciter = plugin("key_noise").from_values({"at": "body.keybed", **values})
    assert isinstance(exciter, Exciter)
    return exciter.gesture(ta.Event({"velocity": velocity}), ta.Place("body.keybed"))


def impulse(segments: tuple[ta.Segment, ...]) -> float:
    """Integral of a force, N s."""
    widths = [(s, s.stop - s.start) for s in segments]
    return sum(s.c0 * w + s.c1 * w**2 / 2 + s.c2 * w**3 / 3 for s, w in widths)


def test_the_key_gives_up_its_momentum() -> None:
    """m V / ratio, downwards; as it comes up m v, whatever the velocity of the blow was."""
    down = gesture(3.0, mass=0.2, ratio=6.0, shank_share=0.0)
    assert impulse(down.segments) == pytest.approx(-0.2 * 3.0 / 6.0, rel=1e-9)
    up = gesture(3.0, part="rest", mass=0.2, speed=0.1, fall=0.04, contact=0.01)
    assert impulse(up.segments) == pytest.approx(-0.02, rel=1e-9)
    assert (up.start, up.stop, up.noise) == (pytest.approx(0.04), pytest.approx(0.05), None)
    assert gesture(0.0) == ta.Gesture(())


@pytest.mark.parametrize(("velocity", "published", "within"), [(1.0, 12.0, 0.1), (4.0, -3.0, 0.1), (2.0, 0.0, 2.1)])
def test_it_meets_its_felt_when_measured_keys_do(velocity: float, published: float, within: float) -> None:
    """ms after the hammer: piano, forte and mezzo forte (Askenfelt and Jansson 1990)."""
    assert 1e3 * gesture(velocity, shank_share=0.0).start == pytest.approx(published, abs=within)


def test_the_shank_rings_at_its_mode_with_a_share_of_the_momentum() -> None:
    """Int e^(-zeta w t) sin(w t) dt = 1 / (w (1 + zeta^2))."""
    ringing = gesture(2.0, head=0.01, shank_share=0.4, shank_loss=0.1, shank_freq=300.0).noise
    assert ringing is not None
    assert ringing.values.sum() * ringing.interval == pytest.approx(0.4 * 0.01 * 2.0 / 1.01, rel=1e-2)
    crossings = np.flatnonzero(np.diff(np.sign(ringing.values[1:480])))
    assert np.diff(crossings).mean() * ringing.interval == pytest.approx(1 / 600, rel=0.02)


def test_modes_of_the_board_move_with_no_more_than_its_mass() -> None:
    """The sum of Gamma^2 over all modes is the mass; the drawn ones have most of it, none above has any."""
    path = tw.list_instruments()["grand_piano"] / "soundboard.csv"
    rows = list(csv.DictReader(x for x in path.read_text(encoding="utf-8").splitlines() if x[:1] != "#"))
    gamma = CASE * np.array([float(row["keybed"]) for row in rows])
    freq = np.array([float(row["f_Hz"]) for row in rows])
    assert 0.8 * BOARD < gamma @ gamma < BOARD
    assert not gamma[freq > 1100].any()


@pytest.fixture(scope="module")
def middle(tmp_path_factory: pytest.TempPathFactory) -> tw.Instrument:
    return piano(tmp_path_factory.mktemp("middle"), ["C4", "E4"])


SCORE = tw.Score(
    [
        tw.Note(0.05, 0.1, note=60, velocity_midi=80),
        tw.Note(0.15, 0.1, note=60, velocity_midi=40),
        tw.Note(0.05, 0.3, note=64, velocity_midi=80),
    ],
)


def test_a_score_has_them_where_they_are_wanted(middle: tw.Instrument) -> None:
    """One with each note, one as each key comes up; a key that is struck again does not come up in between."""
    heard = ta.assemble(middle.replace({"playing.noises.on": True}), 48000)
    found = [(p.exciter, round(p.time, 6)) for p in perform(SCORE, heard).timeline.plays if p.at == "body.keybed"]
    assert sorted(found) == [("key", 0.05), ("key", 0.05), ("key", 0.15), ("release", 0.25), ("release", 0.35)]
    assert not [p for p in perform(SCORE, ta.assemble(middle, 48000)).timeline.plays if p.at]


def test_they_add_to_the_sound_that_there_is_without_them(middle: tw.Instrument) -> None:
    """`dry` has none and keeps its bits; by effect they are left out; a plan tells of them."""
    ways = ({}, {"preset": "dry"}, {"effects": ["key_noise"], "noises": True}, {"noises": True})
    none, dry, on, left_out = (
        tw.render(SCORE, middle, max_duration=0.45, **{"effects": "none", **more}) for more in ways
    )
    assert np.array_equal(none.samples, dry.samples)
    added = on.samples - none.samples
    level = 20 * np.log10(np.abs(added).max() / np.abs(none.samples).max())
    assert -60 < level < -25
    assert np.array_equal(none.samples, left_out.samples)


def test_a_plan_tells_when_they_sound(middle: tw.Instrument) -> None:
    planned = [e for e in tw.plan(SCORE, middle, max_duration=0.45, noises=True).effects if e.name == "key_noise"]
    assert {e.component for e in planned} == {"body.keybed"}
    assert planned[0].spans_s
    assert planned[0].spans_s[0][0] == pytest.approx(0.05, abs=0.01)


@pytest.mark.slow
def test_the_account_of_energy_has_their_work(middle: tw.Instrument) -> None:
    trace = tw.render(SCORE, middle, max_duration=0.45, noises=True, energy=True).energy
    assert isinstance(trace, EnergyTrace)
    assert trace.worst_residual <= 1e-10


def test_played_live_they_are_left_out_and_said_so(middle: tw.Instrument) -> None:
    ignored = dict(tw.Live(middle.replace({"playing.noises.on": True})).summary().ignored)
    assert ignored == {"playing.noises.key": 1, "playing.noises.release": 1}


def test_an_exciter_of_strings_is_refused(tmp_path: Path) -> None:
    with pytest.raises(BundleError, match=r"playing\.noises\.key: 'hammer' acts on strings"):
        piano(tmp_path, ["C4"]).replace({"playing.noises.key": "hammer"})
