"""Lines that commands print: warnings, check, plan."""

from __future__ import annotations

import csv
import json
import math
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace

import pytest
from cli_refusals import refused

from tonewood.cli import (
    batch,
    check,
    common,
    compare,
    estimate,
    plan,
    render_report,
    results,
    stems,
    tab,
    taptone,
    wood,
)
from tonewood.errors import OutputError, TonewoodError
from tonewood.workshop.taps.ringing import Peak

# -- warnings ----------------------------------------------------------------------------------------------------------


@dataclass
class Lost:
    time: float
    reason: str
    name: str = ""


def test_warnings_are_a_line_a_kind(capsys) -> None:
    common.warn_of_dropped(
        [
            Lost(1.0, "A2 is below 40"),
            Lost(2.0, "no string"),
            Lost(3.0, "B3 is below 41"),
            Lost(4.0, "C#4 is below 1.5"),
        ],
        "x: ",
    )
    assert capsys.readouterr().err.splitlines() == [
        "tonewood: warning: x: not played at 1.00 s: A2 is below 40, nor 2 other notes for such a reason",
        "tonewood: warning: x: not played at 2.00 s: no string",
    ]
    common.warn_of_kinds(["late by 1 s", "odd", "late by 2.5 s"])
    assert capsys.readouterr().err.splitlines() == [
        "tonewood: warning: late by 1 s (and 1 more of this kind)",
        "tonewood: warning: odd",
    ]
    common.print_faults([Lost(0, "r", "a"), Lost(0, "s", "b"), Lost(0, "r", "c"), Lost(0, "r", "d")], "conditions")
    assert capsys.readouterr().err.splitlines() == [
        "tonewood: failed: a and 2 other conditions: r",
        "tonewood: failed: b: s",
    ]
    common.print_json("x", {"a": math.nan}, ok=False)
    assert json.loads(capsys.readouterr().out) == {"schema": "tonewood-x/1", "ok": False, "a": None}
    with common.progress("x", 1.0) as advance:
        advance(0.5)
    assert capsys.readouterr().err == ""


def test_a_log_has_a_line_each_15_s_and_one_at_the_end_of_a_long_stage(capsys) -> None:
    now = [0.0]
    with batch._Bars(lambda: now[0]) as bars:
        bars.logs = True
        for at, stage, done in (
            (0, "a", 0),
            (14.9, "a", 1),
            (15, "a", 2),
            (29, "a", 3),
            (40, "a", 8),
            (41, "b", 0),
            (42, "b", 4),
        ):
            now[0] = at
            bars(stage, done, 8 if stage == "a" else 4)
    assert capsys.readouterr().err.splitlines() == [
        "tonewood: a: 2 of 8 (25 %), about 45 s to go",
        "tonewood: a: 8 of 8 (100 %), 40 s",
    ]


@pytest.mark.parametrize(
    ("text", "values"),
    [
        ("body.h=1:2:3", [1.0, 1.5, 2.0]),
        (" a = 0.1:0.2:2", [0.1, 0.2]),
        ("a=1:2:5", [1.0, 1.25, 1.5, 1.75, 2.0]),
    ],
)
def test_values_of_a_sweep(text, values) -> None:
    assert compare._swept(text, 5) == (text.partition("=")[0].strip(), values)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("a=1:2", "PATH=LOW:HIGH:COUNT"),
        ("a=1:2:3:4", "PATH=LOW:HIGH:COUNT"),
        ("=1:2:3", "PATH=LOW:HIGH:COUNT"),
        ("a=2:2:3", "LOW below HIGH"),
        ("a=1:2:2.5", "LOW below HIGH"),
        ("a=1:x:3", "LOW below HIGH"),
        ("a=1:2:1", "has 1 values; 2 to 5 are allowed"),
        ("a=1:2:6", "has 6 values; 2 to 5 are allowed"),
    ],
)
def test_sweeps_that_are_refused(text, said) -> None:
    refused(said, compare._swept, text, 5)
    assert compare._changes("set", ["a=1"]) == ("strings_from=set", "a=1")
    assert compare._changes(None, None) == ()


