from __future__ import annotations

import dataclasses
import json
import pickle
import re
from pathlib import Path

import batch_fakes as fakes
import jsonschema
import numpy as np
import pytest

from tonewood.performance.score.note import Note
from tonewood.support.yaml_io import located
from tonewood.workshop.batch.conditions import Draw, expand, vary_notes
from tonewood.workshop.batch.layout import lay_out
from tonewood.workshop.batch.manifest import (
    ManifestError,
    NoteFields,
    _misfits_besides,
    check_manifest,
    load_manifest,
    manifest_schema,
)
from tonewood.workshop.batch.migration import manifest_edits
from tonewood.workshop.batch.runner import plan_batch
from tonewood.workshop.batch.seeds import blind_codes
from tonewood.workshop.dataset.manifest import dataset_schema
from tonewood.workshop.listening.staircase import StaircaseTrack

STAIRS = {
    "type": "staircase", "path": "body.t60", "start": 0.5, "lowest": 0.1, "highest": 1.0, "steps": [0.1],
}  # fmt: skip
HERE = Path()


def conditions(**changes):
    return expand(check_manifest(fakes.manifest(**changes)), HERE)


def test_crossed_conditions_in_the_manifest_s_order() -> None:
    names = [c.name for c in conditions()]
    assert len(names) == len(set(names)) == 2 * 3 * 2
    assert names[:3] == [
        "harp.low.damping=complex.pluck=near",
        "harp.low.damping=complex.pluck=far",
        "harp.low.damping=proportional.pluck=near",
    ]
    assert names[-1] == "harp.high.damping=block.pluck=far"


def test_levels_become_overrides_and_render_settings() -> None:
    factors = fakes.BASE["factors"] | {
        "rate": {"path": "render.fs", "levels": {"half": 24000, "full": 48000}},
        "tail": {"path": "render.tail", "levels": {"short": 2.0}},
    }
    first = conditions(factors=factors)[0]
    assert first.overrides == {"body.t60": 0.5, "body.detune": 1.0}
    assert (first.render.fs, first.render.tail, first.render.tail_level_db) == (24000, 2.0, -90.0)


def test_earlier_spellings_of_render_settings_mean_the_same() -> None:
    now = {"outputs": ["tailpiece"], "tail": 3.0, "tail_level_db": -40.0}
    before = {"output": "tailpiece", "tail": {"energy_db": -40.0, "cap": 3.0}}
    a, b = (conditions(render=render)[0].render for render in (now, before))
    assert a == b
    assert (a.outputs, a.tail, a.tail_level_db) == (("tailpiece",), 3.0, -40.0)
    factor = {"path": "render.tail.cap", "levels": {"short": 2.0}}
    c = conditions(render=before, factors=fakes.BASE["factors"] | {"tail": factor})[0].render
    assert (c.tail, c.tail_level_db) == (2.0, -40.0)


def test_exclusion_takes_out_matching_subsets() -> None:
    left = conditions(exclude=[{"damping": "block", "pluck": "far"}, {"score": "high", "damping": "proportional"}])
    assert len(left) == 12 - 2 - 2
    assert not [c for c in left if c.levels == {"damping": "block", "pluck": "far"}]
    with pytest.raises(ManifestError, match="nothing is left"):
        conditions(exclude=[{"instrument": "harp"}])
    one = {"instrument": "harp", "score": "low", "damping": "block", "pluck": "far"}
    assert len(conditions(exclude=[one])) == 12 - 1


def test_listed_conditions() -> None:
    rows = [{"damping": "complex", "pluck": "near"}, {"damping": "block", "pluck": "far", "score": "low"}]
    listed = conditions(design="listed", conditions=rows)
    assert [(c.score, c.levels["damping"]) for c in listed] == [
        ("low", "complex"),
        ("high", "complex"),
        ("low", "block"),
    ]


