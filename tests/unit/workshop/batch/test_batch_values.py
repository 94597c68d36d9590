"""Values of batches against figures worked out by hand: plans, levels, files, records, migration."""

from __future__ import annotations

import csv
import dataclasses
import hashlib
import json
import math
import re
import threading
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import batch_fakes as fakes
import mido
import numpy as np
import pytest
from batch_fakes import FakeRenderer

import tonewood as tw
from tonewood.errors import TonewoodError
from tonewood.performance.score.note import Note
from tonewood.workshop.batch import outputs, rendering
from tonewood.workshop.batch.audition import facts_of
from tonewood.workshop.batch.conditions import MAX_CONDITIONS, Draw, bundle_of, expand
from tonewood.workshop.batch.data_sheet import Subject, _name, _software, _sources, data_sheet, write_data_sheet
from tonewood.workshop.batch.definition import (
    changed_condition,
    check_answers,
    check_rendering,
    count_answers,
    definition_of,
    staircase_levels,
    with_value,
)
from tonewood.workshop.batch.layout import MAX_SIGNALS, Group, Stimulus, Trial, lay_out
from tonewood.workshop.batch.manifest import Manifest, ManifestError, Stimuli, check_manifest, manifest_schema
from tonewood.workshop.batch.migration import manifest_edits
from tonewood.workshop.batch.outputs import _draw_differences, _subject
from tonewood.workshop.batch.page_parts import Question, RatingScale, Return
from tonewood.workshop.batch.pages import LEAST_SPAN, AbxPage, HeadphonesPage, StaircasePage, as_pairs
from tonewood.workshop.batch.production import (
    Fault,
    SoundFile,
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
    _Base,
    _channel_per_string,
    _numbers,
    _plain,
    _score,
    instrument_of,
)
from tonewood.workshop.batch.runner import Report, _check, _complete, _Counter, _render, plan_batch, run_batch
from tonewood.workshop.batch.seeds import blind_codes, generator
from tonewood.workshop.batch.stimuli import level_gain_db, page_drop_db, quantised
from tonewood.workshop.batch.store import Rendered, Store, content_key
from tonewood.workshop.batch.trimming import convolved, end, onset, shifted
from tonewood.workshop.batch.workers import Workers

HERE = Path(__file__).parent
STAIRS = {
    "type": "staircase", "path": "body.t60", "of": {"score": "low", "damping": "block", "pluck": "near"},
    "scale": "percent", "start": 40.0, "lowest": 1.0, "highest": 80.0,
}  # fmt: skip


def manifest(**changes: Any) -> Manifest:
    return check_manifest(fakes.manifest(**changes))


def laid(**changes: Any) -> tuple[Manifest, Any, tuple[Group, ...], list[str]]:
    made = manifest(**changes)
    conditions = expand(made, HERE)
    groups, notes = lay_out(made, conditions)
    return made, {c.name: c for c in conditions}, groups, notes


def group(name: str, page: int, *trials: tuple[str, ...]) -> Group:
    """A group of trials whose codes begin with the reference."""
    codes = list(dict.fromkeys(code for trial in trials for code in trial))
    stimuli = tuple(Stimulus(code, f"of {code}") for code in codes)
    made = tuple(Trial(f"{name}{i}", name, codes[0], tuple(codes[1:])) for i, codes in enumerate(trials))
    return Group(name, page, {}, stimuli, made)


def sound_file(code: str, **changes: Any) -> SoundFile:
    values: dict[str, Any] = {
        "code": code, "group": "g", "condition": f"of {code}", "role": "sound", "key": "k", "file": f"{code}.wav",
        "fs": 48000, "channels": 1, "subtype": "PCM_16", "frames": 60000, "gain_db": 1.0, "page_drop_db": 0.5,
        "lufs": -23.456, "momentary_lufs": -20.0, "loudness_gated": True, "peak_dbfs": -3.0, "true_peak_dbtp": -2.345,
        "sha256": "ab",
    }  # fmt: skip
    return SoundFile(**values | changes)


