"""Commands that compare methods, make and serve listening tests and data sets, or play live; limits of options."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any, ClassVar

import pytest

import tonewood as tw
from cli_runs import Asked, refused, told
from tonewood.errors import TonewoodError
from tonewood.sound.render.options import RenderOptions

Run = Callable[..., tuple[int, str, str]]
Patch = pytest.MonkeyPatch


# comparisons of methods


def test_a_comparison_writes_its_page_and_tables(tonewood: Run, tmp_path: Path, monkeypatch: Patch) -> None:
    from tonewood.lab.accuracy import dial, least_time, report, study, tables, timing

    class Study:
        machine_line = "machine"

        def __init__(self, outcomes: list[str], machine: object, quick: bool, more: dict[str, Any]):
            self.said = {"outcomes": outcomes, "quick": quick, "more": {key: rows for key, (_, rows) in more.items()}}

        def markdown(self, plot: str | None) -> str:
            return f"page with {plot}"

        def html(self, png: bytes) -> str:
            return f"page of {png.decode()}"

        def tables(self) -> str:
            return "tables"

        def to_json(self) -> dict[str, Any]:
            return self.said

    point = SimpleNamespace(to_dict=lambda: {"a": 1})
    run, dialled, points = Asked(["one", "two"]), Asked([point]), Asked([point])
    for module, name, to in (
        (report, "Study", Study), (study, "run", run), (timing, "machine", Asked()), (dial, "run", dialled),
        (dial, "budgets", points), (dial, "section", Asked("dial rows")),
        (dial, "budget_section", Asked("budget rows")),
        (least_time, "chart_png", Asked(b"png")), (tables, "section", lambda o: f"section {o}\n"),
        (tables, "headline_tables", Asked("headlines")), (tables, "summary_table", Asked("summary")),
    ):  # fmt: skip
        monkeypatch.setattr(module, name, to)
    (tmp_path / "pictures").mkdir()
    plot, page = tmp_path / "pictures" / "a.png", tmp_path / "a.md"
    totals, positions = list[float](), list[float]()

    @contextmanager
    def progress(label: str, total: float) -> Iterator[Any]:
        totals.append(total)
        yield positions.append

    monkeypatch.setattr("tonewood.cli.accuracy.progress", progress)
    code, out, _ = tonewood("accuracy", "--quick", "--plot", plot, "--report", page)
    assert (code, run.words, run.options["quick"], points.options["quick"]) == (0, (None,), True, True)
    dialled.options["tell"](1.0)
    assert positions == totals  # at the end of the bar
    files = {file.name: file.read_text() for file in tmp_path.rglob("*.*")}
    assert files == {"a.png": "png", "a.md": "page with pictures/a.png", "a-tables.md": "tables"}
    assert out.split("\n\n")[:3] == ["machine", "section one", "section two"]
    assert out.splitlines()[-4:] == ["summary", str(plot), str(page), str(tmp_path / "a-tables.md")]
    for part in ("headlines", "dial rows", "budget rows"):
        assert part in out
    assert told(tonewood("accuracy", "--json", "--report", page))["more"] == {"dial": [{"a": 1}], "effects": [{"a": 1}]}
    assert page.read_text() == "page with None"
    run.result = ["one"]
    one = tonewood("accuracy", "--system", "klosner_d", "--report", tmp_path / "a.html")[1]
    assert run.words == ("klosner_d",)
    assert (tmp_path / "a.html").read_text() == "page of png"
    assert "headlines" not in one
    assert "dial rows" not in one


def test_a_target_is_searched_for_and_applied(tonewood: Run, tmp_path: Path, monkeypatch: Patch) -> None:
    from tonewood.lab.accuracy import target, target_report

    frontier = SimpleNamespace(cheapest=SimpleNamespace(setting=SimpleNamespace(words="--fs 44100")))
    search = Asked(frontier)
    monkeypatch.setattr(target, "search", search)
    for name, to in (("summary", "the summary"), ("to_json", {"a": 1}), ("chart_png", b"png")):
        monkeypatch.setattr(target_report, name, Asked(to))
    words = ("accuracy", "-i", "monochord", "--target", "1cent")
    code, out, _ = tonewood(
        *words, "--notes", "A2, A2:3,", "--fs", 44100, "--bandwidth", 5000, "--plot", tmp_path / "a.png"
    )
    assert (code, out) == (0, f"the summary\n{tmp_path / 'a.png'}\n")
    assert (search.words[0].name, search.words[1]) == ("monochord", target.Target.parse("1cent"))
    asked = {key: search.options[key] for key in ("notes", "fs", "bandwidth")}
    assert asked == {"notes": ["A2", "A2:3"], "fs": 44100, "bandwidth": 5000.0}
    assert (tmp_path / "a.png").read_bytes() == b"png"
    assert tonewood(*words, "--apply")[1] == "--fs 44100\n"
    assert told(tonewood(*words, "--apply", "--json"))["a"] == 1
    frontier.cheapest = None
    refused(tonewood(*words, "--apply"), "no setting meets 1cent")
    assert tonewood(*words)[1] == "the summary\n"
    refused(tonewood(*words[:3]), "--target", "is missing")
    refused(tonewood(*words, "--quick"), "are of another comparison")
    refused(tonewood("accuracy", "--apply"), "need -i INSTRUMENT")
    refused(tonewood(*words, "--bandwidth", 1), "--bandwidth")


def test_a_grid_of_stability_is_printed_and_written(tonewood: Run, tmp_path: Path, monkeypatch: Patch) -> None:
    from tonewood.lab.accuracy import attacks, stability

    grid = SimpleNamespace(attacks="A", table=Asked("table\n"), markdown=Asked("# page"), to_json=Asked({"a": 1}))
    run = Asked(grid)
    monkeypatch.setattr(stability, "run", run)
    monkeypatch.setattr(attacks, "section", lambda a: f"section {a}")
    page = tmp_path / "s.md"
    code, out, _ = tonewood("accuracy", "--stability", "--quick", "--report", page)
    assert (code, out) == (0, f"section A\n\ntable\n{page}\n")
    assert (run.words[0], page.read_text()) == (True, "# page")
    assert told(tonewood("accuracy", "--stability", "--json"))["schema"] == "tonewood-stability/1"
    assert run.words[0] is False
    refused(tonewood("accuracy", "--stability", "--plot", tmp_path / "a.png"), "neither systems to choose nor charts")
    refused(tonewood("accuracy", "--stability", "--system", "klosner_d"), "neither systems to choose nor charts")
    refused(tonewood("accuracy", "--stability", "--report", tmp_path / "a.html"), "a name ending in .md is allowed")


def test_a_failed_row_of_the_papers_ends_with_1(tonewood: Run, tmp_path: Path, monkeypatch: Patch) -> None:
    from tonewood.lab import validation

    row = SimpleNamespace(passed=True, system="plate", quantity="f1", error=0.25, tolerance=0.5)
    wrong = SimpleNamespace(passed=False, system="beam", quantity="f2", error=0.75, tolerance=0.5)
    groups, drawn = [("plate", [row])], Asked([tmp_path / "a.png"])
    for name, to in (
        ("selected", Asked()), ("run_each", lambda only: groups), ("table", lambda name, rows: f"table {name}"),
        ("counted", lambda rows: f"{len(rows)} rows"), ("draw", drawn), ("to_json", lambda rows: {"rows": len(rows)}),
    ):  # fmt: skip
        monkeypatch.setattr(validation, name, to)
    code, out, _ = tonewood("validate")
    assert (code, out.splitlines()) == (0, ["table plate", "1 rows, 0 failed"])
    groups.append(("beam", [wrong]))
    code, out, _ = tonewood("validate", "--plots", tmp_path, "--only", "b")
    assert (code, out.splitlines()[2:4]) == (1, ["2 rows, 1 failed", "FAILED: beam: f2: error 0.75, tolerance 0.5"])
    assert (drawn.words, out.splitlines()[-1]) == ((tmp_path, ["b"]), str(tmp_path / "a.png"))
    report = told(tonewood("validate", "--json"), code=1)
    assert (report["ok"], report["rows"]) == (False, 2)


# listening tests and data sets


@pytest.mark.parametrize("output", [None, "elsewhere"])
def test_results_are_written_beside_the_answers(tonewood: Run, tmp_path: Path, monkeypatch: Patch, output) -> None:
    from tonewood.workshop.listening import definition, plain, report, results

    reason = SimpleNamespace(reason="no file", answers=1)
    mean = SimpleNamespace(label="steel", mean=50.0, low=40.0, high=60.0)
    alone = SimpleNamespace(label="nylon", mean=30.0, low=None, high=None)
    term = SimpleNamespace(name="steel", difference=5.0, low=-1.0, high=11.0, p_holm=0.04, cohens_d=0.5)
    test = SimpleNamespace(name="string", df=1.0, df2=None, statistic=4.0, p_value=0.05)
    linear = SimpleNamespace(formula="y ~ x", method="REML", terms=[term], tests=[test], notes=["few"])
    pair = SimpleNamespace(factor="string", first="nylon", second="steel", r=0.25, p_holm=0.5)
    right = SimpleNamespace(cell={"a": 1}, share=0.75, right=3, answers=4, low=0.25, high=None, p_holm=0.3, d_prime=1.0)
    none = SimpleNamespace(cell={"a": 2}, share=None)
    value = SimpleNamespace(level="steel", value=1.0, low=0.5, high=1.5)
    limits = SimpleNamespace(low=None, high=2.5, mean=1.5, unit="dB", share=0.75, listeners=[1, 2])
    page = SimpleNamespace(
        page=1, heading="how bright", kind="mushra", listeners=2, cells=[mean], helpers=[alone], linear=linear,
        ranks=SimpleNamespace(pairs=[pair]), pairs=[right], detections=[right, none], scale=[value], thresholds=limits,
        screened=[SimpleNamespace(listener="L3", reason="missed the reference")],
    )  # fmt: skip
    analysis = SimpleNamespace(
        pages=[page], unfinished=["L4"], not_passed=["L5"], withdrawn=1, left_out=[reason], who="2 listeners",
        confidence=0.9, test=SimpleNamespace(manifest=SimpleNamespace(name="strings")), to_dict=lambda: {"a": 1},
    )  # fmt: skip
    asked, tables, made = Asked(analysis), Asked(), Asked(tmp_path / "report.html")
    for module, name, to in (
        (definition, "load_test", Asked()), (results, "analyse", asked), (results, "write_tables", tables),
        (report, "write_report", made), (plain, "summary", Asked(["in short"])), (plain, "methods", Asked(["how"])),
    ):  # fmt: skip
        monkeypatch.setattr(module, name, to)
    more = [] if output is None else ["-o", tmp_path / output]
    code, out, err = tonewood("results", tmp_path, "--confidence", 0.9, "--no-screening", *more)
    folder = tmp_path / (output or results.FOLDER)
    assert (code, tables.words, made.words) == (0, (analysis, folder), (analysis, folder, None))
    assert (asked.options["confidence"], asked.options["screening"], asked.options["key"]) == (0.9, False, None)
    assert err.splitlines() == [
        f"tonewood: warning: {line}" for line in (
            "L3 is left out: missed the reference", "L4 did not finish", "L5 did not pass the check of headphones",
            "1 withdrew; their answers were deleted", "left out: no file", "1 answer is left out",
        )
    ]  # fmt: skip
    assert out.splitlines() == [
        "strings: 2 listeners, 90 % intervals",
        "  in short",
        "1. how bright (mushra, 2 listeners)",
        "   steel: 50.00 [40.00, 60.00]",
        "   nylon: 30.00",
        "   y ~ x; REML",
        "     steel: +5.00 [-1.00, 11.00], p by Holm = 0.04, d = 0.50",
        "     string: F(1.0, 0.0) = 4.00, p = 0.05",
        "     few",
        "   ranks, string: steel over nylon: r = 0.25, p by Holm = 0.5",
        *["   a=1: 3 of 4 right, 75.0 % [25.0, 0.0], p by Holm = 0.3, d' = 1.00"] * 2,
        "   a=2: none decided",
        "   steel: +1.00 [0.50, 1.50] logits",
        "   threshold 1.5 [\N{EN DASH}, 2.5] dB, at 75.0 % right",
        f"{tmp_path / 'report.html'}; answers.csv and answers.parquet have one row an answer",
    ]
    report_ = told(tonewood("results", tmp_path, "--json"))
    assert (report_["a"], report_["summary"], report_["methods"]) == (1, ["in short"], ["how"])
    page.detections, limits.listeners, reason.answers = [right], [1], 2  # the page's pairs alone; one listener
    _, out, err = tonewood("results", tmp_path)
    assert out.count("3 of 4 right") == 1
    assert "threshold 1.5 dB, at 75.0 % right" in out
    assert err.splitlines()[-1].endswith("2 answers are left out")


def test_listeners_are_simulated_by_number_and_seed(tonewood: Run, tmp_path: Path, monkeypatch: Patch) -> None:
    from tonewood.workshop.listening import definition, panel

    asked = Asked([1, 2, 3])
    monkeypatch.setattr(definition, "load_test", Asked("test"))
    monkeypatch.setattr(panel, "read_panel", Asked("panel"))
    monkeypatch.setattr(panel, "simulate", asked)
    words = ("simulate", tmp_path, "--panel", tmp_path / "p.yaml")
    assert tonewood(*words, "--listeners", 3, "--seed", 9)[:2] == (0, f"{tmp_path}: 3 simulated listeners\n")
    assert asked.words == ("test", "panel", 3, 9)
    for count in (0, 10_001):
        refused(tonewood(*words, "--listeners", count), "1 to 10000 are allowed")


@pytest.mark.parametrize("faults", [[], [SimpleNamespace(name="a", reason="r", condition="a")]])
def test_a_data_set_is_planned_and_made(tonewood: Run, tmp_path: Path, monkeypatch: Patch, faults: list[Any]) -> None:
    from tonewood.cli import dataset
    from tonewood.workshop.dataset import manifest, runner

    plan = SimpleNamespace(faults=faults, summary=lambda: {"a": 1})
    report = SimpleNamespace(ok=not faults, summary=lambda: {"b": 2})
    planned, made, printed = Asked(plan), Asked(report), Asked()
    monkeypatch.setattr(manifest, "check_dataset", lambda data, *, file: (data["kind"], file))
    for module, name, to in (
        (runner, "plan_dataset", planned), (runner, "run_dataset", made), (dataset, "_print_plan", printed),
        (dataset, "_print_report", printed),
    ):  # fmt: skip
        monkeypatch.setattr(module, name, to)
    file = tmp_path / "m.yaml"
    file.write_text("kind: dataset\n")
    code, words = bool(faults), ("batch", file, "-o", tmp_path / "out")
    assert told(tonewood(*words, "--dry-run", "--json"), code)["ok"] is not code
    assert planned.words[:3] == (("dataset", file), tmp_path, tmp_path / "out")
    assert planned.options == {"predict": True}
    assert tonewood(*words, "--dry-run", "--jobs", 3) == (code, "", "")
    assert printed.words == (plan, 3)
    assert told(tonewood(*words, "--json"), code)["b"] == 2
    assert made.words[:3] == planned.words[:3]
    assert tonewood(*words) == (code, "", "")
    assert printed.words == (report,)
    refused(tonewood(*words, "--dry-run", "--pilot", tmp_path), "belongs to listening tests")
    refused(tonewood(*words, "--pilot", tmp_path), "belongs to --dry-run")
    refused(tonewood(*words, "--jobs", 0), "1 or more are allowed, or -1")


def test_a_batch_is_planned_with_its_power_and_exported(tonewood: Run, tmp_path: Path, monkeypatch: Patch) -> None:
    from tonewood.workshop.batch import runner
    from tonewood.workshop.exchange import export
    from tonewood.workshop.listening import power, results

    class Plan:
        conditions = (SimpleNamespace(name="soft"), SimpleNamespace(name="hard"))
        notes, faults = ("slow",), ()
        manifest = SimpleNamespace(power=SimpleNamespace(power=0.8, alpha=0.05))

        def summary(self) -> dict[str, Any]:
            return {"to_render": 1, "rendered": 2, "files": 3, "trials": 4, "predicted_seconds": 5.4}

        def trials_of_a_pair(self) -> int:
            return 7

    class Row:
        def __init__(self) -> None:
            self.listeners = 12

        def __str__(self) -> str:
            return "12 listeners"

    report = SimpleNamespace(
        folder=tmp_path, files=[1, 2], rendered=1, reused=3, seconds=2.5, notes=(), faults=(), ok=True,
        summary=lambda: {"c": 3},
    )  # fmt: skip
    powered, ran = Asked([Row()]), Asked(report)
    exported = Asked([SimpleNamespace(folder=tmp_path / "web", notes=["a note"])])
    for module, name, to in (
        (runner, "plan_batch", Asked(Plan())), (runner, "run_batch", ran), (power, "power_of", powered),
        (results, "analyse", lambda folder: ("pilot", folder)), (export, "export", exported),
    ):  # fmt: skip
        monkeypatch.setattr(module, name, to)
    (tmp_path / "m.yaml").write_text("kind: listening\n")
    words = ("batch", tmp_path / "m.yaml", "-o", tmp_path / "out")
    code, out, err = tonewood(*words, "--dry-run", "--pilot", tmp_path)
    assert (code, err) == (0, "tonewood: warning: slow\n")
    assert powered.words == (Plan.manifest, 7, ("pilot", tmp_path))
    assert out.splitlines() == [
        "soft", "hard", "2 conditions: 1 to render, 2 rendered; 3 files, 4 trials; about 5 s",
        "for a power of 0.8 at alpha 0.05:", "  12 listeners",
    ]  # fmt: skip
    planned = told(tonewood(*words, "--dry-run", "--json"))
    assert (planned["power"], planned["files"], powered.words[2]) == ([{"listeners": 12}], 3, None)
    code, out, err = tonewood(*words, "--export", "webmushra")
    assert (code, err) == (0, "tonewood: warning: a note\n")
    assert out.splitlines() == [f"{tmp_path}: 2 files from 1 new and 3 earlier renders, 2.5 s", str(tmp_path / "web")]
    assert exported.words == (tmp_path / "out", ["webmushra"])
    places = told(tonewood(*words, "--export", "webmushra", "--json"))
    assert (places["c"], places["exports"]) == (3, [{"folder": str(tmp_path / "web"), "notes": ["a note"]}])
    assert told(tonewood(*words, "--json"))["exports"] == []
    refused(tonewood(*words, "--export", "webmushra", "--dry-run"), "--dry-run none")
    report.ok = False
    assert tonewood(*words)[0] == 1


def test_a_sample_library_is_asked_for_and_told(tonewood: Run, tmp_path: Path, monkeypatch: Patch) -> None:
    from tonewood.workshop.sampling import library

    made = SimpleNamespace(
        sfz=tmp_path / "m.sfz", decent=tmp_path / "m.dspreset", folder=tmp_path / "m", n_samples=3, n_releases=2,
        seconds=12.4, size=2_500_000, gain_db=-6.0, rings=True,
    )  # fmt: skip
    asked = Asked(made)
    monkeypatch.setattr(library, "make_library", asked)
    words = ("sample", "monochord", "-o", tmp_path / "m")
    code, out, _ = tonewood(*words, "--range", "A2-C3", "--velocities", "40, 90", "--every", 2, "--format", "wav")
    assert code == 0
    assert asked.words[2] == library.Sampling(2, [40, 90], 2, 45, 48, 8.0, True)
    assert (asked.words[0].name, asked.words[1], asked.options["jobs"]) == ("monochord", tmp_path / "m", 1)
    assert asked.options["suffix"] == ".wav"
    assert out.splitlines() == [
        f"{tmp_path / 'm.sfz'}: 3 samples and 2 releases, 12 s of sound, 2.5 MB in {tmp_path / 'm'}",
        f"  all at -6.0 dB re the instrument's calibrated level; Decent Sampler: {tmp_path / 'm.dspreset'}",
        "  notes ring on when their keys come up: they have no release",
    ]
    report = told(tonewood(*words, "--json"))
    assert (report["samples"], report["releases"], report["bytes"], report["rings"]) == (3, 2, 2_500_000, True)
    assert asked.options["suffix"] == ".flac"
    refused(tonewood(*words, "--format", "mp3"), "flac or wav are allowed")
    for jobs in (0, -2):
        refused(tonewood(*words, "--jobs", jobs), "1 or more are allowed, or -1")


# servers


class Served:
    """In place of uvicorn's server: keeps its settings and sockets, and ends at once."""

    made: ClassVar[list[Any]] = []

    def __init__(self, config: Any):
        self.config = config

    def run(self, sockets: list[Any]) -> None:
        Served.made.append((self.config, sockets[0].getsockname()))