def test_repeats_share_one_performance_across_levels() -> None:
    vary = {"exciters.pluck.force": {"normal_db": 1.0}, "note.time": {"uniform": 0.01}, "body.x": {"normal": 2}}
    made = conditions(repeats=2, vary=vary)
    first = {c.levels["damping"]: c for c in made if c.score == "low" and c.repeat == 1}
    second = next(c for c in made if c.score == "low" and c.repeat == 2)
    assert first["complex"].draws == first["block"].draws
    force, time, body = first["complex"].draws
    assert (force.note_field, time.note_field, body.note_field) == ("force", "time", None)
    assert not np.array_equal(force.values(3), second.draws[0].values(3))
    assert np.array_equal(force.values(5)[:3], force.values(3))


def test_draws_follow_their_laws() -> None:
    def draw(law: str) -> Draw:
        return Draw("note.force", law, 0.5, 3, ("a",))

    n = 20_000
    uniform, normal, factor = (draw(law).values(n) for law in ("uniform", "normal", "normal_db"))
    assert np.max(np.abs(uniform)) <= 0.5
    assert uniform.std() == pytest.approx(0.5 / np.sqrt(3), rel=0.02)
    assert normal.std() == pytest.approx(0.5, rel=0.02)
    assert (20 * np.log10(factor)).std() == pytest.approx(0.5, rel=0.02)


def test_varied_notes() -> None:
    draw = Draw("note.force", "normal_db", 0.5, 3, ("a",))
    place = Draw("exciters.pluck.from_bridge", "uniform", 0.002, 3, ("a",))
    notes = (Note(0.0, force=1.0, from_bridge=0.1), Note(1.0), Note(2.0, velocity_midi=64))
    later = Draw("note.time", "uniform", 0.1, 3, ("a",))

    def base(draw: Draw, note: Note) -> float | None:
        value = getattr(note, draw.note_field)
        return 3.0 if value is None and draw.note_field == "force" else value

    of_the_body = Draw("body.t60", "normal", 1.0, 3, ("a",))  # varies no note
    got = vary_notes(notes, (of_the_body, later, draw, place), base)
    factors, shifts = draw.values(3), place.values(3)
    np.testing.assert_allclose([n.force for n in got], [1.0, 3.0, 3.0] * factors, rtol=1e-15)
    assert got[0].from_bridge == pytest.approx(0.1 + shifts[0])
    assert got[1].from_bridge is None
    np.testing.assert_allclose([n.time for n in got], np.maximum(np.arange(3) + later.values(3), 0.0))


def test_varied_quantities_are_not_negative_but_angles_are() -> None:
    notes = tuple(Note(float(i), force=0.01, angle_deg=0.0) for i in range(50))
    force, angle = (Draw(f"note.{name}", "normal", 1.0, 3, ("a",)) for name in ("force", "angle_deg"))
    got = vary_notes(notes, (force, angle), lambda draw, note: getattr(note, draw.note_field))
    np.testing.assert_allclose([n.force for n in got], np.maximum(0.01 + force.values(50), 0.0))
    np.testing.assert_allclose([n.angle_deg for n in got], angle.values(50))
    assert min(n.force for n in got) == 0.0
    assert min(n.angle_deg for n in got) < -1.0


def test_varied_velocities_stay_within_midi_and_forces_do_not() -> None:
    notes = tuple(Note(float(i), velocity_midi=120, force=120.0) for i in range(50))
    draws = tuple(Draw(f"note.{name}", "normal", 20.0, 3, ("a",)) for name in ("velocity_midi", "force"))
    got = vary_notes(notes, draws, lambda draw, note: getattr(note, draw.note_field))
    np.testing.assert_allclose([n.velocity_midi for n in got], np.minimum(120 + draws[0].values(50), 127.0))
    assert max(n.force for n in got) > 130.0


def test_inline_notes_have_the_fields_of_notes() -> None:
    assert set(NoteFields.model_fields) == {f.name for f in dataclasses.fields(Note)}
    assert NoteFields(time=1.0, string="s4").to_note() == Note(1.0, string="s4")


def test_codes_are_the_seed_s_and_tell_no_order() -> None:
    names = [f"condition {i}" for i in range(500)]
    codes = blind_codes(1, names)
    assert len(set(codes.values())) == 500
    assert codes == blind_codes(1, names)
    assert not set(codes.values()) & set(blind_codes(2, names).values())
    assert {codes[n] for n in names[::-1]} == set(blind_codes(1, names[::-1]).values())
    assert len(set(blind_codes(1, names[:19], length=1).values())) == 19  # all that there are of one letter
    order = np.argsort(np.argsort(list(codes.values())))
    assert abs(np.corrcoef(order, np.arange(500))[0, 1]) < 0.15


