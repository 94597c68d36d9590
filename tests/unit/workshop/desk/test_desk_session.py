"""Designs on the desk: changed, undone, kept, saved, told as a command that renders the same samples."""

from __future__ import annotations

import shlex
from pathlib import Path

import numpy as np
import pytest

import tonewood as tw
from tonewood.cli.main import run
from tonewood.errors import TonewoodError
from tonewood.instrument.bundle.overrides import parse_assignment
from tonewood.instrument.contract.base import Body
from tonewood.workshop.desk.differences import differences, wolf_words
from tonewood.workshop.desk.knobs import acts_at_once, declared_field, groups, knobs, same_strings_and_body, span
from tonewood.workshop.desk.phrase import phrase
from tonewood.workshop.desk.session import MOST_CHANGES, MOST_SNAPSHOTS, DeskSession, assignment
from tonewood.workshop.desk.views import mobility, shape

TENSION = "strings.A2.tension"


def changed(session: DeskSession) -> dict[str, object]:
    return dict(session.design.changes)


def test_changes_are_undone_and_redone_in_their_order() -> None:
    session = DeskSession("monochord")
    start = session.instrument.resolved
    session.set(TENSION, 80.0)
    session.set("exciters.pluck.from_bridge", 0.1)
    session.undo()
    assert changed(session) == {TENSION: 80.0}
    session.undo()
    assert changed(session) == {}
    assert session.instrument.resolved == start
    session.undo()
    session.redo()
    session.redo()
    session.redo()
    assert changed(session) == {TENSION: 80.0, "exciters.pluck.from_bridge": 0.1}
    assert session.instrument.resolved["strings"]["A2"]["tension"] == 80.0
    session.undo()
    session.set(TENSION, 81.0)
    assert not session.can_redo


def test_one_movement_of_a_knob_is_one_change() -> None:
    session = DeskSession("monochord")
    for value in (70.0, 71.0, 72.0):
        session.set(TENSION, value, dragging=True)
    session.set(TENSION, 75.0)
    session.undo()
    assert changed(session) == {TENSION: 72.0}
    session.undo()
    assert changed(session) == {}


@pytest.mark.parametrize(
    ("path", "value"),
    [(TENSION, -1.0), (TENSION, "high"), ("strings.A2.tenson", 1.0), ("strings.E9.tension", 1.0), ("keys.table", "x")],
)
def test_what_is_not_allowed_changes_nothing(path: str, value: object) -> None:
    session = DeskSession("monochord")
    session.set(TENSION, 80.0)
    design = session.design
    with pytest.raises(TonewoodError):
        session.set(path, value)
    assert session.design is design
    session.undo()
    assert changed(session) == {}


@pytest.mark.slow
def test_history_and_designs_are_bounded() -> None:
    session = DeskSession("monochord")
    for i in range(MOST_CHANGES + 20):
        session.set(TENSION, 70.0 + 0.001 * i)
    undone = 0
    while session.can_undo:
        session.undo()
        undone += 1
    assert undone == MOST_CHANGES
    for i in range(MOST_SNAPSHOTS):
        session.keep(f"design {i}")
    with pytest.raises(TonewoodError, match=f"{MOST_SNAPSHOTS} designs"):
        session.keep("one more")
    session.keep("design 0")
    with pytest.raises(TonewoodError, match="1 to 60"):
        session.keep(" ")


def test_a_design_is_kept_and_recalled() -> None:
    session = DeskSession("monochord", {TENSION: 77.0})
    session.set(TENSION, 80.0)
    session.keep("stiff")
    session.reset(TENSION)
    assert changed(session) == {TENSION: 77.0}
    session.recall("stiff")
    assert changed(session) == {TENSION: 80.0}
    session.undo()
    assert changed(session) == {TENSION: 77.0}
    session.forget("stiff")
    with pytest.raises(TonewoodError, match="nothing yet"):
        session.recall("stiff")


@pytest.mark.parametrize(
    "value", [1e-5, -3, True, None, "D2", [0.1, -0.2], {"scale": 2.0}, [{"at": "x", "mass": 1e-3}]]
)
def test_an_assignment_is_read_again_as_it_was(value: object) -> None:
    assert parse_assignment(assignment("a.b", value)) == ("a.b", value)


