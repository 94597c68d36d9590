"""Random scenes for phantom partials of a piano: keys that others set in motion through soundboard and pedal."""

from __future__ import annotations

from pathlib import Path

import numpy as np

import tonewood as tw
from pianos import piano

FS = 16000.0
NAMES = ["C", "C#", "D", "D#", "E", "F", "F#", "G", "G#", "A", "A#", "B"]
#: MIDI numbers of the keys with phantom partials, and of some above them
BASS, ABOVE = range(21, 49), (52, 55, 60, 64, 72)


def scene(seed: int, folder: Path) -> tuple[tw.Instrument, tw.Score, float, float]:
    """An instrument written into `folder`, one to six notes, their length in s, and a budget in dB.

    Of 28 keys with phantom partials 14 to 20 are there, so that their strings are more than run on all or on none;
    pedals are down for the whole time, go down or up, or stay up.
    """
    rng = np.random.default_rng([91, seed])
    keys = sorted(int(k) for k in rng.choice(BASS, int(rng.integers(14, 21)), replace=False))
    keys += [int(k) for k in rng.choice(ABOVE, int(rng.integers(0, 3)), replace=False)]
    instrument = piano(folder, [f"{NAMES[k % 12]}{k // 12 - 1}" for k in keys])
    seconds = float(rng.uniform(0.5, 1.0))
    notes = [
        tw.Note(float(rng.uniform(0, 0.6 * seconds)), float(rng.uniform(0.05, 0.6)), note=int(rng.choice(keys)),
                velocity_midi=int(rng.integers(20, 128)), channel=0)
        for _ in range(rng.integers(1, 7))
    ]  # fmt: skip
    kind, when = rng.integers(4), float(rng.uniform(0, seconds))
    courses = [[], [(0.0, 1.0)], [(when, 1.0)], [(0.0, 1.0), (when, 0.0)]]
    pedal = [tw.Control(time, "cc64", value, 0) for time, value in courses[kind]]
    notes = [tw.Note(n.time, n.duration, note=n.note, velocity_midi=n.velocity_midi, channel=0) for n in notes]
    return (
        instrument,
        tw.Score(sorted(notes, key=lambda n: n.time), controls=pedal),
        seconds,
        float(rng.uniform(-100, -60)),
    )


def excess(seed: int, folder: Path) -> float:
    """By how many dB `auto` differs from `all` beyond its budget, re the loudest sample."""
    instrument, score, seconds, budget = scene(seed, folder)
    sounds = []
    for options in ({"effects": "auto", "budget_db": budget}, {"effects": "all"}):
        stream = tw.Renderer(score, instrument, FS, max_duration=seconds, tail_level_db=-150.0, tail=seconds, **options)
        sounds.append(np.concatenate([np.asarray(block, dtype=np.float64) for block in stream.blocks(4096)]))
    n = min(map(len, sounds))
    difference = np.max(np.abs(sounds[0][:n] - sounds[1][:n])) / np.max(np.abs(sounds[1]))
    return float(20 * np.log10(max(difference, 1e-300)) - budget)
