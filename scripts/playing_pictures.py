"""Pictures and figures of docs/playing.md: ``python scripts/playing_pictures.py [FOLDER]`` (docs/images by default)."""

from __future__ import annotations

import sys
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from numpy.typing import NDArray

import tonewood as tw
from tonewood.instrument.contract.gestures import Event
from tonewood.instrument.model.assembly import assemble
from tonewood.physics.stepping.forcing import course

Floats = NDArray[np.float64]

FORCES = (0.5, 1.0, 2.0, 4.0)  # N
STRINGS = ("E2", "G3", "E4")


def release(path: Path) -> None:
    """Course of the force on three strings, and the spectrum of its fall."""
    model = assemble(tw.load_instrument("classical_guitar"), 48000)
    pluck = model.exciters["pluck"]
    figure, (whole, fall, spectrum) = plt.subplots(1, 3, figsize=(12, 3.4), layout="constrained")
    print("release from 90 to 10 % of the force, us\nforce, N " + "".join(f"{s:>8s}" for s in STRINGS))
    for force in FORCES:
        times = []
        for name in STRINGS:
            event = Event({"force": force}, model.strings[name].freq(0))
            gesture = pluck.gesture(event, model.place(name, 0))
            t = np.linspace(0.0, gesture.stop, 20001)
            f = course(gesture.segments, t)
            times.append(1e6 * (t[np.argmax(f < 0.1 * force)] - t[np.argmax(f < 0.9 * force)]))
            if name != "G3":
                continue
            draw = np.linspace(gesture.start - 2e-3, gesture.stop + 1e-3, 4000)
            noise = 0.0 if gesture.noise is None else gesture.noise.at(draw)
            whole.plot(1e3 * draw, course(gesture.segments, draw) + noise, label=f"{force:g} N")
            fall.plot(1e6 * t, f / force)
            fine = np.arange(0.0, 4e-3, 1e-6)
            rate = np.abs(np.fft.rfft(course(gesture.segments, fine, derivative=True), 1 << 16)) * 1e-6 / force
            freq = np.fft.rfftfreq(1 << 16, 1e-6)
            spectrum.semilogx(freq[1:], 20 * np.log10(rate[1:]))
        print(f"{force:8.1f} " + "".join(f"{x:8.0f}" for x in times))
    whole.set(xlabel="ms", ylabel="N", title="finger's force, G3")
    whole.legend()
    fall.set(xlabel="us from the beginning of the slip", title="its fall, re the force", xlim=(0, 1200))
    spectrum.set(xlabel="Hz", ylabel="dB re a step", title="spectrum of the fall", xlim=(500, 16000), ylim=(-40, 3))
    figure.savefig(path / "playing_release.png", dpi=70)


def attacks(path: Path) -> None:
    """Spectrograms of one note by ramp and finger, soft and loud, and of a rest stroke."""
    guitar = tw.load_instrument("classical_guitar")
    ramp = guitar.replace({"exciters.pluck": {"plugin": "pluck_ramp", "from_bridge": 0.105, "angle_deg": 30.0}})
    scenes = (
        ("a ramp of 0.2 ms, 2 N", ramp, {"force": 2.0}),
        ("finger, 2 N", guitar, {"force": 2.0}),
        ("finger, 0.4 N", guitar, {"force": 0.4}),
        ("flesh, 2 N", guitar, {"force": 2.0, "technique": "flesh"}),
    )
    figure, axes = plt.subplots(1, 4, figsize=(13, 3.4), sharey=True, layout="constrained")
    for axis, (title, instrument, touch) in zip(axes, scenes, strict=True):
        score = tw.Score([tw.Note(0.1, 1.0, string="E4", stop=0, **touch)])
        x = tw.render(score, instrument, max_duration=0.5).samples.mean(axis=1)
        _, _, _, image = axis.specgram(x / np.abs(x).max() + 1e-12, NFFT=512, Fs=48000, noverlap=448, cmap="magma")
        top = image.get_array().max()
        image.set_clim(top - 90, top)
        axis.set(title=title, ylim=(0, 16000), xlabel="s")
    axes[0].set_ylabel("Hz")
    figure.savefig(path / "playing_attack.png", dpi=70)


