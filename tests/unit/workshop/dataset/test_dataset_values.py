"""Values of data sets against figures worked out by hand: parameters, samples, labels, shards, predictions."""

from __future__ import annotations

import hashlib
import io
import json
import math
import zipfile
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import soundfile
from scipy.stats import qmc

import tonewood as tw
from tonewood.errors import NumericalError, TonewoodError
from tonewood.performance.score.note import Note
from tonewood.workshop.batch.conditions import Draw
from tonewood.workshop.batch.manifest import ManifestError
from tonewood.workshop.batch.production import Fault
from tonewood.workshop.batch.rendering import EngineRenderer
from tonewood.workshop.batch.seeds import generator
from tonewood.workshop.dataset.labels import _word, by_string, jams, midi
from tonewood.workshop.dataset.manifest import Parameter, check_dataset, dataset_schema, midi_clock
from tonewood.workshop.dataset.runner import (
    DatasetPlan,
    DatasetReport,
    _digests,
    _is_made,
    _predicted,
    _record,
    _subject,
    _write,
    plan_dataset,
    run_dataset,
)
from tonewood.workshop.dataset.sampling import points, samples, sources
from tonewood.workshop.dataset.shards import Shard, ShardTask, make, parquet, shard_name, zipped
from tonewood.workshop.dataset.sound import PlayedNote, Sound, _label, fitted, note_row, sound_of

pytest.importorskip("pyarrow")

BASE: dict[str, Any] = {
    "schema": "tonewood-batch/1",
    "kind": "dataset",
    "name": "set",
    "seed": 5,
    "instruments": {"m": "monochord"},
    "scores": {"one": {"phrase": [{"time": 0.0, "note": 45.0}]}},
    "render": {"fs": 16000},
}


def dataset(**changes: Any) -> Any:
    return check_dataset({k: v for k, v in (BASE | changes).items() if v is not None})


def parameter(**fields: Any) -> Parameter:
    return Parameter.model_validate({"path": "body.x", **fields})


# -- parameters -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("fields", "shares", "values"),
    [
        ({"uniform": [2.0, 6.0]}, (0.0, 0.25, 1.0), (2.0, 3.0, 6.0)),
        ({"log_uniform": [1.0, 16.0]}, (0.0, 0.25, 1.0), (1.0, 2.0, 16.0)),
        ({"values": ["a", "b", "c"]}, (0.0, 0.33, 0.34, 0.66, 0.67, 0.999, 1.0), "aabbccc"),
        ({"values": [7]}, (0.0, 1.0), (7, 7)),
    ],
)
def test_values_at_shares_of_a_range(fields: dict[str, Any], shares: Any, values: Any) -> None:
    made_of = parameter(**fields)
    assert [made_of.at(s) for s in shares] == pytest.approx(list(values)) if "values" not in fields else True
    assert "values" not in fields or [made_of.at(s) for s in shares] == list(values)


def test_a_grid_has_both_ends() -> None:
    assert parameter(uniform=[0.0, 1.0], steps=5).grid() == [0.0, 0.25, 0.5, 0.75, 1.0]
    assert parameter(log_uniform=[1.0, 100.0], steps=3).grid() == pytest.approx([1.0, 10.0, 100.0])
    assert parameter(uniform=[0.0, 1.0]).grid() == [0.0, 1.0]
    assert parameter(values=[3, 1]).grid() == [3, 1]


def test_a_value_is_set_or_a_factor_or_a_fraction() -> None:
    assert parameter(values=[1]).setting(0.5) == 0.5
    assert parameter(values=[1], sets="scale").setting(0.5) == {"scale": 0.5}
    assert parameter(values=[1], sets="fraction").setting(0.5) == {"fraction": 0.5}
    assert (parameter(uniform=[1.0, 2.0]).range, parameter(values=[1]).range) == ((1.0, 2.0), None)


@pytest.mark.parametrize(
    ("fields", "reason"),
    [
        ({}, "exactly one"),
        ({"values": [1], "uniform": [0.0, 1.0]}, "exactly one"),
        ({"uniform": [1.0, 1.0]}, "low < high"),
        ({"log_uniform": [0.0, 1.0]}, "above 0"),
        ({"values": [1], "steps": 3}, "steps belongs to a range"),
        ({"path": "render.tail", "values": [1], "sets": "scale"}, "belongs to parameters of the bundle"),
        ({"path": "note.force", "values": [1], "sets": "scale"}, "belongs to parameters of the bundle"),
        ({"path": "note.colour", "values": [1]}, "note.colour is not one of"),
        ({"path": "note.force", "uniform": [-1.0, 2.0]}, "note.force: -1.0"),
        ({"path": "note.freq", "values": [220.0, -3.0]}, "note.freq: -3.0"),
    ],
)
def test_parameters_that_do_not_fit(fields: dict[str, Any], reason: str) -> None:
    with pytest.raises(ValueError, match=reason.replace(".", r"\.")):
        parameter(**fields)
    assert parameter(path="note.freq", values=[220.0]).values == [220.0]
    assert parameter(log_uniform=[1e-9, 1.0]).range == (1e-9, 1.0)