@pytest.mark.parametrize(
    ("text", "quarters"), [("3/4", 3.0), ("6/8", 3.0), (" 2/2 ", 4.0), ("5/16", 1.25), (None, None)]
)
def test_lengths_of_measures(text, quarters) -> None:
    assert tab._meter(text) == quarters
    for wrong in ("0/4", "3/5", "3", "100/4", "3/4/4"):
        refused("3/4 or 6/8 is allowed", tab._meter, wrong)


def test_files_of_stems_are_numbered(tmp_path) -> None:
    out = tmp_path / "mix.wav"
    files = stems.stem_files(tmp_path / "s", ["a", "b", "a", "a", "A", "a_2"], out)
    # one file on macOS and Windows: a and A
    assert [file.name for file in files] == ["a.wav", "b.wav", "a_2.wav", "a_3.wav", "A_4.wav", "a_2_2.wav"]
    refused("is the name of a stem", stems.stem_files, tmp_path, ["mix"], out)
    stems.check_stem_folder(tmp_path / "p" / "q", parents=True)
    assert not (tmp_path / "p").exists()
    refused("cannot be made", stems.check_stem_folder, tmp_path / "p" / "q")
    (tmp_path / "file").write_text("")
    refused("is a file; a folder is allowed", stems.check_stem_folder, tmp_path / "file")
    with pytest.raises(KeyError), stems.stem_folder(tmp_path / "n" / "m", parents=True):
        raise KeyError
    assert not (tmp_path / "n").exists()
    with stems.stem_folder(tmp_path / "n"):
        pass
    assert (tmp_path / "n").is_dir()


def test_a_table_of_taps_has_their_figures(tmp_path) -> None:
    peak = Peak(200.0, 30.0, (199.0, 201.0), (28.0, 32.0), -3.0, 2, 5)
    row = taptone._row(peak, "T1")
    assert row == {
        "freq_Hz": 200.0,
        "freq_90_Hz": [199.0, 201.0],
        "Q": 30.0,
        "Q_90": [28.0, 32.0],
        "level_dB": -3.0,
        "seen_in_taps": 2,
        "taps": 5,
        "certain": False,
        "name": "T1",
    }
    head, cells = csv.reader(taptone._csv([row]).splitlines())
    assert dict(zip(head, cells, strict=True)) == {
        "freq_Hz": "200.0",
        "freq_low_Hz": "199.0",
        "freq_high_Hz": "201.0",
        "Q": "30.0",
        "Q_low": "28.0",
        "Q_high": "32.0",
        "level_dB": "-3.0",
        "seen_in_taps": "2",
        "taps": "5",
        "certain": "0",
        "name": "T1",
    }
    assert taptone._doubts(SimpleNamespace(samples=(1, 2, 3))) == []
    assert taptone._doubts(SimpleNamespace(samples=(1, 2))) == [
        "2 tap(s): three or more at one place tell what repeats"
    ]
    file, band = tmp_path / "a.wav", (50.0, 60.0)
    assert taptone._check([file], 3, 48000, None, 1, band, None, None) == [file]
    refused("no file was given", taptone._check, [], None, None, None, 1, band, None, None)
    refused("--record writes one file", taptone._check, [file, file], 3, 48000, None, 1, band, None, None)
    refused("1 to 100 are allowed", taptone._check, [file], 0, 48000, None, 1, band, None, None)
    refused("--fs: is for --record", taptone._check, [file], None, 48000, None, 1, band, None, None)
    refused("--device: is for --record", taptone._check, [file], None, None, "2", 1, band, None, None)
    refused("8000 to 192000", taptone._check, [file], 1, 7999, None, 1, band, None, None)
    refused("--channel", taptone._check, [file], None, None, None, 0, band, None, None)
    file.write_text("")
    refused("it would be overwritten", taptone._check, [file], 3, 48000, None, 1, band, None, None)


def test_lengths_in_mm_are_told() -> None:
    wood._in_si("--length", 3.0, 5e-4, 3.0, ("m", "mm"))
    refused(r"580 mm are 0.58 m", wood._in_si, "--length", 580.0, 5e-4, 3.0, ("m", "mm"))
    with pytest.raises(TonewoodError) as fault:
        wood._in_si("--length", 3001.0, 5e-4, 3.0, ("m", "mm"))
    assert "mm are" not in str(fault.value)


