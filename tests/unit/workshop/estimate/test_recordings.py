"""What names and tables tell, recordings that are of no use, and partials of known decay."""

from __future__ import annotations

import numpy as np
import pytest
import soundfile as sf
from estimate_sounds import FS, partials

from cli_runs import refused
from tonewood.cli.main import run
from tonewood.errors import TonewoodError
from tonewood.sound.equalizer import response_db
from tonewood.workshop.estimate.analysis import analyse, check_pitches
from tonewood.workshop.estimate.distance import distance
from tonewood.workshop.estimate.gain import KNOTS, Differences, bands_of, curve
from tonewood.workshop.estimate.recordings import Recording, clipped, dynamic_of, note_of_name, read_folder


@pytest.mark.parametrize(
    ("name", "note"),
    [
        ("A3", 57),
        ("57", 57),
        ("F#3", 54),
        ("guitar_Fs4_loud", 66),
        ("Bb2-pp", 46),
        ("C-1", 0),
        ("room", None),
        ("v1", None),
    ],
)
def test_the_note_of_a_name(name: str, note: int | None) -> None:
    assert note_of_name(name) == note


@pytest.mark.parametrize(
    ("text", "velocity"),
    [("A3_pp", 33), ("piano_A3_ff", 112), ("soft", 49), ("A3 v100", 100), ("A3", None), ("v0", None)],
)
def test_the_dynamic_of_a_name(text: str, velocity: float | None) -> None:
    assert dynamic_of(text) == velocity


def test_a_table_tells_string_stop_dynamic_and_place(tmp_path) -> None:
    sf.write(tmp_path / "take one.wav", partials(220.0, 1e-4, np.full(20, 3.0))[0], FS)
    (tmp_path / "notes.csv").write_text("file, string, stop, dynamic, place\ntake one.wav, A2, 12, mf, 0.08\n")
    (only,) = read_folder(tmp_path).recordings
    assert (only.string, only.stop, only.dynamic, only.place) == ("A2", 12.0, 80.0, 0.08)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("name,string\na.wav,A2\n", "column 'name' is unknown"),
        ("note\nA3\n", "a column `file` is missing"),
        ("file\nnowhere.wav\n", "there is no file 'nowhere.wav'"),
        ("file,note\na.wav,A3\n", ""),
        ("file,note,stop\na.wav,A3,many\n", "0 to 200 is allowed"),
        ("file,note,dynamic\na.wav,A3,very\n", "1 to 127 are allowed"),
        ("file,note,dynamic\na.wav,A3,²\n", "1 to 127 are allowed"),
        ("file,note,stop\na.wav,A3,1_2\n", "0 to 200 is allowed"),
        ("file\n", "has no rows"),
        ("file,note\na.wav,A3\na.wav,A3\n", "line 3: lists 'a.wav' a second time"),
        ("file,note,place\na.wav,A3,1,2\n", "line 2: has more cells than the 3 names"),
    ],
)
def test_a_table_that_cannot_be_read(tmp_path, text: str, said: str) -> None:
    sf.write(tmp_path / "a.wav", partials(220.0, 1e-4, np.full(20, 3.0))[0], FS)
    (tmp_path / "notes.csv").write_text(text)
    if said:
        with pytest.raises(TonewoodError, match=said):
            read_folder(tmp_path)
    else:
        assert read_folder(tmp_path).notes == (57,)


