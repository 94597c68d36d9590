"""Views of the desk, its advice and its models, by values worked out by hand."""

from __future__ import annotations

import io
import json
import math
import shlex
import sys
import threading
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import tonewood as tw
from tonewood.errors import TonewoodError
from tonewood.instrument.inspection.wolf import WolfNote
from tonewood.sound.render.options import RenderOptions
from tonewood.workshop.desk.advice import Adviser, offered
from tonewood.workshop.desk.ahead import Ahead
from tonewood.workshop.desk.ahead import main as make_ahead
from tonewood.workshop.desk.differences import differences, wolf_words
from tonewood.workshop.desk.kept_views import KeptViews
from tonewood.workshop.desk.models import KeptModels, ModelMaker, Wanted, previewed
from tonewood.workshop.desk.views import _rounded, drawing, force, mobility, neck, shape, strings
from tonewood.workshop.report.facts import BodyMode

# -- advice ------------------------------------------------------------------------------------------------------------


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


# -- models ------------------------------------------------------------------------------------------------------------


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


# -- views -------------------------------------------------------------------------------------------------------------


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
