"""Data sets: the same bits whoever makes them, and labels that the sound itself confirms."""

from __future__ import annotations

import hashlib
import io
import itertools
import json
import os
import shutil
import subprocess
import sys
import zipfile
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import mido
import numpy as np
import pytest
import soundfile
from scipy.stats import kstest

import tonewood as tw
from tonewood.errors import OutputError
from tonewood.workshop.batch.manifest import ManifestError
from tonewood.workshop.batch.rendering import EngineRenderer
from tonewood.workshop.batch.workers import Workers
from tonewood.workshop.dataset import runner
from tonewood.workshop.dataset import sampling as sampling_module
from tonewood.workshop.dataset.labels import midi
from tonewood.workshop.dataset.manifest import Dataset, check_dataset, midi_clock
from tonewood.workshop.dataset.runner import RECORD, SHARDS, plan_dataset, run_dataset
from tonewood.workshop.dataset.sampling import points, samples
from tonewood.workshop.dataset.shards import parquet
from tonewood.workshop.dataset.sound import PlayedNote

pq = pytest.importorskip("pyarrow.parquet")

FS = 16000
BASE: dict[str, Any] = {
    "schema": "tonewood-batch/1",
    "kind": "dataset",
    "name": "plucks",
    "seed": 5,
    "instruments": {"harp": "african_harp"},
    "scores": {"two": {"phrase": [
        {"time": 0.02, "duration": 0.1, "string": "s4"}, {"time": 0.08, "duration": 0.1, "string": "s1", "stop": 0},
    ]}},
    "sampling": "random",
    "size": 5,
    "parameters": {
        "place": {"path": "note.from_bridge", "uniform": [0.05, 0.2]},
        "force": {"path": "note.force", "log_uniform": [0.5, 2.0]},
    },
    "render": {"fs": FS, "max_duration": 0.2, "effects": "none"},
    "sounds": {"per_shard": 2},
}  # fmt: skip


def made(folder: Path, workers: Workers | None = None, **changes: Any) -> tuple[Path, Any]:
    report = run_dataset(check_dataset(BASE | changes), folder, folder / "out", EngineRenderer(), workers)
    assert report.ok, report.faults
    return folder / "out", report


def bits(folder: Path) -> dict[str, str]:
    """SHA-256 of every file of a data set."""
    paths = [p for p in folder.rglob("*") if p.is_file() and not p.name.startswith(".")]
    return {str(p.relative_to(folder)): hashlib.sha256(p.read_bytes()).hexdigest() for p in paths}


def table(folder: Path, pattern: str = "[0-9]*[0-9].parquet") -> list[dict[str, Any]]:
    return [row for path in sorted((folder / SHARDS).glob(pattern)) for row in pq.read_table(path).to_pylist()]


@pytest.mark.parametrize("name", [b"caf\xe9.mid", b"a\nb.mid", b"a\\b.mid", b"\x7f.MIDI"])
def test_scores_whose_names_are_no_names_of_labels_are_refused(tmp_path: Path, name: bytes) -> None:
    (tmp_path / "music").mkdir()
    with open(os.path.join(os.fsencode(tmp_path), b"music", name), "wb") as stream:
        stream.write(b"")
    with pytest.raises(ManifestError, match="UTF-8 without control characters and backslashes is allowed") as fault:
        samples(check_dataset({**BASE, "scores": {}, "folder": "music"}), tmp_path)
    assert str(fault.value).isascii()


def test_names_that_differ_by_case_alone_are_refused(tmp_path: Path) -> None:
    """Their labels would replace each other where they are unpacked on macOS or Windows."""
    (tmp_path / "music").mkdir()
    for name in ("Study", "study", "other"):
        (tmp_path / "music" / f"{name}.mid").write_bytes(b"")
    two = check_dataset({**BASE, "scores": {}, "folder": "music"})
    with pytest.raises(ManifestError, match=r"^scores: Study and study differ by case alone"):
        samples(two, tmp_path)
    both = check_dataset({**BASE, "instruments": {"harp": "african_harp", "Harp": "african_harp"}})
    with pytest.raises(ManifestError, match=r"^instruments: harp and Harp differ by case alone"):
        samples(both, tmp_path)


