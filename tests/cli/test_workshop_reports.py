"""Reports of fit, design, wood, intonation, distance and data sets; sweeps, and defaults of options."""

from __future__ import annotations

import json
import math
import signal
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace

import mido
import numpy as np
import pytest
import yaml
from cli_refusals import refused

from tonewood.cli import (
    compare,
    dataset,
    design,
    distance,
    fit,
    intonation,
    stopping,
    wood,
)
from tonewood.physics.plate.wood import Wood
from tonewood.workshop.design.search import FoundDesign
from tonewood.workshop.design.task import Free, Target
from tonewood.workshop.estimate.distance import Distance
from tonewood.workshop.fit.responses import Responses
from tonewood.workshop.report import summary
from tonewood.workshop.wood.board import Board, MatchedPeak
from tonewood.workshop.wood.stick import Stick

# -- workshop ----------------------------------------------------------------------------------------------------------


def test_numbers_and_references_of_a_fit(tmp_path) -> None:
    assert fit._words(None) == []
    assert fit._words("a, b") == ["a", "b"]
    assert fit._numbers("1, -2e-3") == (1.0, -2e-3)
    refused("'x' is no number", fit._numbers, "1,x")
    refused("0 is not allowed", fit._numbers, "1,0")
    assert fit._frequencies("--keep", "100,2e3") == (100.0, 2000.0)
    for text in ("0", "-1", "x", "1e999"):
        refused("--keep: .* is no frequency", fit._frequencies, "--keep", text)
    assert fit._references(["a", "b=bb", "c=c_1"]) == (("c", "c_1"), ("b", "bb"), ("a", ""))
    assert fit._references(None) == ()
    fit._check_options("mobility", "H2", -1.0, 1e-4, 2, (1.0, 2.0))
    for options, said in (
        (("speed", "H1", 1.0, None, None, None), "--form"),
        ((None, "H3", 1.0, None, None, None), "--estimator"),
        ((None, "H1", 0.0, None, None, None), "--scale"),
        ((None, "H1", 1.0, 0.0, None, None), "--window-tau"),
        ((None, "H1", 1.0, None, 1, None), "--hits: is 1 hits; 2 to 100000"),
        ((None, "H1", 1.0, None, None, (2.0, 1.0)), "--band"),
    ):
        refused(said, fit._check_options, *options)
    fit._check_folder(tmp_path / "new")
    refused("there is no folder", fit._check_folder, tmp_path / "no" / "new")
    (tmp_path / "instrument.yaml").write_text("")
    refused("holds an instrument", fit._check_folder, tmp_path)
    refused("is a file", fit._check_folder, tmp_path / "instrument.yaml")


def test_points_of_a_fit_have_names_directions_and_places() -> None:
    pairs = (("12+3", "12+3"), ("7-1", "12+3"), ("3+0", "12+3"), ("p", "12+3"))
    responses = Responses(np.ones(1), np.ones((4, 1), complex), pairs)
    named, places = fit._named(responses, ["p=q:x:-0.5", "3+0=bass::1"])
    assert named.points == ("n12", "n7_x_back", "bass", "q")
    assert (places["n12"].direction, places["n12"].u) == ("z", None)
    assert places["n7_x_back"].direction == (-1.0, -0.0, -0.0)
    assert (places["q"].direction, places["q"].u) == ("x", -0.5)
    assert (places["bass"].direction, places["bass"].u) == ("z", 1.0)
    moved, places = fit._named(responses, ["12+3=top:y"])
    assert moved.points[0] == "top"
    assert places["top"].direction == "y"
    for text, said in (
        ("p", "NODE=NAME"),
        ("p=q:x:0:1", "NODE=NAME"),
        ("p=q:w", "the directions x, y, z"),
        ("p=q:x:1.1", "from -1"),
        ("p=Q", "cannot be the name"),
        ("p=sd_a", "cannot be the name"),
        ("p=a b", "cannot be the name"),
    ):
        refused(said, fit._named, responses, [text])


