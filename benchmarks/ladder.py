"""Cost ladder: time of each nonlinear part of an instrument, over the same scene, in one run.

    python benchmarks/ladder.py [--seconds 2] [--fs 48000]

Six steel strings on the body of `steel_strings`, plucked together by ramps of 2 N; one core. Only stepping is timed,
not the making of the model. Each scene is stepped in turn, three times over, and every block counts as it was
quickest, so that all see the same machine."""

from __future__ import annotations

import argparse
import time
from typing import Any

import numpy as np
from numpy.typing import NDArray

import tonewood as tw
import tonewood.authoring as ta
from tonewood.instrument.model.assembly import Model, assemble
from tonewood.physics.stepping.forcing import compile_force
from tonewood.physics.stepping.kernel import KernelStepper, instruction_set

BLOCK = 256
#: clearances at which no fret is reached by this pluck, and at which the strings buzz
HIGH = {"action_first": 3e-3, "action_twelfth": 6e-3}
LOW = {"action_first": 2.5e-4, "action_twelfth": 1.2e-3}
FINGER = {"plugin": "stopping_finger", "from_bridge": 0.1}


def assembled(
    planes: list[str], tension: bool, action: dict[str, float] | None, finger: bool, plugin: str | None = None
) -> tw.Instrument:
    """The steel-string guitar with more or fewer nonlinear parts."""
    changes: dict[str, object] = {"strings.*.polarizations": planes, "tuning.compensate": "none"}
    if plugin is not None:
        changes["strings.*.plugin"] = plugin
    if not tension:
        changes["strings.*.axial_stiffness"] = 0.0
    guitar = tw.load_instrument("steel_strings").replace(changes)
    values = dict(guitar.resolved)
    values["connections"] = {"frets": {"plugin": "frets", **action}} if action else {}
    if finger:
        values["exciters"] = {**values["exciters"], "finger": FINGER}
    return tw.Instrument.from_values(values, guitar.folder)


class Scene:
    """An assembled scene, its strings plucked at 20 ms."""

    def __init__(self, instrument: tw.Instrument, fs: float, finger: bool):
        self.model: Model = assemble(instrument, fs)
        # the fingers lie on the strings; the palm of the bundle stays away
        lies = {name: c for name, c in self.model.resting.items() if ".finger." in name}
        system = self.model.system.with_laws(lies) if finger else self.model.system
        gesture = self.model.exciters["pluck"].gesture(ta.Event({"force": 2.0}, 82.4), self.model.place("E2"))
        self.injections = []
        for string in self.model.strings.values():
            for component, weight in string.weights(gesture.angle_deg).items():
                basis = system.compiled[system.slot(component)].basis
                self.injections += compile_force(
                    component, basis, "pluck", gesture.segments, system.dt, time=0.02, factor=weight
                )  # fmt: skip
        self.stepper = KernelStepper(system)

    def run(self, seconds: float) -> NDArray[np.float64]:
        """Return the time that each block takes."""
        state, left = self.stepper.start(), self.injections
        marks = [time.perf_counter()]
        for _ in range(int(seconds / self.stepper.system.dt) // BLOCK):
            self.stepper.advance(state, BLOCK, left)
            left = [i for i in left if i.stop > state.sample]
            marks.append(time.perf_counter())
        return np.diff(marks)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=2.0)
    parser.add_argument("--fs", type=float, default=48000.0)
    parser.add_argument("--rounds", type=int, default=3)
    args = parser.parse_args()
    both = ["z", "y"]
    setups: dict[str, tuple[Any, ...]] = {
        "linear, one polarization": (["z"], False, None, False),
        "+ second polarization": (both, False, None, False),
        "+ tension modulation": (both, True, None, False),
        "+ longitudinal motion": (both, True, None, False, "geometric_string"),
        "second polarization + 20 frets, not touched": (both, False, HIGH, False),
        "second polarization + 20 frets, buzzing": (both, False, LOW, False),
        "second polarization + a finger on each string": (both, False, None, True),
        "everything, frets not touched": (both, True, HIGH, True),
        "everything, frets buzzing": (both, True, LOW, True),
    }
    scenes: dict[str, Scene] = {}
    left_out: dict[str, str] = {}
    for name, what in setups.items():
        try:
            scenes[name] = Scene(assembled(*what), args.fs, what[3])
        except (ValueError, tw.TonewoodError) as fault:  # a combination that the kernel does not step
            left_out[name] = str(fault)
    least: dict[str, NDArray[np.float64]] = {}
    for _ in range(args.rounds):
        for name, scene in scenes.items():
            took = scene.run(args.seconds)
            least[name] = np.minimum(least.get(name, took), took)
    best = {name: float(np.sum(blocks)) for name, blocks in least.items()}
    base, plain = best["linear, one polarization"], best["+ second polarization"]
    print(f"six strings on the body, {args.fs:g} Hz, one core, {instruction_set()}, {args.seconds:g} s of sound\n")
    print("| scene | modes | connections | x real time | cost / one plane | cost / two planes | Newton | failed |")
    print("|---|---|---|---|---|---|---|---|")
    for name, scene in scenes.items():
        s = scene.stepper.statistics
        per = s.iterations / max(s.solves, 1)
        print(
            f"| {name} | {scene.model.n_modes} | {len(scene.model.system.connections)} "
            f"| {args.seconds / best[name]:.2f} | {best[name] / base:.2f} | {best[name] / plain:.2f} "
            f"| {per:.1f} | {s.failures} |"
        )
    for name, reason in left_out.items():
        print(f"\n{name}: {reason}")


if __name__ == "__main__":
    main()
