"""Time that noises of hands take: one piece with and without them.

    python benchmarks/hand_noises.py SCORE.mid [--instrument classical_guitar] [--seconds 20] [--repeats 9]

The piece is rendered with and without `playing.noises.on`, both with human variation, a block of each in turn, on one
core. Each block of output is computed anew in every repeat; of its processor times the least is taken, and these are
added up, so that other work on the machine counts little. `stepping` is the time of the kernel, `between` all that is
done between runs: bases, gestures, loading the kernel.
"""

from __future__ import annotations

import argparse
import time
from collections import Counter

import numpy as np
from numpy.typing import NDArray

import tonewood as tw
from tonewood.performance.player.playing import perform
from tonewood.support.blas import one_blas_thread

BLOCK = 4096


@one_blas_thread
def once(score: tw.Score, instruments: list[tw.Instrument], seconds: float) -> NDArray[np.float64]:
    """(n_instruments, 3, n_blocks) s of the processor: all, of it stepping, of it between; a block of each in turn."""
    renderers = [tw.Renderer(score, i, max_duration=seconds) for i in instruments]
    counters = [renderer.engine.counters for renderer in renderers]
    blocks = [renderer.blocks(BLOCK) for renderer in renderers]
    out: list[list[tuple[float, float, float]]] = [[] for _ in renderers]
    while True:
        for count, piece, times in zip(counters, blocks, out, strict=True):
            before = count.stepping_s, count.control_s
            began = time.process_time()
            if next(piece, None) is None:
                return np.array([rows[: len(out[-1])] for rows in out]).transpose(0, 2, 1)
            took = time.process_time() - began
            times.append((took, count.stepping_s - before[0], count.control_s - before[1]))


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("score")
    parser.add_argument("--instrument", default="classical_guitar")
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--repeats", type=int, default=9)
    args = parser.parse_args()
    plain = tw.load_instrument(args.instrument).replace({"playing.variation.seed": 1})
    both = [plain, plain.replace({"playing.noises.on": True})]
    score = tw.read_midi(args.score)
    model = tw.Renderer(score, both[1], max_duration=args.seconds).engine.model
    plays = [p for p in perform(score, model).timeline.plays if p.time < args.seconds]
    wanted = model.playing.noises.named.values()
    counts = Counter(play.exciter for play in plays if play.exciter in wanted)
    print(
        f"{args.seconds:g} s, {len(plays) - counts.total()} notes; {', '.join(f'{n} {k}' for k, n in counts.items())}"
    )
    least = np.min([once(score, both, args.seconds) for _ in range(args.repeats)], axis=0).sum(axis=-1)
    print(f"{'s of the processor':20s} {'without':>8s} {'with':>8s} {'ratio':>7s}")
    for row, name in enumerate(("all", "stepping", "between")):
        without, noisy = least[:, row]
        print(f"{name:20s} {without:8.3f} {noisy:8.3f} {noisy / without:7.3f}")


if __name__ == "__main__":
    main()