@pytest.fixture(scope="module")
def alone(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Any]:
    return made(tmp_path_factory.mktemp("one"))


@pytest.mark.slow
def test_two_workers_make_the_same_bytes_as_one(tmp_path: Path, alone: tuple[Path, Any]) -> None:
    folder, report = made(tmp_path, Workers(2))
    assert bits(folder) == bits(alone[0])
    assert len(bits(folder)) > 12
    assert report.sha256 == alone[1].sha256


def test_a_sound_does_not_depend_on_its_shard(tmp_path: Path, alone: tuple[Path, Any]) -> None:
    _, report = made(tmp_path, sounds={"per_shard": 4})
    assert report.sha256 == alone[1].sha256


def test_more_sounds_do_not_move_the_first_ones(tmp_path: Path, alone: tuple[Path, Any]) -> None:
    folder, _ = made(tmp_path, size=7)
    digests = {row["sound"]: row["sha256"] for row in table(folder)}
    first = {row["sound"]: row["sha256"] for row in table(alone[0])}
    assert {name: digests[name] for name in first} == first


def test_an_unfinished_set_is_taken_up_again(tmp_path: Path, alone: tuple[Path, Any]) -> None:
    folder, _ = made(tmp_path)
    (folder / SHARDS / "00001.json").unlink()  # a kill before the record was written
    damaged = folder / SHARDS / "00002.flac"
    damaged.write_bytes(damaged.read_bytes()[:-100])
    plan = plan_dataset(check_dataset(BASE), tmp_path, folder, EngineRenderer())
    assert [task.number for task in plan.tasks] == [1, 2]
    _, report = made(tmp_path)
    assert (report.made, report.reused) == (2, 1)
    assert bits(folder) == bits(alone[0])


def test_a_smaller_set_leaves_no_shard_behind(tmp_path: Path) -> None:
    made(tmp_path)
    folder, _ = made(tmp_path, size=2)
    assert {path.name.partition(".")[0] for path in (folder / SHARDS).iterdir()} == {"00000"}


@pytest.mark.parametrize(
    "damage", [{"sounds": [1]}, {"seconds": "x"}, {"files": {}}, {"physics": None}], ids=lambda damage: str(*damage)
)
def test_a_shard_with_a_damaged_record_is_made_again(
    tmp_path: Path, alone: tuple[Path, Any], damage: dict[str, Any]
) -> None:
    folder = tmp_path / "out"
    shutil.copytree(alone[0], folder)
    path = folder / SHARDS / "00002.json"
    path.write_text(json.dumps({k: v for k, v in {**json.loads(path.read_text()), **damage}.items() if v is not None}))
    assert [t.number for t in plan_dataset(check_dataset(BASE), tmp_path, folder, EngineRenderer()).tasks] == [2]


def test_shards_without_the_parameters_of_their_sounds_are_made_again(tmp_path: Path, alone: tuple[Path, Any]) -> None:
    folder = tmp_path / "out"
    shutil.copytree(alone[0], folder)
    shutil.rmtree(folder / "physics")
    assert len(plan_dataset(check_dataset(BASE), tmp_path, folder, EngineRenderer()).tasks) == 3


def test_a_set_does_not_remove_another_one_nor_files_of_others(tmp_path: Path, alone: tuple[Path, Any]) -> None:
    folder = tmp_path / "out"
    shutil.copytree(alone[0], folder)
    (folder / SHARDS / "notes.txt").write_text("of the user")
    before = bits(folder)
    with pytest.raises(OutputError, match="holds the data set 'plucks'; take another folder"):
        made(tmp_path, name="scales", size=2)
    assert bits(folder) == before
    made(tmp_path, size=2)
    assert (folder / SHARDS / "notes.txt").read_text() == "of the user"
    assert not list((folder / SHARDS).glob("00001.*"))


