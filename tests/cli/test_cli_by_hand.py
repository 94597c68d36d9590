"""What commands hand on where an option is left out, and the picture of a body that is drawn."""

from __future__ import annotations

import json
import socket
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import typer

import tonewood as tw
from cli_runs import Asked, refused
from tonewood.cli import (
    check,
    compare,
    dataset,
    fit,
    listing,
    live,
    modes,
    plan,
    render_report,
    sample,
    serve,
    strings,
    wood,
)
from tonewood.errors import OutputError, TonewoodError

Run = Callable[..., tuple[int, str, str]]
Patch = pytest.MonkeyPatch


@dataclass
class Feel:
    """Of a string that is not felt."""

    newton_per_mm: float | None = None


@pytest.mark.parametrize(("given", "live", "score"), [((), 128, 1024), (("--block", 300), 300, 300)])
def test_blocks_of_live_playing_are_shorter(
    given: Any, live: int, score: int, tonewood: Run, tmp_path: Path, monkeypatch: Patch
) -> None:
    from tonewood.cli import live as cli_live
    from tonewood.performance.score import reading
    from tonewood.sound.level import limiter
    from tonewood.sound.live import play as player
    from tonewood.sound.render import renderer

    played_live, played = Asked(), Asked(SimpleNamespace(frames=4800, clipped=0, underruns=0))
    summary = SimpleNamespace(warnings=[], notes_dropped=[], realtime_factor=8.0)
    one = SimpleNamespace(summary=lambda: summary, model=SimpleNamespace(outputs=[]))
    for module, name, to in (
        (cli_live, "play_live", played_live), (player, "play", played), (renderer, "Renderer", Asked(one)),
        (reading, "read_score", Asked("score")), (limiter, "Limiter", Asked("limiter")),
    ):  # fmt: skip
        monkeypatch.setattr(module, name, to)
    assert tonewood("play", "-i", "monochord", "--keyboard", *given)[0] == 0
    assert played_live.options["block_size"] == live
    assert (played_live.options["port"], played_live.options["keyboard"]) == (None, True)
    for level, held in (("calibrated", None), (None, None)):
        words = ("play", "a.mid", "-i", "monochord", "--gain", 3, *(("--level", level) if level else ()), *given)
        code, out, err = tonewood(*words)
        assert (code, err) == (0, "")
        assert out.startswith("played 0.10 s, 0 underruns; 8.0 x real time")
        assert (played.options["block_size"], played.options["limiter"]) == (score, held)
    assert tonewood("play", "a.mid", "-i", "monochord", "--limiter", *given)[0] == 0
    assert played.options["limiter"] == "limiter"


@pytest.mark.parametrize(("jobs", "needed"), [(1, []), (2, [("batch", "joblib")]), (-1, [("batch", "joblib")])])
def test_several_renders_at_a_time_need_joblib(
    jobs: int, needed: list[Any], tonewood: Run, tmp_path: Path, monkeypatch: Patch
) -> None:
    from tonewood.workshop.sampling import library

    asked, made = list[Any](), SimpleNamespace(
        sfz="a", decent="b", folder="c", n_samples=1, n_releases=0, seconds=1.0, size=1, gain_db=0.0, rings=False
    )  # fmt: skip
    make = Asked(made)
    monkeypatch.setattr(sample, "need", lambda *words: asked.append(words))
    monkeypatch.setattr(library, "make_library", make)
    assert tonewood("sample", "monochord", "-o", tmp_path / "m", "--jobs", jobs)[0] == 0
    assert (asked, make.options["jobs"]) == (needed, jobs)
    assert make.words[2] == library.Sampling(3, [32, 64, 96, 120], 2, None, None, 8.0, True)


