"""Attacks on stability: scenes that are meant to make energy, and the energy that they make.

Undamped where a loss could hide a gain. The energy is read from the states, by `physics.energy.account` and by the
energy budget of a render, which know nothing of how a step is made.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tonewood.instrument.bundle.loading import Instrument
from tonewood.lab.accuracy.timing import Tell, silent
from tonewood.lab.systems.harp_body import harp_body
from tonewood.lab.tables import number, table
from tonewood.performance.effects.base import Moment, SwitchedEffect, Watched
from tonewood.performance.effects.switching import switch
from tonewood.performance.effects.tension import potential
from tonewood.performance.score.note import Note, Score
from tonewood.physics.coupling.connections import Connection, Rigid, Term
from tonewood.physics.coupling.laws import Contact
from tonewood.physics.coupling.system import System
from tonewood.physics.energy.account import EnergyAccount
from tonewood.physics.energy.stored import stored_energy
from tonewood.physics.modal.modes import ModalBasis
from tonewood.physics.modal.string_modes import string_basis
from tonewood.physics.passivity.basis import repair_basis
from tonewood.physics.stepping.kernel import KernelStepper
from tonewood.physics.stepping.motion import from_motion, share_velocities
from tonewood.physics.stepping.stepper import Statistics
from tonewood.sound.render.renderer import Renderer
from tonewood.support.arrays import Floats

TEXT = """\
Growth: the largest rise of the stored energy above its lowest value before, while nothing acts from outside, relative
to the largest energy, per million steps; 0: it never rises. Residual: the largest part of the energy that the account
of forces, losses and switches leaves unexplained, relative to the largest energy, over the whole run; where a loss has
no account (a repaired body) it is left out. Iterations: Newton's method for the forces of laws, mean per step and
largest; *redone*: steps found by the search of last resort; *lost*: steps refused."""

#: Hz
RATES = (8000, 16000, 48000, 96000, 192000)
#: looks at the energy of a run
LOOKS = 50
#: N/m^1.5, of a contact as hard as a fret's
HARD = 2e9
#: a string without loss
LOSSLESS = {"law": "woodhouse", "eta_a": 0.0, "eta_f": 0.0, "eta_b": 0.0}


@dataclass(frozen=True, slots=True)
class Attack:
    """Result of one attack.

    name : in words.
    steps : made.
    growth : largest rise of the stored energy above its lowest value before, nothing acting from outside, relative to
        the largest energy, per 1e6 steps.
    residual : largest part of the energy that no account explains, relative to the largest energy.
    iterations, most : of the search for forces and tensions: mean per step, and in one step.
    redone : steps that the search of last resort found; `failures` are lost ones.
    """

    name: str
    steps: int
    growth: float
    residual: float
    iterations: float
    most: int
    redone: int
    failures: int


#: heading -> cell
COLUMNS: Mapping[str, Callable[[Attack], str]] = {
    "attack": lambda a: a.name,
    "steps": lambda a: f"{a.steps:.3g}",
    "growth per 1e6 steps": lambda a: number(a.growth),
    "largest residual": lambda a: number(a.residual),
    "iterations per step": lambda a: number(a.iterations),
    "most": lambda a: str(a.most),
    "redone": lambda a: str(a.redone),
    "lost": lambda a: str(a.failures),
}


def run(*, quick: bool = False, tell: Tell = silent) -> list[Attack]:
    """Make all attacks; a quick run makes a hundredth of the steps of the long ones."""
    less = 100 if quick else 1
    makes: list[Callable[[], Attack]] = [
        lambda: everything_on_one_string(0.1 if quick else 1.5),
        *(lambda fs=fs: stop_at_the_peak(fs) for fs in (RATES[:1] if quick else RATES)),
        lambda: switched_strings(100_000 // less),
        lambda: truncated_body(10_000_000 // less),
        lambda: unequal_masses(1e-9, 1_000_000 // less),
        lambda: unequal_masses(1e9, 1_000_000 // less),
        lambda: redundant_joints(1_000_000 // less),
        lambda: contradictory_joints(1_000_000 // less),
    ]
    out = []
    for i, make in enumerate(makes):
        out.append(make())
        tell((i + 1) / len(makes))
    return out


def section(attacks: Sequence[Attack]) -> str:
    """Markdown: the attacks and their results, a row per attack."""
    return f"{TEXT}\n\n{table(attacks, COLUMNS)}"


def everything_on_one_string(duration: float) -> Attack:
    """Rising tension, frets, a stopping finger and a bow on one string at 8 kHz."""
    instrument = Instrument.load("bowed_monochord").replace(
        {
            "strings.D3.plugin": "tension_modulated_string",
            "strings.D3.axial_stiffness": 35000.0,
            "stops": {"kind": "frets", "count": 12, "model": "finger"},
            "connections": {
                "frets": {
                    "plugin": "frets", "action_first": 4e-4, "action_twelfth": 1.6e-3, "stiffness": HARD,
                    "exponent": 1.5, "loss": 0.5,
                }
            },
            "tuning.compensate": "none",
        }
    )  # fmt: skip
    third = duration / 4
    notes = [
        Note(0.0, 0.9 * third, string="D3", stop=3, technique="bow"),
        Note(third, 0.9 * third, string="D3", stop=7, technique="bow"),
        Note(2 * third, third, string="D3", stop=5, force=50.0, technique="pluck"),
    ]
    options: dict[str, Any] = {"effects": "all", "oversampling": 1.0, "max_duration": duration, "energy": True}
    renderer = Renderer(Score(notes), instrument, 8000, **options)
    for _ in renderer.blocks(4096):
        pass
    trace = renderer.energy
    assert trace is not None  # asked for
    free = trace.time > 2.2 * third
    put_in = sum(trace.supplied.values()) + sum(trace.booked.values())
    energy = trace.total[free] - np.maximum(np.cumsum(put_in)[free] - np.cumsum(put_in)[free][0], 0.0)
    statistics = renderer.engine.stepper.statistics
    name = "rising tension, frets, finger and bow on one string, 8 kHz"
    return _attack(name, energy, trace.peak, statistics, residual=trace.worst_cumulative_residual)


def stop_at_the_peak(fs: int) -> Attack:
    """A stop changed where a plucked string of rising tension is farthest out, back and forth."""
    instrument = Instrument.load("electric_bass").replace({"connections": {}, "tuning.compensate": "none"})
    options: dict[str, Any] = {"effects": "all", "oversampling": 1.0}
    plain = Renderer(Score([Note(0.0, 1.0, string="G2", stop=0, force=14.0)]), instrument, fs, **options)
    engine, best, at = plain.engine, 0.0, 0.0
    while engine.state.sample < 0.05 * fs:
        engine.advance(1)
        stretch = potential(engine.system, engine.state, "G2")
        if engine.state.sample > 0 and stretch > best:
            best, at = stretch, engine.state.sample / fs
    notes = [Note(0.0, at, string="G2", stop=0, force=14.0), Note(at, 0.1, string="G2", stop=5, technique="hammer_on")]
    renderer = Renderer(Score(notes), instrument, fs, max_duration=at + 0.15, energy=True, **options)
    for _ in renderer.blocks(4096):
        pass
    trace = renderer.energy
    assert trace is not None  # asked for
    free = trace.time > at + 0.11
    residual = trace.worst_cumulative_residual
    name = f"a stop changed at the peak of displacement, rising tension, {fs / 1e3:g} kHz"
    return _attack(name, trace.total[free], trace.peak, renderer.engine.stepper.statistics, residual=residual)


def switched_strings(times: int) -> Attack:
    """Rising tension switched on and off, an interval of the control grid apart, with the energy that this takes."""
    instrument = Instrument.load("electric_bass").replace({"connections": {}, "strings.G2.loss": LOSSLESS})
    renderer = Renderer(Score([Note(0.0, 1e3, string="G2", stop=0, force=14.0)]), instrument, 48000, effects="auto")
    engine = renderer.engine
    (effect,) = (e for e in engine.effects if isinstance(e, SwitchedEffect))
    while engine.state.sample < 4800:
        engine.advance(1)
    state, now, energy = engine.state.copy(), effect.start(), []
    stepper = KernelStepper(engine.system)
    for i in range(times):
        system = stepper.system
        choice = Watched(frozenset(() if now.on else effect.components))
        now = switch(effect, Moment(system, state, engine.frettings, np.zeros(1)), now, choice)
        switched = effect.apply(system, now.on, engine.frettings)
        if switched is not system:
            effect.reset(switched, state, effect.components)
            stepper.exchange(switched)
        stepper.run(state, 64)
        if i % max(times // LOOKS, 1) == 0:
            energy.append(stored_energy(stepper.system, state).total)
    energies = np.array(energy)
    return _attack(f"rising tension switched {times:.0e} times", energies, energies.max(), stepper.statistics)


def _string(loss: float = 0.0, limit: float = 20e3) -> ModalBasis:
    string = string_basis(0.65, 71.6, 6.24e-3, 5.7e-5, lambda omega, k: np.full_like(omega, loss), freq_upper=limit)
    return string.with_places({"pluck": 0.11, "stop": 0.3})


def _followed(name: str, system: System, steps: int, size: float = 1e-3, residual: bool = True) -> Attack:
    """Let go from a shape in which every string's joint is closed."""
    state, stepper = system.start(), KernelStepper(system)
    basis = system.compiled[system.slot("string")].basis
    omega = np.sqrt(basis.stiffness)
    q = size * np.random.default_rng(1).normal(size=basis.n_modes) / omega * omega.min()
    end = basis.right[basis.index("bridge")].real
    system.modes_of(state, "string")[:] = from_motion(basis, q - end * (end @ q) / (end @ end), np.zeros(basis.n_modes))
    share_velocities(system, state)
    stepper.run(state, 2)
    account = EnergyAccount(system, state)
    energy = [sum(account.stored(state).values())]
    for _ in range(LOOKS):
        stepper.run(state, steps // LOOKS)
        energy.append(sum(account.stored(state).values()))
    energies = np.array(energy)
    off = float(np.abs(energies / energies[0] - 1).max()) if residual else None
    return _attack(name, energies, energies.max(), stepper.statistics, residual=off)


def truncated_body(steps: int) -> Attack:
    """A body of complex modes cut off and repaired, with an undamped string on it that hits a hard stop."""
    whole = harp_body()
    half = whole.select(whole.natural_freq < np.median(whole.natural_freq))
    body = repair_basis(half, ["s1"], max_change=10.0)
    links = [
        Connection("end", (Term("string", "bridge"), Term("body", "s1", -1.0)), Rigid()),
        Connection("hit", (Term("string", "stop", -1.0),), Contact(HARD, 1.5, offset=2e-5)),
    ]
    system = System.build({"string": _string(), "body": body}, links, [], dt=1 / 48000)
    return _followed(f"a truncated complex body under hard contact, {steps:.0e} steps", system, steps, residual=False)


def _on_body(mass: float, links: Sequence[Connection]) -> System:
    omega = 2 * np.pi * np.array([97.0, 204.0, 431.0])
    body = ModalBasis.real(omega, np.zeros(3), {"s1": np.array([1.0, -0.7, 0.4])}, modal_mass=mass)
    return System.build({"string": _string(), "body": body}, links, [], dt=1 / 48000)


def _joint(name: str = "end", offset: float = 0.0, share: float = 1.0) -> Connection:
    return Connection(name, (Term("string", "bridge", share), Term("body", "s1", -share)), Rigid(offset))


def unequal_masses(mass: float, steps: int) -> Attack:
    """An undamped string on a body of some mass."""
    return _followed(f"a body of {mass:g} kg", _on_body(mass, [_joint()]), steps)


def redundant_joints(steps: int) -> Attack:
    """State one joint four times, once in other units and once nearly."""
    links = [_joint(), _joint("again"), _joint("thousandfold", share=1e3)]
    terms = (Term("string", "bridge"), Term("body", "s1", -1.0), Term("string", "stop", 1e-9))
    return _followed("redundant joints", _on_body(0.1, [*links, Connection("nearly", terms, Rigid())]), steps)


def contradictory_joints(steps: int) -> Attack:
    """Ask one gap to be 1 and 3 micrometres wide."""
    links = [_joint("one", 1e-6), _joint("three", 3e-6)]
    return _followed("contradictory joints", _on_body(0.1, links), steps, size=1e-2)


def _attack(name: str, energy: Floats, peak: float, statistics: Statistics, *, residual: float | None = None) -> Attack:
    lowest = np.minimum.accumulate(energy)
    steps = max(statistics.steps, 1)
    searched = statistics.iterations
    return Attack(
        name,
        statistics.steps,
        float((energy - lowest).max() / peak * 1e6 / steps),
        float("nan") if residual is None else residual,
        searched / steps,
        statistics.most_iterations,
        statistics.redone,
        statistics.failures,
    )
