"""Ten minutes of random playing on an instrument played live, against the clock of a sound card that is not there.

python benchmarks/live.py [INSTRUMENT] [--minutes 10] [--block 128] [--ahead 4] [--runs 1]

Keys of a random player come singly and in chords of up to six notes, with bends, the pedal and controller 74. Every
block is computed at once and timed by the processor's clock of the thread; on a shared machine other programs still
slow it, so that of several runs, which compute the same, the least cost of each block counts. The
card takes a block every block / fs seconds; `ahead` blocks may be ready. Block k is late, an underrun, where

    t_k = max(t_(k-1), (k - ahead) T) + cost_k  >  k T + (ahead + 1) T.
"""

from __future__ import annotations

import argparse
import cProfile
import gc
import pstats
import tracemalloc
from pathlib import Path
from time import thread_time

import numpy as np

import tonewood as tw


def late_blocks(costs: np.ndarray, length: float, ahead: int) -> tuple[int, float]:
    """Number of blocks that are ready too late, and the least time left before one was needed (s)."""
    ready, late, least = 0.0, 0, np.inf
    for k, cost in enumerate(costs):
        # the place of block k is free when the card takes block k - ahead
        ready = max(ready, (k - ahead) * length) + cost
        left = (k + 1) * length - ready if k >= ahead + 1 else np.inf
        if left < 0:
            late += 1
            ready = (k + 1) * length
        least = min(least, left)
    return late, least


def resident_mb() -> float:
    """Memory of this process now, MB."""
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * 4096 / 2**20


class RandomPlayer:
    """Plays some keys per second, holds each for a while, and moves wheels and pedals."""

    def __init__(self, live: tw.Live, seed: int, rate: float = 8.0):
        strings = live.model.strings.values()
        self.low = min(s.open_note for s in strings)
        self.high = max(s.open_note + s.n_stops for s in strings)
        self.live, self.rng, self.rate = live, np.random.default_rng(seed), rate
        self.held: list[tuple[float, float]] = []

    def before(self, seconds: float) -> None:
        """Play the messages of the next seconds."""
        live, rng = self.live, self.rng
        if rng.random() < self.rate * seconds:
            for _ in range(1 if rng.random() < 0.8 else rng.integers(2, 7)):
                note = float(rng.integers(self.low, self.high + 1))
                live.note_on(note, float(rng.integers(1, 128)))
                self.held.append((live.time + rng.exponential(0.5), note))
        for until, note in [held for held in self.held if held[0] < live.time]:
            live.note_off(note)
            self.held.remove((until, note))
        if rng.random() < 0.5 * seconds:
            live.control(64, float(rng.random() < 0.3))
        if rng.random() < 0.2 * seconds:
            live.control(74, float(rng.random()))
        if live.time % 10.0 < 3.5 and rng.random() < 50 * seconds:
            live.bend(60.0 * np.sin(2 * np.pi * 5 * live.time) if live.time % 10.0 < 3.0 else 0.0)


def trace(instrument: str, block: int, worst: int) -> None:
    """Play again up to a block, and print which functions took its time."""
    live = tw.Live(instrument)
    player, length = RandomPlayer(live, 1), block / live.fs
    for _ in range(worst):
        player.before(length)
        live.process(block)
    profile = cProfile.Profile(thread_time)
    profile.enable()
    player.before(length)
    live.process(block)
    profile.disable()
    print(f"  the worst block, number {worst}, with the profiler's own cost:")
    found = pstats.Stats(profile).stats.items()  # type: ignore[attr-defined]  # untyped
    for (file, _, name), (_, calls, own, whole, _) in sorted(found, key=lambda item: -item[1][3])[:16]:
        print(f"    {1e3 * whole:6.2f} ms, own {1e3 * own:5.2f}, {calls:4d} x {Path(file).name}:{name}")


def play(instrument: str, minutes: float, block: int) -> tuple[tw.Live, RandomPlayer, np.ndarray, list[float]]:
    """Play; returns the cost of each block in s, and the memory at the beginning and after each tenth in MB."""
    live = tw.Live(instrument)
    player = RandomPlayer(live, 1)
    length = block / live.fs
    n = round(60 * minutes / length)
    gc.collect()
    costs, memory = np.zeros(n), []
    for k in range(n):
        if k % max(n // 10, 1) == 0:
            memory.append(resident_mb())
        began = thread_time()
        player.before(length)
        live.process(block)
        costs[k] = thread_time() - began
    memory.append(resident_mb())
    return live, player, costs, memory


def main() -> None:
    """Print costs, underruns and memory."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("instrument", nargs="?", default="classical_guitar")
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--block", type=int, default=128)
    parser.add_argument("--ahead", type=int, default=4)
    parser.add_argument("--runs", type=int, default=1, help="the same blocks again; of each the least cost counts")
    parser.add_argument("--trace", action="store_true", help="which functions took the time of the worst block")
    given = parser.parse_args()
    gc.disable()  # as a session does: playing makes no cycles
    live, player, costs, memory = play(given.instrument, given.minutes, given.block)
    for _ in range(given.runs - 1):  # memory is that of the first: later ones begin with what it left
        live, player, again, _ = play(given.instrument, given.minutes, given.block)
        costs = np.minimum(costs, again)
    length = given.block / live.fs
    summary = live.summary()
    print(f"{given.instrument}: {given.minutes:g} min at {live.fs} Hz, blocks of {given.block} ({1e3 * length:.2f} ms)")
    print(f"  {summary.notes} notes, {summary.cut} cut by others, {sum(summary.dropped.values())} dropped")
    shares = np.percentile(costs, [50, 99, 99.9, 100]) * 1e3
    print(
        f"  load {100 * costs.mean() / length:.0f} %; block: median {shares[0]:.2f} ms, 99 % {shares[1]:.2f}, ", end=""
    )
    print(f"99.9 % {shares[2]:.2f}, worst {shares[3]:.2f} ms")
    if given.trace:
        trace(given.instrument, given.block, int(costs.argmax()))
    for ahead in sorted({1, 2, 3, 4, given.ahead}):
        late, least = late_blocks(costs, length, ahead)
        latency = (ahead + 2) * length + live.latency
        print(f"  {ahead} ahead: {late} underruns, {1e3 * least:+.2f} ms to spare, latency {1e3 * latency:.1f} ms")
    print(
        f"  memory {memory[0]:.0f} MB at first, " + ", ".join(f"{m:.0f}" for m in memory[1:]) + " MB after each tenth"
    )
    tracemalloc.start()
    for _ in range(2):
        before = tracemalloc.get_traced_memory()[0]
        for _ in range(1000):
            player.before(length)
            live.process(given.block)
        gc.collect()
        kept = tracemalloc.get_traced_memory()[0] - before
    print(f"  kept by 1000 further blocks: {kept / 1024:.0f} kB")


if __name__ == "__main__":
    main()