def test_the_index_finds_every_sound_and_its_hash(alone: tuple[Path, Any]) -> None:
    rows = table(alone[0])
    assert len(rows) == 5
    for row in rows:
        path = alone[0] / SHARDS / row["file"]
        samples_, fs = soundfile.read(path, start=row["start"], frames=row["frames"], dtype="int32", always_2d=True)
        assert fs == row["fs"] == FS
        digest = hashlib.sha256(np.ascontiguousarray(samples_ >> 8, dtype="<i4").tobytes()).hexdigest()
        assert digest == row["sha256"]
        assert 0.05 <= row["p.place"] <= 0.2
        physics = json.loads((alone[0] / "physics" / f"{row['physics']}.json").read_text())
        assert "strings" in physics


def test_labels_are_those_of_the_sound(alone: tuple[Path, Any]) -> None:
    """Onsets are where the sound begins, place and force those asked for; MIDI and JAMS say the same."""
    notes = table(alone[0], "*.notes.parquet")
    sounds = {row["sound"]: row for row in table(alone[0])}
    assert len(notes) == 10
    for note in notes:
        row = sounds[note["sound"]]
        assert note["from_bridge"] == pytest.approx(row["p.place"])
        assert note["force"] == pytest.approx(row["p.force"])
    for row in sounds.values():
        own = [note for note in notes if note["sound"] == row["sound"]]
        assert [note["onset_frame"] for note in own] == [round(0.02 * FS), round(0.08 * FS)]
        assert [note["string"] for note in own] == ["s4", "s1"]
        heard, _ = soundfile.read(alone[0] / SHARDS / row["file"], start=row["start"], frames=row["frames"])
        before, after = heard[: own[0]["onset_frame"]], heard[own[0]["onset_frame"] :][:200]
        assert np.abs(after).max() > 5 * np.abs(before).max()
        with zipfile.ZipFile(alone[0] / SHARDS / f"{row['file'][:5]}.labels.zip") as archive:
            file = mido.MidiFile(file=io.BytesIO(archive.read(f"{row['sound']}.mid")))
            data = json.loads(archive.read(f"{row['sound']}.jams"))
        found = {}
        for track in file.tracks[1:]:
            at, facts = 0, {}
            for message in track:
                at += message.time
                if message.type == "text":
                    facts = dict(word.split("=") for word in message.text.split())
                if message.type == "note_on":
                    found[track.name] = (at, message.note, float(facts["from_bridge"]))
        tempo = next(m.tempo for m in file.tracks[0] if m.type == "set_tempo")
        assert file.ticks_per_beat * 1_000_000 == tempo * FS  # a tick is a sample
        for note in own:
            at, key, place = found[note["string"]]
            assert (at, key) == (note["onset_frame"], round(note["pitch"]))
            assert place == pytest.approx(note["from_bridge"])
        times = {a["annotation_metadata"]["data_source"]: a["data"][0]["time"] for a in data["annotations"]}
        assert times == {note["string"]: note["onset"] / FS for note in own}