def dynamics() -> None:
    """Peak and brightness over velocity."""
    guitar = tw.load_instrument("classical_guitar")
    print("velocity  peak, dB re full scale  energy above 3 kHz, dB")
    for velocity in (20, 40, 60, 80, 100, 127):
        score = tw.Score([tw.Note(0.1, 1.0, string="G3", stop=0, velocity_midi=velocity)])
        x = tw.render(score, guitar, max_duration=0.4).samples.mean(axis=1)
        power = np.abs(np.fft.rfft(x[4800:] * np.hanning(len(x) - 4800))) ** 2
        freq = np.fft.rfftfreq(len(x) - 4800, 1 / 48000)
        share = 10 * np.log10(power[freq > 3000].sum() / power.sum())
        print(f"{velocity:8d}  {20 * np.log10(np.abs(x).max()):22.1f}  {share:22.1f}")


def neighbours(path: Path) -> None:
    """First partial of A3 with open strings that ring, damped by the hand, or tuned away."""
    guitar = tw.load_instrument("classical_guitar")
    scenes = (
        ("open strings ring", {}),
        ("a hand lies on them", {"playing.note_end.idle": "damp"}),
        ("open A2 tuned to A#2", {"strings.A2.note": "A#2"}),
    )
    score = tw.Score([tw.Note(0.1, 1.6, string="G3", note=57, velocity_midi=100)])
    figure, axis = plt.subplots(figsize=(7, 3.2), layout="constrained")
    print("A3, first partial, dB re its greatest level, at 0.1 0.15 0.2 0.3 0.6 s")
    for title, changes in scenes:
        x = tw.render(score, guitar.replace(changes), max_duration=1.6).samples.mean(axis=1)
        level = _level(x * np.exp(-2j * np.pi * 220.0 / 48000 * np.arange(len(x))), 0.02)
        time = np.arange(len(x)) / 48000 - 0.1
        level -= level.max()
        axis.plot(time[::48], level[::48], label=title)
        print(f"{title:24s}" + "".join(f"{np.interp(t, time, level):7.1f}" for t in (0.1, 0.15, 0.2, 0.3, 0.6)))
    axis.set(xlim=(0, 1.4), ylim=(-50, 2), xlabel="s", ylabel="dB", title="A3 on the G string: first partial")
    axis.legend()
    figure.savefig(path / "playing_neighbours.png", dpi=70)


