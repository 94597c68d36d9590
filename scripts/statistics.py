"""Print the tables of docs/statistics.md: false alarms, coverage, thresholds, sensitivities and power, by simulation.

    python scripts/statistics.py [--only ratings missing ...] [--experiments 5000] [--staircases 134] [--keep FILE] ...

Each number is the mean of three fixed seeds, which are simulated in batches. Batches that are done are kept in FILE, so
that a run that was stopped goes on where it was.
"""

from __future__ import annotations

import argparse
import itertools
import json
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import astuple
from pathlib import Path
from typing import Any

import listening_studies as sim
import numpy as np

from tonewood.workshop.batch.pages import StaircasePage
from tonewood.workshop.listening import power
from tonewood.workshop.listening.simulations import Population

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
    "A": Population(5.0, 0.25, 2.0, 0.3, 0.02),
    "B": Population(5.0, 0.25, 1.0, 0.3, 0.02),
    "C": Population(5.0, 0.25, 4.0, 0.3, 0.04),
    "D": Population(2.0, 0.4, 3.0, 0.3, 0.02),
    "E": Population(5.0, 0.6, 2.5, 0.5, 0.03),
    "F": Population(8.0, 0.35, 6.0, 0.3, 0.05),
    "G": Population(12.0, 0.15, 1.5, 0.2, 0.01),
}


KEPT: dict[str, list[float]] = {}
Run = Callable[[np.random.Generator, int], Sequence[float]]


def means(options: argparse.Namespace, run: Run, count: int, batch: int, *labels: object) -> list[float]:
    """Mean results of `count` experiments of each seed, in batches; batches of other runs are taken from the file."""
    rows, weights = [], []
    for number, begin in enumerate(range(0, count, batch)):
        for seed in SEEDS:
            n = min(batch, count - begin)
            key = ", ".join(map(str, (*labels, seed, number, n)))
            if key not in KEPT:
                KEPT[key] = [float(x) for x in run(np.random.default_rng([seed, number] if number else seed), n)]
                if options.keep:
                    with options.keep.open("a", encoding="utf-8") as file:
                        file.write(json.dumps({key: KEPT[key]}) + "\n")
            rows.append(KEPT[key])
            weights.append(n)
    print(f"{time.monotonic() - BEGAN:6.0f} s  {', '.join(map(str, labels))}", file=sys.stderr, flush=True)
    return [float(x) for x in np.average(np.array(rows, dtype=np.float64), axis=0, weights=weights)]


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
            case = (n, null)
            r = means(
                options, lambda g, k, case=case: astuple(sim.rating_rates(g, k, *case)), options.experiments, 5000,
                null, n,
            )  # fmt: skip
            rows.append([null, str(n), *map(percent, r)])
    table(["population", "listeners", *HEAD], rows)


def missing(options: argparse.Namespace) -> None:
    """Answers missing."""
    for gaps in sim.GAPS:
        print(f"\n{gaps}:")
        rows = []
        for null in sim.NULLS:
            for n in (12, 20, 40):
                case = (n, null, gaps)
                r = means(
                    options, lambda g, k, case=case: astuple(sim.rating_rates(g, k, *case)), options.experiments, 5000,
                    gaps, null, n,
                )  # fmt: skip
                rows.append([null, str(n), *map(percent, r)])
        table(["population", "listeners", *HEAD], rows)


def others(options: argparse.Namespace) -> None:
    """Ratings of populations that the analyses were not chosen on."""
    rows = []
    for gaps, name, n in itertools.product(("", "20 % at random"), sim.OTHERS, (12, 20, 40)):
        r = means(
            options, lambda g, k, case=(n, name, gaps): astuple(sim.rating_rates(g, k, *case)), options.others, 1000,
            "others", gaps, name, n,
        )  # fmt: skip
        rows.append([name, gaps or "none", str(n), *map(percent, r)])
    table(["population", "missing", "listeners", *HEAD], rows)


def choices(options: argparse.Namespace) -> None:
    """Paired comparisons."""
    rows = []
    for sd, each, n in itertools.product((0.0, 1.0), (1, 4), (6, 12, 20)):
        r = means(
            options, lambda g, k, case=(n, each, sd): sim.choice_rates(g, k, *case), options.others, 500,
            "choices", sd, each, n,
        )  # fmt: skip
        rows.append([f"{sd:g}", str(each), str(n), *map(percent, r)])
    table(["sd of listeners' own values, logits", "answers to a pair", "listeners", "a level chosen more often",
           "coverage"], rows)  # fmt: skip


def sampled(options: argparse.Namespace) -> None:
    """Answers missing, sounds a random sample."""
    rows = []
    for spread, share, sounds, n in itertools.product(sim.SPREADS, (0.0, 0.1, 0.2), (6, 12), (12, 20, 40)):
        if share != 0.1 and spread != next(iter(sim.SPREADS)):
            continue
        case = (n, sounds, share, spread)
        r = means(
            options, lambda g, k, case=case: sim.sampled_rates(g, k, *case), options.sampled, 1000, "sampled", *case
        )  # fmt: skip
        rows.append([spread, percent(share), str(sounds), str(n), *map(percent, r)])
    table(["population", "missing", "sounds", "listeners", "factor", "difference b", "coverage"], rows)