def test_midi_has_every_note_of_many_strings_sample_for_sample() -> None:
    """Keys within 0 to 127, channels again from 0 after 16 strings, a note of no length lasts a sample."""
    note = PlayedNote("s0", 0.0, 100.0, 100, 0.05, 60.4, "pluck", 1.5, 90, 0.1, 0.65, None)
    strings = [replace(note, string=f"s{k}", pitch=60.4 + k) for k in range(18)]
    more = [
        replace(note, onset=2000.6, onset_frame=2001, pitch=-2.0, duration=0.0),
        replace(note, onset=3000.0, onset_frame=3000, pitch=130.0),
    ]
    file = mido.MidiFile(file=io.BytesIO(midi([*strings, *more], FS)))
    assert [track.name for track in file.tracks[1:]] == [n.string for n in strings]
    for k, track in enumerate(file.tracks[1:]):
        at, told = 0, []
        for message in track:
            at += message.time
            if message.type in ("note_on", "note_off"):
                told.append((message.type == "note_on", at, message.note, message.velocity, message.channel))
        channel = k % 16
        expected = [(True, 100, 60 + k, 90, channel), (False, 100 + FS // 20, 60 + k, 0, channel)]
        if k == 0:
            expected += [(True, 2001, 0, 90, 0), (False, 2002, 0, 0, 0)]
            expected += [(True, 3000, 127, 90, 0), (False, 3000 + FS // 20, 127, 0, 0)]
        assert told == expected


def test_each_sound_can_be_brought_to_its_peak(tmp_path: Path, alone: tuple[Path, Any]) -> None:
    """To -1 dB re full scale; otherwise the instrument's own level stays."""
    out, _ = made(tmp_path, sounds={"per_shard": 2, "level": "peak"})
    assert [row["peak"] for row in table(out)] == pytest.approx([10 ** (-1 / 20)] * 5, abs=1e-5)
    assert max(row["peak"] for row in table(alone[0])) < 0.8


def test_time_and_length_of_a_set_are_foretold_from_a_few_sounds(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """On a clock of a second a look: one to make a renderer, one to step it; stems by string are made twice."""
    ticks = itertools.count()
    monkeypatch.setattr(runner, "time", SimpleNamespace(process_time=lambda: float(next(ticks))))
    for sounds, passes in (({}, 1), ({"stems": "string"}, 2)):
        data = check_dataset(BASE | {"sounds": sounds})
        plan = plan_dataset(data, tmp_path, tmp_path / "out", EngineRenderer(), predict=True)
        assert plan.sound_seconds == pytest.approx(5 * 0.2, rel=0.01)
        assert plan.compute_seconds == pytest.approx(5 * 2.0 * passes)
        assert plan.hours_per_core_hour == pytest.approx(0.2 / (2.0 * passes), rel=0.01)
    longer = check_dataset(BASE | {"sounds": {"duration": 3.0}})
    plan = plan_dataset(longer, tmp_path, tmp_path / "out", EngineRenderer(), predict=True)
    assert plan.sound_seconds == pytest.approx(15.0)
    unknown = plan_dataset(longer, tmp_path, tmp_path / "out", EngineRenderer())
    assert (unknown.sound_seconds, unknown.hours_per_core_hour) == (None, None)


def test_columns_of_a_table_keep_their_kinds() -> None:
    """Numbers are numbers, whole ones where all are; two kinds, lists and mappings are JSON; nothing is a number."""
    rows = [
        {"a": 1, "b": 1, "c": 1, "d": [1], "e": None, "f": True, "g": "x", "h": "x", "i": [1]},
        {"a": 2, "b": 2.5, "c": "two", "d": {"k": 2}, "e": None, "f": None, "g": None, "h": 3.0, "i": [2, 3]},
    ]
    found = pq.read_table(io.BytesIO(parquet(rows)))
    assert found.to_pylist() == [
        {"a": 1, "b": 1.0, "c": "1", "d": "[1]", "e": None, "f": True, "g": "x", "h": '"x"', "i": "[1]"},
        {"a": 2, "b": 2.5, "c": '"two"', "d": '{"k": 2}', "e": None, "f": None, "g": None, "h": "3.0", "i": "[2, 3]"},
    ]
    assert [str(found.schema.field(name).type) for name in "abef"] == ["int64", "double", "double", "bool"]
    seeds = [{"a": 2**63 - 1, "b": 2**63, "c": 10**400}, {"a": -(2**63), "b": 1, "c": 0.5}]
    assert pq.read_table(io.BytesIO(parquet(seeds))).to_pylist() == [
        {"a": 2**63 - 1, "b": str(2**63), "c": str(10**400)}, {"a": -(2**63), "b": "1", "c": "0.5"}
    ]  # fmt: skip


def test_too_many_sounds_are_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sampling_module, "MAX_SOUNDS", 5)
    assert len(samples(dataset(), Path())) == 5
    with pytest.raises(ManifestError, match="10 sounds; 5 are allowed"):
        samples(dataset(instruments={"a": "african_harp", "b": "african_harp"}), Path())
    with pytest.raises(ManifestError, match="6 sounds; 5 are allowed"):
        samples(dataset(size=6), Path())


def test_jams_is_read_by_its_own_library(alone: tuple[Path, Any], tmp_path: Path) -> None:
    jams = pytest.importorskip("jams")
    with zipfile.ZipFile(alone[0] / SHARDS / "00000.labels.zip") as archive:
        name = next(n for n in archive.namelist() if n.endswith(".jams"))
        (tmp_path / "a.jams").write_bytes(archive.read(name))
    found = jams.load(str(tmp_path / "a.jams"), validate=True, strict=True)
    assert found.validate()
    (first, second) = found.search(namespace="note_midi")
    assert first.annotation_metadata.data_source == "s4"
    assert second.sandbox.notes[0]["onset_frame"] == round(0.08 * FS)


def test_stems_sum_to_the_mix(tmp_path: Path) -> None:
    folder, _ = made(tmp_path, size=1, sounds={"stems": "string"})
    rows = {row["stem"]: row for row in table(folder)}
    path = folder / SHARDS / rows[""]["file"]
    heard = {s: soundfile.read(path, start=r["start"], frames=r["frames"])[0] for s, r in rows.items()}
    mix = heard.pop("")
    assert {"s1", "s4"} <= set(heard)
    assert np.abs(sum(heard.values()) - mix).max() < len(rows) * 2.0**-22  # dither of each


def dataset(**changes: Any) -> Dataset:
    return check_dataset(BASE | changes)


def test_points_fill_the_ranges() -> None:
    ranges = {
        "a": {"path": "note.force", "log_uniform": [0.1, 10.0]},
        "b": {"path": "note.from_bridge", "uniform": [0.0, 1.0]},
        "c": {"path": "note.string", "values": ["x", "y", "z"]},
    }
    spread = {}
    for sampling in ("random", "sobol"):
        rows = list(points(dataset(sampling=sampling, size=512, parameters=ranges), ("i", "s")))
        assert kstest([np.log10(r["a"]) for r in rows], "uniform", (-1.0, 2.0)).pvalue > 1e-3
        counts = [sum(r["c"] == name for r in rows) for name in "xyz"]
        assert min(counts) > 140
        assert rows != list(points(dataset(sampling=sampling, size=512, parameters=ranges), ("i", "t")))
        spread[sampling] = kstest([r["b"] for r in rows], "uniform").statistic
    assert spread["sobol"] < 0.2 * spread["random"]
    grid = {name: p | {"steps": 3} if "values" not in p else p for name, p in ranges.items()}
    rows = list(points(dataset(sampling="grid", size=None, parameters=grid), ("i", "s")))
    assert len(rows) == 27
    assert sorted({r["a"] for r in rows}) == pytest.approx([0.1, 1.0, 10.0])
    assert sorted({r["b"] for r in rows}) == pytest.approx([0.0, 0.5, 1.0])


def test_a_folder_of_midi_files_gives_a_score_each(tmp_path: Path) -> None:
    for name in ("b", "sub/a"):
        path = tmp_path / "midi" / f"{name}.mid"
        path.parent.mkdir(parents=True, exist_ok=True)
        file = mido.MidiFile()
        played = [mido.Message("note_on", note=60, time=0), mido.Message("note_off", note=60, time=96)]
        file.tracks.append(mido.MidiTrack(played))
        file.save(path)
    found = samples(dataset(folder="midi", scores={}, size=2), tmp_path)
    assert [s.condition.score for s in found] == ["b", "b", "sub/a", "sub/a"]
    assert found[0].condition.note_changes.keys() == {"from_bridge", "force"}
    with pytest.raises(ManifestError, match="holds no MIDI files"):
        samples(dataset(folder="nothing"), tmp_path)


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"sampling": "grid", "size": None}, "parameters.place.steps: is missing"),
        ({"size": None}, "size: is missing"),
        ({"scores": {}}, "give scores, or a folder"),
        ({"parameters": {"x": {"path": "note.sharpness", "values": [1]}}}, "note.sharpness is not one of"),
        ({"parameters": {"x": {"path": "note.force", "values": [-1]}}}, "force"),
        ({"parameters": {"x": {"path": "render.fs", "values": [8000]}}}, "one rate"),
        ({"parameters": {"x": {"path": "note.force", "uniform": [2, 1]}}}, "low < high"),
        ({"vary": {"note.string": {"normal": 1}}}, "vary.note.string: is not one of note.time"),
        ({"render": {"fs": 47999}}, "no tick of one sample at 47999 Hz"),
        ({"pages": []}, "pages: is not a known key"),
    ],
)
def test_manifests_that_do_not_fit_are_one_line(changes: dict[str, Any], reason: str) -> None:
    data = {k: v for k, v in (BASE | changes).items() if v is not None}
    with pytest.raises(ManifestError) as fault:
        check_dataset(data, file=Path("d.yaml"))
    assert reason in str(fault.value)
    assert "\n" not in str(fault.value)


