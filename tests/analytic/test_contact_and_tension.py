"""Contacts and rising tension against closed forms: a mass on a barrier, a string over an obstacle, one mode, a bow,
a spring."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from scipy.special import ellipk, gamma

import tonewood as tw
from tonewood.physics.coupling.connections import Connection, Term
from tonewood.physics.coupling.laws import Contact, Friction
from tonewood.physics.coupling.potentials.tension import TensionModulation
from tonewood.physics.coupling.system import Readout, System
from tonewood.physics.energy.stored import stored_energy
from tonewood.physics.modal.modes import ModalBasis
from tonewood.physics.stepping.kernel import KernelStepper

BOTH = [Readout("u", "displacement", (Term("part", "p"),)), Readout("v", "velocity", (Term("part", "p"),))]


def bounce(rate, mass=0.01, stiffness=1e8, exponent=1.3, speed=2.0):
    """Contact time and exit speed of a free mass thrown at a barrier, from straight lines before and after."""
    basis = ModalBasis.real([0.0], [0.0], {"p": [1.0]}, modal_mass=mass)
    barrier = Connection("barrier", (Term("part", "p"),), Contact(stiffness, exponent))
    system = System.build({"part": basis}, [barrier], BOTH, dt=1 / rate)
    state = system.start()
    start = 4.3 * speed / rate
    state.modes[:, 0] = start * math.sqrt(mass), -speed * math.sqrt(mass)
    n = int(rate * 2e-4) + 30
    stepper = KernelStepper(system)
    out, forces = stepper.run(state, n)
    assert stepper.statistics.failures == 0
    u, v = out[-1]
    return (n - 1) / rate - u / v - start / speed, v, forces


def test_a_free_mass_leaves_a_barrier_as_fast_as_it_came():
    n, K, m, v = 1.3, 1e8, 0.01, 2.0
    depth = ((n + 1) * m * v**2 / (2 * K)) ** (1 / (n + 1))
    contact_time = 2 * depth / v * math.sqrt(math.pi) * gamma(1 + 1 / (n + 1)) / gamma(0.5 + 1 / (n + 1))
    errors = []
    for rate in (96e3, 192e3, 384e3, 768e3):
        time, leaving, _ = bounce(rate)
        errors.append(abs(time / contact_time - 1))
        assert leaving == pytest.approx(v, rel=1e-12)
    assert errors[-1] < 1e-4
    orders = np.log2(np.array(errors[:-1]) / np.array(errors[1:]))
    np.testing.assert_allclose(orders, 2.0, atol=0.05)


def midpoint_obstacle(rate, stiffness, residual, cycles=30):
    """A triangular pluck at the middle over a rigid obstacle there at rest level: period, contact share, force."""
    length, tension, density, height = 0.65, 70.0, 3.6e-3, 1e-3
    speed = math.sqrt(tension / density)
    n = np.arange(1, int(0.45 * rate * 2 * length / speed) + 1, 2)  # odd modes: the rest never move
    omega = n * math.pi * speed / length
    options = {"static_compliance": lambda x, y: min(x, y) * (length - max(x, y)) / (length * tension)}
    basis = ModalBasis.real(
        omega, 0 * omega, {"p": length / 2}, modal_mass=density * length / 2,
        shape=lambda x: np.sin(n * math.pi * x / length), **(options if residual else {}),
    )  # fmt: skip
    barrier = Connection("barrier", (Term("part", "p"),), Contact(stiffness))
    system = System.build({"part": basis}, [barrier], BOTH, dt=1 / rate)
    state = system.start()
    a = 8 * height * np.sin(n * math.pi / 2) / (n * math.pi) ** 2
    state.modes[0, : len(n)] = 0.5 * a * math.sqrt(density * length / 2)
    period = 0.75 * 2 * length / speed
    _, forces = KernelStepper(system).run(state, int((cycles + 1) * period * rate))
    f = forces[:, 0]
    # each cycle's contact is centred half a period after the last release of the pluck's shape
    centres = []
    for c in range(cycles):
        window = slice(int(c * period * rate), int((c + 1) * period * rate))
        t = (np.arange(len(f))[window] + 0.5) / rate
        centres.append(np.sum(t * f[window]) / np.sum(f[window]))
    slope = np.polyfit(np.arange(cycles), centres, 1)[0]
    share = np.mean(f > 0.02 * 4 * tension * height / length)
    pressing = np.median(f[f > 0.5 * 4 * tension * height / length])
    return slope / period, share, pressing / (4 * tension * height / length)


def test_string_over_an_obstacle_at_its_middle():
    period, share, force = midpoint_obstacle(48e3, 1e10, residual=True)
    assert 1200 * abs(math.log2(period)) < 0.3
    assert share == pytest.approx(1 / 3, abs=0.02)
    assert force == pytest.approx(1.0, abs=0.02)


def test_residual_compliance_of_the_obstacle_takes_the_detuning_away():
    with_residual = [abs(midpoint_obstacle(rate, 1e10, True)[0] - 1) for rate in (48e3, 96e3)]
    without = [abs(midpoint_obstacle(rate, 1e10, False)[0] - 1) for rate in (48e3, 96e3)]
    assert with_residual[0] < 0.3 * without[0]
    assert 1.5 < without[0] / without[1] < 2.7


def frequency(u, rate):
    """Of a periodic signal, from its rising zeros, each found on a cubic through four samples."""
    rising = np.flatnonzero((u[:-1] < 0) & (u[1:] >= 0))
    rising = rising[(rising > 1) & (rising < len(u) - 3)]
    zeros = []
    for i in rising:
        roots = np.roots(np.polyfit(np.arange(-1.0, 3.0), u[i - 1 : i + 3], 3))
        real = roots[np.abs(roots.imag) < 1e-9].real
        zeros.append(i + real[np.argmin(np.abs(real - 0.5))])
    return rate * (len(zeros) - 1) / (zeros[-1] - zeros[0])


STEEL = {"density": 8050 * math.pi * 0.3556e-3**2, "tension": 75.0, "young": 174e9, "radius": 0.3556e-3, "length": 1.0}


def steel_string(n_modes, rate, components=("part",), axial=True, damping=0.0):
    area = math.pi * STEEL["radius"] ** 2
    stiffness = STEEL["young"] * math.pi * STEEL["radius"] ** 4 / 4
    p = np.arange(1, n_modes + 1) * math.pi / STEEL["length"]
    omega = np.sqrt((STEEL["tension"] * p**2 + stiffness * p**4) / STEEL["density"])
    basis = ModalBasis.real(
        omega, damping + 0 * omega, {"p": 0.5, "q": 0.13}, modal_mass=STEEL["density"] * STEEL["length"] / 2,
        shape=lambda x: np.sin(p * x), metadata={"length": STEEL["length"], "tension_part": p**2 / STEEL["density"]},
    )  # fmt: skip
    tension = TensionModulation("string", components, STEEL["young"] * area if axial else 0.0)
    readouts = [Readout(name, "displacement", (Term(name, "p"),)) for name in components]
    return System.build(dict.fromkeys(components, basis), [], readouts, dt=1 / rate, potentials=[tension])


@pytest.mark.parametrize(("amplitude", "printed"), [(0.0005, 76.598626), (0.001, 76.647562), (0.002, 76.842943)])
def test_one_mode_of_a_tension_modulated_string_is_a_duffing_oscillator(amplitude, printed):
    rate = 48e3
    system = steel_string(1, rate)
    state = system.start()
    state.modes[0, 0] = 0.5 * amplitude * math.sqrt(STEEL["density"] / 2)
    out, _ = KernelStepper(system).run(state, int(rate))
    p, area = math.pi, math.pi * STEEL["radius"] ** 2
    stiffness = STEEL["young"] * math.pi * STEEL["radius"] ** 4 / 4
    squared = (STEEL["tension"] * p**2 + stiffness * p**4) / STEEL["density"]
    cubic = STEEL["young"] * area * p**4 / (4 * STEEL["density"])
    m = cubic * amplitude**2 / (2 * (squared + cubic * amplitude**2))
    exact = math.sqrt(squared + cubic * amplitude**2) / (4 * ellipk(m))
    assert exact == pytest.approx(printed, abs=2e-6)
    assert 1200 * abs(math.log2(frequency(out[:, 0], rate) / exact)) < 0.01


def test_a_plane_motion_whirls_when_its_tension_is_shared():
    rate = 48e3
    moved = []
    for axial in (True, False):
        system = steel_string(8, rate, ("x", "y"), axial)
        state = system.start()
        for name, amplitude in (("x", 3e-3), ("y", 3e-4)):
            system.modes_of(state, name)[0, 0] = 0.5 * amplitude * math.sqrt(STEEL["density"] / 2)
        system.modes_of(state, "y")[1, 0] = system.modes_of(state, "y")[0, 0]  # out of phase: an ellipse
        before = stored_energy(system, state).total
        out, _ = KernelStepper(system).run(state, int(rate))
        assert stored_energy(system, state).total == pytest.approx(before, rel=1e-7)
        # the axis of the ellipse over the first and the last twentieth of a second
        angles = [0.5 * np.angle(np.sum((out[s, 0] + 1j * out[s, 1]) ** 2)) for s in (slice(2400), slice(-2400, None))]
        moved.append(abs(angles[1] - angles[0]))
    assert moved[0] > 0.1
    assert moved[1] < 0.02


def test_pitch_of_a_plucked_tension_modulated_string_glides_down():
    rate = 48e3
    system = steel_string(30, rate, damping=3.0)
    state = system.start()
    n = np.arange(1, 31)
    a = 2 * 4e-3 / (n * math.pi) ** 2 * np.sin(n * math.pi * 0.13) / (0.13 * 0.87)
    state.modes[0, :30] = 0.5 * a * math.sqrt(STEEL["density"] / 2)
    stepper, linear = KernelStepper(system), steel_string(1, rate).compiled[0].basis.poles.imag[0] / (2 * math.pi)
    tensions, kappa = [], system.joined(0).shares[0].kappa
    for _ in range(30):
        stepper.run(state, 1600)
        tensions.append(2 * math.sqrt(2 * kappa * stored_energy(system, state).potentials))
    cents = 600 * np.log2(1 + np.array(tensions) / STEEL["tension"])
    assert cents[0] > 5
    assert np.polyfit(np.arange(30), cents, 1)[0] < 0
    assert cents[-1] < 0.1
    assert linear == pytest.approx(76.582306, abs=1e-5)


class TestBow:
    rate = 48e3

    def scene(self, force, velocity=0.1, place=0.13, n_modes=60):
        length, tension, density = 0.325, 50.0, 6e-4 * 4
        n = np.arange(1, n_modes + 1)
        omega = n * math.pi / length * math.sqrt(tension / density)
        basis = ModalBasis.real(
            omega, 2.0 + 3e-4 * omega, {"p": place * length, "bridge": 1e-9}, modal_mass=density * length / 2,
            shape=lambda x: np.sin(n * math.pi * x / length),
        )  # fmt: skip
        bow = Connection("bow", (Term("part", "p"),), Friction(force, 0.8, 0.3, 0.1, velocity))
        return System.build({"part": basis}, [bow], BOTH, dt=1 / self.rate), omega[0] / (2 * math.pi)

    def bowed(self, force):
        """Strongest frequency over the string's own, and share of time spent sliding, once the motion is periodic."""
        system, pitch = self.scene(force)
        state, stepper = system.start(), KernelStepper(system)
        stepper.run(state, 36000)
        out, _ = stepper.run(state, 9600)
        assert stepper.statistics.failures == 0
        slip = np.diff(out[:, 0]) * self.rate - 0.1
        spectrum = np.abs(np.fft.rfft(out[:, 1] * np.hanning(len(out))))
        return np.argmax(spectrum) * self.rate / len(out) / pitch, np.mean(np.abs(slip) > 1e-8)

    def test_helmholtz_motion_between_the_least_and_the_greatest_bow_force(self):
        for force in (0.4, 0.6):
            partial, sliding = self.bowed(force)
            assert partial == pytest.approx(1.0, abs=0.02)
            assert sliding == pytest.approx(0.13, abs=0.025)  # the share of the string between bow and bridge
        # too light: two slips in a period; too heavy: no period at all
        assert self.bowed(0.1)[0] == pytest.approx(2.0, abs=0.05)
        assert abs(self.bowed(4.0)[0] - 1.0) > 0.1

    def test_the_bow_pays_for_what_moves_and_what_heats(self):
        system, _ = self.scene(1.0)
        lossless = ModalBasis.real(
            np.abs(system.compiled[0].basis.poles), 0.0, {p: system.compiled[0].basis.right[i].real for i, p in
                                                         enumerate(system.compiled[0].basis.points)}
        )  # fmt: skip
        system = system.with_basis("part", lossless)
        state = system.start()
        out, forces = KernelStepper(system).run(state, 2000)
        u = np.append(out[:, 0], system.compiled[0].rows[0, :, 0] @ system.modes_of(state, "part")[0])
        slip = np.diff(u) * self.rate - 0.1
        given, heat = np.sum(forces[:, 0]) * 0.1 / self.rate, -np.sum(forces[:, 0] * slip) / self.rate
        assert heat > 0
        assert np.all(forces[:, 0] * slip <= 1e-12)
        assert stored_energy(system, state).total == pytest.approx(given - heat, rel=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("points", [1, 4])
def test_a_stiff_spring_on_a_string_stops_it(tmp_path: Path, points: int) -> None:
    """It stops an ideal string at x: c / 2 (L - x). Without R of the modes left out it would be sharp."""
    original = tw.list_instruments()["monochord"]
    (tmp_path / "instrument.yaml").write_text((original / "instrument.yaml").read_text())
    (tmp_path / "body.csv").write_text("f_Hz,Q,modal_mass,bridge\n9000,30,1e4,1\n")
    length, x, tension, density, stiffness = 0.9, 0.06, 60.0, 1.5e-3, 1e6
    values = {
        "tuning.compensate": "none", "strings.A2.tension": tension, "strings.A2.bending_stiffness": 0.0,
        "strings.A2.freq_upper": 5000.0, "strings.A2.polarizations": ["z"],
        "connections": {"stop": {
            "plugin": "listing", "from_bridge": x, "width": 1e-5, "points": points, "stiffness": stiffness,
            "damping": 0.0,
        }},
        "outputs": [{
            "name": "out", "plugin": "point_pickup", "quantity": "displacement", "at": "A2.pluck", "full_scale": 1.0,
        }],
    }  # fmt: skip
    renderer = tw.Renderer(
        tw.Score([tw.Note(0.0, 2.0, string="A2", force=1.0, from_bridge=0.5)]),
        tw.load_instrument(tmp_path).replace(values), max_duration=1.0,
    )  # fmt: skip
    sound = np.concatenate(list(renderer.blocks()))[:, 0]
    spectrum = np.abs(np.fft.rfft(sound * np.hanning(len(sound)), 1 << 22))
    freq = np.argmax(spectrum) * 48000 / (1 << 22)
    stopped = np.sqrt(tension / density) / (2 * (length - x + tension / stiffness))
    model = renderer.model
    sines = model.system.compiled[model.system.slot("A2.z")].basis.n_modes - 1
    assert 1200 / np.log(2) / np.pi**2 / sines * length / (length - x) > 4.0  # cents sharp without R
    assert abs(1200 * np.log2(freq / stopped)) < 0.05
