"""What changed, in numbers: thresholds as printed, differences against closed forms."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

import tonewood as tw
from tonewood.workshop.report.comparison import Candidate, Comparison, compare, match_modes
from tonewood.workshop.report.figures import band_levels
from tonewood.workshop.report.noticed import DECAY, LEVEL, resonance
from tonewood.workshop.report.summary import FigureChange, changes, heard_words, key_figures, lines

FS = 16000


@pytest.fixture(scope="module")
def found() -> Comparison:
    monochord = tw.load_instrument("monochord")
    other = monochord.replace({"strings.A2.loss.sigma0": {"scale": 3.0}})
    return compare([Candidate(monochord), Candidate(other, (), "lossy")], notes=["A2"], fs=FS, duration=0.5)


@pytest.mark.parametrize(("q", "percent"), [(10, 2.5), (25, 1.6), (50, 1.1), (100, 0.8)])
def test_the_least_shift_of_a_resonance(q: float, percent: float) -> None:
    assert resonance(q).more == pytest.approx(percent, abs=0.05)


def test_level_and_decay() -> None:
    """About 1 dB at a moderate level; time constants of 75 to 140 % pass."""
    assert LEVEL.more == pytest.approx(0.93, abs=0.01)
    assert (DECAY.times(-25.0), DECAY.times(40.0)) == (1.0, 1.0)


def test_a_mode_that_moves_is_told_with_its_threshold(found: Comparison) -> None:
    first, second = found.instruments
    moved = tuple(replace(m, freq=m.freq * (1.03 if k == 1 else 1.0)) for k, m in enumerate(second.body_modes))
    both = replace(
        found, instruments=(first, replace(second, body_modes=moved)), modes=match_modes([first.body_modes, moved])
    )
    (row,) = [row for row in changes(both, 1) if row.name == f"mode at {first.body_modes[1].freq:.0f} Hz"]
    assert row.difference == pytest.approx(3.0)
    assert row.times == pytest.approx(3.0 / (7.9 / math.sqrt(moved[1].q)))
    text = "\n".join(lines(both, 1))
    assert "+3.0 %" in text
    assert f"{row.times:.2g} x the least noticed" in text


def test_a_full_scale_changes_no_loudness_and_velocity_is_no_acceleration() -> None:
    monochord = tw.load_instrument("monochord")
    others = [monochord.replace({f"outputs.bridge.{k}": v}) for k, v in (("full_scale", 5.0), ("quantity", "velocity"))]
    found = compare([Candidate(i) for i in (monochord, *others)], notes=["A2"], fs=FS, duration=0.2)
    scaled, other = ({row.name: row.difference for row in changes(found, i)} for i in (1, 2))
    assert scaled["loudness, mean of the notes"] == pytest.approx(0.0, abs=1e-6)
    assert "loudness, mean of the notes" not in other
    assert lines(found, 2)[0].startswith("their outputs are in m/s^2 and m/s, so their levels are not compared")


def test_decay_and_loudness_follow_the_loss(found: Comparison) -> None:
    rows = {row.name: row for row in changes(found, 1)}
    decay = rows["decay, median T60 of all stops"]
    t60 = [float(np.median([n.t60 for n in f.notes])) for f in found.instruments]
    assert decay.difference == pytest.approx(100 * (t60[1] / t60[0] - 1))
    lufs = [f.tones["A2"].lufs for f in found.instruments]
    assert rows["loudness, mean of the notes"].difference == pytest.approx(lufs[1] - lufs[0])
    assert decay.times is not None
    assert decay.times > 1
    assert "decay" in heard_words(found, 1, list(rows.values()))
    assert rows["worst wolf note, severity"].verdict == "no threshold is published"


def test_differences_are_those_of_the_figures_before_and_after(found: Comparison) -> None:
    rows = changes(found, 1)
    for row in rows:
        relative = row.scale == "%" and row.unit != "LUFS"
        told = row.before * (1 + row.difference / 100) if relative else row.before + row.difference
        assert row.after == pytest.approx(told, rel=1e-9), row.name
    assert {"all body modes, median", "damping of all body modes, median"} <= {row.name for row in rows}


def test_nothing_changed_says_so(found: Comparison) -> None:
    rows = [FigureChange("T1", 200.0, 200.0, "Hz", 0.0, "%", resonance(30.0))]
    assert heard_words(found, 1, rows) == "no change here reaches a published threshold of hearing"


def test_mean_mobility_and_the_curve_of_differences_of_a_known_mobility(found: Comparison) -> None:
    """Of |Y| = f / 1000 the mean level over lg f from 80 to 1000 Hz is 10 lg(80 * 1000) - 60 dB; of 2 |Y| 6 dB more."""
    freq = np.geomspace(40.0, 5000.0, 4000)
    first, second = (
        replace(f, freq=freq, mobility={"A2": factor * freq / 1000 + 0j})
        for f, factor in zip(found.instruments, (1.0, 2.0), strict=True)
    )
    value, unit = key_figures(first)["mean mobility, 80 to 1000 Hz"]
    assert (value, unit) == (pytest.approx(10 * math.log10(80 * 1000) - 60, abs=0.02), "dB")
    where, (a, b) = band_levels(replace(found, instruments=(first, second)), ["A2"])
    np.testing.assert_allclose(b - a, 20 * math.log10(2), atol=1e-9)
    np.testing.assert_allclose(a, 20 * np.log10(where / 1000), atol=0.01)


@pytest.mark.slow
def test_a_drawn_body_has_its_names_and_its_mass() -> None:
    guitar = tw.load_instrument("drawn_guitar").replace({"body.fmax": 700.0, "body.cell": 0.03})
    facts = compare([Candidate(guitar)], notes=["E2"], fs=FS, duration=0.1).instruments[0]
    figures = key_figures(facts)
    assert 80 < figures["A0"][0] < 130
    assert 170 < figures["T1"][0] < 260
    assert figures["mass of the body"][0] == pytest.approx(197.0, rel=0.05)
