"""Modes of tables that a bundle moves: their poles change, their shapes and modal masses stay."""

from __future__ import annotations

import numpy as np
import pytest

import tonewood as tw

TABLE = "body.moved_modes"
MICROPHONES = "outputs.microphones.moved_modes"


def pole(freq, q):
    """s^2 + (omega / Q) s + omega^2 = 0."""
    omega = 2 * np.pi * freq
    return omega * (-0.5 / q + 1j * np.sqrt(1 - 0.25 / q**2))


def test_a_body_mode_moves_and_keeps_its_mass() -> None:
    guitar = tw.load_instrument("classical_guitar")
    moved = guitar.replace({TABLE: [{"near": 216.0, "freq": 190.0, "q": 20.0}]})
    before, after = (instrument.body.basis(400.0) for instrument in (guitar, moved))
    k = int(np.argmin(np.abs(before.natural_freq - 216.4)))
    assert after.poles[k] == pytest.approx(pole(190.0, 20.0), rel=1e-12)
    others = np.delete(np.arange(len(before.poles)), k)
    np.testing.assert_array_equal(after.poles[others], before.poles[others])
    # y = sum of phi^2 / m per mode: force to acceleration far above the modes is that of the masses alone
    at, far = before.index("bridge_G3"), 2j * np.pi * 1e5

    def acceleration(basis):
        shape, rate = basis.right[at].real, -2 * basis.poles.real
        return np.sum(shape**2 * far**2 / (far**2 + rate * far + np.abs(basis.poles) ** 2))

    assert abs(acceleration(after)) == pytest.approx(abs(acceleration(before)), rel=1e-4)


def test_microphones_move_with_it() -> None:
    guitar = tw.load_instrument("classical_guitar")
    moved = guitar.replace({MICROPHONES: [{"near": 212.0, "freq": 190.0, "q": 20.0}]})
    before, after = (instrument.pickups["microphones"].basis(400.0) for instrument in (guitar, moved))
    k = int(np.argmin(np.abs(before.natural_freq - 212.2)))
    assert after.poles[k] == pytest.approx(np.pi * 190.0 * (-1 / 20.0 + 2j), rel=1e-12)
    assert np.sum(after.poles != before.poles) == len(guitar.pickups["microphones"].channels)


@pytest.mark.parametrize("key", [TABLE, MICROPHONES])
@pytest.mark.parametrize(
    ("rows", "words"),
    [
        ([{"near": 160.0, "freq": 190.0, "q": 20.0}], "within 5 % of 160 Hz; the nearest is at"),
        ([{"near": 212.5, "freq": 190.0, "q": 20.0}, {"near": 215.0, "freq": 230.0, "q": 9.0}], "two entries"),
    ],
)
def test_what_cannot_be_moved_is_one_line(key, rows, words) -> None:
    moved = tw.load_instrument("classical_guitar").replace({key: rows})
    part = moved.body if key == TABLE else moved.pickups["microphones"]
    with pytest.raises(tw.TonewoodError, match=words) as told:
        part.basis(400.0)
    assert "moved_modes" in str(told.value)
