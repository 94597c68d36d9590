"""Masses, springs and dashpots on a body: against closed forms of the body without them."""

from __future__ import annotations

import numpy as np
import pytest

import tonewood as tw
from tonewood.authoring import assemble
from tonewood.errors import TonewoodError
from tonewood.instrument.bundle.added import body_parts
from tonewood.instrument.bundle.added_schema import Added
from tonewood.instrument.contract.base import BodyPoint
from tonewood.instrument.inspection.frequencies import bridge_mobility
from tonewood.performance.effects.bridge_response import BridgeResponse
from tonewood.physics.modal.modes import ModalBasis

GRAMS = {"at": "bridge_middle", "mass": 0.010}
#: no string sounds a note of its own, and the whole is linear
FREE = {"tuning.compensate": "none", "effects.mode": "all"}


@pytest.fixture(scope="module")
def guitar():
    return tw.load_instrument("classical_guitar")


def peak(freq, mobility, low, high):
    inside = (freq > low) & (freq < high)
    return float(freq[inside][np.argmax(np.abs(mobility[inside]))])


def test_ten_grams_on_the_bridge(guitar):
    """The peak at 216.4 Hz goes where Y / (1 + i omega m Y) has it: to 201.1 Hz."""
    freq = np.arange(60.0, 2000.0, 0.05)
    Y = guitar.body.basis(21600.0).frf(freq, "bridge_middle", "bridge_middle")
    wanted = Y / (1 + 2j * np.pi * freq * 0.010 * Y)
    heavy = guitar.replace({"body.added": [GRAMS], "strings.E2.end": "body.bridge_middle"})
    found = bridge_mobility(assemble(heavy, 48000), freq)["E2"]
    assert np.abs(found / wanted - 1).max() < 1e-9
    assert peak(freq, Y, 150, 300) == pytest.approx(216.4, abs=0.05)
    assert peak(freq, found, 150, 300) == pytest.approx(201.1, abs=0.05)


@pytest.mark.parametrize("ratio", [0.02, 0.1, 0.25])
def test_the_best_damper_of_one_mode_is_den_hartogs(ratio):
    """J. P. Den Hartog, Mechanical Vibrations, section 3.3: of an undamped mode the largest motion is (1 + 2 M / m)^.5.

    Tuned to omega / (1 + m / M), two frequencies have that motion whatever the damping; at his best damping,
    (c / 2 m omega)^2 = 3 (m / M) / (8 (1 + m / M)^3), the response is nearly level there. Other dampers are worse.
    """
    mode, omega = 0.5, 2 * np.pi * 212.0
    body = ModalBasis.real([omega], [0.0], {"bridge": [1.0]}, modal_mass=mode)
    points = {"bridge": BodyPoint((0.0, 0.0, 1.0))}
    tuned, best = 212.0 / (1 + ratio), np.sqrt(8 * (1 + ratio) / (3 * ratio)) / 2
    freq = np.linspace(120.0, 320.0, 20001)

    def motion(frequency, q):
        entry = Added(at="bridge", mass=ratio * mode, frequency=frequency, q=q)
        y = body_parts([entry], body, points).body.frf(freq, "bridge", "bridge")
        return np.abs(y / (2j * np.pi * freq)) * mode * omega**2  # re the static displacement

    wanted = np.sqrt(1 + 2 / ratio)
    square = (freq / 212.0) ** 2
    fixed = (1 + np.array([-1, 1]) * np.sqrt(ratio / (2 + ratio))) / (1 + ratio)
    for q in (best / 3, best, 3 * best):
        assert np.interp(fixed, square, motion(tuned, q)) == pytest.approx(wanted, rel=1e-4)
    assert motion(tuned, best).max() == pytest.approx(wanted, rel=0.01)
    for frequency, q in ((tuned, best / 2), (tuned, 2 * best), (1.04 * tuned, best), (0.96 * tuned, best)):
        assert motion(frequency, q).max() > 1.03 * wanted


@pytest.mark.parametrize(
    ("entry", "impedance"),
    [
        (GRAMS, lambda s: 0.010 * s),
        ({"at": "bridge_middle", "stiffness": 4e4, "damping": 3.0}, lambda s: 4e4 / s + 3.0),
        (
            {"at": "bridge_middle", "mass": 0.02, "stiffness": 9e4, "damping": 2.0, "direction": [0.0, 0.6, 0.8]},
            lambda s: 0.64 * (0.02 * s + 9e4 / s + 2.0),
        ),
        (
            {**GRAMS, "frequency": 210.0, "q": 6.0},
            lambda s: 0.010 * s * (b := 2 * np.pi * 210 * s / 6 + (2 * np.pi * 210) ** 2) / (s**2 + b),
        ),
    ],
)
def test_what_is_heard_of_a_tap(guitar, entry, impedance):
    """Bridge and microphones after a tap, with all strings: a part added divides both by 1 + Z Y, Y with strings.

    On the line Re s = 20 1/s, so that the end of the record does not matter.
    """
    tap = {
        "exciters.tap.at": "body.bridge_middle", "exciters.tap.duration": 4e-4, "playing.exciter": "tap",
        "outputs.bridge.at": "body.bridge_middle", "outputs.bridge.quantity": "velocity", **FREE,
    }  # fmt: skip
    score = tw.Score([tw.Note(0.0, 1.0, string="G3", stop=0, technique="tap")])
    options = {"fs": 48000, "outputs": ("bridge", "microphones"), "max_duration": 1.2}

    def heard(overrides):
        audio = tw.render(score, guitar.replace({**tap, **overrides}), **options)
        alpha, n = 20.0, len(audio.samples)
        freq = np.fft.rfftfreq(n, 1 / 48000)
        kept = (freq > 70) & (freq < 1200)
        window = np.exp(-alpha * np.arange(n) / 48000)[:, None]
        scale = np.array([700.0, 40.0, 40.0])
        return alpha + 2j * np.pi * freq[kept], np.fft.rfft(audio.samples * scale * window, axis=0)[kept] / 48000

    s, bare = heard({})
    _, made = heard({"body.added": [entry]})
    # a smooth pulse of 5 N: two parabolas up, two down; its Laplace transform by Simpson's rule
    t = np.linspace(0.0, 4e-4, 2001)
    x = np.where(t < 2e-4, t, 4e-4 - t) / 2e-4
    pulse = 5.0 * np.where(x < 0.5, 2 * x * x, 1 - 2 * (1 - x) ** 2)
    weight = np.full(t.size, 2.0)
    weight[1::2] = 4.0
    weight[[0, -1]] = 1.0
    force = (np.exp(-np.outer(s, t)) * pulse * weight).sum(axis=1) * (t[1] / 3)
    wanted = 1 / (1 + impedance(s) * bare[:, 0] / force)
    assert np.abs(wanted - 1).max() > 0.3
    for channel in range(3):
        assert np.abs(made[:, channel] - wanted * bare[:, channel]).max() < 2e-3 * np.abs(bare[:, channel]).max()


