"""Sounds of a batch, the files beside them, the engine's renders and hashes, by values worked out by hand."""

from __future__ import annotations

import csv
import dataclasses
import hashlib
import json
import math
import threading
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import batch_fakes as fakes
import numpy as np
import pytest
from batch_by_hand import HERE, STAIRS, group, laid, manifest, sound_file
from batch_fakes import FakeRenderer

import tonewood as tw
from tonewood.errors import TonewoodError
from tonewood.performance.score.note import Note
from tonewood.workshop.batch import outputs, rendering
from tonewood.workshop.batch.audition import facts_of
from tonewood.workshop.batch.conditions import expand
from tonewood.workshop.batch.data_sheet import Subject, _name, _software, _sources, data_sheet, write_data_sheet
from tonewood.workshop.batch.manifest import ManifestError, Stimuli, manifest_schema
from tonewood.workshop.batch.migration import manifest_edits
from tonewood.workshop.batch.outputs import _draw_differences, _subject
from tonewood.workshop.batch.page_parts import Question, RatingScale
from tonewood.workshop.batch.pages import HeadphonesPage, StaircasePage
from tonewood.workshop.batch.production import (
    Fault,
    group_length,
    level_faults,
    longest,
    prepared,
    room_response,
    trial_of_a_file,
)
from tonewood.workshop.batch.records import _flat, batch_record, file_records, key_of, write_csv, write_json
from tonewood.workshop.batch.rendering import (
    EngineRenderer,
    _channel_per_string,
    _numbers,
    _plain,
    instrument_of,
)
from tonewood.workshop.batch.runner import run_batch
from tonewood.workshop.batch.seeds import blind_codes, generator
from tonewood.workshop.batch.stimuli import level_gain_db, page_drop_db, quantised
from tonewood.workshop.batch.store import Rendered, Store, content_key
from tonewood.workshop.batch.trimming import convolved, end, onset, shifted
from tonewood.workshop.batch.workers import Workers

# -- sounds ------------------------------------------------------------------------------------------------------------


def stimuli(**changes: Any) -> Stimuli:
    return Stimuli.model_validate(changes)


def test_lengths_of_files() -> None:
    assert longest(stimuli()) == 12 * 48000
    assert longest(stimuli(duration=0.5, fs=44100)) == 22050
    assert [longest(stimuli(duration=n / 48000)) for n in (0.1, 1.0, 1.6)] == [1, 1, 2]
    assert group_length([3, 9, 4], stimuli()) == 9
    assert group_length([], stimuli()) == 1
    assert group_length([3, 9, 4], stimuli(duration=0.5)) == 24000


def test_a_sound_is_aligned_cut_and_faded() -> None:
    """Its onset at 40 dB below its peak is put to 10 ms; in 20 ms blocks, later ones below -60 dB are cut."""
    sound = np.zeros((9600, 1))
    sound[500], sound[600:4300], sound[9000] = 0.0101, 1.0, 0.9e-3
    found = prepared(Rendered(sound, 48000), stimuli(fade={"in": 0.0, "out": 0.0}))
    assert len(found) == 5 * 960  # 480 + 3800 samples end in the fifth block
    assert (np.flatnonzero(found)[[0, 1]] == [480, 580]).all()
    score = prepared(Rendered(sound, 48000), stimuli(onset={"align": "score"}, trim={"level_db": None}))
    assert len(score) == 480 + 9600
    assert np.flatnonzero(score)[0] == 480 + 500
    early = prepared(Rendered(sound, 48000), stimuli(onset={"at": 0.005}, longest=0.1, trim={"level_db": None}))
    assert (len(early), np.flatnonzero(early)[0]) == (4800, 240)
    assert early[-1, 0] < 1e-5  # the fade is at the end of what is kept