@pytest.mark.parametrize(
    ("fs", "clock"),
    [
        (8000, (8000, 1_000_000)),
        (32767, (32767, 1_000_000)),
        (32768, (16384, 500_000)),
        (44100, (22050, 500_000)),
        (96000, (24000, 250_000)),
        (131075, (26215, 200_000)),
        (192000, (24000, 125_000)),
        (327670, (32767, 100_000)),
        (327680, None),
        (47999, None),
    ],
)
def test_a_tick_is_a_sample(fs: int, clock: tuple[int, int] | None) -> None:
    assert midi_clock(fs) == clock


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"parameters": {"p": {"path": "body.x", "uniform": [0.0, 1.0]}}}, "parameters.p.steps: is missing"),
        ({"sampling": "sobol", "size": 3, "parameters": {"p": {"path": "b.x", "uniform": [0.0, 1.0], "steps": 3}}},
         "parameters.p.steps: belongs to sampling: grid"),
        ({"size": 3}, "size: a grid has as many"),
        ({"sampling": "random"}, "size: is missing; sampling: random"),
        ({"parameters": {p: {"path": "body.x", "values": [1]} for p in "ab"}}, "body.x stands there twice"),
        ({"render": {"fs": 47999}}, "no tick of one sample at 47999 Hz"),
        ({"sounds": {"duration": 1e-5}}, "sounds.duration: is shorter than a sample"),
        ({"render": {"fs": 88201}}, "render.fs: the sampling rate is 88201 Hz; FLAC holds up to 65535 Hz"),
        ({"parameters": {"p": {"path": "render.tail", "values": [1.0, -1.0]}}}, "parameters.p: -1.0: "),
    ],
)  # fmt: skip
def test_sets_that_do_not_fit(changes: dict[str, Any], reason: str) -> None:
    with pytest.raises(ManifestError) as fault:
        dataset(**changes)
    assert reason in str(fault.value)
    assert dataset(render={"fs": 47999}, sounds={"labels": ["jams"]}).render.fs == 47999


# -- samples ----------------------------------------------------------------------------------------------------------


def test_points_of_a_grid_are_in_order() -> None:
    grid = {"a": {"path": "body.x", "values": [1, 2]}, "b": {"path": "body.y", "uniform": [0.0, 1.0], "steps": 2}}
    rows = list(points(dataset(parameters=grid), ("m", "one")))
    assert rows == [{"a": 1, "b": 0.0}, {"a": 1, "b": 1.0}, {"a": 2, "b": 0.0}, {"a": 2, "b": 1.0}]


@pytest.mark.parametrize("size", [1, 4, 5])
def test_random_points_are_those_of_their_generators(size: int) -> None:
    named = {"a": {"path": "body.x", "uniform": [2.0, 4.0]}, "b": {"path": "body.y", "log_uniform": [1.0, 10.0]}}
    rows = list(points(dataset(sampling="random", size=size, parameters=named), ("m", "one")))
    u, v = (generator(5, "random", name, "m", "one").random(size) for name in "ab")
    np.testing.assert_allclose([[r["a"], r["b"]] for r in rows], np.stack([2 + 2 * u, 10**v], axis=1))
    rows = list(points(dataset(sampling="sobol", size=size, parameters=named), ("m", "one")))
    engine = qmc.Sobol(2, scramble=True, seed=generator(5, "sobol", "m", "one"))
    u, v = engine.random_base2(math.ceil(math.log2(size)))[:size].T
    np.testing.assert_allclose([[r["a"], r["b"]] for r in rows], np.stack([2 + 2 * u, 10**v], axis=1))
    assert list(points(dataset(sampling="sobol", size=size), ("m", "one"))) == [{}] * size