# -- conditions and layout --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("path", "field"),
    [
        ("note.time", "time"),
        ("note.duration", "duration"),
        ("exciters.pluck.force", "force"),
        ("exciters.pluck.from_bridge", "from_bridge"),
        ("exciters.*.angle_deg", "angle_deg"),
        ("exciters.pluck.time", "time"),
        ("exciters.pluck.nail", None),
        ("exciters.pluck.deep.force", None),
        ("body.force", None),
        ("exciters.force", None),
    ],
)
def test_fields_of_notes_that_vary(path: str, field: str | None) -> None:
    assert Draw(path, "normal", 1.0, 1, ()).note_field == field


def test_a_drawn_number_is_a_factor_or_an_amount() -> None:
    assert Draw("a", "normal_db", 1.0, 1, ()).applied(3.0, 2.0) == 6.0
    assert Draw("a", "uniform", 1.0, 1, ()).applied(3.0, 2.0) == 5.0


def test_everything_that_decides_a_sound_is_asked_for() -> None:
    made = manifest(repeats=2, vary={"note.force": {"normal_db": 1.0}})
    one = expand(made, HERE)[1]
    asked = one.asked()
    assert (one.name, one.repeat) == ("harp.low.damping=complex.pluck=near.r2", 2)
    assert one.all_levels == {
        "instrument": "harp",
        "score": "low",
        "damping": "complex",
        "pluck": "near",
        "repeat": "2",
    }
    assert asked["overrides"] == {"body.t60": 0.5, "body.detune": 1.0}
    assert (asked["seed"], asked["midi"], asked["midi_sha256"]) == (7, None, None)
    assert asked["notes"] == [dataclasses.asdict(Note(0.0, freq=110.0, force=1.0))]
    labels = ("harp", "low", "2")
    assert asked["draws"] == [{"path": "note.force", "law": "normal_db", "spread": 1.0, "seed": 7, "labels": labels}]
    assert "note_changes" not in asked
    assert dataclasses.replace(one, note_changes={"force": 1.0}).asked()["note_changes"] == {"force": 1.0}


def test_conditions_are_counted_before_they_are_made(monkeypatch: pytest.MonkeyPatch) -> None:
    assert MAX_CONDITIONS == 100_000
    monkeypatch.setattr("tonewood.workshop.batch.conditions.MAX_CONDITIONS", 24)
    assert len(expand(manifest(repeats=2), HERE)) == 24
    with pytest.raises(ManifestError, match="36 conditions; 24 are allowed"):
        expand(manifest(repeats=3), HERE)


def test_folders_of_instruments(tmp_path: Path) -> None:
    (tmp_path / "mine").mkdir()
    (tmp_path / "monochord").mkdir()
    assert bundle_of("mine", tmp_path) == str(tmp_path / "mine")
    assert bundle_of("monochord", tmp_path) == "monochord"  # installed
    assert bundle_of("./monochord", tmp_path) == str(tmp_path / "monochord")
    assert bundle_of("none", tmp_path) == "none"


def test_twelve_signals_are_on_a_page_and_no_more() -> None:
    def page(levels: int, **other: Any) -> tuple[Group, ...]:
        named = {f"l{i}": 0.1 + 0.01 * i for i in range(levels)}
        factors = {"damping": {"path": "body.t60", "levels": named}}
        pages = [{"type": "mushra", "group_by": ["score"], "reference": {"damping": "l0"}, "anchors": [3500, 7000]}]
        return laid(factors=factors, pages=[pages[0] | other])[2]

    first = page(MAX_SIGNALS - 2)[0]
    assert (MAX_SIGNALS, len(first.stimuli), len(first.trials[0].stimuli)) == (12, 12, 11)
    with pytest.raises(ManifestError, match=r"13 signals on page1\.score=low\.repeat=1; at most 12"):
        page(MAX_SIGNALS - 1)
    assert len(page(MAX_SIGNALS - 1, strict=False)[0].stimuli) == 13


