"""Pictures and figures of docs/piano.md: ``python scripts/piano_pictures.py [FOLDER]`` (docs/images by default)."""

from __future__ import annotations

import math
import sys
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

import tonewood as tw
from tonewood.instrument.inspection.frequencies import pitches
from tonewood.instrument.model.assembly import Model, assemble
from tonewood.instrument.model.stretch import inharmonicity
from tonewood.instrument.model.string_assembly import stretch_cents
from tonewood.performance.engine.engine import Engine
from tonewood.performance.player.playing import perform
from tonewood.physics.stepping.kernel import KernelStepper

FS = 48000
#: keys of the tables
SHOWN = ("A0", "C2", "C3", "C4", "C5", "C6", "C7", "C8")
#: B of a recorded Yamaha C5 (Salamander samples), by partials 1 to 8: tuning report of kasper0406/piano-emulator
MEASURED = {"C2": 6.6e-5, "C3": 1.20e-4, "C4": 2.93e-4, "C5": 8.05e-4, "C6": 2.70e-3}


def strings(model: Model, path: Path) -> None:
    """Inharmonicity, stretch and prompt decay of every key."""
    found, stretch = pitches(model), stretch_cents(model.instrument)
    numbers = np.array([p.note - 20 for p in found])
    B = {p.string.partition("_")[0]: inharmonicity(model.strings[p.string].resonator, p.wanted_freq) for p in found}
    t60 = {p.string.partition("_")[0]: p.t60 for p in found}
    own = {}
    for p in found:
        r = model.strings[p.string].resonator.parameters
        law = r.loss.parameters
        own[p.string.partition("_")[0]] = math.log(1000) / (law.sigma0 + law.sigma1 * (math.pi / r.length) ** 2)
    cents = np.array([stretch[p.string] for p in found])
    figure, (left, middle, right) = plt.subplots(1, 3, figsize=(13, 3.6), layout="constrained")
    left.semilogy(numbers, list(B.values()), label="here")
    left.semilogy([numbers[list(B).index(k)] for k in MEASURED], list(MEASURED.values()), "o", label="recorded grand")
    left.set(xlabel="key", ylabel="B", title="inharmonicity")
    left.legend()
    middle.plot(numbers, cents)
    middle.set(xlabel="key", ylabel="cents", title="stretch")
    right.semilogy(numbers, list(t60.values()), label="prompt: all strings in phase")
    right.semilogy(numbers, list(own.values()), label="aftersound: against each other")
    right.set(xlabel="key", ylabel="s, 60 dB", title="decay of the fundamental")
    right.legend()
    figure.savefig(path / "piano_keys.png", dpi=70)
    print("key       B   stretch, cents   prompt T60, s   aftersound T60, s")
    for key in SHOWN:
        string = key if key in stretch else f"{key}_1"
        print(f"{key:4s} {B[key]:.1e} {stretch[string]:12.1f} {t60[key]:15.1f} {own[key]:18.1f}")


def blows(model: Model) -> None:
    """Print speed, time of contact and largest force of hammers."""
    print("key  velocity  speed, m/s  contact, ms  force, N")
    for key, number in (("A0", 21), ("C2", 36), ("C4", 60), ("C6", 84), ("C8", 108)):
        for velocity in (30, 70, 115):
            score = tw.Score([tw.Note(0.02, 0.1, note=number, velocity_midi=velocity)])
            engine = Engine(model, perform(score, model).timeline)
            felts = [j for j, c in enumerate(model.system.connections) if c.name.split("_")[0].split(".")[0] == key]
            felts = [j for j in felts if model.system.connections[j].name.endswith(".felt")]
            engine.advance(1)
            engine.advance(math.ceil((0.0198 * FS - engine.state.sample) / 64))
            _, forces = KernelStepper(engine.system).run(
                engine.state, 320, engine.gestures.injections, engine.gestures.controls
            )
            total = np.abs(forces[:, felts]).sum(axis=1)
            speed = model.playing.velocity.value(velocity)
            touch = 1e3 * np.count_nonzero(total) / FS
            print(f"{key:4s} {velocity:8d} {speed:11.1f} {touch:12.2f} {total.max():9.1f}")


