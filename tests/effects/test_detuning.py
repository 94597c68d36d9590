"""A rise that is left out changes samples far above the additive budget: by the phase of partials, not their level."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import tonewood as tw
from tonewood.performance.effects.base import Moment, Switching, Watched
from tonewood.performance.effects.tension import TensionEffect
from tonewood.sound.files.audio import decibels

FS = 48000
#: a rest before the note: the pull is kept, in place of a step that fades
SCORE = tw.Score([tw.Note(0.25, 3.0, string="G3", force=0.8)])


def rendered(**options: Any) -> tuple[np.ndarray, float]:
    """Sound, and the largest rise of G3 that was left out, cents."""
    renderer = tw.Renderer(SCORE, tw.load_instrument("steel_strings"), FS, max_duration=3.0, **options)
    sound = np.concatenate(list(renderer.blocks(4096)))[:, 0].astype(float)
    bounds = [e.bound or 0.0 for e in renderer.summary().effects if e.name == "tension_modulation"]
    return sound, max(bounds)


def partial(sound: np.ndarray, freq: float, time: float) -> complex:
    """Complex amplitude of a partial about a time, under a Gaussian window."""
    t = np.arange(len(sound)) / FS
    return complex(np.sum(sound * np.exp(-0.5 * ((t - time) / 0.08) ** 2 - 2j * np.pi * freq * t)))


def test_the_difference_of_a_rise_left_out_is_a_turned_phase() -> None:
    full, _ = rendered(effects="all")
    auto, cents = rendered(effects="auto", budget_cents=100.0, budget_db=-90.0)
    peak = float(np.abs(full).max())
    assert 0.0 < cents < 0.1
    difference = decibels(float(np.abs(auto - full).max()) / peak)
    assert difference > -80.0  # 10 dB and more above the budget of added sound
    spectrum, freqs = np.abs(np.fft.rfft(full * np.hanning(len(full)))), np.fft.rfftfreq(len(full), 1 / FS)
    for number in (1, 2, 3, 5, 8):
        near = np.flatnonzero(abs(freqs / (number * 196.0) - 1.01) < 0.03)
        freq = float(freqs[near[np.argmax(spectrum[near])]])
        before, after = (partial(sound, freq, 2.5) for sound in (full, auto))
        turned, level = abs(np.angle(after / before)), abs(abs(after / before) - 1.0)
        assert level < 0.1 * turned
        # at most the angle by which the reported rise would have turned it in all the time
        assert turned < 2 * np.pi * freq * 3.0 * (2 ** (cents / 1200) - 1)


def test_without_a_budget_of_cents_the_difference_keeps_to_that_of_what_is_added() -> None:
    full, _ = rendered(effects="all")
    auto, cents = rendered(effects="auto", budget_cents=0.0, budget_db=-80.0)
    assert cents == 0.0
    assert decibels(float(np.abs(auto - full).max()) / float(np.abs(full).max())) < -100.0


def test_a_switch_is_not_heard(monkeypatch: pytest.MonkeyPatch) -> None:
    """Strings that only move with the bridge have no rise to speak of: when it comes and goes, nothing may click."""
    full, _ = rendered(effects="all")

    def watched(effect: TensionEffect, moment: Moment, _: Switching) -> Watched:
        others = moment.sample // 4096 % 2 == 1
        return Watched(frozenset(effect.components if others else ["G3"]), [], {})

    monkeypatch.setattr(TensionEffect, "watch", watched)
    auto, _ = rendered(effects="auto")
    assert 0.0 < float(np.abs(auto - full).max()) < 1e-5 * float(np.abs(full).max())
