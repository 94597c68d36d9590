"""Print the tables of docs/statistics.md: false alarms, coverage, thresholds, sensitivities and power, by simulation.

    python scripts/statistics.py [--only ratings missing ...] [--experiments 5000] [--staircases 134] ...

Each number is the mean of three fixed seeds.
"""

from __future__ import annotations

import argparse
import itertools
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import astuple
from typing import Any

import numpy as np

from tonewood.workshop.batch.pages import StaircasePage
from tonewood.workshop.listening import power
from tonewood.workshop.listening import simulations as sim

SEEDS = (1, 2, 3)
BEGAN = time.monotonic()
#: the staircase of docs/listening_tests.md, and the rule with steps
STAIRS: dict[str, Any] = {
    "type": "staircase", "path": "exciters.pluck.from_bridge", "scale": "percent", "start": 40.0, "ratio": True,
    "lowest": 0.5, "highest": 80.0, "intervals": 3, "unit": "%",
}  # fmt: skip
LEVITT = {"steps": [2.0, 1.4, 1.2], "down": 2, "reversals": 8, "discard": 2}
PAGES = {
    "QUEST+, 60 trials": STAIRS,
    "2-down staircase": STAIRS | LEVITT,
}
#: populations on which the fit was chosen (A to C), and others: mean threshold, standard deviation of ln(level), slope
#: per unit of ln(level), standard deviation of its logarithm, lapse rate
PEOPLE = {
    "A": sim.Population(5.0, 0.25, 2.0, 0.3, 0.02),
    "B": sim.Population(5.0, 0.25, 1.0, 0.3, 0.02),
    "C": sim.Population(5.0, 0.25, 4.0, 0.3, 0.04),
    "D": sim.Population(2.0, 0.4, 3.0, 0.3, 0.02),
    "E": sim.Population(5.0, 0.6, 2.5, 0.5, 0.03),
    "F": sim.Population(8.0, 0.35, 6.0, 0.3, 0.05),
    "G": sim.Population(12.0, 0.15, 1.5, 0.2, 0.01),
}


def means(run: Callable[[np.random.Generator], Sequence[float]], *labels: object) -> list[float]:
    """Mean results of three seeds, with a line of progress."""
    rows = [run(np.random.default_rng(seed)) for seed in SEEDS]
    print(f"{time.monotonic() - BEGAN:6.0f} s  {', '.join(map(str, labels))}", file=sys.stderr, flush=True)
    return [float(x) for x in np.mean(np.array(rows, dtype=np.float64), axis=0)]


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Print a table in Markdown."""
    print("\n| " + " | ".join(head) + " |\n| " + " | ".join("---" for _ in head) + " |", flush=True)
    for row in rows:
        print("| " + " | ".join(row) + " |", flush=True)


def percent(x: float) -> str:
    """A share in percent."""
    return f"{100 * x:.1f} %"


HEAD = ["factor", "difference b", "difference c", "interaction", "coverage"]


def ratings(options: argparse.Namespace) -> None:
    """Complete answers."""
    rows = []
    for null in sim.NULLS:
        for n in (12, 20, 40):
            r = means(lambda g, n=n, null=null: astuple(sim.rating_rates(g, options.experiments, n, null)), null, n)
            rows.append([null, str(n), *map(percent, r)])
    table(["population", "listeners", *HEAD], rows)


def missing(options: argparse.Namespace) -> None:
    """Answers missing."""
    for gaps in sim.GAPS:
        print(f"\n{gaps}:")
        rows = []
        for null in sim.NULLS:
            for n in (12, 20, 40):
                case = (options.experiments, n, null, gaps)
                r = means(lambda g, case=case: astuple(sim.rating_rates(g, *case)), gaps, null, n)
                rows.append([null, str(n), *map(percent, r)])
        table(["population", "listeners", *HEAD], rows)


def sampled(options: argparse.Namespace) -> None:
    """Answers missing, sounds a random sample."""
    rows = []
    for n, sounds, share in itertools.product((12, 20, 40), (6, 12), (0.1, 0.2)):
        r = means(
            lambda g, n=n, k=sounds, share=share: sim.sampled_rates(g, options.sampled, n, k, share), "sampled", n
        )
        rows.append([str(n), str(sounds), percent(share), *map(percent, r)])
    table(["listeners", "sounds", "missing", "false alarms", "coverage"], rows)


def grades(options: argparse.Namespace) -> None:
    """Odds of higher grades."""
    rows = []
    for cuts in sim.CUTS:
        for n in (12, 20, 40):
            r = means(lambda g, n=n, cuts=cuts: sim.odds_rates(g, options.grades, n, cuts), cuts, n)
            rows.append([cuts, str(n), *map(percent, r[:4]), f"{100 * r[4]:+.1f} %"])
    table(["scale", "listeners", "factor", "difference b", "interaction", "coverage", "bias"], rows)


def staircases(options: argparse.Namespace) -> None:
    """Bias and coverage of thresholds."""
    rows = []
    for name, page in PAGES.items():
        for text, people in PEOPLE.items():
            own = StaircasePage.model_validate(page)
            count = options.staircases if own.adaptive == "quest_plus" else int(0.3 * options.staircases)
            r = means(
                lambda g, case=(count, 12, own, people): astuple(sim.threshold_rates(g, *case)), name, text
            )  # fmt: skip
            rows.append([name, text, f"{r[1]:.0f}", f"{100 * r[2]:+.1f} %", percent(r[3]), f"{100 * r[4]:+.1f} %",
                         percent(r[5]), f"{100 * r[6]:.0f} %"])  # fmt: skip
            print(rows[-1], file=sys.stderr, flush=True)
    table(["method", "listeners", "trials", "bias of the mean", "coverage", "bias of a listener", "coverage",
           "half width of the mean's interval"], rows)  # fmt: skip


def sensitivities(options: argparse.Namespace) -> None:
    """Mean d' of listeners who differ."""
    rows = []
    for task in ("more_2", "more_3", "odd_3", "abx"):
        for mean, sd in ((1.0, 0.5), (1.5, 0.8), (2.5, 0.8)):
            r = means(
                lambda g, t=task, m=mean, s=sd: sim.sensitivity_rates(g, options.sensitivities, 20, 20, t, m, s),
                task, mean,
            )  # fmt: skip
            rows.append([task, f"{mean:g} ± {sd:g}", f"{100 * r[0]:+.1f} %", f"{100 * r[1]:+.1f} %", percent(r[2])])
    table(["task", "d' of listeners", "bias", "bias of pooled shares", "coverage"], rows)


