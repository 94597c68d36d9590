"""Extreme values and damaged files at the command line: a sound, or one line and exit code 2, and no file."""

from __future__ import annotations

import errno
import json
import re
import shutil
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
import soundfile as sf

from midi_bytes import midi_file, note, write
from tonewood.cli.app import _command
from tonewood.cli.results import _facts
from tonewood.errors import DamagedCacheWarning, OutputError, TonewoodError
from tonewood.instrument.contract.registry import instrument_folder
from tonewood.sound.files.audio import Audio
from tonewood.support.sound_rates import check_whole
from tonewood.workshop.listening import answer_file
from tonewood.workshop.listening.definition import load_test

Run = Callable[..., tuple[int, str, str]]


@pytest.fixture
def score(tmp_path: Path) -> Path:
    return write(tmp_path / "score.mid", [*note(0.0, 0.9, 45)])


def settings(*values: str) -> list[str]:
    return [word for value in values for word in ("--set", value)]


def assert_one_line(result: tuple[int, str, str], folder: Path, *said: str) -> None:
    code, out, err = result
    assert (code, out, err.count("\n")) == (2, "", 1), err[-500:]
    assert "Traceback" not in err
    assert len(err) < 2000
    for word in said:
        assert word in err
    assert not [path for path in folder.iterdir() if path.suffix in (".wav", ".json")]


def partials_of(sound: np.ndarray, fs: int, near: np.ndarray) -> np.ndarray:
    """Frequency of the largest line within 2 % of each frequency, Hz."""
    n = 8 * len(sound)
    spectrum = np.abs(np.fft.rfft(sound * np.hanning(len(sound)), n))
    freq = np.arange(len(spectrum)) * fs / n
    inside = [np.flatnonzero(np.abs(freq / f - 1) < 0.02) for f in near]
    return np.array([freq[i[np.argmax(spectrum[i])]] for i in inside])


@pytest.mark.parametrize(
    ("changes", "plane"),
    [
        (["strings.A2.polarizations=[y]"], "y"),
        (["strings.A2.end=[]"], "z"),
        (["body.points.bridge.direction=x"], "z"),
    ],
)
def test_a_string_that_moves_no_body_sounds_with_its_bridge_end_rigid(
    tonewood: Run, score: Path, tmp_path: Path, changes: list[str], plane: str
) -> None:
    """Partials of a stiff string between rigid supports: n sqrt((1 + B n^2) / (1 + B)), B = pi^2 EI / (T L^2)."""
    wav = tmp_path / "out.wav"
    heard = [
        "strings.A2.points={place: {from_bridge: 0.2}}",
        "outputs.bridge.at=A2.place",
        f"outputs.0.direction={plane}",
    ]
    heard += ["outputs.bridge.quantity=velocity", "outputs.bridge.full_scale=10.0"]
    code, _, err = tonewood(
        "render", score, "-i", "monochord", "-o", wav, "--max-duration", 1.0, *settings(*changes, *heard)
    )
    assert code == 0
    assert "strings.A2: shares no direction with the body's points it ends on" in err
    samples, fs = sf.read(str(wav))
    n = np.arange(1, 9)
    stiffness = np.pi**2 * 2.0e-4 / (58.8 * 0.9**2)
    wanted = 110.0 * n * np.sqrt((1 + stiffness * n**2) / (1 + stiffness))
    assert partials_of(samples[4800:], fs, wanted) == pytest.approx(wanted, abs=0.3)


@pytest.mark.slow
def test_a_body_that_does_not_move_is_reported(tonewood: Run, score: Path, tmp_path: Path) -> None:
    wav = tmp_path / "out.wav"
    change = settings("strings.A2.end=[]")
    code, out, _ = tonewood("render", score, "-i", "monochord", "-o", wav, "--max-duration", 0.1, "--json", *change)
    assert code == 1  # silent
    assert "its bridge end is rigid" in json.loads(out)["warnings"][0]
    assert not np.any(sf.read(str(wav))[0])
    assert tonewood("check", "monochord", *change)[0] == 0
    assert tonewood("modes", "monochord", *change)[0] == 0


