"""Knobs, phrases, designs and requests of the desk, by values worked out by hand."""

from __future__ import annotations

import asyncio
import json
import struct
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Literal

import numpy as np
import pytest
from desk_by_hand import FS, Take, sounding
from pydantic.fields import FieldInfo

import tonewood as tw
from tonewood.errors import ScoreError, TonewoodError
from tonewood.workshop.desk import knobs as desk_knobs
from tonewood.workshop.desk.knobs import (
    _words,
    acts_at_once,
    declared_field,
    groups,
    knobs,
    same_strings_and_body,
    shown,
    span,
)
from tonewood.workshop.desk.phrase import ChosenPhrase, phrase
from tonewood.workshop.desk.playback import DeskSound
from tonewood.workshop.desk.server import DeskServer
from tonewood.workshop.desk.session import MOST_SNAPSHOTS, DeskSession

# -- knobs -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("value", "low", "high", "ends"),
    [
        (1.0, 1.0, 100.0, (1.0, 100.0, False)),  # a ratio of 100 is not wide
        (1.0, 1.0, 101.0, (1.0, 4.0, True)),
        (1.0, 0.0, 100.0, (0.0, 100.0, False)),
        (1.0, 0.0, 101.0, (0.25, 4.0, True)),
        (0.0, -360.0, 360.0, (-360.0, 360.0, False)),
        (0.0, 0.0, None, (0.0, 1.0, False)),
        (0.0, None, 0.5, (-1.0, 0.5, False)),
        (-1.0, -50.0, 50.0, (-50.0, 50.0, False)),
        (-0.1, -50.0, 50.0, (-0.4, -0.025, False)),
        (2.0, 1.0, None, (1.0, 8.0, True)),
        (2.0, None, 3.0, (0.5, 3.0, True)),
    ],
)
def test_ends_of_a_knob(value: float, low: float | None, high: float | None, ends: tuple[float, float, bool]) -> None:
    assert span(value, low, high) == ends


def test_groups_are_the_parts_of_a_bundle_in_the_order_of_the_page() -> None:
    assert groups(tw.load_instrument("monochord")) == [
        "exciters.pluck", "playing", "strings.A2", "body", "body.points", "stops", "tuning", "outputs.bridge", "effects"
    ]  # fmt: skip
    guitar = groups(tw.load_instrument("classical_guitar"))
    assert guitar.index("strings.*") + 1 == guitar.index("strings.E2")


def test_knobs_of_a_pluck_are_as_declared() -> None:
    start = tw.load_instrument("monochord")
    design = start.replace({"exciters.pluck.force": 3.0})
    rows = {row["label"]: row for row in shown(design, start, {"exciters.pluck.force": 3.0}, "exciters.pluck")}
    assert rows["force"] == {
        "path": "exciters.pluck.force", "label": "force", "kind": "number", "value": 3.0, "low": 0.0, "high": 1000.0,
        "start": 0.5, "stop": 8.0, "log": True, "whole": False, "unit": "N", "doc": "force at the moment of release",
        "choices": (), "at_once": True, "start_value": 2.0,
    }  # fmt: skip
    assert rows["linear"]["kind"] == "switch"
    assert [rows["linear"][key] for key in ("start", "stop", "log", "choices")] == [0.0, 0.0, False, ()]
    assert (rows["angle_deg"]["start"], rows["angle_deg"]["stop"], rows["angle_deg"]["log"]) == (-360.0, 360.0, False)
    assert rows["from_bridge"]["unit"] == ""  # a length or a fraction: not declared
    assert set(rows) == {
        "force", "from_bridge", "angle_deg", "ramp_time", "release_time", "hold_dashpot", "linear"
    }  # fmt: skip
    assert [k.path for k in knobs(start, "body") if k.path.startswith("body.points")] == []
    assert knobs(start, "strings") == []
    scatter = {k.label: k for k in knobs(start, "strings.A2")}["scatter seed"]
    assert (scatter.whole, scatter.kind, scatter.low, scatter.high) == (True, "number", 0.0, None)
    curve = {k.label: k for k in knobs(start, "playing")}["velocity curve"]
    assert (curve.kind, curve.choices) == ("choice", ("exponential", "linear"))