def test_groups_are_by_page_level_and_repeat() -> None:
    _, conditions, groups, notes = laid(repeats=2)
    assert notes == []
    mushra = [g for g in groups if g.page == 0]
    assert [g.name for g in mushra[:3]] == [
        "page1.score=low.pluck=near.repeat=1", "page1.score=low.pluck=near.repeat=2",
        "page1.score=low.pluck=far.repeat=1",
    ]  # fmt: skip
    one = mushra[0]
    assert [s.code for s in one.stimuli] == sorted(s.code for s in one.stimuli)
    assert sorted(s.role for s in one.stimuli) == ["anchor35", "sound", "sound", "sound"]
    reference = next(s for s in one.stimuli if s.code == one.trials[0].reference)
    assert conditions[reference.condition].levels["damping"] == "complex"
    (anchor,) = [s for s in one.stimuli if s.role == "anchor35"]
    assert anchor.condition == reference.condition
    assert one.trials[0].codes == (reference.code, *one.trials[0].stimuli)
    assert {conditions[s.condition].all_levels["repeat"] for s in one.stimuli} == {"1"}
    pairs = [g for g in groups if g.page == 1]
    assert [g.name for g in pairs] == ["page2.score=low", "page2.score=high"]
    by_code = {s.code: conditions[s.condition].all_levels for s in pairs[0].stimuli}
    assert len(pairs[0].trials) == 2 * 2  # of both places of the pluck and both repeats
    for trial in pairs[0].trials:
        first, second = by_code[trial.reference or ""], by_code[trial.stimuli[0]]
        assert (first["damping"], second["damping"]) == ("complex", "block")
        assert {k for k in first if first[k] != second[k]} == {"damping"}


def test_pairs_of_levels() -> None:
    assert as_pairs("all", ["a", "b", "c"]) == [["a", "b"], ["a", "c"], ["b", "c"]]
    assert as_pairs(["a", "c"], []) == [["a", "c"]]
    assert as_pairs([["a", "b"], ["b", "c"]], []) == [["a", "b"], ["b", "c"]]


def test_codes_that_meet_are_drawn_again() -> None:
    codes = blind_codes(3, [str(i) for i in range(19)], length=1)
    taken: list[str] = []
    for name in map(str, range(19)):  # of the first letter that is free
        for attempt in range(1000):
            digest = hashlib.sha256(f"3\x1fcode\x1f{name}\x1f{attempt}".encode()).digest()
            letter = "bcdfghjkmnpqrstvwxz"[int.from_bytes(digest, "big") % 19]
            if letter not in taken:
                taken.append(letter)
                break
    assert list(codes.values()) == taken
    assert sorted(codes.values()) == sorted("bcdfghjkmnpqrstvwxz")
    assert {len(c) for c in blind_codes(3, ["a", "b"]).values()} == {6}


# -- plans ------------------------------------------------------------------------------------------------------------


