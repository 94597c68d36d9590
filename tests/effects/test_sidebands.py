"""Sidebands of a rising tension: their closed form and their bound against strings whose tension does rise."""

from __future__ import annotations

import numpy as np
import pytest
from effect_scenes import FS, tension_effect
from numpy.typing import NDArray
from scipy.signal.windows import blackmanharris
from tension_scenes import guitar

import tonewood as tw
from tonewood.instrument.model.assembly import Model, assemble
from tonewood.performance.effects import sidebands
from tonewood.performance.effects.bridge_response import BridgeResponse
from tonewood.performance.effects.sidebands import Sidebands
from tonewood.performance.player.fretting import Fretting
from tonewood.physics.coupling.system import State
from tonewood.physics.modal.held_modes import HeldModes
from tonewood.physics.stepping.kernel import KernelStepper
from tonewood.physics.stepping.motion import from_motion, share_velocities, to_motion

Floats = NDArray[np.float64]
STRINGS = [("steel_strings", "G3"), ("classical_guitar", "B3")]


def partials(model: Model, name: str, rng: np.random.Generator, cents: dict[int, float]) -> tuple[State, HeldModes]:
    """A string on its body in some partials of one plane with random phases.

    Each is the motion of the linear instrument at one frequency, seen through a window, and alone would raise the
    string's pitch by so many cents in the mean.
    """
    system, component = model.system.with_potentials([]), model.strings[name].components[0]
    basis = system.compiled[system.slot(component)].basis
    held = HeldModes.of(basis, "bridge")
    law = next(t for t in system.potentials if t.name == name)
    tension, length = (float(basis.metadata[key]) for key in ("tension", "length"))  # type: ignore[arg-type]  # numbers
    numbers, n = list(cents), FS // 4
    v = np.sum(held.vectors[np.array(numbers) - 1], axis=0)
    state, stepper = system.start(), KernelStepper(system)
    system.modes_of(state, component)[:] = from_motion(basis, 0.0 * v, v)
    share_velocities(system, state)
    freq = held.freq_rad[np.array(numbers) - 1]
    window = blackmanharris(n)
    found = np.zeros((len(numbers), *state.modes.shape), dtype=complex)
    for i in range(n):
        found += window[i] * np.exp(-1j * freq * i / FS)[:, None, None] * state.modes
        stepper.run(state, 1)
    out = system.start()
    for number, shape in zip(numbers, found, strict=True):
        out.modes[:] = np.real(shape * np.exp(1j * rng.uniform(0, 2 * np.pi)))
        q, v = to_motion(basis, np.array(system.modes_of(out, component)))
        u = held.vectors[number - 1]
        speed = np.hypot(u @ v, (u * held.stiffness) @ q / held.freq_rad[number - 1])
        # cents = (1200 / ln 2) dT / 2T, dT = EA E / (2 L T)
        energy = cents[number] * np.log(2) / 1200 * 4 * length * tension**2 / law.axial_stiffness
        state.modes[:] = (state.modes if number != numbers[0] else 0.0) + np.sqrt(2 * energy) / speed * out.modes
    state.sample = 0
    return state, held


def bounds(model: Model, name: str, state: State) -> tuple[Sidebands, dict[str, tuple[Floats, Floats]]]:
    system = model.system
    motion = {
        c: to_motion(system.compiled[system.slot(c)].basis, np.array(system.modes_of(state, c)))
        for c in model.strings[name].components
    }
    return tension_effect(model).bounds.sidebands(name, system, Fretting()), motion


def line(y: Floats, freq: float, fs: float = FS) -> float:
    """Amplitude at a frequency, under a window whose side lobes lie below -90 dB."""
    window = blackmanharris(len(y))
    return 2 * abs(np.sum(window * y * np.exp(-2j * np.pi * freq * np.arange(len(y)) / fs))) / float(window.sum())


