"""Sounds, pictures and settings of batches at the edges of what is allowed, worked out by hand."""

from __future__ import annotations

import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import batch_fakes as fakes
import numpy as np
import pytest
import soundfile
from matplotlib.image import imread

from tonewood.workshop.batch import pictures, production
from tonewood.workshop.batch.conditions import Draw
from tonewood.workshop.batch.layout import Group, Stimulus
from tonewood.workshop.batch.manifest import ManifestError, RenderSettings, Stimuli, check_manifest
from tonewood.workshop.batch.outputs import _remove_strangers
from tonewood.workshop.batch.pages import StaircasePage, localised
from tonewood.workshop.batch.pictures import GAP, WAVE_HEIGHT, WIDTH
from tonewood.workshop.batch.production import _drops, _find_level, _Job, _Level, prepared, write_wav
from tonewood.workshop.batch.rendering import _Base
from tonewood.workshop.batch.stimuli import faded, samples_sha256, with_channels
from tonewood.workshop.batch.store import Rendered, Store

PLAIN: dict[str, Any] = {
    "fade": {"in": 0.0, "out": 0.0},
    "trim": {"level_db": None},
    "onset": {"align": "score", "at": 0.0},
}


def stimuli(**changes: Any) -> Stimuli:
    return Stimuli.model_validate(PLAIN | changes)


def test_a_picture_has_both_channels_and_the_spectrum_of_their_mean(tmp_path: Path) -> None:
    """Two channels of opposite sign cancel: their waveforms stand side by side, their spectrogram is silence."""
    left = np.repeat([0.5, 1.0], 50 * WIDTH)
    pictures.write_picture(tmp_path / "a.png", np.stack([left, -left], axis=1), 48000)
    pictures.write_picture(tmp_path / "silent.png", np.zeros((len(left), 1)), 48000)
    image, silent = imread(tmp_path / "a.png"), imread(tmp_path / "silent.png")
    assert (image[WAVE_HEIGHT + GAP :] == silent[WAVE_HEIGHT + GAP :]).all()
    assert (image[WAVE_HEIGHT : WAVE_HEIGHT + GAP] == 1.0).all()
    inked = (image[:WAVE_HEIGHT, :, :3] < 1.0).any(axis=-1)
    centre = (WAVE_HEIGHT - 1) / 2  # row of 0; one row is 2 / (rows - 1)
    for column, height in ((10, 0.5), (WIDTH - 10, 1.0)):
        rows = np.flatnonzero(inked[:, column])
        np.testing.assert_allclose(np.abs(rows - centre) / centre, height, atol=1.1 / centre)
        assert rows.min() < centre < rows.max()


@pytest.mark.parametrize(("fall_db", "drawn"), [(59.0, 2), (61.0, 1)])
def test_differences_are_drawn_down_to_60_db(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fall_db: float, drawn: int
) -> None:
    """A tone of 0.1 s at full level, then lower: blocks of 20 ms of the second part count up to 60 dB below."""
    axes: list[Any] = []
    figure = pictures.figure
    monkeypatch.setattr(pictures, "figure", lambda *a, **k: axes.append(figure(*a, **k)) or axes[-1])
    fs = 8000
    tone = np.sin(2 * np.pi * 1000 * np.arange(1600) / fs)
    tone[800:] *= 10 ** (-fall_db / 20)
    pictures.write_differences(tmp_path / "d.png", {"a": tone[:, None], "b": tone[:, None] / 2}, fs, "h")
    bottom = np.asarray(axes[0][1][1, 0].get_lines()[0].get_xydata())
    np.testing.assert_allclose(bottom[:, 0], 0.02 * np.arange(5 * drawn), atol=1e-12)
    np.testing.assert_allclose(bottom[:, 1], -20 * math.log10(2), atol=1e-9)
    top, below = axes[0][1][:, 0]
    bands = np.asarray(top.get_lines()[0].get_xydata())
    assert bands[np.abs(bands[:, 0] - 1000.0).argmin()] == pytest.approx([1000.0, -20 * math.log10(2)])
    assert (top.get_xscale(), top.get_xlim(), top.get_xlabel()) == ("log", (50.0, 20e3), "frequency, Hz")
    assert (below.get_xscale(), below.get_xlabel()) == ("linear", "time, s")
    assert [t.get_text() for t in top.get_legend().get_texts()] == ["b"]