def test_values_go_to_notes_to_the_render_and_to_the_bundle() -> None:
    named = {
        "force": {"path": "note.force", "values": [2.0]}, "tail": {"path": "render.tail", "values": [3.0]},
        "t": {"path": "strings.A2.tension", "values": [0.9, 1.1], "sets": "scale"},
    }  # fmt: skip
    vary = {"note.time": {"uniform": 0.01}}
    first, second = samples(dataset(parameters=named, vary=vary), Path())
    one = second.condition
    assert (first.index, second.index, second.parameters) == (0, 1, {"force": 2.0, "tail": 3.0, "t": 1.1})
    assert (one.name, one.repeat, one.instrument, one.score) == ("m/one/000001", 2, "m", "one")
    assert (one.overrides, one.note_changes) == ({"strings.A2.tension": {"scale": 1.1}}, {"force": 2.0})
    assert (one.render.tail, one.render.fs, one.bundle, one.seed) == (3.0, 16000, "monochord", 5)
    assert one.draws == (Draw("note.time", "uniform", 0.01, 5, ("m", "one", "1")),)
    assert one.notes == (Note(0.0, note=45.0),)
    many = samples(dataset(instruments={"a": "monochord", "b": "monochord"}, sampling="random", size=2), Path())
    assert [s.condition.name for s in many] == ["a/one/000000", "a/one/000001", "b/one/000000", "b/one/000001"]
    assert [s.index for s in many] == [0, 1, 2, 3]


def test_scores_of_a_folder_and_their_hashes(tmp_path: Path) -> None:
    folder = tmp_path / "music"
    for name in ("b.mid", "sub/a.MIDI", "c.txt"):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(name.encode())
    found = sources(dataset(folder="music"), tmp_path)
    assert list(found) == ["one", "b", "sub/a"]
    assert found["sub/a"] == {
        "midi": {
            "path": str(folder / "sub" / "a.MIDI"), "start": 0.0, "stop": None, "channel_per_string": False
        },
        "midi_sha256": hashlib.sha256(b"sub/a.MIDI").hexdigest(),
    }  # fmt: skip
    score = {"two": {"midi": "music/b.mid", "start": 1.0, "stop": 2.5, "channel_per_string": True}}
    excerpt = sources(dataset(scores=score), tmp_path)["two"]["midi"]
    assert (excerpt["start"], excerpt["stop"], excerpt["channel_per_string"]) == (1.0, 2.5, True)
    with pytest.raises(ManifestError, match="two scores are called b"):
        sources(dataset(scores={"b": BASE["scores"]["one"]}, folder="music"), tmp_path)


# -- sounds and labels ------------------------------------------------------------------------------------------------


def played(string: str = "A", onset: float = 100.0, **changes: Any) -> PlayedNote:
    values: dict[str, Any] = {
        "string": string, "stop": 2.0, "onset": onset, "onset_frame": round(onset), "duration": 0.5, "pitch": 47.25,
        "technique": "pluck", "force": 1.5, "velocity_midi": 90, "from_bridge": 0.1, "length": 0.6, "angle_deg": None,
    }  # fmt: skip
    return PlayedNote(**values | changes)


def test_labels_of_a_sound() -> None:
    notes = [played("B", 50.0), played("A", 160.0), played("B", 320.5, stop=0.0)]
    assert [(name, [n.onset for n in own]) for name, own in by_string(notes).items()] == [
        ("B", [50.0, 320.5]), ("A", [160.0])
    ]  # fmt: skip
    text = jams("x", notes, 1000, 2.5, {"p": 1}, "tonewood 9")
    data = json.loads(text)
    assert text.endswith("}\n")
    assert list(data) == sorted(data)
    with pytest.raises(ValueError, match="Out of range float values"):
        jams("x", [played(pitch=math.nan)], 1000, 2.5, {}, "")
    first = data["annotations"][0]
    assert first["data"] == [
        {"time": 0.05, "duration": 0.5, "value": 47.25, "confidence": 1.0},
        {"time": 0.3205, "duration": 0.5, "value": 47.25, "confidence": 1.0},
    ]
    assert (first["time"], first["duration"], first["namespace"]) == (0.0, 2.5, "note_midi")
    assert first["sandbox"]["string"] == first["annotation_metadata"]["data_source"] == "B"
    assert first["sandbox"]["notes"][1] == {
        "stop": 0.0, "onset_frame": 320, "technique": "pluck", "force": 1.5, "from_bridge": 0.1, "length": 0.6,
        "angle_deg": None,
    }  # fmt: skip
    assert data["sandbox"] == {"fs": 1000, "parameters": {"p": 1}}
    assert (data["file_metadata"]["duration"], data["file_metadata"]["title"]) == (2.5, "x")
    assert [_word(x) for x in (0.1234567891, None, 3, "a")] == ["0.123456789", "", "3", "a"]
    with pytest.raises(ValueError, match="no tick of one sample at 47999 Hz"):
        midi(notes, 47999)
    assert note_row("s", notes[0])["sound"] == "s"
    assert note_row("s", notes[0])["from_bridge"] == 0.1


