"""Values of the desk against figures worked out by hand: knobs, phrases, sound, words, advice."""

from __future__ import annotations

import asyncio
import io
import json
import math
import shlex
import struct
import sys
import threading
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Literal

import numpy as np
import pytest
from pydantic.fields import FieldInfo

import tonewood as tw
from tonewood.errors import ScoreError, TonewoodError
from tonewood.instrument.inspection.wolf import WolfNote
from tonewood.sound.live.instrument import Live
from tonewood.sound.render.options import RenderOptions
from tonewood.workshop.desk import knobs as desk_knobs
from tonewood.workshop.desk.advice import Adviser, offered
from tonewood.workshop.desk.ahead import Ahead
from tonewood.workshop.desk.ahead import main as make_ahead
from tonewood.workshop.desk.desk import Desk
from tonewood.workshop.desk.differences import differences, wolf_words
from tonewood.workshop.desk.kept_views import KeptViews
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
from tonewood.workshop.desk.models import KeptModels, ModelMaker, Wanted, previewed
from tonewood.workshop.desk.phrase import ChosenPhrase, phrase
from tonewood.workshop.desk.playback import ComparedTakes, DeskSound, PageProgress
from tonewood.workshop.desk.server import DeskServer
from tonewood.workshop.desk.session import MOST_SNAPSHOTS, DeskSession
from tonewood.workshop.desk.take import PhraseTake, Ringing, stored
from tonewood.workshop.desk.views import _rounded, drawing, force, mobility, neck, shape, strings
from tonewood.workshop.report.facts import BodyMode

FS = 1000  # a fade lasts 30 frames, the margin 40


# -- advice -----------------------------------------------------------------------------------------------------------


def of_body(**body: Any) -> Any:
    return SimpleNamespace(resolved={"body": body})


@pytest.mark.parametrize(
    ("body", "lines"),
    [
        ({}, []),
        ({"thickness": 0.0025}, ["body.thickness: 0.002 .. 0.003"]),
        ({"thickness": "table.csv", "braces": {}}, []),
        ({"braces": {"a": {}}}, ["body.braces.*.height: x 0.8 .. 1.2"]),
        (
            {"added": [{"stiffness": 1.0}, {"mass": 0.01}, {"mass": 0.01, "frequency": 200.0}]},
            [
                "body.added.1.mass: 0 .. 0.05",
                "body.added.2.mass: 0.001 .. 0.05",
                "body.added.2.frequency: x 0.8 .. 1.2",
            ],
        ),
    ],
)
def test_free_parameters_are_offered_of_what_the_body_has(body: dict[str, Any], lines: list[str]) -> None:
    assert offered(of_body(**body)).splitlines() == lines


class Search:
    """A process of `tonewood design` that has said all that it will."""

    def __init__(self, out: str, err: str = "", code: int = 0):
        self.stdout, self.stderr, self.code, self.ended = io.StringIO(out), io.StringIO(err), code, False

    def wait(self) -> int:
        return self.code

    def terminate(self) -> None:
        self.ended = True


@pytest.mark.parametrize(
    ("process", "lines", "fault", "overrides"),
    [
        (Search('{"lines": ["a", "b"], "overrides": {"x": 1.5}}'), ["a", "b"], "", {"x": 1.5}),
        (Search("", "first\nsecond\nlast\n", 2), [], "last", {}),
        (Search("", "", 3), [], "the search ended with code 3", {}),
        (Search('{"lines": []}', "", 0), [], "the search ended with code 0", {}),
    ],
)
def test_a_search_ends_with_its_report_or_its_last_line(
    monkeypatch: pytest.MonkeyPatch, process: Search, lines: list[str], fault: str, overrides: dict[str, float]
) -> None:
    commands: list[list[str]] = []
    monkeypatch.setattr(
        "tonewood.workshop.desk.advice.subprocess.Popen",
        lambda words, *, text, **_: commands.append(words) or (text and process),
    )
    monkeypatch.setattr(
        "tonewood.workshop.desk.advice.threading.Thread",
        lambda target, args, daemon: SimpleNamespace(start=lambda: None),
    )
    instrument = tw.load_instrument("monochord").replace({"body.added": [{"at": "bridge", "mass": 0.01}]})
    adviser = Adviser()
    adviser.overrides, adviser.fault = {"old": 1.0}, "old"
    adviser.ask(instrument, ["--set", "a=1"], "monochord", " mode 1 = 180\n\n", "\nbody.added.0.mass : 0 .. 0.05 \n")
    words = ["design", "monochord", "--set", "a=1", "--target", "mode 1 = 180"]
    words += ["--free", "body.added.0.mass=0 .. 0.05"]
    assert commands == [[sys.executable, "-P", "-m", "tonewood", *words, "--json"]]
    assert shlex.split(adviser.command) == ["tonewood", *words]
    begun = adviser.state()
    assert 0.0 <= begun.pop("seconds") < 60.0
    assert begun == {"lines": [], "fault": "", "found": {}, "command": adviser.command}
    with pytest.raises(TonewoodError, match="goes on"):
        adviser.ask(instrument, [], "monochord", "mode 1 = 180", "body.added.0.mass: 0 .. 0.05")
    adviser._follow(process)  # type: ignore[arg-type]
    ended = {"seconds": None, "lines": lines, "fault": fault, "found": overrides, "command": adviser.command}
    assert adviser.state() == ended