@pytest.mark.parametrize("how", ["tuning.compensate=none", "tuning.at=open_only", "tuning.at=each_stop"])
@pytest.mark.parametrize("model", ["ideal", "finger"])
@pytest.mark.parametrize(("freq_upper", "command"), [(100.0, "render"), (420.0, "check")])
def test_too_few_modes_are_one_line(
    tonewood: Run, score: Path, tmp_path: Path, how: str, model: str, freq_upper: float, command: str
) -> None:
    change = settings(how, f"stops.model={model}", f"strings.A2.freq_upper={freq_upper}")
    rest = [score, "-i", "monochord", "-o", tmp_path / "out.wav"] if command == "render" else ["monochord"]
    said = ["instrument.yaml: strings.A2.freq_upper: ", f"{freq_upper:g} Hz leave 1 of the modes at stop", "2 or more"]
    assert_one_line(tonewood(command, *rest, *change), tmp_path, *said)


@pytest.mark.parametrize("freq_coupled", [20.0, 250.0, 300.0])
def test_a_string_of_which_hardly_a_partial_drives_longitudinal_motion_sounds(
    tonewood: Run, tmp_path: Path, freq_coupled: float
) -> None:
    score = write(tmp_path / "c4.mid", note(0.0, 0.2, 60))
    change = settings(f"strings.C4.freq_coupled={freq_coupled}")
    wav = tmp_path / "out.wav"
    assert tonewood("render", score, "-i", "struck_monochord", "-o", wav, "--max-duration", 0.05, *change)[0] == 0
    assert np.any(sf.read(str(wav))[0])


@pytest.mark.parametrize("value", ["1e9", "-1e9", "1e300"])
def test_a_note_beyond_all_pitch_is_one_line(tonewood: Run, score: Path, tmp_path: Path, value: str) -> None:
    result = tonewood("render", score, "-i", "monochord", "-o", tmp_path / "o.wav", "--set", f"strings.A2.note={value}")
    assert_one_line(result, tmp_path, "instrument.yaml: strings.A2.note: ", "octaves from the reference frequency; 100")


@pytest.fixture
def bundle(tmp_path: Path) -> Path:
    folder = tmp_path / "bundle"
    shutil.copytree(instrument_folder("monochord"), folder)
    return folder


@pytest.mark.parametrize("field", ["9" * 200_000, "x" * 200_000, '"' + "1" * 200_000])
@pytest.mark.parametrize("place", ["name", "number"])
def test_a_long_field_of_a_table_is_one_line(
    tonewood: Run, score: Path, tmp_path: Path, bundle: Path, field: str, place: str
) -> None:
    names, numbers = "f_Hz,Q,modal_mass,bridge", "300,30,1,1"
    table = [f"{names},{field}", f"{numbers},1"] if place == "name" else [names, f"300,30,1,{field}"]
    (bundle / "body.csv").write_text("\n".join(table) + "\n")
    result = tonewood("render", score, "-i", bundle, "-o", tmp_path / "o.wav")
    assert_one_line(result, tmp_path, "body.csv: line ", "field limit")