# -- check -------------------------------------------------------------------------------------------------------------


def law(**more):
    return {
        "cents": 0.02,
        "bend_cents": 0.0,
        "decay": 0.01,
        "decay_is_off": False,
        "pitch_is_off": False,
        "stop": 3,
        "own": 0.0,
        "decay_partial": 5,
        "pitch_partial": 7,
    } | more


def test_lines_on_the_law_of_a_string() -> None:
    assert check._law_lines([]) == ["does not end on the body: its partials are compared with no law"]
    rows = [law(), law(cents=-0.3, decay=-0.05), law(bend_cents=100.0, cents=2.0, decay=0.2)]
    assert check._law_lines(rows) == [
        "partials within 0.3 cents (2 bent by 100), decays within 5 % (20 %) of its loss law"
    ]
    assert "does not tell its loss law" in check._law_lines([law(decay=None)])[0]
    steep = check._law_lines([law(decay_is_off=True, decay=0.5, own=-0.26)])[1]
    assert steep.startswith("warning: partial 5 at stop 3 decays at 1.5 times the rate")
    assert "too steeply" in steep
    assert "`detuned`" in check._law_lines([law(decay_is_off=True, decay=0.5, own=0.25)])[1]
    off = check._law_lines([law(), law(pitch_is_off=True, cents=4.0, bend_cents=50.0, stop=2)])[1]
    assert off.startswith("warning: partial 7 at stop 2, bent by 50 cents, is +4 cents from that of a basis")


def test_microphones_that_hear_nothing_or_too_much() -> None:
    def row(peak):
        return check._microphone(
            SimpleNamespace(output="o", channel="c", unit="Pa", n_modes=3, peak=peak, freq=200.0, full_scale=2.0)
        )

    assert row(0.0)["doubt"].startswith("hears nothing")
    assert row(0.0)["peak_freq"] is None
    assert (row(2000.0)["doubt"], row(2000.0)["peak_freq"], row(2000.0)["peak"]) == (None, 200.0, 2000.0)
    assert row(2002.0)["doubt"].startswith("gives 1e+03 times full scale per N")


def test_lines_on_pitches() -> None:
    planes = [
        SimpleNamespace(component=f"E2.{name}", cents=c, split_cents=s, share=0.5, off_cents=o)
        for name, c, s, o in (("z", 0.5, 0.0, 9.0), ("y", -3.0, -2.5, -4.0), ("x", 1.0, 1.0, 2.0))
    ]
    p = SimpleNamespace(
        string="E2",
        stop=3,
        note=43,
        planes=planes,
        wanted_freq=98.0,
        freq=98.5,
        error_cents=8.8,
        t60=2.0,
        wolf=None,
        modes=[7],
    )
    assert check._worst_plane(p) == 4.0
    assert check._worst_plane(SimpleNamespace(planes=planes[:1])) == 0.0
    row = check.plane_row(p)
    assert (row["off_cents"], row["note"], row["planes"]["E2.y"]) == (
        4.0,
        "G2",
        {"cents": -3.0, "split_cents": -2.5, "share": 0.5},
    )
    assert check.plane_words(row) == "z +0.5, y -3.0 (split -2.5), x +1.0 (split +1.0) cents"
    assert "wolf" not in check.pitch_row(p)
    p.wolf = SimpleNamespace(freq=98.5 * 2 ** (20 / 1200), level_db=lambda mode: -float(mode))
    wolf = check.pitch_row(p)
    assert wolf["wolf"] == {"freq": p.wolf.freq, "cents": pytest.approx(20.0), "level_db": -7.0}
    assert (
        check.wolf_line(wolf)
        == "E2 stop  3 (G2, 98.5 Hz, +8.8 cents off): a body mode at 99.6 Hz, +20 cents and -7.0 dB from it"
    )
    p.error_cents = 1.0
    assert ", 98.5 Hz): " in check.wolf_line(check.pitch_row(p))
    shared = {
        "string": "E2",
        "stop": 3,
        "note": "G2",
        "modes": [{"cents": 4.0}, {"cents": -6.0}],
        "cents_alone": 0.5,
        "partner": "A2",
        "partner_share": 0.304,
    }
    assert check._mounted_line(shared) == "E2 stop  3 (G2): +4.0 and -6.0 cents, +0.5 alone, shared with A2 (30 %)"
    assert check._mounted_line(shared | {"partner": None}).endswith("+0.5 alone")