def test_midi_scores(tmp_path: Path) -> None:
    score = {"piece": {"midi": "piece.mid", "start": 1.0, "stop": 2.0}}
    data = check_manifest(fakes.manifest(scores=score))
    with pytest.raises(ManifestError, match=r"scores\.piece\.midi: piece\.mid cannot be read"):
        expand(data, tmp_path)
    (tmp_path / "piece.mid").write_bytes(b"one")
    one = expand(data, tmp_path)[0]
    (tmp_path / "piece.mid").write_bytes(b"two")
    two = expand(data, tmp_path)[0]
    assert one.midi is not None
    assert one.midi["path"] == str(tmp_path / "piece.mid")
    assert one.asked() != two.asked()
    assert str(tmp_path) not in json.dumps(one.asked())


def test_bundle_names_and_paths() -> None:
    folder = Path("/batches")
    made = expand(check_manifest(fakes.manifest(instruments={"a": "harp", "b": "./mine", "c": "/x/y"})), folder)
    assert [c.bundle for c in made[::12]] == ["harp", "/batches/mine", "/x/y"]


def test_a_folder_beside_the_manifest_needs_no_dot(tmp_path: Path) -> None:
    """The name of an installed instrument keeps its meaning."""
    for name in ("mine", "monochord"):
        (tmp_path / name).mkdir()
    names = {"a": "mine", "b": "monochord", "c": "gone"}
    made = expand(check_manifest(fakes.manifest(instruments=names)), tmp_path)
    assert [c.bundle for c in made[::12]] == [str(tmp_path / "mine"), "monochord", "gone"]


