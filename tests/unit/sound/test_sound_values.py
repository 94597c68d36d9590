"""Parts of the way from steps to a file: filters, rooms, levels, mixes, plans, keys; closed forms and by hand."""

from __future__ import annotations

import json
import math
import os
import select
from collections import Counter
from fractions import Fraction
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import tonewood as tw
from tonewood.errors import BundleError, OutputError, TonewoodError
from tonewood.instrument.bundle.schema import Preset
from tonewood.instrument.model.output_assembly import OutputGroup
from tonewood.performance.effects.usage import EffectUsage
from tonewood.performance.player.timeline import GRID, Change, Timeline
from tonewood.performance.score.note import Control, ScorePart
from tonewood.sound import equalizer, room
from tonewood.sound.ensemble.mix import GLIDE, EnsemblePart, _course, by_programs, parse_part, placed
from tonewood.sound.ensemble.programs import choose_players, read_programs
from tonewood.sound.files.audio import Audio, SoundWriter, decibels, file_format, flac_bytes
from tonewood.sound.files.tags import Tags
from tonewood.sound.level.limiter import Limiter
from tonewood.sound.level.loudness import resampled
from tonewood.sound.level.spectrum import SILENCE_DB, level_curve, spectrogram
from tonewood.sound.live import keyboard
from tonewood.sound.live.keyboard import HELD, ComputerKeyboard
from tonewood.sound.live.receiver import MidiReceiver
from tonewood.sound.live.stream import Arrivals, AudioStream
from tonewood.sound.live.take import Replay
from tonewood.sound.render import energy, level
from tonewood.sound.render import plan as plan_module
from tonewood.sound.render.accuracy import LEVELS
from tonewood.sound.render.options import RenderOptions, choices, limits
from tonewood.sound.render.plan import (
    Plan,
    Spent,
    SwitchedRate,
    _beginning,
    _computing,
    bends_by_point,
    predicted,
)  # fmt: skip
from tonewood.sound.render.presets import with_preset
from tonewood.sound.render.renderer import _TICKS, _WINDOW, Renderer, silence
from tonewood.sound.render.resampling import Resampler
from tonewood.sound.render.routing import columns_of


@pytest.mark.parametrize("band", [(2500.0, 9.0, None), (2500.0, -9.0, None), (700.0, 9.0, 2.0), (700.0, -12.0, 0.5)])
def test_digital_bands_are_the_analogue_ones_at_mapped_frequencies(band: equalizer.Band) -> None:
    """H(z) at f is H(s) at s = i tan(pi f / fs) / tan(pi f0 / fs) re the middle."""
    fs, freq = 16000.0, np.array([50.0, 300.0, 700.0, 2500.0, 5000.0, 7900.0])
    b0, b1, b2, a0, a1, a2 = equalizer.section(band, fs)
    z = np.exp(-2j * np.pi * freq / fs)
    found = 20 * np.log10(np.abs((b0 + b1 * z + b2 * z * z) / (a0 + a1 * z + a2 * z * z)))
    mapped = band[0] * np.tan(np.pi * freq / fs) / math.tan(math.pi * band[0] / fs)
    assert found == pytest.approx(equalizer.response_db([band], mapped), abs=1e-9)
    assert equalizer.response_db([band, band], freq) == pytest.approx(2 * equalizer.response_db([band], freq))


def test_a_bell_has_half_of_its_decibels_where_its_quality_says() -> None:
    """|H|^2 = (x^2 + g/q^2) / (x^2 + 1/(g q^2)) with x = f/f0 - f0/f: half the decibels at x = 1/q."""
    q, gain = 3.0, 8.0
    edge = 1000.0 * (1 / (2 * q) + math.sqrt(1 / (4 * q * q) + 1))
    assert equalizer.response_db([(1000.0, gain, q)], np.array([edge, 1e6 / edge])) == pytest.approx(
        [gain / 2] * 2, abs=1e-9
    )


def test_bands_out_of_reach_are_left_out() -> None:
    assert not equalizer.Equalizer([[(0.49 * 8000, 6.0, None)], []], 8000.0)
    assert equalizer.Equalizer([[(0.4899 * 8000, 6.0, None)], []], 8000.0)
    sound = np.ones((4, 2))
    assert equalizer.Equalizer([[], []], 8000.0)(sound) is sound


def test_microphones_stand_side_by_side_across_their_distance() -> None:
    box = room.Box((10.0, 8.0, 3.0), 0.5, (2.0, 3.0, 1.0), (3.0, 4.0, 0.0), 1.0)
    left, right = box.places(5.0, 2).T
    assert left + right == pytest.approx(2 * np.array([2.0 + 3.0, 3.0 + 4.0, 1.0]))
    # the first microphone is the left one of a listener who faces the instrument
    assert left - right == pytest.approx(0.3 * np.array([0.8, -0.6, 0.0]))
    (alone,) = box.places(5.0, 1).T
    assert alone == pytest.approx([5.0, 7.0, 1.0])
    assert box.places(1.0, 3).shape == (3, 3)


def test_reverberation_is_what_comes_after_the_direct_sound() -> None:
    """A pulse of 1, one of 1/2 at 2 ms is partly direct, one of 1/4 at 10 ms is late: dB by hand, and with a gain."""
    fs = 16000
    response = np.zeros((400, 2))
    response[8], response[8 + 160] = 1.0, 0.25
    assert room.reverberation_db(response, fs) == pytest.approx(20 * math.log10(0.25))
    share = room._after_direct(response, fs, 0.1)
    assert share[8 + 16].tolist() == [1.0, 1.0]  # 1 ms
    assert share[8 + 40] == pytest.approx([0.1, 0.1])  # 2.5 ms
    assert share[8 + 28] == pytest.approx([0.55, 0.55])  # half way
    assert share[0].tolist() == [1.0, 1.0]
    begun = room._begun(np.concatenate([np.zeros((92, 2)), response * [2.0, 1.0]]), fs)
    assert np.abs(begun).argmax(axis=0).tolist() == [8, 8]  # half a millisecond
    assert begun.max(axis=0).tolist() == [1.0, 0.5]
    assert room._begun(np.eye(3, 1), fs)[0] == 1.0


