"""Time of a piano's score, and the difference that strings make which nobody plays.

    python benchmarks/piano_rest.py [--score examples/scores/prelude.mid]

`grand_piano`, pedal up, eight notes in 3 s. Strings that are left out neither move nor load the bridge. The level is
the power of the difference of samples re that of the whole, then its largest sample re the loudest one, of the first
channel. Time is that of the process, all of it: notes, changes of dampers and hammers, steps.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Collection
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

import tonewood as tw
from tonewood.coupling.connections import SpringDashpot

FS = 48000.0
NOTES = (48, 55, 60, 64, 67, 72, 60, 64)


def rendered(piano: tw.Instrument, left_out: Collection[str]) -> tuple[NDArray[np.float64], float]:
    """First channel of the score without these strings, and s of computing."""
    notes = [tw.Note(0.1 + 0.3 * i, 0.28, note, velocity_midi=80) for i, note in enumerate(NOTES)]
    renderer = tw.Renderer(tw.Score(notes), piano, FS, max_duration=3.0)
    engine = renderer.engine
    joints = [c for c in engine.system.connections if c.role == "bridge" and c.owner in left_out]
    engine.system = engine.system.with_laws({c.name: replace(c, law=SpringDashpot()) for c in joints})
    engine.stepper.exchange(engine.system)
    start = time.process_time()
    blocks = [np.asarray(block, dtype=np.float64) for block in renderer.blocks()]
    return np.concatenate(blocks)[:, 0], time.process_time() - start


def time_of(path: str, seconds: float = 15.0) -> None:
    """Print how quickly the beginning of a score is computed, its model made beforehand."""
    renderer = tw.Renderer(tw.read_score(path), tw.load_instrument("grand_piano"), FS, max_duration=seconds)
    start = time.process_time()
    n = sum(len(block) for block in renderer.blocks())
    took = time.process_time() - start
    print(f"{path}: {n / FS:.1f} s of sound in {took:.2f} s, {n / FS / took:.2f} x real time")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--score", help="time the first 15 s of a score instead")
    if score := parser.parse_args().score:
        return time_of(score)
    piano = tw.load_instrument("grand_piano")
    strings = tw.Renderer(tw.Score([tw.Note(0.0, 0.1, 60)]), piano, FS).engine.model.strings
    played = {name for string in strings.values() if round(string.open_note) in NOTES for name in string.group}
    damped = {name for name, string in strings.items() if string.damper is not None}
    print("| left out | strings | us a sample | x real time | missing, dB | largest, dB |\n|---|---|---|---|---|---|")
    whole = np.zeros(0)
    for what, names in (
        ("nothing", set[str]()),
        ("under dampers, not played", damped - played),
        ("not played", strings.keys() - played),
    ):
        sound, took = rendered(piano, names)
        whole = whole if whole.size else sound
        n = min(len(whole), len(sound))
        off, us = sound[:n] - whole[:n], 1e6 * took / len(sound)
        power, most = np.sum(off**2) / np.sum(whole**2), np.max(np.abs(off)) / np.max(np.abs(whole))
        levels = f"{10 * np.log10(power):.1f} | {20 * np.log10(most):.1f}" if names else "- | -"
        print(f"| {what} | {len(names)} | {us:.1f} | {1e6 / FS / us:.2f} | {levels} |", flush=True)


if __name__ == "__main__":
    main()