def test_a_desk_is_opened_on_this_computer_alone(tonewood: Run, tmp_path: Path, monkeypatch: Patch) -> None:
    import uvicorn

    from tonewood.workshop.desk import desk, server

    opened, closed = Asked(SimpleNamespace(close=lambda: closed(True))), Asked()
    served = SimpleNamespace(token="T", application=Asked("app"), closing=False)
    monkeypatch.setattr(uvicorn, "Server", Served)
    monkeypatch.setattr(uvicorn, "Config", lambda app, **options: (app, options))
    monkeypatch.setattr(desk, "Desk", opened)
    monkeypatch.setattr(server, "DeskServer", Asked(served))
    code, out, _ = tonewood("desk", "monochord", "--port", 0, "--set", "strings.A2.tension=60", "--fs", 44100)
    (app, options), (address, port) = Served.made.pop()
    assert (code, out, address) == (0, f"http://127.0.0.1:{port}/#T\n", "127.0.0.1")
    assert (app, options["ws"], options["lifespan"], options["server_header"]) == ("app", "none", "off", False)
    assert opened.options == {"score": None, "fs": 44100, "folder": None}
    assert opened.words[0].instrument.spec.strings["A2"].tension == 60.0
    assert (served.closing, closed.words) == (True, (True,))
    refused(tonewood("desk", "monochord", "--folder", tmp_path / "no"), "there is no folder")
    refused(tonewood("desk", "monochord", "--port", 65536), "0 to 65535 are allowed")
    refused(tonewood("desk", "monochord", "--fs", 7999), "8000 to 192000 are allowed")


