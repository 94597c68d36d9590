"""Parts of one score on several instruments: the mix is the sum of its parts, wherever they are rendered."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mido
import numpy as np
import pytest

import tonewood as tw
from tonewood.errors import NothingPlayedError, OutputError, TonewoodError
from tonewood.performance.score.note import ScorePart
from tonewood.sound.ensemble.mix import (
    EnsemblePart,
    _to_file,
    by_programs,
    parse_part,
    placed,
    read_ensemble,
    render_ensemble,
)
from tonewood.sound.ensemble.programs import choose_players, read_programs


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
    twice = ("1=guitar@-3dB@-6dB", "1=guitar@pan0@pan1")
    for text in ("guitar", "0x=guitar", "1=guitar@loud", "1=guitar@pan", "1=", *twice):
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


@pytest.mark.slow
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


@pytest.mark.slow
def test_the_process_that_asked_warns_of_dropped_notes(duo: Path, capfd: pytest.CaptureFixture[str]) -> None:
    parts = [parse_part("1=electric_bass"), parse_part("1=electric_bass@pan0.5")]
    with pytest.warns(tw.DroppedNotesWarning, match="1 note cannot be played") as issued:
        render_ensemble(duo, parts, workers=2, reading={"transpose": 2}, fs=8000, max_duration=0.25)
    assert len(issued) == 2
    assert capfd.readouterr().err == ""


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="has no device without space")
def test_a_part_that_cannot_be_kept_is_one_line(duo: Path, tmp_path: Path) -> None:
    (tmp_path / "part.npy").symlink_to("/dev/full")
    options = tw.RenderOptions(fs=16000, max_duration=0.4)
    with pytest.raises(OutputError, match=r"part\.npy: the part cannot be kept until the mix: (No space|is the disk)"):
        _to_file(str(tmp_path / "part.npy"), str(duo), parse_part("4=monochord"), options, {})


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


def test_parts_that_no_instrument_was_chosen_for_go_by_their_programs(tmp_path: Path) -> None:
    """A table from General MIDI 1: 25 nylon guitar, 34 electric bass, 57 trumpet; channel 10 is percussion."""
    path = tmp_path / "band.mid"
    channels = {0: (24, 60), 1: (33, 33), 2: (56, 72), 3: (None, 60), 9: (0, 36)}
    save(path, [(channel, program, key, {}) for channel, (program, key) in channels.items()])
    score = tw.read_score(path)
    assert [(p.number, dict(p.programs), p.n_drums) for p in score.parts] == [
        (1, {25: 1}, 0), (2, {34: 1}, 0), (3, {57: 1}, 0), (4, {None: 1}, 0), (10, {}, 1),
    ]  # fmt: skip
    players, lines = choose_players(score.parts, read_programs())
    assert [(p.part, p.instrument) for p in players] == [
        (1, "classical_guitar"), (2, "electric_bass"), (4, "grand_piano"),
    ]  # fmt: skip
    assert lines == [
        "part 3: 1 note left out, no instrument plays program 57",
        "part 4 names no program: program 1, as General MIDI has it",
        "part 10: 1 note of percussion, left out",
    ]
    with pytest.raises(TonewoodError, match="no part has an instrument: part 3: 1 note left out"):
        choose_players(score.parts[2:3], read_programs(), path)
    assert [n.note for n in tw.read_score(path, tracks=[10]).notes] == [36]


def test_a_channel_that_changes_its_program_is_divided(tmp_path: Path) -> None:
    notes = [ScorePart(2, "Strings", programs={41: 3, 25: 2, 26: 1, None: 4})]
    players, lines = choose_players(notes, {1: "sitar", 25: "monochord", 26: "monochord"})
    assert [(p.instrument, p.programs) for p in players] == [("monochord", [25, 26]), ("sitar", [1])]
    assert "part 2 (Strings): 3 notes left out, no instrument plays program 41" in lines
    score = tw.Score([tw.Note(0.0, 0.2, note="A2"), tw.Note(0.2, 0.2, note="A2", program=25)])
    assert len(by_programs(score, [1]).notes) == len(by_programs(score, [25]).notes) == 1


def test_a_table_of_programs(tmp_path: Path) -> None:
    table = read_programs()
    assert (table[25], table[34], table.get(57), table.get(128)) == ("classical_guitar", "electric_bass", None, None)
    file = tmp_path / "table.yaml"
    file.write_text('programs: {"1-2": monochord, "9": null}\n', encoding="utf-8")
    assert read_programs(file) == {1: "monochord", 2: "monochord"}
    wrong = {
        '{"2-1": a}': "is no program", '{"129": a}': "is no program", "{guitar: a}": "is no program",
        '{"1-4": a, "3": b}': "program 3 stands there twice", "{}": "programs",
    }  # fmt: skip
    for text, reason in wrong.items():
        file.write_text(f"programs: {text}\n", encoding="utf-8")
        with pytest.raises(TonewoodError, match=reason):
            read_programs(file)


def test_volume_expression_and_pan_act_in_the_mix(tmp_path: Path) -> None:
    """General MIDI 2: 40 lg(value/127) dB, and a pan of 1 is left, 64 the middle, 127 right."""
    plain, mixed = tmp_path / "a.mid", tmp_path / "b.mid"
    save(plain, [(0, 0, 45, {})])
    save(mixed, [(0, 0, 45, {7: 64, 11: 100, 10: 127})])
    part, options = [parse_part("1=monochord")], {"fs": 16000, "max_duration": 0.3}
    (alone,), (low,) = (render_ensemble(p, part, workers=1, **options) for p in (plain, mixed))
    wanted = alone.samples[:, :1] * np.sqrt(2) * (64 / 127 * 100 / 127) ** 2
    assert np.allclose(low.samples, np.concatenate([0 * wanted, wanted], axis=1), atol=1e-12 * np.abs(wanted).max())
    assert low.summary.ignored == alone.summary.ignored
    out = placed(np.ones((400, 1)), part[0], [tw.Control(0.1, "cc7", 0.5), tw.Control(0.2, "cc7", 0.0)], 1000.0)
    assert out[[50, 150, 399], 0] == pytest.approx(np.sqrt(0.5) * np.array([1.0, 0.25, 0.0]))


def test_a_zone_of_mpe_is_one_part(tmp_path: Path) -> None:
    path = tmp_path / "mpe.mid"
    zone = [mido.Message("control_change", control=c, value=v) for c, v in ((101, 0), (100, 6), (6, 3))]
    save(path, [(1, None, 45, {}), (3, None, 57, {})], [*zone, mido.Message("program_change", program=25)])
    (part,) = tw.read_score(path).parts
    assert (part.number, part.channels, dict(part.programs)) == (1, (2, 4), {26: 2})
    (player,), lines = choose_players([part], {26: "steel_guitar"})
    assert (player.part, lines) == (1, [])
    (stem,) = render_ensemble(path, [player], workers=1, fs=8000, max_duration=0.1)
    assert stem.summary.notes == 2


def save(path: Path, channels: list[tuple[int, int | None, int, dict[int, int]]], head: Any = ()) -> None:
    """A MIDI file of one note a channel: (channel from 0, program from 0, key, controllers)."""
    file = mido.MidiFile()
    file.tracks.append(mido.MidiTrack(head))
    for channel, program, key, controllers in channels:
        track = mido.MidiTrack()
        if program is not None:
            track.append(mido.Message("program_change", channel=channel, program=program))
        for number, value in controllers.items():
            track.append(mido.Message("control_change", channel=channel, control=number, value=value))
        track.append(mido.Message("note_on", channel=channel, note=key, velocity=90))
        track.append(mido.Message("note_off", channel=channel, note=key, time=200))
        file.tracks.append(track)
    file.save(path)


def test_guitar_and_bass_of_one_guitar_pro_file(tmp_path: Path) -> None:
    """Programs choose them; the bass line stays on its four strings, an octave below the guitar's lowest."""
    import guitarpro as gp

    song = gp.Song(tempo=240)
    bass = gp.Track(song, number=2, name="Bass")
    bass.strings = [gp.GuitarString(i, note) for i, note in enumerate((43, 38, 33, 28), 1)]
    song.tracks.append(bass)
    for track, program in ((song.tracks[0], 24), (bass, 33)):
        track.channel = gp.MidiChannel(channel=track.number, effectChannel=track.number + 4, instrument=program)
        voice = track.measures[0].voices[0]
        for string in (1, 2, 3, 4):
            beat = gp.Beat(voice, status=gp.BeatStatus.normal)
            beat.notes.append(gp.Note(beat, value=3, string=string, type=gp.NoteType.normal))
            voice.beats.append(beat)
    gp.write(song, str(tmp_path / "duo.gp5"))
    music = tw.read_score(tmp_path / "duo.gp5")
    players, lines = choose_players(music.parts, read_programs(None), tmp_path / "duo.gp5")
    assert [(p.part, p.instrument) for p in players] == [(1, "classical_guitar"), (2, "electric_bass")]
    assert lines == []
    stems = render_ensemble(tmp_path / "duo.gp5", players, 8000, workers=1, max_duration=1.1)
    assert [(stem.summary.notes, list(stem.summary.notes_dropped)) for stem in stems] == [(4, []), (4, [])]
    last = stems[1].samples[6400:8800, 0]  # the third fret of the lowest string
    level, freq = np.abs(np.fft.rfft(last * np.hanning(2400), 1 << 15)), np.fft.rfftfreq(1 << 15, 1 / 8000)
    fundamental = 440.0 * 2 ** ((31 - 69) / 12)
    assert freq[np.argmax(level)] == pytest.approx(fundamental, rel=0.02)