@pytest.mark.parametrize(
    ("changes", "line"),
    [
        ({"seed": "x"}, "m.yaml: seed: Input should be a valid integer, not 'x'"),
        ({"seed": None}, "m.yaml: seed: is missing"),
        ({"repeats": True}, "m.yaml: repeats: Input should be a valid integer, not True"),
        ({"schema": "tonewood-batch/2"}, "m.yaml: schema: Input should be 'tonewood-batch/1', not"),
        ({"name": "../x"}, "m.yaml: name: String should match pattern"),
        ({"stimuly": {}}, "m.yaml: stimuly: is not a known key; did you mean stimuli? allowed: schema, kind, name,"),
        (
            {"render": {"precision": "f64"}},
            "m.yaml: render.precision: was removed in 0.2: samples are always computed in double precision; `tonewood",
        ),
        (
            {"factors": fakes.BASE["factors"] | {"f": {"path": "render.precision", "levels": {"x": "f32"}}}},
            "m.yaml: factors.f.levels.x: was removed in 0.2",
        ),
        ({"stimuli": {"fade": {"inn": 1.0}}}, "m.yaml: stimuli.fade.inn: is not a known key; did you mean in?"),
        ({"stimuli": {"duration": -1.0}}, "m.yaml: stimuli.duration: Input should be 'page_max'; or"),
        ({"stimuli": {"subtype": "PCM_8"}}, "m.yaml: stimuli.subtype: Input should be 'PCM_16' or 'PCM_24'"),
        ({"scores": {"a": {"phrase": [{"time": "0"}]}}}, "m.yaml: scores.a.phrase.0.time: Input should be a"),
        ({"scores": {"a": {"phrase": [{"time": 0, "tim": 1}]}}}, "m.yaml: scores.a.phrase.0.tim: is not a known key"),
        ({"scores": {"a": {}}}, "m.yaml: scores.a: give either phrase or midi"),
        ({"scores": {"a": {"midi": "x", "start": 2, "stop": 1}}}, "m.yaml: scores.a: stop must be later"),
        ({"factors": {"score": {"path": "a", "levels": {"x": 1}}}}, "m.yaml: factors: score is not free"),
        ({"factors": {"f": {"path": "a b", "levels": {"x": 1}}}}, "m.yaml: factors.f.path: String should"),
        (
            {"factors": fakes.BASE["factors"] | {"f": {"path": "render.fs", "levels": {"x": "no"}}}},
            "m.yaml: factors.f.levels.x: Input should be a valid integer",
        ),
        (
            {"factors": fakes.BASE["factors"] | {"f": {"path": "render.speed", "levels": {"x": 1}}}},
            "m.yaml: factors.f.levels.x: is not a known key",
        ),
        ({"exclude": [{"damping": "compex"}]}, "m.yaml: exclude.0.damping: compex is not one of complex,"),
        ({"exclude": [{"dampng": "complex"}]}, "m.yaml: exclude.0: dampng is not one of instrument, score,"),
        ({"design": "listed"}, "m.yaml: design: listed and conditions belong together"),
        ({"design": "listed", "conditions": [{"pluck": "far"}]}, "m.yaml: conditions.0: no level of damping"),
        ({"vary": {"note.force": {}}}, "m.yaml: vary.note.force: give exactly one of normal_db"),
        ({"pages": [{"type": "musra"}]}, "m.yaml: page 1.type: musra is not one of 'consent', 'instructions',"),
        ({"pages": [{"name": "x"}]}, "m.yaml: page 1.type: is missing"),
        ({"pages": []}, "m.yaml: pages: List should have at least 1 item"),
        ({"pages": [{"type": "html", "anchors": [3500]}]}, "m.yaml: page 1: anchors are made from a reference"),
        (
            {"pages": [{"type": "mushra", "reference": {"damping": "x"}}]},
            "m.yaml: page 1.reference.damping: x is not one of complex, proportional, block",
        ),
        (
            {"pages": [{"type": "mushra", "reference": {"damping": "block"}, "anchors": [3000]}]},
            "m.yaml: page 1.anchors.0: Input should be 3500 or 7000, not 3000",
        ),
        (
            {"pages": [{"type": "html", "group_by": ["scor"]}]},
            "m.yaml: page 1.group_by: scor is not one of instrument, score, damping, pluck, repeat",
        ),
        ({"pages": [{"type": "abx", "pairs": {"dampng": "all"}}]}, "m.yaml: page 1.pairs: dampng is not one of instr"),
        (
            {"pages": [{"type": "paired_comparison", "pairs": {"damping": "all"}, "question": "?", "unforced": "no"}]},
            "m.yaml: page 1.unforced: was removed in 0.2: which of two is the reference is asked by type abx;",
        ),
        (
            {"pages": [{"type": "paired_comparison", "pairs": {"damping": "all"}}]},
            "m.yaml: page 1.question: is missing",
        ),
        ({"pages": [{"type": "training", "page": 1}]}, "m.yaml: page 1.page: 1 is no page with trials"),
        (
            {"pages": [{"type": "instructions", "name": {"deutsch!": "x"}}]},
            "m.yaml: page 1.name",
        ),
        (
            {"pages": [STAIRS | {"start": 2.0}]},
            "m.yaml: page 1: lowest <= start <= highest is wanted",
        ),
        ({"pages": [STAIRS | {"of": {"damping": "x"}}]}, "m.yaml: page 1.of.damping: x is not one of complex,"),
        ({"stimuli": {"loudness": {"short": "ungated_400ms"}}}, "m.yaml: stimuli.loudness.short: was removed in 0.2"),
        (
            {"pages": [{"type": "abx", "pairs": {"damping": ["block"]}}]},
            "m.yaml: page 1.pairs: a pair is two different levels",
        ),
        (
            {"scores": {"low": {"phrase": [{"time": 0.0, "freq": 220.0}], "stop": 1.0}}},
            "m.yaml: scores.low: start, stop and channel_per_string belong to midi",
        ),
        (
            {"pages": [{"type": "headphones", "trials": 3, "right": 4}]},
            "m.yaml: page 1: right is 4, there are 3 trials",
        ),
        (
            {"pages": [{"type": "mushra", "reference": {"damping": "block"}, "plays": 2, "loop": "whole"}]},
            "m.yaml: page 1: a loop repeats a sound without end",
        ),
        (
            {"pages": [{"type": "questionnaire", "questions": [{"name": "a", "label": "A", "kind": "choice"}]}]},
            "m.yaml: page 1.questions.0: kind: choice and choices belong together",
        ),
        ({"random": ["dampng"]}, "m.yaml: random: dampng is not one of instrument, score, damping, pluck"),
    ],
)
def test_faults_are_one_line(changes, line: str) -> None:
    with pytest.raises(ManifestError) as caught:
        check_manifest(fakes.manifest(**changes), file=Path("m.yaml"))
    assert str(caught.value).startswith(line), str(caught.value)
    assert "\n" not in str(caught.value)


