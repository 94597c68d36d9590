"""Values of sample libraries against figures worked out by hand: spans, levels, texts, strokes."""

from __future__ import annotations

import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest

import tonewood as tw
from tonewood.errors import OutputError, TonewoodError
from tonewood.sound.render.options import RenderOptions
from tonewood.workshop.sampling.library import (
    Sampling,
    _about,
    _enter,
    _head,
    _Measures,
    _region,
    _Task,
    _tasks,
    make_library,
)
from tonewood.workshop.sampling.notes import Span, key_spans, sample_name, spans, velocity_spans
from tonewood.workshop.sampling.strokes import KEY_DOWN, Stroke, release, ringing
from tonewood.workshop.sampling.texts import Region, decent_text, sfz_text

FS = 1000


SOFT = Span(64, 1, 80)


def region(file: str = "a.flac", velocities: Span = SOFT, **changes: Any) -> Region:
    values: dict[str, Any] = {
        "keys": Span(60, 58, 61), "repeat": 1, "n_repeats": 1, "levels": {40: -30.0, 64: -20.0, 100: -14.0},
    }  # fmt: skip
    return Region(file, velocities=velocities, **values | changes)


def test_numbers_go_to_the_nearest_centre_in_the_middle_to_the_higher() -> None:
    assert spans([10, 13, 17], 8, 20) == [Span(10, 8, 11), Span(13, 12, 14), Span(17, 15, 20)]
    assert spans([5], 0, 9) == [Span(5, 0, 9)]
    assert [s.centre for s in key_spans(40, 47, 3)] == [40, 43, 46, 47]
    assert [s.centre for s in key_spans(40, 46, 3)] == [40, 43, 46]
    assert velocity_spans([127, 1]) == [Span(1, 1, 63), Span(127, 64, 127)]
    assert (sample_name(46, 7, 2), sample_name(60, 127, 1, release=True)) == ("As2_v007_r2", "release_C4_v127_r1")


@pytest.mark.parametrize(
    ("velocity", "level"), [(40, -30.0), (52, -25.0), (64, -20.0), (82, -17.0), (127, -9.5), (16, -40.0)]
)
def test_levels_lie_on_straight_lines(velocity: float, level: float) -> None:
    assert region().level(velocity) == pytest.approx(level)


def test_one_layer_alone_grows_by_the_square_of_the_velocity() -> None:
    alone = region(levels={64: -20.0})
    assert [alone.level(v) for v in (64, 128, 0.5)] == pytest.approx(
        [-20.0, -20.0 + 40 * np.log10(2), -20 - 40 * np.log10(64)]
    )


def test_gains_of_a_region() -> None:
    """At 80 of 64 to 100: 16 of 36 times 6 dB more; a release by 0.8 s of 5 dB/s more."""
    assert region().volume_db == pytest.approx(6.0 * 16 / 36)
    assert region(decay_db=5.0).volume_db == pytest.approx(6.0 * 16 / 36 + 5.0 * KEY_DOWN)
    curve = region(velocities=Span(64, 50, 80)).curve
    assert list(curve) == [50, 64, 80]
    assert list(curve.values()) == pytest.approx(
        [10 ** ((-20 - 10 * 14 / 24 + 20 - 16 / 6) / 20), 10 ** (-16 / 120), 1]
    )
    assert list(region(velocities=Span(64, 48, 64)).curve) == [48, 64]
    assert list(region(velocities=Span(64, 1, 127)).curve) == [1, 16, 32, 48, 64, 80, 96, 112, 127]
    falling = region(levels={40: -10.0, 100: -20.0})
    assert set(falling.curve.values()) == {1.0}  # never more


def test_an_sfz_text_word_by_word() -> None:
    one = region("a.flac", Span(64, 64, 127), levels={64: -20.0}, repeat=2, n_repeats=3)
    ended = region("r.flac", Span(64, 64, 127), levels={64: -20.0}, decay_db=5.0)
    lines = sfz_text([one, ended], "lib", ["about", "it"], rings=False).splitlines()
    up = 40 * np.log10(127 / 64)
    curve = " ".join(f"amp_velcurve_{v}={(v / 127) ** 2:.4f}" for v in (64, 80, 96, 112, 127))
    place = "pitch_keycenter=60 lokey=58 hikey=61 lovel=64 hivel=127"
    assert lines == [
        "// about", "// it", "<control> default_path=lib/", "<global> amp_veltrack=100",
        "<group> loop_mode=no_loop ampeg_release=0.03",
        f"<region> sample=a.flac {place} volume={up:.2f} {curve} seq_length=3 seq_position=2",
        "<group> trigger=release loop_mode=one_shot",
        f"<region> sample=r.flac {place} volume={up + 4:.2f} {curve} rt_decay=5.00",
    ]  # fmt: skip
    ringing_on = sfz_text([one], "lib", [], rings=True).splitlines()
    assert ringing_on[2] == "<group> loop_mode=one_shot"
    assert len(ringing_on) == 4


