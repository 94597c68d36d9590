"""Time saved and error made by leaving effects out: one table over scores and instruments.

    python benchmarks/effects.py SCORE.mid ... [--seconds 8] [--instruments steel_strings african_harp]

Each score, or its first seconds, is rendered with effects `all`, `auto` and none but the second polarization (linear),
a block of each in turn, on one core; times are seconds of the processor. `nylon_guitar` is the classical guitar with
all there is: rising tensions and frets; `steel_strings` is taken with frets, too. With `_longitudinal` after their
names the longitudinal motion of their strings is coupled, too: ten times slower than they sound.
Errors are those of `auto` against `all`: the largest sample difference with rising tension always on, over the first
seconds, in dB re the peak (additive effects alone), and by how much the fundamentals of the notes are off while they
sound, in cents: 95 % of the windows of 50 ms in which they are within 20 dB of their loudest, and the note that is off
most in the mean of its power. They are followed in the force of the note's own string on its bridge: in the sound,
partials of two strings at one frequency beat, and the pitch of both together is ill-defined. `plan` is the predicted
time of `auto` over the real one. Rows are printed as they are done; Ctrl-C leaves it at those.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.signal import firwin, lfilter, oaconvolve

import tonewood as tw

Floats = NDArray[np.float64]
FS = 48000
#: reached by loud plucks only: a string that grazes a fret magnifies earlier differences
FRETS = {"frets": {"plugin": "frets", "action_first": 1.5e-3, "action_twelfth": 4e-3}}
LINEAR = ["second_polarization", "dampers"]
#: seconds over which samples are compared
SAMPLES = 3.0
#: forces of strings are kept at every so many samples, below a third of the rate that leaves
COARSE = 8
LOW_PASS = firwin(127, 2000.0, fs=FS)


#: Pa, of nylon: with a string's bending stiffness E pi r^4 / 4 it gives its axial stiffness E pi r^2
NYLON = 5e9


def instrument(name: str) -> tw.Instrument:
    """A bundle, the steel-string guitar with frets if it has none, the classical guitar with all there is."""
    if (plain_name := name.removesuffix("_longitudinal")) != name:
        made = instrument(plain_name)
        return made.replace({"strings.*.plugin": "geometric_string"})
    if name == "nylon_guitar":
        plain = tw.load_instrument("classical_guitar")
        values = {**plain.resolved, "connections": FRETS}
        values["strings"] = {
            string: {
                **part,
                "plugin": "tension_modulated_string",
                "axial_stiffness": float(np.sqrt(4 * np.pi * NYLON * part["bending_stiffness"])),
            }
            for string, part in values["strings"].items()
        }
        return tw.Instrument.from_values(values, plain.folder)
    found = tw.load_instrument(name)
    if name != "steel_strings" or found.attachments:
        return found
    return tw.Instrument.from_values({**found.resolved, "connections": FRETS}, found.folder)


class Listened:
    """A render, of which are kept: sound, and every string's force on its bridge at a lower rate.

    Parameters
    ----------
    score, made : the score and the instrument; further options are those of a renderer.
    seconds : how much of it; None is all.
    strings : keep their forces.
    """

    def __init__(
        self, score: tw.Score, made: tw.Instrument, seconds: float | None, *, strings: bool = True, **options: object
    ):
        self.renderer = tw.Renderer(score, made, FS, max_duration=seconds, tail=2.0, **options)  # type: ignore[arg-type]  # options are those of a renderer
        self.sound: list[NDArray[np.float32]] = []
        self.forces: list[NDArray[np.float32]] = []
        self.seconds = 0.0
        engine = self.renderer.engine
        if strings:
            stepper, step = engine.stepper, engine.stepper._step
            names = [f"{s.components[0]}.bridge" for s in engine.model.strings.values()]
            places = [[c.name for c in engine.system.connections].index(name) for name in names]
            self._memory, self._count = np.zeros((len(LOW_PASS) - 1, len(names))), 0

            def kept(*args: Any) -> tuple[Floats, Floats, Floats | None]:
                sound, linear, others = step(*args)
                began = time.thread_time()
                self._keep(linear[:, np.searchsorted(stepper._active, places)])
                self.seconds -= time.thread_time() - began
                return sound, linear, others

            stepper._step = kept  # type: ignore[method-assign]  # watched, not changed
        self._blocks = self.renderer.blocks(4096)

    def _keep(self, forces: Floats) -> None:
        """Every COARSE-th sample after a low pass."""
        low, self._memory = lfilter(LOW_PASS, 1.0, forces, axis=0, zi=self._memory)
        self.forces.append(low[-self._count % COARSE :: COARSE].astype(np.float32))
        self._count += len(forces)

    def advance(self) -> bool:
        """Render the next block and count its time; False at the end."""
        began = time.thread_time()
        block = next(self._blocks, None)
        self.seconds += time.thread_time() - began
        if block is not None:
            self.sound.append(block[:, 0].astype(np.float32))
        return block is not None


def rendered(
    score: tw.Score, made: tw.Instrument, seconds: float | None, **options: Any
) -> tuple[Floats, tw.Renderer, float]:
    """Sound, renderer and seconds of the processor."""
    one = Listened(score, made, seconds, strings=False, **options)
    while one.advance():
        pass
    return np.concatenate(one.sound).astype(float), one.renderer, one.seconds


def partial(y: Floats, freq: float, fs: float, width: float = 0.04) -> NDArray[np.complex128]:
    t = np.arange(-3 * width, 3 * width, 1 / fs)
    window = np.exp(-0.5 * (t / width) ** 2)
    carrier = np.exp(-2j * np.pi * freq * np.arange(len(y)) / fs)
    return np.asarray(oaconvolve(y * carrier, window / window.sum(), mode="same"))


def detuning(a: Floats, b: Floats, freq: float) -> tuple[Floats, float]:
    """Cents by which the fundamental of a note differs while it sounds: in all windows in which it is strong, and in
    the mean, weighted by power.
    """
    fs = FS / COARSE
    step = round(fs / 20)
    if len(a) < fs / 4:
        return np.zeros(0), 0.0
    x, y = (partial(s, freq, fs)[step:-step:step] for s in (a, b))
    turn = np.angle(y[1:] * np.conj(x[1:]) * np.conj(y[:-1] * np.conj(x[:-1])))
    cents = turn * fs / (2 * np.pi * freq * step) * 1200 / np.log(2)
    power = abs(x[1:] * y[:-1])
    strong = np.minimum(abs(x), abs(y)) > 0.1 * abs(x).max()
    return abs(cents[strong[1:] & strong[:-1]]), abs(float(power @ cents)) / max(float(power.sum()), 1e-300)


def row(score: tw.Score, made: tw.Instrument, seconds: float | None, predict: bool, progress: Progress) -> str:
    """One line of the table; the three renders take turns, a block at a time."""
    auto, every = (Listened(score, made, seconds, effects=mode) for mode in ("auto", "all"))
    linear = Listened(score, made, seconds, strings=False, effects=LINEAR)
    going = [auto, every, linear]
    while going:
        going = [one for one in going if one.advance()]
        progress(auto.renderer.time)
    stream, strings = auto.renderer, auto.renderer.model.strings
    a, b = (np.concatenate(one.forces) for one in (auto, every))
    windows, worst, fs = [np.zeros(1)], 0.0, FS / COARSE
    start = stream.performance.timeline.start
    for p in stream.performance.notes:
        here = slice(round((p.note.time - start) * fs), min(round((p.end - start) * fs), len(a), len(b)))
        column = list(strings).index(p.string)
        cents, mean = detuning(a[here, column], b[here, column], strings[p.string].freq(p.stop))
        windows.append(cents)
        worst = max(worst, mean)
    exact = rendered(score, made, SAMPLES if seconds is None else min(SAMPLES, seconds), budget_cents=0.0)[0]
    whole = np.concatenate(every.sound)
    m = min(len(exact), len(whole))
    difference = float(abs(exact[:m] - whole[:m]).max() / abs(whole[:m]).max())
    db = f"{20 * np.log10(difference):.0f}" if difference > 0 else "same bits"
    on = [r.seconds_active for r in stream.summary().effects if r.name == "tension_modulation"]
    duration = stream.summary().duration_s
    share = f"{100 * np.mean(on) / duration:.0f} %" if on else "-"
    foreseen = "-"
    if predict:
        plan = tw.plan(score, made, FS, max_duration=seconds, tail=2.0)
        foreseen = f"{plan.predicted_s / auto.seconds:.2f}"
    all_cents = np.concatenate(windows)
    return (
        f"{duration:.0f} | {auto.seconds:.1f} | {every.seconds / auto.seconds:.2f} "
        f"| {auto.seconds / linear.seconds:.2f} | {share} "
        f"| {db} | {np.quantile(all_cents, 0.95):.3f} | {worst:.2f} | {foreseen}"
    )


class Progress:
    """Says how far it is, on one line of the error stream, if that is a terminal or a file that is watched."""

    def __init__(self, what: str):
        self.what, self._next = what, 0.0

    def __call__(self, seconds: float) -> None:
        if time.perf_counter() >= self._next:
            self._next = time.perf_counter() + 1.0
            print(f"\r{self.what}: {seconds:.0f} s ", end="", file=sys.stderr, flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scores", nargs="*", type=Path)
    parser.add_argument("--seconds", type=float, default=None, help="of each score; all of it where left out")
    parser.add_argument("--instruments", nargs="+", default=["nylon_guitar", "steel_strings", "african_harp"])
    parser.add_argument("--no-plan", action="store_true")
    args = parser.parse_args()
    began = time.perf_counter()
    columns = [
        "instrument",
        "score",
        "s",
        "auto, s",
        "all / auto",
        "auto / linear",
        "tension on",
        "dB",
        "cents 95 %",
        "worst note",
        "plan",
    ]
    print(f"| {' | '.join(columns)} |\n|{'---|' * len(columns)}")
    for name in args.instruments:
        made = instrument(name)
        try:
            tw.Renderer(tw.Score([tw.Note(0.0, note=60)]), made, FS, effects="all")
        except tw.TonewoodError as fault:
            print(f"| {name} without frets: {fault} |{' |' * (len(columns) - 1)}")
            made = tw.load_instrument(name)
        for path in args.scores:
            progress = Progress(f"{name} {path.stem}")
            line = row(tw.read_midi(path), made, args.seconds, not args.no_plan, progress)
            print("\r", end="", file=sys.stderr)
            print(f"| {name} | {path.stem} | {line} |", flush=True)
    print(f"\n{time.perf_counter() - began:.0f} s in all")


if __name__ == "__main__":
    try:
        main()
    except KeyboardInterrupt:
        print("\nstopped: the rows above are whole")
        sys.exit(130)