def test_a_plan_counts_files_trials_and_seconds(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """12 renders of half a second, 24 files of 2 s; two processes take half of it and begin in 7 s."""
    monkeypatch.setattr("tonewood.workshop.batch.runner.trial_of_a_file", lambda settings, pictures: (2.0, 7.0))
    path = fakes.write(tmp_path, fakes.manifest())
    plan = plan_batch(path, tmp_path / "out", FakeRenderer(), predict=True)
    files = 4 * 4 + 2 * 4
    told = plan.summary()
    assert told.pop("conditions") == [c.name for c in plan.conditions]
    assert told == {
        "name": "damping", "to_render": 12, "rendered": 0, "files": files, "trials": 4 + 4,
        "predicted_seconds": 2.0 * files + 0.5 * 12, "failed": [], "notes": [],
    }  # fmt: skip
    for backend, start in (("processes", 7.0), ("threads", 0.0)):
        two: Any = SimpleNamespace(count=2, backend=backend)
        again = plan_batch(path, tmp_path / "out", FakeRenderer(), two, predict=True)
        assert again.seconds == (2.0 * files + 6.0) / 2 + start
    one: Any = SimpleNamespace(count=1, backend="processes")
    assert plan_batch(path, tmp_path / "out", FakeRenderer(), one, predict=True).seconds == 2.0 * files + 6.0
    assert plan_batch(path, tmp_path / "out", FakeRenderer()).seconds is None
    assert plan.trials_of_a_pair() == {1: 4}
    assert plan.room is None


@pytest.mark.parametrize(
    ("page", "trials"),
    [
        ({"group_by": ["score"], "pairs": {"damping": "all"}, "times": 3}, 3 * 4),
        ({"group_by": ["score"], "pairs": {"damping": "all"}, "subset": 6}, 2),
        ({"group_by": ["score"], "pairs": {"damping": "all"}, "subset": 2}, 1),
        ({"group_by": ["score"], "pairs": {"pluck": "all"}}, 6),
    ],
)
def test_trials_of_one_pair(tmp_path: Path, page: dict[str, Any], trials: int) -> None:
    path = fakes.write(tmp_path, fakes.manifest(pages=[{"type": "abx", **page}]))
    assert plan_batch(path, tmp_path / "out", FakeRenderer()).trials_of_a_pair() == {0: trials}


def test_a_report_in_numbers() -> None:
    report = Report("n", Path("f"), 3, 2, (sound_file("b"),), (Fault("x", "why", "long"),), ("note",), 1.23456)
    assert not report.ok
    assert report.summary() == {
        "name": "n", "folder": "f", "rendered": 3, "reused": 2, "files": 1, "failed": [{"name": "x", "reason": "why"}],
        "notes": ["note"], "seconds": 1.235,
    }  # fmt: skip


def test_trials_without_one_of_their_sounds_are_left_out() -> None:
    made = manifest(pages=[{"type": "abx", "pairs": {"damping": "all"}}, {"type": "html"}])
    groups = [
        group("p", 0, ("a", "b"), ("a", "c"), ("d", "e")),
        group("h", 1, ("x", "y", "z")),
        group("q", 0, ("m", "n")),
    ]
    kept, notes = _complete(groups, {"a", "b", "d", "x", "z"}, made)
    assert notes == ["p: 2 of 3 trials left out: a sound failed", "q: 1 of 1 trials left out: a sound failed"]
    assert [(g.name, [s.code for s in g.stimuli], [t.codes for t in g.trials]) for g in kept] == [
        ("p", ["a", "b"], [("a", "b")]), ("h", ["x", "z"], [("x", "z")])
    ]  # fmt: skip
    assert _complete(groups, set("abcdexyzmn"), made) == (groups, [])


def test_sounds_are_finite_and_have_channels() -> None:
    _check(Rendered(np.zeros((3, 1)), 1000))
    sound = np.zeros((8, 2))
    sound[5, 1] = np.inf
    with pytest.raises(TonewoodError, match=r"not finite from 0\.0050 s on"):
        _check(Rendered(sound, 1000))
    with pytest.raises(ValueError, match="Out of range float values"):
        _check(Rendered(np.zeros((3, 1)), 1000, {"a": math.nan}))
    for wrong in (np.zeros(5), np.zeros((0, 1))):
        with pytest.raises(TonewoodError, match="shape"):
            _check(Rendered(wrong, 1000))


# -- staircases and definitions ---------------------------------------------------------------------------------------


def own(condition: Any, path: str) -> Any:
    return condition.overrides.get(path, 0.5)


def test_levels_of_a_staircase_are_values_of_its_parameter() -> None:
    """The block has 0.3 s: 40, 1 and 80 % more."""
    made = manifest(pages=[{"type": "instructions"}, STAIRS])
    levels = staircase_levels(made, HERE, own)
    assert [level.key for level in levels] == [f"pages.1.{k}" for k in ("reference", "start", "lowest", "highest")]
    values = [level.condition.overrides["body.t60"] for level in levels]
    assert values == pytest.approx([0.3, 0.42, 0.303, 0.54])
    assert levels[0].condition.name == "harp.low.damping=block.pluck=near"
    assert levels[1].condition.name == f"harp.low.damping=block.pluck=near.body.t60={values[1]}"
    given = manifest(pages=[STAIRS | {"reference": 2.0}])
    assert [x.condition.overrides["body.t60"] for x in staircase_levels(given, HERE, own)] == pytest.approx(
        [2.0, 2.8, 2.02, 3.6]
    )
    assert staircase_levels(manifest(), HERE, own) == []
    with pytest.raises(ManifestError, match="fits 2 conditions, one is wanted"):
        changed_condition(
            manifest(pages=[STAIRS | {"of": {"score": "low", "damping": "block"}}]), expand(made, HERE), 0
        )


def test_a_level_may_be_a_setting_of_the_render() -> None:
    factors = fakes.BASE["factors"] | {"rate": {"path": "render.fs", "levels": {"half": 24000}}}
    made = manifest(factors=factors)
    one = expand(made, HERE)[0]
    changed = with_value(made, one, "render.max_duration", 0.25)
    assert (changed.render.fs, changed.render.max_duration) == (24000, 0.25)
    assert changed.overrides == one.overrides
    with pytest.raises(ManifestError, match=r"render\.fs"):
        with_value(made, one, "render.fs", 1)


@pytest.mark.parametrize(("most", "piece"), [(None, 0.05), (0.02, 0.02), (3.0, 0.05)])
def test_a_short_piece_of_each_level_is_tried(most: float | None, piece: float) -> None:
    made = manifest(pages=[STAIRS], render={} if most is None else {"max_duration": most})
    levels = staircase_levels(made, HERE, own)
    tried: list[float | None] = []
    check_rendering(levels, lambda condition: tried.append(condition.render.max_duration))
    assert tried == [piece] * 4

    def fail(condition: Any) -> None:
        raise ZeroDivisionError("by a plugin")

    with pytest.raises(ManifestError, match="cannot be rendered: ZeroDivisionError: by a plugin"):
        check_rendering(levels[1:], fail)


def test_a_definition_has_the_trials_whose_sounds_are_there(tmp_path: Path) -> None:
    made = manifest()
    groups = [group("p", 0, ("a", "b", "c")), group("q", 1, ("d", "e"), ("d", "f"))]
    found = definition_of(made, groups, {"a", "b", "c", "d", "e"}, tmp_path, {"p": 1.5})
    assert found["trials"] == [
        {"id": "p0", "page": 1, "reference": "a", "stimuli": ["b", "c"], "drop_db": 1.5},
        {"id": "q0", "page": 2, "reference": "d", "stimuli": ["e"], "drop_db": 0.0},
    ]
    assert (found["schema"], found["name"], found["folder"]) == ("tonewood-test/1", "damping", str(tmp_path.resolve()))
    assert "room_sha256" not in found
    assert found["manifest"] == fakes.manifest()  # the keys that were written, and no others
    path = tmp_path / "answers.jsonl"
    for text, count in (("", 0), ("head\n", 0), ("head\na\nb\n", 2), ("head\na\nto", 1)):
        path.write_text(text)
        assert count_answers(path) == count
    assert count_answers(tmp_path) == 0


def test_a_test_that_was_answered_stays_as_it_is(tmp_path: Path) -> None:
    made, groups = manifest(), [group("p", 0, ("a", "b"))]
    written = definition_of(made, groups, {"a", "b"}, tmp_path, {"p": 1.5})
    (tmp_path / "test.json").write_text(json.dumps(written))
    check_answers(tmp_path, made, tmp_path, groups, 3)  # nobody has answered
    (tmp_path / "answers").mkdir()
    (tmp_path / "answers" / "x.jsonl").write_text("head\none\ntwo\n")
    check_answers(tmp_path, made, tmp_path, groups, 0)
    with pytest.raises(ManifestError, match="2 answers were given to this test, and 3 of its sounds would be replaced"):
        check_answers(tmp_path, made, tmp_path, groups, 3)
    with pytest.raises(ManifestError, match=r"and test\.json would be replaced"):
        check_answers(tmp_path, made, tmp_path, [group("p", 0, ("a", "c"))], 0)
    more = [*groups, group("q", 1, ("d", "e"))]
    with pytest.raises(ManifestError, match=r"test\.json would be replaced"):
        check_answers(tmp_path, made, tmp_path, more, 0)


# -- sounds -----------------------------------------------------------------------------------------------------------


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


# -- files beside the sounds ------------------------------------------------------------------------------------------


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


# -- the engine -------------------------------------------------------------------------------------------------------


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


# -- migration --------------------------------------------------------------------------------------------------------


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


# -- randomness and hashes --------------------------------------------------------------------------------------------


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


# -- pages and work ---------------------------------------------------------------------------------------------------


def test_one_sound_after_the_other_is_graded_against_the_reference() -> None:
    pages = [{"type": "bs1116", "group_by": ["score", "pluck"], "reference": {"damping": "proportional"}}]
    _, conditions, groups, _ = laid(pages=pages)
    assert [(g.name, g.page) for g in groups[:2]] == [
        (f"page1.score=low.pluck={pluck}.repeat=1", 0) for pluck in ("near", "far")
    ]
    levels = {s.code: conditions[s.condition].levels["damping"] for s in groups[0].stimuli}
    asked = [(levels[t.reference or ""], [levels[c] for c in t.stimuli]) for t in groups[0].trials]
    assert asked == [("proportional", ["complex"]), ("proportional", ["block"])]


def test_random_factors_are_factors() -> None:
    assert manifest(random=["damping"]).random == ["damping"]
    with pytest.raises(ManifestError, match="nope is not one of "):
        manifest(random=["damping", "nope"])


@pytest.mark.parametrize(
    ("fields", "reason"),
    [
        ({}, None),
        ({"code": "C-{id}"}, None),
        ({"code": "C"}, None),
        ({"address": "https://x.org/?c={code}&l={listener}"}, None),
        ({"address": "https://x.org/"}, None),
        ({"code": "{code}"}, "{code} is not one of id"),
        ({"code": "{"}, "Single '{' encountered"),
        ({"address": "https://x.org/{id}"}, "{id} is not one of code, listener"),
        ({"code": "{id:d}"}, "{id:d} is not one of id"),
        ({"code": "{id!r}"}, "{id!r} is not one of id"),
        ({"address": "https://x.org/{code}{z}{b}"}, "{b} is not one of code, listener"),
    ],
)
def test_names_that_a_return_is_filled_in_with(fields: dict[str, str], reason: str | None) -> None:
    if reason is None:
        assert Return.model_validate(fields).model_dump(exclude_unset=True) == fields
    else:
        with pytest.raises(ValueError, match=re.escape(reason)):
            Return.model_validate(fields)


@pytest.mark.parametrize(
    ("fields", "loops"),
    [({}, "whole"), ({"loop": "region"}, "region"), ({"plays": 2}, "off"), ({"plays": 2, "loop": "off"}, "off")],
)
def test_sounds_of_limited_plays_do_not_loop(fields: dict[str, Any], loops: str) -> None:
    assert AbxPage.model_validate({"type": "abx", "pairs": {"damping": "all"}, **fields}).loops == loops


@pytest.mark.parametrize(("down", "share"), [(1, 0.5), (2, 0.70711), (3, 0.79370)])
def test_levels_of_a_staircase_by_ratio_and_by_difference(down: int, share: float) -> None:
    plain = StaircasePage.model_validate(STAIRS | {"steps": [10.0], "down": down})
    ratio = StaircasePage.model_validate(STAIRS | {"steps": [2.0], "down": down, "ratio": True})
    assert plain.share == ratio.share == pytest.approx(share, abs=5e-6)
    assert (plain.adaptive, StaircasePage.model_validate(STAIRS).adaptive) == ("levitt", "quest_plus")
    assert (plain.transformed(3.0), ratio.transformed(3.0)) == (3.0, pytest.approx(math.log(3)))
    assert (plain.level_of(3.0), ratio.level_of(3.0)) == (3.0, pytest.approx(math.exp(3)))
    assert (plain.mean([1.0, 4.0, 16.0]), ratio.mean([1.0, 4.0, 16.0])) == (7.0, pytest.approx(4.0))
    assert hash(plain) == hash(plain.model_copy())
    assert hash(plain) != hash(ratio)


@pytest.mark.parametrize(
    ("fields", "reason"),
    [
        ({"ratio": True, "start": 1.0, "highest": 1 + 1.5 * LEAST_SPAN}, None),
        ({"ratio": True, "start": 1.0, "highest": 1 + 0.5 * LEAST_SPAN}, "too near to each other"),
        ({"lowest": -40.0, "highest": -40.0 + 60 * LEAST_SPAN, "start": -40.0}, None),
        ({"lowest": -40.0, "highest": -40.0 + 20 * LEAST_SPAN, "start": -40.0}, "too near to each other"),
        ({"ratio": True, "steps": [2.0, 1.0]}, "steps above 1"),
        ({"ratio": True, "steps": [2.0, 1.01]}, None),
        ({"ratio": True, "lowest": 0.0}, "levels above 0"),
        ({"ratio": True, "lowest": 1e-9}, None),
    ],
)
def test_ends_and_steps_of_a_staircase(fields: dict[str, Any], reason: str | None) -> None:
    if reason is None:
        assert StaircasePage.model_validate(STAIRS | fields).ratio is fields.get("ratio", False)
    else:
        with pytest.raises(ValueError, match=reason):
            StaircasePage.model_validate(STAIRS | fields)


def test_notes_of_a_condition_are_changed_all() -> None:
    one = expand(manifest(), HERE)[0]
    assert _score(one).notes == (Note(0.0, freq=110.0, force=1.0),)
    two = Note(1.0, freq=220.0, force=3.0)
    changed = dataclasses.replace(one, notes=(*(one.notes or ()), two), note_changes={"force": 5.0})
    assert [(n.time, n.freq, n.force) for n in _score(changed).notes] == [(0.0, 110.0, 5.0), (1.0, 220.0, 5.0)]


def test_a_condition_may_have_a_file_of_midi(tmp_path: Path) -> None:
    """Quarter notes of half a second each; those from 0.5 s on are played."""
    on = [mido.Message("note_on", note=57 + k, velocity=64, time=0 if k == 0 else 480) for k in range(3)]
    file = mido.MidiFile(ticks_per_beat=480)
    file.tracks.append(mido.MidiTrack([*on, mido.Message("note_off", note=59, time=480)]))
    file.save(tmp_path / "a.mid")
    midi = {"path": str(tmp_path / "a.mid"), "start": 0.5, "stop": None}
    one = dataclasses.replace(expand(manifest(), HERE)[0], notes=None, midi=midi)
    assert [n.note for n in _score(one).notes] == [58, 59]


def test_what_a_field_of_a_note_is_before_it_varies() -> None:
    instrument = tw.load_instrument("monochord")
    made = manifest(instruments={"m": "monochord"}, factors={}, pages=[{"type": "html"}])
    (condition, *_) = expand(made, HERE)
    note = Note(0.0, freq=110.0, duration=2.0)
    base = _Base(_score(condition), instrument, condition)

    def value(path: str, note: Note = note) -> float | None:
        return base.value(Draw(path, "normal", 1.0, 1, ()), note)

    velocity = dataclasses.replace(note, velocity_midi=64)
    assert value("note.force", velocity) == instrument.spec.playing.velocity.value(64)
    assert value("note.force", dataclasses.replace(note, force=2.5, velocity_midi=64)) == 2.5
    of_pluck = instrument.resolved["exciters"]["pluck"]
    for name in ("force", "angle_deg"):
        assert value(f"exciters.pluck.{name}") == of_pluck[name]
    assert value("exciters.nail.force") is None
    assert value("exciters.*.from_bridge") == of_pluck["from_bridge"] == 0.15
    assert (value("note.duration"), value("note.held")) == (2.0, None)


def test_a_plan_goes_on_without_what_cannot_be_foretold(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tonewood.workshop.batch.runner.trial_of_a_file", lambda settings, pictures: (2.0, 7.0))

    class Short(FakeRenderer):
        def predict(self, condition: Any) -> float:
            if condition.levels["damping"] == "block" and condition.levels["pluck"] == "far":
                raise TonewoodError("cannot be told")
            return 0.5

    plan = plan_batch(fakes.write(tmp_path, fakes.manifest()), tmp_path / "out", Short(), predict=True)
    assert [(f.name, f.reason) for f in plan.faults] == [
        (f"harp.{score}.damping=block.pluck=far", "cannot be told") for score in ("low", "high")
    ]


def test_a_worker_renders_what_was_asked_for_alone() -> None:
    one = expand(manifest(), HERE)[0]
    renderer = FakeRenderer()
    key = content_key(renderer.identity(one))
    right = _render((renderer, one, key))
    assert (right.key, right.fault) == (key, None)
    assert right.rendered is not None
    other = _render((renderer, one, "other"))
    assert (other.key, other.rendered) == ("other", None)
    assert other.fault is not None
    assert other.fault.name == one.name
    assert "would render something else" in other.fault.reason


def test_finished_work_is_counted() -> None:
    said: list[Any] = []
    count = _Counter(lambda *progress: said.append(progress), "render", 2)
    count()
    count()
    _Counter(None, "render", 1)()
    assert said == [("render", 1, 2), ("render", 2, 2)]


def test_tables_are_written_into_new_folders(tmp_path: Path) -> None:
    write_csv(tmp_path / "new" / "a.csv", [{"a": 1}])
    assert (tmp_path / "new" / "a.csv").read_text().split() == ["a", "1"]