@pytest.mark.parametrize(
    ("kind", "words"),
    [
        (Literal["a", "b"], ("a", "b")),
        (Literal["a"] | Literal["c"] | None, ("a", "c")),
        (Literal["a"] | float, ()),
        (str, ()),
        (None, ()),
    ],
)
def test_words_that_a_value_may_be(kind: Any, words: tuple[str, ...]) -> None:
    assert _words(None if kind is None else FieldInfo(annotation=kind)) == words
    assert _words(FieldInfo(annotation=type(None))) == ()


def test_factors_are_on_numbers_that_all_strings_have() -> None:
    guitar = tw.load_instrument("classical_guitar")
    rows = {row["path"]: row for row in shown(guitar, guitar, {"strings.*.length": {"scale": 1.02}}, "strings.*")}
    length = rows["strings.*.length"]
    assert length["doc"] == "all strings: " + declared_field(guitar, "strings.E2.length").description  # type: ignore[union-attr, operator]
    keys = ("label", "kind", "value", "start_value", "start", "stop", "log", "whole", "unit", "at_once")
    assert [length[k] for k in keys] == ["length", "factor", 1.02, 1.0, 0.5, 2.0, True, False, "times", False]
    assert rows["strings.*.tension"]["value"] == 1.0
    assert "strings.*.scatter.seed" not in rows  # whole numbers
    strings = guitar.resolved["strings"].values()
    zero = [k for k in ("tilt_deg", "cents", "split_cents") if any(s[k] == 0 for s in strings)]
    assert zero
    assert not {f"strings.*.{k}" for k in zero} & set(rows)
    assert rows["strings.*.loss.eta_a"]["label"] == "loss eta_a"


