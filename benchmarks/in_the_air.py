"""Measure single notes of instruments and print the tables of docs/in_the_air.md.

    python benchmarks/in_the_air.py steel_guitar twelve_string_guitar drawn_guitar_x     # some minutes
    python benchmarks/in_the_air.py steel_guitar --step 6 --set exciters.plectrum.from_bridge=0.08
    python benchmarks/in_the_air.py grand_piano
    python benchmarks/in_the_air.py --sounds FOLDER                                      # A2.ogg ... of a piano
    python benchmarks/in_the_air.py --rise monochord classical_guitar
    python benchmarks/in_the_air.py --struck steel_guitar drawn_guitar_x electric_bass   # do strings strike frets?

Plucked instruments are played by `--velocity` (100) in the lowest position, every third semitone; medians.
T60 is that of the partials in a band; the onset is the loudest 3 ms of a band re the loudest 3 ms of all.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import yaml
from numpy.typing import NDArray

import tonewood as tw
from tonewood.instrument.scales import note_name
from tonewood.workshop.estimate.analysis import analyse
from tonewood.workshop.estimate.partials import Bands
from tonewood.workshop.estimate.recordings import FS, read_folder
from tonewood.workshop.estimate.spectra import db, find_onset, power_spectrum, running_rms, share

Floats = NDArray[np.float64]

VELOCITY, STRUCK = 100, 114
#: first lines of the tables
PLUCKED_HEAD = (
    "| instrument | centroid .5 s, Hz | T60 3.2-8 kHz, s | onset > 10 kHz, dB | > 3 kHz, dB | sd, dB | notes |"
)
PIANO_HEAD = "| key | prompt T60, s | between, dB | modulation, dB | < .7 f0, dB | centroid, Hz | 1e5 B | level, dB |"
#: s
DURATION = 4.0
#: notes of the piano, A2 to A6
PIANO = (45, 57, 69, 81, 93)


def played(
    instrument: tw.Instrument,
    note: int,
    string: str | None,
    velocity: int,
    output: str | None,
    preset: str = "dry",
    seconds: float = DURATION,
) -> Floats:
    """Sound of one note, mean of its channels, at `FS`."""
    score = tw.Score([tw.Note(0.1, seconds, note=note, string=string, velocity_midi=velocity)])
    options = {"outputs": (output,)} if output else {}
    sound = tw.render(score, instrument, max_duration=seconds, fs=FS, preset=preset, **options)
    return np.asarray(sound.samples, dtype=np.float64).mean(axis=1)


def lowest(instrument: tw.Instrument, step: int) -> list[tuple[int, str]]:
    """Notes from the lowest open one to E5, `step` semitones apart, on the string with the highest open note that fits.

    Strings without stops have their open notes.
    """
    opens = {name: instrument.open_note(name) for name in instrument.groups}
    if instrument.spec.stops.kind == "none":
        return [(round(note), name) for name, note in opens.items()]
    below = {n: [s for s in opens if opens[s] <= n + 0.5] for n in range(round(min(opens.values())), 77, step)}
    places = [(n, max(names, key=opens.__getitem__)) for n, names in below.items() if names]
    return [(n, s) for n, s in places if n - opens[s] <= instrument.spec.stops.count]


def centroid(x: Floats, low: float = 50.0) -> float:
    """Hz, of the power between `low` and 12 kHz."""
    freq, power = power_spectrum(x, np.hanning(len(x)), 1 << 16)
    heard = (freq > low) & (freq < 12000)
    return float((freq * power)[heard].sum() / power[heard].sum())


def onset_level(x: Floats, onset: int, low: float, high: float) -> float:
    """dB, greatest level of 3 ms in a band from 20 ms before the onset to 30 ms after it, re that of all in 100 ms."""
    from scipy.signal import butter, sosfilt

    band = sosfilt(butter(4, (low, high), "bandpass", fs=FS, output="sos"), x)
    first = max(0, onset - FS // 50)
    loudest = running_rms(np.asarray(band), 0.003)[first : onset + 3 * FS // 100].max()
    return float(20 * np.log10(loudest / running_rms(x, 0.003)[onset : onset + FS // 10].max()))


def plucked(instrument: tw.Instrument, output: str | None, velocity: int, step: int = 3) -> None:
    """Print the medians of an instrument over notes `step` semitones apart."""
    rows, decays, levels = [], [], []
    for note, string in lowest(instrument, step):
        x = played(instrument, note, string, velocity, output)
        f = 440 * 2 ** ((note - 69) / 12)
        found = analyse(x, f, 1e-4)
        onset = round(found.onset * FS)
        late = x[onset + FS // 2 : onset + FS // 2 + FS // 25]
        rows.append(
            (centroid(late), onset_level(x, onset, 10000, 15500), share(x[onset : onset + FS // 10], 3000, FS / 2))
        )
        decays += [
            np.log(1000) / p.rate for p in found.partials.values() if 3200 <= p.freq < 8000 and p.clear and p.rate > 0
        ]
        levels.append(found.level)
    late, onset_db, bright = np.median(rows, axis=0)
    t60 = f"{np.median(decays):.2f}" if decays else "-"
    name = f"{instrument.name} {output or ''}".strip()
    print(f"| {name} | {late:.0f} | {t60} | {onset_db:.0f} | {bright:.0f} | {np.std(levels):.1f} | {len(rows)} |")


def piano(sounds: Mapping[int, Floats]) -> dict[int, tuple[float, ...]]:
    """Print the figures of notes of a piano, each from before its blow on, and return them."""
    figures: dict[int, tuple[float, ...]] = {}
    for note, x in sounds.items():
        f0 = 440 * 2 ** ((note - 69) / 12)
        onset, _ = find_onset(x, f0)
        found = analyse(x, f0, 4e-4)
        g, b = found.f0, found.b
        bands, prompt, wobble = Bands(x, onset), [], []
        for n in range(1, 6):
            at = n * g * np.sqrt(1 + b * n * n)
            y, t = bands.envelope(at, min(0.3 * g, 20.0))
            e = db(np.abs(y) ** 2)
            e, t = (v[(t > 0.08) & (t < 1.5)] for v in (e, t))
            down = np.flatnonzero(e < e[:5].max() - 45)
            last = down[0] if len(down) and down[0] > 20 else len(e)
            early = t < min(0.5, t[last - 1])
            slope = np.polyfit(t[early], e[early], 1)[0]
            if slope < -0.3:
                prompt.append(-60 / slope)
            wobble.append(np.std(e[:last] - np.polyval(np.polyfit(t[:last], e[:last], 3), t[:last])))
        head = x[max(0, onset - 200) : onset + int(0.06 * FS)]
        freq, power = power_spectrum(head, np.hanning(len(head)), 1 << 16)
        below = db(power[(freq > 40) & (freq < 0.7 * g)].sum() / power[freq > 40].sum())
        rest = x[onset + FS // 2 : onset + 3 * FS // 2]
        freq, power = power_spectrum(rest, np.blackman(len(rest)), 1 << 18)
        n = np.arange(1, 80)
        partials = (n * g * np.sqrt(1 + b * n * n))[n * g < 12000]
        off = np.abs(freq[:, None] - partials).min(axis=1) > min(0.2 * g, 12.0)
        between = db(power[off & (freq > 40)].sum() / power[freq > 40].sum())
        bright = centroid(x[onset : onset + FS // 5], 30.0)
        figures[note] = tuple(map(float, (np.median(prompt), between, np.median(wobble), below, bright, 1e5 * b)))
        figures[note] += (float(found.level),)
        cells = " | ".join(f"{v:.{d}f}" for v, d in zip(figures[note], (1, 0, 1, 0, 0, 0, 1), strict=True))
        print(f"| {note_name(note)} | {cells} |")
    return figures


def rises(instrument: tw.Instrument) -> None:
    """Print the time from 20 dB below the first peak to it, ms: medians of notes, in two presets."""
    places = [(n, None) for n in PIANO[1:4]] if instrument.name == "grand_piano" else lowest(instrument, 7)
    places = places[:: max(1, len(places) // 3)][:3]
    cells = []
    for preset in ("dry", "studio"):
        sounds = [
            (played(instrument, n, s, VELOCITY, None, preset, 0.7), 440 * 2 ** ((n - 69) / 12)) for n, s in places
        ]
        found = [find_onset(x, f) for x, f in sounds]
        cells.append(f"{np.median([1e3 * (top - onset) / FS for onset, top in found]):.1f}")
    print(f"| `{instrument.name}` | {' | '.join(cells)} | {len(places)} |")


def struck(instrument: tw.Instrument) -> None:
    """Print notes of velocity `STRUCK` whose sound differs from that of the same strings with no fret in reach."""
    far = instrument.replace({"connections.frets.action_first": 0.02, "connections.frets.action_twelfth": 0.03})
    places = [(s, stop) for s in instrument.string_names for stop in range(0, 13, 2)]
    met = []
    for string, stop in places:
        score = tw.Score([tw.Note(0.05, 0.3, string=string, stop=stop, velocity_midi=STRUCK)])
        near, free = (np.asarray(tw.render(score, i, max_duration=0.25).samples, float) for i in (instrument, far))
        if np.abs(near - free).max() > 1e-6 * np.abs(free).max():
            met.append(f"{string}/{stop}")
    print(f"{instrument.name}: {len(met)} of {len(places)} strike a fret at velocity {STRUCK}: {' '.join(met)}")


def main() -> None:
    """Run the command."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("instruments", nargs="*")
    parser.add_argument("--sounds", type=Path, help="folder of recorded notes of a piano, measured likewise")
    parser.add_argument("--output", help="name of the output that is heard; the first where left out")
    parser.add_argument("--velocity", type=int, default=VELOCITY, help="of plucked instruments")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="of the bundle, as in a render")
    parser.add_argument("--step", type=int, default=3, help="semitones between the notes of plucked instruments")
    parser.add_argument("--rise", action="store_true", help="times of the rise in the presets dry and studio")
    parser.add_argument("--struck", action="store_true", help="look for strings that strike frets")
    given = parser.parse_args()
    head = PIANO_HEAD if given.sounds or "grand_piano" in given.instruments else PLUCKED_HEAD
    if given.rise:
        head = "| instrument | rise dry, ms | studio, ms | notes |"
    if not given.struck:
        print(head + "\n|---" + "|---:" * (head.count("|") - 2) + "|")
    if given.sounds:
        piano({r.note: r.samples for r in read_folder(given.sounds).recordings if r.note in PIANO})
    for name in given.instruments:
        instrument = tw.load_instrument(name)
        if given.set:
            instrument = instrument.replace({k: yaml.safe_load(v) for k, _, v in (s.partition("=") for s in given.set)})
        if given.struck:
            struck(instrument)
        elif given.rise:
            rises(instrument)
        elif name == "grand_piano":
            piano({note: played(instrument, note, None, 80, None) for note in PIANO})
        else:
            plucked(instrument, given.output, given.velocity, given.step)


if __name__ == "__main__":
    main()
