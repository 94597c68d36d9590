"""Exchanges while an engine plays give the same as making everything anew."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pytest

import tonewood as tw
from tonewood.performance.engine.engine import Engine
from tonewood.performance.player.timeline import GRID
from tonewood.physics.coupling.system import System
from tonewood.physics.stepping.kernel import KernelStepper

#: stops, slurs and bends close together, on strings that ring
SCORE = tw.Score(
    [
        tw.Note(0.0, 0.08, note=40, force=1.0),
        tw.Note(0.011, 0.05, note=59, force=1.0),
        tw.Note(0.05, 0.1, note=43, force=2.0),
        tw.Note(0.07, 0.02, note=61, force=1.5),
        tw.Note(0.101, 0.1, note=47, force=1.5),
        tw.Note(0.12, 0.1, note=64, force=0.5),
    ],
    [tw.Control(0.06, "bend", 80.0), tw.Control(0.09, "bend", -60.0), tw.Control(0.14, "bend", 0.0)],
)
CHANGES: Mapping[str, Mapping[str, object]] = {
    "classical_guitar": {},
    "flamenco_guitar": {"effects.mode": "all"},
    "electric_bass": {"effects.budget_cents": 0.5},
}


def same(ours: np.ndarray, theirs: np.ndarray) -> None:
    """Equal but for last bits: BLAS sums the same numbers differently where they lie elsewhere in memory."""
    np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-14 * np.abs(theirs).max(initial=0.0))


@pytest.mark.slow
@pytest.mark.parametrize("name", CHANGES)
def test_parts_exchanged_one_by_one_are_as_if_all_were_loaded(name: str) -> None:
    """The system's solve against one built of its parts, the stepper against one that has just been made."""
    instrument = tw.load_instrument(name).replace(CHANGES[name])
    renderer = tw.Renderer(SCORE, instrument, max_duration=0.2)
    engine: Engine = renderer.engine
    seen: set[System] = set()  # kept, as the id of one that is gone may be another's
    while engine.state.sample < 0.18 * engine.model.fs:
        engine.advance(3)
        system = engine.system
        if system in seen:
            continue
        seen.add(system)
        built = System.build(
            {n: c.basis for n, c in zip(system.names, system.compiled, strict=True)},
            system.connections,
            system.readouts,
            dt=system.dt,
            drives=system.drives,
            potentials=system.potentials,
        )
        same(system.solve.inverse, built.solve.inverse)
        np.testing.assert_array_equal(system.solve.on, built.solve.on)
        if built.nonlinear is not None and system.nonlinear is not None:
            same(system.nonlinear.Z, built.nonlinear.Z)
        engine.stepper.exchange(system)
        states = [engine.state.copy() for _ in range(2)]
        sounds = [
            stepper.run(state, GRID, engine.gestures.injections, engine.gestures.controls)[0]
            for stepper, state in zip((engine.stepper, KernelStepper(system)), states, strict=True)
        ]
        np.testing.assert_array_equal(*sounds)
    assert len(seen) > 6