def test_a_sound_is_cut_or_padded() -> None:
    sound = np.arange(6.0).reshape(3, 2)
    assert fitted(sound, 2).tolist() == [[0.0, 1.0], [2.0, 3.0]]
    assert fitted(sound, 4).tolist() == [*sound.tolist(), [0.0, 0.0]]
    assert fitted(sound, 3).tolist() == sound.tolist()


class Renders:
    """A renderer of two blocks, the second with samples beyond full scale."""

    fs, channels, dropped = 10, ("left",), (SimpleNamespace(time=1.23456, reason="too low"),)

    def __init__(self, blocks: Any = None):
        self.sound = np.array([[0.5], [-0.25], [1.5], [-2.0]]) if blocks is None else blocks

    def renderer(self, condition: Any, *, by_string: bool = False) -> Renders:
        return self

    def blocks(self, n: int) -> list[Any]:
        return [self.sound[:2], self.sound[2:]]

    def summary(self) -> Any:
        return SimpleNamespace(warnings=["loud"])


@pytest.mark.parametrize(
    ("level", "duration", "expected", "gain", "clipped"),
    [
        ("calibrated", None, [0.5, -0.25, 1.5, -2.0], 0.0, 2),
        ("calibrated", 0.3, [0.5, -0.25, 1.5], 0.0, 1),
        ("calibrated", 0.6, [0.5, -0.25, 1.5, -2.0, 0.0, 0.0], 0.0, 2),
        ("peak", None, np.array([0.5, -0.25, 1.5, -2.0]) / 2 * 10 ** (-1 / 20), -1 - 20 * math.log10(2), 0),
    ],
)
def test_a_sound_at_its_level(
    monkeypatch: pytest.MonkeyPatch, level: str, duration: float | None, expected: Any, gain: float, clipped: int
) -> None:
    monkeypatch.setattr("tonewood.workshop.dataset.sound.played", lambda *given: ())
    sound = sound_of(Renders(), SimpleNamespace(name="s"), level, False, duration)  # type: ignore[arg-type]
    np.testing.assert_allclose(sound.stems[""][:, 0], expected)
    assert (sound.gain_db, sound.clipped) == (pytest.approx(gain), {"": clipped})
    assert (sound.fs, sound.channels, sound.dropped, sound.warnings) == (
        10,
        ("left",),
        ("1.235 s: too low",),
        ("loud",),
    )


def test_sounds_without_samples_or_numbers_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tonewood.workshop.dataset.sound.played", lambda *given: ())
    condition: Any = SimpleNamespace(name="s")
    for wrong in (np.zeros((0, 1)), np.array([[1.0], [np.nan]])):
        with pytest.raises(NumericalError, match="s: the sound is empty, or not finite"):
            sound_of(Renders(wrong), condition, "peak", False, None)  # type: ignore[arg-type]
    wide = Renders()
    wide.channels = tuple("abcdefghi")  # type: ignore[assignment]
    with pytest.raises(TonewoodError, match="s: has 9 channels; FLAC holds up to 8"):
        sound_of(wide, condition, "peak", False, None)  # type: ignore[arg-type]
    soft = sound_of(Renders(np.full((4, 1), 0.01)), condition, "peak", False, None)  # type: ignore[arg-type]
    assert (soft.gain_db, soft.clipped) == (pytest.approx(39.0), {"": 0})
    silent = sound_of(Renders(np.zeros((4, 1))), condition, "peak", False, None)  # type: ignore[arg-type]
    assert (silent.gain_db, silent.clipped) == (0.0, {"": 0})