def test_a_body_above_the_highest_mode_is_reported_and_its_account_closes(
    tonewood: Run, score: Path, tmp_path: Path, bundle: Path
) -> None:
    (bundle / "body.csv").write_text("f_Hz,Q,modal_mass,bridge\n30000,30,10.0,1\n40000,30,10.0,1\n")
    render = ["render", score, "-i", bundle, "-o", tmp_path / "o.wav", "--max-duration", 0.05]
    code, _, err = tonewood(*render)
    assert code == 1  # silent
    assert "warning: body: has no mode below the highest that is stepped at 48000 Hz" in err
    code, out, _ = tonewood(*render, "--json", "--energy", tmp_path / "e.json")
    assert code == 1
    account = json.loads((tmp_path / "e.json").read_text())
    assert np.max(np.abs(account["residual"])) < 1e-11 * max(account["stored"]["A2.z"])
    assert "it does not sound" in json.loads(out)["warnings"][0]


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ("exciters.pluck.from_bridge=50", "exciters.pluck: from_bridge is 50 m; places up to 0.9 m"),
        ("exciters.pluck.from_bridge=0.901", "exciters.pluck: from_bridge is 0.901 m; places up to 0.9 m"),
    ],
)
def test_a_place_beyond_the_string_is_refused(
    tonewood: Run, score: Path, tmp_path: Path, change: str, said: str
) -> None:
    for command in (["render", score, "-i", "monochord", "-o", tmp_path / "o.wav"], ["check", "monochord"]):
        assert_one_line(tonewood(*command, "--set", change), tmp_path, "instrument.yaml: ", said)


def test_ignored_midi_is_counted(tonewood: Run, tmp_path: Path) -> None:
    """A program change, channel pressure twice, key pressure, bank select, modulation, system exclusive."""
    ignored = [
        (0.0, b"\xc0\x05"), (0.01, b"\xd0\x10"), (0.02, b"\xd0\x20"), (0.03, b"\xa0\x2d\x10"), (0.04, b"\xb0\x00\x01"),
        (0.05, b"\xb0\x01\x40"), (0.06, b"\xf0\x03\x01\x02\xf7"),
    ]  # fmt: skip
    score = tmp_path / "score.mid"
    score.write_bytes(midi_file([*note(0.0, 0.1, 45), *ignored]))
    render = ["render", score, "-i", "monochord", "-o", tmp_path / "o.wav", "--max-duration", 0.1]
    assert json.loads(tonewood(*render, "--json")[1])["midi_ignored"] == {
        "program change": 1, "channel pressure": 2, "polyphonic pressure": 1, "bank select": 1, "system exclusive": 1,
        "controller 1": 1,
    }  # fmt: skip
    line = next(line for line in tonewood(*render)[1].splitlines() if "without effect" in line)
    assert "2 channel pressure" in line
    assert "1 controller 1" in line
    plain = write(tmp_path / "plain.mid", note(0.0, 0.1, 45))
    assert "without effect" not in tonewood("render", plain, *render[2:])[1]


def test_names_the_file_system_cannot_hold_are_one_line(tonewood: Run, score: Path, tmp_path: Path) -> None:
    name, wav = "n" * 300, tmp_path / "o.wav"
    assert_one_line(tonewood("render", score, "-i", name, "-o", wav), tmp_path, "instrument 'nnn")
    assert_one_line(tonewood("render", score, "-i", "monochord", "-o", tmp_path / f"{name}.wav"), tmp_path, "too long")
    energy = ["--energy", tmp_path / f"{name}.json"]
    assert_one_line(tonewood("render", score, "-i", "monochord", "-o", wav, *energy), tmp_path, "too long")


@pytest.mark.parametrize(
    "command",
    [
        ["render", "\udcff.mid", "-i", "monochord", "-o", "o.wav"],
        ["render", "a.mid", "-i", "monochord", "-o", "\udcff.wav"],
        ["check", "monochord", "--set", "title=\udc80"], ["sample", "monochord", "-o", "\udcff.sfz"],
    ],
)  # fmt: skip
def test_an_argument_that_is_not_utf_8_is_one_line(
    tonewood: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: list[str]
) -> None:
    """Libraries of sound files end in tracebacks of such names, some after all samples were made."""
    monkeypatch.chdir(tmp_path)
    assert_one_line(tonewood(*command), tmp_path, "is not UTF-8")


