"""Every kind of string on one light body, each touched and played by everything there is, as any bundle may ask for."""

from __future__ import annotations

import itertools
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.linalg as sla
from numpy.typing import NDArray
from scene import instrument
from test_geometric_string import STEEL

import tonewood as tw
from tonewood.instrument.bundle.loading import Instrument
from tonewood.instrument.model.assembly import assemble
from tonewood.performance.engine.engine import Engine
from tonewood.performance.player.playing import perform
from tonewood.physics.coupling.connections import Connection, Rigid, Term
from tonewood.physics.coupling.laws import Contact
from tonewood.physics.coupling.potentials.longitudinal import GeometricStretch
from tonewood.physics.coupling.potentials.tension import TensionModulation
from tonewood.physics.coupling.system import State, System
from tonewood.physics.energy.stored import stored_energy
from tonewood.physics.modal.modes import ModalBasis
from tonewood.physics.modal.string_modes import string_basis
from tonewood.physics.stepping.kernel import KernelStepper
from tonewood.physics.stepping.motion import from_motion, to_motion
from tonewood.physics.stepping.stepper import NumpyStepper

Floats = NDArray[np.float64]

PLAIN = {k: v for k, v in STEEL.items() if k not in ("freq_coupled", "axial_stiffness")} | {"freq_upper": 3000.0}
STRINGS: dict[str, dict[str, Any]] = {
    "plain": {**PLAIN, "plugin": "stiff_string", "note": "A3", "linear_density": 1.3e-3},
    "rising": {**PLAIN, "plugin": "tension_modulated_string", "axial_stiffness": 12000.0, "note": "C4",
               "linear_density": 9e-4},
    "along": {**PLAIN, "plugin": "geometric_string", "axial_stiffness": 14612.0, "freq_coupled": 900.0, "note": "E4",
              "freq_upper": 3000.0},
}  # fmt: skip
PARTS: dict[str, dict[str, Any]] = {
    "frets": {"plugin": "frets", "action_first": 3e-4, "action_twelfth": 8e-4, "stiffness": 1e7},
    "bridge": {"plugin": "bridge_barrier", "start": 1e-3, "stop": 0.01, "radius": 0.5, "stiffness": 1e8, "points": 4,
               "loss": 0.2, "thread": {"from_bridge": 0.004, "width": 0.001, "stiffness": 1e4, "damping": 0.3}},
    "ring": {"plugin": "rattle", "from_bridge": 0.3, "mass": 1e-3, "clearance": 1e-5, "stiffness": 3e6},
    "cloth": {"plugin": "listing", "from_bridge": 0.02, "width": 0.01, "points": 2, "damping": 0.02},
}  # fmt: skip
HANDS: dict[str, dict[str, Any]] = {
    "pluck": {"plugin": "pluck_ramp", "from_bridge": 0.12, "angle_deg": 30, "ramp_time": 0.004},
    "plectrum": {"plugin": "plectrum", "from_bridge": 0.1, "force": 2.0, "speed": 1.0},
    "hammer": {"plugin": "hammer", "from_bridge": 0.1, "mass": 3e-3, "stiffness": 1e7, "loss": 0.1, "velocity": 2.0},
    "bow": {"plugin": "bow", "from_bridge": 0.06, "force": 0.6, "velocity": 0.2, "attack_time": 0.004},
    "palm": {"plugin": "stopping_finger", "touch": 0.02, "width": 0.01, "lift": 0.01, "ramp_time": 0.004},
    "slide": {"plugin": "left_hand", "action": "slide", "time": 0.012},
}


def band(folder: Path, **more: Any) -> Instrument:
    """Three strings and a plate that a string easily moves."""
    (folder / "plate.csv").write_text("f_Hz,Q,modal_mass,bridge\n180,20,0.05,1\n430,25,0.08,-0.7\n")
    body = {"plugin": "modal_table", "table": "plate.csv", "shapes": "points", "points": {"bridge": {"direction": "z"}}}
    strings = {name: {**s, "end": "body.bridge"} for name, s in STRINGS.items()}
    heard = [{"name": "plate", "plugin": "point_pickup", "quantity": "velocity", "at": "body.bridge", "full_scale": 1}]
    parts = {"body": body, "exciters": HANDS, "connections": PARTS, "stops": {"kind": "frets", "count": 14}, **more}
    return instrument(folder, strings=strings, outputs=heard, **parts)