def string(**more):
    feel = {"newton_per_mm": 1.25, "from_bridge": 0.12, "break_angle_deg": 12.0, "force_on_bridge": 15.0}
    return {
        "note": "E2",
        "stops": 19,
        "n_modes": 40,
        "tension": 70.0,
        "count": 1,
        "feel": feel,
        "held_note": None,
        "worst_cents": -2.5,
        "worst_cents_mounted": 3.5,
        "law": [law()],
        "stop_tension": {"stop": 3.0, "relative": 0.01},
    } | more


def report(**more):
    return {
        "instrument": "i",
        "title": "t",
        "licence": "l",
        "folder": "f",
        "plugins": ["p", "q"],
        "fs": 48000,
        "n_modes": 90,
        "n_modes_all_outputs": 120,
        "body": {"n_modes": 9, "freq_lower": 80.4, "freq_upper": 999.6, "n_overdamped": 4, "summary": "passive"},
        "added": ["2 g at a"],
        "model": [],
        "silent_outputs": [],
        "strings": {"E2": string(), "A2": string(count=2, tension=50.0, stops=0, held_note="held at 70 N")},
        "microphones": [
            {"output": "o", "channel": "l", "n_modes": 5, "peak": 2.0, "unit": "Pa", "peak_freq": 200.4, "doubt": None}
        ],
        "forces_at_rest": {},
        "touched_at_rest": {"bridge": ["E2"]},
        "changing_bases": [],
        "potentials": [{"name": "v", "effect": None, "doubt": None}, {"name": "w", "effect": "e", "doubt": "doubtful"}],
        "off_pitch": [
            {"string": "E2", "stop": i, "note": "X", "error_cents": (-1) ** i * 5.0 * i} for i in range(1, 7)
        ],
        "wolf_notes": [],
        "off_pitch_mounted": [],
        "off_planes": [],
        "table_doubts": ["table"],
        "stand_ins": [{"path": f"p{i}", "note": "n" if i else None} for i in range(4)],
        "unknown": ["u", "v"],
        "provenance": {"measured": 3, "authored": 2},
        "sources_used": ["s"],
        "sources": {"s": {"text": "S", "doi": "10/1", "licence": "CC"}, "z": {"text": "Z", "licence": "PD"}},
    } | more


def test_a_check_prints_the_worst_first(capsys) -> None:
    check._print(report(), True, False, ["moves"])
    text = capsys.readouterr().out.splitlines()
    assert text[0] == "i: t (l)"
    assert text[2:4] == ["  warning: table", "  warning: doubtful"]
    off = [line for line in text if "off pitch" in line]
    assert off == [f"  off pitch: E2 stop {i} (X): {(-1) ** i * 5.0 * i:+.1f} cents" for i in (6, 5, 4, 3)] + [
        "  off pitch: 2 more (--all)"
    ]
    assert "  90 modes (120 with all outputs) at 48000 Hz, plugins p, q" in text
    assert "  body: 9 modes, 80 to 1000 Hz: passive" in text
    assert "  added to the body: 2 g at a: passive by construction" in text
    assert [line for line in text if "potential" in line] == [
        "  potential v: no effect leaves it out, `--effects none` neither"
    ]
    assert "  2 strings, every stop within 2.5 cents alone, 3.5 with all on" in text
    assert "  string A2: held at 70 N" in text
    assert "  all strings: 170 N along, 45 N down on the bridge" in text
    assert [line for line in text if "stand-in" in line] == [
        "  stand-in: p0",
        "  stand-in: p1: n",
        "  stand-in: 2 more (--all)",
    ]
    assert "  of unknown origin: u, v" in text
    assert text[-3:] == ["  moves", "  (--all prints every string, stop, microphone and source)", "ok, with 2 warnings"]
    strings = {"E2": string(), "A2": string(worst_cents=1.0, worst_cents_mounted=-0.5)}  # the worst counts
    check._print(report(strings=strings), True, False, [])
    assert "  2 strings, every stop within 2.5 cents alone, 3.5 with all on" in capsys.readouterr().out.splitlines()
    bare = report(strings={}, table_doubts=[], potentials=[], n_modes_all_outputs=90)
    check._print(bare, False, False, [])
    text = capsys.readouterr().out.splitlines()
    assert "  90 modes at 48000 Hz, plugins p, q" in text
    assert "  a body alone, without strings" in text
    assert text[-1] == "not ok: its body could create energy"