def test_a_report_of_a_design_has_its_figures() -> None:
    target = Target("A0 = 100", "freq", "=", 100.0, mode="A0")
    free = Free("b.*", ("b.0", "b.1"), (1.0, 2.0), "x", 0.5, 2.0)
    best = FoundDesign(
        (target,),
        (free,),
        np.array([1.0]),
        np.array([1.5]),
        np.array([90.0]),
        np.array([101.0]),
        np.array([[3.0]]),
        SimpleNamespace(name="i"),
    )
    out = json.loads(json.dumps(design._report(best, Path("made"))))
    assert out["parameters"] == [
        {"path": "b.*", "keys": ["b.0", "b.1"], "kind": "x", "low": 0.5, "high": 2.0, "now": 1.0, "designed": 1.5}
    ]
    assert out["targets"] == [
        {
            "text": "A0 = 100",
            "now": 90.0,
            "designed": 101.0,
            "off": pytest.approx(1200 * math.log2(1.01)),
            "unit": "cents",
            "reached": False,
            "rates": [3.0],
        }
    ]
    assert out["overrides"] == {"b.0": 1.5, "b.1": 3.0}
    assert (out["instrument"], out["bundle"], out["at_bounds"], out["trades"]) == ("i", "made", [], [])


def board(**more):
    pairs = (MatchedPeak(100.0, 101.0, (0.9, 0.0, 0.1), 50.0), MatchedPeak(200.0, 199.0, (0.0, 0.9, 0.1), 0.0))
    constants = Wood(1.2e10, 8e8, 7e8, 0.37, 410.0, G_LT=6e8, G_RT=5e7, loss_L=0.01, loss_R=0.02, loss_shear=0.015)
    return Board(
        **{
            "wood": constants,
            "intervals": {"E_L": (1.1e10, 1.3e10), "loss_L": (0.009, 0.011)},
            "pairs": pairs,
            "peaks_without_mode": (150.0,),
            "modes_without_peak": (120.0,),
            "misfit": 0.0121,
            "sensor": 2e-3,
        }
        | more
    )


def test_a_report_of_a_board(capsys) -> None:
    tops = [{"thickness_m": 2.5e-3, "freq_Hz": 75.0, "of": "here"}]
    report = wood._report(board(), 410.0, tops, True)
    assert report["constants"] == {
        "E_L": {"value": 1.2e10, "interval_90": [1.1e10, 1.3e10]},
        "loss_L": {"value": 0.01, "interval_90": [0.009, 0.011]},
    }
    assert report["pairs"][0] == {"measured_Hz": 100.0, "computed_Hz": 101.0, "kind": "bending along"}
    assert (report["density"], report["sensor_kg"], report["modes_without_peak_Hz"]) == (410.0, 2e-3, [120.0])
    said = "\n".join(report["warnings"])
    for text in ("a sensor of 2.0 g", "differ by 1.2 %", "no mode of such a board: 150.0 Hz"):
        assert text in said
    quiet = wood._report(board(misfit=0.012, peaks_without_mode=(), sensor=0.0), 410.0, [], True)
    assert quiet["warnings"] == []
    assert wood._report(board(misfit=0.0, peaks_without_mode=()), 410.0, [], False)["warnings"] == []
    wood._print(report)
    text = capsys.readouterr().out.splitlines()
    assert text[0] == "density 410 kg/m^3"
    assert text[1].split() == ["E_L", "12", "11", "to", "13", "GPa"]
    assert text[2].split() == ["loss_L", "0.01", "0.009", "to", "0.011"]
    assert text[4].split() == ["100.00", "101.00", "+1.00", "bending", "along"]
    assert text[5].split()[:3] == ["200.00", "199.00", "-0.50"]
    assert "modes without a peak: 120 Hz" in text
    assert "2.50 mm: 75.0 Hz, here" in text
    values = yaml.safe_load(wood._yaml(board(), "sitka_spruce"))["wood"]
    assert values.pop("species") == "sitka_spruce"
    assert {key: float(value) for key, value in values.items()} == {
        "density": 410.0,
        "E_L": 1.2e10,
        "E_R": 8e8,
        "G_LR": 7e8,
        "G_LT": 6e8,
        "G_RT": 5e7,
        "nu_LR": 0.37,
        "loss_L": 0.01,
        "loss_R": 0.02,
        "loss_shear": 0.015,
    }
    stick = Stick(1.1e10, 420.0, None, {"E_L": (1e10, 1.2e10)}, (100.0,), (101.0,), ())
    assert wood._report(stick, 420.0, [], True)["pairs"] == [
        {"measured_Hz": 100.0, "computed_Hz": 101.0, "kind": "bending along"}
    ]
    lines = wood._yaml(stick, "s").splitlines()
    assert lines[0].endswith("E_L 1e+10 to 1.2e+10")
    assert lines[1:] == ["wood:", "  species: s", "  density: 420", "  E_L: 1.1e+10"]
    assert wood._tops(stick, (0.48, 0.28, 0.24, 0.37), None) == []
    assert wood._tops(board(), None, None) == []