#: every kind of string is played by every hand, over stops, bends and ends of notes
BUSY = tw.Score(
    [
        tw.Note(0.015 * i + 0.005 * j, 0.013, string=string, stop=(3 * i + j) % 6, technique=hand, force=force)
        for j, string in enumerate(STRINGS)
        for i, (hand, force) in enumerate(
            [("pluck", 4.0), ("plectrum", None), ("hammer", None), ("bow", None), ("palm", 3.0), ("slide", 2.0)]
        )
    ],
    [tw.Control(0.013, "bend", 80.0), tw.Control(0.051, "bend", -150.0), tw.Control(0.08, "bend", 0.0)],
)


@pytest.mark.slow
def test_a_render_of_everything_adds_up_and_knows_no_blocks(tmp_path: Path) -> None:
    """The energy budget closes in every interval; every part acts on every string; blocks change no sample."""
    made = band(tmp_path)
    kinds = {p.name: type(p) for p in assemble(made, 12000).system.potentials}
    assert kinds == {"along": GeometricStretch, "rising": TensionModulation}

    def renderer(**options: Any) -> tw.Renderer:
        return tw.Renderer(BUSY, made, 12000, max_duration=0.12, **options)

    booked = renderer(energy=True)
    whole = np.concatenate(list(booked.blocks()))
    trace = booked.energy
    assert trace is not None
    assert trace.worst_residual < 1e-11
    for string in STRINGS:
        for part in (*PARTS, "hammer", "bow", "plectrum", "palm"):
            lost = sum(v.sum() for name, v in trace.lost.items() if name.startswith(f"{string}.{part}"))
            assert lost > 0, (string, part)
    assert trace.stored["along.longitudinal"].max() > 0

    stream = (other := renderer()).blocks(100)
    first = list(itertools.islice(stream, 7))
    checkpoint = other.snapshot()
    np.testing.assert_array_equal(np.concatenate([*first, *stream]), whole)
    other.restore(checkpoint)
    np.testing.assert_array_equal(np.concatenate(list(other.blocks(7))), whole[700:])


def two(fs: float = 24000) -> tuple[System, System]:
    """A string of rising tension on a light mass, over an edge: alone, and beside one with longitudinal motion."""
    loss = lambda omega, k: np.full_like(omega, 1e-3)  # noqa: E731
    made = {
        f"{name}{p}": string_basis(0.645, T, mu, 8e-5, loss, freq_upper=9000.0).with_places({"edge": 0.2})
        for name, T, mu in (("rising", 80.0, 9e-4), ("along", 104.0, 5.76e-4))
        for p in (1, 2)
    }
    made["long"] = string_basis(0.645, 14612.0, 5.76e-4, 0.0, loss, freq_upper=9000.0)
    for name in ("rising", "along"):
        made[f"{name} body"] = ModalBasis.real([2e3], [50.0], {"bridge": [1.0]}, modal_mass=0.05)

    def built(names: list[str], **stretch: Any) -> System:
        ends = [
            Connection(n, (Term(n, "bridge"), Term(f"{'rising' if 'rising' in n else 'along'} body", "bridge", -share)),
                       Rigid())
            for n, share in zip(names, (1.0, 0.0, 1.0, 0.0, 0.2), strict=False)
        ]  # fmt: skip
        parts = {n: made[n] for n in (*names, *(f"{s} body" for s in ("rising", "along") if f"{s}1" in names))}
        edge = Connection("edge", (Term("rising1", "edge"),), Contact(1e8, 1.5, 0.2, offset=-1e-4))
        return System.build(parts, [*ends, edge], dt=1 / fs, **stretch)

    rising = ("rising1", "rising2")
    alone = built(list(rising), potentials=[TensionModulation("rising", rising, 12000.0)])
    beside = built(
        [*rising, "along1", "along2", "long"],
        potentials=[
            GeometricStretch("along", ("along1", "along2"), "long", 14612.0, 2000.0),
            TensionModulation("rising", rising, 12000.0),
        ],
    )
    return alone, beside


def drawn(system: System, names: dict[str, float], place: float = 0.15) -> State:
    """A state of strings drawn aside at a place (m from the bridge) by so many metres, and at rest."""
    state = system.start()
    for name, height in names.items():
        basis = system.compiled[system.slot(name)].basis
        vec: Any = basis.metadata["vec"]
        L = 0.645
        k = np.arange(1, len(vec)) * np.pi / L
        bent = np.concatenate([[0.0], 2 * height * L**2 * np.sin(k * place) / (place * (L - place) * (k * L) ** 2)])
        system.modes_of(state, name)[:] = from_motion(basis, sla.solve(vec, bent), np.zeros(basis.n_modes))
    return state