def test_a_saved_bundle_is_the_design(tmp_path: Path) -> None:
    session = DeskSession("classical_guitar")
    session.set("strings_from", "ej45")
    session.set("strings.*.length", {"scale": 1.02})
    session.set("body.added", [{"at": "bridge_middle", "mass": 0.01}])
    session.save(tmp_path / "mine")
    again = tw.load_instrument(tmp_path / "mine")
    told = {"name", "title", "provenance"}
    assert {k: v for k, v in again.resolved.items() if k not in told} == {
        k: v for k, v in session.instrument.resolved.items() if k not in told
    }
    assert again.spec.provenance["strings.*.length"].kind == "authored"
    with pytest.raises(TonewoodError, match="there already"):
        session.save(tmp_path / "mine")
    with pytest.raises(TonewoodError, match="cannot be the name"):
        session.save(tmp_path / "my guitar")
    with pytest.raises(TonewoodError, match="no folder"):
        session.save(tmp_path / "missing" / "mine")
    assert [p.name for p in tmp_path.iterdir()] == ["mine"]


def test_the_command_renders_the_samples_heard(tmp_path: Path) -> None:
    from tonewood.sound.render.options import RenderOptions
    from tonewood.sound.render.renderer import assembled
    from tonewood.workshop.desk.take import PhraseTake

    session = DeskSession("monochord")
    session.set(TENSION, 80.0)
    session.set("exciters.pluck.from_bridge", 0.05)
    file, wav = tmp_path / "phrase.mid", tmp_path / "out.wav"
    score = phrase("notes", session.instrument, file, notes="A2 E3", velocity=90)
    options = RenderOptions(fs=48000, tail=0.5, max_duration=60.0, gain_db=-7.3)
    heard = PhraseTake(score, assembled(session.instrument, options), options, {}).sound()
    words = shlex.split(session.command(str(file), str(wav), -7.3, 0.5))
    with pytest.raises(SystemExit) as ended:
        run(words[1:])
    assert ended.value.code == 0
    found = np.frombuffer(_data(wav), dtype="<f4").reshape(len(heard), -1)
    assert np.array_equal(found[:, 0], heard[:, 0])
    assert np.array_equal(found[:, -1], heard[:, 1])


def _data(file: Path) -> bytes:
    """Samples of a WAV file of floats."""
    raw = file.read_bytes()
    at = raw.index(b"data")
    return raw[at + 8 : at + 8 + int.from_bytes(raw[at + 4 : at + 8], "little")]


@pytest.mark.slow
def test_every_number_of_every_part_is_a_knob_with_its_declaration() -> None:
    instrument = tw.load_instrument("classical_guitar")
    every = {knob.path: knob for group in groups(instrument) for knob in knobs(instrument, group)}
    tension = every["strings.E2.tension"]
    assert (tension.kind, tension.unit) == ("number", "N")
    assert tension.value == instrument.resolved["strings"]["E2"]["tension"]
    assert tension.start < tension.value < tension.stop
    assert every["strings.*.tension"].kind == "factor"
    assert every["strings.E2.loss.eta_a"].doc
    assert every["stops.kind"].choices == ("none", "frets", "continuous")
    assert every["stops.count"].whole
    assert every["exciters.pluck.linear"].kind == "switch"
    assert every["exciters.pluck.nail"].at_once
    assert not tension.at_once
    for knob in every.values():
        if knob.kind != "factor":
            instrument.replace({knob.path: knob.value})  # each can be set as it stands


def test_a_third_partys_parameters_are_knobs() -> None:
    pytest.importorskip("tonewood_plate", reason="needs the example of a third party's plugin")
    instrument = tw.load_instrument("plate_zither")
    declared = type(instrument.body).Parameters.model_fields
    shown = {knob.path: knob for knob in knobs(instrument, "body")}
    for name, field in declared.items():
        if isinstance(instrument.resolved["body"].get(name), float):
            assert shown[f"body.{name}"].doc == field.description


def test_hands_alone_need_no_new_model() -> None:
    guitar, piano = tw.load_instrument("classical_guitar"), tw.load_instrument("struck_monochord")
    assert same_strings_and_body(guitar, guitar.replace({"exciters.pluck.force": 3.0, "playing.note_end.t60": 0.2}))
    assert not same_strings_and_body(guitar, guitar.replace({"strings.E2.tension": 70.0}))
    hammer = next(name for name in piano.exciters if not acts_at_once(piano, f"exciters.{name}.mass"))
    assert not acts_at_once(piano, f"exciters.{hammer}.x")