@pytest.mark.parametrize(("host", "family"), [("127.0.0.1", socket.AF_INET), ("::1", socket.AF_INET6)])
def test_an_address_is_taken_again_at_once_and_by_one_server(
    host: str, family: int, tonewood: Run, tmp_path: Path, monkeypatch: Patch
) -> None:
    import uvicorn

    from tonewood.workshop.listening import answer_file, definition, server

    seen = list[Any]()

    class Server:
        def __init__(self, config: Any):
            self.config = config

        def run(self, sockets: list[Any]) -> None:
            one = sockets[0]
            seen.append((one.family, bool(one.getsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR)), self.config))

    for module, name, to in (
        (uvicorn, "Server", Server), (uvicorn, "Config", lambda app, **options: options),
        (definition, "load_test", Asked("test")), (answer_file, "clear_parts", Asked()),
        (server, "ListeningServer", Asked(SimpleNamespace(application=Asked("app")))),
        (server, "has_staircase", Asked(False)),
    ):  # fmt: skip
        monkeypatch.setattr(module, name, to)
    with socket.socket(family, socket.SOCK_STREAM) as taken:
        try:
            taken.bind((host, 0))
        except OSError:
            pytest.skip("has no such address")
        taken.listen(1)
        port = taken.getsockname()[1]
        refused(tonewood("serve", tmp_path, "--host", host, "--port", port), f"{host}:{port} cannot be used")
        assert seen == []
    code, out, _ = tonewood("serve", tmp_path, "--host", host, "--port", 0)
    assert code == 0
    assert out.startswith("http://[::1]:" if ":" in host else "http://127.0.0.1:")
    ((found, again, config),) = seen
    assert (found, again, config["timeout_graceful_shutdown"]) == (family, True, 2)


@pytest.mark.parametrize(
    ("name", "allowed"),
    [("lab", True), ("lab-1.example_org", True), ("10.0.0.1", True), ("[fe80::1]", True), ("fe80::1", True),
     ("https://lab", False), ("lab:8000", False), ("", False), ("lab two", False), ("l\xe4b", False)],
)  # fmt: skip
def test_names_of_a_computer(name: str, allowed: bool) -> None:
    assert serve._is_name(name) is allowed


def test_addresses_to_open(monkeypatch: Patch) -> None:
    """Of all interfaces those of this computer and of its network, or its name where it has none."""
    assert serve._names("10.0.0.1") == ["10.0.0.1"]
    assert serve._names("::1") == ["[::1]"]

    class Probe:
        fault: OSError | None = None

        def __init__(self, family: int, kind: int):
            assert (family, kind) == (socket.AF_INET, socket.SOCK_DGRAM)

        def __enter__(self) -> Probe:
            return self

        def __exit__(self, *_: object) -> None:
            pass

        def connect(self, address: Any) -> None:
            if self.fault is not None:
                raise self.fault

        def getsockname(self) -> tuple[str, int]:
            return "192.168.1.7", 4711

    monkeypatch.setattr(serve.socket, "socket", Probe)
    monkeypatch.setattr(serve.socket, "gethostname", lambda: "lab")
    for host in ("0.0.0.0", "::"):
        assert serve._names(host) == ["127.0.0.1", "192.168.1.7"]
    monkeypatch.setattr(Probe, "fault", OSError("no network"))
    assert serve._names("0.0.0.0") == ["127.0.0.1", "lab"]


