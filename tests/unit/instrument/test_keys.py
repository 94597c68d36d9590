"""Table of keys: strings, hammers and dampers of every row, and messages about bad rows."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

import tonewood as tw
import tonewood.authoring as ta
from pianos import piano, some_keys
from tonewood.errors import BundleError
from tonewood.instrument.model.stretch import octave_stretch

ALL = ["A0", "F1", "C4", "C5", "C8"]


@pytest.fixture(scope="module")
def few(tmp_path_factory: pytest.TempPathFactory) -> tw.Instrument:
    return piano(tmp_path_factory.mktemp("few"), ALL)


def test_a_row_is_a_key_with_its_strings_hammer_and_damper(few: tw.Instrument) -> None:
    assert few.string_names == (
        *("A0", "F1_1", "F1_2"), *("C4_1", "C4_2", "C4_3"), *("C5_1", "C5_2", "C5_3"), *("C8_1", "C8_2", "C8_3")
    )  # fmt: skip
    assert few.groups["C4_1"] == ("C4_1", "C4_2", "C4_3")
    assert "C4_2" not in few.groups
    assert [few.spec.strings[f"C4_{i}"].cents for i in (1, 2, 3)] == [0.0, 0.82, -0.68]
    assert few.spec.strings["C4_3"].ends == ("body.C4",)
    assert few.resonators["C4_2"].parameters.loss.parameters.sigma0 == 0.18
    assert few.exciter("hammer", "C4_1").parameters.mass == 0.0087
    assert few.exciter("hammer", "A0").parameters.exponent == 2.24
    assert few.exciter("hammer", "A0").parameters.loss == few.exciters["hammer"].parameters.loss
    entries = few.spec.keys.entries
    assert entries["C4"].damper.from_bridge.fraction == 0.84
    assert entries["C8"].damper is None
    assert (entries["A0"].una_corda, entries["F1"].una_corda, entries["C4"].una_corda) == (1, 1, 2)


def test_the_piano_has_its_243_strings() -> None:
    grand = tw.load_instrument("grand_piano")
    sizes = [len(of) for of in grand.groups.values()]
    assert (sizes.count(1), sizes.count(2), sizes.count(3), len(grand.string_names)) == (8, 5, 75, 243)
    entries = grand.spec.keys.entries
    assert [name for name, key in entries.items() if key.kind == "published"] == ["C2", "C3", "C4", "C5", "C6", "C7"]
    damped = [name for name, key in entries.items() if key.damper]
    assert len(damped) == 69
    assert damped[-1] == "F6"


def test_overrides_reach_what_a_table_gave(few: tw.Instrument) -> None:
    other = few.replace({"strings.C4_1.length": 0.66, "keys.entries.*.exciter.mass": {"scale": 2.0}})
    assert other.resonators["C4_1"].length == 0.66
    assert other.exciter("hammer", "C4_1").parameters.mass == pytest.approx(0.0174)
    assert other.exciter("hammer", "A0").parameters.mass == pytest.approx(0.0224)
    assert other.groups == few.groups
    with pytest.raises(BundleError, match=r"keys\.table: cannot be changed"):
        few.replace({"keys.table": "other.csv"})


@pytest.mark.parametrize(
    ("cells", "line"),
    [
        ({"string.length": "7"}, r"keys\.csv: line 2: string\.length: is 7 m.*at most 5 m"),
        ({"string.length": "long"}, r"keys\.csv: line 2: string\.length: .*number"),
        ({"string.length": ""}, r"keys\.csv: line 2: string\.length: is missing"),
        ({"strings": "9"}, r"keys\.csv: line 2: strings: is 9; whole numbers from 1 to 6"),
        ({"una_corda": "4"}, r"keys\.csv: line 2: una_corda: is 4; 1 to 3, the number of its strings"),
        ({"damped": "perhaps"}, r"keys\.csv: line 2: damped: is 'perhaps'; yes and no"),
        ({"cents_2": "1_0"}, r"keys\.csv: line 2: cents_2: '1_0' is not a finite number"),
        ({"cents_2": "x"}, r"keys\.csv: line 2: cents_2: 'x' is not a finite number"),
        ({"cents_2": "300"}, r"keys\.csv: line 2: cents_2: is 300.*at most 100"),
        ({"note": ""}, r"keys\.csv: line 2: note: is empty"),
        ({"note": "H4"}, r"keys\.csv: line 2: note: .*H4"),
        ({"hammer.mass": "8.7"}, r"keys\.csv: line 2: hammer\.mass: is 8\.7 kg.*at most 1 kg"),
        ({"damper.resistance": "-1"}, r"keys\.csv: line 2: damper\.resistance: .*at least 0"),
        ({"kind": "invented"}, r"keys\.csv: line 2: kind: .*published"),
        ({"string.loss.sigma0": "-1"}, r"keys\.csv: line 2: string\.loss\.sigma0: .*at least 0"),
        ({"string.loss": "2"}, r"keys\.csv: line 2: string\.loss: has a value beside those of the columns below"),
        ({"string.plugin": "nope"}, r"keys\.csv: line 2: string\.plugin: there is no plugin 'nope'"),
        ({"string_2.end": "body.nix"}, r"keys\.csv: line 2: string_2\.end: there is no point 'body\.nix'"),
        ({"cents_4": "1"}, r"keys\.csv: line 2: cents_4: is of string 4; the row has 3"),
        ({"string_5.note": "C5"}, r"keys\.csv: line 2: string_5\.note: is of string 5; the row has 3"),
        ({"damper.foo": "1"}, r"keys\.csv: line 2: damper\.foo: is not a known key; allowed: from_bridge, width"),
    ],
)
def test_a_bad_cell_is_named(tmp_path: Path, cells: dict[str, str], line: str) -> None:
    with pytest.raises(tw.TonewoodError, match=line):
        piano(tmp_path / "bad", ["C4"], cells)


@pytest.mark.parametrize(
    ("before", "after", "line"),
    [
        ("hammer.mass", "hamer.mass", r"keys\.csv: hamer\.mass: is no column of a table of keys.*hammer\.PARAMETER"),
        ("hammer.mass", "hammer.mas", r"keys\.csv: line 2: hammer\.mas: is not a known key; did you mean mass"),
        ("note", "key", r"keys\.csv: key: is no column"),
        ("\nC4,", "\nC4,3\nC4,", r"keys\.csv: line 2: 2 numbers under 22 columns"),
    ],
)
def test_a_bad_header_is_named(tmp_path: Path, before: str, after: str, line: str) -> None:
    table = some_keys(tmp_path / "bad", ["C4"]) / "keys.csv"
    table.write_text(table.read_text().replace(before, after, 1))
    with pytest.raises(BundleError, match=line):
        tw.load_instrument(tmp_path / "bad")


@pytest.mark.parametrize(
    ("before", "after", "line"),
    [
        ("0.84}", "84}", r"instrument\.yaml: line \d+: keys\.damper\.from_bridge\.fraction: is 84; at most 1"),
        ("  damper: {", "  pedal: {}\n  damper: {", r"yaml: line \d+: keys\.pedal: is not a known key; .*pedals"),
        ("  damper: {from_bridge: {fraction: 0.84}}", "  damper: 5", r"keys\.damper: .*valid dictionary, not 5"),
        (
            "  damper: {",
            "  entries: {C4: {note: E4, strings: [C4_1]}}\n  damper: {",
            r"note: is 'C4', which `keys",
        ),
        ("strings:\n", "strings:\n  C4_2: {note: C4}\n", r"note: makes string C4_2, which `strings` has, too"),
        (
            "exciter: hammer",
            "exciter: hamer",
            r"yaml: line \d+: keys\.exciter: .*'hamer'; did you mean hammer",
        ),
        (
            "  damper: {",
            "  entries: {X: {note: 60, strings: [C4_1]}}\n  damper: {",
            r"keys\.csv: line 2: note: is 'C4', the pitch of key X; one key a pitch",
        ),
    ],
)
def test_what_a_bundle_says_beside_its_table_is_named(tmp_path: Path, before: str, after: str, line: str) -> None:
    manifest = some_keys(tmp_path / "bad", ["C4"]) / "instrument.yaml"
    text = manifest.read_text()
    assert before in text
    manifest.write_text(text.replace(before, after, 1))
    with pytest.raises(BundleError, match=line):
        tw.load_instrument(tmp_path / "bad")


def test_two_names_of_one_pitch_are_refused(tmp_path: Path) -> None:
    table = some_keys(tmp_path / "twice", ["C#4"]) / "keys.csv"
    text = table.read_text()
    table.write_text(text + text.splitlines()[-1].replace("C#4", "Db4") + "\n")
    with pytest.raises(BundleError, match=r"keys\.csv: line 3: note: is 'Db4', the pitch of key Cs4"):
        tw.load_instrument(tmp_path / "twice")


def test_cells_of_whole_numbers_and_printed_accidentals(tmp_path: Path) -> None:
    cells = {"note": "D\u266f4", "string.stops": "3", "string.end": "body.Ds4"}
    made = piano(tmp_path / "whole", ["C4"], cells)
    assert made.spec.strings["Ds4_1"].stops == 3
    assert made.open_note("Ds4_1") == 63


def test_what_would_have_no_effect_is_refused(few: tw.Instrument) -> None:
    with pytest.raises(BundleError, match=r"keys\.damper: is for the rows of a table.*keys\.entries\.NAME\.damper"):
        few.replace({"keys.damper.resistance": 5.0})
    with pytest.raises(BundleError, match=r"keys\.entries\.C4\.note: 'H' is not a note"):
        few.replace({"keys.entries.C4.note": "H"})
    with pytest.raises(BundleError, match=r"keys\.entries\.C4\.note: is C5, and its string C4_1 sounds C4; the same"):
        few.replace({"keys.entries.C4.note": "C5"})
    assert few.replace({"keys.entries.C4.note": 60}).open_note("C4_1") == 60


def test_keys_may_stand_beside_those_of_the_table(tmp_path: Path) -> None:
    manifest = some_keys(tmp_path / "beside", ["C4"]) / "instrument.yaml"
    own = "  E5: {note: E5, length: 0.3, tension: 700.0, linear_density: 0.006, bending_stiffness: 0.01, end: body.E5}"
    text = manifest.read_text().replace("strings:\n", f"strings:\n{own}\n", 1)
    manifest.write_text(text.replace("  exciter: h", "  entries: {X: {note: E5, strings: [E5]}}\n  exciter: h", 1))
    made = tw.load_instrument(tmp_path / "beside")
    assert set(made.spec.keys.entries) == {"C4", "X"}
    assert set(made.groups) == {"C4_1", "E5"}


def test_one_string_of_a_row_keeps_what_its_own_columns_leave(tmp_path: Path) -> None:
    loss = (
        piano(tmp_path / "own", ["C4"], {"string_2.loss.sigma0": "0.5"}).resonators["C4_2"].parameters.loss.parameters
    )
    assert (loss.sigma0, loss.sigma1) == (0.5, 0.00031)


def test_a_damper_lies_on_its_string(tmp_path: Path) -> None:
    away = piano(tmp_path / "away", ["C4"]).replace({"keys.entries.C4.damper.from_bridge": 3.0})
    with pytest.raises(BundleError, match=r"keys\.entries\.C4\.damper\.from_bridge: puts .* 3 m.*0 and 0\.657 m"):
        ta.assemble(away, 8000)


def test_a_damper_without_resistance_takes_nothing(tmp_path: Path) -> None:
    model = ta.assemble(piano(tmp_path / "soft", ["C4"], {"damper.resistance": "0"}), 8000)
    string = model.strings["C4_1"]
    bases = string.bases(0.0)
    for name, basis in string.modes.under_damper(bases, 1.0).items():
        assert (basis.poles == bases[name].poles).all()


def test_a_table_may_not_make_any_number_of_strings(tmp_path: Path) -> None:
    table = some_keys(tmp_path / "many", ["C4"], {"strings": "6", "una_corda": ""}) / "keys.csv"
    header, row = table.read_text().splitlines()
    letters = ("C", "C#", "D", "Eb", "E", "F", "F#", "G", "G#", "A", "Bb", "B")
    named = [f"{letter}{octave}" for octave in range(15) for letter in letters]
    table.write_text("\n".join([header, *(row.replace("C4", note, 1) for note in named)]))
    with pytest.raises(BundleError, match=r"line 172: strings: makes more than the 1024 strings allowed"):
        tw.load_instrument(tmp_path / "many")


def test_the_group_sounds_its_note_together(tmp_path: Path) -> None:
    from tonewood.instrument.inspection.mounted import Mounted

    # without mistuning, three strings in phase sound the note: 3 ends on one place of the board
    alike = piano(tmp_path / "alike", ["C3", "C4", "C5"], {"cents_2": "0", "cents_3": "0"})
    model = ta.assemble(alike.replace({"tuning.stretch": "none"}), 48000)
    for key in ("C3", "C4", "C5"):
        beside = {f"{key}_{i}": model.strings[f"{key}_{i}"] for i in (1, 2, 3)}
        (at,) = ta.pitches(model, [f"{key}_1"])
        star = Mounted(beside, model.body)
        # the mode in which the three share alike
        modes = star.pitch(at).modes
        together = min(modes, key=lambda mode: abs(mode[1] - 1 / 3))
        assert abs(together[0]) < 0.01


def test_octaves_of_two_strings_by_hand() -> None:
    B = {"A3": 2e-4, "A4": 6e-4}
    found = octave_stretch({"A3": 57.0, "A4": 69.0}, {"A3": 220.0, "A4": 440.0}, B)

    def above(b: float, m: int) -> float:
        return 600 * math.log2((1 + b * m * m) / (1 + b))

    wide = [above(B["A3"], 2 * k) - above(B["A4"], k) for k in range(1, 9)]
    assert found["A4"] == 0.0
    heard = [1 / (1 + (440 * k / 2000) ** 4) / (1 + (400 / (440 * k)) ** 4) for k in range(1, 9)]
    mean = sum(w * d for w, d in zip(heard, wide, strict=True)) / sum(heard)
    assert found["A3"] == pytest.approx(-mean, abs=1e-6)


def test_strings_without_stiffness_are_not_stretched() -> None:
    notes = {str(n): float(n) for n in range(40, 90)}
    found = octave_stretch(notes, {k: 440 * 2 ** ((n - 69) / 12) for k, n in notes.items()}, dict.fromkeys(notes, 0.0))
    assert max(map(abs, found.values())) < 1e-9


def test_the_piano_is_stretched_as_railsback_measured() -> None:
    from tonewood.instrument.model.string_assembly import stretch_cents

    found = stretch_cents(tw.load_instrument("grand_piano"))
    assert found["A4_1"] == 0.0
    # flat in the bass and sharp in the treble, by some tens of cents at the top
    assert -30 < found["A0"] < -15
    assert 20 < found["C8_1"] < 45
    assert all(abs(found[f"{n}_1"]) < 4 for n in ("C4", "G4", "C5"))
    assert found["C4_1"] == found["C4_2"] == found["C4_3"]


def test_keys_above_the_highest_mode_are_left_out(few: tw.Instrument) -> None:
    model = ta.assemble(few, 8000)
    assert set(model.groups) == {"A0", "F1_1", "C4_1", "C5_1"}
    assert any("keys.C8: left out" in line for line in model.warnings)