@pytest.mark.parametrize(("rings", "ended"), [(True, "5"), (False, "0.03")])
def test_a_preset_of_decent_sampler(rings: bool, ended: str) -> None:
    one = region("a.flac", Span(64, 64, 127), levels={64: -20.0}, repeat=2, n_repeats=3)
    text = decent_text([one, region("r.flac", decay_db=0.0)], "lib", ["a -- b"], rings=rings)
    notes, releases = ElementTree.fromstring(text).iter("group")
    assert (notes.get("trigger"), notes.get("release"), releases.get("trigger"), releases.get("release")) == (
        "attack", ended, "release", "5"
    )  # fmt: skip
    (sample,) = notes
    assert sample.attrib == {
        "path": "lib/a.flac", "rootNote": "60", "loNote": "58", "hiNote": "61", "loVel": "64", "hiVel": "127",
        "volume": f"{40 * np.log10(127 / 64):.2f}dB", "seqLength": "3", "seqPosition": "2",
    }  # fmt: skip
    assert len(list(ElementTree.fromstring(decent_text([one], "lib", [], rings=rings)).iter("group"))) == 1


def test_measures_of_a_stroke() -> None:
    loud = np.concatenate([np.full((500, 1), 0.1), np.full((700, 1), -0.5)])
    stroke = Stroke(60, 100, 1, loud)
    assert (stroke.peak, stroke.level_db(FS)) == (0.5, pytest.approx(-20.0))
    nothing = Stroke(60, 100, 1, np.zeros((0, 1)))
    assert (nothing.peak, nothing.level_db(FS)) == (0.0, -200.0)
    t = np.arange(1100) / FS
    falling = Stroke(60, 100, 1, 10 ** (-30 * t[:, None] / 20))
    assert falling.decay_db(FS) == pytest.approx(30.0)
    assert Stroke(60, 100, 1, falling.samples[:1000]).decay_db(FS) == pytest.approx(30.0)
    assert Stroke(60, 100, 1, falling.samples[:999]).decay_db(FS) == 0.0


def test_a_region_has_the_means_of_its_strokes() -> None:
    measures = _Measures()
    keys, soft, hard = Span(60, 58, 61), Span(40, 1, 70), Span(100, 71, 127)
    for velocities, size in ((soft, 0.1), (hard, 0.5)):
        for repeat in (2, 5):
            decay = 10 ** (-10 * repeat * np.arange(1100) / FS / 20)
            task = _Task(keys, velocities, repeat, False)
            _enter(measures, FS, task, Stroke(60, velocities.centre, repeat, size * decay[:, None]), Path(task.name))
    ended = _Task(keys, soft, 1, True)
    _enter(measures, FS, ended, Stroke(60, 40, 1, np.full((10, 1), 0.9)), Path("r"))
    assert (measures.peak, measures.frames) == (0.9, 4 * 1100 + 10)
    assert measures.recordings["C4_v040_r5"][1] == Path("C4_v040_r5")
    one = _region(_Task(keys, hard, 5, False), measures, ".wav")
    assert (one.file, one.repeat, one.n_repeats, one.decay_db) == ("C4_v100_r5.wav", 2, 2, None)
    levels = [Stroke(60, 1, 1, 10 ** (-10 * r * np.arange(500) / FS / 20)[:, None]).level_db(FS) for r in (2, 5)]
    assert one.levels == {
        40: pytest.approx(np.mean(levels) - 20),
        100: pytest.approx(np.mean(levels) - 20 * np.log10(2)),
    }
    of_release = _region(ended, measures, ".wav")
    assert of_release.decay_db == pytest.approx(35.0)
    assert (of_release.file, of_release.n_repeats) == ("release_C4_v040_r1.wav", 1)


def test_strokes_of_a_library() -> None:
    """A guitar's notes are damped: a release of each key, at the middle layer, for all velocities."""
    guitar = tw.load_instrument("classical_guitar")
    sampling = Sampling(step=5, velocities=(30, 60, 90, 120), repeats=2, lowest=40, highest=51)
    tasks = _tasks(guitar, sampling, RenderOptions(fs=8000))
    assert [t.keys.centre for t in tasks[::8][:4]] == [40, 45, 50, 51]
    assert len(tasks) == 4 * 4 * 2 + 4 * 2
    assert [(t.velocities.centre, t.repeat) for t in tasks[:4]] == [(30, 1), (30, 2), (60, 1), (60, 2)]
    assert [(t.keys.centre, t.velocities, t.repeat, t.release) for t in tasks[-3:]] == [
        (50, Span(90, 1, 127), 2, True), (51, Span(90, 1, 127), 1, True), (51, Span(90, 1, 127), 2, True)
    ]  # fmt: skip
    assert tasks[-1].name == "release_Ds3_v090_r2"
    bare = Sampling(step=5, velocities=(64,), repeats=1, lowest=40, highest=40, releases=False)
    assert len(_tasks(guitar, bare, RenderOptions(fs=8000))) == 1