def test_files_of_no_use_are_told(tmp_path) -> None:
    x, _ = partials(220.0, 1e-4, np.full(20, 3.0))
    sf.write(tmp_path / "A3.wav", x, FS)
    sf.write(tmp_path / "B3.wav", np.clip(3 * x, -0.3, 0.3), FS)
    sf.write(tmp_path / "C4.wav", np.zeros(FS), FS)
    sf.write(tmp_path / "D4.wav", x[: FS // 5], FS)
    sf.write(tmp_path / "E4.wav", np.stack([x, -x], 1), FS)
    (tmp_path / "F4.wav").write_bytes(b"not a sound")
    sf.write(tmp_path / "noise.wav", x, FS)
    found = read_folder(tmp_path)
    assert found.notes == (57, 64)
    lines = "\n".join(found.warnings)
    for words in (
        "is clipped",
        "is silent",
        "lasts 0.20 s",
        "cancel each other",
        "cannot be read",
        "no note in its name",
    ):
        assert words in lines


def test_clipping_is_no_crest_of_a_sine() -> None:
    t = np.arange(FS) / FS
    assert clipped(np.sin(2 * np.pi * 27.5 * t)) == 0
    assert clipped(np.minimum(np.sin(2 * np.pi * 440.0 * t), 0.97)) > 4


def test_another_pitch_than_the_name_says(tmp_path) -> None:
    rows = [
        Recording(f"{n}.wav", n + 12, partials(440 * 2 ** ((n - 69) / 12), 1e-4, np.full(20, 3.0))[0])
        for n in (57, 60, 64)
    ]
    with pytest.raises(TonewoodError, match=r"-12.. cents from their names: try -12"):
        check_pitches(rows)
    good = [Recording(f"{n}.wav", n, partials(440 * 2 ** ((n - 69) / 12), 1e-4, np.full(20, 3.0))[0]) for n in (57, 60)]
    fits, lines = check_pitches([*good, rows[0]])
    assert len(fits) == 2
    assert "below the note of its name" in lines[0]


def test_partials_of_known_decay_are_found_again() -> None:
    n = np.arange(1, 31)
    rates = 1.5 + 0.4 * n
    for freq, b in ((110.0, 1e-4), (329.6, 4e-5)):
        x, f = partials(freq, b, rates)
        found = analyse(x, freq * 2 ** (20 / 1200), 2.5 * b)
        assert found.f0 == pytest.approx(freq, rel=2e-4)
        assert found.b == pytest.approx(b, rel=0.02)
        clear = [p for p in found.partials.values() if p.clear]
        assert len(clear) > 15
        for partial in clear:
            assert partial.freq == pytest.approx(f[partial.number - 1], rel=1e-3)
            assert partial.rate == pytest.approx(rates[partial.number - 1], rel=0.05)


def test_a_gain_common_to_all_is_no_distance_and_a_slower_decay_is_one() -> None:
    rates = np.full(25, 4.0)
    a, b, c = (
        analyse(partials(196.0, 1e-4, r, level=v)[0], 196.0, 1e-4)
        for r, v in ((rates, 0.3), (rates, 0.03), (1.5 * rates, 0.3))
    )
    same, slower = distance([(a, b)]), distance([(a, c)])
    assert same.third_octaves == pytest.approx(0, abs=0.05)
    assert same.decays == pytest.approx(1, abs=0.01)
    assert slower.decays == pytest.approx(1.5, rel=0.03)
    assert slower.third_octaves > 1


def test_a_gain_is_found_through_levels_of_notes() -> None:
    rng = np.random.default_rng(3)
    wanted = 6 * np.sin(np.log(KNOTS / 80.0))
    freq = np.exp(rng.uniform(np.log(80), np.log(10000), 1200))
    note = np.repeat(np.arange(12), 100)
    levels = np.interp(np.log(freq), np.log(KNOTS), wanted) + 10 * rng.normal(size=12)[note] + rng.normal(size=1200)
    levels[::20] += 30
    found = curve(Differences(note.astype(np.intp), freq, levels, np.ones(1200)))
    assert found - found.mean() == pytest.approx(wanted - wanted.mean(), abs=0.8)
    grid = np.geomspace(100, 8000, 30)
    made = response_db(bands_of(found), grid) - np.interp(np.log(grid), np.log(KNOTS), found)
    assert made - made.mean() == pytest.approx(0, abs=0.6)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["nowhere", "-o", "mine", "--from", "classical_guitar"], "there is no such folder"),
        (["empty", "-o", "mine", "--from", "classical_guitar"], "holds no sound files"),
        (["empty", "-o", "empty", "--from", "classical_guitar"], "is there already"),
        (["empty", "-o", "no/mine", "--from", "classical_guitar"], "there is no folder"),
        (["empty", "-o", "mine", "--from", "classical_guitar", "--iterations", "0"], "1 to 10 are allowed"),
        (["empty", "-o", "mine", "--from", "classical_guitar", "--page", "p.txt"], "ending in .html"),
        (["empty", "-o", "mine", "--from", "banjo"], "banjo"),
    ],
)
def test_errors_are_one_line_and_nothing_is_made(
    tmp_path, monkeypatch, capsys, arguments: list[str], said: str
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "empty").mkdir()
    with pytest.raises(SystemExit) as ended:
        run(["estimate", *arguments])
    out, err = capsys.readouterr()
    refused((ended.value.code, out, err), said)
    assert [path.name for path in tmp_path.iterdir()] == ["empty"]


@pytest.mark.parametrize("rate", [4000, 2**31 - 1])
def test_a_rate_that_no_recording_has_is_one_line(tmp_path, monkeypatch, capsys, rate: int) -> None:
    """Resampling of the second one would need 320 GiB."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "notes").mkdir()
    sf.write(tmp_path / "notes" / "A3.wav", 0.1 * np.sin(np.arange(4000)), 48000)
    with (tmp_path / "notes" / "A3.wav").open("r+b") as stream:
        stream.seek(24)
        stream.write(rate.to_bytes(4, "little"))
    with pytest.raises(SystemExit) as ended:
        run(["distance", "notes", "notes"])
    out, err = capsys.readouterr()
    assert (ended.value.code, out, err.count("\n")) == (2, "", 1)
    assert f"A3.wav: has {rate} samples a second; 8000 to 400000 are allowed" in err


@pytest.mark.parametrize("name", ["999", "C-3"])
def test_a_note_beyond_all_keys_is_left_out(tmp_path, name: str) -> None:
    """Its frequency would lie above half of the rate, or far below what is heard."""
    for stem in ("A3", name):
        sf.write(tmp_path / f"{stem}.wav", 0.3 * np.sin(np.arange(FS) * 2 * np.pi * 220 / FS), FS)
    folder = read_folder(tmp_path)
    assert [r.note for r in folder.recordings] == [57]
    assert any(f"left out: {name}.wav: is of note" in w and "0 to 127 are allowed" in w for w in folder.warnings)
