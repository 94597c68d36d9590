"""Errors of ``--accuracy``: partials compared, on made-up sounds and on the shipped instruments."""

from __future__ import annotations

import numpy as np
import pytest

import tonewood as tw
from tonewood.lab.accuracy import dial
from tonewood.lab.accuracy.partials import compare

FS = 48000.0
#: their strokes differ, and means over them leave a single partial to chance; tanpura's string winds about its bridge
#: anew in each period, and one of its partials decays 5.6 % faster in `reference`
NOT_EVERY_PARTIAL = ("bowed_monochord", "buzzing_monochord", "tanpura")
#: one plane of the first partial of G3 dies away within 0.4 s beside a mode of the top; the other is heard 45 dB below.
#: Its level is a difference that each rate gets wrong by up to 1 dB, either way, and the slope of the two with it
#: of the sixth partial of the piano's F4, at -34 dB, three strings beat: the rate of its decay is 0.4, 1.7, 2.6, 0.9
#: and 0.4 % off at 1/2, 3/4, 1, 5/4 and 3/2 of the rate of `standard`
BY_CHANCE = {"drawn_guitar_x": {"decay_worst"}, "grand_piano": {"decay_worst"}}


def tone(freqs: np.ndarray, rates: np.ndarray, levels: np.ndarray) -> np.ndarray:
    t = np.arange(int(1.4 * FS))[:, None] / FS
    return np.sum(levels * np.exp(-rates * t) * np.cos(2 * np.pi * freqs * t + 0.1), axis=1)


def test_known_errors_of_partials_are_found() -> None:
    n = np.arange(1, 6)
    freqs, rates, levels = 200.0 * n * np.sqrt(1 + 1e-4 * n**2), 2.0 + n, 1.0 / n
    truth = tone(freqs, rates, levels)
    # the same error for all partials: medians and worst are that
    sound = tone(freqs * 2 ** (0.3 / 1200), rates * 1.02, levels * 10 ** (0.5 / 20))
    errors = compare(sound, truth, FS, 200.0)
    assert errors.partials == 5
    assert errors.cents == pytest.approx(0.3, rel=0.02)
    assert errors.cents_worst == pytest.approx(0.3, rel=0.05)
    assert errors.decay == pytest.approx(0.02, rel=0.02)
    # a faster decay takes some of the level too
    assert errors.level == pytest.approx(0.5, abs=0.1)


def test_a_sound_is_as_itself() -> None:
    n = np.arange(1, 6)
    truth = tone(200.0 * n, 2.0 + n, 1.0 / n)
    errors = compare(truth, truth, FS, 200.0)
    assert max(errors.cents_worst, errors.decay_worst, errors.level_worst) < 1e-12


@pytest.mark.slow
def test_strokes_are_compared_by_what_they_have_in_common() -> None:
    """Partials that fluctuate from stroke to stroke about the same decay: single strokes differ, their means do not."""
    rng = np.random.default_rng(5)
    t = np.arange(int(2 * FS)) / FS
    drift = np.cumsum(rng.standard_normal((160, len(t) // 4800 + 1)), axis=1)

    def strokes(which: slice, rate: float) -> np.ndarray:
        slow = np.stack([np.interp(t, np.arange(x.size) * 0.1, x) for x in drift[which]])
        return np.exp(-rate * t + 0.3 * slow / np.sqrt(1 + t)) * np.cos(2 * np.pi * 200 * t)

    ours, theirs = strokes(slice(0, 160, 2), 3.0), strokes(slice(1, 160, 2), 3.0)
    assert max(compare(x, y, FS, 200.0).decay for x, y in zip(ours[:5], theirs[:5], strict=True)) > 0.1
    assert compare(ours, theirs, FS, 200.0).decay < 0.05
    assert compare(strokes(slice(0, 160, 2), 3.6), theirs, FS, 200.0).decay > 0.1


def test_a_driven_note_is_heard_before_and_fades_after_it_is_let_go() -> None:
    t = np.arange(int(2 * FS)) / FS

    def note(level: float, rate: float) -> np.ndarray:
        return level * np.exp(-rate * np.maximum(t - 1, 0)) * np.cos(2 * np.pi * 200 * t)

    errors = compare(note(1.1, 4.2), note(1.0, 4.0), FS, 200.0, let_go=1.0)
    assert errors.level == pytest.approx(20 * np.log10(1.1), abs=1e-6)
    assert errors.decay == pytest.approx(0.05, rel=0.05)
    assert errors.cents < 1e-6


def hold(name: str, string: str | None = None) -> None:
    """Within the limits in the median of the partials; in every one of them where the motion is regular."""
    instrument = tw.load_instrument(name)
    points = {p.accuracy: p for p in dial.measure(instrument, string or dial.middle_string(instrument))}
    errors = points["standard"].errors
    assert errors.partials >= 5
    wrong = {words.split()[0] for words in dial.out_of_order(list(points.values()))}
    assert wrong <= BY_CHANCE.get(name, set())
    assert dial.beyond(errors) == ""
    if name not in NOT_EVERY_PARTIAL:
        assert dial.beyond(errors, worst=True) == ""


def test_limits_are_distinguished() -> None:
    errors = dial.PartialErrors(0.5, 1.5, 0.06, 0.2, 1.0, 1.25, 9)
    assert dial.beyond(errors) == "6 % of the decay"
    assert dial.beyond(errors, worst=True) == "1.5 cents, 20 % of the decay, 1.2 dB"


@pytest.mark.slow
def test_a_setting_that_is_too_coarse_is_reported() -> None:
    """Draft instead of standard: the limits are not kept everywhere."""
    (draft, *_) = dial.measure(tw.load_instrument("clavichord"), "A3", nudge=False)
    assert dial.beyond(draft.errors) != ""


def test_a_dial_that_points_the_wrong_way_is_reported() -> None:
    near, far = (dial.PartialErrors(e, e, e, e, e, e, 9, e, 0.0) for e in (0.1, 0.2))
    points = [
        dial.DialPoint("x", "A", name, errors, 1.0, 9, 1) for name, errors in (("draft", near), ("standard", far))
    ]
    assert len(dial.out_of_order(points)) == 7
    assert dial.out_of_order([*points[:1], dial.DialPoint("x", "A", "standard", near, 1.0, 9, 1)]) == []


@pytest.mark.slow
@pytest.mark.parametrize(("name", "string"), [("classical_guitar", "D3"), ("steel_strings", "G3")])
def test_each_step_of_the_dial_leads_nearer(name: str, string: str) -> None:
    """Pitch, decay, level and waveform; with fewer modes at the rate of `standard`, `draft` used to be nearer."""
    points = dial.measure(tw.load_instrument(name), string, nudge=False)
    assert dial.out_of_order(points) == []
    draft, standard, _ = (p.errors for p in points)
    assert standard.cents_worst < 0.3 * draft.cents_worst
    assert points[0].n_modes < points[1].n_modes


@pytest.mark.slow
@pytest.mark.parametrize("name", ["monochord"])
def test_standard_is_near_reference(name: str) -> None:
    hold(name)


@pytest.mark.validate
@pytest.mark.parametrize("name", list(tw.list_instruments()))
def test_standard_is_near_reference_on_every_instrument(name: str) -> None:
    hold(name)


@pytest.mark.validate
@pytest.mark.parametrize("string", ["E2", "A2", "D3", "B3", "E4"])
def test_standard_is_near_reference_on_every_string(string: str) -> None:
    hold("classical_guitar", string)