@pytest.mark.parametrize("fs", [8000, 16000, 22050, 32000, 44100, 48000, 88200, 96000, 192000])
def test_a_tick_of_midi_can_be_a_sample(fs: int) -> None:
    clock = midi_clock(fs)
    assert clock is not None
    ticks, tempo = clock
    assert ticks <= 32767
    assert ticks * 1_000_000 == tempo * fs


@pytest.mark.slow
def test_the_command_plans_and_makes_it(tmp_path: Path) -> None:
    path = tmp_path / "d.yaml"
    path.write_text(json.dumps(BASE | {"size": 2}))
    command = [sys.executable, "-m", "tonewood", "batch", str(path), "-o", str(tmp_path / "o"), "--jobs", "1"]
    planned = subprocess.run([*command, "--dry-run"], capture_output=True, text=True, check=True)
    assert "hours of sound per core-hour" in planned.stdout
    assert not (tmp_path / "o").exists()
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert "2 sounds" in done.stdout
    record = json.loads((tmp_path / "o" / RECORD).read_text())
    assert record["sounds"] == 2


@pytest.mark.validate
def test_a_dask_cluster_makes_the_same_bytes(tmp_path: Path, alone: tuple[Path, Any]) -> None:
    pytest.importorskip("distributed")
    made_cluster = "LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None)"
    lines = (f"c = {made_cluster}", "print(c.scheduler_address, flush=True)", "sys.stdin.read()")
    script = "from distributed import LocalCluster; import sys\nif __name__ == '__main__': " + "; ".join(lines)
    cluster = subprocess.Popen([sys.executable, "-c", script], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    try:
        assert cluster.stdout is not None
        address = cluster.stdout.readline().strip()
        folder, _ = made(tmp_path, Workers(cluster=address))
    finally:
        cluster.kill()
        cluster.wait()
    assert bits(folder) == bits(alone[0])


def test_clipped_samples_are_those_at_full_scale(tmp_path: Path) -> None:
    folder, _ = made(tmp_path, size=1, render=BASE["render"] | {"gain_db": 30.0})
    (row,) = table(folder)
    heard, _ = soundfile.read(folder / SHARDS / row["file"], start=row["start"], frames=row["frames"])
    assert row["clipped"] == np.count_nonzero(np.abs(heard) > 1 - 2.0**-21) > 10


def test_the_data_sheet_names_each_instrument_once(alone: tuple[Path, Any]) -> None:
    sheet = (alone[0] / "datasheet.md").read_text(encoding="utf-8")
    assert sheet.count(tw.load_instrument("african_harp").spec.title) == 1