def test_channels_of_a_sound_in_a_room(tmp_path: Path) -> None:
    """One channel is heard through both of the room; two go each through its own, or together as their mean."""
    click = np.zeros((8, 2))
    click[0] = [1.0, 3.0]
    soundfile.write(tmp_path / "two.wav", np.array([[0.5, 0.25]]), 48000, subtype="DOUBLE")
    soundfile.write(tmp_path / "one.wav", np.array([0.5]), 48000, subtype="DOUBLE")
    for channels, downmix, room, first in (
        (2, "mean", "two.wav", [0.5, 0.75]), (1, "mean", "one.wav", [1.0]), (1, "first", "one.wav", [0.5]),
        (1, "mean", None, [2.0]), (1, "first", None, [1.0]), (2, "mean", None, [1.0, 3.0]),
    ):  # fmt: skip
        path = None if room is None else tmp_path / room
        found = prepared(Rendered(click, 48000), stimuli(channels=channels, downmix=downmix), room=path)
        np.testing.assert_allclose(found[0], first, atol=1e-12)
    three = with_channels(click[:, :1], 2)
    assert three[0].tolist() == [1.0, 1.0]
    with pytest.raises(Exception, match="3 channels cannot become 2; allowed: 1, 3"):
        with_channels(np.zeros((4, 3)), 2)


def test_an_anchor_has_the_gain_of_its_sound(tmp_path: Path) -> None:
    """A tone of 10 kHz is out of the anchor of 3.5 kHz: of the same gain, its true peak is 50 dB below."""
    store = Store(tmp_path)
    store.save("ab", Rendered(0.1 * np.sin(2 * np.pi * 10000 * np.arange(24000) / 48000)[:, None], 48000))
    soft = stimuli(fade={"in": 0.05, "out": 0.05})
    jobs = [_Job(Stimulus("c", "x", role), "g", tmp_path, "ab", soft, None, 1) for role in ("sound", "anchor35")]
    sound, anchor = map(_find_level, jobs)
    assert (sound.gain_db, sound.frames, sound.fault) == (anchor.gain_db, 24000, None)
    assert sound.true_peak_dbtp == pytest.approx(sound.gain_db - 20.0, abs=0.2)
    assert anchor.true_peak_dbtp < sound.true_peak_dbtp - 40.0
    lost = _find_level(_Job(Stimulus("c", "x"), "g", tmp_path, "gone", stimuli(), None, 1))
    assert (lost.code, lost.frames, lost.gain_db, lost.true_peak_dbtp) == ("c", 1, 0.0, -math.inf)
    assert "run the batch again" in str(lost.fault)


def test_groups_are_lowered_by_their_loudest_sound() -> None:
    groups = [Group(name, 0, {}, tuple(Stimulus(c, c) for c in codes), ()) for name, codes in (("g", "ab"), ("h", "c"))]
    levels = {c: _Level(c, 1, 0.0, peak) for c, peak in (("a", -3.0), ("b", 0.5), ("c", -1.0))}
    drops, notes = _drops(groups, levels, stimuli())
    assert drops == {"g": pytest.approx(1.51), "h": 0.0}  # 0.01 dB below the limit of -1
    assert notes == ["g: all files lowered by 1.51 dB to keep true peaks below -1.0 dBTP"]


@pytest.mark.parametrize(("subtype", "top"), [("PCM_16", 2**15), ("PCM_24", 2**23)])
def test_integer_samples_are_written_as_they_are(tmp_path: Path, subtype: str, top: int) -> None:
    steps = np.array([[0, 1], [-1, top - 1], [-top, 12345]], dtype=np.int16 if top == 2**15 else np.int32)
    write_wav(tmp_path / "new" / "a.wav", steps, 8000, subtype)
    read, fs = soundfile.read(tmp_path / "new" / "a.wav")
    assert (read * top).tolist() == steps.tolist()
    assert (fs, soundfile.info(tmp_path / "new" / "a.wav").subtype) == (8000, subtype)
    assert samples_sha256(steps) == samples_sha256(steps.astype(steps.dtype.newbyteorder(">")))