@pytest.mark.parametrize(("fs", "names", "of"), [(16000.0, ["A"], "bridge at"), (48000.0, [], "body at")])
def test_a_drawn_body_has_its_mobility_above_its_first_modes(
    fs: float, names: list[str], of: str, tmp_path: Path, monkeypatch: Patch
) -> None:
    """Twelve panels in rows of four below one that is as wide as all; motion at 0 Hz is no mode."""
    from tonewood.instrument.inspection import frequencies
    from tonewood.physics.plate import figures
    from tonewood.support import plotting

    shapes, curves, saved, legends = Asked(), Asked(), Asked(), Asked()
    asked = list[Any]()
    mobility = {"A": np.ones(4000)}

    def bridge_mobility(model: Any, freq: np.ndarray, strings: list[str]) -> Any:
        asked.append((freq, strings))
        return mobility

    for module, name, to in (
        (frequencies, "bridge_mobility", bridge_mobility), (figures, "draw_shapes", shapes),
        (plotting, "draw_mobility", curves), (plotting, "save", saved), (plotting, "legend", legends),
    ):  # fmt: skip
        monkeypatch.setattr(module, name, to)
    sources = SimpleNamespace(areas=[1.0], of=lambda which: ("of", which.tolist()))
    basis = SimpleNamespace(natural_freq=np.array([0.0, 95.0, 210.0]), damping_ratio=np.array([0.0, 0.02, 0.01]))
    known = list[float]()
    body = SimpleNamespace(
        sources=lambda up_to: known.append(up_to) or sources, basis=lambda up_to: known.append(up_to) or basis
    )
    instrument = SimpleNamespace(spec=SimpleNamespace(title="A guitar"), body=body)
    model: Any = SimpleNamespace(fs=fs, instrument=instrument, strings={"A": SimpleNamespace(freq=lambda: 110.0)})
    modes._plot(model, names, tmp_path / "a.png")
    ((freq, strings),) = asked
    assert (freq.size, freq[0], freq[-1]) == pytest.approx((4000, 40.0, min(10000.0, 0.45 * fs)))
    assert np.diff(np.log(freq)) == pytest.approx(np.log(freq[-1] / 40.0) / 3999)
    assert strings == names
    axes, shown, at, quality = shapes.words
    assert (len(axes), shown) == (12, ("of", [False, True, True]))
    assert (at.tolist(), quality.tolist()) == ([95.0, 210.0], [25.0, 50.0])
    assert len(set(known)) == 1
    page, path = saved.words
    assert path == tmp_path / "a.png"
    assert [tuple(page.axes[i].get_subplotspec().colspan) for i in (0, 3)] == [(0,), (3,)]
    whole = page.axes[-1]
    assert tuple(whole.get_subplotspec().colspan) == (0, 1, 2, 3)
    assert tuple(whole.get_subplotspec().rowspan) == (0,)
    assert page.get_size_inches()[1] == pytest.approx(5.0 + 3 * 3.6 + 0.2)
    assert curves.words == (whole, freq, mobility)
    assert (whole.get_title(loc="left") or whole.get_title(), legends.words) == ("A guitar", (whole,))
    assert legends.options == {"title": of, "ncols": 2}
    mobility.clear()
    with pytest.raises(OutputError, match="there is no mobility"):
        modes._plot(model, names, tmp_path / "a.png")


@pytest.mark.parametrize(
    ("passive", "code", "said"), [(True, 0, "ok"), (False, 2, "not ok: its body could create energy")]
)
def test_a_check_of_a_body_that_creates_energy_fails(
    passive: bool, code: int, said: str, tonewood: Run, monkeypatch: Patch
) -> None:
    body = check._body
    monkeypatch.setattr(check, "_body", lambda model: body(model) | {"passive": passive})
    found = tonewood("check", "monochord", "--fs", 16000)
    assert (found[0], found[1].splitlines()[-1].partition(",")[0]) == (code, said)
    assert json.loads(tonewood("check", "monochord", "--fs", 16000, "--json")[1])["ok"] is passive