def stop(number, rigid, planes, rests=None):
    return SimpleNamespace(
        stop=number, rigid=rigid, planes=planes, rests_on=rests or number, frets=1.0, stretch=2.0, stiffness=0.5
    )


def test_lines_on_intonation(capsys) -> None:
    assert intonation._setup(None) == " " * 20 + "none"
    assert intonation._setup(SimpleNamespace(nut_setback=1e-3, saddle_setback=-2.5e-3, rms=1.25)).split() == [
        "+1.00",
        "-2.50",
        "1.25",
    ]
    assert intonation._planes({"E2.z": 1.0, "E2.y": 2.0, "E2.x": -0.1}) == "z +1.0, x -0.1"
    string = SimpleNamespace(
        name="E2", stops=[stop(1, 0.5, {"E2.z": 1.0}), stop(2, 1.0, {"E2.z": -1.0, "E2.y": 3.0}, rests=3)]
    )
    assert intonation._warnings([string]) == ["warning: string E2 pressed to fret 2 lies on fret 3, which stands out"]
    intonation._print_body([string])
    assert capsys.readouterr().out.splitlines()[1] == "  E2 fret  2: z -1.0, y +3.0 cents, +1.0 without the body"
    intonation._print_detail([string])
    assert capsys.readouterr().out.splitlines()[3] == "     2   +1.00   +2.00   +0.50 =   +1.00   z -1.00  y +3.00"


def test_columns_of_distances(capsys) -> None:
    a = Distance(1.234, 2.0, 1.5, math.nan, 4.0, 5.0, 3, 7)
    distance.print_distances({"A to B": a, "scale   ": a})
    rows = capsys.readouterr().out.splitlines()
    assert rows[0].split() == ["A", "to", "B", "scale"]
    assert [row.split()[-1] for row in rows[1:]] == ["1.23", "2.00", "1.50", "-", "4.00", "5.00", "3"]
    assert len({len(row) for row in rows}) == 1


@dataclass
class Fault:
    name: str
    reason: str


def test_lines_on_a_data_set(capsys) -> None:
    plan = SimpleNamespace(
        samples=range(10),
        keys=range(4),
        tasks=range(3),
        sound_seconds=7200.0,
        compute_seconds=400.0,
        hours_per_core_hour=18.0,
        faults=[],
    )
    dataset._print_plan(plan, 2)
    assert capsys.readouterr().out.splitlines() == [
        "10 sounds in 4 shards, 3 of them to make",
        "about 2 hours of sound, 18 hours of sound per core-hour; about 150 s to go on 2 cores",
    ]
    plan.sound_seconds = None
    dataset._print_plan(plan, 2)
    assert len(capsys.readouterr().out.splitlines()) == 1
    report = SimpleNamespace(
        folder="f",
        sounds=10,
        sound_seconds=1800.0,
        made=2,
        reused=1,
        seconds=3.25,
        sha256="0123456789abcdefXX",
        notes=[f"n{i}" for i in range(21)],
        faults=[Fault("a", "r")],
    )
    dataset._print_report(report)
    out, err = capsys.readouterr()
    assert (
        out
        == "f: 10 sounds, 0.5 hours, in 2 new and 1 earlier shards, 3.2 s; SHA-256 of all samples 0123456789abcdef\n"
    )
    lines = err.splitlines()
    assert len(lines) == 22
    assert lines[20:] == ["tonewood: warning: 1 more note: --json has all", "tonewood: failed: a: r"]


