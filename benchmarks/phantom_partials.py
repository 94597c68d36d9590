"""Levels of the phantom partials of a grand piano, and their cost.

    python benchmarks/phantom_partials.py

One key at a time, velocity 120 and 60, 48 kHz, first channel: the difference of sounds with and without the
longitudinal forces of the key's strings, from 0.2 to 2.2 s after the blow. Columns: the sum of two neighbouring
partials and its level re the loudest partial; the strongest one. The last lines are time of the process per sample
with no string's force, with the key's, and with all strings', each the least of three runs of 0.5 s.
"""

from __future__ import annotations

import math
import time
from collections.abc import Collection

import numpy as np
from numpy.typing import NDArray

import tonewood as tw

FS = 48000.0
KEYS = (("A0", 21, (8, 9)), ("E1", 28, (8, 9)), ("C2", 36, (8, 9)), ("C3", 48, (8, 9)))


def renderer(piano: tw.Instrument, note: int, velocity: int, on: Collection[str] | None, seconds: float) -> tw.Renderer:
    """A render with the longitudinal forces of these strings; None: of all."""
    score = tw.Score([tw.Note(0.1, seconds, note, velocity_midi=velocity)])
    made = tw.Renderer(score, piano, FS, max_duration=seconds)
    if on is not None:
        made.engine.system = made.engine.system.with_potentials(on)
        made.engine.stepper.exchange(made.engine.system)
    return made


def samples(made: tw.Renderer) -> NDArray[np.float64]:
    return np.concatenate([np.asarray(block, dtype=np.float64)[:, 0] for block in made.blocks()])


def main() -> None:
    piano = tw.load_instrument("grand_piano").replace({"effects.mode": "all"})
    print("| key | velocity | sum of | Hz | dB | strongest, dB | at Hz |\n|---|---|---|---|---|---|---|")
    for key, note, (i, j) in KEYS:
        group = next(of for leader, of in piano.groups.items() if round(piano.open_note(leader)) == note)
        p = piano.resonators[group[0]].parameters
        f0 = 440 * 2 ** ((note - 69) / 12)
        B = math.pi**2 * p.bending_stiffness / (p.linear_density * (2 * p.length * f0) ** 2 * p.length**2)
        wanted = sum(m * f0 * math.sqrt((1 + B * m * m) / (1 + B)) for m in (i, j))
        for velocity in (120, 60):
            with_them, without = (samples(renderer(piano, note, velocity, on, 2.4)) for on in (group, ()))
            n = 96000
            window, part = np.hanning(n), slice(14400, 14400 + n)
            spectra = [np.abs(np.fft.rfft(x[part] * window, 8 * n)) for x in (without, with_them - without)]
            freq = np.fft.rfftfreq(8 * n, 1 / FS)
            near = np.abs(freq - wanted) < 2.0
            level, most = (20 * math.log10(x / spectra[0].max()) for x in (spectra[1][near].max(), spectra[1].max()))
            at = freq[spectra[1].argmax()]
            print(f"| {key} | {velocity} | {i}, {j} | {wanted:.0f} | {level:.0f} | {most:.0f} | {at:.0f} |", flush=True)
    for key, note, _ in KEYS[:3]:
        group = next(of for leader, of in piano.groups.items() if round(piano.open_note(leader)) == note)
        took = []
        for on in ((), group, None):
            each = []
            for _ in range(3):
                made = renderer(piano, note, 100, on, 0.5)
                start = time.process_time()
                n = len(samples(made))
                each.append(1e6 * (time.process_time() - start) / n)
            took.append(min(each))
        print(f"{key}: {took[0]:.1f}, {took[1]:.1f}, {took[2]:.1f} us a sample")


if __name__ == "__main__":
    main()
