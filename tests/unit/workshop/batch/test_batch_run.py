from __future__ import annotations

import base64
import csv
import errno
import hashlib
import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import batch_fakes as fakes
import numpy as np
import pyarrow.parquet as pq
import pytest
import soundfile
from batch_fakes import FakeRenderer

from tonewood.errors import OutputError, TonewoodError
from tonewood.instrument.bundle.loading import Instrument
from tonewood.workshop.batch import runner, stimuli, trimming
from tonewood.workshop.batch.data_sheet import Subject, data_sheet
from tonewood.workshop.batch.manifest import ManifestError, Stimuli
from tonewood.workshop.batch.production import room_response
from tonewood.workshop.batch.runner import Report, plan_batch, run_batch
from tonewood.workshop.batch.stimuli import StimulusError
from tonewood.workshop.batch.store import Rendered, Store, content_key
from tonewood.workshop.batch.workers import Workers

SMALL = {
    "scores": {"low": fakes.BASE["scores"]["low"]},
    "factors": {"damping": fakes.BASE["factors"]["damping"]},
    "pages": [{"type": "mushra", "reference": {"damping": "complex"}, "anchors": [3500, 7000]}],
    "output": {"formats": ["test", "csv", "json"]},
}


def run(tmp_path: Path, name: str = "out", renderer: FakeRenderer | None = None, **changes) -> Report:
    path = fakes.write(tmp_path / f"{name}_in", fakes.manifest(**SMALL | changes))
    return run_batch(path, tmp_path / name, renderer or FakeRenderer())


def sounds(folder: Path) -> dict[str, bytes]:
    return {p.name: p.read_bytes() for p in sorted((folder / "stimuli").iterdir())}


