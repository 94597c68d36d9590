"""Distances between folders of notes of known difference, and the command."""

from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np
import pytest
import soundfile as sf
from estimate_sounds import FS, partials

from cli_runs import refused
from tonewood.cli.main import run

RATES = np.full(25, 3.0)
#: recordings of the FreePats Spanish guitar
NOTES = Path(os.environ.get("TONEWOOD_NOTES", Path(__file__).parents[5] / "shared/listening/recordings"))


def write(folder, notes, rates, *, ending="wav") -> None:
    folder.mkdir(exist_ok=True)
    for note in notes:
        x, _ = partials(440 * 2 ** ((note - 69) / 12), 1e-4, rates, seconds=1.4)
        sf.write(folder / f"{note}{ending}", x, FS)


@pytest.mark.slow
def test_the_command_tells_the_distance_and_the_scatter(tmp_path, monkeypatch, capsys) -> None:
    monkeypatch.chdir(tmp_path)
    write(tmp_path / "a", (57, 58), RATES, ending=".wav")
    write(tmp_path / "b", (57, 60), 1.4 * RATES, ending=".wav")
    with pytest.raises(SystemExit) as ended:
        run(["distance", "a", "b", "--json"])
    assert ended.value.code == 0
    report = json.loads(capsys.readouterr().out)
    assert report["notes"] == [57]
    assert report["distances"]["A to B"]["decays"] == pytest.approx(1.4, rel=0.03)
    assert report["distances"]["next semitone, A"]["decays"] == pytest.approx(1.0, abs=0.02)
    assert "strokes of one note, A" not in report["distances"]
    with pytest.raises(SystemExit):
        run(["distance", "a", "a"])
    assert " 0.00" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("b", "said"), [("empty", "holds no sound files"), ("c", "no note in common"), ("banjo", "banjo")]
)
def test_what_cannot_be_compared_is_one_line(tmp_path, monkeypatch, capsys, b: str, said: str) -> None:
    monkeypatch.chdir(tmp_path)
    write(tmp_path / "a", (57,), RATES, ending=".wav")
    write(tmp_path / "c", (64,), RATES, ending=".wav")
    (tmp_path / "empty").mkdir()
    with pytest.raises(SystemExit) as ended:
        run(["distance", "a", b])
    out, err = capsys.readouterr()
    refused((ended.value.code, out, err), said)


@pytest.mark.validate
@pytest.mark.skipif(not NOTES.is_dir(), reason="the recordings are not here")
def test_the_estimated_guitar_is_nearer_to_its_recordings_than_their_next_semitones(capsys) -> None:
    rows = {}
    for name in ("spanish_guitar", "classical_guitar"):
        with pytest.raises(SystemExit):
            run(["distance", str(NOTES), name, "--json"])
        rows[name] = json.loads(capsys.readouterr().out)["distances"]
    estimated, begun = (rows[name]["A to B"] for name in rows)
    scatter = rows["spanish_guitar"]["next semitone, A"]
    assert estimated["decays"] < 1.30 < 1.4 < begun["decays"]
    for row in ("third_octaves", "onset", "decays", "early_decays", "levels"):
        assert estimated[row] < scatter[row] < begun[row], row
