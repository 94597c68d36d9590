"""Where the time of `--effects auto` goes in dense music whose tensions rise, as multiples of the linear engine's.

    python benchmarks/auto_dense.py [SCORE.mid ...] [--instrument steel_strings] [--seconds 8] [--budget-db -80]
        [--without-connections]

Renders with effects `auto`, `all` and none but the second polarization (linear) take turns, a block each, on one core.
A row has the processor time of `all` and `auto` over that of the linear one; the parts of the linear one and of auto
that steps and the work between them take (stops, gestures, bounds); and the share of time in which so many strings'
tensions rise. The table below it has the time of a step with so many: the least of some runs from one state, over that
with none. `--without-connections` takes frets and the like away.
"""

from __future__ import annotations

import argparse
import time
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import tonewood as tw
from tonewood.performance.effects.base import SwitchedEffect

SCORES = Path(__file__).resolve().parents[1] / "examples" / "scores"
FS = 48000
LINEAR = ["second_polarization", "dampers"]
#: samples of a timed run, and how many of them count the least
STRETCH, ROUNDS = 2048, 7


def costs(renderer: tw.Renderer) -> list[float]:
    """Seconds per sample with the tensions of 0, 1, 2, ... strings rising, from the state that a render is in."""
    engine = renderer.engine
    effect = next(e for e in engine.effects if isinstance(e, SwitchedEffect) and e.name == "tension_modulation")
    out = [float("inf")] * (len(effect.components) + 1)
    for _ in range(ROUNDS):
        for n in range(len(out)):
            engine.stepper.exchange(effect.apply(engine.system, effect.components[:n], engine.frettings))
            state = engine.state.copy()
            began = time.thread_time()
            engine.stepper.run(state, STRETCH)
            out[n] = min(out[n], (time.thread_time() - began) / STRETCH)
    engine.stepper.exchange(engine.system)
    return out


def row(path: Path, made: tw.Instrument, args: argparse.Namespace) -> tuple[list[str], list[float]]:
    """One scene, and the time of steps in its middle."""
    score = tw.read_score(path)
    budgets = {"budget_db": args.budget_db, "budget_cents": args.budget_cents}
    ways: dict[str, dict[str, Any]] = {
        "auto": {"effects": "auto", **budgets},
        "all": {"effects": "all"},
        "linear": {"effects": LINEAR},
    }
    renderers = {k: tw.Renderer(score, made, FS, max_duration=args.seconds, **o) for k, o in ways.items()}
    streams = {k: r.blocks(4096) for k, r in renderers.items()}
    spent, rising = dict.fromkeys(ways, 0.0), Counter[int]()
    per_sample: list[float] = []
    blocks = 0
    while streams:
        for name in list(streams):
            began = time.thread_time()
            block = next(streams[name], None)
            spent[name] += time.thread_time() - began
            if block is None:
                del streams[name]
            elif name == "auto":
                rising[len(renderers[name].engine.running("tension_modulation"))] += 1
                blocks += 1
                if blocks == 40:
                    per_sample = costs(renderers[name])
    linear, counters = spent["linear"], renderers["auto"].engine.counters
    share = [rising[n] / blocks for n in range(len(per_sample))]
    plain = renderers["linear"].engine.counters
    parts = [plain.stepping_s, plain.control_s, counters.stepping_s, counters.control_s]
    figures = [x / linear for x in (spent["all"], spent["auto"], *parts)]
    shown = [path.stem, *(f"{x:.2f}" for x in figures), " ".join(f"{100 * s:.0f}" for s in share)]
    return shown, [c / per_sample[0] for c in per_sample]


def table(columns: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    return "\n".join(f"| {' | '.join(r)} |" for r in (columns, ["---"] * len(columns), *rows))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scores", nargs="*", type=Path, default=sorted(SCORES.glob("*.mid")))
    parser.add_argument("--instrument", default="steel_strings")
    parser.add_argument("--seconds", type=float, default=8.0)
    parser.add_argument("--budget-db", type=float, default=-80.0)
    parser.add_argument("--budget-cents", type=float, default=0.5)
    parser.add_argument("--without-connections", action="store_true")
    args = parser.parse_args()
    made = tw.load_instrument(args.instrument)
    if args.without_connections:
        made = tw.Instrument.from_values({**made.resolved, "connections": {}}, made.folder)
    found = [row(path, made, args) for path in args.scores]
    columns = [
        "score",
        "all",
        "auto",
        "linear: steps",
        "between",
        "auto: steps",
        "between",
        "0, 1, ... rise, % of time",
    ]
    print(table(columns, [shown for shown, _ in found]))
    n = len(found[0][1])
    steps = [[shown[0], *(f"{c:.2f}" for c in cost)] for shown, cost in found]
    print("\n" + table(["a step with so many", *map(str, range(n))], steps))


if __name__ == "__main__":
    main()
