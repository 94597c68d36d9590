"""Severity of wolf notes against two coupled oscillators in closed form."""

from __future__ import annotations

import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tonewood.instrument.bundle.loading import Instrument
from tonewood.instrument.inspection import wolf
from tonewood.instrument.inspection.wolf import (
    _HINT,
    LEAST_SHARE,
    STEP_CENTS,
    _refined,
    intervals,
    share_curve,
    wolf_notes,
)
from tonewood.instrument.model.assembly import Model, assemble

DENSITY, LENGTH = 1.95e-3, 0.65
#: D3 of 12 stops: stop 6 is in the middle
FREQ = 440.0 * 2 ** ((50 + 6 - 69) / 12)


def instrument(folder: Path, values: dict[str, Any], mass: float, q: float, sigma: float = 1e-3) -> Model:
    """One string, one polarization, on a body of one mode at the pitch of stop 6."""
    (folder / "body.csv").write_text(f"f_Hz,Q,modal_mass,bridge,wing\n{FREQ},{q},{mass},1,0.4\n")
    string = values["strings"]
    values["strings"] = {"defaults": string["defaults"], "D3": {**string["D3"], "end_compliance": 0.0}}
    string["defaults"].update(loss={"law": "sigma", "sigma0": sigma}, bending_stiffness=0.0)
    return assemble(Instrument.from_values(values, folder), 16000.0)


def half_splitting(mass: float) -> float:
    """Half the splitting of a string's fundamental on a mode of the same frequency, cents: sqrt(m / 2 M) / pi."""
    string_mass = DENSITY * LENGTH * 2 ** (-6 / 12)
    return 1200 / math.log(2) * math.sqrt(string_mass / (2 * mass)) / math.pi


@pytest.mark.parametrize("mass", [0.5, 2.0])
def test_a_string_on_one_mode_without_loss(tmp_path: Path, values: dict[str, Any], mass: float) -> None:
    """Depth 1/2, breadth 3 c and severity c, c half the splitting; pitch goes in steps of 6.25 cents."""
    c = half_splitting(mass)
    (wolf,) = wolf_notes(instrument(tmp_path, values, mass, q=1e5))
    assert wolf.severity_cents == pytest.approx(c, rel=0.04)
    assert wolf.breadth_cents == pytest.approx(3 * c, rel=0.04)
    assert (1 - 3.125 / math.hypot(3.125, 2 * c)) / 2 - 0.01 < wolf.depth < 0.51
    assert 1200 * math.log2(wolf.worst_freq / FREQ) == pytest.approx(0.0, abs=4.0)
    assert wolf.body_freq == pytest.approx(FREQ, rel=1e-6)
    assert wolf.stops == (6,)


def test_the_share_is_that_of_two_oscillators(tmp_path: Path, values: dict[str, Any]) -> None:
    """The eigenvectors of q1'' + w1^2 q1 = g q2, q2'' + w2^2 q2 = g q1, found here by numpy."""
    mass = 1.0
    model = instrument(tmp_path, values, mass, q=1e5)
    string = model.strings["D3"]
    x = np.array([-60.0, -20.0, -5.0, 5.0, 20.0, 60.0])
    # at a stop the tuned tension has taken the body's pull in; the string's own tension counts, T = rho (2 l f)^2
    tension = DENSITY * (2 * string.length(6) * FREQ) ** 2
    found = share_curve(string.tuning.coupled(6), tension, FREQ, x)
    string_mass, rad = DENSITY * string.length(6), 2 * math.pi * FREQ
    pull = rad**2 / math.pi * math.sqrt(2 * string_mass / mass)
    for offset, share in zip(x, found, strict=True):
        own = (rad * 2 ** (offset / 1200)) ** 2
        vectors = np.linalg.eigh(np.array([[own, pull], [pull, rad**2]]))[1]
        assert share == pytest.approx(min(vectors[0] ** 2), abs=0.025)


def test_losses_beyond_the_splitting_end_a_wolf(tmp_path: Path, values: dict[str, Any]) -> None:
    """sigma_b - sigma_s > 2 times half the splitting in rad/s: the two modes are at one frequency, none is shared."""
    mass = 2.0
    splitting = 2 * math.pi * FREQ * math.sqrt(DENSITY * LENGTH * 2 ** (-0.5) / (2 * mass)) / math.pi
    q = 2 * math.pi * FREQ / 2 / (4 * splitting)  # sigma_b = omega / 2 Q = 4 times half the splitting
    assert wolf_notes(instrument(tmp_path, values, mass, q)) == []


def test_intervals_of_a_triangle() -> None:
    """d = 1 - |x| / 100 is at least 0.2 for |x| <= 80, and its integral there is 96."""
    x = np.arange(-150.0, 151.0, 10.0)
    (found,) = intervals(x, np.maximum(1 - np.abs(x) / 100, 0.0))
    assert pytest.approx([-80.0, 80.0, 0.0, 1.0, 96.0], abs=0.6) == list(found)
    assert LEAST_SHARE == 0.2