@pytest.mark.parametrize("text", ['"a\\ud83d"', '"\\udfb8"'])
def test_half_a_surrogate_pair_in_a_bundle_or_manifest_is_one_line(tonewood: Run, tmp_path: Path, text: str) -> None:
    """No such text can be printed or written to a file."""
    assert tonewood("new", tmp_path / "own", "--from", "monochord")[0] == 0
    file = tmp_path / "own" / "instrument.yaml"
    lines = [f"title: {text}" if line.startswith("title:") else line for line in file.read_text().splitlines()]
    file.write_text("\n".join(lines) + "\n")
    for command in (["check", tmp_path / "own"], ["report", tmp_path / "own", "-o", tmp_path / "r.html"]):
        code, out, err = tonewood(*command)
        assert (code, out) == (2, "")
        assert err.count("\n") == 1
        assert "half a surrogate pair is no character" in err
    assert not (tmp_path / "r.html").exists()


def test_a_pitch_far_from_a_tension_that_stays_is_reported(tonewood: Run) -> None:
    """A string four times as light sounds an octave higher, at every stop."""
    change = settings("tuning.compensate=none", "strings.A2.linear_density=0.000375")
    code, out, _ = tonewood("check", "monochord", *change, "--json")
    assert code == 0
    off = [row["error_cents"] for row in json.loads(out)["off_pitch"]]
    assert len(off) == 25
    assert all(abs(cents - 1200) < 25 for cents in off)
    assert tonewood("modes", "monochord", *change)[0] == 0


def test_a_string_that_does_not_vibrate_names_its_loss(tonewood: Run, tmp_path: Path) -> None:
    """At the damping rate 2 pi 110 Hz = 691 1/s the lowest mode is critically damped."""
    change = settings("strings.A2.loss={law: sigma, sigma0: 2000, sigma1: 0}")
    said = "strings.A2.note: at stop 0: no mode", "decays at 2000 1/s, and from 691.2 1/s on", "lower `loss`"
    assert_one_line(tonewood("check", "monochord", *change), tmp_path, *said)


@pytest.mark.parametrize(
    ("of", "stem"),
    [
        (["-i", "classical_guitar", "--outputs", "microphones,bridge"], "bridge"),
        (["-i", "monochord", "--stems-by", "string"], "bridge.A2"),
        (["--part", "1=monochord"], "01_monochord"),
    ],
)
def test_a_mix_with_the_name_of_a_stem_is_one_line(
    tonewood: Run, score: Path, tmp_path: Path, of: list[str], stem: str
) -> None:
    """The stem would replace the mix, of which the other stems are cut."""
    result = tonewood("render", score, *of, "-o", tmp_path / f"{stem}.wav", "--stems", tmp_path)
    assert_one_line(result, tmp_path, f"{stem}.wav: --stems: is the name of a stem; another is allowed")


def test_no_line_of_an_error_steers_the_terminal(tonewood: Run, tmp_path: Path) -> None:
    code, _, err = tonewood("render", tmp_path / "\x1b[31mred.mid", "-i", "monochord", "-o", tmp_path / "a.wav")
    assert code == 2
    assert r"\x1b[31mred.mid: No such file" in err
    assert "\x1b" not in err


@pytest.mark.parametrize("value", ["1", "x", "[1]", "[[a, b]]", "null"])
@pytest.mark.parametrize("key", ["sources", "provenance"])
def test_sources_and_kinds_that_are_no_mapping_are_one_line(
    tonewood: Run, tmp_path: Path, key: str, value: str
) -> None:
    for name, more in (("monochord", ""), ("classical_guitar", "\nstrings_from: ej45")):
        folder = tmp_path / name
        shutil.copytree(instrument_folder(name), folder)
        text = (folder / "instrument.yaml").read_text()
        text = re.sub(r"^strings_from:.*\n", "", text, flags=re.MULTILINE)
        text = re.sub(rf"^{key}:.*\n(?:[ ]+.*\n|\n)*", f"{key}: {value}{more}\n", text, flags=re.MULTILINE)
        (folder / "instrument.yaml").write_text(text)
        code, _, err = tonewood("check", folder)
        assert (code, err.count("\n")) == (2, 1)
        assert f": {key}: " in err