def heard(grand: tw.Instrument, path: Path) -> None:
    """One note soft and loud, and a chord with and without the pedal."""
    note = [tw.Note(0.05, 1.0, note=60, velocity_midi=v) for v in (25, 70, 115)]
    chord = [tw.Note(0.05, 0.6, note=n, velocity_midi=75) for n in (48, 55, 60, 64, 67)]
    pedal = [tw.Control(0.0, "cc64", 1.0)]
    scenes = [(f"C4, velocity {n.velocity_midi:g}", [n], []) for n in note]
    scenes += [("chord", chord, []), ("chord, pedal down", chord, pedal)]
    figure, axes = plt.subplots(1, len(scenes), figsize=(16, 3.6), sharey=True, layout="constrained")
    print("scene               peak, dBFS   2.5 to 6 kHz re 0.2 to 1 kHz, dB   level at 1.6 s re 0.3 s, dB")
    for axis, (name, notes, controls) in zip(axes, scenes, strict=True):
        x = tw.render(tw.Score(notes, controls), grand, max_duration=1.8).samples.mean(axis=1)
        axis.specgram(x + 1e-12, NFFT=2048, Fs=FS, noverlap=1536, vmin=-150, vmax=-50, cmap="magma")
        axis.set(title=name, xlabel="s", ylim=(0, 10000))
        first = x[: int(0.45 * FS)]
        power, freq = np.abs(np.fft.rfft(first * np.hanning(first.size))) ** 2, np.fft.rfftfreq(first.size, 1 / FS)
        low, high = (power[(freq > a) & (freq < b)].sum() for a, b in ((200, 1000), (2500, 6000)))
        early, late = (np.sqrt(np.mean(x[int(t * FS) : int((t + 0.1) * FS)] ** 2)) for t in (0.3, 1.6))
        peak = 20 * np.log10(np.abs(x).max())
        print(f"{name:20s} {peak:9.1f} {10 * np.log10(high / low):32.1f} {20 * np.log10(late / early):28.1f}")
    axes[0].set_ylabel("Hz")
    figure.savefig(path / "piano_heard.png", dpi=70)


def released(grand: tw.Instrument) -> None:
    """How soon a released key falls silent, and the sound between the partials of a held one."""
    print("key   20 dB after the key is released, s")
    for key, number in (("C3", 48), ("C4", 60), ("C5", 72)):
        score = tw.Score([tw.Note(0.05, 0.5, note=number, velocity_midi=80)])
        x = tw.render(score, grand, max_duration=2.0).samples[:, 0]
        window = int(0.03 * FS)
        starts = np.arange(int(0.5 * FS), x.size - window, int(0.01 * FS))
        level = 10 * np.log10([np.mean(x[i : i + window] ** 2) for i in starts])
        print(f"{key:4s} {np.argmax(level < level[0] - 20) * 0.01:10.2f}")
    print("key   between the partials 1 s after a blow at velocity 115, dB of the whole")
    for key, number, B in (("C4", 60, 3.1e-4), ("C6", 84, 2.7e-3)):
        score = tw.Score([tw.Note(0.05, 3.0, note=number, velocity_midi=115)])
        x = tw.render(score, grand, max_duration=1.8).samples[int(1.05 * FS) :, 0]
        power, freq = np.abs(np.fft.rfft(x * np.hanning(x.size))) ** 2, np.fft.rfftfreq(x.size, 1 / FS)
        f0 = 440 * 2 ** ((number - 69) / 12)
        partial = np.zeros(freq.size, dtype=bool)
        for n in range(1, 40):
            f = n * f0 * math.sqrt((1 + B * n * n) / (1 + B))
            partial |= np.abs(freq - f) < max(12.0, 0.012 * f)
        heard = (freq > 60) & (freq < 10000)
        print(f"{key:4s} {10 * np.log10(power[heard & ~partial].sum() / power[heard].sum()):10.1f}")


if __name__ == "__main__":
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parents[1] / "docs" / "images"
    piano = tw.load_instrument("grand_piano")
    whole = assemble(piano, FS)
    strings(whole, folder)
    blows(whole)
    heard(piano, folder)
    released(piano)