def test_levels_of_intervals_by_hand() -> None:
    samples = np.concatenate([np.full((20, 2), 0.1), np.full((20, 2), 1.0), np.zeros((20, 2)), np.ones((19, 2))])
    time, found = level_curve(samples, 1000.0)
    assert time == pytest.approx([0.01, 0.03, 0.05])
    assert found == pytest.approx([-20.0, 0.0, SILENCE_DB])
    time, found = level_curve(np.full((10, 1), 0.1), 1000.0)
    assert (time.tolist(), found.tolist()) == ([0.01], [pytest.approx(-20.0 + 10 * math.log10(0.5))])
    assert len(level_curve(samples, 1000.0, interval=1e-9)[0]) == 79


def test_a_spectrogram_shows_a_sine_in_its_bin_at_its_time() -> None:
    fs, window = 8000.0, 512
    t = np.arange(4000) / fs
    sine = 0.5 * np.sin(2 * np.pi * 1000.0 * t)
    time, freq, found = spectrogram(np.stack([sine, sine], axis=1), fs, window=window, columns=9, freq_upper=2000.0)
    assert found.shape == (freq.size, time.size) == (129, 9)
    assert (time[0], time[-1]) == (0.0, (4000 - 256) / fs)
    assert freq[found[:, 4].argmax()] == 1000.0
    assert found[:, 4].max() == pytest.approx(20 * math.log10(0.5), abs=0.02)
    assert found[:, 0].max() == pytest.approx(20 * math.log10(0.25), abs=0.1)  # half of the window is before the sound
    opposite = spectrogram(np.stack([sine, -sine], axis=1), fs, window=window)[2]
    assert opposite.max() == SILENCE_DB
    assert spectrogram(sine[:, None], fs, window=window, freq_upper=1.0)[1].size == 2
    assert spectrogram(np.zeros((3, 1)), fs, window=window)[0].tolist() == [0.0, pytest.approx(1 / fs)]


@pytest.mark.parametrize(("p", "q"), [(1, 2), (3, 2), (2, 1), (5, 4)])
def test_a_resampler_is_a_sum_over_samples_in_any_pieces(p: int, q: int) -> None:
    """A slow sine keeps its values at the times of the frames; frames come out as `frame` counts them."""
    n, ratio = 1200, Fraction(p, q)
    x = np.sin(2 * np.pi * 0.02 * np.arange(n) / max(1.0, p / q) + 0.3)[:, None]
    run, pieces, at = Resampler(ratio, 1), [], 0
    for size in (1, 100, 7, n - 108):
        piece = run(x[at : at + size], at)
        assert len(piece) == run.frame(at + size) - run.frame(at)
        pieces.append(piece)
        at += size
    whole = Resampler(ratio, 1)(x, 0)
    np.testing.assert_array_equal(np.concatenate(pieces), whole)
    first = Resampler(ratio, 1).frame(0)
    frames = first + np.arange(len(whole))
    inside = (frames * p / q > 150) & (frames * p / q < n - 150)
    expected = np.sin(2 * np.pi * 0.02 * frames * p / q / max(1.0, p / q) + 0.3)
    np.testing.assert_allclose(whole[inside, 0], expected[inside], atol=1e-4)
    assert inside.sum() > 300
    assert Resampler(ratio, 1).samples(10.0) == 10.0 * p / q
    plain = Resampler(Fraction(1), 2)
    assert (plain.frame(17), plain(x, 0) is x) == (17, True)


def test_a_sound_at_another_rate_keeps_its_wave_and_length() -> None:
    t = np.arange(4410) / 44100
    found = resampled(np.sin(2 * np.pi * 440 * t)[:, None], 44100, 48000)
    assert len(found) == 4800
    np.testing.assert_allclose(
        found[400:-400, 0], np.sin(2 * np.pi * 440 * np.arange(4800) / 48000)[400:-400], atol=1e-4
    )
    same = np.ones((3, 1))
    assert resampled(same, 44100, 44100) is same


def test_columns_of_groups_alone_and_in_a_room() -> None:
    groups: Any = [SimpleNamespace(channels=c) for c in (("a",), ("b", "c"), ("d",))]
    assert columns_of(groups, in_room=False) == [[0], [1, 2], [3]]
    assert columns_of(groups, in_room=True) == [[0, 0], [1, 2], [3, 3]]


def test_a_controller_glides_to_its_values() -> None:
    """At 1 kHz, from its first value; a change within a glide begins after it; before 0 s it is there at once."""
    fs = 1000.0
    course = _course([Control(0.02, "cc7", 0.5), Control(0.1, "cc7", 0.25)], 120, fs, 1.0)
    wanted = {0: 1.0, 20: 1.0, 25: 0.75, 30: 0.5, 100: 0.5, 105: 0.375, 110: 0.25, 119: 0.25}
    assert {i: course[i] for i in wanted} == pytest.approx(wanted)
    assert GLIDE == 0.01
    near = _course([Control(0.02, "cc7", 0.5), Control(0.025, "cc7", 0.0)], 60, fs, 1.0)
    assert [near[i] for i in (30, 35, 40)] == pytest.approx([0.5, 0.25, 0.0])
    early = _course([Control(0.0, "cc7", 0.1), Control(0.0, "cc7", 0.5)], 3, fs, 1.0)
    assert early.tolist() == [0.5] * 3