@pytest.mark.slow
@pytest.mark.parametrize("cents", [0.05, 0.45])
@pytest.mark.parametrize(("guitar_name", "name"), STRINGS)
def test_sidebands_are_those_of_the_closed_form(guitar_name: str, name: str, cents: float) -> None:
    """In the force on the bridge, (dT / 2T) w^2 / |w_n^2 - w^2| of partial n's; 1.4 to 1.9 dB more at any rate."""
    model = assemble(guitar(guitar_name, (name,), mode="all"), FS)
    m, n = {"G3": (1, 5), "B3": (2, 7)}[name]
    state, held = partials(model, name, np.random.default_rng(1), {m: cents, n: 0.02 * cents})
    bridge = [c.name for c in model.system.connections].index(f"{name}.z.bridge")
    force = KernelStepper(model.system).run(state, FS // 4)[1][:, bridge]
    w = held.freq_rad / (2 * np.pi)
    push = held.force / held.freq_rad
    sizes = {k: line(force, w[k - 1]) for k in (m, n)}
    found, _ = bounds(model, name, model.system.start())
    # dT / 2T of now, from the velocity that partial m's force tells
    rise = found.rise * 0.5 * (sizes[m] / push[m - 1]) ** 2
    # the upper one; where the lower one falls, partials are more nearly in tune
    freq = w[n - 1] + 2 * w[m - 1]
    expected = rise * freq**2 / (freq**2 - w[n - 1] ** 2) * sizes[n]
    assert 20 * np.log10(line(force, freq) / expected) == pytest.approx(1.7, abs=0.4)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(("guitar_name", "name"), STRINGS)
def test_what_is_missing_stays_below_its_bound(guitar_name: str, name: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    model = assemble(guitar(guitar_name, (name,), mode="all"), FS)
    numbers = [int(k) for k in rng.choice(np.arange(1, 11), 3, replace=False)]
    state, held = partials(model, name, rng, {k: 10 ** rng.uniform(-1.5, -0.3) for k in numbers})
    on, off = model.system, model.system.with_potentials([])
    sounds = [KernelStepper(system).run(state.copy(), FS // 4)[0] for system in (on, off)]
    found, motion = bounds(model, name, state)
    peak = np.abs(sounds[1]).max(axis=0)
    w = held.freq_rad / (2 * np.pi)
    lines = {abs(w[i - 1] + 2 * sign * w[j - 1]) for i in numbers for j in numbers for sign in (-1, 1)}
    # a sideband at a partial itself is its shift of pitch
    apart = [f for f in lines if all(abs(f - w[k - 1]) > 20 for k in numbers)]
    assert apart
    lost = max(sum(line(sounds[0][:, r] - sounds[1][:, r], f) for f in apart) / p for r, p in enumerate(peak))
    bound = found.level(motion, peak)
    assert 0.0 < lost <= bound < 20 * lost


def test_energies_are_those_without_the_bridge_s_motion() -> None:
    """Motion in the shape that follows the bridge alone has none; motion across it has all its own."""
    model = assemble(guitar("steel_strings", ("G3",), mode="all"), FS)
    found, motion = bounds(model, "G3", model.system.start())
    name, plane = next(iter(found.planes.items()))
    rng, n = np.random.default_rng(5), len(motion[name][0])
    q, v = rng.standard_normal((2, n)) * 1e-4
    followed, static = plane.shape, plane.shape / plane.stiffness
    assert plane.energies(1e-4 * static, 1e-3 * followed) == pytest.approx(
        (0.0, 0.0), abs=1e-6 * (1e-3 * followed @ followed) ** 2
    )
    v -= followed * (followed @ v) / (followed @ followed)
    q -= static * (followed @ q) / (followed @ static)
    own = (0.5 * plane.stiffness @ (q * q), 0.5 * v @ v)
    assert plane.energies(q, v) == pytest.approx(own, rel=1e-9)
    assert plane.energies(q + 1e-4 * static, v + 1e-3 * followed) == pytest.approx(own, rel=1e-6)


def test_the_bound_is_cubic_and_grows_by_what_is_pulled() -> None:
    model = assemble(guitar("steel_strings", ("G3",), mode="all"), FS)
    state, _ = partials(model, "G3", np.random.default_rng(3), {1: 0.2, 3: 0.05})
    found, motion = bounds(model, "G3", state)
    peak = np.ones(len(model.system.readouts))
    level = found.level(motion, peak)
    double = {c: (2 * q, 2 * v) for c, (q, v) in motion.items()}
    assert found.level(double, peak) == pytest.approx(8 * level, rel=1e-9)
    pulled = {c: 1e-6 * np.ones_like(q) for c, (q, _) in motion.items()}
    assert found.level(motion, peak, pulled) > level


def test_a_pluck_at_rest_has_the_bound_of_its_shape() -> None:
    """A string at rest that will be released is as one that has its displacement already, at rest as well."""
    name = "B3"
    model = assemble(guitar("classical_guitar", (name,), mode="all"), FS)
    found, motion = bounds(model, name, model.system.start())
    peak = np.ones(len(model.system.readouts))
    rng = np.random.default_rng(2)
    drawn = {c: 1e-5 * rng.standard_normal(len(q)) for c, (q, _) in motion.items()}
    rest = {c: (0.0 * q, 0.0 * v) for c, (q, v) in motion.items()}
    assert found.level(rest, peak) == 0.0
    foreseen = found.level(rest, peak, plucked=drawn)
    still = {c: (drawn[c], 0.0 * v) for c, (_, v) in motion.items()}
    # what a switch would do to the force of the bridge now is no part of what is foreseen
    assert 0.0 < foreseen <= found.level(still, peak) * (1 + 1e-12)
    twice = found.level(rest, peak, plucked={c: 2 * q for c, q in drawn.items()})
    assert twice == pytest.approx(8 * foreseen, rel=1e-9)  # rise with the square, times the partial


def test_partials_counted_together_are_bounded_as_if_counted_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of an accelerometer on the string, whose sidebands grow with the square of their frequency."""
    instrument = guitar("steel_strings", ("G3",), mode="all")
    values = dict(instrument.resolved)
    values["strings"]["G3"]["points"] = {"sensor": {"from_bridge": 0.11}}
    sensor = {"plugin": "point_pickup", "name": "sensor", "quantity": "acceleration", "at": "G3.sensor"}
    values["outputs"] = [sensor | {"full_scale": 1.0}]
    model = assemble(tw.Instrument.from_values(values, instrument.folder), FS)
    together = tension_effect(model).bounds.sidebands("G3", model.system, Fretting())
    monkeypatch.setattr(sidebands, "_BEATING", 40)
    alone = Sidebands.of(
        {c: model.system.compiled[model.system.slot(c)] for c in model.strings["G3"].components}, together.rise,
        model.system, BridgeResponse(model),
    )  # fmt: skip
    for name, plane in together.planes.items():
        first, last = plane.heard.shape[-1] - 1, alone.planes[name].heard.shape[-1] - 1
        each = alone.planes[name].heard[..., first:last].max(axis=-1)
        assert np.all(each <= plane.heard[..., -1])
        assert np.all(each > 0.0)
