"""What ``--accuracy`` costs in accuracy: partials compared, on made-up sounds and on the shipped instruments."""

from __future__ import annotations

import numpy as np
import pytest

import tonewood as tw
from tonewood.lab.accuracy import dial

FS = 48000.0
#: contacts or a bow make their motion chaotic: settings differ as two strokes of a player do
CHAOTIC = ("bowed_monochord", "buzzing_monochord")


def tone(freqs: np.ndarray, rates: np.ndarray, levels: np.ndarray) -> np.ndarray:
    t = np.arange(int(1.4 * FS))[:, None] / FS
    return np.sum(levels * np.exp(-rates * t) * np.cos(2 * np.pi * freqs * t + 0.1), axis=1)


def test_known_errors_of_partials_are_found() -> None:
    n = np.arange(1, 6)
    freqs, rates, levels = 200.0 * n * np.sqrt(1 + 1e-4 * n**2), 2.0 + n, 1.0 / n
    truth = tone(freqs, rates, levels)
    # the same error for all partials: medians and worst are that
    sound = tone(freqs * 2 ** (0.3 / 1200), rates * 1.02, levels * 10 ** (0.5 / 20))
    errors = dial.compare(sound, truth, FS, 200.0)
    assert errors.partials == 5
    assert errors.cents == pytest.approx(0.3, rel=0.02)
    assert errors.cents_worst == pytest.approx(0.3, rel=0.05)
    assert errors.decay == pytest.approx(0.02, rel=0.02)
    # a faster decay takes some of the level too
    assert errors.level == pytest.approx(0.5, abs=0.1)


def test_a_sound_is_as_itself() -> None:
    n = np.arange(1, 6)
    truth = tone(200.0 * n, 2.0 + n, 1.0 / n)
    errors = dial.compare(truth, truth, FS, 200.0)
    assert max(errors.cents_worst, errors.decay_worst, errors.level_worst) < 1e-12


def hold(name: str, string: str | None = None) -> None:
    instrument = tw.load_instrument(name)
    points = {
        p.accuracy: p for p in dial.measure(instrument, string or dial.middle_string(instrument), nudge=name in CHAOTIC)
    }
    errors = points["standard"].errors
    cents, decay, level = dial.LIMITS
    if name in CHAOTIC:
        chance = points[dial.NUDGED].errors
        cents, decay, level = 5 * chance.cents, 5 * chance.decay, 5 * chance.level
    assert errors.cents < cents
    assert errors.decay < decay
    assert errors.level < level
    worst = (errors.cents_worst, errors.decay_worst, errors.level_worst)
    if not instrument.attachments and name not in CHAOTIC:
        assert all(e < limit for e, limit in zip(worst, dial.LIMITS, strict=True))


@pytest.mark.parametrize("name", ["monochord", "electric_bass"])
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