@pytest.mark.parametrize(("errors", "worst"), [([0.1, -0.4, 0.3], -0.4), ([0.5, -0.4, 0.3], 0.5)])
def test_the_worst_stop_of_a_string_is_the_farthest_from_its_pitch(
    errors: list[float], worst: float, monkeypatch: Patch
) -> None:
    """Alone, and with all strings on the body, where the errors are in the other order."""
    from tonewood.instrument.inspection import frequencies, string_laws

    monkeypatch.setattr(string_laws, "law_errors", lambda model, name: [])
    monkeypatch.setattr(frequencies, "feel", lambda model, name: Feel())
    tension = SimpleNamespace(given=None, held="pitch", noticeable=False)
    string = SimpleNamespace(
        open_note=45.0, n_stops=2, components=(), group=("A", "B"), tuning=SimpleNamespace(given=tension)
    )
    model: Any = SimpleNamespace(strings={"A": string, "B": string})
    pairs: Any = [
        (SimpleNamespace(string=name, stop=i, error_cents=scale * e, tension=60.0 + i),
         SimpleNamespace(error_cents=2 * scale * e))
        for name, scale in (("A", 1.0), ("B", 9.0)) for i, e in enumerate(errors)
    ]  # fmt: skip
    row = check._string(model, "A", pairs)
    assert (row["worst_cents"], row["worst_cents_mounted"]) == (worst, 2 * worst)
    assert (row["tension"], row["stop_tension"]) == (60.0, {"stop": 2, "relative": pytest.approx(2 / 60)})
    assert (row["note"], row["stops"], row["count"], row["loss_error"], row["held_note"]) == ("A2", 2, 2, None, None)


@pytest.mark.parametrize("reduction", [None, 0.0, 2.5])
def test_a_limiter_is_told_of_where_it_took_something_away(reduction: float | None) -> None:
    summary = SimpleNamespace(peak_dbfs=-3.0, warnings=())
    hold: Any = None if reduction is None else SimpleNamespace(reduction_db=reduction)
    renderer: Any = SimpleNamespace(summary=lambda: summary)
    written = render_report.WrittenSound(renderer, Path("a.wav"), "PCM_24", 0, 0.5, "peak", 0.0, hold)
    assert written.warnings() == (["the limiter took away up to 2.5 dB"] if reduction else [])


@pytest.mark.parametrize(("duration", "going"), [(None, True), (4.0, True), (3.0, False), (2.0, False)])
def test_a_session_lasts_as_long_as_it_is_asked_to(
    duration: float | None, going: bool, monkeypatch: Patch, capsys: pytest.CaptureFixture[str]
) -> None:
    """3 s after its beginning; its latency is told once."""
    clock, ended = [1000.0], [False]
    monkeypatch.setattr(live.time, "monotonic", lambda: clock[0])
    session: Any = SimpleNamespace(latency={"pluck": 0.005, "blocks": 0.0125}, status=lambda: "s" * 200)
    wait = live._meter(session, duration, lambda: ended[0])
    assert wait() is True
    clock[0] = 1003.0
    assert wait() is going
    ended[0] = True
    assert wait() is False
    assert capsys.readouterr().err == "  latency 17.5 ms: pluck 5.0, blocks 12.5\n"
    monkeypatch.setattr(live.sys.stderr, "isatty", lambda: True, raising=False)
    wait()
    assert capsys.readouterr().err == "\r\x1b[K" + "s" * 110