def test_onsets_and_ends_at_their_levels() -> None:
    sound = np.array([[0.0, 0.0], [0.0, -0.1], [0.5, 0.0], [1.0, 0.0]])
    assert [onset(sound, level) for level in (-20.0, -19.9, 0.0)] == [1, 2, 3]
    blocks = np.array([1.0, 1.0, 0.1, 0.1, 0.0, 0.0, 0.1])[:, None]
    assert end(blocks, 2, -24.0) == 7  # the last block is 0.1 and a zero: -23 dB
    assert end(blocks, 2, -22.9) == 4
    assert end(blocks, 2, -19.9) == 2
    assert shifted(sound, 2).shape == (6, 2)
    assert shifted(sound, -3).tolist() == [[1.0, 0.0]]
    assert convolved(np.ones((3, 2)), np.array([[1.0], [2.0]]))[:, 1].round(9).tolist() == [1, 3, 3, 2]


def test_gains_and_drops(rng: np.random.Generator) -> None:
    tone = np.sin(2 * np.pi * 997 * np.arange(48000) / 48000)[:, None]
    assert level_gain_db(tone, 48000, "none", -23.0) == 0.0
    for method in ("bs1770_gated", "loudest"):
        assert level_gain_db(tone, 48000, method, -23.0, 0.4) == pytest.approx(-23 + 3.01, abs=0.01)
    assert [page_drop_db([x], -1.0) for x in (-1.0, -0.9)] == [0.0, pytest.approx(0.11)]
    assert page_drop_db([-math.inf, -3.0], -1.0) == 0.0
    for beyond in (2**15 - 0.6, -(2**15) - 0.4):
        with pytest.raises(TonewoodError, match="passes full scale"):
            quantised(np.full((1000, 1), beyond / 2**15), "PCM_16", rng)
    edge = np.array([[(2**15 - 3) / 2**15], [-(2**15 - 2) / 2**15]])
    assert quantised(edge, "PCM_16", rng).dtype == np.int16
    assert quantised(edge * 0, "PCM_24", rng).dtype == np.int32
    steps = np.array([[0.0, 100.0, -100.0, 7.5]])
    many = np.mean([quantised(steps / 2**15, "PCM_16", rng) for _ in range(3000)], axis=0)
    np.testing.assert_allclose(many, steps, atol=0.05)  # rounding and dither have no mean


