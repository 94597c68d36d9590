"""Plectra and bows on strings whose tension rises: every step finds its branch of the friction curve."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scene import instrument, play

from tonewood.physics.coupling.laws import friction as friction_module
from tonewood.physics.coupling.laws.friction import Friction, FrictionBranch, solve_branches

STATIC = {"plectrum": 1.0, "bow": 0.8}
STRING: dict[str, Any] = {
    "plugin": "tension_modulated_string", "axial_stiffness": 1.5e5, "polarizations": ["z", "y"],
}  # fmt: skip
STROKES: tuple[dict[str, Any], ...] = (
    {"plugin": "plectrum", "force": 0.5},
    {"plugin": "plectrum", "force": 20.0, "speed": 1.0},
    {"plugin": "plectrum", "force": 10.0, "speed": 0.3, "dynamic": 0.5},
    {"plugin": "bow", "force": 0.2, "velocity": 0.1, "direction": "z"},
    {"plugin": "bow", "force": 5.0, "velocity": 0.5, "direction": "y"},
    {"plugin": "bow", "force": 20.0, "velocity": 0.3, "direction": "z"},
    {"plugin": "bow", "force": 40.0, "velocity": 2.0, "direction": "z"},
)
FRETS = {"plugin": "frets", "action_first": 2e-4, "action_twelfth": 8e-4, "stiffness": 1e8, "exponent": 1.5}


def stroke(folder: Path, what: dict[str, Any], place: float, fs: float, duration: float, **options: Any) -> Any:
    """A stroke; `play` asserts that no step failed."""
    parts = {"connections": {"frets": options.pop("frets")}} if "frets" in options else {}
    string = {**STRING, "freq_upper": 0.4 * min(fs, 20000.0), **options.pop("string", {})}
    exciter = {**what, "from_bridge": {"fraction": place}}
    made = instrument(folder, string, exciters={"it": exciter}, stops={"kind": "frets", "count": 12}, **parts)
    played = play(made, duration=duration * min(48000 / fs, 1.0), fs=fs, **options)
    force = next(f for name, f in played.forces.items() if name.endswith((".edge", ".hair")))
    assert np.abs(force).max() <= STATIC[what["plugin"]] * what["force"] * (1 + 1e-9)
    return played


@pytest.mark.parametrize("fs", [24000, 48000, 192000])
@pytest.mark.parametrize("place", [0.03, 0.3])
def test_every_step_is_found(tmp_path: Path, place: float, fs: float) -> None:
    for k, what in enumerate(STROKES):
        stroke(tmp_path, what, place, fs, 0.05, stop=12 * (k % 2))


@pytest.mark.slow
@pytest.mark.parametrize("what", [STROKES[1], STROKES[5]])
def test_and_pays(tmp_path: Path, what: dict[str, Any]) -> None:
    """The energy balance, step by step, in strokes that used to be lost between sticking and sliding."""
    trace = stroke(tmp_path, what, 0.1, 24000, 0.05, energy=True, frets=FRETS).energy
    assert trace.worst_residual < 1e-9
    assert trace.worst_cumulative_residual < 1e-8
    # losses of the compliances at one string, frets and a plectrum, belong to all of them together
    assert trace.lost["S.it.edge" if what["plugin"] == "plectrum" else "S.it.hair"].min() >= -1e-9 * trace.peak
    assert sum(trace.lost.values()).min() >= -1e-9 * trace.peak  # the motion is made again from the forces


@pytest.mark.validate
def test_strokes_at_random(tmp_path: Path) -> None:
    """Any string, stroke, place, stop, rate, with frets in reach or not."""
    rng = np.random.default_rng(2)
    for k in range(300):
        string = {"axial_stiffness": 10 ** rng.uniform(3, 6.5)}
        if k % 2:
            what = {
                "plugin": "plectrum", "force": 10 ** rng.uniform(-1, 2), "dynamic": rng.choice([0, 0.3, 0.9, 1]),
                "speed": 10 ** rng.uniform(-1, 0.5), "slip_speed": 10 ** rng.uniform(-3, 0),
                "stiffness": 10 ** rng.uniform(2, 5),
            }  # fmt: skip
        else:
            what = {
                "plugin": "bow", "force": 10 ** rng.uniform(-1, 1.6), "velocity": 10 ** rng.uniform(-2, 0.6),
                "dynamic": rng.uniform(0, 0.8), "speed": 10 ** rng.uniform(-3, 0), "direction": "yz"[k // 2 % 2],
            }  # fmt: skip
        what = {key: value if isinstance(value, str) else float(value) for key, value in what.items()}
        fs, extra = rng.choice([24000, 44100, 48000, 96000, 192000]), {"frets": FRETS} if k % 3 else {}
        place, stop = float(rng.uniform(0.01, 0.5)), int(rng.integers(0, 13))
        stroke(tmp_path, what, place, float(fs), 0.05, stop=stop, string=string, **extra)


@pytest.mark.parametrize("patience", [0, 4])
@pytest.mark.parametrize("before", [0.0, 0.3, -0.3])
def test_branches_meet_the_curve(monkeypatch: pytest.MonkeyPatch, before: float, patience: int) -> None:
    """Velocity v = c + m f + n f^3 of all else: the friction found sticks within its limit or lies on its curve,
    by changing branches or, without patience, by halving alone.
    """
    monkeypatch.setattr(friction_module, "PATIENCE", patience)
    law, m, n = Friction(1.0, 0.8, 0.2, 0.1), 0.4, 0.5
    found = []
    for c in np.linspace(-1.0, 1.0, 81):
        friction, force = FrictionBranch(law, 1.0, before), [0.0]

        def solve(friction: FrictionBranch = friction, force: list[float] = force, c: float = c) -> None:
            for _ in range(200):
                f = force[0]
                mobility = m + 3 * n * f * f
                friction.meet(c + m * f + n * f**3 - mobility * f, mobility)
                force[0] = friction.force
                if abs(force[0] - f) < 1e-14:
                    return
            raise AssertionError("no force")

        solve_branches([friction], solve)
        v, f = friction.velocity, friction.force
        assert v == pytest.approx(c + m * f + n * f**3, abs=1e-12)
        if v == 0.0:
            assert abs(f) <= 0.8 * (1 + 1e-12)
        else:
            assert f == pytest.approx(-np.copysign(0.2 + 0.6 / (1 + abs(v) / 0.1), v), rel=1e-9)
        found.append(v)
    assert min(found) < -0.4
    assert max(found) > 0.4
    assert found.count(0.0) > 20
