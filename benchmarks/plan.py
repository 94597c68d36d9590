"""`tonewood plan` against the truth: predicted over measured processor time of a whole render, a scene a row.

    python benchmarks/plan.py [--rounds 3] [--seconds 8]

Plan and render take turns; a row has the median of the ratios of the rounds, and the lowest and highest. The last line
counts the scenes whose median is within 25 %.
"""

from __future__ import annotations

import argparse
import statistics
import time
from pathlib import Path

import tonewood as tw

SCORES = Path(__file__).resolve().parents[1] / "examples" / "scores"
SCENES = [
    ("steel_strings", "scale", {}),
    ("steel_strings", "prelude", {}),
    ("steel_strings", "romance", {"budget_db": -60.0}),
    ("steel_strings", "greensleeves", {"budget_cents": 5.0, "budget_db": -40.0}),
    ("steel_strings", "chords", {"effects": "all"}),
    ("classical_guitar", "prelude", {}),
    ("classical_guitar", "greensleeves", {"effects": "none"}),
    ("electric_bass", "scale", {}),
    ("african_harp", "pentatonic", {}),
    ("twelve_string_guitar", "romance", {}),
]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--seconds", type=float, default=8.0)
    args = parser.parse_args()
    print("| instrument | score | options | measured, s | predicted / measured | range |\n|---|---|---|---:|---:|---:|")
    within = 0
    for name, score_name, options in SCENES:
        score, made = tw.read_score(SCORES / f"{score_name}.mid"), tw.load_instrument(name)
        ratios, times = [], []
        for _ in range(args.rounds):
            foreseen = tw.plan(score, made, 48000, max_duration=args.seconds, **options)
            renderer = tw.Renderer(score, made, 48000, max_duration=args.seconds, **options)
            began = time.thread_time()
            for _ in renderer.blocks(4096):
                pass
            times.append(time.thread_time() - began)
            ratios.append(foreseen.predicted_s / times[-1])
        middle = statistics.median(ratios)
        within += 0.75 <= middle <= 1.25
        said = ", ".join(f"{key} {value}" for key, value in options.items()) or "auto"
        shown = f"{statistics.median(times):.2f} | {middle:.2f} | {min(ratios):.2f}-{max(ratios):.2f}"
        print(f"| {name} | {score_name} | {said} | {shown} |", flush=True)
    print(f"\n{within} of {len(SCENES)} within 25 %")


if __name__ == "__main__":
    main()