def test_volume_and_pan_of_a_part_in_the_mix() -> None:
    part = EnsemblePart(part=1, instrument="x", gain_db=-20.0, pan=0.5)
    mono, stereo = np.ones((50, 1)), np.ones((50, 2))
    angle = math.pi * 1.5 / 4
    assert placed(mono, part)[0] == pytest.approx([0.1 * math.cos(angle), 0.1 * math.sin(angle)])
    assert placed(stereo, part)[0] == pytest.approx([0.1 * 2**0.5 * math.cos(angle), 0.1 * 2**0.5 * math.sin(angle)])
    # cc10 = 127 is a pan of 1, 0 and 1 of -1, 64 of 0; the sum with the part's own stays within -1 to 1
    for value, own, pan in (
        (127, 0.0, 1.0),
        (64, 0.0, 0.0),
        (1, 0.0, -1.0),
        (0, 0.0, -1.0),
        (95.5, -0.25, 0.25),
        (127, 0.5, 1.0),
    ):
        at = EnsemblePart(part=1, instrument="x", pan=own)
        angle = math.pi * (1 + pan) / 4
        found = placed(mono, at, [Control(0.0, "cc10", value / 127)], 1000.0)[0]
        assert found == pytest.approx([math.cos(angle), math.sin(angle)], abs=1e-9)
        both = placed(stereo, at, [Control(0.0, "cc10", value / 127)], 1000.0)[0]
        assert both == pytest.approx([2**0.5 * math.cos(angle), 2**0.5 * math.sin(angle)], abs=1e-9)
    controls = [Control(0.0, "cc7", 0.5), Control(0.0, "cc11", 0.5), Control(0.0, "cc1", 0.1)]
    assert placed(stereo, EnsemblePart(part=1, instrument="x"), controls, 1000.0)[0] == pytest.approx([0.0625] * 2)


@pytest.mark.parametrize(
    ("text", "values"),
    [
        ("2=bass", (2, "bass", 0.0, 0.0)), (" 12=a b @ -3 dB @pan-0.3", (12, "a b", -3.0, -0.3)),
        ("1=x@pan 1@+2.5dB", (1, "x", 2.5, 1.0)),
    ],
)  # fmt: skip
def test_parts_on_the_command_line(text: str, values: tuple[int, str, float, float]) -> None:
    part = parse_part(text)
    assert (part.part, part.instrument, part.gain_db, part.pan) == values
    for wrong in ("bass", "1=", "1=x@3", "1=x@pan", "=x", "1=x@3dB@loud"):
        with pytest.raises(TonewoodError, match="is not NUMBER=INSTRUMENT"):
            parse_part(wrong)


def test_notes_of_some_programs() -> None:
    notes = [tw.Note(0.0, note=60, program=p) for p in (None, 1, 25, 26)]
    assert [n.program for n in by_programs(tw.Score(notes), [1, 26]).notes] == [None, 1, 26]
    score = tw.Score(notes)
    assert by_programs(score, None) is score


def test_a_table_of_programs_by_hand(tmp_path: Path) -> None:
    file = tmp_path / "p.yaml"
    file.write_text('programs: {"1": a, "25-27": b, "128": null}')
    assert read_programs(file) == {1: "a", 25: "b", 26: "b", 27: "b"}
    for text, said in (('"0": a', "is no program"), ('"5-4": a', "is no program"), ('"129": a', "is no program"),
                       ('"1-3": a, "3": b', "program 3 stands there twice")):  # fmt: skip
        file.write_text(f"programs: {{{text}}}")
        with pytest.raises(BundleError, match=said):
            read_programs(file)
    parts = [
        ScorePart(1, "lead", programs={25: 3, 1: 2}), ScorePart(2, programs={None: 4}),
        ScorePart(3, programs={99: 1, 98: 2}), ScorePart(10, n_drums=7), ScorePart(4, programs={26: 1, 27: 1}),
    ]  # fmt: skip
    players, lines = choose_players(parts, {1: "a", 25: "b", 26: "b", 27: "b"})
    assert [(p.part, p.instrument, p.programs) for p in players] == [
        (1, "b", [25]), (1, "a", [1]), (2, "a", [1]), (4, "b", [26, 27]),
    ]  # fmt: skip
    assert lines == [
        "part 2 names no program: program 1, as General MIDI has it",
        "part 3: 3 notes left out, no instrument plays program 98, 99", "part 10: 7 notes of percussion, left out",
    ]  # fmt: skip
    with pytest.raises(
        TonewoodError, match="no part has an instrument: part 10: 7 notes of percussion, left out; choose"
    ):
        choose_players(parts[3:4], {})


@pytest.mark.parametrize(
    ("name", "subtype", "size", "found"),
    [
        ("a.wav", None, 0.0, ("WAV", "PCM_24")), ("a.WAV", "float", 0.0, ("WAV", "FLOAT")),
        ("a.wav", "PCM_16", 2e9, ("WAV", "PCM_16")), ("a.wav", "PCM_16", 2e9 + 1, ("RF64", "PCM_16")),
        ("a.wav", None, 4e9 / 3, ("WAV", "PCM_24")), ("a.wav", None, 4e9 / 3 + 1, ("RF64", "PCM_24")),
        ("a.wav", "DOUBLE", 5e8 + 1, ("RF64", "DOUBLE")), ("a.flac", None, 1e12, ("FLAC", "PCM_24")),
        ("a.rf64", "PCM_32", 0.0, ("RF64", "PCM_32")),
    ],
)  # fmt: skip
def test_formats_of_files(name: str, subtype: str | None, size: float, found: tuple[str, str]) -> None:
    assert file_format(name, subtype, size) == found
    for wrong, said in (("a.aiff", "suffix '.aiff' is none of"), ("a.flac", "FLAC has no subtype FLOAT")):
        with pytest.raises(OutputError, match=said):
            file_format(wrong, "FLOAT")