def test_all_faults_are_told_at_once_with_their_lines(tmp_path: Path) -> None:
    """Faults of values, of names beside them, and pages counted from 1."""
    text = """\
schema: tonewood-batch/1
name: many
seed: x
instruments: {harp: african_harp}
scores:
  low: {phrase: [{time: 0.0, freq: 110.0}]}
factors:
  damping: {path: body.t60, levels: {a: 0.5, b: 0.4}}
exclude:
  - {dampng: a}
repeats: 0
pages:
  - {type: consent}
  - {type: mushra, reference: {damping: c}}
  - type: abx
    pairs: {damping: all}
    time: 3
  - {type: training, page: 3}
  - {type: training, page: 1}
"""
    path = tmp_path / "m.yaml"
    path.write_text(text)
    with pytest.raises(ManifestError) as caught:
        load_manifest(path)
    found = [(f.line, str(f).removeprefix(f"{path}: line {f.line}: ")) for f in located(caught.value).all]
    assert [line for line, _ in found] == [3, 10, 11, 14, 17, 19]
    assert [fault.partition(": ")[0] for _, fault in found] == [
        "seed", "exclude.0", "repeats", "page 2.reference.damping", "page 3.time", "page 5.page",
    ]  # fmt: skip
    assert "did you mean times?" in found[4][1]


def test_faults_of_the_layout_are_told_together(tmp_path: Path) -> None:
    mushra = {"type": "mushra", "reference": {"damping": "complex"}}
    path = fakes.write(tmp_path, fakes.manifest(pages=[mushra, {"type": "html"}, mushra], stimuli={"room": "no.wav"}))
    with pytest.raises(ManifestError) as caught:
        plan_batch(path, tmp_path / "out", fakes.FakeRenderer())
    assert [fault.key for fault in caught.value.all] == ["pages.0.reference", "pages.2.reference", "stimuli.room"]
    assert all(fault.file == str(path) for fault in caught.value.all)
    assert pickle.loads(pickle.dumps(caught.value)).also[1].key == "stimuli.room"


def test_every_key_of_every_page_is_in_the_reference_and_in_the_schema() -> None:
    """Mended by `python scripts/manifest_tables.py > docs/reference/manifest.md`."""
    text = (Path(__file__).parents[4] / "docs" / "reference" / "manifest.md").read_text("utf-8")
    sections = dict(re.findall(r"^###? (.+?)\n(.*?)(?=^##|\Z)", text, re.DOTALL | re.MULTILINE))
    tables = {name: re.findall(r"^\| `(\w+)` \|.*\| (.*) \|$", table, re.MULTILINE) for name, table in sections.items()}
    for schema, title in ((manifest_schema(), "A listening test"), (dataset_schema(), "A data set")):
        models = {title: schema}
        for name, model in schema["$defs"].items():
            kind = model.get("properties", {}).get("type", {}).get("const")
            models[kind or name] = model
        for name, model in models.items():
            assert {key for key, _ in tables[name]} == set(model["properties"]), name
            assert not [key for key, meaning in tables[name] if meaning in ("", "None")], name
    assert {"mushra", "staircase", "headphones", "finish"} <= tables.keys()


def test_too_many_conditions() -> None:
    levels = {f"l{i}": i for i in range(400)}
    factors = {name: {"path": name, "levels": levels} for name in ("a", "b")}
    with pytest.raises(ManifestError, match="320000 conditions; 100000 are allowed"):
        conditions(factors=factors, pages=None)


def test_the_schema_accepts_what_the_model_accepts(tmp_path: Path) -> None:
    schema = manifest_schema()
    jsonschema.Draft202012Validator.check_schema(schema)
    jsonschema.validate(fakes.manifest(), schema)
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate(fakes.manifest(stimuly={}), schema)
    assert load_manifest(fakes.write(tmp_path, fakes.manifest())).name == "damping"


