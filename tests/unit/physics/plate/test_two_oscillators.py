"""The far field of two oscillators and of modes by chance, against coupled air and the sums over a drawn guitar."""

from __future__ import annotations

import numpy as np
import pytest

import tonewood as tw
from tonewood.physics.plate.air import couple_air
from tonewood.physics.plate.microphones import pressure
from tonewood.physics.plate.radiation import Sources
from tonewood.physics.plate.two_oscillators import displaced_volumes, pressure_shapes

NONE = (np.zeros(0), np.zeros((0, 1)), np.zeros(0))


def test_volumes_are_those_of_the_coupled_oscillators() -> None:
    """A top of 90 g and 0.05 m^2 with a hole: a q + Y of both modes, from frequencies and shapes at the bridge."""
    mass, area, volume = 0.09, 0.05, 0.013
    a = area / np.sqrt(mass)
    modes = couple_air(np.array([185.0]), np.array([a]), volume, (np.pi * 0.042**2, 0.07), NONE)
    shapes = modes.plates[0] / np.sqrt(mass)
    found = displaced_volumes(tuple(modes.freq), tuple(shapes), volume)
    assert found == pytest.approx(a * modes.plates[0] + modes.hole, rel=1e-9)
    with pytest.raises(ValueError, match="do not move the bridge as two coupled oscillators"):
        displaced_volumes((100.0, 200.0), (0.0, 0.0), volume)


def test_power_above_t1_is_that_of_the_loss_factor() -> None:
    """A mode that moves with |q'| = 1 gives p^2 / 2 rho c over a sphere of 3 m: eta omega / 2."""
    freq, loss = np.array([100.0, 200.0, 950.0]), np.array([0.03, 0.03, 0.02])
    signs = np.ones((1, 3))
    heard = pressure_shapes(freq, loss, np.array([1.3, 3.5, 1.0]), (0, 1), 0.013, 3.0, 0.004, signs)
    omega = 2 * np.pi * 950.0
    power = 4 * np.pi * 9.0 * (omega * heard[0, 2]) ** 2 / (2 * 1.2 * 343.0)
    assert power == pytest.approx(0.004 * omega / 2, rel=1e-12)


@pytest.mark.slow
def test_levels_are_near_those_of_a_guitar_whose_surface_is_known() -> None:
    """The drawn guitar, known at its bridge alone: octaves at 1 m within 6 dB of the sums over its whole surface.

    Without a sum over the back half space these are of six places in front; the estimate is of all directions.
    """
    body = tw.load_instrument("drawn_guitar").replace({"body.fmax": 2500.0, "body.cell": 0.012}).body
    modes, basis, sources = body.modes_below(2e4), body.basis(2e4), body.sources(2e4)
    named, bridge = modes.named(), basis.right[basis.index("saddle_D3")].real
    rng = np.random.default_rng(1)
    heard = pressure_shapes(modes.freq, modes.loss, bridge, (named["A0"], named["T1"]), 0.0134, 1.0, 0.004,
                            rng.choice([-1.0, 1.0], size=(8, len(bridge))))  # fmt: skip
    assert isinstance(sources, Sources)
    places = [(0.3 + np.sin(t) * np.cos(u), np.sin(t) * np.sin(u), np.cos(t))
              for t in (0.3, 1.0) for u in (0.5, 2.6, 4.7)]  # fmt: skip
    for low in 80.0 * 2.0 ** np.arange(5):
        f = np.geomspace(low, 2 * low, 300)
        s = 2j * np.pi * f[:, None]
        motion = bridge * s**2 / ((s - basis.poles) * (s - basis.poles.conj()))
        estimate = np.mean(np.abs(motion @ heard.T) ** 2)
        sums = [pressure(sources, at, basis.poles, bridge[None], f, 0.0) for at in places]
        apart = 10 * np.log10(estimate / np.mean(np.abs(sums) ** 2))
        assert abs(apart) < 6.0


def test_a_measured_guitar_offers_the_estimate() -> None:
    """Half a second of the classical guitar at 1 m: quieter than its near field, the same for the same seed."""
    score = tw.Score([tw.Note(0.0, 0.3, "E2", velocity_midi=100)])
    guitar = tw.load_instrument("classical_guitar")
    options = {"max_duration": 0.4, "effects": "none"}
    far = tw.render(score, guitar, 24000, outputs=("listener",), **options)
    near = tw.render(score, guitar, 24000, **options)
    assert far.channels == ("left", "right")
    levels = [20 * np.log10(np.sqrt(np.mean(a.samples**2)) * scale) for a, scale in ((far, 4.0), (near, 40.0))]
    assert -30.0 < levels[0] - levels[1] < -5.0
    assert np.abs(far.samples[:, 0] - far.samples[:, 1]).max() > 0.01 * np.abs(far.samples).max()