def powers(options: argparse.Namespace) -> None:
    """Power promised, and power had by other simulated experiments."""
    rows = []
    for shift, sd in ((5.0, 8.0), (5.0, 12.0), (8.0, 12.0)):

        def promised(n: int, shift: float = shift, sd: float = sd) -> float:
            return float(power.rating_power([0.0, shift, 0.0], sd**2 / 2 * np.eye(3), n, 0.05)[0])

        n = power.fewest(promised, 0.8, "")
        had = means(lambda g, a=shift, s=sd, n=n: [sim.power_had(g, options.experiments, n, a, s)], "power", shift)
        rows.append([f"{shift:g} points, sd {sd:g}", str(n), percent(promised(n)), percent(had[0])])
    for sounds in (6, 12):
        own, spread = power.stated_spread(12.0, 5.0, sounds, 2)

        def of_sounds(n: int, own: Any = own, spread: power.SoundSpread = spread) -> float:
            return float(power.rating_power([0.0, 8.0], own, n, 0.05, sampled=spread)[0])

        n = power.fewest(of_sounds, 0.8, "")
        had = means(
            lambda g, n=n, m=sounds: [sim.power_had_by_sounds(g, options.experiments // 5, n, m, 8.0, 12.0, 5.0)],
            "power of sounds", sounds,
        )  # fmt: skip
        rows.append([f"8 points, sd 12; {sounds} random sounds, sd 5", str(n), percent(of_sounds(n)), percent(had[0])])
    page, people = StaircasePage.model_validate(STAIRS), sim.Population(5.0, 0.25, 2.0)
    margin = float(np.log(1.25))
    n = power.threshold_listeners(page, people, margin, 0.05, 0.8)
    had = means(lambda g: [sim.excluded(g, options.staircases, n, page, people, margin)], "power", "threshold")
    rows.append(["threshold 25 % higher", str(n), "at least 80 %", percent(had[0])])
    table(["effect", "listeners", "power promised", "power had"], rows)


PARTS = {"ratings": ratings, "powers": powers, "sensitivities": sensitivities, "staircases": staircases,
         "missing": missing, "sampled": sampled, "grades": grades}  # fmt: skip

if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--experiments", type=int, default=5000, help="of ratings, for each seed")
    parser.add_argument(
        "--staircases",
        type=int,
        default=134,
        help="experiments with QUEST+, for each seed; 0.3 of them by Levitt's rule",
    )
    parser.add_argument("--sensitivities", type=int, default=110, help="experiments with d', for each seed")
    parser.add_argument("--grades", type=int, default=200, help="experiments with grades, for each seed")
    parser.add_argument("--sampled", type=int, default=200, help="experiments with random sounds, for each seed")
    parser.add_argument("--only", nargs="*", choices=list(PARTS), default=list(PARTS))
    chosen = parser.parse_args()
    for part in chosen.only:
        PARTS[part](chosen)
