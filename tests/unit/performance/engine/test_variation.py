"""Human variation: reproducible, off by default, of the spreads that are asked for."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import tonewood as tw
from tonewood.instrument.model.assembly import assemble
from tonewood.performance.player.playing import Performance, perform
from tonewood.performance.player.variation import Deviates

SCORE = tw.Score([tw.Note(0.5 + 0.25 * i, 0.2, string="G3", stop=i % 5, velocity_midi=80) for i in range(300)])


@pytest.fixture(scope="module")
def guitar() -> tw.Instrument:
    return tw.load_instrument("classical_guitar")


def played(guitar: tw.Instrument, **variation: float) -> Performance:
    changes = {f"playing.variation.{key}": value for key, value in variation.items()}
    return perform(SCORE, assemble(guitar.replace(changes), 8000, freq_limit=3000))


def forces(performance: Performance) -> np.ndarray:
    return np.array([p.gesture.force(0.0) for p in performance.timeline.plays])


def test_without_a_seed_nothing_varies(guitar: tw.Instrument) -> None:
    plain = played(guitar)
    assert [p.time for p in plain.timeline.plays] == [n.time for n in SCORE.notes]
    assert np.ptp(forces(plain)) == 0.0
    assert {(p.gesture.from_bridge, p.gesture.angle_deg) for p in plain.timeline.plays} == {(0.105, 55.0)}


@pytest.mark.slow
def test_the_same_seed_is_the_same_performance(guitar: tw.Instrument) -> None:
    one, again, other = (played(guitar, seed=s) for s in (3, 3, 4))
    assert [p.gesture.segments for p in one.timeline.plays] == [p.gesture.segments for p in again.timeline.plays]
    assert [p.time for p in one.timeline.plays] == [p.time for p in again.timeline.plays]
    assert not np.allclose(forces(one), forces(other))


def test_spreads_are_those_asked_for(guitar: tw.Instrument) -> None:
    """Standard deviations of 300 notes; cut at 2.5 of them, a normal law has 0.96 of its own."""
    found = played(guitar, seed=1, time=0.01, force_db=2.0, from_bridge=0.008, angle_deg=6.0)
    plays = found.timeline.plays
    level = 20 * np.log10(forces(found))
    assert np.std(level) == pytest.approx(0.96 * 2.0, rel=0.12)
    late = np.sort([p.time for p in plays]) - [n.time for n in SCORE.notes]
    assert np.std(late) == pytest.approx(0.96 * 0.01, rel=0.12)
    assert np.std([p.gesture.from_bridge or 0.0 for p in plays]) == pytest.approx(0.96 * 0.008, rel=0.12)
    assert np.std([p.gesture.angle_deg for p in plays]) == pytest.approx(0.96 * 6.0, rel=0.12)
    assert len({p.gesture.width for p in plays}) > 100  # the share of nail decides the width
    drawn = np.array([[d.force, d.time, d.place] for d in (Deviates.of(1, i) for i in range(300))])
    assert np.abs(np.corrcoef(drawn.T) - np.eye(3)).max() < 0.2
    assert np.abs(drawn).max() <= 2.5


def test_a_slur_varies_as_a_note_that_names_its_technique() -> None:
    bass = tw.load_instrument("electric_bass").replace({"playing.variation.seed": 5})
    model = assemble(bass, 8000, freq_limit=3000)
    notes = [tw.Note(0.4 * i, 0.45, string="E1", stop=stop, velocity_midi=80) for i, stop in enumerate((2, 5, 3, 12))]
    slurred = perform(tw.Score(notes), model)
    names = [assigned.note.technique for assigned in slurred.notes]
    named = [dataclasses.replace(n, technique=name) for n, name in zip(notes, names, strict=True)]
    assert names == [None, "hammer_on", "pull_off", "slide"]
    asked = perform(tw.Score(named), model)
    assert slurred.timeline.changes == asked.timeline.changes
    for one, other in zip(slurred.timeline.plays, asked.timeline.plays, strict=True):
        assert (one.start, one.gesture.segments) == (other.start, other.gesture.segments)
        assert (one.gesture.from_bridge, one.gesture.angle_deg) == (other.gesture.from_bridge, other.gesture.angle_deg)


def test_an_option_of_the_render_gives_the_seed(guitar: tw.Instrument) -> None:
    score = tw.Score(SCORE.notes[:2])
    plain, varied, again = (
        tw.render(score, guitar, 16000, max_duration=0.9, humanize=seed).samples for seed in (None, 5, 5)
    )
    assert np.array_equal(varied, again)
    assert np.abs(varied - plain).max() > 0.05 * np.abs(plain).max()
