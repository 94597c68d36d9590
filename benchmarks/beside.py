"""Draw a phrase of each instrument beside a sampled one, as spectrograms of the same MIDI notes.

    python benchmarks/beside.py --bank BANK.sf2 OUT grand_piano steel_guitar

BANK is a General MIDI bank of sampled instruments, played by the command `fluidsynth`; neither is part of the project.
The instrument is rendered with the preset `studio`. Both sounds are at the same level.
"""

from __future__ import annotations

import argparse
import subprocess
import tempfile
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import soundfile as sf

import tonewood as tw
from tonewood.support.arrays import Floats
from tonewood.workshop.estimate.spectra import db

if TYPE_CHECKING:
    from matplotlib.axes import Axes

FS = 48000
#: instrument -> program of General MIDI, counted from 0, and the lowest note of the phrase
PROGRAMS = {
    "classical_guitar": (24, 45),
    "flamenco_guitar": (24, 45),
    "spanish_guitar": (24, 45),
    "drawn_guitar": (24, 45),
    "steel_guitar": (25, 45),
    "twelve_string_guitar": (25, 45),
    "electric_bass": (33, 28),
    "sitar": (104, None),
    "african_harp": (46, None),
    "clavichord": (6, None),
    "grand_piano": (0, 45),
}
#: semitones above the lowest note, 0.3 s apart; then the first four together
PHRASE = (0, 7, 12, 16, 19, 24, 19, 16)


def phrase(instrument: tw.Instrument, lowest: int | None) -> list[tuple[float, float, int]]:
    """Start and length (s) and number of each note; open strings where the instrument has no stops."""
    opens = sorted({round(instrument.open_note(s)) for s in instrument.groups})
    notes = [lowest + n for n in PHRASE] if lowest is not None else [opens[k % len(opens)] for k in (0, 1, 2, 3, 2, 1)]
    if instrument.name == "electric_bass":
        notes = [n - 5 if n > 43 else n for n in notes]
    events = [(0.1 + 0.3 * k, 0.28, n) for k, n in enumerate(notes)]
    last = 0.1 + 0.3 * len(notes)
    return events + [(last, 1.8, n) for n in sorted(set(notes[:4]))]


def midi(events: list[tuple[float, float, int]], program: int) -> bytes:
    """Bytes of a MIDI file: 480 ticks are half a second."""
    moments = [(t, 0x90, n) for t, _, n in events] + [(t + d, 0x80, n) for t, d, n in events]
    track, now = bytes([0, 0xC0, program]), 0
    for time, status, note in sorted(moments):
        tick = round(960 * time)
        step, now = tick - now, tick
        length = bytes([0x80 | step >> 7, step & 0x7F]) if step > 127 else bytes([step])
        track += length + bytes([status, note, 90 if status == 0x90 else 0])
    track += bytes([0, 0xFF, 0x2F, 0])
    header = b"MThd" + (6).to_bytes(4, "big") + bytes([0, 0, 0, 1, 1, 0xE0])
    return header + b"MTrk" + len(track).to_bytes(4, "big") + track


def sampled(events: list[tuple[float, float, int]], program: int, bank: Path) -> Floats:
    """Sound of the bank, mono."""
    with tempfile.TemporaryDirectory() as folder:
        score, wav = Path(folder) / "phrase.mid", Path(folder) / "phrase.wav"
        score.write_bytes(midi(events, program))
        subprocess.run(["fluidsynth", "-ni", "-q", "-r", str(FS), "-F", wav, bank, score], check=True)
        return np.asarray(sf.read(wav, always_2d=True)[0].mean(axis=1))


def draw(ax: Axes, x: Floats, title: str) -> None:
    """Draw a spectrogram, 80 dB deep."""
    from scipy.signal import stft

    freq, time, z = stft(x, FS, nperseg=4096, noverlap=3584)
    level = db(np.abs(z) ** 2 + 1e-20)
    ax.pcolormesh(time, freq / 1000, level, vmin=level.max() - 80, vmax=level.max(), rasterized=True)
    ax.set(title=title, ylim=(0, 8), xlabel="s", ylabel="kHz")


def shares(x: Floats) -> str:
    """Share of the energy in bands, dB."""
    power = np.abs(np.fft.rfft(x)) ** 2
    freq = np.fft.rfftfreq(len(x), 1 / FS)
    edges = (40, 150, 500, 1500, 4000, 10000)
    return " | ".join(f"{db(power[(freq >= a) & (freq < b)].sum() / power.sum()):.0f}" for a, b in pairwise(edges))


def main() -> None:
    """Run the command."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("out", type=Path)
    parser.add_argument("instruments", nargs="*", default=list(PROGRAMS))
    parser.add_argument("--bank", type=Path, required=True)
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    print(
        "| phrase, dB of all in Hz | 40-150 | 150-500 | 500-1500 | 1500-4000 | 4000-10000 |\n|---" + "|---:" * 5 + "|"
    )
    for name in given.instruments:
        program, lowest = PROGRAMS[name]
        instrument = tw.load_instrument(name)
        events = phrase(instrument, lowest)
        score = tw.Score([tw.Note(t, d, note=n, velocity_midi=90) for t, d, n in events])
        own = tw.render(score, instrument, fs=FS, preset="studio", max_duration=events[-1][0] + 2.5)
        both = [np.asarray(own.samples, dtype=np.float64).mean(axis=1), sampled(events, program, given.bank)]
        figure, axes = plt.subplots(1, 2, figsize=(12, 4), sharey=True, layout="constrained")
        for ax, x, title in zip(axes, both, (name, f"sampled, program {program + 1}"), strict=True):
            draw(ax, x, title)
            print(f"| {title if x is both[0] else f'{name}, sampled'} | {shares(x)} |")
        figure.savefig(given.out / f"{name}.png", dpi=60)
        plt.close(figure)


if __name__ == "__main__":
    main()
