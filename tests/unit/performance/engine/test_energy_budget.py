"""Accounts of energy of whole renders: stops, bends, holds, plucks on ringing strings and every kind of law."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest

import tonewood as tw
from tonewood.errors import OutputError
from tonewood.physics.energy.trace import EnergyTrace
from tonewood.sound.render.energy import save_energy

#: a stop change, a pluck on a ringing string, bends and ends of notes, at odd times
BUSY = tw.Score(
    [
        tw.Note(0.0, 0.05, note=45, force=1.0),
        tw.Note(0.0417, 0.02, note=50.3, force=2.0, from_bridge=0.2, angle_deg=40.0),
        tw.Note(0.0702, 0.05, note=45, force=1.5),
    ],
    [tw.Control(0.03, "bend", 60.0), tw.Control(0.05, "bend", -120.0), tw.Control(0.09, "bend", 0.0)],
)


#: instruments whose strings play few notes
OWN = {
    # a body of complex modes: its stored energy follows from its passivity
    "african_harp": tw.Score(
        [
            tw.Note(0.0, 0.05, string="s4", stop=0, force=1.0),
            tw.Note(0.0317, 0.03, string="s2", stop=0, force=2.0),
            tw.Note(0.0617, 0.03, string="s4", stop=0, force=1.0),
        ]
    ),
    "clavichord": tw.Score([tw.Note(0.0, 0.05, note=57, force=1.0), tw.Note(0.0617, 0.03, note=59, force=1.0)]),
    "struck_monochord": tw.Score(
        [tw.Note(0.0, 0.05, note=60, velocity_midi=110), tw.Note(0.0617, 0.03, note=62, velocity_midi=90)]
    ),
    "tanpura": tw.Score([tw.Note(0.0, 0.05, note=48, force=1.0), tw.Note(0.0617, 0.03, note=48, force=1.0)]),
}


def rendered(name: str, *, energy: bool = False) -> tw.Audio:
    return tw.render(OWN.get(name, BUSY), tw.load_instrument(name), max_duration=0.12, energy=energy)


def balanced(trace: EnergyTrace) -> None:
    steps = int(trace.steps.sum())
    assert trace.peak > 0
    assert trace.worst_residual <= 1e-10
    assert trace.worst_cumulative_residual <= 1e-10 + 4e-16 * steps
    # a compliance at several contacts at once loses as a whole
    assert trace.power_lost.min() >= -1e-9 * trace.peak


@pytest.mark.parametrize(
    "name",
    [
        pytest.param("classical_guitar", marks=pytest.mark.slow),
        pytest.param("african_harp", marks=pytest.mark.slow),
        "bowed_monochord",
        "buzzing_monochord",
        "sitar",
        "clavichord",
        "tanpura",
        pytest.param("struck_monochord", marks=pytest.mark.validate),
        pytest.param("steel_strings", marks=pytest.mark.validate),
        pytest.param("electric_bass", marks=pytest.mark.validate),
    ],
)
def test_every_interval_of_a_render_adds_up(name: str) -> None:
    audio = rendered(name, energy=True)
    trace = audio.energy
    assert trace is not None
    balanced(trace)
    assert np.array_equal(audio.samples, rendered(name).samples)
    assert np.all(trace.steps <= 64)
    assert trace.time[-1] >= 0.12
    into = sum(v.sum() for v in trace.supplied.values()) + sum(v.sum() for v in trace.booked.values())
    lost = sum(v.sum() for v in trace.lost.values())
    assert trace.total[-1] == pytest.approx(into - lost, rel=1e-9)
    assert sum(v.sum() for v in trace.supplied.values()) > 0


def test_bends_are_booked_as_power_in() -> None:
    trace = rendered("monochord", energy=True).energy
    assert trace is not None
    booked = trace.booked["stops, bends and dampers"]
    # tightening a ringing string works on it, slackening it takes energy out, as its frequency goes up and down
    up, down = booked[np.searchsorted(trace.time, 0.0300)], booked[np.searchsorted(trace.time, 0.0500)]
    assert up > 1e-3 * trace.peak
    assert down < -1e-3 * trace.peak


def test_no_account_is_kept_unasked() -> None:
    assert rendered("monochord").energy is None


def test_a_work_that_is_not_entered_leaves_the_balance_open(monkeypatch: pytest.MonkeyPatch) -> None:
    from tonewood.performance.engine.energy_budget import EnergyBudget

    monkeypatch.setattr(EnergyBudget, "_known", lambda self, active: [])
    trace = rendered("monochord", energy=True).energy
    assert trace is not None
    assert trace.worst_residual > 1e-4


def test_a_wrong_loss_leaves_the_balance_open(monkeypatch: pytest.MonkeyPatch) -> None:
    from tonewood.physics.energy.forms import ComponentEnergy

    true_loss = ComponentEnergy.lost
    monkeypatch.setattr(ComponentEnergy, "lost", lambda self, *args: 1.001 * true_loss(self, *args))
    trace = rendered("monochord", energy=True).energy
    assert trace is not None
    assert trace.worst_residual > 1e-9


def test_a_finger_s_dashpot_takes_what_the_string_loses_under_it() -> None:
    trace = rendered("monochord", energy=True).energy
    assert trace is not None
    assert sum(v.sum() for name, v in trace.lost.items() if name.endswith(".hold")) > 0.01 * trace.peak


def test_account_goes_to_files(tmp_path: Path) -> None:
    trace = rendered("monochord", energy=True).energy
    assert trace is not None
    save_energy(trace, tmp_path / "e.json")
    save_energy(trace, tmp_path / "e.csv")
    data = json.loads((tmp_path / "e.json").read_text())
    rows = list(csv.DictReader((tmp_path / "e.csv").open()))
    assert len(rows) == len(data["residual"]) == trace.time.size
    stored = [sum(float(v) for k, v in row.items() if k.startswith("stored:")) for row in rows]
    assert stored == pytest.approx(trace.total.tolist(), rel=1e-12)
    with pytest.raises(tw.TonewoodError, match="ending in"):
        save_energy(trace, tmp_path / "e.txt")
    with pytest.raises(OutputError, match="no folder"):
        save_energy(trace, tmp_path / "none" / "e.json")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["e.csv", "e.json"]


def test_a_stop_on_a_string_beyond_sense_adds_up() -> None:
    """Where psi^2 / 2 has parted from V by more than V is after the stop."""
    strings = {"strings.A2.plugin": "tension_modulated_string", "strings.A2.axial_stiffness": 1e6}
    made = tw.load_instrument("monochord").replace({**strings, "tuning.compensate": "none"})
    notes = [tw.Note(0.0, 0.02, note=45, force=1000.0), tw.Note(0.03, 0.02, note=57, force=1.0)]
    trace = tw.render(tw.Score(notes), made, 8000, max_duration=0.06, effects="all", energy=True).energy
    assert trace is not None
    assert trace.worst_residual <= 1e-10
