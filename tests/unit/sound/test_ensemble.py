"""Parts of one score on several instruments: the mix is the sum of its parts, wherever they are rendered."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import tonewood as tw
from tonewood.errors import NothingPlayedError, TonewoodError
from tonewood.sound.ensemble.mix import EnsemblePart, parse_part, placed, read_ensemble, render_ensemble


@pytest.fixture(scope="module")
def duo(tmp_path_factory: pytest.TempPathFactory) -> Path:
    notes = [tw.Note(0.1 * i, 0.1, note=60 + i, channel=0, velocity_midi=80) for i in range(3)]
    notes += [tw.Note(0.0, 0.3, note=45, channel=3, velocity_midi=90)]
    path = tmp_path_factory.mktemp("duo") / "duo.mid"
    tw.write_midi(tw.Score(notes), path)
    return path


def test_a_part_as_it_is_written() -> None:
    found = parse_part("2=electric_bass@-3dB@pan-0.3")
    assert (found.part, found.instrument, found.gain_db, found.pan) == (2, "electric_bass", -3.0, -0.3)
    assert parse_part(" 1=folder/my-guitar ").instrument == "folder/my-guitar"
    for text in ("guitar", "0x=guitar", "1=guitar@loud", "1=guitar@pan", "1="):
        with pytest.raises(TonewoodError, match=r"is not NUMBER=INSTRUMENT\[@GAINdB\]"):
            parse_part(text)
    with pytest.raises(TonewoodError, match=r"--part\.pan: is 3; at most 1"):
        parse_part("1=guitar@pan3")


def test_a_pan_has_constant_power_and_a_middle() -> None:
    mono, stereo = np.ones((1, 1)), np.array([[1.0, 0.5]])
    for pan in (-1.0, -0.3, 0.0, 0.8):
        assert np.sum(placed(mono, EnsemblePart(part=1, instrument="x", pan=pan)) ** 2) == pytest.approx(1.0)
    assert placed(mono, EnsemblePart(part=1, instrument="x", pan=-1.0)).tolist()[0] == pytest.approx([1.0, 0.0])
    assert placed(stereo, EnsemblePart(part=1, instrument="x")).tolist()[0] == pytest.approx([1.0, 0.5])
    louder = placed(stereo, EnsemblePart(part=1, instrument="x", gain_db=20.0))
    assert louder.tolist()[0] == pytest.approx([10.0, 5.0])


def test_stems_are_the_parts_alone(duo: Path) -> None:
    parts = [parse_part("1=classical_guitar@pan-1"), parse_part("4=monochord@-6dB")]
    options: dict[str, Any] = {"fs": 16000, "max_duration": 0.4}
    stems = render_ensemble(duo, parts, workers=1, **options)
    alone = tw.render(tw.read_score(duo, tracks=[4]), "monochord", **options).samples
    assert np.allclose(stems[1].samples[: len(alone)], alone * 10 ** (-0.3) * np.sqrt(0.5), rtol=1e-12)
    assert not stems[0].samples[:, 1].any() or np.abs(stems[0].samples[:, 1]).max() < 1e-15
    assert [len(s.samples) for s in stems] == [6400, 6400]
    assert [s.summary.notes for s in stems] == [3, 1]
    apart = render_ensemble(duo, parts, workers=2, **options)
    assert all(np.array_equal(a.samples, b.samples) for a, b in zip(stems, apart, strict=True))


def test_the_process_that_asked_warns_of_dropped_notes(duo: Path, capfd: pytest.CaptureFixture[str]) -> None:
    parts = [parse_part("1=electric_bass"), parse_part("1=electric_bass@pan0.5")]
    with pytest.warns(tw.DroppedNotesWarning, match="1 note cannot be played") as issued:
        render_ensemble(duo, parts, workers=2, reading={"transpose": 2}, fs=8000, max_duration=0.25)
    assert len(issued) == 2
    assert capfd.readouterr().err == ""


def test_wrong_parts_are_one_line(duo: Path, tmp_path: Path) -> None:
    file = tmp_path / "band.yaml"
    file.write_text("parts:\n  - {part: 1, instrument: monochord, gain: 3}\n", encoding="utf-8")
    with pytest.raises(TonewoodError, match=r"band.yaml.*parts\.0\.gain"):
        read_ensemble(file)
    file.write_text(
        "parts:\n  - {part: 1, instrument: monochord, gain_db: 3, set: {strings.string.note: C3}}\n", encoding="utf-8"
    )
    assert read_ensemble(file)[0].set == {"strings.string.note": "C3"}
    with pytest.raises(TonewoodError, match="there is no channel 2"):
        render_ensemble(duo, [parse_part("2=monochord")], workers=1)
    with pytest.raises(NothingPlayedError, match="part 1 on clavichord"):
        render_ensemble(duo, [parse_part("1=clavichord")], workers=1)
    with pytest.raises(TonewoodError, match="lead_in: is auto"):
        render_ensemble(duo, [parse_part("1=monochord")], lead_in="auto")