def test_a_plugin_without_a_docstring_is_listed(tonewood: Run, monkeypatch: Patch) -> None:
    """One whose docstring refers to its module has the first line of that."""
    from tonewood.instrument.contract import registry

    entry = SimpleNamespace(name="one", dist=SimpleNamespace(name="p", version="1"))
    plugins = {
        "bare": SimpleNamespace(__doc__=None, kind="body"),
        "short": SimpleNamespace(__doc__="  A thing.\n\nMore.", kind="exciter"),
        "long": SimpleNamespace(__doc__="See the module.", kind="string", __module__=__name__),
    }
    monkeypatch.setattr(registry, "entries", lambda group: dict.fromkeys(plugins if "plugin" in group else (), entry))
    monkeypatch.setattr(registry, "broken_plugins", dict)
    monkeypatch.setattr(registry, "plugin", plugins.get)
    monkeypatch.setattr(listing, "_owner", lambda entry: {"name": entry.name, "package": "p", "version": "1"})
    rows = json.loads(tonewood("list", "--json")[1])["plugins"]
    assert [(row["kind"], row["summary"]) for row in rows] == [
        ("body", ""), ("exciter", "A thing."),
        ("string", "What commands hand on where an option is left out, and the picture of a body that is drawn."),
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("given", "longest"), [((), 3.75), (("--max-duration", 2.5), 2.5), (("--max-duration", 9), 3.75)]
)
def test_a_sketch_is_as_long_as_its_last_note_and_the_tail(
    given: Any, longest: float, tonewood: Run, monkeypatch: Patch
) -> None:
    from contextlib import nullcontext

    from tonewood.performance.score import reading
    from tonewood.sound.render import plan as foreseen

    bars, asked = list[Any](), Asked(foreseen.Plan((), 1.0, 2.0, 1.0, sketched_s=1.0))
    score = tw.Score([tw.Note(0.0, 3.0, note=45), tw.Note(1.0, 0.5, note=45)])
    monkeypatch.setattr(reading, "read_score", lambda path, **settings: score)
    monkeypatch.setattr(plan, "progress", lambda label, total: bars.append((label, total)) or nullcontext("bar"))
    monkeypatch.setattr(foreseen, "plan", asked)
    assert tonewood("plan", "a.mid", "-i", "monochord", "--tail", 0.75, *given)[0] == 0
    assert bars == [("sketching", longest)]
    assert (asked.words[0], asked.options["progress"]) == (score, "bar")


def test_tops_of_a_board_are_those_of_a_stiffness_or_of_three_thicknesses(monkeypatch: Patch) -> None:
    from tonewood.physics.plate import outline
    from tonewood.workshop.wood import thickness
    from tonewood.workshop.wood.board import Board

    board: Any = object.__new__(Board)
    object.__setattr__(board, "wood", "spruce")
    monkeypatch.setattr(outline, "guitar_outline", lambda *sizes: ("ring", sizes))
    monkeypatch.setattr(thickness, "thickness_for", lambda *words: words)
    monkeypatch.setattr(thickness, "panel_freq", lambda *words: words)
    monkeypatch.setattr(thickness, "gore_thickness", lambda *words: words)
    monkeypatch.setattr(thickness, "TARGETS", {"steel_string": 55.0})
    sizes = (0.5, 0.28, 0.24, 0.38)
    ring = ("ring", sizes)
    first, last = wood._tops(board, sizes, 7.0)
    assert (first["thickness_m"], first["freq_Hz"]) == (("spruce", ring, 7.0), 7.0)
    assert (last["thickness_m"], last["freq_Hz"]) == (("spruce", 0.5, 0.38, 55.0), 55.0)
    assert last["of"] == "Gore and Gilet's target of a steel string, a clamped rectangle"
    rows = wood._tops(board, sizes, None)
    assert [row["thickness_m"] for row in rows[:3]] == pytest.approx([2.0e-3, 2.5e-3, 3.0e-3])
    assert [row["freq_Hz"] for row in rows[:3]] == [("spruce", ring, row["thickness_m"]) for row in rows[:3]]
    assert wood._tops(board, None, 7.0) == wood._tops("a stick", sizes, 7.0) == []  # type: ignore[arg-type]


@pytest.mark.parametrize(("word", "place"), [("-1", -1.0), ("1", 1.0), ("-1.01", None), ("1.01", None), ("x", None)])
def test_places_on_the_bridge_are_from_bass_to_treble(word: str, place: float | None) -> None:
    if place is None:
        with pytest.raises(TonewoodError, match=r"--point: is 'n=a:z:.*'; the place U is a number from -1 \(bass\)"):
            fit._place_on_bridge(f"n=a:z:{word}", word)
    else:
        assert fit._place_on_bridge(f"n=a:z:{word}", word) == place


# from where on something is told


