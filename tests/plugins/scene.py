"""One string on an all but rigid body, touched and played, with every force in reach."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tonewood.instrument.bundle.loading import Instrument
from tonewood.instrument.contract.gestures import Event
from tonewood.instrument.model.assembly import Model, assemble
from tonewood.physics.coupling.system import Injection, PrescribedMotion, System
from tonewood.physics.energy.account import EnergyAccount, KnownForce
from tonewood.physics.energy.trace import EnergyTrace
from tonewood.physics.stepping.forcing import compile_force
from tonewood.physics.stepping.kernel import KernelStepper

Floats = NDArray[np.float64]

STRING: dict[str, Any] = {
    "plugin": "stiff_string",
    "note": "A2",
    "length": 0.65,
    "tension": 73.9,
    "linear_density": 3.61e-3,
    "bending_stiffness": 4e-5,
    "loss": {"law": "sigma", "sigma0": 0.5, "sigma1": 1e-4},
    "end": "body.bridge",
    "polarizations": ["z"],
    "freq_upper": 8000.0,
}
PLUCK: dict[str, Any] = {"plugin": "pluck_ramp", "from_bridge": 0.2, "ramp_time": 0.02, "hold_dashpot": 0.0}


def instrument(folder: Path, string: Mapping[str, Any] | None = None, **parts: Any) -> Instrument:
    """The string S with other keys, and parts of the bundle in place of a mere pluck."""
    (folder / "body.csv").write_text("f_Hz,Q,modal_mass,bridge\n30,5,1e5,1\n")
    values: dict[str, Any] = {
        "schema": "tonewood-instrument/2",
        "name": "touched",
        "title": "One string",
        "licence": "CC-BY-4.0",
        "sources": {},
        "body": {
            "plugin": "modal_table", "table": "body.csv", "shapes": "points", "points": {"bridge": {"direction": "z"}},
        },
        "strings": {"S": {**STRING, **(string or {})}},
        "tuning": {"compensate": "none"},
        "exciters": {"pluck": PLUCK},
        "playing": {"exciter": next(iter(parts.get("exciters", {"pluck": None})))},
        "outputs": [{"name": "end", "plugin": "point_pickup", "quantity": "force", "at": "S.bridge", "full_scale": 9}],
        **parts,
    }  # fmt: skip
    if "pluck" not in values["exciters"]:
        first, part = next(iter(values["exciters"].items()))
        parameter = "velocity" if part["plugin"] in ("hammer", "bow") else "force"
        values["playing"]["velocity"] = {"parameter": f"{first}.{parameter}", "low": 0.1, "high": 1.0}
    return Instrument.from_values(values, folder)


@dataclass(frozen=True)
class Played:
    """A gesture run sample by sample from `start` (s, before the event where it is prepared)."""

    system: System
    start: float
    out: Floats
    forces: Mapping[str, Floats]
    energy: EnergyTrace | None

    @property
    def time(self) -> Floats:
        return self.start + np.arange(len(self.out)) * self.system.dt


def play(
    made: Instrument | Model, values: Mapping[str, float] | None = None, *, duration: float, exciter: str | None = None,
    fs: float = 48000, held: float = np.inf, stepper: Any = KernelStepper, energy: bool = False, stop: float = 0,
) -> Played:  # fmt: skip
    """One event of an exciter on the string S, at a stop; the end's force and all connections' forces."""
    model = made if isinstance(made, Model) else assemble(made, fs)
    name = exciter or model.default_exciter
    string = model.strings["S"]
    gesture = model.exciters[name].gesture(Event(values or {}, string.freq(stop), held), model.place("S", stop))
    system = model.system
    for component, basis in string.bases(stop, pluck_from_bridge=gesture.from_bridge).items():
        system = system.with_basis(component, basis)
    mine = {c.name: c for c in string.connections(stop)}
    acting = {
        n: c for n, c in mine.items() if n not in model.resting or any(m.connection == n for m in gesture.motions)
    }
    if acting:
        system = system.with_laws(acting)
    dt, first = system.dt, int(np.floor(min(gesture.start, 0.0) / model.system.dt))
    n = round(duration / dt) - first
    if gesture.on is not None:
        where = model.inputs[gesture.on]
    else:
        where = tuple((c, "pluck", w) for c, w in string.weights(gesture.angle_deg).items())
    injections: list[Injection] = []
    known: list[KnownForce] = []
    for component, point, factor in where:
        basis = system.compiled[system.slot(component)].basis
        injections += compile_force(component, basis, point, gesture.segments, dt, first=first, factor=factor)
        known.append(KnownForce(component, component, point, tuple(gesture.segments), 0.0, factor))
    middle, edges = (first + np.arange(n) + 0.5) * dt, (first + np.arange(n + 1)) * dt
    controls = [
        PrescribedMotion(m.connection, first, **{m.quantity: m.course(edges if m.quantity == "offset" else middle)})
        for m in gesture.motions
    ]
    run, state = stepper(system), system.start()
    state.sample = first
    trace = None
    if energy:
        account, pieces = EnergyAccount(system, state.copy(), 1), []
        for done in range(0, n, 64):
            before = state.copy()
            pieces.append(run.run(state, min(64, n - done), injections, controls))
            account.follow(before, state, pieces[-1][1], injections, known, controls)
        out, forces = (np.concatenate(parts) for parts in zip(*pieces, strict=True))
        trace = account.trace()
    else:
        out, forces = run.run(state, n, injections, controls)
    assert run.statistics.failures == 0
    names = [c.name for c in system.connections]
    return Played(system, first * dt, out[:, 0], {name: forces[:, j] for j, name in enumerate(names)}, trace)


def band_energy(signal: Floats, low: float, high: float, fs: float = 48000) -> float:
    """Of a windowed piece of signal between two frequencies (Hz)."""
    spectrum = np.fft.rfft(signal * np.hanning(len(signal)))
    freq = np.fft.rfftfreq(len(signal), 1 / fs)
    return float(np.sum(np.abs(spectrum[(freq >= low) & (freq < high)]) ** 2))
