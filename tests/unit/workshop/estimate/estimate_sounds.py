"""Notes of known partials, and notes of a known guitar, as files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import soundfile as sf

from tonewood.instrument.bundle.loading import Instrument
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


def recorded(folder: Path, changes: dict[str, Any], places, *, seconds=1.5) -> None:
    """Notes of a changed guitar as recordings with a table of their strings and stops.

    places : (string, stop) of each note.
    """
    truth = Instrument.load(GUITAR).replace(changes)
    stage = Stage(truth)
    rows, notes = ["file,string,stop"], []
    for string, stop in places:
        note = round(stage.open_note(string) + stop)
        notes.append(stage.at(Recording(f"{string}_{stop}", note, np.zeros(round(seconds * FS))), string, float(stop)))
        rows.append(f"{string}_{stop}.wav,{string},{stop}")
    output = truth.spec.outputs[0].name
    for played, sounds in zip(notes, render_notes(truth, notes, [output]), strict=True):
        x = sounds[output]
        sf.write(folder / f"{played.recording.file}.wav", 0.5 * x / np.abs(x).max(), FS, subtype="PCM_24")
    (folder / "notes.csv").write_text("\n".join(rows) + "\n")