def test_the_last_fifty_lines_of_progress_are_kept_and_a_stopped_search_says_nothing() -> None:
    adviser, process = Adviser(), Search("", "".join(f" {i}\n" for i in range(60)))
    process.wait = lambda: setattr(adviser, "seen", list(adviser.lines)) or 0  # type: ignore[method-assign, func-returns-value]
    adviser._process = process  # type: ignore[assignment]
    adviser._follow(process)  # type: ignore[arg-type]
    assert adviser.seen == [str(i) for i in range(10, 60)]  # type: ignore[attr-defined]
    adviser._process = process  # type: ignore[assignment]
    adviser.stop()
    assert process.ended
    assert (adviser.lines, adviser.fault) == ([], "stopped")
    adviser._follow(Search('{"lines": ["x"], "overrides": {}}'))  # type: ignore[arg-type]
    assert (adviser.lines, adviser.fault) == ([], "stopped")
    idle = Adviser()
    idle.stop()
    assert idle.fault == ""


# -- models -----------------------------------------------------------------------------------------------------------


def test_the_process_ahead_assembles_the_design_that_it_reads(monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[tuple[Any, Any]] = []
    monkeypatch.setattr("tonewood.workshop.desk.ahead.assembled", lambda *given: made.append(given))
    monkeypatch.setattr("tonewood.workshop.desk.ahead.os.nice", lambda n: made.append((n, None)))
    asked = {"source": "monochord", "fs": 44100, "allow_code": False, "changes": {"strings.A2.tension": 60.0}}
    monkeypatch.setattr(sys, "stdin", io.StringIO(json.dumps(asked)))
    make_ahead()
    (nice, _), (instrument, options) = made
    assert nice == 5
    assert instrument.resolved["strings"]["A2"]["tension"] == 60.0
    assert options.fs == 44100


def test_nothing_is_made_ahead_where_nothing_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tonewood.workshop.desk.ahead.cache_folder", lambda: None)
    maker, called = Ahead("monochord", 48000, allow_code=False), list[int]()
    maker.make(SimpleNamespace(instrument=of_body(x=1), changes={}), lambda: called.append(1))  # type: ignore[arg-type]
    assert called == [1]
    assert maker._process is None


def test_the_last_three_models_are_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[int] = []
    monkeypatch.setattr(
        "tonewood.workshop.desk.models.assembled",
        lambda instrument, _: made.append(instrument.resolved["n"]) or len(made),
    )
    kept, options = KeptModels(), RenderOptions()

    def of(values: dict[str, int]) -> Any:
        return SimpleNamespace(resolved=values)

    def model(n: int) -> Any:
        return kept.model(of({"n": n}), options)

    assert [model(n) for n in (0, 1, 2)] == [1, 2, 3]
    assert model(0) == 1  # the newest again
    assert model(3) == 4  # 1 goes
    assert [model(n) for n in (2, 0, 3)] == [3, 1, 4]
    assert made == [0, 1, 2, 3]
    assert model(1) == 5
    one, same = ({"n": 7, "m": 8}, {"m": 8, "n": 7})
    assert kept.model(of(one), options) == kept.model(of(same), options) == 6


def test_faults_of_a_model_are_told_and_the_next_is_made() -> None:
    told: list[tuple[Any, str]] = []
    used: list[Any] = []
    done = threading.Semaphore(0)
    faults = {
        1: TonewoodError("no", key="body"),
        2: ValueError("bad"),
        3: MemoryError("much"),
        4: ZeroDivisionError("0"),
    }

    def model(instrument: int, _: Any) -> int:
        if instrument in faults:
            raise faults[instrument]
        return 10 * instrument

    def fault(wanted: Any, words: str) -> None:
        told.append((wanted.instrument, words))
        done.release()

    def use(made: Any, wanted: Any) -> None:
        used.append((made, wanted.instrument))
        done.release()

    maker = ModelMaker(RenderOptions(), fault, SimpleNamespace(model=model))  # type: ignore[arg-type]
    for n in range(1, 6):
        maker.want(Wanted(n, {}, n, use))  # type: ignore[arg-type]
        assert done.acquire(timeout=60)
    assert told == [(1, "body: no"), (2, "ValueError: bad"), (3, "MemoryError: much"), (4, "ZeroDivisionError: 0")]
    assert used == [(50, 5)]
    maker.close()


def test_the_newest_model_that_waits_is_made_next_and_those_before_are_passed_over() -> None:
    made: list[Any] = []
    began, go, done = threading.Event(), threading.Event(), threading.Event()

    def model(instrument: Any, _: Any) -> Any:
        began.set()
        assert go.wait(60)
        return instrument

    maker = ModelMaker(RenderOptions(), lambda *_: None, SimpleNamespace(model=model))  # type: ignore[arg-type]
    assert maker.busy is None

    def wanted(n: int) -> Wanted:
        return Wanted(n, {}, n, lambda found, _: made.append(found) or (done.set() if n == 3 else None))  # type: ignore[arg-type, func-returns-value]

    one, two, three = map(wanted, (1, 2, 3))
    maker.want(one)
    assert began.wait(60)
    assert (maker.busy, maker.making) == (one, one)
    maker.want(two)
    assert maker.busy is two
    maker.want(three)
    assert maker.busy is three
    go.set()
    assert done.wait(60)
    assert made == [1, 3]
    maker.forget()
    maker.close()


def test_a_preview_is_of_another_body_that_is_not_coarse_already() -> None:
    guitar = tw.load_instrument("drawn_guitar")
    made = previewed(guitar, None)
    assert made is not None
    assert made[1] == "preview: body with fmax 1000, cell 0.04"
    assert previewed(made[0], None) is None
    assert previewed(guitar, guitar) is None
    other = guitar.replace({"strings.E2.tension": 70.0})
    assert previewed(other, guitar) is None  # the same body
    half = guitar.replace({"body.fmax": 1000.0})
    assert previewed(half, guitar)[1] == "preview: body with cell 0.04"  # type: ignore[index]


# -- views ------------------------------------------------------------------------------------------------------------


class Seen:
    """Models and what is computed of them, counted."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch):
        self.computed: list[tuple[str, Any]] = []
        for name in ("mobility", "strings", "neck", "shape", "force"):
            monkeypatch.setattr(f"tonewood.workshop.desk.views.{name}", self.counted(name))
        monkeypatch.setattr(
            "tonewood.workshop.desk.kept_views.wolf_notes", lambda m: self.computed.append(("wolves", m.name)) or []
        )
        monkeypatch.setattr("tonewood.workshop.desk.kept_views.differences", lambda a, b: (a.name, b.name))

    def counted(self, name: str) -> Any:
        return lambda *given: (self.computed.append((name, *given[1:])), name, *given)[1:]


def fake(name: str) -> Any:
    return SimpleNamespace(name=name, instrument=f"instrument {name}", groups={"A": 0, "B": 0})


def test_a_view_is_computed_once_per_model(monkeypatch: pytest.MonkeyPatch) -> None:
    seen, start, one, two = Seen(monkeypatch), fake("start"), fake("one"), fake("two")
    kept = KeptViews("first", "options", SimpleNamespace(model=lambda *given: start))  # type: ignore[arg-type]

    def view(model: Any, kind: str, argument: str = "", *, of_start: bool = False, exact: bool = True) -> Any:
        return kept.view(model, kind, argument, of_start=of_start, exact=exact)

    assert view(one, "mobility", of_start=True, exact=False) == ("mobility", one)
    assert view(one, "mobility") == view(one, "mobility") == ("mobility", one)
    assert len(seen.computed) == 2
    assert view(one, "mobility", of_start=True) == ("mobility", start)
    assert view(two, "mobility") == ("mobility", two)
    assert len(seen.computed) == 4
    assert view(two, "mobility", of_start=True) == ("mobility", start)
    assert len(seen.computed) == 4
    assert view(two, "shape", "110.5") == ("shape", two, 110.5)
    assert view(two, "force") == ("force", "instrument two", "A", "options")
    assert view(two, "force", "B") == ("force", "instrument two", "B", "options")
    assert view(two, "differences") == ("two", "start")
    seen.computed.clear()
    wolves = view(two, "wolves")
    assert wolves == {"wolves": [], "start": [], "neck": ("neck", two), "words": []}
    view(one, "wolves")  # those of the start are kept
    assert [c for c in seen.computed if c[0] == "wolves"] == [("wolves", n) for n in ("two", "start", "one")]
    for i in range(40):
        view(one, "shape", str(i))
    assert len(kept._views) == 24
    seen.computed.clear()
    view(one, "shape", "16")
    assert seen.computed == []
    view(one, "shape", "15")
    assert seen.computed == [("shape", 15.0)]
    with pytest.raises(TonewoodError, match="Hz is allowed"):
        view(one, "shape", "high")


def mode(freq: float, q: float = 20.0, residue: float = 1.0) -> BodyMode:
    return BodyMode(freq, q, 1.0, residue, 1 / residue if residue else math.inf, np.array([1.0 + 0j]))


def modal(*modes: BodyMode, **strings: tuple[float, float]) -> Any:
    """A model of body modes and of open strings: name -> tension (N), frequency (Hz)."""
    rows = {
        name: SimpleNamespace(tension=lambda stop, t=t: t, freq=lambda stop, f=f: f) for name, (t, f) in strings.items()
    }
    return SimpleNamespace(modes=modes, strings=rows, groups=dict.fromkeys(rows))


def told(monkeypatch: pytest.MonkeyPatch, model: Any, start: Any) -> list[str]:
    monkeypatch.setattr("tonewood.workshop.desk.differences.body_modes", lambda m: m.modes)
    return differences(model, start)


def cents_up(freq: float, cents: float) -> float:
    return freq * 2 ** (cents / 1200)


@pytest.mark.parametrize(
    ("other", "line"),
    [
        (mode(cents_up(100, 0.49)), None),
        (mode(cents_up(100, 0.51)), "body mode 100.0 → 100.0 Hz (+1 cents), Q 20 → 20, at the bridge +0.0 dB"),
        (mode(cents_up(100, -100)), "body mode 100.0 → 94.4 Hz (-100 cents), Q 20 → 20, at the bridge +0.0 dB"),
        (mode(100, q=20 * 1.009), None),
        (mode(100, q=22), "body mode 100.0 → 100.0 Hz (+0 cents), Q 20 → 22, at the bridge +0.0 dB"),
        (mode(100, q=18), "body mode 100.0 → 100.0 Hz (+0 cents), Q 20 → 18, at the bridge +0.0 dB"),
        (mode(100, residue=1.019), None),
        (mode(100, residue=0.981), None),
        (mode(100, residue=2), "body mode 100.0 → 100.0 Hz (+0 cents), Q 20 → 20, at the bridge +3.0 dB"),
        (mode(100, residue=0.5), "body mode 100.0 → 100.0 Hz (+0 cents), Q 20 → 20, at the bridge -3.0 dB"),
        (mode(100, residue=0), "body mode 100.0 → 100.0 Hz (+0 cents), Q 20 → 20, at the bridge +0.0 dB"),
    ],
)
def test_a_mode_differs_by_half_a_cent_one_percent_of_q_or_two_of_its_residue(
    monkeypatch: pytest.MonkeyPatch, other: BodyMode, line: str | None
) -> None:
    assert told(monkeypatch, modal(other), modal(mode(100))) == ([] if line is None else [line])


def test_a_mode_s_level_is_that_of_the_ratio_of_its_residues(monkeypatch: pytest.MonkeyPatch) -> None:
    lines = told(monkeypatch, modal(mode(100, residue=2)), modal(mode(100, residue=4)))
    assert lines == ["body mode 100.0 → 100.0 Hz (+0 cents), Q 20 → 20, at the bridge -3.0 dB"]


def test_the_three_strongest_modes_are_told(monkeypatch: pytest.MonkeyPatch) -> None:
    """Peaks of the mobility are residue Q / freq: of these 2, 0.1, 0.375, 0.5 and 0.0625."""
    figures = [(100.0, 100.0, 2.0), (200.0, 20.0, 1.0), (400.0, 5.0, 30.0), (800.0, 400.0, 1.0), (1600.0, 1.0, 100.0)]
    before = [mode(*row) for row in figures]
    after = [mode(1.01 * freq, q, residue) for freq, q, residue in figures]
    peaks = [before[i] for i in (0, 3, 2, 1, 4)]
    lines = told(monkeypatch, modal(*after), modal(*before))
    assert [line.split()[2] for line in lines] == [f"{m.freq:.1f}" for m in peaks[:3]]
    lines = told(monkeypatch, modal(), modal(*before))
    assert lines == [
        *(f"mode of the start at {m.freq:.1f} Hz has no counterpart" for m in peaks[:3]),
        "2 weaker modes have no counterpart",
        "modes of the body: 5 → 0",
    ]
    lines = told(monkeypatch, modal(*before[:3]), modal())
    assert lines[:3] == [f"mode of the design at {m.freq:.1f} Hz has no counterpart" for m in peaks if m in before[:3]]
    assert lines[3:] == ["modes of the body: 0 → 3"]


def test_open_strings_differ_by_tension_or_pitch(monkeypatch: pytest.MonkeyPatch) -> None:
    start = modal(A=(80.0, 110.0), B=(80.0, 110.0), C=(80.0, 110.0), D=(80.0, 110.0))
    design = modal(
        A=(80.15, cents_up(110, 0.4)), B=(80.17, 110.0), C=(80.0, cents_up(110, -10)), D=(79, 111), E=(9.0, 9.0)
    )
    assert told(monkeypatch, design, start) == [
        "string B: tension 80.0 → 80.2 N",
        "string C: 110.00 → 109.37 Hz",
        "string D: tension 80.0 → 79.0 N, 110.00 → 111.00 Hz",
    ]
    many = {f"s{i}": (80.0, 110.0 + i) for i in range(14)}
    lines = told(monkeypatch, modal(**many), modal(**{k: (40.0, f) for k, (_, f) in many.items()}))
    assert [line.split(":")[0] for line in lines] == [f"string s{i}" for i in range(12)]


def wolf(string: str, freq: float, severity: float) -> WolfNote:
    return WolfNote(string, freq - 1, freq + 1, freq, 0.4, 30.0, severity, freq, ())


def test_wolf_notes_are_told_where_their_severity_differs() -> None:
    start = [wolf("A", 100, 5.0), wolf("B", 200, 3.0), wolf("C", 300, 2.0)]
    now = [wolf("A", 101, 5.04), wolf("B", 200, 8.0), wolf("D", 400, 1.0)]
    assert wolf_words(start, now) == [
        "wolf note on B at 200 Hz: 3.0 → 8.0 cents",
        "wolf note on C at 300 Hz: 2.0 → none cents",
        "wolf note on D at 400 Hz: none → 1.0 cents",
    ]
    assert len(wolf_words([wolf(f"s{i}", 100, 1.0) for i in range(9)], [])) == 6


@pytest.mark.parametrize(
    ("value", "digits", "shown"),
    [(1.23456789, 4, 1.235), (math.inf, 3, 0.0), (math.nan, 3, 0.0), (-123456.0, 2, -120000.0), (0.0, 3, 0.0)],
)
def test_numbers_of_pictures_have_so_many_digits(value: float, digits: int, shown: float) -> None:
    assert _rounded(np.array([value]), digits) == [shown]


def test_the_shape_of_a_mode_has_its_largest_end_real_and_positive(monkeypatch: pytest.MonkeyPatch) -> None:
    turned = np.array([0.612345j, -0.8j])  # the larger end is turned to 1
    modes = [mode(100.0), replace(mode(200.0), shape=turned, q=math.inf), mode(400.0)]
    monkeypatch.setattr("tonewood.workshop.desk.views.body_modes", lambda model: modes)
    body = SimpleNamespace(sources=lambda upper: None)
    model = SimpleNamespace(groups={"A": 0, "B": 0}, fs=1000.0, instrument=SimpleNamespace(body=body))
    shown = shape(model, 290.0)  # type: ignore[arg-type]
    assert shown["freq"] == 200.0
    assert shown["ends"] == [-0.6123, 0.8]
    assert (shown["q"], shown["mass"], shown["strings"]) == (None, 1.0, ["A", "B"])
    assert shape(model, 310.0)["freq"] == 400.0  # type: ignore[arg-type]
    monkeypatch.setattr("tonewood.workshop.desk.views.body_modes", lambda model: [])
    with pytest.raises(TonewoodError, match="no modes"):
        shape(model, 100.0)  # type: ignore[arg-type]


def test_the_surface_of_a_mode_is_its_volume_by_area_on_the_wood(monkeypatch: pytest.MonkeyPatch) -> None:
    """Three elements on a square of 1 m, one in its hole: heights 2 and -1, of which the largest is 1."""
    ring = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    hole = 0.4 + 0.2 * ring
    surface = SimpleNamespace(
        areas=np.array([0.5, 1.0, 1.0]), volumes=np.array([[1.0, 1.0], [9.0, 9.0], [0.0, -1.0]]),
        points=np.array([[0.2, 0.2], [0.5, 0.5], [0.812345, 0.1]]), rings=[ring, hole], labels=("A0",),
    )  # fmt: skip
    basis = SimpleNamespace(natural_freq=np.array([99.0, 201.0]))
    body = SimpleNamespace(sources=lambda upper: surface, basis=lambda upper: basis)
    model = SimpleNamespace(groups={"A": 0}, fs=1000.0, instrument=SimpleNamespace(body=body))
    monkeypatch.setattr("tonewood.workshop.desk.views.body_modes", lambda model: [mode(100.0), mode(200.0)])
    shown = shape(model, 190.0)  # type: ignore[arg-type]
    largest = 1.0 + 0.99 * (2.0 - 1.0)  # 99 % quantile of 1 and 2
    assert shown["points"] == [[0.2, 0.2], [0.8123, 0.1]]
    assert shown["heights"] == pytest.approx([2 / largest, -1 / largest], rel=0.006)
    assert (shown["own_freq"], shown["label"]) == (201.0, "")
    assert shown["rings"] == [ring.tolist(), [[float(f"{x:.4g}") for x in p] for p in hole]]
    assert shape(model, 100.0)["label"] == "A0"  # type: ignore[arg-type]
    # one in 400 elements moves by 4, one by -4, the others by 1: those are cut at 1.5
    surface.areas, surface.volumes = np.ones(400), np.r_[4.0, -4.0, np.ones(398)][:, None]
    surface.points, basis.natural_freq = np.full((400, 2), 0.2), np.array([100.0])
    assert shape(model, 100.0)["heights"][:3] == [1.5, -1.5, 1.0]  # type: ignore[arg-type]


def test_the_force_on_the_body_before_the_release_is_the_lever_s() -> None:
    """F (1 - a / L) of a finger 0.15 m from the bridge of 0.9 m; F at velocity 80 is 0.4 * 10^(79/126) N."""
    instrument = tw.load_instrument("monochord")
    found = force(instrument, "A2", RenderOptions(fs=16000))
    assert (found["string"], found["fs"], found["before"]) == ("A2", 16000, 0.01)
    assert len(found["force"]) == round((0.01 + 0.06) * 16000)
    assert all(x == float(f"{x:.5g}") for x in found["force"])
    at_rest = abs(found["force"][round((0.01 - 1e-4) * 16000)])
    assert at_rest == pytest.approx(0.4 * 10 ** (79 / 126) * (1 - 0.15 / 0.9), rel=0.03)
    with pytest.raises(TonewoodError, match="there is no 'B2'; there is A2"):
        force(instrument, "B2", RenderOptions(fs=16000))


def test_strings_and_their_stops_for_the_page(monkeypatch: pytest.MonkeyPatch) -> None:
    rows = {
        f"s{i}": SimpleNamespace(open_note=45 + i, tuning=SimpleNamespace(freqs=[110.12345, 2.0])) for i in range(13)
    }
    model: Any = SimpleNamespace(strings=rows, groups=dict.fromkeys(rows))
    asked: list[Any] = []
    partial = SimpleNamespace(number=2, freq=220.5, cents=3.25, t60=math.inf)
    monkeypatch.setattr(
        "tonewood.workshop.desk.views.partials",
        lambda m, name, stop, count: asked.append((name, stop, count)) or [partial],
    )
    found = strings(model)
    assert [row["string"] for row in found] == [f"s{i}" for i in range(12)]
    assert (found[1]["note"], found[1]["partials"]) == ("A#2", [{"n": 2, "freq": 220.5, "cents": 3.25, "t60": None}])
    assert asked[0] == ("s0", 0, 20)
    assert neck(model)[0] == {"string": "s0", "freqs": [110.123, 2.0]}
    assert len(neck(model)) == 13


def test_mobility_of_the_page_has_2500_points_and_400_modes(monkeypatch: pytest.MonkeyPatch) -> None:
    place = "tonewood.workshop.desk.views."
    freq = np.linspace(40.0, 10000.0, 6001)
    monkeypatch.setattr(f"{place}frequencies", lambda body, fs: freq)
    monkeypatch.setattr(f"{place}bridge_mobility", lambda model, f: {"A": 1e-3 * f * 1j, "B": 0 * f})
    monkeypatch.setattr(f"{place}body_modes", lambda model: [replace(mode(100.0 + i), q=math.inf) for i in range(401)])
    model: Any = SimpleNamespace(body=None, fs=48000.0)
    found = mobility(model)
    shown = np.array(found["freq"])
    assert (len(shown), shown[0], shown[-1]) == (2500, 40.0, 10000.0)
    np.testing.assert_allclose(found["db"]["A"], 20 * np.log10(1e-3 * shown), atol=2e-3)
    assert found["db"]["B"] == [-240.0] * 2500
    assert (found["n_modes"], len(found["modes"]), found["modes"][0]) == (
        401,
        400,
        {"freq": 100.0, "q": None, "mass": 1.0},
    )
    monkeypatch.setattr(f"{place}frequencies", lambda body, fs: freq[:2500])
    assert mobility(model)["freq"][1] == 41.66


def test_bars_of_a_drawing_are_those_of_the_bundle() -> None:
    assert drawing(tw.load_instrument("monochord")) is None
    guitar = tw.load_instrument("drawn_guitar")
    body, shown = guitar.resolved["body"], drawing(guitar)
    assert shown is not None
    keys = ("start", "stop", "width")
    assert shown["braces"] == [{"name": n} | {k: b[k] for k in keys} for n, b in body["braces"].items()]
    assert shown["bridge"] == {k: body["bridge"][k] for k in keys}
    assert len(shown["rings"]) == 2  # outline and sound hole
    assert all(80 <= len(ring) <= 320 or len(ring) < 160 for ring in shown["rings"])
    bare = SimpleNamespace(resolved={"body": {"braces": {"a": {"start": 1, "stop": 2}}}}, body=None)
    assert drawing(bare) is None  # type: ignore[arg-type]


# -- knobs ------------------------------------------------------------------------------------------------------------


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


# -- phrases ----------------------------------------------------------------------------------------------------------


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


# -- sound ------------------------------------------------------------------------------------------------------------


class Take:
    """A phrase of one value on the left, of its negative on the right."""

    def __init__(self, value: float, frames: int = 100):
        self.value, self.length, self.frames, self.begun = value, frames, frames, 0

    def read(self, start: int, frames: int) -> Any:
        n = max(min(frames, self.length - start), 0)
        return np.tile(np.float32([self.value, -self.value]), (n, 1))

    def again(self) -> Take:
        self.begun += 1
        return self


class Keys(Live):
    """Keys that sound 1, 2, 3, ... in one channel."""

    def __init__(self) -> None:
        self.at, self.released = 0, 0

    def process(self, frames: int) -> Any:
        self.at += frames
        return np.arange(self.at - frames + 1, self.at + 1, dtype=float)[:, None]

    def all_off(self) -> None:
        self.released += 1


FALL = 1 - np.arange(30) / 30


def sounding(value: float, frames: int = 100, at: int = 0) -> DeskSound:
    sound = DeskSound(FS)
    sound.swap(Take(value, frames))  # type: ignore[arg-type]
    sound.start()
    if at:
        sound.read(at)
    return sound


def left(sound: DeskSound, frames: int) -> Any:
    out = sound.read(frames)[0]
    np.testing.assert_allclose(out[:, 1], -out[:, 0], atol=1e-6)
    return out[:, 0]


def test_another_take_comes_in_while_the_one_before_falls_in_30_ms() -> None:
    sound = sounding(1.0, at=20)
    sound.swap(Take(2.0), serial=7)  # type: ignore[arg-type]
    np.testing.assert_allclose(left(sound, 40), 2.0 + np.r_[FALL, np.zeros(10)], rtol=1e-6)
    assert (sound.serial, sound.at) == (7, 40)
    sound.swap(Take(2.0))  # type: ignore[arg-type]
    assert sound.serial == 7


def test_a_take_that_goes_on_rises_at_the_same_frame() -> None:
    sound = sounding(1.0, at=20)
    sound.swap(Take(3.0), goes_on=True)  # type: ignore[arg-type]
    assert sound.at == 20
    found = np.concatenate([left(sound, 10), left(sound, 30)])  # a rise over two blocks
    np.testing.assert_allclose(found, 3.0 * np.r_[1 - FALL, np.ones(10)] + np.r_[FALL, np.zeros(10)], atol=1e-6)
    sound.swap(Take(3.0, 25), goes_on=True)  # type: ignore[arg-type]
    assert sound.at == 25


@pytest.mark.parametrize("loop", [True, False])
def test_a_phrase_ends_or_begins_again_within_a_block(loop: bool) -> None:
    sound = sounding(1.0, frames=100)
    sound.loop = loop
    out, what = sound.read(130)
    assert (out[:, 0] == np.r_[np.ones(100), np.full(30, float(loop))]).all()
    assert (sound.playing, sound.at) == (loop, 30 if loop else 100)
    assert (what["frame"], what["place"], what["playing"]) == (0, 0, loop)
    assert sound.take.begun == 1 + loop  # type: ignore[union-attr]


def test_an_empty_phrase_ends() -> None:
    sound = sounding(1.0, frames=0)
    assert not sound.read(10)[0].any()
    assert not sound.playing


def test_a_sound_that_is_stopped_falls_and_its_keys_are_released() -> None:
    sound, keys = sounding(1.0, at=50), Keys()
    sound.live = keys
    sound.stop()
    sound.live = None
    assert keys.released == 1
    np.testing.assert_allclose(left(sound, 31), np.r_[FALL, 0.0], atol=1e-6)
    assert not sound.playing
    sound.start(again=False)
    assert (sound.playing, sound.at) == (True, 50)
    empty = DeskSound(FS)
    empty.start()
    assert not empty.playing


def test_a_and_b_are_exchanged_over_30_ms_at_their_gains() -> None:
    sound = sounding(9.0, at=20)
    pair = ComparedTakes((Take(1.0), Take(2.0)), (1.0, 0.5), ("this design", "the start"))  # type: ignore[arg-type]
    assert pair.state() == {"names": ["A: this design", "B: the start"], "which": 0, "blind": False}
    sound.compare(pair)
    rise = 1 - FALL
    np.testing.assert_allclose(left(sound, 30), 9 * FALL + rise, rtol=1e-5)
    sound.switch(0)
    np.testing.assert_allclose(left(sound, 10), 1.0)
    sound.switch(1)
    np.testing.assert_allclose(left(sound, 40), np.r_[FALL + rise, np.ones(10)], rtol=1e-6)  # 2 at a gain of 0.5
    assert sound.at == 100
    sound.switch(2)
    assert pair.which == 1
    sound.compare(None)
    assert sound.pair is None
    other = replace(pair, blind=True, order=(1, 0))
    assert other.state() == {"names": ["X", "Y"], "which": 0, "blind": True}
    assert replace(other, blind=False, which=0).state()["which"] == 1
    assert replace(other, blind=False).state()["names"] == ["B: the start", "A: this design"]


def test_keys_that_are_exchanged_fall_and_the_last_four_fades_are_kept() -> None:
    sound = DeskSound(FS)
    sound.exchange_live(Keys())
    assert (sound.read(5)[0] == np.tile(np.arange(1, 6)[:, None], 2)).all()
    sound.exchange_live(None)
    np.testing.assert_allclose(sound.read(31)[0][:, 0], np.r_[np.arange(6, 36) * FALL, 0.0], rtol=1e-6)
    for value in range(6):
        sound._fade_out(Take(float(value)), 0, 1.0)  # type: ignore[arg-type]
    assert [f.source.value for f in sound._fading] == [2.0, 3.0, 4.0, 5.0]  # type: ignore[union-attr]
    sound.read(30)
    assert sound._fading == []


@pytest.mark.parametrize("block", [7, 30, 40])
def test_a_take_that_falls_goes_on_from_where_it_was(block: int) -> None:
    """The same in blocks of any length: frames 20 to 49 of a take that counts them, at its gain."""

    class Counting(Take):
        def read(self, start: int, frames: int) -> Any:
            return np.arange(start, start + frames, dtype=np.float32)[:, None] * np.float32([1.0, -1.0])

    sound = sounding(0.0)
    sound._fade_out(Counting(0.0), 20, 0.5)  # type: ignore[arg-type]
    found = np.concatenate([left(sound, block) for _ in range(-(-40 // block))])[:40]
    np.testing.assert_allclose(found, np.r_[0.5 * np.arange(20, 50) * FALL, np.zeros(10)], rtol=1e-6)
    assert sound._fading == []


def test_effects_of_a_take_have_their_times_and_costs() -> None:
    """Of switched effects what they cost a second of sound: their own steps, and those of the loads where they run."""
    rates = SimpleNamespace(mode=2e-9, running={"bend": 1e-6}, load={"bend": 1e-7, "ring": 3e-7})
    usage = SimpleNamespace(
        costs=SimpleNamespace(rates=lambda: rates), loads={"bend": {"A": 5.0, "B": 7.0}, "ring": {"A": 2.0}}
    )
    switchings = {name: SimpleNamespace(on=on) for name, on in (("bend", {"B", "A"}), ("ring", {"A"}), ("none", {"A"}))}
    reports = [
        SimpleNamespace(name=n, title=n.upper(), component=c, seconds_active=s, seconds_saved=1.5)
        for n, c, s in (("bend", "A", 0.25), ("bend", "B", 0.12345), ("ring", "A", 0.5), ("plain", "A", 1.0))
    ]
    fake: Any = SimpleNamespace(
        model=SimpleNamespace(n_modes=100, fs=96000.0), frames=24000, fs=48000,
        renderer=SimpleNamespace(
            engine=SimpleNamespace(usage=usage, switchings=switchings), summary=lambda: SimpleNamespace(effects=reports)
        ),
    )  # fmt: skip
    whole, bend, ring, plain = PhraseTake.effects(fake)
    assert (whole["title"], whole["active"], whole["on"], whole["saved"]) == ("100 modes", {"": 0.5}, None, 0.0)
    assert whole["cost"] == pytest.approx(2e-9 * 100 * 48000)
    assert (bend["title"], bend["active"], bend["saved"]) == ("BEND", {"A": 0.25, "B": 0.123}, 3.0)
    assert (bend["on"], bend["cost"]) == (["A", "B"], pytest.approx((1e-6 + 12 * 1e-7) * 96000))
    assert (ring["on"], ring["cost"]) == (["A"], pytest.approx(2 * 3e-7 * 96000))
    assert (plain["on"], plain["cost"]) == (None, None)
    switchings["bend"].on = set()
    assert PhraseTake.effects(fake)[1]["cost"] == 0.0


def test_a_fork_is_joined_at_its_frame() -> None:
    sound = sounding(1.0, at=20)
    sound.fork(Take(5.0), 33, 4)  # type: ignore[arg-type]
    out, what = sound.read(20)
    assert (out[:, 0] == np.r_[np.ones(13), np.full(7, 5.0)]).all()
    assert (what["serial"], sound.serial) == (4, 4)
    sound.fork(Take(6.0), 90, 5)  # type: ignore[arg-type]
    sound.start()  # from its beginning, with the newest
    assert (sound.take.value, sound.serial, sound.at) == (6.0, 5, 0)  # type: ignore[union-attr]


def test_frames_that_a_page_has_not_heard_are_sent_again(monkeypatch: pytest.MonkeyPatch) -> None:
    now = [10.0]
    monkeypatch.setattr("tonewood.workshop.desk.playback.time.monotonic", lambda: now[0])
    sound = sounding(1.0, frames=400)
    page = sound.listen(2.0)
    assert (page.reported, page.unheard, sound.unheard) == (12.0, 0, 0)
    sound.read(200)
    assert (page.sent, page.unheard) == (200, 200)
    page.report(50)
    assert (page.unheard, page.reported) == (150, 10.0)
    now[0] = 10.125
    assert page.unheard == 25  # it has heard 0.125 s more
    now[0] = 10.9
    assert page.unheard == 0
    now[0] = 10.03125  # 119 are unheard, 40 of these are on their way
    assert (page.unheard, sound.unheard) == (119, 79)
    sound.swap(Take(2.0, 400))  # type: ignore[arg-type]
    out, what = sound.read(50)
    assert what["place"] == 121
    np.testing.assert_allclose(out[:, 0], 2.0 + np.r_[FALL, np.zeros(20)], rtol=1e-6)
    assert page.sent == 171
    assert sound.unheard == 20  # a fade is not cut: from 151 on
    page.report(171)
    assert sound.unheard == 0


def test_a_report_is_trusted_for_half_a_second(monkeypatch: pytest.MonkeyPatch) -> None:
    now = [10.0]
    monkeypatch.setattr("tonewood.workshop.desk.playback.time.monotonic", lambda: now[0])
    page = PageProgress(FS, 0.0)
    page.sent = 2000
    unheard = []
    for time in (9.0, 10.25, 10.5, 10.75):
        now[0] = time
        unheard.append(page.unheard)
    assert unheard == [2000, 1750, 1500, 1500]


def test_what_no_page_has_heard_is_taken_back_when_it_is_stopped(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of 200 frames that were sent 40 are on their way; then the fade of 30 is not taken back."""
    monkeypatch.setattr("tonewood.workshop.desk.playback.time.monotonic", lambda: 10.0)
    sound = sounding(1.0, frames=400)
    page = sound.listen(0.0)
    sound.read(200)
    sound.stop()
    assert (page.sent, sound.at, sound.unheard) == (40, 40, 0)
    sound.read(110)
    assert (page.sent, sound.unheard) == (150, 80)
    page.report(120)
    assert sound.unheard == 0


def test_keys_are_sent_again_with_the_phrase() -> None:
    sound = sounding(0.0, frames=400)
    page = sound.listen(9.0)
    sound.exchange_live(Keys())
    assert sound.read(100)[0][-1, 0] == 100
    sound._take_back(30)
    assert (page.sent, sound.at) == (70, 70)
    assert sound.read(20)[0][:, 0].tolist() == list(range(71, 91))
    assert sound.read(20)[0][:, 0].tolist() == list(range(91, 111))
    sound._take_back(2000)
    sound._take_back(500)  # 2 s are kept: from 1 on, as none were before
    assert sound.read(3)[0][:, 0].tolist() == [1, 2, 3]


def test_the_load_is_a_smoothed_share_of_the_blocks_time(monkeypatch: pytest.MonkeyPatch) -> None:
    times = iter((0.0, 0.05, 1.0, 1.02, 2.0, 2.001))
    monkeypatch.setattr("tonewood.workshop.desk.playback.time.perf_counter", lambda: next(times))
    sound = DeskSound(FS)
    sound.read(100)  # half of 0.1 s
    assert (sound.meter.load, sound.meter.worst) == pytest.approx((0.025, 0.5))
    sound.read(100)
    assert (sound.meter.load, sound.meter.worst) == pytest.approx((0.025 + 0.05 * (0.2 - 0.025), 0.495))
    sound.read(100)
    assert sound.meter.worst == pytest.approx(0.495 * 0.99)


def test_energy_of_modes_is_that_of_oscillators() -> None:
    """E = (v^2 + w^2 q^2) / 2 by mode; power of sound 2 sigma s E; components that are driven have none."""

    def component(q: list[float], v: list[float], w: list[float], radiated: list[float] | None = None) -> Any:
        shown = {} if radiated is None else {"radiated": radiated}
        basis = SimpleNamespace(
            motion=(1.0, 0.0, 1.0, 1.0, 0.0, 1.0), stiffness=np.square(w), is_real=True, n_modes=len(w),
            damping_rate=np.array([3.0, 5.0][: len(w)]), metadata=shown,
        )  # fmt: skip
        return SimpleNamespace(basis=basis, modes=np.array([q, v]))

    parts = {
        "A.0": component([1.0, 0.5], [2.0, 0.0], [3.0, 4.0]),  # (4 + 9) / 2 + 4 / 2
        "A.1": component([0.0], [2.0], [3.0]),  # 2
        "B.0": component([1.0], [0.0], [2.0]),  # 2
        "finger": component([1.0], [0.0], [2.0]),
        "body": component([0.0, 1.0], [4.0, 0.0], [9.0, 2.0], [0.5, 0.1]),  # 8, 2
        "microphones": component([9.0], [9.0], [9.0]),
    }
    owners = {"A.0": "A", "A.1": "A", "B.0": "B", "microphones": "A"}
    layout = SimpleNamespace(driven=[name == "microphones" for name in parts], owners=owners)
    system = SimpleNamespace(
        names=list(parts), compiled=list(parts.values()), layout=layout, modes_of=lambda state, name: state[name].modes
    )
    engine = SimpleNamespace(system=system, state=parts, model=SimpleNamespace(strings={"A": 0, "B": 0}))
    found = stored(engine, 77)  # type: ignore[arg-type]
    assert found == Ringing(77, {"A": 10.5, "B": 2.0}, 10.0, 2 * 3 * 0.5 * 8 + 2 * 5 * 0.1 * 2)
    parts["body"].basis.metadata = {}
    assert stored(engine, 0).sound is None  # type: ignore[arg-type]
    parts["A.0"].basis.is_real = False
    assert stored(engine, 0).strings["A"] == 2.0  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("serial", "heard", "preview", "known"),
    [(2, 2, "", True), (2, 3, "", True), (2, 1, "", False), (2, 2, "coarse", False), (0, 0, "", False)],
)
def test_a_preview_is_not_wanted_once_its_exact_sound_is_heard(
    serial: int, heard: int, preview: str, known: bool
) -> None:
    sounding = SimpleNamespace(take=SimpleNamespace(preview=preview), serial=heard)
    wanted, desk = SimpleNamespace(serial=serial), SimpleNamespace(playback=sounding)
    assert Desk._exact_known(desk, wanted) is known  # type: ignore[arg-type]
    desk.playback = SimpleNamespace(take=None, serial=heard)
    assert not Desk._exact_known(desk, wanted)  # type: ignore[arg-type]


# -- the server -------------------------------------------------------------------------------------------------------


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


# -- designs ----------------------------------------------------------------------------------------------------------


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
