"""A string whose tension rises with its stretch, through the plugin, against closed forms.

One mode of it is q'' + omega0^2 q + eps q^3 = 0 for the amplitude q of sin(p x), with omega0^2 = (T p^2 + EI p^4) / mu
and eps = EA p^4 / 4 mu: a Jacobi elliptic oscillation of frequency pi sqrt(omega0^2 + eps A^2) / 2 K(m).
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
import scipy.linalg as sla
from numpy.typing import NDArray
from scene import instrument, play

from tonewood.instrument.bundle.loading import Instrument
from tonewood.instrument.model.assembly import Model, assemble
from tonewood.physics.coupling.system import State
from tonewood.physics.stepping.kernel import KernelStepper
from tonewood.physics.stepping.motion import from_motion, to_motion

Floats = NDArray[np.float64]

#: steel, rho 8050, r .3556 mm, E 174 GPa: the test string of M. Ducceschi's and S. Bilbao's published scripts
AREA = np.pi * 0.3556e-3**2
STEEL: dict[str, Any] = {
    "plugin": "tension_modulated_string",
    "length": 1.0,
    "tension": 75.0,
    "linear_density": 8050 * AREA,
    "bending_stiffness": 174e9 * np.pi * 0.3556e-3**4 / 4,
    "axial_stiffness": 174e9 * AREA,
    "loss": {"law": "sigma", "sigma0": 0.0, "sigma1": 0.0},
    "note": None,
    "freq": 76.58,
    "freq_upper": 900.0,
    "end_compliance": 0.0,
}


def bent(model: Model, amplitude: float) -> State:
    """State of rest in the shape `amplitude` sin(pi x / L)."""
    state = model.system.start()
    basis = model.system.compiled[model.system.slot("S.z")].basis
    sine = np.zeros(basis.n_modes)
    sine[1] = amplitude
    q = sla.solve(cast(Floats, basis.metadata["vec"]), sine)
    model.system.modes_of(state, "S.z")[:] = from_motion(basis, q, np.zeros_like(q))
    return state


def backbone(amplitude: float, string: dict[str, Any] = STEEL) -> float:
    """Frequency of one mode at an amplitude (m), Hz."""
    from scipy.special import ellipk

    p, mu = np.pi / string["length"], string["linear_density"]
    omega2 = (string["tension"] * p**2 + string["bending_stiffness"] * p**4) / mu
    stiffening = string["axial_stiffness"] * p**4 / (4 * mu) * amplitude**2
    m = stiffening / (2 * (omega2 + stiffening))
    return float(np.pi * np.sqrt(omega2 + stiffening) / (2 * ellipk(m)) / (2 * np.pi))


def frequency(x: Floats, dt: float) -> float:
    """By rising zero crossings, a straight line through them."""
    rising = np.flatnonzero((x[:-1] < 0) & (x[1:] >= 0))
    times = [(i - x[i] / (x[i + 1] - x[i])) * dt for i in rising]
    slope, _ = np.polyfit(np.arange(len(times)), times, 1)
    return 1 / float(slope)


def fundamental(model: Model, state: State, n: int) -> tuple[Floats, KernelStepper]:
    """Amplitude of sin(pi x / L) over n steps: other partials, little as they are, would move zero crossings."""
    stepper = KernelStepper(model.system)
    basis = model.system.compiled[model.system.slot("S.z")].basis
    row, out = cast(Floats, basis.metadata["vec"])[1], np.empty(n)
    for i in range(n):
        out[i] = row @ to_motion(basis, model.system.modes_of(state, "S.z"))[0]
        stepper.run(state, 1)
    return out, stepper


@pytest.mark.parametrize("freq_upper", [900.0, 20000.0])
@pytest.mark.parametrize(("amplitude", "freq"), [(0.5e-3, 76.598626), (1e-3, 76.647562), (2e-3, 76.842943)])
def test_one_mode_at_an_amplitude(tmp_path: Path, amplitude: float, freq: float, freq_upper: float) -> None:
    """To a hundredth of a cent; the frequencies are those of the closed form, printed."""
    assert backbone(amplitude) == pytest.approx(freq, rel=1e-8)
    model = assemble(instrument(tmp_path, {**STEEL, "freq_upper": freq_upper}), 48000)
    moved, stepper = fundamental(model, bent(model, amplitude), 4600)
    assert abs(1200 * np.log2(frequency(moved, 1 / 48000) / freq)) < 0.01
    assert stepper.statistics.failures == 0


def test_the_fundamental_stretches_as_much_as_it_should(tmp_path: Path) -> None:
    """S of A sin(p x) is A^2 p^2 L / 2, at every stop; bending stiffness must not change it."""
    string = instrument(tmp_path, STEEL).resonators["S"]
    for stop in (0.0, 0.3):
        basis = string.basis(20000.0, stop=stop)
        sine = np.zeros(basis.n_modes)
        sine[1] = 1.0
        y = sla.solve(cast(Floats, basis.metadata["vec"]), sine)
        length = 1.0 - stop
        assert cast(Floats, basis.metadata["stretch_part"]) @ y**2 == pytest.approx(np.pi**2 / (2 * length), rel=1e-9)


def pluck(folder: Path, **string: Any) -> Instrument:
    values = {**STEEL, "length": 0.65, "freq": 118.0, "freq_upper": 3000.0, **string}
    return instrument(folder, values)


def test_a_decaying_pitch_glides_down_its_backbone(tmp_path: Path) -> None:
    """At every moment the frequency is that of the amplitude then: with one mode the closed form, to 0.2 cent."""
    string = {**STEEL, "loss": {"law": "sigma", "sigma0": 6.0, "sigma1": 0.0}, "freq_upper": 250.0}
    model = assemble(instrument(tmp_path, string), 16000)
    moved, _ = fundamental(model, bent(model, 3e-3), 8000)
    rising = np.flatnonzero((moved[:-1] < 0) & (moved[1:] >= 0))
    times = (rising - moved[rising] / (moved[rising + 1] - moved[rising])) / 16000
    heard = 1 / np.diff(times)
    for k in range(len(heard)):
        window = moved[rising[k] : rising[k + 1]]
        amplitude = (window.max() - window.min()) / 2
        # losses lower the pitch a little
        wanted = np.sqrt(backbone(amplitude, string) ** 2 - (6.0 / (2 * np.pi)) ** 2)
        assert abs(1200 * np.log2(heard[k] / wanted)) < 0.1
    assert np.all(np.diff(heard) < 0)
    assert 1200 * np.log2(heard[0] / heard[-1]) > 8


def test_energy_never_rises(tmp_path: Path) -> None:
    """A pluck far beyond the strength of a string: 60 modes, 300 N; the energy budget closes and nothing is gained."""
    lossy = {"loss": {"law": "sigma", "sigma0": 0.5, "sigma1": 1e-4}, "freq_upper": 7000.0}
    played = play(pluck(tmp_path, **lossy), {"force": 300.0}, duration=0.02, energy=True)
    trace = played.energy
    assert trace is not None
    assert trace.worst_residual < 1e-9
    free = trace.total[trace.time > 2.5e-4]
    assert np.all(np.diff(free) <= 1e-11 * trace.peak)


def test_both_polarizations_share_the_tension(tmp_path: Path) -> None:
    """Two planes at 45 degrees are one plane turned: the sum of squares stretches."""
    both = {"polarizations": ["z", "y"], "freq_upper": 1500.0}
    ends = []
    for tilt in (0.0, 45.0):
        made = pluck(tmp_path, **both, tilt_deg=tilt)
        played = play(made, {"force": 12.0}, duration=0.03, fs=24000)
        ends.append(played.out)
    np.testing.assert_allclose(ends[1], ends[0], rtol=0, atol=2e-5 * np.abs(ends[0]).max())


def test_without_axial_stiffness_it_is_the_stiff_string(tmp_path: Path) -> None:
    slack = assemble(pluck(tmp_path, axial_stiffness=0.0), 48000)
    assert slack.system.potentials.each == ()
    plain = {k: v for k, v in STEEL.items() if k != "axial_stiffness"}
    stiff = instrument(tmp_path, {**plain, "plugin": "stiff_string", "length": 0.65, "freq": 118.0, "freq_upper": 3e3})
    a, b = (play(m, {"force": 5.0}, duration=0.02).out for m in (slack, stiff))
    np.testing.assert_array_equal(a, b)