def test_switches_and_words_of_all_strings_have_no_factor(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(desk_knobs, "declared_field", lambda instrument, path: None)
    parts = {"on": True, "x": 2.0, "n": 3, "word": "a", "inner": {"y": -1.0, "off": False}, "zero": 0.0}
    fake: Any = SimpleNamespace(resolved={"strings": {"A": parts, "B": parts | {"n": 4}}})
    assert [knob.path for knob in desk_knobs._factors(fake)] == ["strings.*.x", "strings.*.n", "strings.*.inner.y"]


def test_hands_of_another_folder_or_with_another_hammer_need_a_model() -> None:
    one, other = tw.load_instrument("monochord"), tw.load_instrument("struck_monochord")
    assert same_strings_and_body(one, one)
    assert not same_strings_and_body(one, other)
    name = next(iter(other.exciters))
    value = next(k for k in knobs(other, f"exciters.{name}") if k.kind == "number")
    assert not same_strings_and_body(other, other.replace({value.path: 1.01 * value.value}))
    assert acts_at_once(one, "playing.velocity.low")
    assert not acts_at_once(one, "exciters.none_such.force")
    assert not acts_at_once(one, "effects.mode")


# -- phrases -----------------------------------------------------------------------------------------------------------


def strung(*notes: float) -> Any:
    """An instrument of open strings."""
    names = {f"s{i}": note for i, note in enumerate(notes)}
    return SimpleNamespace(groups=dict.fromkeys(names), open_note=names.__getitem__)


@pytest.mark.parametrize(
    ("kind", "words", "strings", "expected"),
    [
        ("chord", "", (45.0,), [(0.0, 45)]),
        ("chord", "", (50.2, 45.0, 45.0), [(0.0, 45), (0.03125, 50)]),
        ("chord", "", range(40, 46), [(0.03125 * i, 40 + i) for i in range(6)]),
        ("chord", "", range(40, 47), [(0.03125 * i, 40 + 7 * i // 6) for i in range(6)]),
        ("chord", "", range(40, 52), [(0.03125 * i, 40 + 2 * i) for i in range(6)]),
        ("scale", "", (50, 40), [(0.25 * i, 40 + k) for i, k in enumerate((0, 2, 4, 5, 7, 9, 11, 12))]),
        ("notes", "E2 G#2+B2", (40,), [(0.0, 40), (0.25, 44), (0.25, 47)]),
        ("notes", "A4 " * 64, (40,), [(0.25 * i, 69) for i in range(64)]),
    ],
)
def test_notes_of_a_phrase(tmp_path: Path, kind: str, words: str, strings: Any, expected: list[Any]) -> None:
    made = phrase(kind, strung(*strings), tmp_path / "a.mid", notes=words, velocity=101)
    assert [(round(n.time, 3), n.note) for n in made.notes] == [(round(t, 3), note) for t, note in expected]
    assert {n.velocity_midi for n in made.notes} == {101}
    if kind == "chord":
        assert [n.duration for n in made.notes] == pytest.approx([2.0] * len(expected), abs=2e-3)


@pytest.mark.parametrize("velocity", [1, 127])
def test_velocities_of_a_phrase_are_1_to_127(tmp_path: Path, velocity: int) -> None:
    assert phrase("chord", strung(40), tmp_path / "a.mid", velocity=velocity).notes[0].velocity_midi == velocity
    with pytest.raises(ScoreError, match="1 to 127"):
        phrase("chord", strung(40), tmp_path / "a.mid", velocity=0.99 if velocity == 1 else 127.1)


@pytest.mark.parametrize("words", ["", "A4 " * 65])
def test_a_phrase_has_1_to_64_notes(tmp_path: Path, words: str) -> None:
    with pytest.raises(ScoreError, match=f"{len(words.split())} notes; 1 to 64"):
        phrase("notes", strung(40), tmp_path / "a.mid", notes=words)
    with pytest.raises(ScoreError, match="file are allowed"):
        phrase("melody", strung(40), tmp_path / "a.mid")


def test_a_file_is_the_phrase_until_another_is_asked_for(tmp_path: Path) -> None:
    file = tmp_path / "given.mid"
    phrase("notes", strung(40), file, notes="A2 B2")
    chosen = ChosenPhrase(file, tmp_path / "made.mid")
    assert chosen.asked == {"kind": "file", "notes": "", "velocity": 80}
    assert chosen.file == file
    assert [n.note for n in chosen.score(strung(40)).notes] == [45, 47]
    chosen.asked = {"kind": "scale", "notes": "", "velocity": 80}
    assert chosen.file == tmp_path / "made.mid"
    assert [n.note for n in chosen.score(strung(40)).notes][:2] == [40, 42]
    assert ChosenPhrase(None, tmp_path / "made.mid").asked["kind"] == "chord"
    (tmp_path / "link.mid").symlink_to(file)  # the first chord would have replaced the user's score
    with pytest.raises(TonewoodError, match="is the file that the desk writes its phrases to"):
        ChosenPhrase(file, tmp_path / "link.mid")


# -- the server --------------------------------------------------------------------------------------------------------


def served(**desk: Any) -> DeskServer:
    return DeskServer(SimpleNamespace(**desk), token="t")  # type: ignore[arg-type]


def asked(body: Any = None, **query: str) -> Any:
    """A request with a token, a body and a query."""

    async def stream() -> Any:
        yield json.dumps(body).encode()

    headers = {"x-desk-token": "t", "content-type": "application/json"}
    return SimpleNamespace(headers=headers, stream=stream, query_params=query, path_params=query)


def test_an_address_has_a_token_of_16_random_bytes() -> None:
    one, other = (DeskServer(SimpleNamespace()) for _ in range(2))  # type: ignore[arg-type]
    assert len(one.token) == len(other.token) == 22
    assert one.token != other.token


def test_blocks_are_sent_ahead_of_what_is_heard() -> None:
    """A head of five numbers before each; of another stream, or of a server that ends, nothing."""
    sound = sounding(1.0, frames=9000)
    sound.serial = 7
    server = served(playback=sound)
    server._ahead = 5.0

    async def sent() -> list[bytes]:
        server._stream, blocks = 4, []
        async for block in server._blocks(4):
            blocks.append(block)
            if len(blocks) == 3:
                server._stream = 5
        return blocks + [block async for block in server._blocks(4)]

    blocks = asyncio.run(sent())
    assert [struct.unpack("<5I", b[:20]) for b in blocks] == [(512, 7, 512 * k, 1, 512 * k) for k in range(3)]
    assert np.frombuffer(blocks[0][20:], dtype="<f4").tolist() == [1.0, -1.0] * 512


def test_a_report_is_of_the_page_that_has_the_stream() -> None:
    sound = DeskSound(FS)
    server, page = served(playback=sound), sound.listen(0.0)
    server._stream = 3
    body = {"stream": 3, "heard": 70, "ahead": 0.5, "underruns": 2, "other": "text"}
    reply = asyncio.run(server._report(asked(body)))
    assert json.loads(bytes(reply.body)) == {"stream": 3}
    assert (page._heard, server._ahead, sound.meter.underruns) == (70, 0.5, 2)
    for ahead, kept in ((0.001, 0.03), (9.0, 1.0)):
        asyncio.run(server._report(asked(body | {"ahead": ahead, "heard": 71})))
        assert (page._heard, server._ahead) == (71, kept)
    asyncio.run(server._report(asked({"stream": 2, "heard": 5, "ahead": 0.2})))
    assert (page._heard, server._ahead, sound.meter.underruns) == (71, 1.0, 2)
    asyncio.run(server._report(asked({"stream": 3})))
    assert (page._heard, server._ahead, sound.meter.underruns) == (0, 1.0, 0)


@pytest.mark.parametrize(
    ("since", "frame"), [(None, 0), ("17", 17), ("-1", 0), ("x", 0), ("9" * 12, 0), ("9" * 11, 99999999999)]
)
def test_moments_are_asked_for_since_a_frame(since: str | None, frame: int) -> None:
    query = {} if since is None else {"since": since}
    assert served(playback=SimpleNamespace(moments=lambda at: at))._moments(asked(**query)) == frame


def test_views_are_asked_for_by_kind_argument_and_design() -> None:
    server = served(view=lambda *given, of_start: (*given, of_start))
    assert server._view(asked(kind="shape", argument="90")) == ("shape", "90", False)
    assert server._view(asked(kind="mobility", of="start")) == ("mobility", "", True)
    assert server._view(asked(kind="mobility", of="design")) == ("mobility", "", False)


@pytest.mark.parametrize(
    ("given", "calls"),
    [
        ({"act": "key", "note": "A2", "on": True}, [("key", "A2", 80.0, True)]),
        ({"act": "key", "note": 45, "on": 0, "velocity": 12}, [("key", 45, 12.0, False)]),
        ({"act": "compare"}, [("compare", None, False)]),
        ({"act": "compare", "name": "", "blind": True}, [("compare", "", True)]),
        ({"act": "phrase", "kind": "notes"}, [("set_phrase", "notes", "", 80.0)]),
        ({"act": "phrase", "kind": "notes", "notes": "A2", "velocity": 3}, [("set_phrase", "notes", "A2", 3.0)]),
        ({"act": "advise", "targets": "T1 = 1", "free": "x"}, [("ask", "now", ["--set"], "harp", "T1 = 1", "x")]),
        ({"act": "pick", "which": 1}, [("pick", 1)]),
        ({"act": "reveal"}, [("reveal",)]),
    ],
)
def test_acts_are_done_with_their_values(given: dict[str, Any], calls: list[Any]) -> None:
    done: list[Any] = []

    def call(name: str) -> Any:
        return lambda *values, **named: done.append((name, *values, *named.values()))

    server = served(
        key=call("key"), compare=call("compare"), set_phrase=call("set_phrase"),
        adviser=SimpleNamespace(ask=call("ask")), playback=SimpleNamespace(pick=call("pick"), reveal=call("reveal")),
        session=SimpleNamespace(instrument="now", options=lambda: ["--set"], source="harp"),
    )  # fmt: skip
    assert server._done(given) == ""
    assert done == calls


def test_a_phrase_is_played_again_and_again_unless_it_is_said() -> None:
    sound = DeskSound(FS)
    sound.swap(Take(1.0))  # type: ignore[arg-type]
    server = served(playback=sound)
    for given, playing, loop in (
        ({"act": "play"}, True, True),
        ({"act": "play", "on": False}, False, True),
        ({"act": "play", "loop": False}, True, False),
        ({"act": "play"}, True, False),
        ({"act": "loop", "on": True}, True, True),
    ):
        server._done(given)
        assert (sound.playing, sound.loop) == (playing, loop)
    with pytest.raises(TonewoodError, match="loop: a value is missing"):
        server._done({"act": "loop"})


# -- designs -----------------------------------------------------------------------------------------------------------


def test_a_bundle_that_is_saved_tells_its_changes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    written: list[Any] = []
    monkeypatch.setattr("tonewood.workshop.desk.session.write_changed", lambda *given: written.append(given))
    session = DeskSession("monochord")
    changes = {"body.a": "Föhre", "strings_from": "x", "body.b": [1.5, None]}
    session.design = replace(session.design, changes=changes)
    session.save(tmp_path / "mine")
    ((instrument, folder, title, notes),) = written
    assert (instrument, folder) == (session.instrument, tmp_path / "mine")
    assert title == f"mine, changed from monochord: {instrument.spec.title}"
    said = "changed at the desk; monochord has another value. Now "
    assert notes == {"body.a": said + '"Föhre"', "body.b": said + "[1.5, null]"}


def test_designs_are_kept_under_1_to_60_characters() -> None:
    session = DeskSession("monochord")
    session.keep("x" * 60)
    for name in ("", "  ", "x" * 61):
        with pytest.raises(TonewoodError, match="1 to 60"):
            session.keep(name)
    session.keep(" b ")
    assert list(session.snapshots) == ["x" * 60, "b"]
    assert session.snapshot("") is session.start
    session.snapshots |= {f"{i}": session.design for i in range(MOST_SNAPSHOTS - 2)}
    session.keep("b")
    with pytest.raises(TonewoodError, match=f"^name: {MOST_SNAPSHOTS} designs"):
        session.keep("c")
    session.forget("b")
    session.keep("c")
    with pytest.raises(TonewoodError, match="there is no 'b'; kept are: xxx"):
        session.recall("b")


def test_a_command_tells_the_changes_in_their_order() -> None:
    session = DeskSession("monochord", {"strings.A2.tension": 60.0})
    session.set_all({"stops.count": 12, "strings.A2.note": "B2"})
    assert (session.can_undo, session.can_redo) == (True, False)
    session.allow_code = True
    words = "tonewood render a.mid -i monochord --allow-code --set strings.A2.tension=60.0 --set stops.count=12"
    words += (
        " --set 'strings.A2.note=\"B2\"' --level calibrated --gain=-7.25 --tail=3 --max-duration=60 --subtype FLOAT"
    )
    assert session.command("a.mid", "out.wav", -7.25, 3.0) == words + " -o out.wav"
    assert session.instrument.resolved["stops"]["count"] == 12
    session.reset("strings.A2.length")  # never changed
    session.undo()
    assert (dict(session.design.changes), session.can_undo) == ({"strings.A2.tension": 60.0}, False)
    session.set_all({"strings.A2.tension": 61.0, "stops.count": 9})
    session.reset("strings.A2.tension")
    assert dict(session.design.changes) == {"stops.count": 9, "strings.A2.tension": 60.0}
