"""Conditions, pages, plans and definitions of a batch, by values worked out by hand."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import math
import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import batch_fakes as fakes
import mido
import numpy as np
import pytest
from batch_by_hand import HERE, STAIRS, group, laid, manifest, sound_file
from batch_fakes import FakeRenderer

import tonewood as tw
from tonewood.errors import TonewoodError
from tonewood.performance.score.note import Note
from tonewood.workshop.batch.conditions import MAX_CONDITIONS, Draw, bundle_of, expand
from tonewood.workshop.batch.definition import (
    changed_condition,
    check_answers,
    check_rendering,
    count_answers,
    definition_of,
    staircase_levels,
    with_value,
)
from tonewood.workshop.batch.layout import MAX_SIGNALS, Group
from tonewood.workshop.batch.manifest import ManifestError
from tonewood.workshop.batch.page_parts import Return
from tonewood.workshop.batch.pages import LEAST_SPAN, AbxPage, StaircasePage, as_pairs
from tonewood.workshop.batch.production import (
    Fault,
)
from tonewood.workshop.batch.records import write_csv
from tonewood.workshop.batch.rendering import (
    _Base,
    _score,
)
from tonewood.workshop.batch.runner import Report, _check, _complete, _Counter, _render, plan_batch
from tonewood.workshop.batch.seeds import blind_codes
from tonewood.workshop.batch.store import Rendered, content_key

# -- conditions and layout ---------------------------------------------------------------------------------------------


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


# -- plans -------------------------------------------------------------------------------------------------------------


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


# -- staircases and definitions ----------------------------------------------------------------------------------------


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


# -- pages and work ----------------------------------------------------------------------------------------------------


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
