"""What leaving effects out saves and costs: one table over scores and instruments.

    python benchmarks/effects.py SCORE.mid ... [--seconds 8] [--instruments steel_guitar african_harp]

Each score's first seconds are rendered with effects `all`, `auto` and none but the second polarization (linear), in
turn, on one core; times are those of stepping, in seconds of the processor. `nylon_guitar` is the classical guitar with
all there is: rising tensions and frets; `steel_guitar` is taken with frets, too. `awake` is the share of modes stepped.
Errors are those of `auto` against `all`: the largest sample difference with rising tension always on, in dB re the peak
(additive effects alone), and by how much the fundamentals of the notes are off while they sound, in cents: 95 % of the
windows of 50 ms in which they are within 20 dB of their loudest (where they beat with another string's partial, the
pitch of both together is ill-defined), and the note that is off most in the mean of its power. `plan` is the predicted
time of `auto` over the real one.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.signal import oaconvolve

import tonewood as tw

Floats = NDArray[np.float64]
FS = 48000
#: reached by loud plucks only: a string that grazes a fret magnifies what was different before
FRETS = {"frets": {"plugin": "frets", "action_first": 1.5e-3, "action_twelfth": 4e-3}}
LINEAR = ["second_polarization", "dampers"]
#: seconds over which samples are compared
SAMPLES = 3.0


#: Pa, of nylon: with a string's bending stiffness E pi r^4 / 4 it gives its axial stiffness E pi r^2
NYLON = 5e9


def instrument(name: str) -> tw.Instrument:
    """A bundle, the steel-string guitar with frets if it has none, the classical guitar with all there is."""
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
    if name != "steel_guitar" or found.attachments:
        return found
    return tw.Instrument.from_values({**found.resolved, "connections": FRETS}, found.folder)


def rendered(
    score: tw.Score, made: tw.Instrument, seconds: float, **options: object
) -> tuple[Floats, tw.Renderer, float]:
    """Sound, renderer and seconds of the processor."""
    renderer = tw.Renderer(score, made, FS, max_duration=seconds, tail=tw.Tail(cap=2.0), **options)  # type: ignore[arg-type]  # options are those of a renderer
    began = time.thread_time()
    blocks = list(renderer.blocks(4096))
    return np.concatenate(blocks)[:, 0], renderer, time.thread_time() - began


def partial(y: Floats, freq: float, width: float = 0.04) -> NDArray[np.complex128]:
    t = np.arange(-3 * width, 3 * width, 1 / FS)
    window = np.exp(-0.5 * (t / width) ** 2)
    carrier = np.exp(-2j * np.pi * freq * np.arange(len(y)) / FS)
    return np.asarray(oaconvolve(y * carrier, window / window.sum(), mode="same"))


def detuning(a: Floats, b: Floats, notes: list[tuple[float, float, float]]) -> tuple[Floats, Floats]:
    """Cents by which the fundamentals of notes (Hz, from and to s) differ: in all windows in which they are strong, and
    of each note in the mean, weighted by power.
    """
    out, means, step = [np.zeros(1)], [0.0], FS // 20
    for freq, start, stop in notes:
        here = slice(round(start * FS), min(round(stop * FS), len(a)))
        if here.stop - here.start < FS // 4:
            continue
        x, y = (partial(s[here], freq)[step:-step:step] for s in (a, b))
        turn = np.angle(y[1:] * np.conj(x[1:]) * np.conj(y[:-1] * np.conj(x[:-1])))
        cents = turn * FS / (2 * np.pi * freq * step) * 1200 / np.log(2)
        power = abs(x[1:] * y[:-1])
        strong = np.minimum(abs(x), abs(y)) > 0.1 * abs(x).max()
        out.append(abs(cents[strong[1:] & strong[:-1]]))
        means.append(abs(float(power @ cents)) / float(power.sum()))
    return np.concatenate(out), np.array(means)


def row(score: tw.Score, made: tw.Instrument, seconds: float, predict: bool) -> str:
    auto, stream, t_auto = rendered(score, made, seconds, effects="auto")
    every, _, t_all = rendered(score, made, seconds, effects="all")
    *_, t_linear = rendered(score, made, seconds, effects=LINEAR)
    n = min(len(auto), len(every))
    strings = stream.model.strings
    notes = [(strings[p.string].freq(p.stop), p.note.time, p.end) for p in stream.performance.notes]
    cents, means = detuning(every[:n], auto[:n], notes)
    short = min(SAMPLES, seconds)
    exact = rendered(score, made, short, effects="auto", budget_cents=0.0)[0]
    m = min(len(exact), n)
    difference = float(abs(exact[:m] - every[:m]).max() / abs(every[:m]).max())
    db = f"{20 * np.log10(difference):.0f}" if difference > 0 else "same bits"
    ledger = stream.engine.ledger
    awake = ledger.mode_samples / ledger.samples / stream.model.n_modes
    on = [r.seconds_active for r in stream.summary().effects if r.name == "tension_modulation"]
    share = f"{100 * np.mean(on) / stream.summary().duration_s:.0f} %" if on else "-"
    foreseen = "-"
    if predict:
        plan = tw.plan(score, made, FS, max_duration=seconds, tail=tw.Tail(cap=2.0))
        foreseen = f"{plan.predicted_s / t_auto:.2f}"
    return (
        f"{n / FS:.0f} | {t_auto:.1f} | {t_all / t_auto:.2f} | {t_auto / t_linear:.2f} | {share} | {100 * awake:.0f} % "
        f"| {db} | {np.quantile(cents, 0.95):.3f} | {means.max():.2f} | {foreseen}"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scores", nargs="+", type=Path)
    parser.add_argument("--seconds", type=float, default=8.0)
    parser.add_argument("--instruments", nargs="+", default=["nylon_guitar", "steel_guitar", "african_harp"])
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
        "awake",
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
            print(
                f"| {name} | {path.stem} | {row(tw.read_midi(path), made, args.seconds, not args.no_plan)} |",
                flush=True,
            )
    print(f"\n{time.perf_counter() - began:.0f} s in all")


if __name__ == "__main__":
    main()