@pytest.mark.parametrize(("share", "told"), [(0.099, False), (0.101, True), (-0.099, False), (-0.101, True)])
def test_a_stop_that_is_tuned_by_more_than_a_tenth_of_the_tension_is_doubted(share: float, told: bool) -> None:
    string = {"stop_tension": {"stop": 7.0, "relative": share}, "law": []}
    report = {
        "model": [], "table_doubts": [], "microphones": [], "silent_outputs": [], "potentials": [],
        "forces_at_rest": {}, "changing_bases": [], "strings": {"A": string},
        "body": {"n_modes": 1, "freq_upper": 5e3, "n_overdamped": 0},
    }  # fmt: skip
    found = check._warnings(report)
    assert len(found) == told
    if told:
        assert found[0].startswith(f"string A: stop 7 is in tune at {100 * share:+.0f} % of the open string's tension")


def test_a_list_has_a_line_for_each_of_what_is_installed(tonewood: Run) -> None:
    """The words of its JSON: names, titles, packages with their versions, licences, notes of sets."""
    lines, report = tonewood("list")[1].splitlines(), json.loads(tonewood("list", "--json")[1])
    at = [lines.index(word) for word in ("instruments", "plugins")]
    of_sets = next(i for i, line in enumerate(lines) if line.startswith("string sets"))
    assert lines[0] == f"tonewood {report['version']}"
    assert lines[at[0] + 1 : at[1] - 1] == [
        f"  {x['name']:<20} {x['title']}  [{x['package']} {x['version']}, {x['licence']}]"
        for x in report["instruments"]
    ]
    assert lines[at[1] + 1 : of_sets - 1] == [
        f"  {x['name']:<20} {x['kind']:<10} {x['summary']}  [{x['package']} {x['version']}]" for x in report["plugins"]
    ]
    assert lines[of_sets + 1 :] == [
        f"  {x['name']:<20} {x['maker']} {x['product']} ({' '.join(x['notes'])})" for x in report["string_sets"]
    ]
    assert len(report["instruments"]) > 5
    assert listing._line({"name": "x", "broken": "no folder"}) == f"  {'x':<20} broken: no folder"


@pytest.mark.parametrize(
    ("seconds", "predicted", "told"),
    [(0.0, None, False), (0.1, None, True), (9.98, None, True), (9.995, None, False), (10.0, 0.079, False),
     (10.0, 0.081, True), (0.0, 0.081, True)],
)  # fmt: skip
def test_an_effect_matters_that_is_switched_or_takes_two_percent(
    seconds: float, predicted: float | None, told: bool
) -> None:
    """Of 10 s of sound in 4 s of computing."""
    effect: Any = SimpleNamespace(seconds=seconds, predicted_s=predicted)
    whole: Any = SimpleNamespace(duration_s=10.0, predicted_s=4.0)
    assert plan.matters(effect, whole) is told


@pytest.mark.parametrize("count", [20, 21])
def test_twenty_notes_on_a_data_set_are_told(count: int, capsys: pytest.CaptureFixture[str]) -> None:
    report: Any = SimpleNamespace(
        folder="d", sounds=3, sound_seconds=7200.0, made=2, reused=1, seconds=4.25, sha256="0123456789abcdef99",
        notes=[f"note {i}" for i in range(count)], faults=[],
    )  # fmt: skip
    dataset._print_report(report)
    out, err = capsys.readouterr()
    assert out == (
        "d: 3 sounds, 2 hours, in 2 new and 1 earlier shards, 4.2 s; SHA-256 of all samples 0123456789abcdef\n"
    )
    assert err.count("note ") == 20
    assert len(err.splitlines()) == count