def groups_of(**changes):
    data = check_manifest(fakes.manifest(**changes))
    return lay_out(data, expand(data, HERE))


def test_mushra_pages_hold_one_reference_and_its_rivals() -> None:
    groups, notes = groups_of(repeats=2)
    mushra = [g for g in groups if g.page == 0]
    assert len(mushra) == 2 * 2 * 2  # score, pluck and, always, repeat
    assert not notes
    for group in mushra:
        (trial,) = group.trials
        by_code = {s.code: s.condition for s in group.stimuli}
        assert "damping=complex" in by_code[trial.reference]
        assert len(trial.stimuli) == 3  # an anchor among them
        assert sum("damping=complex" in by_code[c] for c in trial.stimuli) == 1
        assert trial.stimuli == tuple(sorted(trial.stimuli))
    codes = [s.code for g in groups for s in g.stimuli]
    assert len(codes) == len(set(codes))


def test_pairs_differ_in_one_factor_only() -> None:
    page = {"type": "abx", "pairs": {"damping": [["complex", "block"], ["complex", "proportional"]]}}
    groups, _ = groups_of(pages=[page])
    (group,) = groups
    by_code = {s.code: s.condition for s in group.stimuli}
    pairs = {(by_code[t.reference], by_code[t.stimuli[0]]) for t in group.trials}
    assert len(pairs) == 2 * 2 * 2
    for a, b in pairs:
        parts = zip(a.split("."), b.split("."), strict=True)
        assert [x.split("=")[0] for x, y in parts if x != y] == ["damping"]
    assert len(group.stimuli) == 12


def test_a_rating_page_has_each_sound_by_itself() -> None:
    page = {"type": "rating", "scales": [{"name": "bright", "label": "Bright", "low": 1.0, "high": 7.0}]}
    groups, notes = groups_of(pages=[{"type": "instructions", "content": "c"}, page])
    assert not notes
    for group in groups:
        assert group.page == 1
        assert group.name.startswith("page2")
        assert [(trial.reference, len(trial.stimuli)) for trial in group.trials] == [(None, 1)] * len(group.stimuli)
        assert {trial.stimuli[0] for trial in group.trials} == {s.code for s in group.stimuli}


def test_the_audition_takes_what_is_on_no_other_page() -> None:
    rated = {"type": "mushra", "group_by": ["score"], "reference": {"damping": "complex", "pluck": "near"}}
    groups, _ = groups_of(pages=[{"type": "html"}])
    assert [(len(g.stimuli), g.fixed) for g in groups] == [
        (6, {"instrument": "harp", "score": "low", "repeat": "1"}),
        (6, {"instrument": "harp", "score": "high", "repeat": "1"}),
    ]
    groups, _ = groups_of(pages=[rated, {"type": "html"}])
    assert {g.page for g in groups} == {0}
    anchored = {"type": "html", "group_by": ["score", "pluck"], "reference": {"damping": "complex"}}
    groups, _ = groups_of(pages=[anchored | {"anchors": [3500, 7000]}])
    assert sorted(s.role for s in groups[0].stimuli) == ["anchor35", "anchor70", "sound", "sound", "sound"]


def test_pages_that_cannot_be() -> None:
    mushra = {"type": "mushra", "group_by": ["score"], "reference": {"damping": "complex"}}
    with pytest.raises(ManifestError, match=r"page 1\.reference: .*names 2 conditions on page1\.score=low"):
        groups_of(pages=[mushra])
    only = mushra | {"reference": {"damping": "complex", "pluck": "near"}}
    with pytest.raises(ManifestError, match="names 0 conditions"):
        groups_of(pages=[only], exclude=[{"damping": "complex", "score": "high"}])
    groups, notes = groups_of(pages=[only], exclude=[{"damping": d, "score": "high"} for d in ("block", "proportional")]
                              + [{"pluck": "far", "score": "high"}])  # fmt: skip
    assert len(groups) == 1
    assert notes == ["page1.score=high.repeat=1 is left out: nothing to compare after exclusion"]
    many = {"damping": {"path": "body.t60", "levels": {f"l{i}": 0.1 * (i + 1) for i in range(12)}}}
    crowded = mushra | {"reference": {"damping": "l0"}, "anchors": [3500]}
    with pytest.raises(ManifestError, match=r"13 signals on page1.* at most 12 \(BS\.1534\), or strict: false"):
        groups_of(factors=many, pages=[crowded])
    assert groups_of(factors=many, pages=[crowded | {"strict": False}])[0]
    with pytest.raises(ManifestError, match="pages: no page is left with anything to hear"):
        groups_of(pages=[{"type": "consent"}])
    abx = {"type": "abx", "pairs": {"damping": ["complex", "block"]}}
    groups, _ = groups_of(pages=[abx, {"type": "html"}], exclude=[{"damping": "block"}])
    assert {g.page for g in groups} == {1}