@pytest.mark.parametrize("staircase", [False, True])
def test_a_listening_test_is_served(tonewood: Run, tmp_path: Path, monkeypatch: Patch, staircase: bool) -> None:
    import uvicorn

    from tonewood.workshop.listening import answer_file, definition, on_demand, server

    closed, cleared, application = Asked(), Asked(), Asked("app")
    pairs = SimpleNamespace(changes=lambda: ["monochord has changed"], close=lambda: closed(True))
    served = Asked(SimpleNamespace(application=application))
    for module, name, to in (
        (uvicorn, "Server", Served), (uvicorn, "Config", lambda app, **options: (app, options)),
        (definition, "load_test", Asked("test")), (answer_file, "clear_parts", cleared),
        (server, "ListeningServer", served),
        (server, "has_staircase", Asked(staircase)), (on_demand, "RenderedPairs", Asked(pairs)),
    ):  # fmt: skip
        monkeypatch.setattr(module, name, to)
    code, out, err = tonewood("serve", tmp_path, "--port", 0, "--name", "lab")
    (app, options), (address, port) = Served.made.pop()
    assert (code, out, address) == (0, f"http://127.0.0.1:{port}/\n", "127.0.0.1")
    assert (app, options["ws"], options["lifespan"], options["server_header"]) == ("app", "none", "off", False)
    assert (cleared.words, served.words) == (("test",), ("test", pairs if staircase else None))
    assert application.words == ("127.0.0.1", ["lab"])
    ended = f"tonewood: the server has ended; answers are in {tmp_path / 'answers'}\n"
    assert err == ("tonewood: monochord has changed\n" if staircase else "") + ended
    assert closed.words == ((True,) if staircase else ())
    refused(tonewood("serve", tmp_path, "--port", -1), "0 to 65535 are allowed")