def others() -> None:
    """Pluck and dynamic range (frets lowered) from velocity 20 to 127, and the velocity that meets a fret."""
    heads = ("from bridge, mm", "release at 20", "and 127, us", "peak, dB", "share > 3 kHz", "first contact")
    print(f"{'instrument':16s}" + "".join(f"{head:>16s}" for head in heads))
    no_frets = {"connections.frets.action_first": 0.02, "connections.frets.action_twelfth": 0.03}
    for name in ("classical_guitar", "flamenco_guitar", "steel_guitar", "electric_bass", "african_harp"):
        made = tw.load_instrument(name)
        string = made.string_names[len(made.string_names) // 2]
        free = made.replace(no_frets) if made.attachments else made
        found = []
        for velocity in (20, 127):
            audio, release = _one_note(free, string, velocity)
            if made.spec.playing.exciter == "plectrum":
                release = np.nan  # a plectrum slips by its own motion
            x = audio[4800:19200]
            power, freq = np.abs(np.fft.rfft(x * np.hanning(len(x)))) ** 2, np.fft.rfftfreq(len(x), 1 / 48000)
            share = 10 * np.log10(power[freq > 3000].sum() / power.sum())
            found.append((1e6 * release, 20 * np.log10(np.abs(audio).max()), share))
        place = tw.Renderer(_single(string, 90), made).engine.timeline.plays[0].gesture.from_bridge or 0.0
        (slow, quiet, dark), (fast, loud, bright) = found
        met = [v for v in range(60, 128, 4) if made.attachments and _meets_a_fret(made, free, string, v)]
        first = f"velocity {met[0]}" if met else "none" if made.attachments else "no frets"
        numbers = 1e3 * place, slow, fast, loud - quiet, bright - dark
        print(f"{name:16s}" + "".join(f"{x:16.1f}" for x in numbers) + f"{first:>16s}")


def _single(string: str, velocity: int) -> tw.Score:
    return tw.Score([tw.Note(0.1, 1.0, string=string, stop=0, velocity_midi=velocity)])


def _one_note(instrument: tw.Instrument, string: str, velocity: int) -> tuple[Floats, float]:
    """Sound of 0.5 s, and release from 90 to 10 % of the force (s)."""
    renderer = tw.Renderer(_single(string, velocity), instrument, max_duration=0.5)
    audio = np.concatenate(list(renderer.blocks(4096))).mean(axis=1)
    gesture = renderer.engine.timeline.plays[0].gesture
    t = np.linspace(0.0, gesture.stop, 20001)
    f = course(gesture.segments, t)
    release = float(t[np.argmax(f < 0.1 * f[0])] - t[np.argmax(f < 0.9 * f[0])])
    return audio, release


def _meets_a_fret(made: tw.Instrument, free: tw.Instrument, string: str, velocity: int) -> bool:
    """Whether a note sounds otherwise than with frets out of reach."""
    near, far = (_one_note(instrument, string, velocity)[0] for instrument in (made, free))
    return bool(np.abs(near - far).max() > 1e-6 * np.abs(far).max())


def hands(path: Path) -> None:
    """Noises between notes: two shifts on the low E string, a stop and an end on the B string."""
    guitar = tw.load_instrument("classical_guitar")
    line = ((0.2, "E2", 1, 0.5), (0.7, "E2", 5, 0.5), (1.2, "E2", 3, 0.4), (1.8, "B3", 1, 0.3))
    score = tw.Score([tw.Note(t, d, string=s, stop=stop, velocity_midi=70) for t, s, stop, d in line])
    figure, axes = plt.subplots(1, 2, figsize=(13, 3.6), sharey=True, layout="constrained")
    for axis, on in zip(axes, (False, True), strict=True):
        x = tw.render(score, guitar, max_duration=2.4, noises=on).samples.mean(axis=1)
        _spectrogram(axis, x, 100)
        axis.set(title="with noises" if on else "without", ylim=(0, 9000), xlabel="s")
    axes[0].set_ylabel("Hz")
    figure.savefig(path / "playing_noises.png", dpi=70)


def piece(path: Path) -> None:
    """A piece by a ramp that is always the same, and by hands: spectrogram and level."""
    guitar = tw.load_instrument("classical_guitar")
    ramp = guitar.replace({"exciters.pluck": {"plugin": "pluck_ramp", "from_bridge": 0.105, "angle_deg": 30.0}})
    score = tw.read_score(Path(__file__).parents[1] / "examples" / "scores" / "romance.mid")
    figure, (first, second, below) = plt.subplots(3, 1, figsize=(12, 8), sharex=True, layout="constrained")
    scenes = ((first, "ramps", ramp, {}), (second, "hands", guitar, {"humanize": 1, "noises": True}))
    for axis, title, instrument, options in scenes:
        x = tw.render(score, instrument, max_duration=6.0, **options).samples.mean(axis=1)
        _spectrogram(axis, x, 90)
        axis.set(title=title, ylim=(0, 12000), ylabel="Hz")
        level = _level(x, 0.02)
        below.plot(np.arange(len(x))[::96] / 48000, level[::96] - level.max(), label=title, lw=0.9)
    below.set(xlim=(0, 6), ylim=(-25, 1), xlabel="s", ylabel="dB", title="level of 20 ms")
    below.legend()
    figure.savefig(path / "playing_piece.png", dpi=70)


def _spectrogram(axis: plt.Axes, x: Floats, span: float) -> None:
    """Levels down to `span` dB below the greatest."""
    _, _, _, image = axis.specgram(x / np.abs(x).max() + 1e-12, NFFT=1024, Fs=48000, noverlap=896, cmap="magma")
    top = image.get_array().max()
    image.set_clim(top - span, top)


def _level(x: NDArray[np.inexact], seconds: float) -> Floats:
    """Level of the mean (complex x) or of the square (real x) over some time, dB."""
    n = int(seconds * 48000)
    mean = np.convolve(x if np.iscomplexobj(x) else x**2, np.hanning(n) / np.hanning(n).sum(), "same")
    return (20 if np.iscomplexobj(x) else 10) * np.log10(np.abs(mean) + 1e-12)


if __name__ == "__main__":
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parents[1] / "docs" / "images"
    release(folder)
    attacks(folder)
    dynamics()
    others()
    neighbours(folder)
    hands(folder)
    piece(folder)
