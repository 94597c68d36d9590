"""Named string sets: against figures printed elsewhere, and put on instruments."""

from __future__ import annotations

import json

import numpy as np
import pytest

import tonewood as tw
from tonewood.authoring import assemble
from tonewood.cli.main import run
from tonewood.errors import TonewoodError
from tonewood.instrument.bundle.string_sets import figures, string_sets


def of(name, note, length=0.65, freq=None):
    chosen = string_sets()[name]
    entry = next(entry for entry in chosen.strings if entry.note == note)
    return figures(entry, chosen, length, freq or {"G3": 195.99772, "E2": 82.406889, "E4": 329.62756}[note])


def test_a_nylon_string_of_which_more_is_published():
    """G3 of 1 mm nylon on 0.65 m: 58.1277 N, and E A 2120.575 N, as a study of nonlinear strings prints them."""
    found = of("ej45", "G3")
    assert found["tension"] == pytest.approx(58.1277, abs=1e-3)
    assert found["axial_stiffness"] == pytest.approx(2120.575, abs=1e-3)
    assert "loss" not in found


def test_the_shipped_guitars_are_their_sets():
    for instrument, name, tolerance in (("classical_guitar", "ej46", 1e-6), ("steel_strings", "ej16", 3e-3)):
        bare = tw.load_instrument(instrument)
        strings = bare.replace({"strings_from": name}).resolved["strings"]
        for key, part in bare.resolved["strings"].items():
            for number in ("tension", "linear_density", "bending_stiffness"):
                assert strings[key][number] == pytest.approx(part[number], rel=tolerance), (key, number)
            assert strings[key]["loss"] == part["loss"]


def test_tension_goes_with_the_square_of_length_and_pitch():
    usual, longer = of("ej46", "E2"), of("ej46", "E2", length=0.66, freq=82.406889 * 2 ** (-2 / 12))
    assert usual["tension"] == pytest.approx(71.6, rel=1e-6)
    assert longer["tension"] == pytest.approx(71.6 * (0.66 / 0.65) ** 2 * 2 ** (-4 / 12), rel=1e-6)


@pytest.mark.parametrize("name", sorted(string_sets()))
def test_every_set_has_the_pitch_of_its_notes(name):
    """Published tensions and densities are those of the note: a quarter tone at most, as sources round."""
    chosen = string_sets()[name]
    notes = {"E2": 40, "A2": 45, "D3": 50, "G3": 55, "B3": 59, "E4": 64, "C2": 36, "G2": 43, "A3": 57}
    notes |= {"D4": 62, "A4": 69, "E5": 76, "E1": 28, "A1": 33, "D2": 38}
    for entry in chosen.strings:
        length, freq = entry.length or chosen.length, 440.0 * 2 ** ((notes[entry.note] - 69) / 12)
        found = figures(entry, chosen, length, freq)
        sounding = np.sqrt(found["tension"] / found["linear_density"]) / (2 * length)
        assert abs(1200 * np.log2(sounding / freq)) < 50, entry.note


def test_a_bundle_names_its_set(tmp_path):
    """Keys of the bundle's own strings go first; values of the set have the set's source."""
    folder = tmp_path / "mine"
    with pytest.raises(SystemExit):
        run(["new", str(folder), "--from", "classical_guitar", "--strings", "ej45"])
    file = folder / "instrument.yaml"
    file.write_text(file.read_text().replace('G3: {"note": "G3"', 'G3: {"tension": 60.0, "note": "G3"'))
    mine = tw.load_instrument(folder)
    assert mine.resolved["strings"]["G3"]["tension"] == 60.0
    assert mine.resolved["strings"]["E4"]["tension"] == pytest.approx(of("ej45", "E4")["tension"])
    assert mine.origins.of("strings.E4.tension").source == "strings_ej45"
    assert mine.origins.of("strings.E4.loss").kind == "unknown"
    lower = mine.replace({"strings.E4.note": "D4"})
    assert lower.resolved["strings"]["G3"]["tension"] == 60.0
    again = mine.replace({"strings_from": "ej46", "strings.E2.tension": 70.0})
    assert again.resolved["strings"]["E2"]["tension"] == 70.0
    assert again.resolved["strings"]["G3"]["tension"] == pytest.approx(58.3, rel=1e-5)


def test_check_tells_how_strings_feel(capsys):
    """T (1/a + 1/b) aside and T sin(angle) down."""
    with pytest.raises(SystemExit):
        run(["check", "classical_guitar", "--strings", "ej45", "--set", "strings.*.break_angle_deg=25", "--json",
             "--set", "stops.kind=none"])  # fmt: skip
    report = json.loads(capsys.readouterr().out)
    guitar = tw.load_instrument("classical_guitar").replace({"strings_from": "ej45", "stops.kind": "none"})
    model = assemble(guitar, 48000)
    for name, row in report["strings"].items():
        tension = model.strings[name].tension(0)
        assert row["feel"]["newton_per_mm"] == pytest.approx(1e-3 * tension * (1 / 0.105 + 1 / 0.545), rel=1e-9)
        assert row["feel"]["force_on_bridge"] == pytest.approx(tension * np.sin(np.deg2rad(25.0)), rel=1e-9)


@pytest.mark.parametrize(
    ("instrument", "name", "shown"),
    [
        ("classical_guitar", "ej4", "there is no string set 'ej4'; did you mean ej46. there are ej46, ej45"),
        ("monochord", "ej45", "ej45 has 6 strings .E2, A2, D3, G3, B3, E4.; this instrument has 1"),
        ("steel_strings", "ej46", "strings.E2.axial_stiffness: the string set does not say it"),
    ],
)
def test_a_set_that_does_not_fit(instrument, name, shown):
    with pytest.raises(TonewoodError, match=shown):
        tw.load_instrument(instrument).replace({"strings_from": name})