# -- others ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("count", "every", "told"), [(8, False, False), (9, False, True), (9, True, False)])
def test_parameters_that_are_not_printed_are_told(capsys, count, every, told) -> None:
    rows = [SimpleNamespace(key=f"k{i}", values=(1, None), unit="m") for i in range(count)]
    facts = [SimpleNamespace(heading=h, strings=(), label=h, short=h, warnings=[], missing_tones={}) for h in "AB"]
    result = SimpleNamespace(instruments=facts, sweep="", wolves=[], parameters=rows)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(summary, "lines", lambda of, i: ["first", "  rest"])
        compare._print(result, every)
    out = capsys.readouterr().out.splitlines()
    assert out[:4] == ["A, a body without strings", "B, a body without strings", "A to B: first", "  rest"]
    assert out[4] == f"parameters that differ: {count}"
    assert out[5] == "  k0: 1 | none m"
    assert len([line for line in out if line.startswith("  k")]) == (count if every else 8)
    assert (out[-1] == "(--all prints the rest)") is told


def test_measures_of_a_length_begin_at_the_first_note(tonewood, tmp_path) -> None:
    """Six quarter notes in 3/4: two measures of three."""
    file, track = mido.MidiFile(ticks_per_beat=480), mido.MidiTrack()
    file.tracks.append(track)
    for pitch in (57, 59, 57, 60, 57, 62):
        track += [mido.Message("note_on", note=pitch, velocity=80), mido.Message("note_off", note=pitch, time=480)]
    file.save(tmp_path / "a.mid")
    code, out, err = tonewood("tab", tmp_path / "a.mid", "-i", "classical_guitar", "--meter", "3/4", "--json")
    assert code == 0, err
    assert [row["measure"] for row in json.loads(out)["notes"]] == [1, 1, 1, 2, 2, 2]


def test_a_sweep_prints_a_row_for_each_value(capsys, monkeypatch) -> None:
    facts = [
        SimpleNamespace(
            heading=h, strings=(), label=h, short=h, warnings=[], missing_tones={}, body_modes=[SimpleNamespace(freq=f)]
        )
        for h, f in (("A", 100.0), ("B", 120.0))
    ]
    result = SimpleNamespace(
        instruments=facts,
        sweep="body.h",
        wolves=[],
        parameters=[],
        swept=lambda: list(zip((1.0, 2.5), facts, strict=True)),
    )
    monkeypatch.setattr(summary, "key_figures", lambda one: {"mass": (0.5, "kg")} if one is facts[0] else {})
    monkeypatch.setattr(summary, "value_words", lambda value, unit: f"{value:g} {unit}")
    monkeypatch.setattr(summary, "lines", lambda of, i: ["first"])
    compare._print(result, False)
    assert capsys.readouterr().out.splitlines() == [
        "A, a body without strings",
        "B, a body without strings",
        "   body.h  mode 1    mass",
        "    1 (A)  100 Hz  0.5 kg",
        "  2.5 (B)  120 Hz       -",
        "parameters that differ: 0",
        "(--all prints the rest)",
    ]
    compare._print(result, True)
    assert "A to B: first" in capsys.readouterr().out
    one = SimpleNamespace(instruments=facts[:1], sweep="", wolves=[], parameters=[])
    compare._print(one, False)
    assert capsys.readouterr().out.splitlines() == ["A, a body without strings", "  mass: 0.5 kg"]


def test_a_stiffness_needs_an_outline(tonewood, tmp_path) -> None:
    size = ("--length", 0.5, "--width", 0.2, "--thickness", 0.003, "--mass", 0.12, "--stiffness", 60)
    assert "needs --outline LENGTH UPPER WAIST LOWER" in tonewood("wood", tmp_path / "p.csv", *size)[2]
    code, _, err = tonewood("wood", tmp_path / "p.csv", *size, "--outline", 0.48, 0.28, 0.24, 0.37)
    assert code == 2
    assert "p.csv: cannot be read" in err


@pytest.mark.parametrize(
    ("ended", "code", "line"), [(False, 143, "tonewood: terminated; nothing was written\n"), (True, 3, "")]
)
def test_a_signal_outside_of_a_command_ends_the_program(monkeypatch, ended, code, line) -> None:
    said, codes = [], []
    monkeypatch.setattr(stopping, "_write", lambda descriptor, text: said.append((descriptor, text)))
    monkeypatch.setattr(stopping.os, "_exit", codes.append)
    handling = stopping.SignalHandling()
    if ended:
        handling.command_begins()
        handling.command_ends(3)
    with pytest.raises(KeyboardInterrupt):  # as the exit is none here
        handling._take(signal.SIGTERM, None)
    assert codes == [code]
    assert said == ([(2, line)] if line else [])