# live playing


def test_the_gain_of_live_playing_is_that_of_all_open_strings(monkeypatch: Patch) -> None:
    """Plucked one after the other in 10 ms each, at velocity 110."""
    from tonewood.cli import live
    from tonewood.sound.render import level

    asked, options = Asked(-7.5), RenderOptions()
    monkeypatch.setattr(level, "preview_gain", asked)
    guitar = tw.load_instrument("classical_guitar")
    assert live._gain(guitar, options) == -7.5
    score, *rest = asked.words
    assert rest == [guitar, options]
    assert [(n.string, n.stop, n.velocity_midi) for n in score.notes] == [
        (name, 0, 110) for name in guitar.string_names
    ]
    assert [n.time for n in score.notes] == pytest.approx([0.01 * i for i in range(6)])


@pytest.mark.parametrize("ends", ["well", "badly", "at once"])
def test_a_take_is_kept_whatever_ends_a_session(tonewood: Run, tmp_path: Path, monkeypatch: Patch, ends: str) -> None:
    from tonewood.cli import live
    from tonewood.sound.live import instrument, keyboard, ports, session

    made, closed, kept = dict[str, Any](), list[str](), list[int]()
    string, group = SimpleNamespace(open_note=45.0), SimpleNamespace(full_scale=40.0, unit="Pa", gain_db=0.0)
    played = SimpleNamespace(
        frames=0, summary=lambda: summary, fs=48000, options=SimpleNamespace(gain_db=-7.2),
        model=SimpleNamespace(strings={"A2": string, "B2": SimpleNamespace(open_note=47.0)}, outputs=[group]),
        instrument=SimpleNamespace(spec=SimpleNamespace(name="monochord")),
    )  # fmt: skip
    summary = SimpleNamespace(
        ignored={}, dropped={}, clipped=0, peak_dbfs=-6.0, notes=2, cut=0, effects=[], duration_s=1.0
    )

    class Session:
        def __init__(self, live_: Any, sources: Any, **options: Any) -> None:
            made.update(options, live=live_, sources=sources)
            self.live, self.take = live_, options["take"]
            self.receiver = SimpleNamespace(ignored={}, messages=3)
            self.stream, self.latency = SimpleNamespace(block_size=64), {"device": 0.002}

        def run(self, device: Any, stream: Any, wait: Any) -> Any:
            made.update(device=device, going=wait())
            if ends != "at once":
                self.take.add(0, [0x90, 45, 90])
            if ends != "well":
                raise TonewoodError("the card is gone")
            return SimpleNamespace(frames=24000, underruns=0, late=0, load=0.5, worst_block_s=0.001)

    def source(name: str) -> Any:
        return SimpleNamespace(name=name, close=lambda: closed.append(name), ended=False)

    lives, keys = Asked(played), Asked(source("the keys"))
    monkeypatch.setattr(live, "_gain", Asked(-7.25))
    monkeypatch.setattr(instrument, "Live", lives)
    monkeypatch.setattr(session, "LiveSession", Session)
    monkeypatch.setattr(keyboard, "ComputerKeyboard", keys)
    monkeypatch.setattr(ports, "MidiInput", source)
    monkeypatch.setattr("tonewood.sound.live.take.Take.save", lambda take, *words: kept.append(len(take.messages)))
    words = (
        "play",
        "-i",
        "monochord",
        "--midi-in",
        "port",
        "--keyboard",
        "--record",
        tmp_path / "t.mid",
        "--device",
        2,
    )
    code, out, err = tonewood(*words, "--ahead", 6, "--block", 64, "--ramp", 4, "--spacing", 3, "--tracks", "2")
    assert keys.words == (45.0,)  # the lowest string
    assert (lives.options["options"].gain_db, lives.options["ramp"], lives.options["spacing"]) == (-7.2, 4e-3, 3)
    assert {key: made[key] for key in ("block_size", "ahead", "channels", "device", "going")} == {
        "block_size": 64, "ahead": 6, "channels": [2], "device": 2, "going": True,
    }  # fmt: skip
    assert [s.name for s in made["sources"]] == closed == ["port", "the keys"]
    assert kept == {"well": [1], "badly": [1], "at once": []}[ends]
    assert out.splitlines()[:2] == [
        "monochord played by port and the keys; Ctrl-C ends", "  gain -7.2 dB, 0 dBFS is 91.63 Pa",
    ]  # fmt: skip
    if ends == "well":
        assert (code, out.splitlines()[3]) == (
            0,
            "played 0.50 s, 2 notes, 0 dropped, 0 ended by another on their string; 0 underruns",
        )
        report = told((*tonewood(*words, "--json", "--gain", -3)[:2], ""))
        assert lives.options["options"].gain_db == -3.0  # as it is told
        assert (report["block"], report["latency_s"], report["record"]) == (
            64,
            {"device": 0.002},
            str(tmp_path / "t.mid"),
        )
        assert (report["duration_s"], report["load"], report["messages"], report["notes"]) == (0.5, 0.5, 3, 2)
    else:
        assert (code, err.splitlines()[-1]) == (2, "tonewood: the card is gone")