@pytest.mark.parametrize(("fades", "edge"), [((0.5, 0.25), (4, 2)), ((1.0, 1.0), (4, 4)), ((2.0, 1.0), (5, 3))])
def test_fades_share_a_sound_in_their_ratio(fades: tuple[float, float], edge: tuple[int, int]) -> None:
    found = faded(np.ones((8, 1)), 8, *fades)[:, 0]
    up, down = ([(1 - math.cos(math.pi * k / n)) / 2 for k in range(n)] for n in edge)
    assert found == pytest.approx([*up, *[1.0] * (8 - sum(edge)), *down[::-1]])


@pytest.mark.parametrize(
    ("language", "said"), [("de", "A"), ("de-AT", "A"), ("de-CH", "C"), ("en", "E"), ("fr", "E"), ("en-GB", "E")]
)
def test_a_text_in_a_language_its_base_or_the_first(language: str, said: str) -> None:
    assert localised({"en": "E", "de": "A", "de-CH": "C"}, language) == said
    assert (localised("all", language), localised({}, language)) == ("all", "")


@pytest.mark.parametrize(
    ("level", "by", "reversals", "plain", "ratio"),
    [
        (10.0, 1, 0, 14.0, 40.0), (10.0, -1, 1, 6.0, 2.5), (10.0, 1, 2, 12.0, 20.0), (10.0, -1, 9, 8.0, 5.0),
        (39.0, 1, 0, 40.0, 40.0), (2.0, -1, 0, 1.0, 1.0),
    ],
)  # fmt: skip
def test_steps_of_a_staircase_after_two_reversals_each(
    level: float, by: int, reversals: int, plain: float, ratio: float
) -> None:
    fields = {"type": "staircase", "path": "a", "start": 4.0, "lowest": 1.0, "highest": 40.0, "steps": [4.0, 2.0]}
    for found, page in ((plain, fields), (ratio, fields | {"ratio": True})):
        assert StaircasePage.model_validate(page).moved(level, by, reversals) == pytest.approx(found)


@pytest.mark.parametrize(
    ("scale", "reference", "value"),
    [("value", 3.0, 6.0), ("add", None, 8.0), ("add", 3.0, 9.0), ("percent", None, 2.12), ("db", 1.0, 10**0.3)],
)
def test_values_of_a_level(scale: str, reference: float | None, value: float) -> None:
    page = {"type": "staircase", "path": "a", "start": 4.0, "lowest": 1.0, "highest": 9.0, "scale": scale}
    assert StaircasePage.model_validate(page | {"reference": reference}).value(6.0, 2.0) == pytest.approx(value)
    for wrong in (True, "text"):
        if scale != "value":
            with pytest.raises(ValueError, match=f"scale: {scale} needs a number"):
                StaircasePage.model_validate(page).value(6.0, wrong)


def test_tails_of_renders_by_either_spelling() -> None:
    settings = RenderSettings.model_validate({"tail": {"cap": 3.0}, "output": "bridge"})
    assert (settings.tail, settings.tail_level_db, settings.outputs) == (3.0, -90.0, ("bridge",))
    made = check_manifest(fakes.manifest(render={"tail": {"cap": 3.0, "energy_db": -40.0}}))
    changed = made.render_settings({"tail.energy_db": -50.0, "fs": 8000})
    assert (changed.tail, changed.tail_level_db, changed.fs) == (3.0, -50.0, 8000)
    for wrong, said in (({"tail": {"top": 1.0}}, "tail.top: is not a known key"), ({"room": "hall"}, "single renders")):
        with pytest.raises(ManifestError, match=said):
            check_manifest(fakes.manifest(render=wrong))


