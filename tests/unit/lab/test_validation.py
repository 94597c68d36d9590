"""The table of checked quantities: choice of systems, JSON, exit code."""

from __future__ import annotations

import json
from types import SimpleNamespace

import pytest
from rich.console import Console

from tonewood.cli.validate import validate
from tonewood.errors import TonewoodError
from tonewood.lab import validation
from tonewood.lab.row import Row
from tonewood.lab.systems import fabre_academic, harp

GOOD = Row("toy", "a", "by hand", 2.0, 2.01, 0.1)
BAD = Row("toy", "b", "by hand", 2.0, 2.2, 0.05, relative=True)
NAN = Row("toy", "c", "by hand", 1.0, float("nan"), 1e9)


@pytest.fixture
def toys(monkeypatch):
    given = {"good": [GOOD], "bad": [GOOD, BAD], "nan": [NAN]}
    monkeypatch.setattr(validation, "SYSTEMS", {name: name for name in given})

    def plots(directory):
        return [directory / "toy.png"]

    def module(name):
        drawn = {"plots": plots} if name == "good" else {}
        return SimpleNamespace(rows=lambda: iter(given[name]), **drawn)

    monkeypatch.setattr(validation, "_module", module)


def test_row_judges_absolute_and_relative_errors():
    assert GOOD.passed
    assert GOOD.error == pytest.approx(0.01)
    assert not BAD.passed
    assert BAD.error == pytest.approx(0.1)
    assert not NAN.passed


def test_names_and_their_beginnings():
    assert validation.selected(None) == list(validation.SYSTEMS)
    assert validation.selected(["fabre_g", "klosner"]) == ["fabre_guitar", "klosner"]
    assert len(validation.selected(["fabre"])) == 5
    assert validation.selected(["fabre", "fabre_guitar"]) == validation.selected(["fabre"])
    for unknown in ("", "stradivari"):
        with pytest.raises(TonewoodError, match=r"--only.*fabre_guitar"):
            validation.selected([unknown])


@pytest.mark.parametrize(("only", "code"), [(["good"], 0), (["bad"], 1), (["nan"], 1), (["good", "bad"], 1)])
def test_exit_code_tells_of_a_failed_row(toys, capsys, only, code):
    assert validate(only=only) == code
    printed = capsys.readouterr().out
    assert ("FAILED: toy" in printed) == (code == 1)


def test_json_holds_every_row(toys, capsys):
    assert validate(only=["bad", "nan"], as_json=True) == 1
    found = json.loads(capsys.readouterr().out, parse_constant=lambda text: pytest.fail(f"{text} is no JSON"))
    assert (found["schema"], found["ok"]) == ("tonewood-validation/1", False)
    assert [row["pass"] for row in found["rows"]] == [True, False, False]
    row = found["rows"][1]
    keys = {"system", "quantity", "source", "reference", "value", "error", "tolerance", "pass"}
    assert keys <= set(row)
    assert (row["system"], row["reference"], row["value"], row["tolerance"]) == ("toy", 2.0, 2.2, 0.05)
    assert found["rows"][2]["value"] is None


def test_what_cannot_be_written_is_one_line(toys, tmp_path, capsys):
    blocked = tmp_path / "file"
    blocked.write_text("")
    with pytest.raises(TonewoodError, match="cannot be made"):
        validate(plots=blocked, only=["good"])
    capsys.readouterr()


def test_plots_are_listed(toys, tmp_path, capsys):
    assert validate(plots=tmp_path / "new", only=["good", "nan"]) == 1
    assert capsys.readouterr().out.count("toy.png") == 1
    assert (tmp_path / "new").is_dir()


FITTED = Row("toy", "fitted", "made for it", 1.0, 1.0, 0.1, kind="regression")


def test_regression_is_distinguished_from_validation(capsys):
    assert validation.counted([GOOD, BAD]) == "2 rows"
    assert validation.counted([GOOD, FITTED, BAD]) == "3 rows (2 validation, 1 regression)"
    Console(width=200).print(validation.table("toys", [GOOD, FITTED]))
    printed = capsys.readouterr().out
    assert "toys: 2 rows (1 validation, 1 regression)" in printed
    (line,) = [line for line in printed.splitlines() if "made for it" in line]
    assert "regression" in line
    assert FITTED.to_dict()["kind"] == "regression"


@pytest.mark.slow
def test_rows_that_were_fitted_are_regression():
    """The academic system is a reconstruction from Table 1, the harp's body a stand-in with the paper's levels."""
    kinds = {row.quantity: row.kind for row in [*fabre_academic.rows(), *harp.rows()]}
    assert kinds["S1 mode 1 frequency (Hz)"] == kinds["S2 mode 5 MPC"] == "regression"
    assert kinds["case 2: third coupled mode, zeta"] == "regression"
    assert kinds["case 2 - case 1, string partial 3 (dB), as in the paper"] == "regression"
    assert kinds["case 2 - case 1, string partial 3 (dB)"] == "validation"
    assert kinds["case 1: waveform of m9, largest error / peak"] == "validation"