def test_time_of_a_file_is_one_and_a_half_trials(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two trials in 4 s, of which the processor had 2: a core is at half of its speed."""
    clock, core = iter((10.0, 14.0) * 2), iter((1.0, 3.0) * 2)
    for name in ("level_gain_db", "true_peak", "quantised", "measured"):
        monkeypatch.setattr(f"tonewood.workshop.batch.stimuli.{name}", lambda *_: 0.0)
    monkeypatch.setattr("tonewood.workshop.batch.production.time.perf_counter", lambda: next(clock))
    monkeypatch.setattr("tonewood.workshop.batch.production.time.process_time", lambda: next(core))
    assert trial_of_a_file(stimuli(), pictures=False) == (1.5 * 2.0, 3.0 * 2.0)
    assert trial_of_a_file(stimuli(), pictures=True) == (1.5 * 2.0 + 0.15, 6.0)


def test_levels_without_a_loudness_are_told(tmp_path: Path) -> None:
    store = Store(tmp_path)
    store.save("a1", Rendered(np.zeros((4800, 1)), 48000))
    store.save("b2", Rendered(np.sin(np.arange(9600.0))[:, None], 48000))
    faults = list(level_faults({"silent": "a1", "well": "b2", "unmade": None, "gone": "c3"}, store, stimuli(), None))
    assert [f.name for f in faults] == ["silent", "gone"]
    assert "silent" in faults[0].reason
    with pytest.raises(ValueError, match="Out of range float values"):
        store.save("d4", Rendered(np.zeros((4, 1)), 48000, {"a": math.nan}))
    assert (store.others({"a1"}), store.others(set()), store.others({"a1", "b2"})) == (1, 2, 0)
    assert store.facts("b2") == {"fs": 48000, "frames": 9600, "info": {}}


# -- files beside the sounds -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({}, "1.25 s, -23.5 LUFS, -2.3 dBTP"),
        ({"loudness_gated": False}, "1.25 s, -23.5 LUFS (ungated), -2.3 dBTP"),
        ({"lufs": None, "true_peak_dbtp": None, "fs": 24000}, "2.50 s, silent"),
    ],
)
def test_a_sound_in_words(changes: dict[str, Any], text: str) -> None:
    assert facts_of(sound_file("b", **changes)) == text


def test_facts_of_all_sounds() -> None:
    made = manifest(title={"en": "Damping", "de": "Dämpfung"}, licence="CC0-1.0")
    files = [sound_file("b"), sound_file("c", lufs=-20.04, frames=36000, sha256="cd"), sound_file("d", lufs=None)]
    subject = _subject(made, files)
    assert (subject.name, subject.title, subject.licence) == ("damping", "Damping", "CC0-1.0")
    assert subject.facts == {
        "format": "WAV, 48000 Hz, 1 channels, PCM_16", "length": "3.2 s in all",
        "loudness": "bs1770_gated, -23 LUFS", "measured": "-23.5 to -20.0 LUFS (BS.1770)",
    }  # fmt: skip
    assert subject.digests == {"b": "ab", "c": "cd", "d": "ab"}
    assert "measured" not in _subject(made, files[2:]).facts
    assert subject.manifest["schema"] == "tonewood-batch/1"
    assert "conditions" not in subject.manifest


@pytest.mark.parametrize(("count", "drawn"), [(1, False), (2, True), (13, True), (14, False)])
def test_differences_are_drawn_of_2_to_13_sounds(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, count: int, drawn: bool
) -> None:
    asked: list[Any] = []
    removed: list[Path] = []
    monkeypatch.setattr(outputs, "_draw", asked.append)
    monkeypatch.setattr(outputs, "remove", removed.append)
    codes = [f"c{i}" for i in range(count)]
    groups = [group("none", 0, ("x", "y")), group("g", 0, (codes[-1], *codes[:-1]))]
    workers: Any = SimpleNamespace(each=lambda work, tasks: [work(task) for task in tasks])
    _draw_differences(groups, {c: sound_file(c) for c in codes}, tmp_path, workers)
    path = tmp_path / "pictures" / "differences1.png"
    assert removed == ([] if drawn else [path])
    if drawn:
        ((where, files, name),) = asked
        assert (where, name, next(iter(files))) == (path, "g", f"of {codes[-1]}")  # the reference comes first
        assert list(files.values())[1] == tmp_path / "c0.wav"


def test_rows_of_a_data_sheet(tmp_path: Path) -> None:
    one = {"version": "1", "isa": "avx2", "computed_with": {"numpy": "2.0", "blas": [{"b": 1, "a": 2}]}}
    assert _software([one, {"version": "2"}]) == [
        ("tonewood", "1; 2"), ("instruction set", "avx2; not stated"), ("numpy", "2.0"), ("blas", '[{"a": 2, "b": 1}]')
    ]  # fmt: skip
    sources = {
        "a": {"text": "A", "doi": "10/x", "url": "http://u", "licence": "L", "changes": "c"},
        "b": {"text": "B", "url": "http://u", "licence": "M"}, "c": {"text": "C", "licence": "N"},
    }  # fmt: skip
    assert _sources([{"sources": sources}, {"sources": None}]) == {
        ("A, doi:10/x", "L", "c"), ("B, http://u", "M", ""), ("C", "N", "")
    }  # fmt: skip
    names = [_name(keys) for keys in ({"title": "T", "name": "n"}, {"title": "", "name": "n"}, {})]
    assert names == ["T", "n", "not stated"]
    whole = hashlib.sha256(json.dumps({"a": 1, "seed": 3}).encode()).hexdigest()
    assert f"| SHA-256 of the manifest | `{whole}` |" in data_sheet(
        Subject("n", "", "", {"seed": 3, "a": 1}, {}, {}), []
    )
    sheet = data_sheet(Subject("n", "", "", {"seed": 3}, {"length": "1 | 2"}, {"b": "1", "a": "2"}), [])
    write_data_sheet(tmp_path / "new", Subject("n", "", "", {"seed": 3}, {}, {}), [])
    assert (tmp_path / "new" / "datasheet.md").read_text().startswith("# Data sheet: n\n")
    for line in ("| title | n |", "| licence of the sounds | not stated |", "| sounds | 2 |", "| seed | 3 |"):
        assert line in sheet
    assert r"| length | 1 \| 2 |" in sheet


def test_records_and_keys_have_every_value() -> None:
    made, conditions, groups, _ = laid(pages=[fakes.BASE["pages"][0], {"type": "html"}])
    key = key_of(made, groups, conditions)
    assert (key["schema"], key["name"], key["seed"]) == ("tonewood-key/1", "damping", 7)
    assert key["factors"] == ["instrument", "score", "damping", "pluck"]
    assert key["levels"] == {
        "instrument": ["harp"], "score": ["low", "high"], "damping": ["complex", "proportional", "block"],
        "pluck": ["near", "far"],
    }  # fmt: skip
    first = groups[0].trials[0]
    assert key["trials"][first.id] == {
        "page": 1, "type": "mushra", "group": "page1.score=low.pluck=near.repeat=1", "reference": first.reference,
        "fixed": {"score": "low", "pluck": "near", "repeat": "1"}, "stimuli": list(first.stimuli),
    }  # fmt: skip
    one = groups[0].stimuli[0]
    assert key["stimuli"][one.code] == {
        "condition": one.condition, "role": one.role, "group": groups[0].name,
        "levels": conditions[one.condition].all_levels,
    }  # fmt: skip
    name = next(iter(conditions))
    (row,) = file_records([sound_file("b", condition=name)], conditions, {"k": {"isa": "any"}}, {"k": {"fs": 1}})
    assert (row["code"], row["instrument"], row["score"], row["repeat"], row["seed"]) == ("b", "harp", "low", 1, 7)
    assert (row["levels"], row["identity"]) == ({"damping": "complex", "pluck": "near"}, {"isa": "any"})
    assert (row["render"], row["asked"]) == ({"fs": 1}, conditions[name].asked())
    record = batch_record(made, [row], [Fault("x", "why")], ["note"])
    assert record["failed"] == [{"name": "x", "reason": "why", "detail": ""}]
    assert (record["schema"], record["notes"], record["files"]) == ("tonewood-record/1", ["note"], [row])
    assert record["manifest"]["schema"] == "tonewood-batch/1"
    assert "conditions" not in record["manifest"]  # what is not there
    assert _flat({"a": {"b": 1, "c": {"d": [1, "ä"]}}, "e": None}) == [("a.b", 1), ("a.c.d", '[1, "ä"]'), ("e", None)]


# -- the engine --------------------------------------------------------------------------------------------------------


def test_numbers_that_a_path_leads_to() -> None:
    values = {"s": {"a": {"x": 1, "y": True}, "b": {"x": 2.5}}, "l": [{"name": "n", "x": 3}, {"x": 4}, [5.0]]}
    assert _numbers(values, "s.*.x") == [("s.a.x", 1.0), ("s.b.x", 2.5)]
    assert _numbers(values, "l.n.x") == [("l.n.x", 3.0)]
    assert _numbers(values, "l.1.x") == [("l.1.x", 4.0)]
    for path, said in (("s.a.y", "True cannot vary"), ("s.c.x", "there is no 'c'"), ("s.a.x.z", "there is no 'z'")):
        with pytest.raises(TonewoodError, match=said):
            _numbers(values, path)


def test_facts_are_plain_and_finite() -> None:
    given = {"a": np.float64(1.5), 2: (math.inf, -3, True, None), "c": [math.nan, "x"]}
    assert _plain(given) == {"a": 1.5, "2": [None, -3, True, None], "c": [None, "x"]}


@pytest.mark.parametrize(
    ("path", "value"),
    [
        ("strings.A2.tension", 58.8),
        ("strings.*.tension", 58.8),
        ("outputs.bridge.full_scale", 100.0),
        ("render.fs", 22050),
        ("render.none", None),
        ("strings.A2.tension.x", None),
        ("strings.B2.tension", None),
    ],
)
def test_own_values_of_parameters(path: str, value: Any) -> None:
    made = manifest(instruments={"m": "monochord"}, factors={}, pages=[{"type": "html"}], render={"fs": 22050})
    assert EngineRenderer().own_value(expand(made, HERE)[0], path) == value


@pytest.mark.parametrize(("most", "seconds"), [(None, 3.0 + 4.0 * (2.5 + 1.5 + 0.5 * 6.0)), (5.0, 3.0 + 4.0 * 5.0)])
def test_a_render_takes_its_setup_and_its_length(
    monkeypatch: pytest.MonkeyPatch, most: float | None, seconds: float
) -> None:
    """3 s to set up and 4 s for each second: a note from 2.5 to 4 s with half of a tail of 6 s."""
    phrase = [{"time": 0.0, "freq": 110.0, "duration": 1.0}, {"time": 2.5, "freq": 110.0, "duration": 1.5}]
    render = {"tail": 6.0} if most is None else {"tail": 6.0, "max_duration": most}
    made = manifest(scores={"s": {"phrase": phrase}}, factors={}, pages=[{"type": "html"}], render=render)
    clock = iter((0.0, 3.0, 4.0))
    pieces: list[float] = []

    def renderer(self: Any, condition: Any, max_duration: float) -> Any:
        pieces.append(max_duration)
        return SimpleNamespace(blocks=lambda: [])

    monkeypatch.setattr(EngineRenderer, "renderer", renderer)
    monkeypatch.setattr("tonewood.workshop.batch.rendering.time.perf_counter", lambda: next(clock))
    monkeypatch.setattr("tonewood.workshop.batch.rendering._COSTS", {})
    for _ in range(2):  # measured once
        assert EngineRenderer().predict(expand(made, HERE)[0]) == pytest.approx(seconds)
    assert pieces == [0.25]


def test_the_engine_s_renders_have_facts() -> None:
    made = manifest(
        instruments={"m": "monochord"}, factors={}, pages=[{"type": "html"}], render={"fs": 8000, "max_duration": 0.1},
    )  # fmt: skip
    found = EngineRenderer().render(expand(made, HERE)[0])
    assert (found.samples.shape, found.fs, found.info["channels"]) == ((800, 1), 8000, ["acceleration"])
    json.dumps(found.info, allow_nan=False)
    wanted = tw.render(
        tw.Score([Note(0.0, freq=110.0, force=1.0)]), tw.load_instrument("monochord"),
        options=made.render_settings({}),
    ).samples  # fmt: skip
    np.testing.assert_array_equal(found.samples, wanted)


@pytest.mark.parametrize(("reversals", "discard", "allowed"), [(4, 2, True), (4, 3, False), (2, 0, True)])
def test_two_reversals_count_at_least(reversals: int, discard: int, allowed: bool) -> None:
    fields = {**STAIRS, "steps": [10.0, 5.0], "reversals": reversals, "discard": discard}
    if allowed:
        assert StaircasePage.model_validate(fields).discard == discard
    else:
        with pytest.raises(ValueError, match="reversals must be at least discard"):
            StaircasePage.model_validate(fields)


@pytest.mark.parametrize(("low", "high", "allowed"), [(1.0, 1.0, False), (1.0, 1.001, True), (2.0, 1.0, False)])
def test_scales_rise(low: float, high: float, allowed: bool) -> None:
    ends: dict[str, Any] = {"name": "q", "label": "Q", "low": low, "high": high}
    for kind in (RatingScale, Question):
        if allowed:
            assert kind.model_validate(ends).high == high
        else:
            with pytest.raises(ValueError, match="low must be below high"):
                kind.model_validate(ends)


# -- migration ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("values", "edits"),
    [
        ({}, []),
        ({"render": {"precision": "single"}}, [("render.precision", None)]),
        ({"pages": [{"type": "paired_comparison"}]}, [("pages.0.type", "abx")]),
        ({"pages": [{"type": "paired_comparison", "question": "?", "both_orders": True}]}, []),
        (
            {"pages": ["x", {"type": "paired_comparison", "both_orders": True, "unforced": "same", "looping": False}]},
            [("pages.1.type", "abx"), ("pages.1.looping", None), ("pages.1.both_orders", None),
             ("pages.1.unforced", "true")],
        ),
        ({"pages": [{"type": "mushra", "show_waveform": True, "switch_back": True}]},
         [("pages.0.show_waveform", None), ("pages.0.switch_back", None)]),
        ({"pages": [{"type": "abx", "unforced": "x"}]}, []),
        ({"factors": {"a": {"path": "render.fs"}, "b": 1}, "pages": 3, "render": 2}, []),
    ],
)  # fmt: skip
def test_edits_of_an_old_manifest(values: dict[str, Any], edits: list[Any]) -> None:
    assert [(e.path, e.value) for e in manifest_edits(values)] == edits


def test_a_factor_of_the_precision_is_for_the_author() -> None:
    with pytest.raises(ManifestError, match=r"varies render\.precision"):
        manifest_edits({"factors": {"p": {"path": "render.precision"}}})


@pytest.mark.parametrize(
    ("key", "shown"),
    [
        ("pages.0.type", "page 1.type"),
        ("pages.11", "page 12"),
        ("pages.x", "pages.x"),
        ("factors.1.path", "factors.1.path"),
    ],
)
def test_pages_are_counted_from_one(key: str, shown: str) -> None:
    assert ManifestError.shown_key(key) == shown


# -- randomness and hashes ---------------------------------------------------------------------------------------------


def test_random_numbers_are_those_of_the_hash_of_their_purpose() -> None:
    """PCG64 from the first 16 bytes of SHA-256 over seed and labels; codes of consonants from all bytes."""
    digest = hashlib.sha256(b"7\x1fdither\x1f3").digest()
    expected = np.random.Generator(np.random.PCG64(int.from_bytes(digest[:16], "big"))).random(4)
    np.testing.assert_array_equal(generator(7, "dither", 3).random(4), expected)
    number = int.from_bytes(hashlib.sha256(b"7\x1fcode\x1fa\x1f0").digest(), "big")
    letters = "bcdfghjkmnpqrstvwxz"
    assert blind_codes(7, ["a"]) == {"a": "".join(letters[number // 19**i % 19] for i in range(6))}


def test_keys_are_of_finite_values_with_their_schema() -> None:
    text = '{"a":[1],"b":"x","schema":"tonewood-render/2"}'
    assert content_key({"b": "x", "a": [1]}) == hashlib.sha256(text.encode()).hexdigest()
    with pytest.raises(ValueError, match="Out of range float values"):
        content_key({"a": math.nan})


def test_code_of_bundles_runs_where_it_is_allowed_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    assert EngineRenderer().allow_code is False
    assert EngineRenderer(True).allow_code is True
    asked: list[Any] = []
    monkeypatch.setattr(rendering, "_loaded", lambda bundle, allow_code: asked.append((bundle, allow_code)))
    monkeypatch.setattr(rendering, "_changed", lambda *given: None)
    one = expand(manifest(), HERE)[0]
    instrument_of(one)
    instrument_of(one, True)
    assert asked == [("african_harp", False), ("african_harp", True)]
    assert _channel_per_string(one) is False
    for midi in ({"channel_per_string": True}, {}):
        assert _channel_per_string(dataclasses.replace(one, midi=midi)) is bool(midi)


def test_a_batch_is_made_in_a_folder_of_folders(tmp_path: Path) -> None:
    path = fakes.write(tmp_path, fakes.manifest(pages=[{"type": "html"}], stimuli={"longest": 0.1}, factors={}))
    report = run_batch(path, tmp_path / "a" / "b", FakeRenderer())
    assert (report.ok, report.rendered, report.reused, len(report.files)) == (True, 2, 0, 2)
    again = run_batch(path, tmp_path / "a" / "b", FakeRenderer())
    assert (again.rendered, again.reused) == (0, 2)
    assert {"schema", "pages"} <= set(manifest_schema()["properties"])


@pytest.mark.parametrize(
    ("fields", "needed"),
    [
        ({}, 6),
        ({"trials": 4}, 4),
        ({"method": "antiphase"}, 5),
        ({"method": "antiphase", "trials": 1}, 1),
        ({"right": 3}, 3),
    ],
)
def test_right_answers_to_a_check_of_headphones(fields: dict[str, Any], needed: int) -> None:
    assert HeadphonesPage.model_validate({"type": "headphones", **fields}).needed == needed


def test_records_are_readable_and_finite(tmp_path: Path) -> None:
    write_json(tmp_path / "sub" / "a.json", {"ä": [1, None]})
    assert (tmp_path / "sub" / "a.json").read_text("utf-8") == '{\n "ä": [\n  1,\n  null\n ]\n}\n'
    with pytest.raises(ValueError, match="Out of range float values"):
        write_json(tmp_path / "b.json", {"a": math.inf})
    write_csv(tmp_path / "a.csv", [{"a": 1, "b": {"c": [2]}}, {"d": None, "a": "x"}])
    with (tmp_path / "a.csv").open(newline="") as stream:
        assert list(csv.reader(stream)) == [["a", "b.c", "d"], ["1", "[2]", ""], ["x", "", ""]]


def test_workers_are_of_this_machine() -> None:
    assert Workers(2, "threads", "tcp://x").local() == Workers(2, "threads")
    assert (Workers().jobs, Workers().backend, Workers(3).count) == (1, "processes", 3)
    assert sorted(Workers(1, "threads").each(lambda x: x * x, [1, 2, 3])) == [1, 4, 9]
    assert max(Workers(500, "threads").each(lambda x: threading.active_count(), [1, 2])) < 100  # no more than the work


def test_a_room_has_one_channel_or_those_of_the_files(tmp_path: Path) -> None:
    import soundfile

    def room(name: str, samples: Any, fs: int = 48000) -> Path:
        soundfile.write(tmp_path / name, np.asarray(samples, dtype=float), fs, subtype="DOUBLE")
        return tmp_path / name

    stereo = stimuli(channels=2)
    assert room_response(room("one.wav", [0.5, 0.25]), stereo).tolist() == [[0.5], [0.25]]
    assert room_response(room("two.wav", [[0.5, 0.1], [0.25, 0.2]]), stereo).tolist() == [[0.5, 0.1], [0.25, 0.2]]
    for name, samples, reason in (
        ("three.wav", np.ones((4, 3)), "has 3 channels; 1 or 2 are allowed"),
        ("silent.wav", np.zeros(4), "is silent"),
        ("nan.wav", [0.1, np.nan], "not finite"),
    ):
        with pytest.raises(TonewoodError, match=reason):
            room_response(room(name, samples), stereo)
    with pytest.raises(TonewoodError, match="cannot be read: No such file"):
        room_response(tmp_path / "none.wav", stereo)
    # the convolution of a click with its room, aligned to the room's loudest sample
    whole = stimuli(channels=2, fade={"in": 0.0, "out": 0.0}, trim={"level_db": None})
    dry = prepared(Rendered(np.eye(100, 1, -10), 48000), whole, room=tmp_path / "two.wav")
    np.testing.assert_allclose(dry[480:482], [[0.5, 0.1], [0.25, 0.2]], atol=1e-12)