def test_a_whole_check_prints_every_string_and_source(capsys) -> None:
    check._print(report(), True, True, [])
    text = capsys.readouterr().out.splitlines()
    assert "  string E2: E2, 19 stops, 40 modes, 70.00 N, within 2.5 cents alone, 3.5 with all on" in text
    assert (
        "  string A2, one of 2 of its key: E2, open, 40 modes, 50.00 N, within 2.5 cents alone, 3.5 with all on" in text
    )
    assert "    1.25 N for 1 mm sideways, 120 mm from the bridge; 12 deg over it, 15.0 N down on it" in text
    assert "    held at 70 N" in text
    assert "  microphone o.l: 5 modes in its bank, at most 2 Pa/N, at 200 Hz" in text
    assert "  figures: 3 measured, 2 authored" in text
    assert "  source s: S, 10/1 (CC)" in text
    assert "  source z, which no figure names: Z (PD)" in text
    assert sum("stand-in" in line for line in text) == 4
    assert sum("off pitch" in line for line in text) == 6
    check._print_tension(report(strings={"E2": string(feel={"force_on_bridge": None})}))
    assert capsys.readouterr().out == "  all strings: 70 N along\n"


# -- plan --------------------------------------------------------------------------------------------------------------


def effect(**more):
    return SimpleNamespace(
        **{
            "name": "e",
            "component": "E2",
            "seconds": 2.0,
            "spans_s": [(0.0, 2.0)],
            "predicted_s": 1.0,
            "why": "w",
            "title": "a law",
            "bound": 0.5,
            "bound_db": None,
            "unit": "cents",
            "seconds_active": 1.0,
            "seconds_saved": 0.5,
        }
        | more
    )


def test_effects_of_a_plan() -> None:
    whole = SimpleNamespace(predicted_s=50.0, duration_s=10.0)
    for seconds, cost, told in (
        (0.0, None, False),
        (5.0, None, True),
        (9.99, None, False),
        (0.0, 1.0, True),
        (10.0, 0.99, False),
    ):
        assert plan.matters(effect(seconds=seconds, predicted_s=cost), whole) is told
    two = [effect(), effect(component="A2", seconds=4.0, predicted_s=0.5, why="longest")]
    assert plan._line("n", two) == "n of E2 and A2 for 2 to 4 s (1.5 s of computing): longest"
    assert plan._line("n", [effect(predicted_s=None)] * 3) == "n of 3 strings for 2 s: w"
    spans = [(float(i), i + 0.5) for i in range(5)]
    assert plan._when(effect(spans_s=spans)) == " [0.00-0.50, 1.00-1.50, 2.00-2.50 and 2 more]"
    assert plan._when(effect(spans_s=spans[:3])) == " [0.00-0.50, 1.00-1.50, 2.00-2.50]"
    assert plan._when(effect(spans_s=[])) == ""


def test_effects_that_were_left_out() -> None:
    def summary(*effects):
        return SimpleNamespace(effects=effects, duration_s=3.0, render_s=9.0)

    lines = render_report.left_out_lines
    assert lines(summary(effect(bound=0.0), effect(bound=None), effect(seconds_active=3.0))) == []
    assert lines(summary(effect(), effect(component="A2", seconds_active=2.5, bound=0.75, bound_db=0.1))) == [
        "  Left out: a law of E2 for 2 s and A2 for 0.5 s, at most 0.75 cent and 0.1 dB. Saved 1.0 s of 10.0 s."
    ]
    many = [effect(seconds_active=x, seconds_saved=0.01) for x in (0.5, 1.0, 2.0)]
    assert lines(summary(*many)) == ["  Left out: a law of 3 strings for 1 to 2.5 s, at most 0.5 cent."]