@pytest.mark.parametrize("height", [2e-3, 1e-2])
def test_a_rising_tension_is_the_same_beside_another_string(height: float) -> None:
    """A potential of another kind beside it changes nothing."""
    for k in (1, 2):
        alone, beside = two(24000 * k)
        pulled = {"rising1": height, "rising2": 0.4 * height}
        a, b = drawn(alone, pulled), drawn(beside, {**pulled, "along1": -height})
        runs = [KernelStepper(s).run(state, 200 * k)[1] for s, state in ((alone, a), (beside, b))]
        assert runs[0][:, -1].any()  # it meets the edge
        assert beside.modes_of(b, "long").any()
        here, there = (
            np.concatenate([to_motion(s.compiled[s.slot(n)].basis, s.modes_of(x, n))[0][:8] for n in pulled])
            for s, x in ((alone, a), (beside, b))
        )
        assert np.abs(there - here).max() < 1e-12 * np.abs(here).max()


@pytest.mark.parametrize("height", [2e-3, 2e-2])
def test_kernel_and_twin_agree_on_both_kinds(height: float) -> None:
    _, system = two()
    runs = []
    for stepper in (KernelStepper, NumpyStepper):
        state = drawn(system, {"rising1": height, "rising2": 0.4 * height, "along1": -height, "along2": 0.2 * height})
        _, forces = stepper(system).run(state, 60)
        runs.append(forces)
    np.testing.assert_allclose(*runs, rtol=0, atol=1e-8 * np.abs(runs[1]).max())


@pytest.mark.validate
@pytest.mark.parametrize("height", [2e-3, 1e-2])
def test_energy_of_both_kinds_falls_over_a_million_steps(height: float) -> None:
    """Over an edge, on a light body, both strings drawn far aside: looked at each 500 steps, energy never rises."""
    _, system = two()
    state = drawn(system, {"rising1": height, "rising2": 0.4 * height, "along1": -height, "along2": 0.2 * height})
    stepper = KernelStepper(system)
    energy = [stored_energy(system, state).total]
    for _ in range(2000):
        stepper.run(state, 500)
        energy.append(stored_energy(system, state).total)
    assert stepper.statistics.failures == 0
    assert np.all(np.diff(energy) <= 1e-12 * energy[0])
    assert energy[-1] < 1e-3 * energy[0]


@pytest.mark.validate
@pytest.mark.parametrize("kind", ["tension_modulated_string", "geometric_string"])
@pytest.mark.parametrize("name", sorted(set(tw.list_instruments()) - {"gong"}))  # a plate: no string to replace
def test_every_bundle_takes_every_kind_of_string(name: str, kind: str) -> None:
    """Played by its own hands in turn: all steps are found, and nothing is louder than four times the linear sound."""
    base = tw.load_instrument(name)
    strings = list(base.spec.strings)
    hands = [h for h, e in base.exciters.items() if e.at is None]
    notes = [tw.Note(0.02 * i, 0.1, string=s, stop=0, velocity_midi=120) for i, s in enumerate(strings[:3])]
    notes += [tw.Note(0.15 + 0.04 * i, 0.04, string=strings[0], stop=0, technique=h) for i, h in enumerate(hands)]
    values = json.loads(json.dumps(base.resolved))
    for string in values["strings"].values():
        for key in ("freq_coupled", "bridge_leverage", "longitudinal_loss"):
            string.pop(key, None)
        string["plugin"], string["axial_stiffness"] = kind, string.get("axial_stiffness", 40 * string["tension"])
    peaks = []
    for made in (base, Instrument.from_values(values, base.folder)):
        x = tw.render(tw.Score(notes), made, max_duration=0.2 + 0.04 * len(hands)).samples
        assert np.all(np.isfinite(x))
        peaks.append(np.abs(x).max())
    assert 0.25 * peaks[0] < peaks[1] < 4 * peaks[0]


def test_quiet_strings_beside_a_loud_one() -> None:
    """Strings that hardly move take part in the same solve as a loud one next to them."""
    guitar = tw.load_instrument("steel_strings").replace({"strings.E4.plugin": "geometric_string"})
    notes = (
        tw.Note(0.02, 0.5, string="E4", stop=0, velocity_midi=40),
        tw.Note(0.12, 0.5, string="E4", stop=0, velocity_midi=127),
    )
    model = assemble(guitar, 48000)
    engine = Engine(model, perform(tw.Score(notes), model).timeline)
    while engine.state.sample < 0.13 * 48000:
        engine.advance(1)
    assert engine.stepper.statistics.redone == engine.stepper.statistics.failures == 0
    assert np.all(np.isfinite(engine.state.modes))