@pytest.mark.parametrize(
    ("note", "velocity"),
    [
        ({"velocity_midi": 63.4}, 63),
        ({"velocity_midi": 0.0}, 1),
        ({"force": 2.52}, 25),
        ({"force": 99.0}, 127),
        ({"force": 0.0}, 1),
        ({}, 64),
    ],
)
def test_a_label_tells_what_was_played(note: dict[str, Any], velocity: int) -> None:
    """Forces of a tenth of the velocity; a gesture's place counts before that of the note."""
    string = SimpleNamespace(length=lambda stop: 0.65 - 0.01 * stop)
    curve = SimpleNamespace(value=lambda v: 0.1 * v)
    model = SimpleNamespace(strings={"A": string}, playing=SimpleNamespace(velocity=curve, default_exciter="pluck"))
    renderer: Any = SimpleNamespace(model=model, fs=1000, zero_frame=7)
    given = Note(0.25, 1.0, from_bridge=0.2, angle_deg=30.0, note=45.0, **note)
    assigned: Any = SimpleNamespace(note=given, string="A", stop=5, end=0.75, cents=50.0)
    plain = _label(renderer, assigned, {}, 50.0)
    assert plain == PlayedNote(
        "A", 5.0, 257.0, 257, 0.5, 50.5, "pluck", note.get("force"), velocity, 0.2, 0.6, 30.0
    )  # fmt: skip
    gesture = SimpleNamespace(from_bridge=0.1, angle_deg=None)
    play: Any = SimpleNamespace(gesture=gesture, exciter="nail")
    of_play = _label(renderer, assigned, {("A", 0.25): play}, None)
    assert (of_play.from_bridge, of_play.angle_deg, of_play.technique, of_play.pitch) == (0.1, None, "nail", 45.5)
    assigned.note = Note(0.25, 1.0, freq=110.0, **note)
    assert _label(renderer, assigned, {}, None).pitch == 0.5  # of a note without a number
    assigned.end = 0.1
    assert _label(renderer, assigned, {}, 50.0).duration == 0.0


# -- shards -----------------------------------------------------------------------------------------------------------


def shard(monkeypatch: pytest.MonkeyPatch, subtype: str = "PCM_24", count: int = 3, **sounds: Any) -> tuple[Any, Shard]:
    """A shard of sounds of 5 samples with a stem of 3; the second one fails."""

    def sound(renderer: Any, condition: Any, level: str, by_string: bool, duration: float | None) -> Sound:
        if condition.name.endswith("1"):
            raise TonewoodError("too hard", key="body")
        if condition.name.endswith("3"):
            raise ZeroDivisionError("a plugin")
        mix = np.array([[0.0, 0.5], [0.25, 0.0], [2.0, -2.0], [0.0, 0.0], [0.0, 0.0]])
        notes = (played(),) if condition.name.endswith("0") else ()
        return Sound({"": mix, "A": mix[:3, :1]}, 16000, ("l", "r"), notes, ("1.000 s: low",), -3.0, {"": 2, "A": 1},
                     ("loud",))  # fmt: skip

    monkeypatch.setattr("tonewood.workshop.dataset.shards.sound_of", sound)
    data = dataset(sampling="random", size=count, sounds={"subtype": subtype, **sounds},
                   parameters={"p": {"path": "note.force", "uniform": [1.0, 2.0]}})  # fmt: skip
    renderer: Any = SimpleNamespace(identity=lambda condition: {"n": condition.name}, allow_code=False)
    task = ShardTask(7, data, tuple(samples(data, Path())), renderer, "by")
    return task, make(task)


