"""Frets, boards, curved bridges and loose parts against closed forms and their known behaviour."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scene import PLUCK, Played, band_energy, instrument, play

from tonewood.errors import BundleError
from tonewood.instrument.bundle.loading import Instrument
from tonewood.instrument.model.assembly import assemble

FREQ = np.sqrt(73.9 / 3.61e-3) / 2 / 0.65
IDEAL = {"bending_stiffness": 0.0, "loss": {"law": "sigma", "sigma0": 0.0, "sigma1": 0.0}, "freq_upper": 20000.0}


def test_string_on_an_edge_at_its_middle(tmp_path: Path) -> None:
    """An edge at rest level under the middle, plucked there: period 3/4 of 2L/c, contact a third of it, with the
    force of the pluck, 4 T h / L (geometry of the travelling kinks).
    """
    edge = {"plugin": "bridge_barrier", "start": 0.3249, "stop": 0.3251, "points": 1, "stiffness": 1e10}
    pluck = {**PLUCK, "from_bridge": {"fraction": 0.5}, "ramp_time": 0.5, "release_time": 0.0}
    made = instrument(tmp_path, IDEAL, connections={"edge": edge}, exciters={"pluck": pluck})
    played = play(made, {"force": 0.5}, duration=0.5)
    force = played.forces["S.edge.0"]
    ringing = played.time > 0
    starts = np.flatnonzero(np.diff((force[ringing] > 0.1).astype(int)) == 1)
    starts = starts[np.insert(np.diff(starts) > 100, 0, True)]
    period = (starts[-1] - starts[0]) / (len(starts) - 1) * played.system.dt
    assert len(starts) > 60
    assert period * FREQ == pytest.approx(0.75, rel=1e-3)
    assert np.mean(force[ringing][starts[0] : starts[-1]] > 0.1) == pytest.approx(1 / 3, abs=0.02)
    held = force[ringing][starts[0] : starts[-1]]
    assert np.median(held[held > 0.1]) == pytest.approx(0.5, rel=0.03)


FRETS: dict[str, Any] = {"plugin": "frets", "action_first": 3e-4, "action_twelfth": 2e-3, "stiffness": 1e9}


def fretted(folder: Path, low: float = 1.0, **more: Any) -> Instrument:
    frets = {**FRETS, "action_first": 3e-4 * low, "action_twelfth": 2e-3 * low, **more}
    return instrument(folder, connections={"frets": frets}, stops={"kind": "frets", "count": 14})


def test_low_action_buzzes(tmp_path: Path) -> None:
    """With room enough the frets are not there; with little the string meets them and brightens."""
    free = play(instrument(tmp_path, stops={"kind": "frets", "count": 14}), {"force": 1.5}, duration=0.4)
    high = play(fretted(tmp_path, 4.0), {"force": 1.5}, duration=0.4)
    low = play(fretted(tmp_path, 0.3), {"force": 1.5}, duration=0.4)
    assert not any(high.forces[f"S.frets.{i}"].any() for i in range(1, 15))
    np.testing.assert_allclose(high.out, free.out, rtol=0, atol=1e-9 * np.abs(free.out).max())
    touched = [i for i in range(1, 15) if low.forces[f"S.frets.{i}"].any()]
    assert len(touched) >= 3
    assert band_energy(low.out[-9600:], 3000, 8000) > 30 * band_energy(free.out[-9600:], 3000, 8000)
    # the law may pull a little where it is left faster than 1 / loss
    assert all(low.forces[f"S.frets.{i}"].min() >= -0.01 * low.forces[f"S.frets.{i}"].max() for i in touched)


def test_one_high_fret(tmp_path: Path) -> None:
    """It is met first, and alone."""
    made = fretted(tmp_path, 4.0, heights={"9": 6.0e-3})
    played = play(made, {"force": 2.0}, duration=0.2)
    assert [i for i in range(1, 15) if played.forces[f"S.frets.{i}"].any()] == [9]


def test_room_under_a_stopped_string(tmp_path: Path) -> None:
    """From the crown of its fret straight to the bridge; a straight neck leaves no buzz behind the next fret."""
    model = assemble(fretted(tmp_path), 48000)
    string = model.strings["S"]
    x = [string.length(i) for i in range(15)]
    c = [3e-4 + (2e-3 - 3e-4) * (x[1] - xi) / (x[1] - 0.325) for xi in x]
    for stop in (0, 1, 5, 12):
        offsets = {k.name: k.law.offset for k in string.connections(stop)}
        basis = string.bases(stop)["S.z"]
        for i in range(1, 15):
            room = c[i] - (c[stop] * x[i] / x[stop] if stop else 0.0)
            if i > stop:
                assert -offsets[f"S.frets.{i}"] == pytest.approx(room, rel=1e-9)
                assert room > 0
            else:  # behind the stop a fret is out of play
                assert not basis.right[basis.index(f"frets.{i}")].any()
                assert not basis.residual[basis.index(f"frets.{i}")].any()


def test_frets_need_stops(tmp_path: Path) -> None:
    made = instrument(tmp_path, connections={"frets": FRETS})
    with pytest.raises(BundleError, match=r"connections\.frets: string S has no stops"):
        assemble(made, 48000)


def test_a_fretted_note_is_a_fretted_note(tmp_path: Path) -> None:
    """Stopped high above the board the string sounds as without frets."""
    free = play(instrument(tmp_path, stops={"kind": "frets", "count": 14}), {"force": 0.3}, duration=0.05, stop=7)
    high = play(fretted(tmp_path, 4.0), {"force": 0.3}, duration=0.05, stop=7)
    np.testing.assert_allclose(high.out, free.out, rtol=0, atol=1e-9 * np.abs(free.out).max())


def test_a_finer_board_is_the_same_board(tmp_path: Path) -> None:
    """K is that of the whole board: its push in the first period does not depend on how many points stand for it."""
    pushes = []
    for points in (16, 32, 64):
        board = {"plugin": "fingerboard", "end_from_bridge": 0.15, "action_nut": 2e-4, "action_end": 2e-4,
                 "points": points, "stiffness": 3e6, "loss": 5.0}  # fmt: skip
        made = instrument(tmp_path, {"freq_upper": 4000.0}, connections={"board": board})
        played = play(made, {"force": 1.5}, duration=1.0 / FREQ)
        pushes.append(sum(played.forces[f"S.board.{i}"].sum() for i in range(points)) * played.system.dt)
    assert pushes[0] > 0
    assert pushes[1] == pytest.approx(pushes[2], rel=0.02)
    assert pushes[0] == pytest.approx(pushes[2], rel=0.04)


def test_rattle_keeps_momentum_and_energy(tmp_path: Path) -> None:
    """Contact gives the ring the energy that it takes from the string; the energy budget holds all of it."""
    ring = {"plugin": "rattle", "from_bridge": 0.2, "mass": 5e-4, "clearance": 2e-4, "freq": 20.0, "loss": 0.5}
    played = play(instrument(tmp_path, connections={"ring": ring}), {"force": 2.0}, duration=0.2, energy=True)
    trace = played.energy
    assert trace is not None
    assert played.forces["S.ring.at"].any()
    assert trace.worst_residual < 1e-10
    assert trace.stored["S.ring.mass"].max() > 1e-3 * trace.peak
    assert trace.lost["S.ring.at"].sum() > 0
    after = trace.total[trace.time > 0]
    assert np.all(np.diff(after) <= 1e-12 * trace.peak)


def tanpura(**changes: Any) -> Played:
    found = Instrument.load("tanpura").replace(changes)
    text = json.dumps(found.resolved).replace('"C3": {', '"S": {').replace("C3.bridge", "S.bridge")
    return play(Instrument.from_values(json.loads(text), found.folder), duration=0.45)


def precursor(played: Played) -> float:
    """Energy above 2.5 kHz in the third of a period before the main edge, over that within a tenth around it."""
    from scipy.signal import butter, sosfiltfilt

    x = played.out[played.time > 0.25]
    high = sosfiltfilt(butter(4, 2500, "high", fs=48000, output="sos"), x)
    period, ratios = int(48000 / 130.5), []
    for start in range(period, len(x) - 3 * period, period):
        at = start + int(np.argmin(np.diff(x[start : start + period])))
        before, around = high[at - period // 3 : at - period // 20], high[at - period // 20 : at + period // 20]
        ratios.append(float(before @ before / (around @ around)))
    return float(np.median(ratios))


def test_tanpura_precursor_comes_of_stiffness() -> None:
    """High waves of a stiff string run ahead; without bending stiffness all come at once (van Walstijn et al. 2016)."""
    stiff, limp = tanpura(), tanpura(**{"strings.C3.bending_stiffness": 0.0})
    assert precursor(stiff) > 0.5
    assert precursor(limp) < 0.05


def test_tanpura_partials_grow() -> None:
    """The closing and opening contact feeds the partials near 2.5 kHz for some hundred milliseconds."""
    with_bridge, without = tanpura(), tanpura(**{"connections.bridge.stiffness": 0.0})

    def levels(played: Played) -> list[float]:
        pieces = [played.out[(played.time >= t) & (played.time < t + 0.06)] for t in np.arange(0.0, 0.36, 0.06)]
        return [10 * np.log10(band_energy(p, 2000, 3000)) for p in pieces]

    grown, plain = levels(with_bridge), levels(without)
    assert int(np.argmax(grown)) >= 3
    assert max(grown) > grown[0] + 10
    assert max(plain) < plain[0] + 3
    assert plain[-1] < plain[0]