with_stems = pytest.mark.parametrize(
    "of", [["-i", "monochord"], ["-i", "monochord", "--stems-by", "string"], ["--part", "1=monochord"]]
)


@with_stems
def test_stems_in_a_file_are_one_line_and_no_sound(tonewood: Run, score: Path, tmp_path: Path, of: list[str]) -> None:
    taken = tmp_path / "taken"
    taken.write_text("kept")
    result = tonewood("render", score, *of, "-o", tmp_path / "o.wav", "--max-duration", 0.02, "--stems", taken)
    assert_one_line(result, tmp_path, "--stems: is a file; a folder is allowed")
    assert taken.read_text() == "kept"


@with_stems
def test_stems_where_no_folder_can_be_made_are_one_line_before_any_work(
    tonewood: Run, score: Path, tmp_path: Path, of: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def made(*_: object, **__: object) -> Iterator[np.ndarray]:
        raise AssertionError("a sound was computed")
        yield np.zeros((1, 1))

    monkeypatch.setattr("tonewood.sound.render.renderer.Renderer.blocks", made)
    taken = tmp_path / "taken"
    taken.write_text("kept")
    before = sorted(tmp_path.iterdir())
    for folder, said in ((taken / "stems", "taken/stems: --stems: cannot be made: "), (tmp_path / ("n" * 300), "long")):
        result = tonewood("render", score, *of, "-o", tmp_path / "o.wav", "--stems", folder)
        assert_one_line(result, tmp_path, said)
    result = tonewood("render", score, *of, "-o", taken / "o.wav", "--stems", tmp_path / "stems")
    assert_one_line(result, tmp_path, "there is no folder")
    with pytest.raises(AssertionError, match="a sound was computed"):
        tonewood("render", score, *of, "-o", tmp_path / "o.wav", "--stems", tmp_path / "stems")
    assert sorted(tmp_path.iterdir()) == before


@pytest.mark.parametrize(("q", "said"), [("0", "must be above 0"), ("1e-320", "zeta from 1e-12 to 1e4 are allowed")])
def test_a_quality_factor_of_nothing_is_one_line(
    tonewood: Run, score: Path, tmp_path: Path, bundle: Path, q: str, said: str
) -> None:
    (bundle / "body.csv").write_text(f"f_Hz,Q,modal_mass,bridge\n300,{q},1,1\n")
    assert_one_line(tonewood("render", score, "-i", bundle, "-o", tmp_path / "o.wav"), tmp_path, "body.csv: ", said)


def test_a_release_in_no_time_is_a_step_of_force(tonewood: Run, score: Path, tmp_path: Path) -> None:
    """Of 1e-300 s, whose square is 0, or of 0 s: the same samples."""
    heard = []
    for value in ("1.0e-300", "0"):
        wav = tmp_path / f"{value}.wav"
        change = settings(f"exciters.pluck.release_time={value}")
        assert tonewood("render", score, "-i", "monochord", "-o", wav, "--max-duration", 0.05, *change)[0] == 0
        heard.append(sf.read(str(wav))[0])
    assert np.any(heard[0])
    np.testing.assert_array_equal(*heard)


def test_a_track_of_thousands_of_digits_is_one_line(tonewood: Run, score: Path, tmp_path: Path) -> None:
    result = tonewood("render", score, "-i", "monochord", "-o", tmp_path / "o.wav", "--tracks", "9" * 5000)
    assert_one_line(result, tmp_path, "--tracks: is '999")


def test_recordings_without_samples_are_one_line(tonewood: Run, tmp_path: Path) -> None:
    hit = tmp_path / "hit.rf64"
    sf.write(str(hit), np.zeros((0, 2)), 48000, subtype="FLOAT")
    how = ["--points", "bridge", "--driving", "bridge", "--form", "accelerance", "--sensitivity", "100,100"]
    assert_one_line(
        tonewood("fit", hit.rename(tmp_path / "hit.WAV"), "-o", tmp_path / "f", *how), tmp_path, "no samples"
    )
    assert not (tmp_path / "f").exists()


def test_ctrl_c_between_a_sound_and_its_stems_names_the_sound(
    tonewood: Run, score: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def stopped(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("tonewood.cli.render.write_output_stems", stopped)
    wav = tmp_path / "o.wav"
    stems = ["--max-duration", 0.02, "--stems", tmp_path / "stems"]
    code, out, err = tonewood("render", score, "-i", "monochord", "-o", wav, *stems)
    assert (code, out, err) == (130, "", f"tonewood: interrupted; {wav} is written, its stems are not\n")
    assert sf.info(str(wav)).frames == 960


DEEP = "[" * 100_000


@pytest.mark.parametrize("text", ["", "null", "[]", "3", "{}", '{"files": [{}]}', '{"files": [], "manifest": 1}', DEEP])
def test_a_damaged_record_of_a_batch_is_one_line(tmp_path: Path, text: str) -> None:
    assert _facts(tmp_path) is None
    (tmp_path / "manifest.json").write_text(text)
    with pytest.raises(TonewoodError, match=r"manifest\.json: is not the record of a batch"):
        _facts(tmp_path)


def test_files_of_a_listening_test_nested_too_deep_are_one_line(tmp_path: Path) -> None:
    (tmp_path / "test.json").write_text(DEEP)
    with pytest.raises(TonewoodError, match=r"test\.json: not JSON"):
        load_test(tmp_path)
    (tmp_path / "answers.jsonl").write_text(DEEP + "\n")
    with pytest.raises(TonewoodError, match=r"answers\.jsonl: line 1: not JSON"):
        answer_file.read(tmp_path / "answers.jsonl")


def test_no_output_replaces_what_is_read(tonewood: Run, score: Path, tmp_path: Path) -> None:
    """Neither by its name nor by a link; the score and the room are as they were."""
    room, link, notes = tmp_path / "ir.wav", tmp_path / "link.wav", tmp_path / "notes.txt"
    sf.write(room, np.ones(8), 48000)
    link.symlink_to(score)
    shutil.copy(score, notes)
    before = score.read_bytes(), room.read_bytes()
    for arguments in (
        ["tab", notes, "-i", "classical_guitar", "-o", notes],
        ["render", score, "-i", "monochord", "-o", room, "--room", room],
        ["render", score, "-i", "monochord", "-o", link],
    ):
        code, out, err = tonewood(*arguments)
        assert (code, out, err.count("\n")) == (2, "", 1)
        assert "would replace a file that is read" in err
    assert (score.read_bytes(), room.read_bytes(), notes.read_bytes()) == (*before, before[0])


def test_no_other_output_replaces_what_is_read(tonewood: Run, score: Path, tmp_path: Path) -> None:
    """A table or an account of energy in place of the instrument's own table, a stem in place of the score."""
    mine, sound, stems = tmp_path / "mine", tmp_path / "a.wav", tmp_path / "st"
    shutil.copytree(instrument_folder("monochord"), mine)
    (mine / "own.csv").write_text("measured")
    stems.mkdir()
    (stems / "bridge.wav").write_bytes(score.read_bytes())
    short = ["-i", mine, "--max-duration", "0.05", "-o", sound]
    for arguments in (
        ["modes", mine, "--table", mine / "own.csv"],
        ["render", score, *short, "--energy", mine / "own.csv"],
        ["render", stems / "bridge.wav", *short, "--stems", stems],
    ):
        code, _, err = tonewood(*arguments)
        assert (code, err.count("would replace a file that is read")) == (2, 1), err
    shutil.copy(score, tmp_path / "tap.csv")
    (mine / "page.html").write_text("mine")
    for arguments in (
        ["taptone", tmp_path / "tap.csv", "-o", tmp_path / "tap.csv"],
        ["wood", tmp_path / "tap.csv", "-o", tmp_path / "tap.csv"],
        ["compare", "monochord", mine, "-o", mine / "page.html"],
        ["report", mine, "-o", mine / "page.html"],
        ["plan", score, "-i", mine, "-o", mine / "own.csv"],
    ):
        code, _, err = tonewood(*arguments)
        assert (code, err.count("\n")) == (2, 1), err
    assert (tmp_path / "tap.csv").read_bytes() == score.read_bytes()
    assert (mine / "page.html").read_text() == "mine"
    assert (mine / "own.csv").read_text() == "measured"
    assert (stems / "bridge.wav").read_bytes() == score.read_bytes()


@pytest.mark.parametrize(
    ("name", "data", "said"),
    [
        ("e.musicxml", b"", "is not MusicXML: it is empty"),
        ("u.xml", "<score-partwise/>".encode("utf-16-be"), "is not MusicXML: it does not begin with '<'"),
        ("a.mxl", b"no archive", "is not an archive of a score: it does not begin with 'PK'"),
        ("a.gp5", b"other", "is not Guitar Pro"),
    ],
)
def test_a_score_that_is_not_of_its_kind_is_named_by_it(
    tonewood: Run, tmp_path: Path, name: str, data: bytes, said: str
) -> None:
    (tmp_path / name).write_bytes(data)
    result = tonewood("render", tmp_path / name, "-i", "monochord", "-o", tmp_path / "o.wav")
    assert_one_line(result, tmp_path, f"{name}: {said}")


def test_a_warning_is_printed_once(capsys: pytest.CaptureFixture[str]) -> None:
    """Also where a context of filters between two warnings makes Python forget the first."""

    def twice() -> None:
        for _ in range(2):
            with warnings.catch_warnings():
                warnings.warn("damaged", DamagedCacheWarning, stacklevel=1)

    _command(twice)()
    assert capsys.readouterr().err == "tonewood: warning: damaged\n"


@with_stems
def test_stems_that_fail_leave_no_folder(
    tonewood: Run, score: Path, tmp_path: Path, of: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object, **__: object) -> None:
        raise OutputError("cannot be written: No space left on device", file="st/bridge.wav")

    for name in ("render.write_output_stems", "render.write_string_stems"):
        monkeypatch.setattr(f"tonewood.cli.{name}", full)
    stems = ["--max-duration", 0.02, "--stems", tmp_path / "st"]
    if "--part" in of:
        save = Audio.save
        monkeypatch.setattr(
            Audio, "save", lambda self, file, *more: full() if "st" in file.parts else save(self, file, *more)
        )
    code, _, err = tonewood("render", score, *of, "-o", tmp_path / "o.wav", *stems)
    assert (code, err.count("\n")) == (2, 1), err
    assert not (tmp_path / "st").exists()


def test_samples_on_a_full_disk_name_the_file(tonewood: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("tonewood.workshop.sampling.library.np.save", full)
    few = ["--range", "45-45", "--velocities", "80", "--round-robins", 1, "--duration", 0.5]
    code, _, err = tonewood("sample", "monochord", "-o", tmp_path / "s.sfz", *few)
    assert (code, err) == (2, f"tonewood: {tmp_path}/s.sfz: cannot be written: No space left on device\n")
    assert not list(tmp_path.iterdir())


def test_a_recording_that_is_cut_short_or_absurd_is_one_line(tonewood: Run, tmp_path: Path) -> None:
    """A length that a pipe's writer did not know (2^32 - 1) is no promise: the file is read."""
    sound = np.random.default_rng(1).normal(0, 0.1, 48000) * np.exp(-np.arange(48000) / 4000.0)
    whole, half, huge = (tmp_path / f"{name}.WAV" for name in ("whole", "half", "huge"))
    sf.write(whole, sound, 48000, subtype="DOUBLE", format="WAV")
    data = whole.read_bytes()
    half.write_bytes(data[: len(data) // 2])
    sf.write(huge, 1e300 * sound, 48000, subtype="DOUBLE", format="WAV")
    assert_one_line(tonewood("taptone", half), tmp_path, "half.WAV: is cut short: ", "of 384000 bytes")
    assert_one_line(tonewood("taptone", huge), tmp_path, "huge.WAV: has a sample of ", "up to 1e+30 are allowed")
    notes = write(tmp_path / "n.mid", [*note(0.0, 0.1, 45)])
    room = tonewood("render", notes, "-i", "monochord", "-o", tmp_path / "o.wav", "--room", half)
    assert_one_line(room, tmp_path, "is cut short")
    at = data.index(b"data") + 4
    half.write_bytes(data[:at] + b"\xff" * 4 + data[at + 4 : len(data) // 2])
    check_whole(half)


def test_a_string_without_stops_plays_its_open_note(tonewood: Run, score: Path, tmp_path: Path) -> None:
    short = ["-i", "monochord", "-o", tmp_path / "o.wav", "--max-duration", 0.05, "--set", "stops.count=0"]
    assert tonewood("render", score, *short)[0] == 0
    high = write(tmp_path / "high.mid", [*note(0.0, 0.9, 46)])
    (tmp_path / "o.wav").unlink()
    code, _, err = tonewood("render", high, *short)
    assert (code, err.count("\n")) == (1, 1)
    assert "the strings reach from A2 to A2" in err


def test_a_number_with_its_unit_says_that_units_are_si(tonewood: Run, tmp_path: Path) -> None:
    change = settings("body.added=[{at: bridge, mass: 10 g}]")
    said = "not '10 g': numbers are in SI units and stand without them"
    assert_one_line(tonewood("check", "monochord", *change), tmp_path, said)


def test_a_preset_cuts_nothing_off_the_first_note(tonewood: Run, score: Path, tmp_path: Path) -> None:
    common = ("render", score, "-i", "monochord", "-o", tmp_path / "a.wav", "--max-duration", 0.1, "--preset", "dry")
    assert "smoothed" not in tonewood(*common)[1]
    assert "smoothed" in tonewood(*common, "--lead-in", 0)[1]


@pytest.mark.parametrize("option", ["--fs", "--block", "--capo"])
def test_an_integer_beyond_all_floats_is_one_line(tonewood: Run, score: Path, tmp_path: Path, option: str) -> None:
    result = tonewood("render", score, "-i", "monochord", "-o", tmp_path / "o.wav", option, "9" * 400)
    assert_one_line(result, tmp_path, f"{option.lstrip('-')}: is inf")


@pytest.mark.parametrize(
    "words",
    [("migrate",), ("distance", "x" * 300), ("fit", "a.csv", "--form", "mobility", "-o"), ("batch", "m.yaml", "-o")],
)
def test_a_name_that_is_too_long_is_one_line(tonewood: Run, tmp_path: Path, words: tuple[str, ...]) -> None:
    monochord = {"mono": "monochord"}
    phrase = {"low": {"phrase": [{"time": 0.0, "duration": 0.3, "note": 45, "force": 1.1}]}}
    manifest = {"schema": "tonewood-batch/1", "name": "m", "seed": 1, "instruments": monochord, "scores": phrase}
    (tmp_path / "m.yaml").write_text(json.dumps(manifest))
    (tmp_path / "a.csv").write_text("freq_Hz,bridge_re,bridge_im\n" + "".join(f"{k},1,1\n" for k in range(50, 99)))
    files = [tmp_path / word if "." in word else word for word in words]
    code, _, err = tonewood(*files, "x" * 300)
    assert code == 2
    assert err.count("\n") == 1, err
    assert "x" * 300 in err