@pytest.mark.parametrize(("subtype", "bits"), [("PCM_16", 16), ("PCM_24", 24)])
def test_sounds_stand_one_after_the_other_in_a_shard(monkeypatch: pytest.MonkeyPatch, subtype: str, bits: int) -> None:
    import pyarrow.parquet as pq

    task, made_of = shard(monkeypatch, subtype, 4)
    assert set(made_of.files) == {"00007.flac", "00007.parquet", "00007.notes.parquet", "00007.labels.zip"}
    assert [f.name for f in made_of.faults] == ["m/one/000001", "m/one/000003"]
    assert [f.reason for f in made_of.faults] == ["body: too hard", "ZeroDivisionError: a plugin"]
    rows = pq.read_table(io.BytesIO(made_of.files["00007.parquet"])).to_pylist()
    assert [(r["sound"], r["stem"], r["start"], r["frames"]) for r in rows] == [
        ("m/one/000000", "", 0, 5), ("m/one/000000", "A", 5, 3),
        ("m/one/000002", "", 8, 5), ("m/one/000002", "A", 13, 3),
    ]  # fmt: skip
    heard, fs = soundfile.read(io.BytesIO(made_of.files["00007.flac"]), dtype="int32", always_2d=True)
    heard >>= 32 - bits
    assert (fs, heard.shape) == (16000, (16, 2))
    full = 2 ** (bits - 1)
    for row in rows:
        width = 2 if row["stem"] == "" else 1
        own = heard[row["start"] : row["start"] + row["frames"], :width]
        expected = np.array([[0.0, 0.5], [0.25, 0.0], [1.0, -1.0], [0.0, 0.0], [0.0, 0.0]])[: row["frames"], :width]
        assert np.abs(own - full * expected).max() <= 4  # dither of two steps, and two that are left to it
        assert row["peak"] == np.abs(own).max() / full
        assert row["sha256"] == hashlib.sha256(np.ascontiguousarray(own, dtype="<i4").tobytes()).hexdigest()
    assert not heard[5:8, 1].any()
    first = rows[0]
    told = {"index": 0, "instrument": "m", "score": "one", "channels": "l,r", "gain_db": -3.0, "clipped": 2, "notes": 1,
            "dropped": 1, "file": "00007.flac", "fs": 16000, "p.p": task.samples[0].parameters["p"]}  # fmt: skip
    assert {key: first[key] for key in told} == told
    assert [row["clipped"] for row in rows] == [2, 1, 2, 1]
    assert made_of.seconds == pytest.approx(2 * 5 / 16000)
    resolved = json.dumps(tw.load_instrument("monochord").resolved, sort_keys=True, default=str).encode()
    assert first["physics"] == hashlib.sha256(resolved).hexdigest()[:16]
    assert made_of.physics == {f"{first['physics']}.json": resolved}
    assert made_of.notes[:4] == (
        "m/one/000000: loud", "m/one/000000: 1.000 s: low",
        "m/one/000000: 2 samples clipped; lower render.gain_db, or take sounds: {level: peak}",
        "m/one/000000: 1 samples of the stem A clipped; take sounds: {level: calibrated} with a lower render.gain_db",
    )  # fmt: skip
    (note,) = pq.read_table(io.BytesIO(made_of.files["00007.notes.parquet"])).to_pylist()
    assert (note["sound"], note["string"], note["onset"]) == ("m/one/000000", "A", 100.0)
    with zipfile.ZipFile(io.BytesIO(made_of.files["00007.labels.zip"])) as archive:
        assert archive.namelist() == [f"m/one/00000{k}.{kind}" for k in (0, 2) for kind in ("jams", "mid")]
        assert json.loads(archive.read("m/one/000000.jams"))["file_metadata"]["duration"] == 5 / 16000
    assert _digests(made_of) == {
        f"{r['sound']}.{r['stem']}".rstrip("."): r["sha256"] for r in rows
    }  # fmt: skip


def test_labels_are_written_as_wanted(monkeypatch: pytest.MonkeyPatch) -> None:
    assert "00007.labels.zip" not in shard(monkeypatch, labels=[])[1].files
    with zipfile.ZipFile(io.BytesIO(shard(monkeypatch, labels=["midi"])[1].files["00007.labels.zip"])) as archive:
        assert archive.namelist() == ["m/one/000000.mid", "m/one/000002.mid"]


def test_a_zip_is_the_same_whenever_it_is_made() -> None:
    found = zipped({"b": b"2", "a": b"1" * 500})
    assert found == zipped({"a": b"1" * 500, "b": b"2"})
    with zipfile.ZipFile(io.BytesIO(found)) as archive:
        entries = archive.infolist()
        assert [(e.filename, e.date_time, e.external_attr >> 16) for e in entries] == [
            (name, (1980, 1, 1, 0, 0, 0), 0o644) for name in "ab"
        ]
        assert entries[0].compress_size < 100
        assert archive.read("a") == b"1" * 500
    assert shard_name(12) == "00012"


def test_a_shard_is_made_where_all_of_it_stands_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    stem = {"sound": "s", "stem": "", "sha256": "ab"}
    whole = Shard(3, {"00003.flac": b"f", "00003.parquet": parquet([stem])}, {"p.json": b"{}"}, 1.5, (), ())
    place = tmp_path / "shards"
    place.mkdir()
    (place / "00003.old").write_text("")
    (place / "00004.flac").write_text("")
    _write(tmp_path, whole, "key", "plucks")
    assert {p.name for p in place.iterdir()} == {"00003.flac", "00003.parquet", "00003.json", "00004.flac"}
    assert (tmp_path / "physics" / "p.json").read_bytes() == b"{}"
    record = json.loads((place / "00003.json").read_text())
    assert (record["key"], record["seconds"], record["failed"], record["sounds"]) == ("key", 1.5, [], {"s": "ab"})
    assert record["files"]["00003.flac"] == hashlib.sha256(b"f").hexdigest()
    assert _is_made(tmp_path, 3, "key")
    assert not _is_made(tmp_path, 3, "other")
    assert not _is_made(tmp_path, 4, "key")
    (place / "00003.flac").write_bytes(b"g")
    assert not _is_made(tmp_path, 3, "key")
    _write(tmp_path, Shard(3, whole.files, {}, 1.5, (Fault("x", "why"),), ()), "key", "plucks")
    assert json.loads((place / "00003.json").read_text())["failed"] == [{"name": "x", "reason": "why"}]
    assert not _is_made(tmp_path, 3, "key")