def test_the_worst_comes_first() -> None:
    wolves = wolf_notes(assemble(Instrument.load("african_harp"), 16000.0))
    severities = [wolf.severity_cents for wolf in wolves]
    assert severities == sorted(severities, reverse=True)
    assert all(0 < w.severity_cents <= w.depth * w.breadth_cents for w in wolves)
    assert all(w.severity_cents >= LEAST_SHARE * w.breadth_cents * 0.99 for w in wolves)


def test_a_share_is_that_of_a_pitch_wherever_it_is_counted_from(tmp_path: Path, values: dict[str, Any]) -> None:
    """From a stop six semitones below the body's mode the string is brought up to it, as from one six above down."""
    string = instrument(tmp_path, values, mass=1.0, q=1e5).strings["D3"]
    at = string.tuning.coupled(6)
    tension = DENSITY * (2 * string.length(6) * FREQ) ** 2
    here = np.array([-40.0, -5.0, 5.0, 40.0])
    expected = share_curve(at, tension, FREQ, here)
    assert expected.min() > 0.01
    for away in (-600.0, 600.0):
        begin = tension * 2 ** (away / 600), FREQ * 2 ** (away / 1200)
        assert share_curve(at, *begin, here - away) == pytest.approx(expected, rel=1e-6)


def test_a_wolf_between_stops_far_apart_is_found(tmp_path: Path, values: dict[str, Any]) -> None:
    """Of steps of 870 cents the second is 270 above the body's mode."""
    (tmp_path / "wide.scl").write_text("wide\n2\n870.\n1740.\n")
    values["tuning"] = {"scale": "wide.scl"}
    values["stops"]["count"] = 2
    values["strings"]["D3"]["freq"] = FREQ * 2**-0.5
    del values["strings"]["D3"]["note"]
    wolves = wolf_notes(instrument(tmp_path, values, mass=0.5, q=1e5))
    assert [wolf.worst_freq for wolf in wolves] == [pytest.approx(FREQ, rel=2e-3)]


@pytest.mark.parametrize("width", [4.0, 20.0, 60.0])
def test_steps_are_halved_beside_every_point_of_a_share(width: float) -> None:
    """A Lorentzian narrower than a step stands at one of its ends alone; its area is pi times width and height."""
    x, d = _refined(lambda u: 0.9 / (1 + ((u - 100.0) / width) ** 2), np.arange(-1000.0, 1001.0, 25.0), 0.0)
    assert np.all(np.diff(x) > 0)
    wide = np.diff(x) > STEP_CENTS
    assert np.maximum(d[:-1], d[1:])[wide].max() <= _HINT
    whole = 0.9 * width * (math.atan(900.0 / width) + math.atan(1100.0 / width))
    assert np.trapezoid(d, x) == pytest.approx(whole, rel=0.25 if width < STEP_CENTS else 0.02)
    calls: list[np.ndarray] = []
    _refined(lambda u: calls.append(u) or np.full(len(u), 0.9 * _HINT), np.arange(0.0, 100.0, 25.0), 10.0)
    assert [u.tolist() for u in calls] == [[-10.0, 15.0, 40.0, 65.0]]  # nothing to refine


def test_stops_near_a_body_mode_are_swept_in_steps_of_25_cents(monkeypatch: pytest.MonkeyPatch) -> None:
    """Half-way to the next stops, and at the body's modes; stops that are far from all of these are not swept."""
    swept: dict[int, np.ndarray] = {}

    def refined(curve: Any, x: np.ndarray, origin: float) -> tuple[np.ndarray, np.ndarray]:
        stop = curve.args[0]
        swept[stop] = x
        assert curve.args[1:] == (70.0, pytest.approx(110.0 * 2 ** (origin / 1200)))
        assert origin == pytest.approx(100.0 * stop)
        return x, np.where((x > 190.0) & (x < 240.0), 0.5, 0.0)

    monkeypatch.setattr(wolf, "_refined", refined)
    tuning = SimpleNamespace(freqs=[110.0 * 2 ** (i / 12) for i in range(25)], coupled=lambda stop: stop)
    string = SimpleNamespace(tuning=tuning, tension=lambda stop: 70.0)
    body = SimpleNamespace(natural_freq=np.array([0.0, 110.0 * 2 ** (213 / 1200)]))
    model: Any = SimpleNamespace(body=body, groups=["A"], strings={"A": string})
    (found,) = wolf.wolf_notes(model)
    near = wolf._NEAR_CENTS + 50.0
    assert sorted(swept) == [i for i in range(25) if abs(100 * i - 213) < near]
    assert swept[2] == pytest.approx([150.0, 175.0, 200.0, 213.0, 225.0, 250.0])
    assert swept[1] == pytest.approx([50.0, 75.0, 100.0, 125.0, 150.0])
    assert (found.string, found.stops, found.depth) == ("A", (2,), 0.5)
    assert found.body_freq == pytest.approx(110.0 * 2 ** (213 / 1200))
    cents = [1200 * math.log2(f / 110.0) for f in (found.low_freq, found.worst_freq, found.high_freq)]
    assert 175.0 < cents[0] < 200.0 <= cents[1] <= 225.0 < cents[2] < 250.0
    assert found.breadth_cents == pytest.approx(cents[2] - cents[0])
    assert wolf.wolf_notes(model, ["A"]) == [found]