def test_tensions_of_a_set_are_in_newtons_and_pounds(capsys: pytest.CaptureFixture[str]) -> None:
    """An international pound is 0.45359237 kg at 9.80665 m/s^2."""
    pound = 0.45359237 * 9.80665
    chosen: Any = SimpleNamespace(maker="M", product="P", source=SimpleNamespace(text="S"))
    row = {"note": "E4", "diameter": 0.254e-3, "material": None, "linear_density": 4e-4, "tension": 20 * pound,
           "bending_stiffness": 3e-6, "axial_stiffness": None, "fretting_stiffness": 9000.0}  # fmt: skip
    strings._print_set("set", chosen, [row, row | {"diameter": None, "material": "steel", "tension": 10 * pound}])
    lines = capsys.readouterr().out.splitlines()
    assert lines[:2] == ["set: M P", "  S"]
    assert lines[3].split() == ["E4", "0.254", "0.0100", "-", "0.4000", f"{20 * pound:.2f}", "20.0", "3", "-", "9000"]
    assert lines[4].split()[1:4] == ["-", "-", "steel"]
    assert lines[5] == f"  together {30 * pound:.1f} N, 30.0 lb"


def test_a_report_names_the_changes_of_its_instrument(tonewood: Run, monkeypatch: Patch) -> None:
    """The set of strings first, then each value."""
    ran, loaded = Asked(), Asked(SimpleNamespace(name="loaded"))
    monkeypatch.setattr(compare, "_run", ran)
    monkeypatch.setattr(compare, "load", loaded)
    words = ("report", "monochord", "--set", "a.b=1", "--set", "c=2")
    assert tonewood(*words, "--strings", "light", "--duration", 3, "--velocity", 70)[0] == 0
    assert loaded.words == ("monochord", ["a.b=1", "c=2"], False, "light")
    ((candidate,), *rest) = ran.words
    assert (candidate.instrument.name, candidate.changes) == ("loaded", ("strings_from=light", "a.b=1", "c=2"))
    assert rest == [None, None, 3.0, 70.0, 48000, False, False]
    tonewood(*words)
    assert ran.words[0][0].changes == ("a.b=1", "c=2")


def test_a_mix_that_is_silent_has_no_level_and_fails(tmp_path: Path, monkeypatch: Patch) -> None:
    from tonewood.cli import ensemble
    from tonewood.sound.ensemble import mix

    file = tmp_path / "a.mid"
    tw.write_midi(tw.Score([tw.Note(0.0, 0.1, note=60, velocity_midi=80)]), file)
    part = mix.EnsemblePart(part=1, instrument="monochord")
    summary = SimpleNamespace(notes=1, ignored={}, notes_dropped=[], warnings=[])
    stem = SimpleNamespace(part=part, samples=np.zeros((4000, 2)), summary=summary)
    monkeypatch.setattr(mix, "render_ensemble", lambda *arguments, **options: [stem])
    told = list[Any]()
    monkeypatch.setattr(ensemble, "print_json", lambda command, report, ok: told.append((report, ok)))
    with pytest.raises(typer.Exit) as ended:
        ensemble.render_parts(
            file, [part], tmp_path / "a.wav", tw.RenderOptions(fs=8000), reading={}, subtype="PCM_24", level="LUFS",
            target=-1.0, stems=None, as_json=True, left_out=None,
        )  # fmt: skip
    ((report, ok),) = told
    assert (ended.value.exit_code, ok) == (1, False)
    assert (report["gain_db"], report["true_peak_dbtp"], report["loudness_lufs"]) == (0.0, None, None)
    assert (report["parts"][0]["peak_dbfs"], report["frames"], report["stems"]) == (None, 4000, [])


@pytest.mark.parametrize("n", [1, 2])
def test_planes_of_a_string_are_printed_where_there_are_two(n: int, tonewood: Run, monkeypatch: Patch) -> None:
    planes = {f"A2.{p}": {"cents": 0.5 * i, "split_cents": -0.25, "share": 1.0} for i, p in enumerate("zy"[:n])}
    monkeypatch.setattr(check, "plane_row", lambda pitch: {"planes": planes})
    lines = tonewood("modes", "monochord", "--count", 1, "--fs", 16000)[1].splitlines()
    assert [line for line in lines if "planes" in line] == ["  planes: z +0.0, y +0.5 (split -0.2) cents"][: n - 1]