def test_a_page_may_be_grouped_by_the_repeat() -> None:
    page = {"type": "html", "group_by": ["repeat", "score"]}
    groups, _ = groups_of(pages=[page], repeats=2)
    assert [g.fixed for g in groups] == [{"score": s, "repeat": r} for s in ("low", "high") for r in "12"]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"steps": [1e-30]}, "of the largest go 8.9e-27 % of the way"),
        ({"steps": [1e-4]}, "of the largest go 0.89 % of the way"),
        ({"steps": [0.1, 1e-17]}, "steps.1: 1e-17 is lost by rounding"),
        ({"steps": [0.1, 0.1, 1e-17]}, "steps.2: 1e-17 is lost by rounding"),
        ({"steps": [1.0000000000000002], "ratio": True}, "of the way from lowest to highest, 1 % at least"),
        ({"steps": [1.0], "start": 3e16, "lowest": 2e16, "highest": 4e16}, "of the way"),
        ({"start": 0.5, "lowest": 0.5, "highest": 0.5 + 1e-15}, "too near"),
        ({"steps": [], "start": 1e16, "lowest": 1e16, "highest": 1e16 + 2}, "too near"),
        ({"steps": [], "start": 1.0, "lowest": 1.0, "highest": 1.0 + 1e-15, "ratio": True}, "too near"),
        ({"longest": 8}, "8 reversals take 13 trials or more (down: 2)"),
        ({"reversals": 9, "discard": 0, "down": 3, "longest": 19}, "9 reversals take 20 trials or more (down: 3)"),
    ],
)
def test_staircases_that_cannot_move_or_end_are_refused(change: dict[str, object], message: str) -> None:
    with pytest.raises(ManifestError) as caught:
        check_manifest(fakes.manifest(pages=[STAIRS | change]))
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(("down", "reversals", "least"), [(1, 2, 3), (2, 8, 13), (3, 9, 20), (3, 4, 9)])
def test_the_shortest_track_that_is_accepted_can_end(down: int, reversals: int, least: int) -> None:
    """The shortest track by trying all answers: wrong, then right `down` times, then wrong, and so on."""
    levitt = {"down": down, "reversals": reversals, "discard": 0, "longest": max(least, 5)}
    page = check_manifest(fakes.manifest(pages=[STAIRS | levitt])).pages[0]
    track = StaircaseTrack(page)
    while not track.done:
        run = 1 if len(track.reversal_levels) % 2 == 0 and track.levels else 0
        track.answer(right=bool(run))
    assert track.converged
    assert len(track.levels) == least
    if least > 5:
        with pytest.raises(ManifestError, match=f"take {least} trials or more"):
            check_manifest(fakes.manifest(pages=[STAIRS | levitt | {"longest": least - 1}]))


@pytest.mark.parametrize(
    ("scale", "reference", "level", "value"),
    [
        ("value", 3.0, 7.0, 7.0), ("add", 3.0, 0.5, 3.5), ("percent", 3.0, 20.0, 3.6), ("percent", None, -50.0, 0.25),
        ("db", 3.0, 20.0, 30.0), ("db", None, -20.0, 0.05), ("add", None, -0.1, 0.4),
    ],
)  # fmt: skip
def test_the_value_of_a_level(scale: str, reference: float | None, level: float, value: float) -> None:
    """The formulas of the page; the parameter's own value is 0.5."""
    page = check_manifest(fakes.manifest(pages=[STAIRS | {"scale": scale, "reference": reference}])).pages[0]
    assert page.value(level, 0.5) == pytest.approx(value, rel=1e-12)
    if scale != "value":
        with pytest.raises(ValueError, match=f"scale: {scale} needs a number"):
            page.model_copy(update={"reference": True}).value(level, 0.5)


