"""Random small instruments and scores on which leaving modes out is hard to bound: light, sharp bodies and unisons."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

import tonewood as tw

FS = 48000
QUANTITIES = ("displacement", "velocity", "acceleration")


def scene(seed: int, folder: Path) -> tuple[tw.Instrument, tw.Score, float]:
    """Return an instrument, a score and its length in s.

    Bodies have 1-6 modes between 80 and 6000 Hz, of Q 20-3000 and 20-300 g, in tune with a partial in a third of the
    cases; two or three strings are in unison to 0.02 semitone, an octave or a fifth apart, or anyhow.
    """
    rng = np.random.default_rng([2026, seed])
    n_strings, n_body = int(rng.integers(2, 4)), int(rng.integers(1, 7))
    base = float(rng.uniform(40.0, 64.0))
    names = [f"s{i + 1}" for i in range(n_strings)]
    notes = [base]
    for _ in names[1:]:
        near = float(rng.choice([0.0, 0.02, -0.05, 0.2]))
        notes.append(base + (float(rng.choice([0.0, 12.0, 7.0])) + near if rng.random() < 0.8 else rng.uniform(0, 14)))
    f0 = 440.0 * 2.0 ** ((base - 69.0) / 12.0)
    freq = np.exp(rng.uniform(np.log(80.0), np.log(6000.0), n_body))
    tuned = rng.random(n_body) < 1 / 3
    freq[tuned] = np.maximum(np.round(freq[tuned] / f0), 1) * f0 * (1 + 1e-3 * rng.standard_normal(int(tuned.sum())))
    freq = np.sort(freq)
    q = np.exp(rng.uniform(np.log(20.0), np.log(3000.0), n_body))
    mass = np.exp(rng.uniform(np.log(0.02), np.log(0.3), n_body))
    shapes = rng.uniform(-1.0, 1.0, (n_body, n_strings)) if rng.random() < 0.7 else np.ones((n_body, n_strings))
    quantity = str(rng.choice(QUANTITIES))
    strings = {
        name: (
            note,
            float(np.exp(rng.uniform(np.log(0.2), np.log(4.0)))),
            float(np.exp(rng.uniform(np.log(5e-5), np.log(1e-3)))),
        )
        for name, note in zip(names, notes, strict=True)
    }
    place = float(rng.uniform(0.05, 0.4))
    rows = [(f, sharp, m, *s) for f, sharp, m, s in zip(freq, q, mass, shapes, strict=True)]
    instrument = instrument_of(folder, rows, strings, place, quantity, str(rng.choice(names)))
    seconds = float(rng.uniform(4.0, 9.0))
    played = []
    for time in np.sort(rng.uniform(0.05, 0.7 * seconds, int(rng.integers(1, 4)))):
        force = float(np.exp(rng.uniform(np.log(0.02), np.log(4.0))))
        played.append(tw.Note(float(time), seconds, string=str(rng.choice(names)), stop=0, force=force))
    return instrument, tw.Score(played), seconds


def instrument_of(
    folder: Path,
    rows: Sequence[Sequence[float]],
    strings: Mapping[str, tuple[float, float, float]],
    place: float,
    quantity: str,
    read: str,
) -> tw.Instrument:
    """Write a body's table and return the instrument.

    Parameters
    ----------
    rows : of modes: Hz, Q, modal mass in kg, and the shape at each string.
    strings : name -> MIDI note, sigma0 in 1/s, sigma1 in m^2/s; 58.8 N each.
    place : of the pluck, share of the length from the bridge.
    quantity, read : what is read at the bridge of which string.
    """
    lines = [",".join(["f_Hz", "Q", "modal_mass", *strings]), *(",".join(f"{x:.9g}" for x in row) for row in rows)]
    (folder / "body.csv").write_text("\n".join(lines) + "\n")
    base = min(note for note, *_ in strings.values())

    def string(name: str, note: float, sigma0: float, sigma1: float) -> dict[str, Any]:
        length = 0.9 if note < base + 6 else 0.9 * 2 ** (-(note - base) / 12)
        return {
            "plugin": "stiff_string",
            "note": note,
            "length": length,
            "tension": 58.8,
            "linear_density": 58.8 / (2 * length * 440.0 * 2 ** ((note - 69.0) / 12)) ** 2,
            "bending_stiffness": 2e-4,
            "freq_upper": 12000.0,
            "loss": {"law": "sigma", "sigma0": sigma0, "sigma1": sigma1},
            "end": f"body.{name}",
        }

    return tw.Instrument.from_values(
        {
            "schema": "tonewood-instrument/2",
            "name": "random_scene",
            "title": "random scene",
            "licence": "CC-BY-4.0",
            "sources": {},
            "provenance": {"*": {"kind": "authored"}},
            "body": {
                "plugin": "modal_table",
                "table": "body.csv",
                "shapes": "points",
                "points": {name: {"direction": "z"} for name in strings},
            },
            "strings": {name: string(name, *values) for name, values in strings.items()},
            "stops": {"kind": "none"},
            "exciters": {"pluck": {"plugin": "pluck_ramp", "from_bridge": place}},
            "playing": {
                "velocity": {"parameter": "pluck.force", "low": 0.4, "high": 4.0},
                "note_end": {"kind": "ring"},
            },
            "outputs": [
                {
                    "name": "bridge",
                    "plugin": "point_pickup",
                    "quantity": quantity,
                    "at": f"body.{read}",
                    "full_scale": 100.0,
                }
            ],
        },
        folder,
    )


def rendered(instrument: tw.Instrument, score: tw.Score, seconds: float, effects: str) -> tuple[Any, tw.Renderer]:
    """Sound of one channel, (n,), and its renderer; every exchange is taken to pay."""
    stream = tw.Renderer(score, instrument, FS, max_duration=seconds, tail=seconds, tail_level_db=-120, effects=effects)
    stream.engine.sleeper.worth = 0.0
    return np.concatenate(list(stream.blocks(4096)))[:, 0].astype(float), stream


def difference(instrument: tw.Instrument, score: tw.Score, seconds: float) -> tuple[float, float, float]:
    """Peak of the difference of `auto` and `all` re the peak, the largest figure reported, both in dB; share culled."""
    (a, auto), (b, _) = (rendered(instrument, score, seconds, effects) for effects in ("auto", "all"))
    n = min(len(a), len(b))
    error = max(float(np.abs(a[:n] - b[:n]).max() / np.abs(b).max()), 1e-30)
    culled = [
        10 ** (e.bound / 20)
        for e in auto.summary().effects
        if e.name == "high_modes" and e.bound is not None and e.seconds_active < auto.summary().duration_s - 1e-9
    ]
    ledger = auto.engine.ledger
    share = 1.0 - ledger.mode_samples / max(ledger.samples * auto.model.n_modes, 1)
    return 20 * np.log10(error), 20 * np.log10(max(sum(culled), 1e-30)), share
