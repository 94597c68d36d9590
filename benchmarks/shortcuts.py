"""Gain of each shortcut of the kernel: time with it off over time with all on, scene by scene.

    python benchmarks/shortcuts.py [--seconds 1] [--rounds 5] [SHORTCUT ...]

The scenes are those of `ladder.py`. All variants of a scene are stepped in turn; every block of 256 samples counts as
it was quickest, so that all see the same machine.
"""

from __future__ import annotations

import argparse
from dataclasses import fields, replace

import ladder
import numpy as np

from tonewood.physics.stepping.kernel import KernelStepper, Shortcuts, instruction_set

PLANES = ["z", "y"]
SCENES = {
    "linear": (PLANES, False, None, False),
    "tension": (PLANES, True, None, False),
    "frets, not touched": (PLANES, False, ladder.HIGH, False),
    "frets, buzzing": (PLANES, False, ladder.LOW, False),
    "fingers": (PLANES, False, None, True),
    "all, not touched": (PLANES, True, ladder.HIGH, True),
    "all, buzzing": (PLANES, True, ladder.LOW, True),
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("shortcuts", nargs="*", help="names; all if none is given")
    parser.add_argument("--seconds", type=float, default=1.0)
    parser.add_argument("--rounds", type=int, default=5)
    args = parser.parse_args()
    names = args.shortcuts or [field.name for field in fields(Shortcuts)]
    print(f"six strings on the body, 48 kHz, one core, {instruction_set()}, {args.seconds:g} s of sound\n")
    print("| scene | " + " | ".join(f"`{name}`" for name in names) + " |")
    print("|---" * (len(names) + 1) + "|")
    for scene, what in SCENES.items():
        stepped = ladder.Scene(ladder.assembled(*what), 48000.0, what[3])
        system = stepped.stepper.system
        variants = {None: Shortcuts()} | {name: replace(Shortcuts(), **{name: False}) for name in names}
        steppers = {name: KernelStepper(system, shortcuts=on) for name, on in variants.items()}
        least: dict[str | None, np.ndarray] = {}
        for _ in range(args.rounds):
            for name, stepper in steppers.items():
                stepped.stepper = stepper
                took = stepped.run(args.seconds)
                least[name] = np.minimum(least.get(name, took), took)
        gains = [float(np.sum(least[name]) / np.sum(least[None])) for name in names]
        print(f"| {scene} | " + " | ".join(f"{gain:.2f}" for gain in gains) + " |", flush=True)


if __name__ == "__main__":
    main()