@pytest.mark.parametrize(
    ("changes", "key"),
    [
        ({"step": 0}, "every"),
        ({"step": 24}, None),
        ({"step": 25}, "every"),
        ({"repeats": 0}, "round-robins"),
        ({"repeats": 16}, None),
        ({"repeats": 17}, "round-robins"),
        ({"lowest": 44}, "range"),
        ({"lowest": 45, "highest": 69}, None),
        ({"highest": 70}, "range"),
        ({"lowest": 50, "highest": 49}, "range"),
        ({"lowest": 50, "highest": 50}, None),
    ],
)
def test_limits_of_a_library(changes: dict[str, Any], key: str | None) -> None:
    """The monochord's string goes from A2 to two octaves above."""
    monochord = tw.load_instrument("monochord")
    if key is None:
        assert _tasks(monochord, Sampling(**changes), RenderOptions(fs=8000))
    else:
        with pytest.raises(TonewoodError) as fault:
            _tasks(monochord, Sampling(**changes), RenderOptions(fs=8000))
        assert fault.value.key == key


def test_notes_are_rendered_with_their_own_seeds(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[Any] = []

    class Renders:
        channels = ("a", "b")

        def __init__(self, score: Any, instrument: Any, options: Any):
            asked.append((score.notes[0], options.humanize))

        def blocks(self, n: int) -> list[Any]:
            return [np.ones((700, 2)), np.full((300, 2), 2.0)]

    monkeypatch.setattr("tonewood.workshop.sampling.strokes.Renderer", Renders)
    instrument: Any = SimpleNamespace()
    for options, longest in (
        (RenderOptions(fs=8000, humanize=3, max_duration=2.5), 2.5), (RenderOptions(fs=8000, tail=4.0), 4.0)
    ):  # fmt: skip
        stroke = ringing(instrument, options, 60, 90, 2)
        note, seed = asked.pop()
        assert (note.time, note.duration, note.note, note.velocity_midi) == (0.0, longest, 60.0, 90.0)
        assert seed == (3 + 2000 + 60 if options.humanize is not None else None)
        assert (stroke.key, stroke.velocity, stroke.repeat, len(stroke.samples)) == (60, 90, 2, 1000)
    after = release(instrument, RenderOptions(fs=8000), 60, 90, 2)
    assert asked[0][0].duration == 0.8
    assert after.samples.shape == (0, 2)
    after = release(instrument, RenderOptions(fs=8000).model_copy(update={"fs": 1000}), 60, 90, 2)
    assert (after.samples == 2.0).all()
    assert len(after.samples) == 200


def test_texts_beside_the_samples(tmp_path: Path) -> None:
    spec = SimpleNamespace(title="T", name="n", licence="L", sources={"k": SimpleNamespace(text="S", licence="M")})
    instrument: Any = SimpleNamespace(spec=spec)
    assert _head(instrument, -3.456)[2] == "all samples -3.46 dB re the instrument's calibrated level"
    _about(instrument, tmp_path / "a")
    assert (tmp_path / "a").read_text().splitlines() == [
        "Samples of T.", "Licence of the instrument: L.", "", "Source k: S (M)"
    ]  # fmt: skip


def test_titles_stay_in_their_comments(tmp_path: Path) -> None:
    """A break in a title is no line of SFZ, and hyphens end no comment of XML."""
    title = "a --- b\n<global> volume=-100\x07"
    head = _head(SimpleNamespace(spec=SimpleNamespace(title=title, name="n", licence="L\nM")), 0.0)  # type: ignore[arg-type]
    assert head[:2] == [
        "a --- b <global> volume=-100", "rendered by tonewood from the instrument n, licence L M"
    ]  # fmt: skip
    assert [line for line in sfz_text([], "a", head, rings=True).splitlines() if "volume" in line] == [f"// {head[0]}"]
    assert ElementTree.fromstring(decent_text([], "a", head, rings=True)).tag == "DecentSampler"
    for name in ("a <b>", "a$b", "a sample=b", "a\\b", "a\nb", "a\rb", "a\x07"):
        with pytest.raises(OutputError, match="which SFZ takes for its own"):
            make_library(tw.load_instrument("monochord"), tmp_path / f"{name}.sfz", Sampling(), RenderOptions(fs=8000))


def test_a_library_tells_its_seconds_its_size_and_its_gain(tmp_path: Path) -> None:
    few = Sampling(step=1, velocities=(60, 100), repeats=1, lowest=50, highest=50, duration=0.25)
    shares: list[float] = []
    made = make_library(
        tw.load_instrument("monochord"), tmp_path / "a.sfz", few, RenderOptions(fs=8000), tell=shares.append
    )
    assert shares == [0.5, 1.0]
    assert made.seconds == pytest.approx(0.5)
    assert made.size == sum(f.stat().st_size for f in made.folder.iterdir())
    assert (made.n_samples, made.n_releases, made.rings) == (2, 0, True)
    assert (made.sfz, made.decent, made.folder) == tuple(tmp_path / name for name in ("a.sfz", "a.dspreset", "a"))
    text = made.sfz.read_text()
    assert f"// all samples {made.gain_db:+.2f} dB re" in text
    assert re.findall(r"sample=(\S+)", text) == ["D3_v060_r1.flac", "D3_v100_r1.flac"]