@pytest.mark.parametrize(
    "entry",
    [
        pytest.param(GRAMS, marks=pytest.mark.slow),
        {"at": "bridge_middle", "mass": 1e-6, "stiffness": 1e6, "damping": 100.0},
        pytest.param({"at": "bridge_middle", "stiffness": 1e9, "damping": 1e6}, marks=pytest.mark.slow),
        {**GRAMS, "frequency": 210.0, "q": 6.0},
        pytest.param({**GRAMS, "frequency": 5000.0, "q": 0.1}, marks=pytest.mark.slow),
    ],
)
def test_nothing_of_it_makes_energy(guitar, entry):
    """Put in = stored + lost, to rounding, with the energy stored in the lump and lost in its dashpot."""
    score = tw.Score([tw.Note(0.0, 0.1, string="G3", stop=0, force=2.0)])
    audio = tw.render(score, guitar.replace({"body.added": [entry]}), fs=48000, max_duration=0.1, energy=True)
    assert audio.energy.peak > 1e-4
    assert abs(audio.energy.worst_cumulative_residual) < 1e-11


@pytest.mark.parametrize("tuned", [False, True])
def test_bounds_know_of_it(guitar, tuned):
    """Response of the microphones to the force of G3 with a mass or a damper under it: by the body's own mobility."""
    mass, alone = {"at": "bridge_G3", "mass": 0.010}, {"strings.G3.end": "body.bridge_G3"}
    mass |= {"frequency": 210.0, "q": 6.0} if tuned else {}
    light = BridgeResponse(assemble(guitar.replace(alone), 48000))
    heavy = BridgeResponse(assemble(guitar.replace({**alone, "body.added": [mass]}), 48000))
    s = 1j * light.freq_rad
    Y = guitar.body.basis(21600.0).frf(light.freq_rad / (2 * np.pi), "bridge_G3", "bridge_G3")
    b = 2 * np.pi * 210 * s / 6 + (2 * np.pi * 210) ** 2 if tuned else np.inf
    factor = 1 / np.abs(1 + 0.010 * s / (1 + s**2 / b) * Y)
    place = light.components.index("G3.z")
    wanted = light.heard[0, place] * factor
    found = np.interp(light.freq_rad, heavy.freq_rad, heavy.heard[0, place])
    shared = np.isin(light.freq_rad, heavy.freq_rad)
    assert np.count_nonzero(shared) > 100
    assert found[shared] == pytest.approx(wanted[shared], rel=1e-6, abs=1e-9 * wanted.max())


@pytest.mark.parametrize(
    ("entry", "shown"),
    [
        ({"at": "nowhere", "mass": 0.01}, r"body\.added\.0\.at: there is no point 'nowhere'; there are bridge_E2"),
        ({"at": "bridge_E2", "mass": 0.01, "direction": "x"}, r"body\.added\.0\.direction: the body does not move"),
        ({"at": "bridge_E2"}, r"body\.added\.0: .*a mass, a stiffness or a damping above 0 is needed"),
        ({"at": "bridge_E2", "mass": -0.01}, r"body\.added\.0\.mass"),
        ({**GRAMS, "frequency": 200.0}, r"body\.added\.0: .*a tuned damper has mass, frequency and q"),
        ({**GRAMS, "frequency": 200.0, "q": 5.0, "damping": 1.0}, r"body\.added\.0: .*no stiffness or damping"),
        ({**GRAMS, "frequency": -3.0, "q": 5.0}, r"body\.added\.0\.frequency"),
        (
            {**GRAMS, "mass": 5e-324, "frequency": 200.0, "q": 5.0},
            r"body\.added\.0: .*mass is .*; 0, or 1e-09 and more",
        ),
        ({"at": "bridge_E2", "stiffness": 1e-300}, r"body\.added\.0: .*stiffness is 1e-300; 0, or 1e-09"),
        ({"at": "bridge_E2", "mass": 10}, r"body\.added\.0\.mass: is 10 kg; at most 5 kg: did you mean 10 g"),
    ],
)
def test_what_is_wrong_is_reported_in_one_line(guitar, entry, shown):
    with pytest.raises(TonewoodError, match=shown) as fault:
        assemble(guitar.replace({"body.added": [entry]}), 48000)
    assert "\n" not in str(fault.value)