def test_a_batch_from_manifest_to_pages(tmp_path: Path) -> None:
    path = fakes.write(tmp_path, fakes.manifest(output={"formats": ["test", "html", "csv", "json", "parquet"]}))
    seen: list[tuple[str, int, int]] = []
    report = run_batch(path, tmp_path / "out", FakeRenderer(), progress=lambda *step: seen.append(step))
    assert report.ok
    assert (report.rendered, report.reused) == (12, 0)
    assert len(report.files) == 12 + 4 + 8
    assert seen[11] == ("renders", 12, 12)
    assert seen[-1] == ("files", 48, 48)
    out = tmp_path / "out"
    assert {p.name for p in out.iterdir()} == {
        "stimuli", "test.json", "audition", "work", "audition.html", "key.json", "manifest.json", "manifest.csv",
        "manifest.parquet", "datasheet.md",
    }  # fmt: skip
    record = json.loads((out / "manifest.json").read_text())
    for row in record["files"]:
        samples, fs = soundfile.read(out / row["file"], dtype="int16", always_2d=True)
        assert fs == 48000
        assert soundfile.info(out / row["file"]).subtype == "PCM_16"
        assert samples.shape == (row["frames"], 1)
        assert hashlib.sha256(samples.astype("<i2").tobytes()).hexdigest() == row["sha256"]
        heard = stimuli.measured(samples / 2.0**15, fs)
        assert heard.lufs == pytest.approx(row["lufs"], abs=1e-9)
        if row["role"] == "sound":
            assert row["lufs"] == pytest.approx(-23.0 - row["page_drop_db"], abs=0.01)
        assert heard.true_peak_dbtp <= -1.0
        assert row["render"]["info"]["energy_residual"] == 1e-12
        assert row["identity"]["version"] == "1"
    lengths = {}
    for row in record["files"]:
        lengths.setdefault(row["group"], set()).add(row["frames"])
    assert all(len(found) == 1 for found in lengths.values())
    with (out / "manifest.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert [r["sha256"] for r in rows] == [r["sha256"] for r in record["files"]]
    assert rows[0]["levels.damping"] in ("complex", "proportional", "block")
    same = pq.read_table(out / "manifest.parquet").to_pylist()
    assert [row["gain_db"] for row in same] == [row["gain_db"] for row in record["files"]]
    assert [row["levels.damping"] for row in same] == [row["levels.damping"] for row in rows]


def test_blind_names_and_the_key(tmp_path: Path) -> None:
    report = run(tmp_path, output={"blind": True, "formats": ["test", "html"]})
    out = report.folder
    page = (out / "audition.html").read_text()
    for word in ("complex", "proportional", "=block", "damping="):
        assert word not in page
    key = json.loads((out / "key.json").read_text())
    assert {f"{code}.wav" for code in key["stimuli"]} == set(sounds(out))
    by_code = key["stimuli"]
    (trial,) = key["trials"].values()
    assert by_code[trial["reference"]]["levels"]["damping"] == "complex"
    heard = [by_code[c] for c in trial["stimuli"]]
    assert {s["levels"]["damping"] for s in heard if s["role"] == "sound"} == {"proportional", "block"}
    assert {s["role"] for s in heard} == {"sound", "anchor35", "anchor70"}


def test_the_audition_has_every_sound_and_keeps_names_apart(tmp_path: Path) -> None:
    evil = "</script><script>alert(1)</script>"
    page = {"type": "html", "name": evil, "group_by": ["score"], "reference": {"damping": "complex"}, "anchors": [3500]}
    report = run(tmp_path, pages=[page], output={"blind": True}, title=evil)
    text = (report.folder / "audition.html").read_text()
    assert text.count("<script") == 2
    assert "alert(1)</script>" not in text
    data = json.loads(re.search(r'id="data">(.*?)</script>', text, re.DOTALL)[1])
    assert data["sets"][0]["question"] == evil
    assert {s["code"] for s in data["sets"][0]["sounds"]} == {f.code for f in report.files}
    names = (report.folder / "audition" / "names.js").read_text()
    assert "harp.low.damping=complex" in names
    assert '"role": "anchor35"' in names
    for stranger in ("set9.js", "setup.js", "set1.txt"):
        (report.folder / "audition" / stranger).write_text("")
    run(tmp_path, pages=[page], output={"blind": True}, title=evil)
    sets = {path.name for path in (report.folder / "audition").iterdir()}
    assert sets >= {"set1.js", "setup.js", "set1.txt"}
    assert "set9.js" not in sets
    script = (report.folder / "audition" / "set1.js").read_text()
    sounds = json.loads(script.removeprefix("soundsOf(0, ").removesuffix(");\n"))
    for file in report.files:
        assert base64.b64decode(sounds[file.code]) == (report.folder / file.file).read_bytes()
    by_role = {f.role: f for f in report.files if "complex" in f.condition}
    assert by_role["anchor35"].gain_db == by_role["sound"].gain_db
    assert not (report.folder / "pictures").exists()
    assert data["pictures"] == ""


def test_pictures_are_drawn_on_request_and_removed_without_it(tmp_path: Path) -> None:
    page = {"type": "html", "group_by": ["score"], "reference": {"damping": "complex"}}
    report = run(tmp_path, pages=[page], output={"pictures": True})
    pictures = report.folder / "pictures"
    wanted = {f"{file.code}.png" for file in report.files}
    assert {path.name for path in pictures.iterdir()} == wanted | {"differences1.png"}
    assert all(path.read_bytes().startswith(b"\x89PNG") for path in pictures.iterdir())
    run(tmp_path, pages=[page])
    assert list(pictures.iterdir()) == []


def test_the_data_sheet_names_versions_hashes_licences_and_sources(tmp_path: Path) -> None:
    report = run(tmp_path, licence="CC-BY-4.0", seed=11)
    sheet = (report.folder / "datasheet.md").read_text()
    digests = sorted((f.code, f.sha256) for f in report.files)
    whole = hashlib.sha256(json.dumps(digests).encode()).hexdigest()
    for words in (f"| SHA-256 of all samples | `{whole}` |", "| licence of the sounds | CC-BY-4.0 |", "| seed | 11 |"):
        assert words in sheet
    citation = (Path(__file__).parents[4] / "CITATION.cff").read_text("utf-8")
    for doi in re.findall(r"doi:(10\S+)", sheet):
        assert doi in citation
    instrument = Instrument.load("classical_guitar")
    identity = {
        "bundle": instrument.content_hash, "plugins": instrument.plugin_hashes, "parameters": instrument.resolved,
        "version": "9.9", "isa": "avx2", "computed_with": {"numpy": "2.0", "blas": [{"name": "openblas"}]},
    }  # fmt: skip
    full = data_sheet(Subject("x", "", "", {"seed": 1}, {}, {}), [identity])
    assert instrument.content_hash in full
    assert instrument.spec.licence in full
    for source in instrument.spec.sources.values():
        assert source.text in full
        assert source.doi is None or source.doi in full
    for name, digest in instrument.plugin_hashes.items():
        assert f"| {name} | `{digest}` |" in full
    assert "| tonewood | 9.9 |" in full


def test_the_same_manifest_gives_the_same_bytes(tmp_path: Path) -> None:
    first, second = run(tmp_path, "a"), run(tmp_path, "b")
    assert sounds(first.folder) == sounds(second.folder)
    for name in ("key.json",):
        assert (first.folder / name).read_bytes() == (second.folder / name).read_bytes()
    other = run(tmp_path, "c", seed=8)
    assert not set(sounds(first.folder)) & set(sounds(other.folder))


@pytest.mark.slow
@pytest.mark.parametrize("workers", [Workers(2, "threads"), Workers(2, "processes")])
def test_workers_do_not_change_a_byte(tmp_path: Path, workers: Workers) -> None:
    alone = run(tmp_path, "alone")
    path = fakes.write(tmp_path, fakes.manifest(**SMALL))
    run_batch(path, tmp_path / "many", FakeRenderer(), workers)
    assert sounds(alone.folder) == sounds(tmp_path / "many")


@pytest.mark.slow
def test_worker_processes_follow_the_current_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Processes are kept from one batch to the next, relative paths are those of the caller."""
    for name in ("first", "second"):
        path = fakes.write(tmp_path / name, fakes.manifest(**SMALL))
        monkeypatch.chdir(path.parent)
        report = run_batch(Path(path.name), Path("out"), FakeRenderer(), Workers(2, "processes"))
        assert report.ok, report.faults
        assert sounds(tmp_path / name / "out")


def test_a_current_folder_that_was_removed_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)  # and back again at the end
    (tmp_path / "gone").mkdir()
    os.chdir("gone")
    (tmp_path / "gone").rmdir()
    with pytest.raises(TonewoodError, match="the current folder is not there any more"):
        list(Workers(2).each(str, [1, 2]))


def test_finished_renders_are_used_again(tmp_path: Path) -> None:
    log = tmp_path / "log"
    path = fakes.write(tmp_path, fakes.manifest(**SMALL))
    out = tmp_path / "out"
    run_batch(path, out, FakeRenderer(log=log))
    before = sounds(out)
    again = run_batch(path, out, FakeRenderer(log=log))
    assert (again.rendered, again.reused) == (0, 3)
    assert len(log.read_text().splitlines()) == 3
    assert sounds(out) == before
    other = run_batch(path, out, FakeRenderer(log=log, version="2"))
    assert other.rendered == 3
    (note,) = [n for n in other.notes if "not used" in n]
    assert note.startswith(f"3 renders in {out / 'work'} are not used: they were made of something else (parameters,")
    assert "version" in note


def test_a_damaged_render_is_made_again(tmp_path: Path) -> None:
    path = fakes.write(tmp_path, fakes.manifest(**SMALL))
    out = tmp_path / "out"
    run_batch(path, out, FakeRenderer())
    before = sounds(out)
    first, second, _ = sorted((out / "work").iterdir())
    first.write_bytes(first.read_bytes()[:1000])
    raw = bytearray(second.read_bytes())
    raw[len(raw) // 2] ^= 1
    second.write_bytes(bytes(raw))
    assert run_batch(path, out, FakeRenderer()).rendered == 2
    assert sounds(out) == before


def test_equal_conditions_are_rendered_once(tmp_path: Path) -> None:
    log = tmp_path / "log"
    levels = {"complex": 0.5, "proportional": 0.4, "same": 0.4}
    report = run(tmp_path, renderer=FakeRenderer(log=log), factors={"damping": {"path": "body.t60", "levels": levels}})
    assert len(log.read_text().splitlines()) == report.rendered == 2
    assert len(report.files) == 5


def test_files_of_an_earlier_seed_are_removed_and_strangers_kept(tmp_path: Path) -> None:
    out = run(tmp_path).folder
    (out / "stimuli" / "training.wav").write_bytes(b"mine")
    after = run(tmp_path, seed=9)
    assert set(sounds(out)) == {Path(f.file).name for f in after.files} | {"training.wav"}


def test_the_plan_writes_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its time is that of renders and files, shared among workers, which take time to start."""
    monkeypatch.setattr(runner, "trial_of_a_file", lambda settings, pictures: (0.1, 7.0))
    path = fakes.write(tmp_path, fakes.manifest(**SMALL))
    plan = plan_batch(path, tmp_path / "out", FakeRenderer(), Workers(1), predict=True)
    assert not (tmp_path / "out").exists()
    summary = plan.summary()
    assert (summary["to_render"], summary["files"], summary["trials"]) == (3, 5, 1)
    assert summary["predicted_seconds"] == pytest.approx(3 * 0.5 + 5 * 0.1)
    shared = plan_batch(path, tmp_path / "out", FakeRenderer(), Workers(2), predict=True)
    assert shared.seconds == pytest.approx((3 * 0.5 + 5 * 0.1) / 2 + 7.0)
    run_batch(path, tmp_path / "out", FakeRenderer())
    assert plan_batch(path, tmp_path / "out", FakeRenderer()).summary()["to_render"] == 0


@pytest.mark.slow
def test_killed_in_the_middle_and_taken_up_again(tmp_path: Path) -> None:
    levels = {f"l{i}": 0.1 + 0.01 * i for i in range(30)}
    page = {"type": "mushra", "reference": {"damping": "l0"}, "strict": False}
    data = fakes.manifest(**SMALL | {"factors": {"damping": {"path": "body.t60", "levels": levels}}, "pages": [page]})
    path, out = fakes.write(tmp_path, data), tmp_path / "out"
    script = Path(__file__).with_name("run_in_process.py")
    # both workers stop somewhere on their way, so that there is a middle however slow whoever is
    never = [f"harp.low.damping=l{i}" for i in (20, 21)]
    command = [sys.executable, str(script), str(path), str(out), "2", *never]
    process = subprocess.Popen(command, env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)})
    while len(list((out / "work").glob("[!.]*.npz"))) < 5:
        assert process.poll() is None
        time.sleep(0.01)
    process.send_signal(signal.SIGKILL)
    process.wait()
    kept = len(list((out / "work").glob("[!.]*.npz")))
    assert 5 <= kept <= 28
    (out / "work" / ".half.0badcafe.part.npz").write_bytes(b"half a render")
    report = run_batch(path, out, FakeRenderer())
    assert report.reused == kept
    assert report.rendered == 30 - kept
    assert not list(out.rglob("*.part*"))
    run_batch(path, tmp_path / "unbroken", FakeRenderer())
    assert sounds(out) == sounds(tmp_path / "unbroken")