def test_what_is_not_said_of_a_midi_file() -> None:
    source = check_manifest(
        fakes.manifest(scores={"low": {"midi": "a.mid"}}, factors={}, pages=[{"type": "html"}])
    ).scores["low"]
    assert (source.start, source.stop, source.channel_per_string) == (0.0, None, False)


def test_a_factor_is_not_called_as_a_column_of_the_answers(tmp_path: Path) -> None:
    """Results of a factor `page` were empty, those of a factor `value` a traceback."""
    levels = fakes.BASE["factors"]["damping"]
    data = fakes.manifest(factors={"page": levels, "value": levels, "pages": levels}, pages=[{"type": "html"}])
    with pytest.raises(ManifestError) as caught:
        load_manifest(fakes.write(tmp_path, data))
    assert [fault.reason.partition(" is not free as the name")[0] for fault in caught.value.all] == ["page", "value"]
    assert check_manifest(data).factors.keys() == {"page", "value", "pages"}  # a test that was answered is read


@pytest.mark.parametrize(
    ("freq", "stimuli", "reason"),
    [
        (4000.0, {"fs": 8000}, r"is 4000 Hz; less than half of stimuli.fs, 8000 Hz, is wanted"),
        (50.0, {"loudness": {"target_lufs": -5.0}}, r"a sine of 50 Hz at full scale has -7.6 LUFS"),
    ],
)
def test_a_tone_that_files_cannot_hold_is_refused(tmp_path: Path, freq: float, stimuli: dict, reason: str) -> None:
    pages = [{"type": "level", "freq": freq}, {"type": "html"}]
    path = fakes.write(tmp_path, fakes.manifest(pages=pages, stimuli=stimuli))
    with pytest.raises(ManifestError, match=rf"page 1\.freq: {reason}"):
        load_manifest(path)


def test_a_manifest_of_today_needs_no_edits() -> None:
    pages = [{"type": "paired_comparison", "question": "brighter?"}, {"type": "mushra"}]
    assert manifest_edits({"render": {"fs": 48000}, "pages": pages}) == []
    old = {"render": {"precision": "f32", "fs": 48000}, "pages": [{"type": "paired_comparison", "both_orders": True}]}
    assert manifest_edits({"render": "all", "pages": "all", "factors": {"a": "x", "b": {"path": "body.t60"}}}) == []
    edits = [(edit.path, edit.value) for edit in manifest_edits(old)]
    assert edits == [("render.precision", None), ("pages.0.type", "abx"), ("pages.0.both_orders", None)]


@pytest.mark.parametrize(
    ("change", "key"),
    [
        ({}, "colour"),
        ({"name": 5}, "name"),
        ({"schema": "x"}, "schema"),
        ({"seed": -1}, "seed"),
        ({"instruments": {"harp": 5}}, "instruments.harp"),
        ({"scores": fakes.BASE["scores"] | {"low": 3}}, "scores.low.midi"),
        ({"factors": fakes.BASE["factors"] | {"damping": fakes.BASE["factors"]["damping"] | {"path": 5}}},
         "factors.damping.path"),
        ({"pages": [*fakes.BASE["pages"], {"type": "x"}]}, f"pages.{len(fakes.BASE['pages'])}.type"),
        ({"render": {"fs": -1}}, "render.fs"),
    ],
)  # fmt: skip
def test_what_else_is_wrong_is_told_beside_a_faulty_key(change, key: str) -> None:
    """Others that name the faulty section are no faults; the manifest stays as it was."""
    data = fakes.manifest(vary={"note.colour": {"normal": 1.0}}, **change) | ({"colour": 1} if key == "colour" else {})
    before = json.dumps(data)
    assert [key for key, _ in _misfits_besides(data, [key])] == ["vary.note.colour"]
    assert json.dumps(data) == before
    assert _misfits_besides(data | {"title": 5}, [key]) == []  # something else that no misfits are known beside
