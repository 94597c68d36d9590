"""The string on rubber: its potential against differences, its energy, and its pitch."""

from __future__ import annotations

import numpy as np
import pytest

import tonewood as tw
import tonewood.authoring as ta

STRING = {"plugin": "bedded_string", "length": 0.45, "tension": 60.0, "linear_density": 1.53e-3, "t60": 3.0}


def zither(bed: float) -> tw.Instrument:
    whole = tw.load_instrument("plate_zither")
    values = dict(whole.resolved)
    values["strings"] = {"A3": {**STRING, "bed": bed, "note": "A3", "end": "body.bridge_A3"}}
    values["connections"] = {}
    return tw.Instrument.from_values(values, whole.folder)


def test_the_gradient_is_that_of_the_potential() -> None:
    string = zither(1e10).resonators["A3"]
    (potential,) = string.potentials(ta.StringMotion("A3", ("A3.z", "A3.y"), None, {}))
    assert isinstance(potential, ta.ModalPotential)
    bed = potential.energy([string.basis(9000.0)] * 2)
    y = 1e-4 * np.random.default_rng(1).normal(size=sum(bed.sizes))
    value, slope = bed.gradient(y)
    assert value > 0.0
    for k in (0, 5, len(y) - 1):
        up, down = (bed.energy(y + sign * 1e-7 * np.eye(len(y))[k]) for sign in (1, -1))
        assert slope[k] == pytest.approx((up - down) / 2e-7, rel=1e-5, abs=1e-6 * np.abs(slope).max())


def render(force: float, seconds: float, **options: object) -> tw.Audio:
    score = tw.Score([tw.Note(0.0, 1.0, string="A3", stop=0, force=force)])
    return tw.render(score, zither(1e9), 12000, oversampling=1.0, max_duration=seconds, **options)


def test_its_energy_adds_up() -> None:
    account = render(3.0, 0.03, energy=True).energy
    assert account is not None
    assert account.worst_residual < 1e-10
    assert account.stored["A3.potential"].max() > 0.0


def test_a_loud_note_is_sharp() -> None:
    def pitch(force: float) -> float:
        piece = render(force, 0.25).samples[-2000:, 0] * np.hanning(2000)
        spectrum = np.abs(np.fft.rfft(piece, 1 << 16))
        near = slice(int(200 / 12000 * (1 << 16)), int(260 / 12000 * (1 << 16)))
        return (near.start + int(np.argmax(spectrum[near]))) * 12000 / (1 << 16)

    assert pitch(0.1) == pytest.approx(220.0, abs=0.4)
    assert pitch(3.0) > 221.0