def test_a_knob_spans_what_is_allowed_or_a_factor_of_four() -> None:
    assert span(0.5, 0.0, 1.0) == (0.0, 1.0, False)
    assert span(2.0, 0.0, 1e6) == (0.5, 8.0, True)
    assert span(2.0, 1.0, 5.0) == (1.0, 5.0, False)
    assert span(-2.0, None, None) == (-8.0, -0.5, False)
    assert span(0.0, None, None) == (-1.0, 1.0, False)


def test_mobility_and_shapes_are_those_of_two_modes() -> None:
    """A body of two modes: peaks of |Y| = A / (2 sigma) at their natural frequencies."""
    from tonewood.instrument.model.assembly import assemble

    model = assemble(tw.load_instrument("monochord"), 48000.0)
    shown = mobility(model)
    (curve,) = shown["db"].values()
    freq, db = np.array(shown["freq"]), np.array(curve)
    body = model.body
    point = model.strings["A2"].polarizations[0].ends
    residues = body.residues(max(point, key=lambda p: abs(point[p])))
    first = int(np.argmax(residues / body.damping_rate))
    peak = 20 * np.log10(residues[first] / (2 * body.damping_rate[first]))
    at = int(np.argmin(np.abs(freq - body.natural_freq[first])))
    assert db[at] == pytest.approx(peak, abs=1.0)
    assert shape(model, float(body.natural_freq[first]))["freq"] == pytest.approx(body.natural_freq[first], rel=1e-9)
    assert wolf_words([], []) == []


def test_bodies_declare_no_preview_unless_they_need_one() -> None:
    assert dict(Body.preview) == {}
    assert dict(type(tw.load_instrument("drawn_guitar").body).preview) == {"fmax": 1000.0, "cell": 0.04}


def test_modes_without_a_counterpart_are_said() -> None:
    """Modes that no mode of the other design pairs with, of the start and of the design."""
    from tonewood.instrument.model.assembly import assemble

    start, other = (assemble(tw.load_instrument(name), 48000.0) for name in ("monochord", "classical_guitar"))
    said = [line for line in differences(other, start) if line.endswith("no counterpart")]
    assert said
    assert not [line for line in differences(start, start) if "counterpart" in line]


def test_declarations_of_a_plugin_within_a_plugin_are_found() -> None:
    """The loss of a string: the string's own field, and the fields of the law."""
    instrument = tw.load_instrument("monochord")
    string = type(instrument.resonators["A2"]).Parameters.model_fields
    law = type(instrument.resonators["A2"].parameters.loss).Parameters.model_fields
    assert declared_field(instrument, "strings.A2.loss") == string["loss"]
    for name, field in law.items():
        assert declared_field(instrument, f"strings.A2.loss.{name}") == field
    assert declared_field(instrument, "strings.A2.none_such") is None


def test_truths_and_names_are_no_numbers_to_turn() -> None:
    """No factor on a truth that all strings have; neither schema nor name is a knob."""
    instrument = tw.load_instrument("grand_piano")
    every = [knob for group in groups(instrument)[:3] for knob in knobs(instrument, group)]
    strings = list(instrument.resolved["strings"].values())
    for knob in every:
        assert knob.path.split(".")[-1] not in ("schema", "name", "plugin")
        if knob.kind == "factor":
            value = strings[0]
            for key in knob.path.split(".")[2:]:
                value = value[key]
            assert isinstance(value, (int, float))
            assert not isinstance(value, bool)


@pytest.mark.parametrize(("kind", "steps"), [("scale", 2), ("notes", 4)])
def test_notes_of_a_phrase_overlap_by_so_many_steps(tmp_path: Path, kind: str, steps: int) -> None:
    made = phrase(kind, tw.load_instrument("monochord"), tmp_path / "a.mid", notes="A2 B2 C3")
    onsets = np.array([note.time for note in made.notes])
    lasting = np.array([note.duration for note in made.notes])
    np.testing.assert_allclose(lasting, steps * np.diff(onsets)[0], atol=2e-3)