def test_a_set_is_made_in_a_folder_of_folders(tmp_path: Path) -> None:
    data = dataset(render={"fs": 16000, "max_duration": 0.02, "effects": "none"}, sounds={"labels": []})
    seen: list[Any] = []
    report = run_dataset(
        data, tmp_path, tmp_path / "a" / "b", EngineRenderer(), progress=lambda *step: seen.append(step)
    )
    assert seen == [("shards", 1, 1)]
    assert (report.ok, report.made, report.reused, report.sounds) == (True, 1, 0, 1)
    assert report.sound_seconds == pytest.approx(0.02)
    again = run_dataset(data, tmp_path, tmp_path / "a" / "b", EngineRenderer())
    assert (again.made, again.reused, again.sha256) == (0, 1, report.sha256)
    assert {"schema", "instruments"} <= set(dataset_schema()["properties"])
    unknown = dataset(parameters={"p": {"path": "strings.A2.tenson", "values": [60.0]}})
    with pytest.raises(ManifestError, match="no sound can be resolved"):
        plan_dataset(unknown, tmp_path, tmp_path / "c", EngineRenderer())


def test_sounds_that_failed_are_not_counted_and_made_again(tmp_path: Path) -> None:
    """Three sounds in two shards, of which the second sound cannot be: its shard is not finished."""
    data = dataset(
        parameters={"p": {"path": "strings.A2.tension", "values": [60.0, -1.0, 55.0]}}, sounds={"per_shard": 2},
        render={"fs": 16000, "max_duration": 0.02, "effects": "none"}, sampling="grid", size=None,
    )  # fmt: skip
    for made_before in (0, 1):
        report = run_dataset(data, tmp_path, tmp_path / "out", EngineRenderer())
        assert (report.ok, report.sounds, report.made, report.reused) == (False, 2, 2 - made_before, made_before)
        assert len(report.faults) == 1
        assert "strings.A2.tension" in report.faults[0].reason
        assert report.sound_seconds == pytest.approx(0.04)


def test_sounds_that_cannot_be_resolved_are_named(tmp_path: Path) -> None:
    data = dataset(parameters={"p": {"path": "strings.A2.tension", "values": [60.0, -1.0]}})
    found = plan_dataset(data, tmp_path, tmp_path / "out", EngineRenderer())
    wrong = [s.condition.name for s in found.samples if s.parameters["p"] == -1.0]
    assert [f.name for f in found.faults] == wrong
    assert len(wrong) == 1
    assert "strings.A2.tension" in found.faults[0].reason
    assert len(found.samples) == 2