@pytest.mark.parametrize("keys", [{"room": None}, {"preset": None, "room_distance": None}, {"output": None}])
def test_keys_of_single_renders_that_say_nothing_are_accepted(keys: dict[str, None]) -> None:
    assert RenderSettings.model_validate(keys) == RenderSettings()


def test_one_output_is_not_given_beside_several() -> None:
    with pytest.raises(ValueError, match="output\n  Extra inputs"):
        RenderSettings.model_validate({"output": "x", "outputs": ["y"]})


def test_a_fraction_varies_about_its_length() -> None:
    """from_bridge of a tenth of a string that sounds 0.6 m long, and of a note that no string plays."""
    instrument: Any = SimpleNamespace(
        resolved={"exciters": {"e": {"from_bridge": {"fraction": 0.1}, "force": 2}}},
        spec=SimpleNamespace(playing=SimpleNamespace(velocity=None, default_exciter="e")),
    )
    base = _Base(SimpleNamespace(notes=()), instrument, SimpleNamespace())  # type: ignore[arg-type]
    base.lengths = {(0.0, 40, None, None, None): 0.6}
    note: Any = SimpleNamespace(time=0.0, note=40, freq=None, string=None, stop=None, technique=None,
                                from_bridge=None, force=None, velocity_midi=None)  # fmt: skip
    draw = Draw("exciters.*.from_bridge", "normal", 1.0, 1, ())
    assert base.value(draw, note) == pytest.approx(0.06)
    note.time = 1.0
    assert base.value(draw, note) is None
    assert base.value(Draw("exciters.*.force", "normal", 1.0, 1, ()), note) == 2.0


def test_numbers_that_are_not_finite_are_left_out_of_records() -> None:
    assert [production._finite(x) for x in (1.5, math.inf, -math.inf, math.nan)] == [1.5, None, None, None]


@pytest.mark.parametrize(("pictures_kept", "left"), [(True, ["bcdfgh.png", "differences1.png"]), (False, [])])
def test_sounds_and_pictures_of_other_codes_are_removed(tmp_path: Path, pictures_kept: bool, left: list[str]) -> None:
    """Codes are six consonants; files of other names stay wherever they are."""
    for folder, names in (
        ("stimuli", ("bcdfgh.wav", "zzzzzz.wav", "notes.wav")),
        ("pictures", ("bcdfgh.png", "zzzzzz.png", "differences1.png", "abcdef.png")),
        (".", ("zzzzzz.wav", "zzzzzz.png")),
    ):
        (tmp_path / folder).mkdir(exist_ok=True)
        for name in names:
            (tmp_path / folder / name).touch()
    _remove_strangers(tmp_path, {"bcdfgh"}, pictures=pictures_kept)
    assert sorted(p.name for p in (tmp_path / "stimuli").iterdir()) == ["bcdfgh.wav", "notes.wav"]
    assert sorted(p.name for p in (tmp_path / "pictures").iterdir()) == sorted(["abcdef.png", *left])
    assert sorted(p.name for p in tmp_path.iterdir() if p.is_file()) == ["zzzzzz.png", "zzzzzz.wav"]


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"steps": [], "longest": 40}, "longest belongs to a staircase with steps"),
        ({"trials": 30}, "trials belongs to QUEST"),
        ({"ratio": True, "steps": [1.2], "expect_sd": 1.0}, "expect_sd is a ratio above 1"),
        ({"ratio": True, "steps": [1.2], "margin": 0.5}, "margin is a ratio above 1"),
        ({"ratio": True, "steps": [1.2], "expect_sd": 1.01}, None),
        ({"expect_sd": 0.5}, None),
        ({"steps": [], "trials": 30}, None),
        ({"highest": float("inf")}, None),  # refused where the path is known
    ],
)
def test_keys_of_staircases_that_do_not_fit(change: dict[str, Any], said: str | None) -> None:
    page = {"type": "staircase", "path": "b", "start": 0.5, "lowest": 0.1, "highest": 1.0, "steps": [0.1]} | change
    if said is None:
        assert StaircasePage.model_validate(page).start == 0.5
    else:
        with pytest.raises(ValueError, match=said):
            StaircasePage.model_validate(page)
