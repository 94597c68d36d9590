"""Commands that play live, several parts, and scores that are not MIDI."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import soundfile as sf

import tonewood as tw
from tonewood.cli.main import run
from tonewood.sound.live.take import Take

sys.path.insert(0, str(Path(__file__).parents[1] / "unit" / "performance" / "score"))
from tablatures import guitar_pro, musicxml, note

Run = Callable[..., tuple[int, str, str]]


@pytest.fixture
def tonewood(capsys: pytest.CaptureFixture[str]) -> Run:
    def command(*words: Any) -> tuple[int, str, str]:
        with pytest.raises(SystemExit) as ended:
            run([str(word) for word in words])
        out, err = capsys.readouterr()
        return int(ended.value.code or 0), out, err

    return command


@pytest.fixture
def duo(tmp_path: Path) -> Path:
    notes = [tw.Note(0.2 * i, 0.2, note=60 + i, channel=i % 2, velocity_midi=80) for i in range(4)]
    tw.write_midi(tw.Score(notes), tmp_path / "duo.mid")
    return tmp_path / "duo.mid"


def test_parts_are_mixed(tonewood: Run, duo: Path, tmp_path: Path) -> None:
    words = ("render", duo, "--part", "2=monochord@-3dB@pan-0.5", "--fs", 16000)
    words += ("--max-duration", 0.3, "-o", tmp_path / "mix.wav", "--stems", tmp_path / "stems")
    code, out, _ = tonewood(*words, "--json")
    found = json.loads(out)
    assert (code, found["schema"]) == (0, "tonewood-render-parts/1")
    assert found["true_peak_dbtp"] == pytest.approx(-1.0)
    assert [(p["part"], p["gain_db"], p["notes"]) for p in found["parts"]] == [(2, -3.0, 1)]
    mix, _ = sf.read(tmp_path / "mix.wav")
    stems = [sf.read(file)[0] for file in found["stems"]]
    assert np.abs(mix - sum(stems)).max() < 3 * 2**-23
    _, out, _ = tonewood(*words, "--level", "calibrated")
    assert "1 part at 16000 Hz, true peak" in out
    assert "part 2 on monochord, -3.0 dB, pan -0.50: 1 note, 0 dropped" in out


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (("--part", "7=monochord"), "there is no channel 7; there are 1, 2"),
        (("--part", "1=monochord", "-i", "monochord"), "--instrument: is for one instrument"),
        (("--ensemble", "none.yaml"), "none.yaml: cannot be read: No such file or directory"),
        (("--set", "name=a"), "--set: is for one instrument, chosen by -i"),
        (("-i", "monochord", "--programs", "a.yaml"), "--programs: is for a score without -i"),
        (("--programs", "none.yaml"), "none.yaml: cannot be read: No such file or directory"),
        (("-i", "monochord", "--tracks", "one"), "--tracks: is 'one'; numbers from 1"),
        (("-i", "monochord", "--tempo", "0"), "a tempo of 0.0 times the score's: 0.05 to 20 are allowed"),
        (("-i", "monochord", "--live", "--start", "1"), "--live: repeats a take as it was"),
    ],
)
def test_what_cannot_be_is_one_line(
    tonewood: Run, duo: Path, tmp_path: Path, words: tuple[str, ...], line: str
) -> None:
    code, out, err = tonewood("render", duo, "-o", tmp_path / "a.wav", *words)
    assert (code, out) == (2, "")
    assert line in err
    assert len(err.splitlines()) == 1


def test_written_scores_are_rendered_and_lacking_techniques_counted(tonewood: Run, tmp_path: Path) -> None:
    def change(song: Any, beats: list[Any]) -> None:
        for beat in beats:
            beat.notes[0].effect.palmMute = True

    for path in (guitar_pro(tmp_path / "a.gp5", change), tmp_path / "b.musicxml"):
        if path.suffix == ".musicxml":
            path.write_text(musicxml(note("E", 2, 16, "<handbell/>")), encoding="utf-8")
        words = (
            "render",
            path,
            "-i",
            "flamenco_guitar",
            "--fs",
            8000,
            "--max-duration",
            0.2,
            "-o",
            tmp_path / "a.wav",
        )
        code, out, _ = tonewood(*words)
        assert code == 0
        assert ("4 palm mute, plucked as any note" if path.suffix == ".gp5" else "1 handbell") in out


@pytest.mark.slow
def test_one_part_twice_has_two_stems(tonewood: Run, duo: Path, tmp_path: Path) -> None:
    words = (
        "render",
        duo,
        "--fs",
        16000,
        "--max-duration",
        0.3,
        "-o",
        tmp_path / "mix.wav",
        "--stems",
        tmp_path / "stems",
    )
    code, out, _ = tonewood(*words, "--part", "2=monochord", "--part", "2=monochord@-6dB", "--json")
    stems = json.loads(out)["stems"]
    assert (code, [Path(file).name for file in stems]) == (0, ["02_monochord.wav", "02_monochord_2.wav"])
    one, two = (sf.read(file)[0] for file in stems)
    assert np.abs(two - one / 10**0.3).max() < 2 * 2**-23
    assert one.any()


def test_excerpts_and_capo(tonewood: Run, duo: Path, tmp_path: Path) -> None:
    words = ("render", duo, "-i", "classical_guitar", "--fs", 8000, "-o", tmp_path / "a.wav", "--json", "--tail", 0.1)
    code, out, _ = tonewood(*words, "--start", 0.15, "--stop", 0.45, "--tempo", 2, "--tracks", 2, "--capo", 2)
    assert (code, json.loads(out)["notes"]) == (0, 1)


def test_outputs_of_one_instrument_as_stems(tonewood: Run, duo: Path, tmp_path: Path) -> None:
    words = ("render", duo, "-i", "classical_guitar", "--fs", 8000, "--max-duration", 0.2, "-o", tmp_path / "a.wav")
    code, _, _ = tonewood(*words, "--outputs", "microphones,bridge", "--stems", tmp_path / "stems")
    assert code == 0
    whole, _ = sf.read(tmp_path / "a.wav")
    assert np.array_equal(sf.read(tmp_path / "stems" / "microphones.wav")[0], whole[:, :2])
    assert np.array_equal(sf.read(tmp_path / "stems" / "bridge.wav")[0], whole[:, 2])


def test_a_take_is_rendered_again(tonewood: Run, tmp_path: Path) -> None:
    live, take = tw.Live("monochord", prepare=False), Take(48000)
    take.add(0, (0x90, 45, 100))
    live.note_on(45, 100)
    sound = live.process(4800)
    take.save(tmp_path / "take.mid", live, live.frames)
    words = ("render", tmp_path / "take.mid", "-i", "monochord", "--live", "-o", tmp_path / "a.wav")
    code, _, err = tonewood(*words, "--subtype", "DOUBLE", "--level", "calibrated", "--max-duration", 0.1)
    assert (code, err) == (0, "")
    assert np.array_equal(sf.read(tmp_path / "a.wav", always_2d=True)[0], sound)


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (("-i", "monochord"), "there is no SCORE; without one give --midi-in or --keyboard"),
        (("-i", "monochord", "--keyboard"), "--keyboard: standard input is no terminal"),
        (("-i", "monochord", "--keyboard", "--ramp", "0"), "--ramp: is 0 ms; 1 to 100 are allowed"),
        (("-i", "monochord", "--keyboard", "--limiter"), "--level: a look-ahead limiter"),
        (("-i", "monochord", "--keyboard", "--record", "none/a.mid"), "--record: there is no folder none"),
        (("-i", "monochord", "--keyboard", "--record", "."), "--record: . cannot be written"),
        (("-i", "monochord", "--keyboard", "--tail", "3"), "tail: is for scores that are known before"),
    ],
)
def test_a_live_session_that_cannot_be_is_one_line(tonewood: Run, words: tuple[str, ...], line: str) -> None:
    code, _, err = tonewood("play", *words)
    assert code == 2
    assert line in err
    assert len(err.splitlines()) == 1


def test_a_score_has_nothing_to_record(tonewood: Run, duo: Path) -> None:
    assert "--record: records live playing" in tonewood("play", duo, "-i", "monochord", "--record", "a.mid")[2]
    assert "one of both is allowed" in tonewood("play", duo, "-i", "monochord", "--keyboard")[2]


def test_strings_of_one_instrument_as_stems(tonewood: Run, duo: Path, tmp_path: Path) -> None:
    """Their files add up to the mix, at its gain and length; a mix that cannot be split is refused."""
    words = ("render", duo, "-i", "classical_guitar", "--fs", 16000, "-o", tmp_path / "mix.wav", "--max-duration", 0.3)
    more = ("--effects", "none", "--stems", tmp_path / "stems", "--stems-by", "string")
    code, out, _ = tonewood(*words, *more)
    assert code == 0
    mix, files = sf.read(tmp_path / "mix.wav")[0], sorted((tmp_path / "stems").iterdir())
    assert [file.stem.split(".")[1] for file in files] == sorted(["E2", "A2", "D3", "G3", "B3", "E4", "body"])
    assert str(files[0].name) in out
    assert np.abs(sum(sf.read(file)[0] for file in files) - mix).max() < 6 * 2**-23
    code, out, _ = tonewood(*words, *more, "--gain", 30, "--json")
    clipped = {file: np.count_nonzero(np.abs(sf.read(file)[0]) > 1 - 2.0**-22) for file in files}
    assert max(clipped.values()) > 1
    for file, n in clipped.items():  # strings that cancel may be louder than their sum
        line = f"{file}: {n} samples were clipped; lower --gain or --normalize, or use --subtype FLOAT"
        assert (line in json.loads(out)["warnings"]) == (n > 1)
    for wrong in (("--stems-by", "string"), ("--stems", tmp_path / "stems", "--stems-by", "fret")):
        code, _, err = tonewood(*words, *wrong)
        assert (code, err.count("\n")) == (2, 1)
        assert "--stems-by" in err