def test_sounds_are_counted_over_instruments_and_scores(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tonewood.workshop.dataset.sampling.MAX_SOUNDS", 6)
    two = BASE["scores"] | {"two": BASE["scores"]["one"]}
    assert len(samples(dataset(scores=two, sampling="random", size=3), Path())) == 6
    many = dataset(scores=two, instruments={"m": "monochord", "n": "monochord"}, sampling="random", size=2)
    with pytest.raises(ManifestError, match="8 sounds; 6 are allowed"):
        samples(many, Path())


# -- plans and records ------------------------------------------------------------------------------------------------


def plan(count: int = 11, **changes: Any) -> DatasetPlan:
    data = dataset(sampling="random", size=count, **changes)
    return DatasetPlan(data, tuple(samples(data, Path())), (), {0: "k", 1: "l"}, (Fault("x", "why"),))


def test_a_plan_in_numbers() -> None:
    made_of = DatasetPlan(**{**vars(plan()), "sound_seconds": 7200.0, "compute_seconds": 1800.0})
    assert made_of.summary() == {
        "name": "set", "sounds": 11, "shards": 2, "to_make": 0, "sound_hours": 2.0, "core_hours": 0.5,
        "sound_hours_per_core_hour": 4.0, "failed": [{"name": "x", "reason": "why"}],
    }  # fmt: skip
    assert plan().summary()["sound_hours"] is None
    report = DatasetReport("n", Path("f"), 1, 2, 3, 4.0, "ab", (Fault("x", "why", "long"),), ("note",), 5.0)
    assert not report.ok
    assert report.summary() == {
        "name": "n", "folder": "f", "made": 1, "reused": 2, "sounds": 3, "sound_seconds": 4.0, "sha256": "ab",
        "faults": [{"name": "x", "reason": "why"}], "notes": ["note"], "seconds": 5.0,
    }  # fmt: skip
    subject = _subject(plan(title="A set", licence="CC0-1.0"), 1.0, {"s": "ab"})
    assert (subject.name, subject.title, subject.licence, subject.digests) == ("set", "A set", "CC0-1.0", {"s": "ab"})
    facts = _subject(plan(), 12.34, {"s": "ab"}).facts
    assert facts == {"format": "FLAC, 16000 Hz, PCM_24", "length": "12.3 s in all", "level": "calibrated"}
    shards: Any = [{"files": {"a": "1"}, "sounds": {"s": 1, "t": 2}}, {"files": {}, "sounds": {"u": 3}}]
    record = _record(plan(), shards, "cd", 9.0, [Fault("y", "b"), Fault("x", "a")])
    assert (record["sounds"], record["seconds"], record["sounds_sha256"]) == (3, 9.0, "cd")
    assert (record["bundles"], record["shards"]) == (["monochord"], [{"a": "1"}, {}])
    assert [f["name"] for f in record["failed"]] == ["x", "y"]
    assert (record["manifest"]["schema"], record["manifest"]["size"]) == ("tonewood-batch/1", 11)
    assert "folder" not in record["manifest"]  # what is not there
    assert "duration" not in _subject(plan(), 1.0, {}).manifest["sounds"]
    assert _subject(plan(), 1.0, {}).manifest["schema"] == "tonewood-batch/1"


@pytest.mark.parametrize(
    ("frames", "length", "cost"),
    [
        (3000, 3.0, 1.0 + 2.0),  # whole: a second to make it, two to step it
        (6500, 15.0, 1.0 + 2.0 * 15.0 / 6.5),  # longer than 6 s: 20 s are expected, of which a tail of 10 s half
    ],
)
def test_time_of_a_set_is_that_of_six_of_its_sounds(
    monkeypatch: pytest.MonkeyPatch, frames: int, length: float, cost: float
) -> None:
    tried: list[int] = []
    clock = iter(range(10**6))

    def now() -> float:
        """0 1 3, 4 5 7, ...: a second to make a renderer, two to step it, none between."""
        k = next(clock)
        return float(k // 3 * 4 + (0, 1, 3)[k % 3])

    def renderer(condition: Any) -> Any:
        tried.append(int(condition.name[-6:]))
        blocks = [np.zeros((500, 1))] * (frames // 500)
        return SimpleNamespace(
            fs=1000, blocks=lambda n: blocks, expected_duration=20.0, options=SimpleNamespace(tail=10.0)
        )

    monkeypatch.setattr("tonewood.workshop.dataset.runner.time.process_time", now)
    fake: Any = SimpleNamespace(renderer=renderer)
    found = _predicted(plan(), fake)
    assert tried == [0, 0, 2, 4, 6, 8, 10]  # the first one warms up
    assert found.sound_seconds == pytest.approx(11 * length)
    assert found.compute_seconds == pytest.approx(11 * cost)
    twice = _predicted(plan(sounds={"stems": "string", "duration": 4.0}), fake)
    assert twice.sound_seconds == 44.0
    assert twice.compute_seconds == pytest.approx(2 * 11 * cost)
    one = _predicted(plan(1), fake)
    assert one.sound_seconds == pytest.approx(length)

    def fail(condition: Any) -> Any:
        raise TonewoodError("no")

    failing = _predicted(plan(), SimpleNamespace(renderer=fail))  # type: ignore[arg-type]
    assert failing.sound_seconds is None
    named = {f.name: f.reason for f in plan().faults} | {f"m/one/{k:06d}": "no" for k in (0, 2, 4, 6, 8, 10)}
    assert {f.name: f.reason for f in failing.faults} == named


def test_a_shard_of_nothing_has_no_files(monkeypatch: pytest.MonkeyPatch) -> None:
    task, _ = shard(monkeypatch, count=2)
    _, *failing = task.samples
    made_of = make(ShardTask(7, task.dataset, tuple(failing), task.renderer, "by"))
    assert (made_of.files, made_of.physics, made_of.seconds, len(made_of.faults)) == ({}, {}, 0, 1)
