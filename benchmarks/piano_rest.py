"""Time of a piano's score, and the error of stand-ins for strings that are not played.

    python benchmarks/piano_rest.py [--notes dense | --score examples/scores/prelude.mid [--pedal 1.5]]

`grand_piano`, pedal up, 3 s: eight notes, or (dense) forty in two hands. Damped strings that are not played are
left out, or something simpler stands in their place:

* *left out*: they neither move nor load the bridge;
* *dashpot*: sqrt(T mu) of each string at its place of the bridge, the impedance of a string without reflections;
* *below f*: their modes below a frequency; the static compliance of the others goes into the residual;
* *one for three*: the unisons of a key in one string, sqrt(n) times as stiff and heavy, at the mean of their
  frequencies: exact for equal strings, which move alike if only the bridge moves them;
* *one for three, below f*: both.

All of them are passive. The level is the power of the difference of samples re that of the whole, then its largest
sample re the loudest one, of the first channel, without phantom partials. Time is that of the process, all of it:
notes, changes of dampers and hammers, steps. With `--score`: the effects `auto` against `all`, nothing left out by
hand.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Collection, Mapping
from dataclasses import replace
from typing import cast

import numpy as np
from numpy.typing import NDArray

import tonewood as tw
from tonewood.instrument.model.strings import StringModel
from tonewood.physics.coupling.connections import SpringDashpot
from tonewood.physics.coupling.system import System
from tonewood.physics.modal.modes import ModalBasis

FS = 48000.0
SPARSE = [(0.1 + 0.3 * i, note) for i, note in enumerate((48, 55, 60, 64, 67, 72, 60, 64))]
DENSE = [(0.1 + 0.07 * i, 41 + (7 * i) % 19 + 24 * (i % 2)) for i in range(40)]
#: system, its strings, those to replace -> the system with something in their place
Way = Callable[[System, Mapping[str, StringModel], Collection[str]], System]


def left_out(system: System, strings: Mapping[str, StringModel], names: Collection[str]) -> System:
    """Nothing in their place."""
    joints = [c for c in system.connections if c.role == "bridge" and c.owner in names]
    return system.with_laws({c.name: replace(c, law=SpringDashpot()) for c in joints})


def dashpots(system: System, strings: Mapping[str, StringModel], names: Collection[str]) -> System:
    """Their wave impedance."""
    laws, bases = {}, {}
    for c in system.connections:
        if c.role == "bridge" and c.owner in names:
            component = strings[c.owner].components[0]
            basis = system.compiled[system.slot(component)].basis
            density = cast(float, basis.metadata["linear_density"])
            impedance = np.sqrt(strings[c.owner].tension(0) * density)
            laws[c.name] = replace(c, law=SpringDashpot(damping=float(impedance)))
            bases[component] = basis.select(np.zeros(0, dtype=np.intp), fold=False)
    return exchanged(system, bases).with_laws(laws)


def below(freq: float) -> Way:
    """Their modes below a frequency."""

    def way(system: System, strings: Mapping[str, StringModel], names: Collection[str]) -> System:
        bases = {c: system.compiled[system.slot(c)].basis for name in names for c in strings[name].components}
        return exchanged(system, {c: basis.select(basis.natural_freq < freq) for c, basis in bases.items()})

    return way


def one_for_three(system: System, strings: Mapping[str, StringModel], names: Collection[str]) -> System:
    """One string a key."""
    bases, others = {}, set[str]()
    for name in names:
        group = strings[name].group
        if name != group[0]:
            continue
        others |= set(group[1:])
        each = [system.compiled[system.slot(strings[member].components[0])].basis for member in group]
        n = min(basis.n_modes for basis in each)
        first, share = each[0].select(np.arange(n)), 1 / np.sqrt(len(group))
        freq_rad = np.mean([np.sqrt(basis.stiffness[:n]) for basis in each], axis=0)
        merged = ModalBasis.real(
            freq_rad,
            first.damping_rate,
            {point: share * first.right[i].real for i, point in enumerate(first.points)},
            residual=first.residual * share**2,
            metadata=first.metadata,
        )
        bases[strings[name].components[0]] = merged
    return left_out(exchanged(system, bases), strings, others)


def both(freq: float) -> Way:
    """One string a key, and its modes below a frequency."""
    return lambda system, strings, names: below(freq)(one_for_three(system, strings, names), strings, names)


def exchanged(system: System, bases: Mapping[str, ModalBasis]) -> System:
    """A system with these bases."""
    return system.with_compiled({name: system.compile(name, basis) for name, basis in bases.items()})


def rendered(
    piano: tw.Instrument, played: list[tuple[float, int]], way: Way | None, names: Collection[str]
) -> tuple[NDArray[np.float64], float]:
    """First channel of the score with a way of leaving strings out, and s of computing."""
    notes = [tw.Note(start, 0.28, note, velocity_midi=80) for start, note in played]
    renderer = tw.Renderer(tw.Score(notes), piano, FS, max_duration=3.0, effects="all")
    engine = renderer.engine
    engine.system = engine.system.with_potentials(())
    if way is not None:
        engine.system = way(engine.system, engine.model.strings, names)
    engine.stepper.exchange(engine.system)
    start = time.process_time()
    blocks = [np.asarray(block, dtype=np.float64) for block in renderer.blocks()]
    return np.concatenate(blocks)[:, 0], time.process_time() - start


def pedalled(score: tw.Score, seconds: float) -> tw.Score:
    """The score with the sustain pedal down, changed every `seconds`."""
    controls = []
    for i in range(int(score.duration / seconds) + 1):
        controls += [tw.Control(i * seconds, "cc64", 0.0), tw.Control(i * seconds + 0.1, "cc64", 1.0)]
    return replace(score, controls=controls)


def time_of(path: str, pedal: float, seconds: float) -> None:
    """Print how quickly the beginning of a score is computed with the effects `auto` and `all`, and the difference.

    Models are made beforehand; both take turns, the lesser time of two counts.
    """
    score, piano = tw.read_score(path), tw.load_instrument("grand_piano")
    if pedal:
        score = pedalled(score, pedal)
    took, sounds = {"auto": np.inf, "all": np.inf}, {}
    for _ in range(2):
        for mode in took:
            renderer = tw.Renderer(score, piano, FS, max_duration=seconds, effects=mode)
            start = time.process_time()
            sounds[mode] = np.concatenate([np.asarray(block, dtype=np.float64) for block in renderer.blocks()])
            took[mode] = min(took[mode], time.process_time() - start)
            if mode == "auto":
                report = [e for e in renderer.summary().effects if e.bound is not None and e.unit == "dB"]
    n = min(len(sound) for sound in sounds.values())
    whole = sounds["all"][:n]
    off = sounds["auto"][:n] - whole
    power, most = np.sum(off**2) / np.sum(whole**2), np.max(np.abs(off)) / np.max(np.abs(whole))
    for mode, each in took.items():
        print(f"{mode}: {n / FS:.1f} s of sound in {each:.2f} s, {n / FS / each:.2f} x real time")
    print(f"all / auto {took['all'] / took['auto']:.2f}; missing {10 * np.log10(power):.1f} dB in power, ", end="")
    print(f"{20 * np.log10(most):.1f} dB in the largest sample")
    for effect in sorted({e.name for e in report}):
        each = [e for e in report if e.name == effect]
        ran = sum(e.seconds_active for e in each) / (len(each) * n / FS)
        worst = max(cast(float, e.bound) for e in each)
        print(f"{effect}: {len(each)} strings, on {100 * ran:.1f} % of the time, bound {worst:.1f} dB at most")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--score", help="compare effects in the first seconds of a score instead")
    parser.add_argument("--seconds", type=float, default=15.0, help="of the score")
    parser.add_argument("--pedal", type=float, default=0.0, help="s between changes of a pedal that is down; 0: up")
    parser.add_argument("--notes", choices=("sparse", "dense"), default="sparse")
    args = parser.parse_args()
    if args.score:
        return time_of(args.score, args.pedal, args.seconds)
    score = SPARSE if args.notes == "sparse" else DENSE
    pitches = {note for _, note in score}
    piano = tw.load_instrument("grand_piano")
    strings = tw.Renderer(tw.Score([tw.Note(0.0, 0.1, 60)]), piano, FS).engine.model.strings
    played = {name for string in strings.values() if round(string.open_note) in pitches for name in string.group}
    damped = {name for name, string in strings.items() if string.places.damper is not None} - played
    ways: list[tuple[str, Way | None, Collection[str]]] = [
        ("nothing", None, ()),
        ("not played: left out", left_out, strings.keys() - played),
        ("under dampers: left out", left_out, damped),
        ("dashpot", dashpots, damped),
        ("below 500 Hz", below(500.0), damped),
        ("below 1 kHz", below(1000.0), damped),
        ("below 3 kHz", below(3000.0), damped),
        ("below 6 kHz", below(6000.0), damped),
        ("below 9 kHz", below(9000.0), damped),
        ("one for three", one_for_three, damped),
        ("one for three, below 3 kHz", both(3000.0), damped),
    ]
    print("| in place of strings | of them | us a sample | times quicker | missing, dB | largest, dB |")
    print("|---|---|---|---|---|---|")
    whole, all_us = np.zeros(0), 0.0
    for what, way, names in ways:
        sound, took = rendered(piano, score, way, names)
        n, us = len(sound), 1e6 * took / len(sound)
        if way is None:
            whole, all_us = sound, us
        n = min(n, len(whole))
        off = sound[:n] - whole[:n]
        power, most = np.sum(off**2) / np.sum(whole**2), np.max(np.abs(off)) / np.max(np.abs(whole))
        levels = f"{10 * np.log10(power):.1f} | {20 * np.log10(most):.1f}" if names else "- | -"
        print(f"| {what} | {len(names)} | {us:.1f} | {all_us / us:.2f} | {levels} |", flush=True)


if __name__ == "__main__":
    main()
