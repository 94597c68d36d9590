"""The grid of modes x pluck force x sampling rate, method by method."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from tonewood.cli.main import run as command
from tonewood.lab.accuracy import stability, study
from tonewood.lab.accuracy.stability import NAN, STABLE, StabilityGrid, run


@pytest.fixture(scope="module")
def grid() -> StabilityGrid:
    return run(quick=True)


@pytest.mark.slow
def test_this_project_s_scheme_is_stable_everywhere(grid: StabilityGrid) -> None:
    own = [cell for cell in grid.cells if cell.method in ("tonewood", "held_position")]
    assert {cell.verdict for cell in own} == {STABLE}
    assert max(cell.growth for cell in own) <= 1 + 1e-9
    # not for want of hard cases: modes above Nyquist, a kilonewton
    assert max(cell.n_modes for cell in own) >= 188
    assert max(cell.force for cell in own) == 1000.0


@pytest.mark.slow
@pytest.mark.parametrize(("method", "limit"), [("ab3", study.AB3_LIMIT), ("verlet", study.VERLET_LIMIT)])
def test_explicit_methods_fail_where_their_limits_say(grid: StabilityGrid, method: str, limit: float) -> None:
    cells = [c for c in grid.cells if c.method == method and c.system == stability.LINEAR]
    assert {c.verdict for c in cells} == {STABLE, NAN}
    for cell in cells:
        # highest partial of the string of 110 Hz; a fifth is left for its shift by coupling
        reach = 2 * np.pi * 110 * cell.n_modes / cell.fs / limit
        if reach > 1.25:
            assert cell.verdict == NAN
        if reach < 0.8:
            assert cell.verdict == STABLE


def test_force_linear_in_time_at_position_level_never_works(grid: StabilityGrid) -> None:
    assert {c.verdict for c in grid.cells if c.method == "linear_position"} == {NAN}


def test_rising_tension_breaks_explicit_steps_of_hard_plucks_only(grid: StabilityGrid) -> None:
    cells = [c for c in grid.cells if c.system == stability.TENSION and c.method == "verlet" and c.n_modes < 60]
    verdict = {(c.force, c.fs): c.verdict for c in cells}
    assert verdict[0.001, 48e3] == STABLE
    assert verdict[50.0, 48e3] == NAN
    assert verdict[1000.0, 192e3] == NAN


def test_attacks_of_a_quick_run_make_no_energy(grid: StabilityGrid) -> None:
    """A hundredth of the steps of the long ones; two to settle at first."""
    held = [100_002, *[10_002] * 4]
    assert [a.steps for a in grid.attacks][-5:] == held
    assert 800 <= grid.attacks[0].steps < 2400  # of 0.1 s at 8 kHz; some are made twice
    assert grid.attacks[2].steps == 64 * 1000
    names = [a.name for a in grid.attacks]
    assert names[1].endswith("at the peak of displacement, rising tension, 8 kHz")
    assert names[4:6] == ["a body of 1e-09 kg", "a body of 1e+09 kg"]
    for attack in grid.attacks:
        assert attack.failures == 0
        assert 0 <= attack.growth < 1e-9, attack
        assert not attack.residual > 1e-10, attack
    # contacts and friction are searched for, joints and rising tension are not
    assert [a.most > 0 for a in grid.attacks] == [True, False, False, True, False, False, False, False]


@pytest.mark.validate
def test_table_and_json_say_the_same(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    page = tmp_path / "grid.md"
    with pytest.raises(SystemExit) as exit_:
        command(["accuracy", "--stability", "--quick", "--json", "--report", str(page)])
    assert exit_.value.code == 0
    found, table = json.loads(capsys.readouterr().out), page.read_text()
    assert found["schema"] == "tonewood-stability/1"
    for verdict in ("stable", "grows", "NaN"):
        assert table.count(f" {verdict} ") == sum(cell["verdict"] == verdict for cell in found["cells"])
    assert page.read_text().startswith("# ")
