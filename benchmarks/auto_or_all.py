"""Whether `--effects auto` is ever slower than `all`: processor time of whole renders, one instrument and score a line.

    python benchmarks/auto_or_all.py [SCORE.mid ...] [--instruments monochord ...] [--rounds 15] [--seconds 8]
    python benchmarks/auto_or_all.py --commands ...

Renders take turns, in one process or, with `--commands`, each as a `tonewood render` of its own. A line has the medians
of both, the median of their ratios round by round, and an upper bound of that median: the order statistic that lies
above it with a probability of 95 % whatever the distribution (for 15 rounds the 12th, for 5 the largest). "bits"
tells whether both renders are the same samples.
Rows are printed as they are done; rounds stop early, from 5 on, when `--limit` s of a line are over. Where no scores
are named, each instrument also plays its open strings, from the lowest on. A score that it cannot play has a row that
says so.
"""

from __future__ import annotations

import argparse
import math
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import mido
import numpy as np
from numpy.typing import NDArray

import tonewood as tw
from tonewood.instrument.contract.registry import list_instruments

SCORES = Path(__file__).resolve().parents[1] / "examples" / "scores"
MODES = ("auto", "all")


def upper(ratios: NDArray[np.float64]) -> float:
    """Order statistic above the median with a probability of 95 %; the largest for fewer than 5."""
    n = len(ratios)
    tail = np.cumsum([math.comb(n, k) for k in range(n, -1, -1)]) / 2.0**n  # of n - i successes or more
    above = int(np.count_nonzero(tail <= 0.05))
    return float(np.sort(ratios)[n - max(above, 1)])


def open_strings(name: str, path: Path) -> Path:
    """Write a phrase that the instrument can play: twice its lowest open strings, four at most, two notes a second."""
    instrument = tw.load_instrument(name)
    notes = sorted({round(instrument.open_note(leader)) for leader in instrument.groups})[:4]
    track = mido.MidiTrack()
    for note in 2 * notes:
        track += [mido.Message("note_on", note=note, velocity=80), mido.Message("note_off", note=note, time=480)]
    mido.MidiFile(tracks=[track]).save(path)  # 480 ticks a beat, 120 beats a minute
    return path


def rendered(score: tw.Score, name: str, mode: str, seconds: float | None) -> tuple[NDArray[np.float32], float]:
    """Sound, and seconds of the processor, set-up included."""
    began = time.process_time()
    stream = tw.Renderer(score, tw.load_instrument(name), 48000, max_duration=seconds, effects=mode)
    sound = np.concatenate([np.asarray(block, dtype=np.float32) for block in stream.blocks(4096)])
    return sound, time.process_time() - began


def commanded(path: Path, name: str, mode: str, seconds: float | None, out: Path) -> float:
    """Seconds of the processor of one command."""
    limit = [] if seconds is None else ["--max-duration", str(seconds)]
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run(
        [sys.executable, "-m", "tonewood", "render", str(path), "-i", name, "-o", str(out), "--effects", mode, *limit],
        capture_output=True,
        text=True,
    )
    if done.returncode:
        raise tw.TonewoodError((done.stderr.strip().splitlines() or ["the command failed"])[-1])
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def row(path: Path, name: str, args: argparse.Namespace) -> str:
    """One line of the table."""
    score = tw.read_midi(path)
    sounds = {mode: rendered(score, name, mode, args.seconds) for mode in MODES}
    bits = "same" if np.array_equal(sounds["auto"][0], sounds["all"][0]) else "differ"
    times: list[list[float]] = []
    began = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        for i in range(args.rounds):
            turn = MODES if i % 2 else MODES[::-1]
            if args.commands:
                taken = {m: commanded(path, name, m, args.seconds, Path(folder) / f"{m}.wav") for m in turn}
            else:
                taken = {m: rendered(score, name, m, args.seconds)[1] for m in turn}
            times.append([taken[m] for m in MODES])
            if len(times) >= 5 and time.perf_counter() - began > args.limit:
                break
    auto, every = np.array(times).T
    ratio = auto / every
    return (
        f"{np.median(auto):.3f} | {np.median(every):.3f} | {np.median(ratio):.3f} | {upper(ratio):.3f} "
        f"| {len(times)} | {bits}"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scores", nargs="*", type=Path)
    parser.add_argument("--instruments", nargs="+", default=sorted(list_instruments()))
    parser.add_argument("--rounds", type=int, default=15)
    parser.add_argument("--limit", type=float, default=60.0, help="s for a line, once it has 5 rounds")
    parser.add_argument("--seconds", type=float, default=None, help="of each score; all of it where left out")
    parser.add_argument("--commands", action="store_true", help="each render as a command of its own")
    args = parser.parse_args()
    columns = ["instrument", "score", "auto, s", "all, s", "auto / all", "upper", "rounds", "bits"]
    print(f"| {' | '.join(columns)} |\n|{'---|' * len(columns)}", flush=True)
    with tempfile.TemporaryDirectory() as folder:
        for name in args.instruments:
            own = Path(folder) / "open_strings.mid"
            scores = args.scores or [*sorted(SCORES.glob("*.mid")), open_strings(name, own)]
            for path in scores:
                try:
                    line = row(path, name, args)
                except tw.TonewoodError as fault:
                    line = f"{fault}{' |' * (len(columns) - 3)}"
                print(f"| {name} | {path.stem} | {line} |", flush=True)


if __name__ == "__main__":
    try:
        main()
    except KeyboardInterrupt:
        print("\nstopped: the rows above are whole")
        sys.exit(130)