def grades(options: argparse.Namespace) -> None:
    """Odds of higher grades."""
    rows = []
    for cuts in sim.CUTS:
        for n in (12, 20, 40):
            r = means(
                options, lambda g, k, n=n, cuts=cuts: sim.odds_rates(g, k, n, cuts), options.grades, 1000, cuts, n
            )  # fmt: skip
            rows.append([cuts, str(n), *map(percent, r[:4]), f"{100 * r[4]:+.1f} %", percent(r[5])])
    table(["scale", "listeners", "factor", "difference b", "interaction", "coverage", "bias", "not converged"], rows)


def staircases(options: argparse.Namespace) -> None:
    """Bias and coverage of thresholds."""
    rows = []
    for name, page in PAGES.items():
        for text, people in PEOPLE.items():
            own = StaircasePage.model_validate(page)
            case = (12, own, people)
            r = means(
                options, lambda g, k, case=case: astuple(sim.threshold_rates(g, k, *case)), options.staircases, 67,
                name, text,
            )  # fmt: skip
            rows.append([
                name, text, f"{r[1]:.0f}", str(3 * options.staircases), f"{100 * r[2]:+.1f} %", percent(r[3]),
                f"{100 * r[4]:+.1f} %", percent(r[5]), f"{100 * r[6]:.0f} %",
            ])  # fmt: skip
            print(rows[-1], file=sys.stderr, flush=True)
    table(["method", "population", "trials", "experiments", "bias of the mean", "coverage", "bias of a listener",
           "coverage", "half width of the mean's interval"], rows)  # fmt: skip


def sensitivities(options: argparse.Namespace) -> None:
    """Mean d' of listeners who differ."""
    rows = []
    for task in ("more_2", "more_3", "odd_3", "abx"):
        for mean, sd in ((1.0, 0.5), (1.5, 0.8), (2.5, 0.8)):
            case = (20, 20, task, mean, sd)
            r = means(
                options, lambda g, k, case=case: sim.sensitivity_rates(g, k, *case), options.sensitivities, 110,
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
        case = (n, shift, sd)
        had = means(
            options, lambda g, k, case=case: [sim.power_had(g, k, *case)], options.experiments, 5000, "power", *case
        )  # fmt: skip
        rows.append([f"{shift:g} points, sd {sd:g}", str(n), percent(promised(n)), percent(had[0])])
    for sounds in (6, 12):
        own, spread = power.stated_spread(12.0, 5.0, sounds, 2)

        def of_sounds(n: int, own: Any = own, spread: power.SoundSpread = spread) -> float:
            return float(power.rating_power([0.0, 8.0], own, n, 0.05, sampled=spread)[0])

        n = power.fewest(of_sounds, 0.8, "")
        case = (n, sounds, 8.0, 12.0, 5.0)
        had = means(
            options, lambda g, k, case=case: [sim.power_had_by_sounds(g, k, *case)], options.experiments, 5000,
            "power of sounds", *case,
        )  # fmt: skip
        rows.append([f"8 points, sd 12; {sounds} random sounds, sd 5", str(n), percent(of_sounds(n)), percent(had[0])])

    def of_shares(n: int) -> float:
        return float(power.ordinal_power([0.0, 0.6, 0.0], 1.0, 6, (1.0, 5.0), n, 0.05)[0])

    n = power.fewest(of_shares, 0.8, "")
    case = (n, 0.6, 1.0)
    had = means(
        options, lambda g, k, case=case: [sim.power_had_by_shares(g, k, *case)], options.grades, 1000, "grades", *case
    )  # fmt: skip
    rows.append(["0.6 points of an ordinal scale of 1 to 5, sd 1, six sounds", str(n), percent(of_shares(n)),
                 percent(had[0])])  # fmt: skip
    page, people = StaircasePage.model_validate(STAIRS), Population(5.0, 0.25, 2.0)
    margin = float(np.log(1.25))
    n = power.threshold_listeners(page, people, margin, 0.05, 0.8)
    had = means(
        options, lambda g, k: [sim.excluded(g, k, n, page, people, margin)], options.staircases, 67, "power",
        "threshold", n,
    )  # fmt: skip
    rows.append(["threshold 25 % higher", str(n), "at least 80 %", percent(had[0])])
    table(["effect", "listeners", "power promised", "power had"], rows)


PARTS = {"ratings": ratings, "powers": powers, "sensitivities": sensitivities, "staircases": staircases,
         "missing": missing, "others": others, "choices": choices, "sampled": sampled, "grades": grades}  # fmt: skip

if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--experiments", type=int, default=5000, help="of ratings, for each seed")
    parser.add_argument(
        "--others", type=int, default=1000, help="of other populations and of paired comparisons, for each seed"
    )
    parser.add_argument("--staircases", type=int, default=134, help="experiments with staircases, for each seed")
    parser.add_argument("--sensitivities", type=int, default=110, help="experiments with d', for each seed")
    parser.add_argument("--grades", type=int, default=200, help="experiments with grades, for each seed")
    parser.add_argument("--sampled", type=int, default=200, help="experiments with random sounds, for each seed")
    parser.add_argument("--only", nargs="*", choices=list(PARTS), default=list(PARTS))
    parser.add_argument(
        "--keep", type=Path, help="file of the batches that are done; remove it where an analysis has changed"
    )
    chosen = parser.parse_args()
    for line in chosen.keep.read_text("utf-8").splitlines() if chosen.keep and chosen.keep.exists() else ():
        KEPT |= json.loads(line)
    for part in chosen.only:
        PARTS[part](chosen)
