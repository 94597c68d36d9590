"""``tonewood render --energy``."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import soundfile as sf

import tonewood as tw
from tonewood.cli.main import run


@pytest.fixture
def score(tmp_path: Path) -> Path:
    path = tmp_path / "score.mid"
    tw.write_midi(tw.Score([tw.Note(0.0, 0.05, note=45, force=1.0)]), path)
    return path


def call(*arguments: object) -> int:
    with pytest.raises(SystemExit) as exit_:
        run([str(a) for a in arguments])
    assert isinstance(exit_.value.code, int)
    return exit_.value.code


@pytest.mark.slow
def test_account_is_written_beside_the_same_sound(
    score: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    common = ("render", score, "-i", "monochord", "--max-duration", 0.06, "--json")
    plain, reported = tmp_path / "plain.wav", tmp_path / "reported.wav"
    files = [tmp_path / f"energy.{ending}" for ending in ("json", "csv", "png")]
    assert call(*common, "-o", plain) == 0
    assert json.loads(capsys.readouterr().out)["energy"] is None
    assert call(*common, "-o", reported, *(a for file in files for a in ("--energy", file))) == 0
    said = json.loads(capsys.readouterr().out)["energy"]
    account = json.loads(files[0].read_text())
    assert (sf.read(plain)[0] == sf.read(reported)[0]).all()
    assert said["peak_J"] == account["peak"] > 0
    assert said["worst_residual"] <= 1e-10
    assert len(files[1].read_text().splitlines()) == len(account["residual"]) + 1
    assert files[2].read_bytes().startswith(b"\x89PNG")


def test_a_name_that_says_no_format_is_refused_before_rendering(
    score: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert call("render", score, "-i", "monochord", "-o", tmp_path / "o.wav", "--energy", tmp_path / "e.txt") == 2
    err = capsys.readouterr().err
    assert err.count("\n") == 1
    assert ".json, .csv, .png" in err
    assert not (tmp_path / "o.wav").exists()