# limits

WOOD = ("wood", "p.csv", "--length", 0.5, "--width", 0.2, "--thickness", 4e-3, "--mass", 0.16)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("compare", "monochord", "--variant", "strings.A2.tension=60", "--duration", 99), "0.1 to 60"),
        (("report", "monochord", "--velocity", 200), "1 to 127"),
        (("desk", "monochord", "--port", -1), "0 to 65535"),
        (("desk", "monochord", "--fs", 1), "8000 to 192000"),
        (("estimate", ".", "-o", "new", "--from", "monochord", "--iterations", 0), "1 to 10"),
        (("fit", "a.csv", "-o", "f", "--scale", 0), "1e-09 to 1000000000"),
        (("fit", "a.csv", "-o", "f", "--window-tau", 0), "0.0001 to 1000"),
        (("fit", "a.csv", "-o", "f", "--hits", 1), "2 to 100000"),
        (("play", "s.mid", "-i", "monochord", "--block", 1), "16 to 65536"),
        (("play", "-i", "monochord", "--midi-in", "x", "--ahead", 0), "1 to 64"),
        (("play", "-i", "monochord", "--midi-in", "x", "--ramp", 0), "1 to 100"),
        (("render", "s.mid", "-i", "monochord", "-o", "a.wav", "--block", 0), "1 to 16777216"),
        (("render", "s.mid", "-i", "monochord", "-o", "a.wav", "--normalize", 1), "-200 to 0"),
        (("sample", "monochord", "-o", "m", "--duration", 0), "0.5 to 120"),
        (("serve", ".", "--port", -1), "0 to 65535"),
        (("simulate", ".", "--panel", "p.yaml", "--listeners", 0), "1 to 10000"),
        (("strings", "ej46", "--length", 0), "0.02 to 5"),
        (("taptone", "a.wav", "--record", 0), "1 to 100"),
        (("taptone", "a.wav", "--record", 1, "--fs", 1), "8000 to 192000"),
        (("taptone", "a.wav", "--channel", 0), "1 to 256"),
        ((*WOOD, "--thickness-error", 0), "1e-07 to 0.0008"),
        ((*WOOD, "--sensor", 1), "0 to 0.016"),
        ((*WOOD, "--outline", 9, 9, 9, 9), "0.01 to 3"),
        ((*WOOD, "--length", 9000), "0.0005 to 3"),
        ((*WOOD, "--mass", 1e6), "0.0001 to 100"),
    ],
)
def test_limits_of_options_are_told(tonewood: Run, tmp_path: Path, monkeypatch: Patch, words: Any, said: str) -> None:
    """Both ends are in the line, and nothing is read, written or opened before."""
    monkeypatch.chdir(tmp_path)
    refused(tonewood(*words), f"{said} are allowed")
    assert list(tmp_path.iterdir()) == []