def test_a_sound_in_memory_shows_its_level(tmp_path: Path) -> None:
    audio = Audio(np.array([[0.5, -2.0], [0.25, 1.0]]), 1000, ("left", "right"))
    assert (audio.duration, audio.peak_dbfs) == (0.002, pytest.approx(20 * math.log10(2)))
    assert repr(audio) == "Audio(2 samples x 2, 0.002 s at 1000 Hz, peak 6.0 dBFS)"
    text = audio._repr_html_()
    assert "left, right, 0.00 s at 1000 Hz, peak 6.0 dBFS, played -6.0 dB" in text
    assert "played" not in Audio(0.5 * audio.samples, 1000)._repr_html_()
    assert "2 channels" in Audio(0.5 * audio.samples, 1000)._repr_html_()
    assert (decibels(0.1), decibels(0.0)) == (pytest.approx(-20.0), -math.inf)
    assert flac_bytes(audio.samples, 8000)[:4] == b"fLaC"
    assert Audio(np.zeros((0, 1)), 1000).peak_dbfs == -math.inf
    with SoundWriter(tmp_path / "a.wav", 8000, 2, "FLOAT") as writer:
        writer.write(audio.samples)
        writer.write(0.1 * audio.samples)
    assert (writer.clipped, writer.frames, writer.peak, writer.keeps_peaks) == (1, 4, 2.0, True)
    with pytest.warns(UserWarning, match=r"a\.wav: 1 samples were clipped, the peak is \+6\.0 dBFS"):
        assert audio.save(tmp_path / "a.wav") == 1
    with pytest.warns(UserWarning, match="1 samples lie beyond full scale"):
        audio.save(tmp_path / "a.wav", "DOUBLE")