@pytest.mark.parametrize(
    ("peak", "subtype", "silent"),
    [
        (2.0**-16, "PCM_16", False),
        (0.9 * 2.0**-16, "pcm_16", True),
        (2.0**-24, "PCM_24", False),
        (1e-9, "FLOAT", False),
        (0.9 * 2.0**-24, "PCM_24", True),
    ],
)
def test_sounds_below_the_smallest_step_are_silent(peak, subtype, silent) -> None:
    def written(dbfs=-20.0, **more):
        renderer = SimpleNamespace(summary=lambda: SimpleNamespace(peak_dbfs=dbfs, warnings=("w",)))
        return render_report.WrittenSound(
            renderer,
            Path("a.wav"),
            subtype,
            **{"clipped": 0, "peak": peak, "level": "peak", "gain_db": 0.0, "limiter": None} | more,
        )

    assert written().silent is silent
    assert written(dbfs=-math.inf).silent
    assert any("is silent" in line for line in written().warnings()) is silent
    fate = "beyond full scale" if subtype == "FLOAT" else "clipped"
    assert f"1 sample was {fate}; lower --gain, or use --level peak or --limiter" in written(clipped=1).warnings()
    assert f"2 samples were {fate}; lower --gain, or use --level peak or --limiter" in written(clipped=2).warnings()
    assert "the limiter took away up to 3.0 dB" in written(limiter=SimpleNamespace(reduction_db=3.0)).warnings()
    assert written(limiter=SimpleNamespace(reduction_db=0.0)).warnings()[0] == "w"


def test_facts_of_stimuli(tmp_path) -> None:
    assert results._facts(tmp_path) is None
    files = [
        {"frames": 48000, "fs": 48000, "lufs": -20.0, "momentary_lufs": None, "true_peak_dbtp": -3.0},
        {"frames": 24000, "fs": 48000, "lufs": -23.0, "momentary_lufs": None, "true_peak_dbtp": -1.0},
    ]
    record = {"files": files, "manifest": {"stimuli": {"onset": {"at": 0.02}}}}
    (tmp_path / "manifest.json").write_text(json.dumps(record))
    assert results._facts(tmp_path) == {
        "count": 2,
        "fs": 48000,
        "onset_ms": 20.0,
        "rows": [
            {"name": "length, s", "low": 0.5, "high": 1.0},
            {"name": "loudness BS.1770, LUFS", "low": -23.0, "high": -20.0},
            {"name": "true peak, dBTP", "low": -3.0, "high": -1.0},
        ],
    }
    assert results._facts_of({"files": files, "manifest": {}})["onset_ms"] == 10.0
    assert results._facts_of({"files": [], "manifest": {}}) is None
    assert results._facts_of({"files": files[:1], "manifest": {}})["fs"] == 48000
    for text in ("{", "[]", '{"files": 3}', '{"files": [], "files": []}'):
        (tmp_path / "manifest.json").write_text(text)
        refused("is not the record of a batch", results._facts, tmp_path)


def test_words_of_an_estimate(tmp_path) -> None:
    for count, said in ((0, ""), (1, ", 1 mode moved"), (2, ", 2 modes moved")):
        assert estimate._but(SimpleNamespace(figures=SimpleNamespace(modes=dict.fromkeys(range(count))))) == said
    estimate._check(tmp_path / "new", 10, None)
    refused("1 to 10 are allowed", estimate._check, tmp_path / "new", 11, None)
    with pytest.raises(OutputError, match="is there already"):
        estimate._check(tmp_path, 3, None)


def test_the_stop_of_the_largest_change_of_tension_is_told() -> None:
    pitches = [SimpleNamespace(stop=n, tension=t) for n, t in enumerate((80.0, 82.0, 76.0, 81.0))]
    told = check._stop_tension(pitches)
    assert told == {"stop": 2, "relative": pytest.approx(-0.05)}
