"""Cost of slides over buzzing frets, as a multiple of the linear engine playing the same notes in the same run.

    python benchmarks/slides.py [--force 50] [--rounds 3]

Six strings of `steel_strings`, frets low enough that the strings buzz. Each string is plucked with --force N at its
second stop, slides to its seventh and back to its third, and is plucked again; 2.5 s of sound at 48 kHz. The linear
instrument has neither frets nor rising tensions. The scenes take turns, a block each, on one core; a row has the least
processor time of the rounds per second of sound, over that of the linear one and over the steps of the linear one
alone, the share of it in steps, and the counters of the solver of contacts. Most of the linear one's time goes to the
bases of strings whose stops change.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass

import tonewood as tw
from tonewood.physics.stepping.kernel import instruction_set

FS, SECONDS = 48000, 2.5
LINEAR = ["second_polarization", "dampers"]
#: clearances at which the strings buzz
LOW = {"plugin": "frets", "action_first": 2.5e-4, "action_twelfth": 1.2e-3}


@dataclass(frozen=True, eq=False)
class Scene:
    """An instrument, and which of its effects run."""

    instrument: tw.Instrument
    effects: str | list[str]


@dataclass(eq=False)
class Spent:
    """Processor time of a render and of its steps, s; solves, iterations, and steps made again without the kernel."""

    whole: float = 0.0
    stepping: float = 0.0
    solves: int = 0
    iterations: int = 0
    redone: int = 0


def scenes() -> dict[str, Scene]:
    """The linear instrument, and it with frets, with rising tensions and with both."""
    guitar = tw.load_instrument("steel_strings")
    buzzing = tw.Instrument.from_values({**guitar.resolved, "connections": {"frets": LOW}}, guitar.folder)
    return {
        "linear": Scene(guitar, LINEAR),
        "frets buzzing": Scene(buzzing, [*LINEAR, "frets"]),
        "rising tensions": Scene(guitar, [*LINEAR, "tension_modulation"]),
        "rising tensions, frets buzzing": Scene(buzzing, [*LINEAR, "frets", "tension_modulation"]),
        "the same, stopped by soft fingers": Scene(buzzing.replace({"stops.model": "finger"}), "all"),
    }


def score(force: float) -> tw.Score:
    """Slides on all strings, the strings 20 ms apart."""
    notes = []
    for i, string in enumerate(("E2", "A2", "D3", "G3", "B3", "E4")):
        for start, stop, technique in ((0.05, 2, None), (0.6, 7, "slide"), (1.2, 3, "slide"), (1.8, 5, None)):
            notes.append(tw.Note(start + 0.02 * i, 0.6, string=string, stop=stop, force=force, technique=technique))
    return tw.Score(notes)


def played(all_: dict[str, Scene], notes: tw.Score) -> dict[str, Spent]:
    """Render the scenes, a block of each in turn."""
    renderers = {
        k: tw.Renderer(notes, s.instrument, FS, max_duration=SECONDS, effects=s.effects) for k, s in all_.items()
    }
    streams = {k: r.blocks(4096) for k, r in renderers.items()}
    spent = {k: Spent() for k in all_}
    while streams:
        for name in list(streams):
            began = time.thread_time()
            if next(streams[name], None) is None:
                del streams[name]
            spent[name].whole += time.thread_time() - began
    for name, renderer in renderers.items():
        found, own = renderer.engine.stepper.statistics, spent[name]
        own.stepping = renderer.engine.counters.stepping_s
        own.solves, own.iterations, own.redone = found.solves, found.iterations, found.redone
    return spent


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--force", type=float, default=50.0)
    parser.add_argument("--rounds", type=int, default=3)
    args = parser.parse_args()
    all_, notes = scenes(), score(args.force)
    least: dict[str, Spent] = {}
    for _ in range(args.rounds):
        for name, spent in played(all_, notes).items():
            if name not in least or spent.whole < least[name].whole:
                least[name] = spent
    print(f"{args.force:g} N, {FS} Hz, one core, {instruction_set()}, {SECONDS:g} s of sound\n")
    print("| scene | s per s | / linear | / its steps | steps | solves | iterations a solve | steps made again |")
    print("|---|---:|---:|---:|---:|---:|---:|---:|")
    linear = least["linear"]
    for name, s in least.items():
        print(
            f"| {name} | {s.whole / SECONDS:.3g} | {s.whole / linear.whole:.1f} | {s.whole / linear.stepping:.0f} "
            f"| {100 * s.stepping / s.whole:.0f} % | {s.solves} | {s.iterations / max(s.solves, 1):.1f} | {s.redone} |"
        )


if __name__ == "__main__":
    main()