def test_a_full_disk_stops_the_run_and_keeps_what_is_finished(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, out = fakes.write(tmp_path, fakes.manifest(**SMALL)), tmp_path / "out"
    savez, calls = np.savez, []

    def full(stream: object, **arrays: object) -> None:
        calls.append(stream)
        savez(stream, **arrays)
        if len(calls) > 2:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(np, "savez", full)
    with pytest.raises(OutputError, match="No space left on device"):
        run_batch(path, out, FakeRenderer())
    assert len(list((out / "work").iterdir())) == 2
    monkeypatch.undo()
    report = run_batch(path, out, FakeRenderer())
    assert (report.reused, report.rendered) == (2, 1)
    run_batch(path, tmp_path / "unbroken", FakeRenderer())
    assert sounds(out) == sounds(tmp_path / "unbroken")


@pytest.mark.parametrize(
    ("level", "reason"),
    [
        ("unstable", "not finite at 0.1 s"),
        ("bug", "ZeroDivisionError: a plugin's mistake"),
        ("unknown", "body.t60: unknown is not a number"),
        ("silent", "the sound is silent"),
        ("nan", "the sound is not finite from 0.0000 s on"),
        ("empty", "a render of shape (n, channels) is wanted, not (0, 1)"),
        ("flat", "a render of shape (n, channels) is wanted, not (100,)"),
    ],
)
def test_one_failing_condition_is_reported_and_the_rest_goes_on(tmp_path: Path, level: str, reason: str) -> None:
    levels = fakes.BASE["factors"]["damping"]["levels"] | {"bad": level}
    pairs = [["complex", "block"], ["complex", "bad"]]
    report = run(
        tmp_path,
        factors={"damping": {"path": "body.t60", "levels": levels}},
        pages=[
            {"type": "mushra", "reference": {"damping": "complex"}},
            {"type": "abx", "pairs": {"damping": pairs}},
        ],
    )
    assert not report.ok
    assert {f.name for f in report.faults} == {"harp.low.damping=bad"}
    assert reason in report.faults[0].reason
    assert any("page1.repeat=1: 1 of 1 trials left out" in note for note in report.notes)
    assert any("page2: 1 of 2 trials left out" in note for note in report.notes)
    test = json.loads((report.folder / "test.json").read_text())
    assert [trial["page"] for trial in test["trials"]] == [2]
    assert len(sounds(report.folder)) == 2
    record = json.loads((report.folder / "manifest.json").read_text())
    assert record["failed"][0]["name"] == "harp.low.damping=bad"
    if level == "bug":
        assert "Traceback" in record["failed"][0]["detail"]


def test_a_page_is_lowered_as_a_whole(tmp_path: Path) -> None:
    # a sparse click is as loud as a tone only far above full scale
    loud = {"loudness": {"target_lufs": -8.0}}
    report = run(tmp_path, stimuli=loud | {"longest": 1.0})
    drops = {f.page_drop_db for f in report.files}
    (drop,) = drops
    assert drop > 0
    assert max(f.true_peak_dbtp for f in report.files) == pytest.approx(-1.0, abs=0.02)
    assert max(f.true_peak_dbtp for f in report.files) <= -1.0
    for file in report.files:
        assert file.lufs == pytest.approx(-8.0 - drop, abs=0.01)
    assert f"lowered by {drop:.2f} dB" in report.notes[0]


def test_files_begin_at_the_same_sample_and_end_with_the_longest_decay(tmp_path: Path) -> None:
    report = run(tmp_path, stimuli={"onset": {"at": 0.02}})
    found = {}
    for file in report.files:
        samples, fs = soundfile.read(report.folder / file.file, always_2d=True)
        assert fs == 48000
        if file.role == "sound":
            assert trimming.onset(samples, -40.0) == 960
            found[file.condition] = np.flatnonzero(np.abs(samples[:, 0]) > 1.5 / 2**15)[-1] / fs
    # complex decays by 60 dB in 0.5 s: no file is longer, and the others are silent after their own decay
    assert {file.frames for file in report.files} == {max(f.frames for f in report.files)}
    assert report.files[0].frames / 48000 == pytest.approx(0.5 + 0.02, abs=0.03)
    assert found["harp.low.damping=block"] == pytest.approx(0.3 + 0.02, abs=0.04)
    rendered = run(tmp_path, "score", stimuli={"onset": {"align": "score"}, "trim": {"level_db": None}})
    assert rendered.files[0].frames == round(1.0 * 48000) + 480  # two decay times are rendered


def test_sounds_in_a_room(tmp_path: Path) -> None:
    """Two channels, the second half as loud and 100 samples later."""
    response = np.zeros((101, 2))
    response[0, 0], response[100, 1] = 1.0, 0.5
    (tmp_path / "out_in").mkdir()
    soundfile.write(tmp_path / "out_in" / "room.wav", response, 48000, subtype="DOUBLE")
    report = run(tmp_path, stimuli={"channels": 2, "subtype": "PCM_24", "room": "room.wav"})
    for file in report.files:
        samples, _ = soundfile.read(report.folder / file.file, always_2d=True)
        left, right = samples[600:9000, 0], samples[700:9100, 1]
        if file.role == "sound":
            assert np.max(np.abs(right - 0.5 * left)) < 1e-5
    with pytest.raises(StimulusError, match=r"room\.wav: has 2 channels; 1 or 1 are allowed"):
        room_response(tmp_path / "out_in" / "room.wav", Stimuli())
    record = json.loads((report.folder / "manifest.json").read_text())
    assert record["room_sha256"] == hashlib.sha256((tmp_path / "out_in" / "room.wav").read_bytes()).hexdigest()
    (tmp_path / "absent_in").mkdir()
    (tmp_path / "absent_in" / "text.wav").write_text("no sound")
    soundfile.write(tmp_path / "absent_in" / "silent.wav", np.zeros((9, 1)), 48000)
    for name, reason in (
        ("gone.wav", "cannot be read: No such file or directory"),
        (".", "cannot be read: Is a directory"),
        ("text.wav", "cannot be read: Format not recogni[sz]ed"),
        ("silent.wav", "is silent, or holds a number that is not finite"),
    ):
        with pytest.raises(ManifestError, match=rf"\.yaml: stimuli\.room: {re.escape(name)}: {reason}"):
            run(tmp_path, "absent", stimuli={"room": name})


def test_24_bits_two_channels_other_rates_and_a_given_length(tmp_path: Path) -> None:
    settings = {"subtype": "PCM_24", "channels": 2, "fs": 44100, "duration": 0.75}
    report = run(tmp_path, stimuli=settings)
    for file in report.files:
        info = soundfile.info(report.folder / file.file)
        assert (info.subtype, info.channels, info.samplerate, info.frames) == ("PCM_24", 2, 44100, 33075)
        samples, _ = soundfile.read(report.folder / file.file, dtype="int32")
        assert not np.any(samples & 0xFF)
        assert stimuli.samples_sha256(samples >> 8) == file.sha256


def test_store(tmp_path: Path) -> None:
    store, sound = Store(tmp_path), Rendered(np.array([[0.5, -0.25]]), 44100, {"a": [1]})
    store.save("k", sound)
    got = store.load("k")
    assert np.array_equal(got.samples, sound.samples)
    assert (got.fs, got.info) == (44100, {"a": [1]})
    assert store.facts("k") == {"fs": 44100, "frames": 1, "info": {"a": [1]}}
    assert store.has("k")
    assert not store.has("other")
    with pytest.raises(OutputError, match="damaged or gone"):
        store.load("other")
    assert content_key({"a": 1, "b": [2]}) == content_key({"b": [2], "a": 1}) != content_key({"a": 1})


def test_a_damaged_render_is_not_there(tmp_path: Path, rng: np.random.Generator) -> None:
    """Bytes changed, cut off or put in, entries of other kinds: rendered again, or one line, never another error."""
    store, samples = Store(tmp_path), rng.normal(size=(300, 2))
    store.save("k", Rendered(samples, 44100, {"a": [1]}))
    whole = store.path("k").read_bytes()
    damaged = [b"", whole[:40], b"PK", b"\x93NUMPY", b"\x93NUMPY\x01\x00\xff\xff", json.dumps([1]).encode()]
    for _ in range(100):
        raw = bytearray(whole)
        for at in rng.integers(0, len(raw), rng.integers(1, 4)):
            raw[at] = rng.integers(0, 256)
        damaged.append(bytes(raw[: rng.integers(1, len(raw) + 1)]) if rng.random() < 0.3 else bytes(raw))
    # the zip's directory and the headers, where fields have meanings
    ends = [*range(120), *range(len(whole) - 300, len(whole))]
    damaged += [whole[:at] + bytes([value]) + whole[at + 1 :] for at in ends for value in (0xFF, whole[at] ^ 1)]
    for raw in damaged:
        store.path("k").write_bytes(raw)
        if store.has("k"):  # the change says nothing, a date for instance
            assert np.array_equal(store.load("k").samples, samples)
        else:
            with pytest.raises(OutputError, match="damaged or gone"):
                store.load("k")


@pytest.mark.parametrize(
    ("facts", "samples"),
    [
        (b"not JSON", np.zeros((3, 1))),
        (b"[]", np.zeros((3, 1))),
        (b'{"fs": 0, "frames": 3, "info": {}}', np.zeros((3, 1))),
        (b'{"fs": "x", "frames": 3, "info": {}}', np.zeros((3, 1))),
        (b'{"fs": 8000, "frames": 3, "info": 1}', np.zeros((3, 1))),
        (b'{"fs": 8000, "frames": 4, "info": {}}', np.zeros((3, 1))),
        (b'{"fs": 8000, "frames": 3, "info": {}}', np.zeros(3)),
        (b'{"fs": 8000, "frames": 3, "info": {}}', np.zeros((3, 1), dtype=np.int16)),
        (b"[" * 100_000, np.zeros((3, 1))),
    ],
)
def test_an_entry_that_is_no_render_is_not_there(tmp_path: Path, facts: bytes, samples: np.ndarray) -> None:
    with Store(tmp_path).path("k").open("wb") as stream:
        np.savez(stream, samples=samples, facts=np.frombuffer(facts, dtype=np.uint8))
    assert not Store(tmp_path).has("k")


def test_what_cannot_be_removed_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As on a mount that has become read-only."""
    (tmp_path / ".x.part.npz").write_bytes(b"")

    def refuse(path: Path, missing_ok: bool = False) -> None:
        raise OSError(errno.EROFS, os.strerror(errno.EROFS), str(path))

    monkeypatch.setattr(Path, "unlink", refuse)
    with pytest.raises(OutputError, match=r"\.x\.part\.npz: cannot be removed: Read-only file system"):
        Store(tmp_path).clear_parts()


def test_a_dead_cluster_is_one_line() -> None:
    with pytest.raises(TonewoodError, match="cluster nonsense does not answer"):
        list(Workers(cluster="nonsense").each(len, ["a"]))
