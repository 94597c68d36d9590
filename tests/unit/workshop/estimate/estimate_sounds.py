"""Notes of known partials, and notes of a known guitar, as files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import soundfile as sf

from tonewood.instrument.bundle.loading import Instrument
from tonewood.workshop.estimate.analysis import NoteAnalysis
from tonewood.workshop.estimate.partials import NotePartial
from tonewood.workshop.estimate.playing import Stage, render_notes
from tonewood.workshop.estimate.recordings import FS, Recording

GUITAR = "classical_guitar"


def partials(freq, b, rates, *, seconds=2.0, place=0.15, before=0.1, level=0.3):
    """Sum of damped partials n f sqrt(1 + B n^2) with the decay rate of each, after silence; and their frequencies."""
    n = np.arange(1, len(rates) + 1)
    f = n * freq * np.sqrt(1 + b * n**2)
    t = np.arange(round(seconds * FS)) / FS
    size = np.abs(np.sin(np.pi * n * place)) / n + 1e-4
    x = sum(
        a * np.exp(-r * t) * np.sin(2 * np.pi * at * t + k)
        for k, (a, r, at) in enumerate(zip(size, rates, f, strict=True))
    )
    x *= level / np.abs(x).max() * np.minimum(1.0, t / 1e-3)
    return np.concatenate([np.zeros(round(before * FS)), x]), f


def partial(number, *, freq=None, level=-20.0, rate=3.0, early=3.0, fell=30.0, misfit=-20.0):
    """A partial of known figures."""
    return NotePartial(number, freq or 100.0 * number, level, rate, early, fell, (), misfit, -90.0)


def analysed(**figures):
    """An analysis of known figures; `partials` is a list."""
    usual = {
        "onset": 0.1, "f0": 100.0, "b": 1e-4, "below": (None, None), "bands": np.zeros((4, 21)), "rise": 0.01,
        "peak": -3.0, "level": -20.0, "bright": -30.0, "modulation": (np.nan,) * 3, "floor": (np.nan,) * 3,
        "tail": np.empty((0, 2)), "partials": [],
    } | figures  # fmt: skip
    usual["partials"] = {p.number: p for p in usual["partials"]}
    return NoteAnalysis(**usual)


def recording(path: Path, x, fs) -> None:
    """Write a file."""
    sf.write(path, x, fs, subtype="PCM_24")


def recorded(folder: Path, changes: dict[str, Any], places, *, seconds=1.5, dynamics=(), guitar=GUITAR) -> None:
    """Notes of a changed guitar, or another instrument, as recordings with a table of their strings and stops.

    places : (string, stop) of each note.
    dynamics : MIDI velocities of the strokes of each; one of the usual velocity where left out. Levels stay, then.
    """
    truth = Instrument.load(guitar).replace(changes)
    stage = Stage(truth)
    rows, notes = ["file,string,stop,dynamic"], []
    for string, stop in places:
        note = round(stage.open_note(string) + stop)
        for dynamic in dynamics or (None,):
            name = f"{string}_{stop}" if dynamic is None else f"{string}_{stop}_v{dynamic}"
            silence = np.zeros(round(seconds * FS))
            notes.append(stage.at(Recording(name, note, silence, dynamic=dynamic), string, float(stop)))
            rows.append(f"{name}.wav,{string},{stop},{dynamic or ''}")
    output = truth.spec.outputs[0].name
    sounds = [by_output[output] for by_output in render_notes(truth, notes, [output])]
    loudest = max(float(np.abs(x).max()) for x in sounds)
    for played, x in zip(notes, sounds, strict=True):
        peak = loudest if dynamics else np.abs(x).max()
        sf.write(folder / f"{played.recording.file}.wav", 0.5 * x / peak, FS, subtype="PCM_24")
    (folder / "notes.csv").write_text("\n".join(rows) + "\n")