def test_pictures_show_the_sound() -> None:
    t = np.arange(8000) / 8000
    audio = Audio(0.5 * np.sin(2 * np.pi * 1000 * t)[:, None], 8000)
    (axes,) = audio.plot_decay(range_db=60.0).axes
    (line,) = axes.lines
    assert line.get_xdata() == pytest.approx((np.arange(50) + 0.5) * 0.02)
    assert line.get_ydata() == pytest.approx(np.full(50, 20 * math.log10(0.5) - 10 * math.log10(2)), abs=1e-6)
    top = float(max(line.get_ydata()))
    assert axes.get_ylim() == pytest.approx((top - 60.0, top + 5.0))
    shown = audio.spectrogram(freq_upper=9000.0, range_db=70.0, window=256).axes[0]
    (image,) = shown.images
    assert image.get_extent()[2:] == [0.0, 4.0]
    assert image.get_clim() == (-70.0, 0.0)
    levels = np.asarray(image.get_array())
    assert levels.max() == 0.0
    assert levels[:, levels.shape[1] // 2].argmax() == 32  # 1 kHz of 4 in 128 bins
    (image,) = audio.spectrogram(freq_upper=2000.0, window=256).axes[0].images
    assert image.get_extent()[2:] == [0.0, 2.0]


def test_tags_of_instruments_stand_once() -> None:
    def instrument(title: str, name: str, licence: str) -> Any:
        return SimpleNamespace(spec=SimpleNamespace(title=title, name=name, licence=licence))

    players = [instrument("A", "a", "L"), instrument("", "b", ""), instrument("A", "c", "M")]
    tags = Tags.of(tw.Score([], metadata={"title": "T", "composer": "C"}), players)
    assert (tags.title, tags.composer, tags.instrument, tags.licence) == ("T", "C", "A, b", "L, M")
    assert Tags.of(None, []).title == ""


def test_accuracies_multiply_the_bundle_s_own_steps() -> None:
    bundle: Any = SimpleNamespace(draft_oversampling=0.5, oversampling=2)
    assert {name: one.oversampling(bundle) for name, one in LEVELS.items()} == {
        "draft": 1,
        "standard": 2,
        "reference": 8,
    }


def test_presets_fill_in_what_is_not_given() -> None:
    spec: Any = SimpleNamespace(
        presets={"own": Preset(outputs=["a"], room_mix_db=-3.0, humanize=7), "dry": Preset(room="hall")}
    )
    own = with_preset(RenderOptions(preset="own", humanize=2), spec)
    assert (own.preset, own.outputs, own.room_mix_db, own.humanize, own.noises) == (None, ("a",), -3.0, 2, None)
    assert with_preset(RenderOptions(preset="dry"), spec).room == "hall"
    stage = with_preset(RenderOptions(preset="stage"), spec)
    assert (stage.room, stage.humanize, stage.noises) == ("hall", 1, True)
    plain = RenderOptions()
    assert with_preset(plain, spec) is plain
    with pytest.raises(TonewoodError, match="preset: is 'x'; dry, studio, stage, own are allowed"):
        with_preset(RenderOptions(preset="x"), spec)


def test_options_have_limits_and_words() -> None:
    fields = RenderOptions.model_fields
    assert limits(fields["fs"]) == (8000.0, 768000.0)
    assert limits(fields["preset"]) is None
    assert choices(fields["accuracy"].annotation) == ["draft", "standard", "reference"]
    given = RenderOptions(effects=" a, b ,", budget_db=-50.0)
    assert given.effect_changes == {"effects.mode": ["a", "b"], "effects.budget_db": -50.0}
    assert RenderOptions().effect_changes == {}
    for value in (0.25, 16.0, 1.75):
        assert RenderOptions(oversampling=value).oversampling == value
    for value in (0.2, 1.1, 16.25):
        with pytest.raises(TonewoodError, match=r"0\.25 to 16"):
            RenderOptions(oversampling=value)


def test_a_preview_has_the_two_loudest_seconds(monkeypatch: pytest.MonkeyPatch) -> None:
    """Sums of squares of forces from each note on; the gain leaves 3 dB below -1 dBFS."""
    heard: list[Any] = []

    class Stub:
        def __init__(self, score: tw.Score, instrument: object, *, options: RenderOptions):
            heard.append((score, options))

        def blocks(self, size: int) -> list[np.ndarray]:
            return [np.array([[0.1], [-0.5]]), np.array([[0.25]])]

    monkeypatch.setattr(level, "Renderer", Stub)
    instrument: Any = SimpleNamespace(
        spec=SimpleNamespace(playing=SimpleNamespace(velocity=SimpleNamespace(value=lambda v: v / 64.0)))
    )
    forces = [(0.0, 3.0), (1.0, 1.0), (4.0, 2.5), (5.9, 2.5), (6.0, 2.9), (9.0, None)]
    score = tw.Score(
        [tw.Note(t, note=60, force=f) for t, f in forces],
        [Control(1.0, "cc1", 0.5), Control(5.95, "cc1", 1.0), Control(6.0, "cc1", 0.0)],
    )
    gain = level.preview_gain(score, instrument, RenderOptions(gain_db=5.0))
    assert gain == pytest.approx(-1.0 - 3.0 - 20 * math.log10(0.5))
    ((part, options),) = heard
    # 2.5^2 + 2.9^2 from 5.9 s on is more than 3^2 + 1 from 0 s on; 4.0 s has 12.5
    assert [(n.time, n.force) for n in part.notes] == [(0.0, 2.5), (pytest.approx(0.1), 2.9)]
    assert [(c.time, c.value) for c in part.controls] == [
        (0.0, 0.5),
        (pytest.approx(0.05), 1.0),
        (pytest.approx(0.1), 0.0),
    ]
    assert (options.effects, options.max_duration, options.gain_db, options.lead_in) == ("none", 2.0, 0.0, 0.0)
    assert level.preview_gain(tw.Score([]), instrument, RenderOptions()) == 0.0


def test_times_of_a_plan_by_hand() -> None:
    """Steps and control in proportion to a sketch; rates of effects from three timings."""
    assert predicted(Spent(2.0, 1.0), 0.5, Spent(0.5, 0.25), Spent(3.0, 5.0)) == pytest.approx(
        1.5 / 0.5 * 3.0 + 4.0 * 5.0
    )
    assert predicted(Spent(0.2, 1.0), 0.5, Spent(0.5, 0.0), Spent(3.0, 5.0)) == 5.0
    assert predicted(Spent(), 0.0, Spent(), Spent(3.0, 5.0)) == 8.0
    assert Spent(2.0, 3.0).times(2.0, 3.0) == Spent(4.0, 9.0)
    assert SwitchedRate.fitted(1.0, 4.0, 10.0, (2.0, 5.0)) == SwitchedRate(0.0, 2.0)
    assert SwitchedRate.fitted(1.0, 7.0, 10.0, (2.0, 5.0)) == SwitchedRate(4.0, 1.0)
    assert SwitchedRate.fitted(1.0, 9.0, 5.0, (2.0, 2.0)) == SwitchedRate(0.0, 2.0)
    assert SwitchedRate.fitted(1.0, 9.0, 5.0, (0.0, 0.0)) == SwitchedRate(0.0, 4.0)
    assert SwitchedRate.fitted(5.0, 9.0, 4.0, (1.0, 3.0)) == SwitchedRate(4.0, 0.0)
    usage = EffectUsage(100.0, {"e": {"a": 2.0, "b": 3.0}}, {"e": 1.0})
    usage.count(0, 50, {"e": {"a"}}, 1, 0.0)
    usage.count(50, 50, {"e": ()}, 1, 0.0)
    found = _computing({"e": SwitchedRate(0.1, 0.01)}, usage)
    assert found == {("e", "a"): pytest.approx(50 * 2.0 * 0.01 + 50 * 0.1 / 2), ("e", "b"): pytest.approx(50 * 0.1 / 2)}
    assert (Plan((), 1.0, 2.0, 3.0).bends, Plan((), 1.0, 2.0, 3.0).sketched_s) == (0, 0.0)


def test_points_with_bends_and_beginnings_of_long_scores() -> None:
    fs = 6400.0
    changes = [
        Change(0.0, "a", cents=1.0), Change(0.0099, "b", cents=2.0), Change(0.01, "a", cents=3.0),
        Change(0.02, "a", stop=2.0, cents=1.0), Change(0.03, "a", added_damping=1.0),
    ]  # fmt: skip
    assert {k: [c.cents for c in v] for k, v in bends_by_point(Timeline(changes, ()), fs).items()} == {
        0: [1.0, 2.0],
        1: [3.0],
    }
    assert GRID / fs == 0.01
    few = tw.Score([tw.Note(0.01 * i, note=60) for i in range(1500)])
    assert _beginning(few) == (few, math.inf)
    many = tw.Score(
        [tw.Note(0.01 * i, note=60) for i in range(1501)], [Control(14.99, "cc1", 0.5), Control(15.0, "cc1", 0.1)]
    )
    part, until = _beginning(many)
    assert (len(part.notes), until, len(part.controls)) == (1500, 15.0, 1)
    quick = tw.Score([tw.Note(0.0001 * i, note=60) for i in range(1600)])
    part, until = _beginning(quick)
    assert (len(part.notes), until) == (1500, 1.0)
    moves = tw.Score(
        [tw.Note(0.0, note=60), tw.Note(20.0, note=60)], [Control(0.005 * i, "cc64", 0.5) for i in range(3001)]
    )
    part, until = _beginning(moves)
    assert ([n.time for n in part.notes], until, len(part.controls)) == ([0.0], 15.0, 3000)


def test_the_computer_s_keys_are_two_octaves() -> None:
    now, typed = [0.0], [""]
    keys = ComputerKeyboard(41.0, lambda: typed[0], lambda: now[0])

    def poll(text: str, time: float) -> list[list[int]]:
        typed[0], now[0] = text, time
        return [message for _, message in keys.poll()]

    assert keys.base == 36
    assert poll("zMQ", 0.0) == [[0x90, 36, 90], [0x90, 47, 90], [0x90, 48, 90]]
    assert poll("z", 0.05) == []  # a key that is held repeats
    assert poll("", 0.59) == []
    assert poll("", HELD) == [[0x80, 47, 0], [0x80, 48, 0]]
    assert poll("", HELD + 0.05) == [[0x80, 36, 0]]
    assert poll("]=z", 1.0) == [[0x90, 48, 100]]
    assert poll("[[-z", 2.0)[:1] == [[0x90, 24, 90]]
    assert poll(" ", 2.1) == [[0xB0, 120, 0]]
    assert poll("", 9.0) == []
    poll("[" * 9 + "-" * 20, 9.0)
    assert (keys.base, keys.velocity) == (0, 10)
    poll("]" * 20 + "=" * 20, 9.0)
    assert (keys.base, keys.velocity) == (108, 127)
    assert poll("q", 9.1) == [[0x90, 120, 127]]
    assert poll("p", 9.1) == []  # beyond the last note of MIDI
    assert not keys.ended
    poll("\x1b", 9.2)
    assert keys.ended


def test_arrivals_that_have_waited_too_long_keep_their_distances() -> None:
    now = [0.0]
    arrivals = Arrivals[str](1000, 100, lambda: now[0])
    arrivals.add(0.0, "a")
    now[0] = 0.05
    assert list(arrivals.due(0)) == ["a"]  # within the patience: at once
    for time, name in ((1.0, "b"), (1.148, "c"), (1.15, "d"), (1.355, "e")):
        arrivals.add(time, name)
    now[0] = 1.051
    assert list(arrivals.due(500)) == ["b", "c"]  # 100 frames, and those after the first 51 count twice: 149
    assert list(arrivals.due(600)) == ["d"]  # 349
    assert list(arrivals.due(700)) == ["e"]
    arrivals.add(5.0, "f")
    assert list(arrivals.rest()) == ["f"]
    for ahead, size in ((0, 64), (4097, 64), (1, 0), (1, (1 << 20) + 1)):
        with pytest.raises(TonewoodError, match="are allowed"):
            AudioStream([], size, ahead=ahead, fs=8000, n_channels=1)
    with pytest.raises(TypeError, match="fs and n_channels"):
        AudioStream([], 64)


def test_a_limiter_by_its_recurrences() -> None:
    """r, m, g and the mean of g as the module states them, sample by sample."""
    rng = np.random.default_rng(5)
    x = rng.normal(size=(600, 2)) * np.where(rng.uniform(size=(600, 1)) < 0.03, 4.0, 0.2)
    fs, L, release, ceiling = 1000.0, 5, 60.0, -1.0
    found = np.concatenate(list(Limiter(1000, ceiling_db=ceiling, look_ahead=0.005, release_db_s=release).process([x])))
    r = [min(0.0, ceiling - 20 * math.log10(max(abs(a), abs(b)))) for a, b in x.tolist()]
    m = [min(r[n : n + L + 1]) for n in range(600)]
    g: list[float] = []
    for value in m:
        g.append(min(value, (g[-1] if g else 0.0) + release / fs))
    mean = [np.mean([g[k] if k >= 0 else 0.0 for k in range(n - L, n + 1)]) for n in range(600)]
    late = max(abs(found[n, 0] - x[n, 0] * 10 ** (mean[n] / 20)) for n in range(L, 590))
    assert late < 1e-9


def test_gains_of_groups_and_silent_sounds() -> None:
    assert silence(0.0, ended=False) == []
    assert silence(0.5, ended=True) == []
    assert silence(0.0, ended=True) == ["the sound is silent: its peak is -inf dBFS"]
    group = OutputGroup("g", ("a",), (0,), "velocity", "m/s", 2.0, "", 6.0206)
    assert level.meaning([group], 0.0) == "gain +0.0 dB, 0 dBFS is 1 m/s"


@pytest.mark.parametrize("step", [None, [0.0, 0.0], [1.0, -2.0]])
def test_a_sound_that_begins_earlier_than_its_first_frame_fades_in_from_there(step: list[float] | None) -> None:
    """Frames before are left out; what the first is away from 0 is taken off, by a fade over the next blocks."""
    fade = np.array([1.0, 0.75, 0.5, 0.25])
    waiting = SimpleNamespace(_step=step if step is None else np.array(step), _fade=fade)
    begun = partial(Renderer._begun, waiting)  # type: ignore[arg-type]
    blocks = [np.arange(6.0).reshape(3, 2) + 10 * i for i in range(4)]
    assert begun(blocks[0], -3).shape == (0, 2)
    assert (waiting._step is None) == (step is None)
    second, third, last = begun(blocks[1], -1), begun(blocks[2], 2), begun(blocks[3], 5)
    taken = blocks[1][1] if step is None else np.array(step)
    np.testing.assert_allclose(second, blocks[1][1:] - fade[:2, None] * taken)
    np.testing.assert_allclose(third, blocks[2] - np.array([0.5, 0.25, 0.0])[:, None] * taken)
    assert last is not blocks[3]
    np.testing.assert_array_equal(last, blocks[3])
    np.testing.assert_array_equal(blocks[1], np.arange(6.0).reshape(3, 2) + 10)  # the engine's own stays


#: frames of the last window and of a span of the grid, at 100 Hz
_KEPT = round(_WINDOW * 100) + _TICKS * GRID


def watcher(**values: Any) -> SimpleNamespace:
    """A render at half of the model's rate, 100 Hz; its last event is at 2 s, and a channel is late by 0.5 s."""
    usual = {
        "_resampler": SimpleNamespace(ratio=2),
        "_loudest": 1.0,
        "_recent": [],
        "model": SimpleNamespace(fs=200),
        "fs": 100,
        "performance": SimpleNamespace(timeline=SimpleNamespace(stop=2.0)),
        "_routing": SimpleNamespace(longest_delay=50),
        "_end": "",
        "engine": SimpleNamespace(done=True),
        "options": SimpleNamespace(tail_level_db=-60.0, tail=3.0),
    }
    return SimpleNamespace(**{**usual, **values})


@pytest.mark.parametrize(
    ("seconds", "peak", "changes", "end"),
    [
        (2.5 + _WINDOW, 1e-3, {}, "decayed"),
        (2.5 + _WINDOW, 1.1e-3, {}, ""),
        (2.49 + _WINDOW, 0.0, {}, ""),  # the delayed channel is not over
        (2.5 + _WINDOW, 0.0, {"_routing": SimpleNamespace(longest_delay=60)}, ""),
        (2.5 + _WINDOW, 0.0, {"engine": SimpleNamespace(done=False)}, ""),
        (2.5 + _WINDOW, 1.9e-3, {"_loudest": 2.0}, "decayed"),
        (5.0, 0.1, {}, "tail cap"),
        (4.99, 0.1, {}, ""),
        (5.0, 0.0, {"_end": "duration"}, "duration"),
        (4.9, 0.0, {"_recent": [(490 - _KEPT + 1, 0.5)]}, ""),  # heard within the window
        (4.9, 0.0, {"_recent": [(490 - _KEPT, 0.5)]}, "decayed"),
        (4.9, 0.0, {"_recent": [(-900, 0.5), (-800, 0.5), (485, 2e-3)]}, ""),
    ],
)
def test_a_render_ends_when_its_sound_has_decayed_or_its_tail_is_over(
    seconds: float, peak: float, changes: dict[str, Any], end: str
) -> None:
    one = watcher(**changes)
    Renderer._watch(one, round(seconds * 200), peak)  # type: ignore[arg-type]
    assert one._end == end
    assert one._recent[-1] == (round(seconds * 200) // 2, peak)
    assert one._loudest == changes.get("_loudest", 1.0)


def test_the_loudest_frame_and_the_last_window_are_kept() -> None:
    one = watcher(_loudest=0.0, engine=SimpleNamespace(done=False))
    for sample in range(0, 2000, 2):
        Renderer._watch(one, sample, 1.0 if sample == 1900 else 0.5)  # type: ignore[arg-type]
    assert one._loudest == 1.0
    first = one._recent[0][0]
    assert one._recent == [(i, 1.0 if i == 950 else 0.5) for i in range(first, 1000)]
    assert first == 999 - _KEPT + 1


@pytest.mark.parametrize(
    ("channels", "played"),
    [
        (None, {*range(16)} - {9}),
        ({1}, {0, 1, 2}),  # of a zone with its members
        ({16}, {15, *range(10, 15)}),
        ({3}, {2}),
        ({10}, {9}),
    ],
)
def test_channels_of_zones_are_played_with_their_masters(channels: set[int] | None, played: set[int]) -> None:
    zones = {0: [1, 2], 15: list(range(10, 15))}
    of = SimpleNamespace(is_member=lambda number: any(number in members for members in zones.values()))
    one = SimpleNamespace(zones=zones, channels=channels, _channels=of)
    one._masters = partial(MidiReceiver._masters, one)  # type: ignore[arg-type]
    one._chosen = partial(MidiReceiver._chosen, one)  # type: ignore[arg-type]
    assert [one._masters(i) for i in (0, 1, 2, 3, 10, 15)] == [[], [0], [0], [], [15], []]
    assert {i for i in range(16) if MidiReceiver._is_played(one, i)} == played  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("number", "done"),
    [
        (120, ["release_keys 3 pedalled"]),
        (121, ["reset 3", "control 1 0.0 3", "control 11 1.0 3", "control 64 0.0 3"]),
        (122, ["local control"]),
        *((number, ["release_keys 3"]) for number in (123, 124, 127)),
    ],
)
def test_messages_of_the_mode_of_a_channel(number: int, done: list[str]) -> None:
    """MIDI 1.0: 120 all sound off, 121 reset, 122 local control, from 123 on all notes off."""
    said = list[str]()
    calls = {name: lambda *a, name=name, **how: said.append(" ".join(map(str, (name, *a, *how))))
             for name in ("reset", "control", "release_keys")}  # fmt: skip
    channels = SimpleNamespace(reached=lambda n: [n], reset=calls["reset"])
    moved = {(3, f"cc{controller}") for controller in (1, 11, 64)}
    live = SimpleNamespace(**calls, player=SimpleNamespace(controls=moved))
    one: Any = SimpleNamespace(_channels=channels, live=live, ignored=Counter(), _bend=list)
    MidiReceiver._mode(one, 3, number)
    assert [*said, *one.ignored] == done


def test_the_terminal_is_read_by_characters_and_given_back(monkeypatch: pytest.MonkeyPatch) -> None:
    import pty
    import termios

    controller, terminal = pty.openpty()
    with open(terminal, "rb", closefd=False) as stdin:
        monkeypatch.setattr(keyboard.sys, "stdin", stdin)
        before = termios.tcgetattr(terminal)
        opened = keyboard._Terminal()
        assert opened.read() == ""
        os.write(controller, "q\N{LATIN SMALL LETTER E WITH ACUTE}".encode())  # no return key
        assert select.select([terminal], [], [], 10.0)[0]
        assert opened.read() == "q\N{LATIN SMALL LETTER E WITH ACUTE}"
        during = termios.tcgetattr(terminal)
        assert not during[3] & (termios.ICANON | termios.ECHO)
        opened.close()
        assert termios.tcgetattr(terminal) == before
    for descriptor in (controller, terminal):
        os.close(descriptor)
    monkeypatch.setattr(keyboard.sys, "stdin", open(os.devnull))  # noqa: SIM115  # closed with the test
    with pytest.raises(TonewoodError, match="standard input is no terminal"):
        keyboard._Terminal()


def test_an_account_of_energy_is_a_row_an_interval(tmp_path: Path) -> None:
    trace: Any = SimpleNamespace(
        time=np.array([0.5, 1.0]), steps=np.array([10, 20]), residual=np.array([1e-12, -2e-12]),
        stored={"A": np.array([1.0, 0.5])}, supplied={"pluck": np.array([2.0, 0.0])}, booked={},
        lost={"A": np.array([0.25, 0.125])},
        to_dict=lambda: {"a": 1}, plot=lambda stream: stream.write(b"png"),
    )  # fmt: skip
    files = [tmp_path / name for name in ("e.csv", "e.JSON", "e.png")]
    for file in files:
        energy.save_energy(trace, file)
    assert files[0].read_text().splitlines() == [
        "time_s,steps,stored:A,supplied:pluck,lost:A,residual", "0.5,10,1.0,2.0,0.25,1e-12",
        "1.0,20,0.5,0.0,0.125,-2e-12",
    ]  # fmt: skip
    assert (json.loads(files[1].read_text()), files[2].read_bytes()) == ({"a": 1}, b"png")
    with pytest.raises(TonewoodError, match=r"--energy: is 'e\.txt'; a name ending in \.json, \.csv, \.png is allowed"):
        energy.save_energy(trace, tmp_path / "e.txt")
    assert sorted(tmp_path.iterdir()) == sorted(files)


@pytest.mark.parametrize(("limit", "seconds"), [(None, 3.5), (9.0, 3.5), (2.0, 2.0)])
def test_a_take_lasts_to_its_last_message_and_the_tail(limit: float | None, seconds: float) -> None:
    fake: Any = SimpleNamespace(_end=16000, fs=8000, options=SimpleNamespace(tail=1.5, max_duration=limit))
    assert Replay.expected_duration.fget(fake) == seconds  # type: ignore[attr-defined]


def test_time_of_a_switched_effect_is_measured_on_none_one_and_all(monkeypatch: pytest.MonkeyPatch) -> None:
    """1 us a sample without it, 0.2 us with any of it, and 10 ns for each unit of its load, on a quiet clock."""
    clock, loads = [0.0], {"A": 2.0, "B": 6.0}

    class Switched:
        name, chosen, components = "bend", True, ("A", "B")

        def apply(self, system: Any, on: Any, frettings: Any) -> Any:
            return on

        def load(self, component: str) -> float:
            return loads[component]

    class Stepper:
        on: Any = None

        def exchange(self, on: Any) -> None:
            self.on = on

        def run(self, state: Any, n: int) -> None:
            clock[0] += n * (1e-6 + 2e-7 * bool(self.on) + 1e-8 * sum(loads[name] for name in self.on))

    left_out, none = Switched(), Switched()
    left_out.chosen, none.components = False, ()  # type: ignore[assignment]
    engine: Any = SimpleNamespace(
        effects=[Switched(), left_out, none, object()], stepper=Stepper(), system="system", frettings={},
        state=SimpleNamespace(copy=lambda: None),
    )  # fmt: skip
    monkeypatch.setattr(plan_module, "SwitchedEffect", Switched)
    monkeypatch.setattr(plan_module.time, "thread_time", lambda: clock[0])
    (rate,) = plan_module._switched_rates(engine).values()
    assert (rate.per_sample, rate.per_load) == pytest.approx((2e-7, 1e-8))
    assert engine.stepper.on == "system"


def test_a_long_score_is_planned_from_its_first_notes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(plan_module, "_MOST_NOTES", 1)
    score = tw.Score([tw.Note(0.0, 0.2, note=45), tw.Note(1.5, 0.5, note=45)])
    found = tw.plan(score, tw.load_instrument("monochord"), 16000, tail=0.25, lead_in=0.0, effects="none")
    assert found.duration_s == pytest.approx(1.5 + 0.5 + 0.25)
    assert 0.2 < found.sketched_s <= 1.5
