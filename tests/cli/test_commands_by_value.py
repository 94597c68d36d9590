"""Commands between their options and their output: long computations are replaced by results that are known."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any, ClassVar

import numpy as np
import pytest
import soundfile as sf

import tonewood as tw
from cli_runs import Asked, refused, told
from midi_bytes import note, write
from tonewood.workshop.estimate.distance import Distance
from tonewood.workshop.taps.ringing import Peak

Run = Callable[..., tuple[int, str, str]]
Patch = pytest.MonkeyPatch


# instruments


def test_a_check_counts_the_modes_of_the_table(tonewood: Run) -> None:
    table = (tw.list_instruments()["monochord"] / "body.csv").read_text().splitlines()
    freq = np.array([float(line.split(",")[0]) for line in table if line[:1].isdigit()])
    found = told(tonewood("check", "monochord", "--fs", 16000, "--json"))["body"]
    assert found["n_modes"] == freq.size
    assert (found["freq_lower"], found["freq_upper"]) == pytest.approx((freq.min(), freq.max()), rel=1e-3)
    assert (found["passive"], found["summary"]) == (True, "passive by construction (real modes)")


@pytest.mark.parametrize(("fs", "highest"), [(48000, 10000.0), (16000, 7200.0)])
def test_a_mobility_is_drawn_up_to_its_end(tonewood: Run, tmp_path: Path, monkeypatch: Patch, fs: int, highest) -> None:
    from tonewood.support import plotting

    drawn, saved = Asked("page"), Asked()
    monkeypatch.setattr(plotting, "mobility_figure", drawn)
    monkeypatch.setattr(plotting, "save", saved)
    code, out, _ = tonewood(
        "modes", "monochord", "--fs", fs, "--plot", tmp_path / "a.png", "--table", tmp_path / "t.csv"
    )
    assert code == 0
    freq, mobility = drawn.words
    assert (freq.size, freq[0], freq[-1]) == pytest.approx((4000, 40.0, highest))
    assert (list(mobility), drawn.options["of"]) == (["A2"], "bridge at")
    assert drawn.options["marks"] == pytest.approx([110.0])
    assert saved.words == ("page", tmp_path / "a.png")
    assert out.splitlines()[-2:] == [
        f"bridge mobility: {tmp_path / 'a.png'}",
        f"modes of the body: {tmp_path / 't.csv'}; its first lines are the keys for a bundle",
    ]
    assert (tmp_path / "t.csv").read_text().count("\n") > 1


def test_modes_of_an_instrument_are_printed(tonewood: Run, monkeypatch: Patch) -> None:
    """With the parts of a body that knows its surface; rigid motion, of 0 Hz, is none of its modes."""
    from tonewood.cli import modes

    rows = [{"freq": 99.6, "q": 24.6, "kind": "A0"}, {"freq": 210.4, "q": 30.0, "kind": "top"}]
    monkeypatch.setattr(modes, "_body_modes", Asked(rows))
    found = told(tonewood("modes", "monochord", "--count", 2, "--fs", 16000, "--stop", 5, "--json"))
    string = found["strings"]["A2"]
    assert (found["stop"], found["body"]["modes"], found["plot"], found["table"]) == (5, rows, None, None)
    assert string["wanted_freq"] == pytest.approx(110 * 2 ** (5 / 12))
    lines = tonewood("modes", "monochord", "--count", 2, "--fs", 16000, "--stop", 5)[1].splitlines()
    assert lines[0] == f"A2 at stop 5: {110 * 2 ** (5 / 12):.2f} Hz, {string['tension']:.2f} N"
    at = lines.index("  partial     freq/Hz    cents    T60/s  share of the body") + 1
    assert [line.split()[:4] for line in lines[at : at + 2]] == [
        [str(p["number"]), f"{p['freq']:.2f}", f"{p['cents']:+.2f}", f"{p['t60']:.2f}"] for p in string["partials"]
    ]
    assert [line.split()[4:] for line in lines[at : at + 2]] == [
        [f"{100 * p['body_share']:.1f}", "%"] for p in string["partials"]
    ]
    peaks = [f"{p['freq']:.0f} Hz {20 * math.log10(p['mobility']):.0f} dB" for p in string["bridge_mobility_peaks"]]
    assert lines[at + 2] == f"  bridge mobility peaks, re 1 (m/s)/N: {', '.join(peaks)}"
    assert "body: modes in Hz 100 (A0, Q 25)  210 (top, Q 30)" in lines
    monkeypatch.undo()
    natural, damping = np.array([0.0, 100.0, 200.0, *range(300, 1500, 100)]), np.array([1.0, 0.02, 0.01, *[0.005] * 12])
    surface = SimpleNamespace(labels=["rigid", "A0", *["top"] * 13])
    body = SimpleNamespace(
        sources=lambda freq: surface, basis=lambda freq: SimpleNamespace(natural_freq=natural, damping_ratio=damping)
    )
    told_of = modes._body_modes(SimpleNamespace(body=body))  # type: ignore[arg-type]
    assert told_of[:2] == [{"freq": 100.0, "q": 25.0, "kind": "A0"}, {"freq": 200.0, "q": 50.0, "kind": "top"}]
    assert [row["freq"] for row in told_of] == [100.0 * k for k in range(1, 13)]


def test_a_check_tells_cents_by_which_modes_move(tonewood: Run, monkeypatch: Patch) -> None:
    from tonewood.workshop.design import sensitivity

    sensed = sensitivity.Sensitivity(np.array([100.0, 200.0]), ("A0", "2"), {"1 g at bridge": np.array([-1.5, 2.0])})
    monkeypatch.setattr(sensitivity, "sensitivity", Asked(sensed))
    monkeypatch.setattr(sensitivity, "words", Asked(["a gram moves A0"]))
    words = ("check", "monochord", "--fs", 16000, "--sensitivity")
    found = told(tonewood(*words, "--json"))["sensitivity"]
    assert found == {"modes": ["A0", "2"], "freq": [100.0, 200.0], "cents": {"1 g at bridge": [-1.5, 2.0]}}
    assert "a gram moves A0" in tonewood(*words)[1]


def test_string_sets_and_materials_are_listed(tonewood: Run) -> None:
    from tonewood.instrument.bundle.string_materials import string_materials
    from tonewood.instrument.bundle.string_sets import string_sets

    report = told(tonewood("strings", "--json"))
    assert (report["sets"], set(report["materials"])) == (list(string_sets()), set(string_materials()))
    lines = tonewood("strings")[1].splitlines()
    for name, one in string_sets().items():
        notes = " ".join(entry.note for entry in one.strings)
        assert f"  {name:<20} {one.maker} {one.product} ({notes})" in lines
    for name, material in string_materials().items():
        (line,) = [line for line in lines if line.startswith(f"  {name:<20} ")]
        assert f": {material.density.value:g} kg/m^3" in line
        assert (f", E {1e-9 * material.young.value:.4g} GPa" if material.young else ", for wraps") in line
        assert f"    {material.density.source}" in lines


@pytest.mark.parametrize("kind", ["instrument", "test", "dataset"])
def test_schemas_are_of_their_kind(tonewood: Run, kind: str) -> None:
    code, out, _ = tonewood("schema", kind)
    key = {"instrument": "strings", "test": "trials", "dataset": "sampling"}[kind]
    text = json.dumps(json.loads(out))
    assert code == 0
    assert f'"{key}"' in text
    assert ('"sampling"' in text) == (kind == "dataset")
    refused(tonewood("schema", "tune"), "instrument, test, dataset are allowed")


def test_a_new_bundle_names_its_files(tonewood: Run, tmp_path: Path, monkeypatch: Patch) -> None:
    monkeypatch.chdir(tmp_path)
    code, out, _ = tonewood("new", "mine", "--from", "monochord")
    files = sorted(str(f.relative_to("mine")) for f in Path("mine").rglob("*") if f.is_file())
    assert (code, out.splitlines()[0].partition(": ")[2]) == (0, ", ".join(files))
    assert out.splitlines()[-1].endswith("tonewood check ./mine")
    report = told(tonewood("new", "other", "--from", "monochord", "--json"))
    assert (report["name"], report["files"]) == ("other", files)
    assert out.splitlines()[1] == f"strings A2; {len(report['unknown'])} figures of unknown origin"


def test_cents_of_frets_are_printed_by_string(tonewood: Run, monkeypatch: Patch) -> None:
    from tonewood.instrument.inspection import intonation

    def stop(n: int, cents: float) -> Any:
        return SimpleNamespace(stop=n, rests_on=n, rigid=cents, planes={"E2.z": cents + n})

    setup = SimpleNamespace(nut_setback=1e-3, saddle_setback=2e-3, rms=0.5)
    rows = [
        SimpleNamespace(name=name, stops=[stop(1 + n, c) for n, c in enumerate(cents)], built=setup, saddle_alone=None,
                        both=setup) for name, cents in (("E2", (1.0, -2.0)), ("A2", (3.0,)))
    ]  # fmt: skip
    asked = Asked(rows)
    monkeypatch.setattr(intonation, "intonation", asked)
    lines = tonewood("intonation", "classical_guitar", "--frets", 19, "--fs", 44100)[1].splitlines()
    assert asked.options == {"frets": 19, "fs": 44100}
    assert [line.split() for line in lines[1:4]] == [["fret", "E2", "A2"], ["1", "+1.0", "+3.0"], ["2", "-2.0"]]
    assert lines[5:7] == [
        "  E2 fret  2: z +0.0 cents, -2.0 without the body", "  A2 fret  1: z +4.0 cents, +3.0 without the body",
    ]  # fmt: skip
    assert lines[-2].split() == ["A2", "+1.00", "+2.00", "0.50", "none", "+1.00", "+2.00", "0.50"]
    monkeypatch.setattr("tonewood.cli.intonation._row", lambda s: s.name)
    report = told(tonewood("intonation", "classical_guitar", "--json"))
    assert (report["frets"], report["strings"], report["instrument"]) == (12, ["E2", "A2"], "classical_guitar")
    assert asked.options == {"frets": 12, "fs": 48000}
    for frets in (1, 20):
        refused(tonewood("intonation", "classical_guitar", "--frets", frets), "2 to 19 are allowed")
    refused(tonewood("intonation", "african_harp"), "frets are wanted")


def test_a_comparison_has_its_variants_and_its_sweep(tonewood: Run, tmp_path: Path, monkeypatch: Patch) -> None:
    from tonewood.cli import compare
    from tonewood.workshop.report import as_json, comparison, page

    asked, printed = Asked("result"), Asked()
    for module, name, to in (
        (comparison, "compare", asked), (as_json, "to_json", Asked({"a": 1})), (page, "page", Asked("<page>")),
        (compare, "_print", printed),
    ):  # fmt: skip
        monkeypatch.setattr(module, name, to)
    words = ("compare", "monochord", "--variant", "strings.A2.tension=60; strings.A2.length=0.7", "--name", "long")
    file = tmp_path / "p.html"
    code, out, _ = tonewood(*words, "--sweep", "strings.A2.tension=50:70:3", "--set", "title=other", "-o", file)
    first, long, *swept = asked.words[0]
    assert (code, out, file.read_text()) == (0, f"page: {file}\n", "<page>")
    assert (first.changes, first.instrument.spec.strings["A2"].tension) == (("title=other",), 58.8)
    assert (long.name, long.changes[1:]) == ("long", ("strings.A2.tension=60", "strings.A2.length=0.7"))
    assert [c.instrument.spec.strings["A2"].tension for c in (long, *swept)] == [60.0, 50.0, 60.0, 70.0]
    assert [c.name for c in swept] == ["tension 50", "tension 60", "tension 70"]
    options = {key: asked.options[key] for key in ("notes", "fs", "duration", "velocity_midi", "sweep")}
    assert options == {
        "notes": None,
        "fs": 48000,
        "duration": 4.0,
        "velocity_midi": 80.0,
        "sweep": "strings.A2.tension",
    }
    assert printed.words == ("result", False)
    report = told(tonewood(*words, "--json", "--notes", "A2, C3", "--duration", 0.1, "--velocity", 127))
    assert (report["schema"], report["page"], report["a"]) == ("tonewood-compare/1", None, 1)
    assert (asked.options["notes"], asked.options["sweep"]) == (["A2", "C3"], "")
    alone = told(tonewood("report", "monochord", "--json", "-o", file))
    assert (alone["schema"], alone["page"]) == ("tonewood-report/1", str(file))
    refused(tonewood("compare", "monochord"), "one instrument: another one")
    refused(tonewood(*words, "--name", "b"), "2 names for 1 variants")
    for option, value in (("--duration", 0.1), ("--duration", 60), ("--velocity", 1), ("--velocity", 127)):
        told(tonewood(*words, option, value, "--json"))
    for option, value in (("--duration", 0.09), ("--duration", 61), ("--velocity", 0.9), ("--velocity", 128)):
        refused(tonewood(*words, option, value), option)
    refused(tonewood(*words, "--notes", " ,"), "notes such as E2,A3 are wanted")


# scores


def test_a_tablature_counts_notes_positions_and_shifts(tonewood: Run, tmp_path: Path) -> None:
    score = write(tmp_path / "s.mid", note(0.0, 0.4, 40) + note(0.5, 0.4, 45) + note(1.0, 0.4, 20))
    words = ("tab", score, "-i", "classical_guitar", "-o", tmp_path / "a.txt", "--meter", "2/4")
    code, out, err = tonewood(*words)
    assert code == 0
    report = told(tonewood(*words[:4], "--json"))
    rows = report["notes"]
    assert [(r["note"], r["string"], r["stop"], r["measure"]) for r in rows] == [(40, "E2", 0, 1), (45, "A2", 0, 1)]
    assert [d["note"] for d in report["notes_dropped"]] == [20]
    assert out.startswith(f"{tmp_path / 'a.txt'}: 2 notes on 6 strings, 1 dropped, 1 measure, positions ")
    assert out.endswith(", 0 shifts\n")
    assert "not played at 1.00 s: no string plays G#0" in err
    refused(tonewood("tab", score, "-i", "african_harp", "-o", tmp_path / "b.txt"), "has no stops")


# recordings


def taps(fs: int, count: int) -> Any:
    """Taps with half a second of silence before each."""
    time = np.arange(2 * fs) / fs
    tap = 0.2 * np.sin(400 * np.pi * time) * np.exp(-20 * time)
    return np.tile(np.concatenate([np.zeros(fs // 2), tap]), count)


def test_modes_of_taps_are_listed_written_and_drawn(tonewood: Run, tmp_path: Path, monkeypatch: Patch) -> None:
    from tonewood.workshop.taps import figure, ringing

    peaks = [
        Peak(100.0, 30.0, (99.5, 100.5), (28.0, 32.0), -3.0, 3, 3),
        Peak(200.0, 20.0, (1.0, 2.0), (3.0, 4.0), 0.0, 1, 3),
    ]
    fs, drawn, asked = 4000, Asked(), Asked(peaks)
    monkeypatch.setattr(figure, "draw_taps", drawn)
    monkeypatch.setattr(ringing, "ringing", asked)
    sound = taps(fs, 3)
    sf.write(tmp_path / "a.wav", np.stack([0 * sound, sound], 1), fs, subtype="DOUBLE")
    words = ("taptone", tmp_path / "a.wav", "--channel", 2, "--band", 60, 600, "-o", tmp_path / "p.csv")
    found = told(tonewood(*words, "--no-names", "--json", "--plot", tmp_path / "p.png"))
    assert (len(asked.words[0]), asked.words[1:]) == (3, (fs, (60.0, 600.0)))
    assert asked.words[0][0] == pytest.approx(sound[: len(asked.words[0][0])], abs=0.2)
    assert (len(drawn.words[0]), drawn.words[1:]) == (3, (fs, (60.0, 600.0), peaks, {}, tmp_path / "p.png"))
    assert [(p["freq_Hz"], p["Q"], p["certain"], p["name"]) for p in found["peaks"]] == [
        (100.0, 30.0, True, None), (200.0, 20.0, False, None),
    ]  # fmt: skip
    assert (found["taps"], found["band_Hz"], found["warnings"], found["left_out"]) == (3, [60.0, 600.0], [], [])
    assert (found["files"], found["analysed_s"]) == ([str(tmp_path / "a.wav")], len(asked.words[0][0]) / fs)
    assert [line.split(",")[0] for line in (tmp_path / "p.csv").read_text().splitlines()] == [
        "freq_Hz",
        "100.0",
        "200.0",
    ]
    lines = tonewood(*words)[1].splitlines()
    assert lines[0] == (
        f"3 taps, silent after {found['ring_out_s']:.2f} s; {found['analysed_s']:.2f} s of each analysed"
    )
    assert lines[2].split() == ["100.00", "99.50", "100.50", "30.0", "28.0", "32.0", "-3.0", "3/3", "A0"]
    assert lines[3].split() == ["200.00", "1.00", "2.00", "20.0", "3.0", "4.0", "0.0", "1/3", "uncertain"]
    assert lines[4].startswith("names by order")
    assert lines[-1] == f"written: {tmp_path / 'p.csv'}"


def test_taps_are_recorded_into_a_file(tonewood: Run, tmp_path: Path, monkeypatch: Patch) -> None:
    from tonewood.workshop.taps import recordings, ringing

    asked = Asked(taps(8000, 3))
    monkeypatch.setattr(recordings, "record_taps", asked)
    monkeypatch.setattr(ringing, "ringing", Asked([]))
    file = tmp_path / "new.wav"
    code, out, err = tonewood("taptone", file, "--record", 3, "--fs", 8000, "--device", "2")
    assert (code, err.splitlines()[0]) == (0, "wait a second, then tap 3 times and let each ring out")
    assert (asked.words, asked.options["fs"], asked.options["device"]) == ((3,), 8000, 2)
    asked.options["tell"](1)
    samples, fs = sf.read(file)
    assert fs == 8000
    assert samples == pytest.approx(asked.result, abs=1e-6)
    assert "names by order" not in out


@pytest.mark.parametrize(
    ("stick", "words"), [(True, ["--stick"]), (False, ["--sensor", 0]), (False, ["--outline", 0.48, 0.28, 0.24, 0.37])]
)
def test_a_wood_is_asked_for_with_its_sizes(tonewood: Run, tmp_path: Path, monkeypatch: Patch, stick, words) -> None:
    from tonewood.cli import wood
    from tonewood.workshop.wood.stick import Stick

    rod = Stick(1.1e10, 400.0, None, {"E_L": (1e10, 1.2e10)}, (100.0,), (101.0,), ())
    asked = Asked(rod)
    monkeypatch.setattr(wood, "_stick" if stick else "_board", asked)
    monkeypatch.setattr(wood, "_tops", Asked([{"thickness_m": 2e-3, "freq_Hz": 60.0, "of": "top"}]))
    (tmp_path / "p.csv").write_text("freq_Hz,Q\n100,70\n200,80\n900,90\n")
    sizes = ("--length", 0.5, "--width", 0.02, "--thickness", 0.01, "--mass", 0.04)
    code, out, err = tonewood("wood", tmp_path / "p.csv", *sizes, "--band", 50, 500, *words, "-o", tmp_path / "w.yaml")
    assert (code, err) == (0, "tonewood: warning: peaks outside --band 50 500 were not used: 900.0 Hz\n")
    assert asked.words[0] == {"--length": 0.5, "--width": 0.02, "--thickness": 0.01}
    assert (asked.words[1], [p.freq for p in asked.words[2]]) == (0.04, [100.0, 200.0])
    if not stick:
        assert asked.words[3:] == ("sitka_spruce", 5e-5, 0.0 if "--sensor" in words else None)
    lines = out.splitlines()
    assert lines[0] == "density 400 kg/m^3"
    assert "2.00 mm: 60.0 Hz, top" in lines
    assert lines[-1] == f"written: {tmp_path / 'w.yaml'}"
    assert "E_L: 1.1e+10" in (tmp_path / "w.yaml").read_text()
    refused(tonewood("wood", tmp_path / "p.csv", *sizes, "--stick", "--outline", 0.48, 0.28, 0.24, 0.37), "no E_R")
    refused(tonewood("wood", tmp_path / "p.csv", *sizes[:-1], 1.0), "is no wood")
    refused(tonewood("wood", tmp_path / "p.csv", *sizes[:-1], 0.0079), "79 kg/m^3 is no wood")


def test_a_board_is_estimated_twice_and_a_stick_once(tonewood: Run, tmp_path: Path, monkeypatch: Patch) -> None:
    """The second estimate of a board begins with the wood of the first, and holds it near its species."""
    from tonewood.workshop.wood import board, rectangle, stick, thickness

    spruce = board.typical("sitka_spruce", 400.0)
    found = board.Board(spruce, {}, (), (), (), 0.0, 0.0)
    calls: list[Any] = []
    monkeypatch.setattr(board, "estimate_board", lambda *words, **options: calls.append((words, options)) or found)
    monkeypatch.setattr(rectangle.Rectangle, "of", staticmethod(lambda *words: words))
    monkeypatch.setattr(thickness, "panel_freq", lambda wood, ring, h: 1e4 * h)
    monkeypatch.setattr(thickness, "thickness_for", lambda wood, ring, freq: 1e-4 * freq)
    monkeypatch.setattr(thickness, "gore_thickness", lambda wood, length, width, freq: 1e-5 * freq * length / width)
    (tmp_path / "p.csv").write_text("freq_Hz,Q\n100,50\n")
    words = ("wood", tmp_path / "p.csv", "--length", 0.5, "--width", 0.2, "--thickness", 4e-3, "--mass", 0.16, "--json")
    outline = ("--outline", 0.48, 0.28, 0.24, 0.4)
    tops = told(tonewood(*words, *outline, "--sensor", 0.001))["tops"]
    (first, options), (second, more) = calls
    assert first[0] == second[0] == (0.5, 0.2, 4e-3, 0.16, spruce)
    assert [list(values) for values in (first[1], first[3])] == [[100.0], [50.0]]
    assert (options["sensor"], options["thickness_error"], options.get("prior")) == (1e-3, 5e-5, None)
    assert (more["sensor"], more["prior"]) == (1e-3, spruce)
    freqs = [20.0, 25.0, 30.0, 60.0, 75.0, 50.0, 55.0]
    assert [row["freq_Hz"] for row in tops] == pytest.approx(freqs)
    heights = [2e-3, 2.5e-3, 3e-3, *(1e-5 * f * 0.48 / 0.4 for f in freqs[3:])]
    assert [row["thickness_m"] for row in tops] == pytest.approx(heights)
    assert tops[3]["of"] == "Gore and Gilet's target of a classical top, a clamped rectangle"
    tops = told(tonewood(*words, *outline, "--stiffness", 27))["tops"]
    assert (tops[0]["thickness_m"], tops[0]["freq_Hz"], len(tops)) == (pytest.approx(2.7e-3), 27.0, 5)
    refused(tonewood(*words[:-1], "--stiffness", 27), "needs --outline")
    refused(tonewood(*words[:-1], "--outline", 0.48, 0.28, 0.24, 3.1), "0.01 to 3 are allowed")
    rod = Asked(stick.Stick(1.1e10, 400.0, None, {}, (100.0,), (101.0,), ()))
    monkeypatch.setattr(stick, "estimate_stick", rod)
    assert told(tonewood(*words, "--stick"))["tops"] == []
    assert rod.words[:4] == (0.5, 0.2, 4e-3, 0.16)
    assert rod.options == {"shear_ratio": pytest.approx(spruce.G_LT / spruce.E_L), "thickness_error": 5e-5}


def test_distances_of_two_folders_and_of_an_instrument(tonewood: Run, tmp_path: Path, monkeypatch: Patch) -> None:
    from tonewood.workshop.estimate import recordings, yardstick

    (tmp_path / "a").mkdir()
    (tmp_path / "b").mkdir()
    row = Distance(1.0, 2.0, 1.5, 3.0, 4.0, 5.0, 3, 7)
    found = SimpleNamespace(between=row, scale={"strokes": row}, shared=(45, 50), warnings=("quiet",))
    compared, read = Asked(found), Asked("notes")
    monkeypatch.setattr(yardstick, "compare_notes", compared)
    monkeypatch.setattr(yardstick, "played_as", lambda folder, instrument: (folder, instrument.name))
    monkeypatch.setattr(recordings, "read_folder", read)
    report = told(tonewood("distance", tmp_path / "a", tmp_path / "b", "--json"))
    assert compared.words == ("notes", "notes")
    assert (report["a"], report["b"], report["notes"]) == (str(tmp_path / "a"), str(tmp_path / "b"), [45, 50])
    assert list(report["distances"]) == ["A to B", "strokes"]
    assert (report["distances"]["strokes"], report["warnings"]) == (row.as_dict(), ["quiet"])
    for second in ("monochord", tw.list_instruments()["monochord"]):  # a bundle's folder is an instrument, too
        code, out, err = tonewood("distance", tmp_path / "a", second, "--transpose", 2, "--table", tmp_path / "t.csv")
        assert (code, err) == (0, "tonewood: warning: quiet\n")
        assert out.split()[:4] == ["A", "to", "B", "strokes"]
        assert compared.words == ("notes", ("notes", "monochord"))
        assert (read.words, read.options) == ((tmp_path / "a",), {"table": tmp_path / "t.csv", "transpose": 2})
    found.between = Distance(*[float("nan")] * 6, 0, 0)
    refused(tonewood("distance", tmp_path / "a", tmp_path / "b"), "nothing could be compared")


def test_an_estimate_is_written_and_printed(tonewood: Run, tmp_path: Path, monkeypatch: Patch) -> None:
    from tonewood.workshop.estimate import bundle, estimate, laws, page, recordings

    row = Distance(1.0, 2.0, 1.5, 3.0, 4.0, 5.0, 3, 7)
    rates = SimpleNamespace(rate=lambda freq: 0 * freq + 2.0)
    names = ("E2", "A2")
    figures = SimpleNamespace(
        laws=dict.fromkeys(names, rates), bending={"E2": 3.0, "A2": 1.0}, estimated={"E2": True}, modes={1: 1, 2: 2}
    )
    result = SimpleNamespace(
        moved=["string E2 is moved"], figures=figures, start=SimpleNamespace(bending={"E2": 2.0, "A2": 0.0}),
        intervals={"E2": SimpleNamespace(spread=0 * laws.STATED + 0.25)}, warnings=("short",),
        notes=[SimpleNamespace(string=name) for name in ("E2", "E2", "A2")], begun_with=SimpleNamespace(name="other"),
    )  # fmt: skip
    asked, written, read = Asked(result), Asked(SimpleNamespace(name="mine")), Asked("notes")
    for module, name, to in (
        (estimate, "estimate", asked), (bundle, "write_bundle", written), (recordings, "read_folder", read),
        (page, "page", Asked("<page>")), (page, "columns_of", Asked({"before": row})),
        (page, "place_line", Asked("place")),
        (page, "split_line", Asked("")), (page, "louder_line", Asked("")), (page, "mode_lines", Asked(["mode"])),
        (page, "room_line", Asked("room")),
    ):  # fmt: skip
        monkeypatch.setattr(module, name, to)
    words = ("estimate", tmp_path, "-o", tmp_path / "mine", "--from", "monochord", "--iterations", 5)
    code, out, err = tonewood(*words, "--title", "a guitar", "--page", tmp_path / "p.html")
    assert (code, err) == (0, "tonewood: warning: short\n")
    assert (asked.words[0], asked.words[1].name, asked.options["iterations"]) == ("notes", "monochord", 5)
    assert (written.words[:3], written.options) == ((result, tmp_path / "mine", "monochord"), {"allow_code": False})
    assert written.words[3] == bundle.RecordingOrigin("a guitar", bundle.UNKNOWN, bundle.UNKNOWN, None)
    assert (tmp_path / "p.html").read_text() == "<page>"
    lines = out.splitlines()
    n = len(laws.STATED)
    assert lines[0] == "string E2 is moved"
    assert lines[2].split() == ["E2", "2", "1.500", *["2.00", "+-25", "%"] * n]
    assert lines[3].split() == ["A2", "1", "nan", *["2.00"] * n, "(from", "the", "neighbouring", "strings)"]
    assert lines[4:7] == ["place", "mode", "room"]
    assert lines[-1] == f"{tmp_path / 'mine'}: plays at once; its body is that of other, 2 modes moved"
    figures.laws = dict.fromkeys((*names, *map(str, range(10))), rates)  # up to 12 all are listed
    figures.bending = result.start.bending = dict.fromkeys(figures.laws, 1.0)
    assert "9        " in tonewood(*words)[1]
    figures.laws["13"] = rates  # beyond only those that were heard
    shown = tonewood(*words)[1].splitlines()
    assert [line.split()[0] for line in shown[2:4]] == ["E2", "place"]


def test_a_fit_hands_its_options_on(tonewood: Run, tmp_path: Path, monkeypatch: Patch) -> None:
    from tonewood.cli import fit
    from tonewood.workshop.fit import files, folder, radiation
    from tonewood.workshop.fit import fit as fitting

    fitted = SimpleNamespace(body="body", responses="used", warnings=("noise",))
    reading, asked, heard = Asked("responses"), Asked(fitted), Asked("radiation")
    made: ClassVar[list[Any]] = []

    class Folder:
        def __init__(self, *words: Any) -> None:
            made.append(words)

        def write(self, output: Path, draw: Any) -> list[Path]:
            return [output / "body.csv"]

        def facts(self) -> dict[str, Any]:
            return {"misfit": 1.5}

    places = {"bridge": folder.MeasuredPoint("z", 0.5), "side": folder.MeasuredPoint("x", None)}
    named = Asked(("named", places))
    for module, name, to in (
        (files, "read_responses", reading), (fitting, "fit_responses", asked), (radiation, "fit_radiation", heard),
        (folder, "FitFolder", Folder), (fit, "_named", named),
    ):  # fmt: skip
        monkeypatch.setattr(module, name, to)
    words = ("fit", "a.csv", "-o", tmp_path / "f", "--band", 80, 900, "--keep", "100,200", "--drop", "300", "--json")
    report = told(tonewood(*words, "--form", "mobility", "--damping", "viscous", "--driving", "bridge", "--hits", 4))
    assert reading.words[0] == [Path("a.csv")]
    request = reading.words[1]
    assert (request.form, request.n_hits, request.scale, request.estimator) == ("mobility", 4, 1.0, "H1")
    assert (request.references, request.window_tau, request.arrays) == ((("bridge", ""),), None, ())
    assert named.words == ("responses", [])
    options = {key: asked.options[key] for key in ("band", "damping", "keep", "drop")}
    assert options == {"band": (80.0, 900.0), "damping": "viscous", "keep": (100.0, 200.0), "drop": (300.0,)}
    assert heard.words == ("used", "body", {"bridge": 0.5})
    assert made[0][:3] == (fitted, "radiation", places)
    assert (report["misfit"], report["warnings"]) == (1.5, ["noise"])
    assert report["written"] == [str(tmp_path / "f" / "body.csv")]
    fitted.body = None  # no passive body: nothing of which microphones could be fitted
    told(tonewood(*words))
    assert (asked.options["damping"], made[1][1]) == ("auto", None)
    told(tonewood(*(word for word in words if word not in ("--band", 80, 900))))
    assert asked.options["band"] == (None, None)
    (tmp_path / "f").mkdir()
    (tmp_path / "f" / "instrument.yaml").write_text("")
    refused(tonewood(*words[:-1]), "holds an instrument")
    refused(tonewood(*words[:3], tmp_path / "no" / "f"), "there is no folder")


def test_lines_on_a_fit(capsys: pytest.CaptureFixture[str]) -> None:
    from tonewood.cli import fit

    rows = [
        {"freq_Hz": 101.25, "Q": 30.0, "mass_kg": 0.125, "measured": True, "sd_cents": 1.5, "sd_Q": 0.02,
         "without_db": 6.5, "mpc": 0.875},
        {"freq_Hz": 202.5, "Q": 20.0, "mass_kg": None, "measured": True, "sd_cents": 2.0, "sd_Q": 0.5,
         "without_db": 3.0, "mpc": None},
        {"freq_Hz": 5000.0, "Q": 5.0, "mass_kg": 0.5, "measured": False},
    ]  # fmt: skip
    facts = {
        "step_Hz": 0.5, "modes": rows, "dropped": ["a line"], "error_db": {"rms": 0.25, "95%": 0.5, "most": 1.5},
        "misfit": 1.25, "radiation": {"channels": ["left", "right"], "modes": 9, "error_db_rms": 2.5},
    }  # fmt: skip
    steps = [SimpleNamespace(freq=[1, 2], misfit=3.0), SimpleNamespace(freq=[1, 2, 3], misfit=1.25)]
    fitted = SimpleNamespace(
        responses=SimpleNamespace(kept=(4, 5), pairs=[("a", "b"), ("b", "b")], freq=[80.0, 900.0]),
        modes=SimpleNamespace(iterations=steps, structural=True), body=SimpleNamespace(points=["b", "a"]),
    )  # fmt: skip
    folder: Any = SimpleNamespace(fit=fitted, facts=lambda: facts, origin=SimpleNamespace(measured_by="unknown"))
    fit._print(folder, [Path("f/body.csv"), Path("f/fit.json")])
    assert capsys.readouterr().out.splitlines() == [
        "a:b, b:b: 80 to 900 Hz in steps of 0.5 Hz, 4 of 5 hits kept",
        "modes found iteration by iteration, and misfit re noise: 2 (3), 3 (1.25)",
        "damping taken for structural (hysteretic), Q = 1/eta",
        "     f/Hz       Q   mass at b/kg  +-cents   +-Q    without it   MPC",
        f"   101.25    30.0   {'0.125':>10}       1.5     2 %      6.5 dB  0.875",
        f"    202.5    20.0   {'':>10}         2    50 %      3.0 dB",
        f"     5000     5.0   {'0.5':>10}    no mode of the band: stands for modes beyond it",
        "  dropped: a line",
        "misfit 1.25 times the noise; the body's mobility re the measured one: 0.25 dB r.m.s., 0.50 in 95 % of the "
        "bins, 1.50 at most",
        "microphones left, right: 9 modes, 2.50 dB r.m.s. off",
        "passive by construction (real modes)",
        "measured by unknown: say who by --measured-by",
        "written: f/body.csv, f/fit.json",
    ]
    fitted.body, fitted.responses.kept, fitted.modes.structural = None, None, False
    facts["radiation"], folder.origin.measured_by = None, "N. N."
    fit._print(folder, [Path("f/modes.csv")])
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "a:b, b:b: 80 to 900 Hz in steps of 0.5 Hz"
    assert lines[2] == "damping taken for viscous"
    assert lines[4].split() == ["101.25", "30.0", "0.125", "1.5", "2", "%", "6.5", "dB", "0.875"]
    assert "the modes' mobility" in lines[8]
    assert lines[9:] == ["measured by N. N.", "written: f/modes.csv"]
