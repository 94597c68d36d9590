"""Commands that show an instrument: `list`, `check`, `modes`, `schema`."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import tonewood as tw
from cli_runs import refused

Run = Callable[..., tuple[int, str, str]]


def test_list_names_what_is_installed(tonewood: Run) -> None:
    code, out, _ = tonewood("list", "--json")
    assert code == 0
    found = json.loads(out)
    assert {"classical_guitar", "flamenco_guitar", "african_harp", "monochord"} <= {
        i["name"] for i in found["instruments"]
    }
    assert all((Path(i["folder"]) / "instrument.yaml").is_file() for i in found["instruments"])
    plugins = {p["name"]: p for p in found["plugins"]}
    assert plugins["stiff_string"]["kind"] == "resonator"
    assert plugins["stiff_string"]["package"] == "tonewood"
    assert all(p["summary"] for p in found["plugins"])
    text = tonewood("list")[1]
    assert all(name in text for name in plugins)


@pytest.mark.slow
def test_check_counts_the_modes_that_a_render_steps(tonewood: Run) -> None:
    """By default a render has the first output group; a page of the documentation names the count."""
    guitar = tw.load_instrument("classical_guitar")
    report = json.loads(tonewood("check", "classical_guitar", "--json")[1])
    for outputs, key in ((None, "n_modes"), (tuple(guitar.pickups), "n_modes_all_outputs")):
        model = tw.Renderer(tw.Score([tw.Note(0.0, 0.1, note=64)]), guitar, outputs=outputs).model
        assert report[key] == model.n_modes
    assert "  1566 modes (1618 with all outputs) at 48000 Hz" in tonewood("check", "classical_guitar")[1]
    page = (Path(__file__).parents[2] / "docs" / "cost.md").read_text(encoding="utf-8")
    assert "`classical_guitar` is 1566 modes" in page


@pytest.mark.slow
def test_check_tells_pitch_wolf_notes_stand_ins_and_sources(tonewood: Run) -> None:
    code, out, _ = tonewood("check", "classical_guitar", "--json")
    assert code == 0
    report = json.loads(out)
    assert report["ok"]
    assert report["body"]["passive"]
    assert report["sources"]["body"]["doi"] == "10.5281/zenodo.4604577"
    assert set(report["strings"]) == {"E2", "A2", "D3", "G3", "B3", "E4"}
    # every stop is within a cent of its note, or a strong mode of the body says why not
    assert {(p["string"], p["stop"]) for p in report["off_pitch"]} <= {
        (p["string"], p["stop"]) for p in report["wolf_notes"]
    }
    # the body's strongest resonance lies near 215 Hz: A3 is a wolf note wherever it is stopped on the lower strings
    assert {p["string"] for p in report["wolf_notes"] if p["note"] == "A3"} >= {"E2", "A2", "D3"}
    assert all(abs(w["wolf"]["cents"]) <= 60 or abs(w["error_cents"]) > 1 for w in report["wolf_notes"])
    text = tonewood("check", "african_harp")[1]
    assert "stand-in: body" in text
    assert text.endswith("ok\n")


@pytest.mark.slow
def test_modes_lists_partials_and_draws_the_mobility(tonewood: Run, tmp_path: Path) -> None:
    picture = tmp_path / "bridge.png"
    code, out, _ = tonewood(
        "modes", "classical_guitar", "--string", "E4", "--stop", 3, "--count", 5, "--plot", picture, "--json"
    )
    assert code == 0
    report = json.loads(out)
    rows = report["strings"]["E4"]["partials"]
    assert [r["number"] for r in rows] == [1, 2, 3, 4, 5]
    g4 = 440.0 * 2 ** (-2 / 12)
    assert rows[0]["freq"] == pytest.approx(g4, rel=1e-5)
    assert all(r["freq"] == pytest.approx(r["number"] * g4, rel=0.02) for r in rows)
    assert all(0 < r["t60"] < 20 for r in rows)
    air, top = report["strings"]["E4"]["bridge_mobility_peaks"][:2]
    assert 90 < air["freq"] < 115 < 190 < top["freq"] < 240
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert "partial" in tonewood("modes", "monochord")[1]


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--string", "H7"], ["H7", "E2"]),
        (["--stop", "20"], ["--stop", "19"]),
        (["--stop", "-1"], ["--stop"]),
        (["--count", "0"], ["--count"]),
        (["--string", "E2", "--plot", "nowhere/a.png"], ["nowhere/a.png"]),
    ],
)
def test_modes_refuses(tonewood: Run, arguments: list[str], said: list[str]) -> None:
    refused(tonewood("modes", "classical_guitar", *arguments), *said)


@pytest.mark.slow
def test_schema_is_one_json_schema_that_all_bundles_keep(tonewood: Run) -> None:
    from jsonschema import Draft202012Validator

    from tonewood.support.yaml_io import load_yaml

    code, out, _ = tonewood("schema")
    assert code == 0
    validator = Draft202012Validator(json.loads(out))
    Draft202012Validator.check_schema(validator.schema)
    for folder in tw.list_instruments().values():
        assert list(validator.iter_errors(load_yaml(folder / "instrument.yaml"))) == []
    wrong = load_yaml(tw.list_instruments()["monochord"] / "instrument.yaml")
    wrong["strings"]["A2"]["tensoin"] = 3.0
    assert not validator.is_valid(wrong)


@pytest.mark.slow
def test_check_shows_strings_alone_and_mounted(tonewood: Run) -> None:
    few = [("--set", f"strings.{name}.stops={count}") for name, count in {"E2": 5, "A2": 0, "D3": 0}.items()]
    few += [("--set", f"strings.{name}.stops=0") for name in ("G3", "B3", "E4")]
    code, out, _ = tonewood("check", "classical_guitar", "--fs", 16000, "--json", *(a for pair in few for a in pair))
    assert code == 0
    report = json.loads(out)
    (shared,) = [row for row in report["off_pitch_mounted"] if (row["string"], row["stop"]) == ("E2", 5)]
    assert shared["partner"] == "A2"
    assert abs(shared["cents_alone"]) < 0.01
    assert abs(shared["cents_mounted"]) > 2
    assert report["strings"]["E2"]["worst_cents_mounted"] != report["strings"]["E2"]["worst_cents"]
    heard = [(row["channel"], row["doubt"]) for row in report["microphones"]]
    assert heard == [(channel, None) for channel in ("bass", "treble", "left", "right")]
    text = tonewood("check", "classical_guitar", "--fs", 16000, "--all", *(a for pair in few for a in pair))[1]
    assert "with all strings on: E2 stop  5 (A2): " in text
    assert "shared with A2 (5" in text


@pytest.mark.slow
def test_check_and_modes_show_each_plane(tonewood: Run) -> None:
    """Sorted, the worst first; near the mode at 215 Hz the second plane rings on 8 cents or more beside the note."""
    rows = json.loads(tonewood("check", "classical_guitar", "--json")[1])["off_planes"]
    off = [row["off_cents"] for row in rows]
    assert off == sorted(off, reverse=True)
    assert min(off) > 5.0
    by_stop = {(row["string"], row["stop"]): row for row in rows}
    g_sharp = by_stop["D3", 6]
    assert g_sharp["note"] == "G#3"
    assert abs(g_sharp["planes"]["D3.z"]["cents"]) < 0.1
    assert 8.0 < g_sharp["planes"]["D3.y"]["cents"] < 20.0
    lines = [line for line in tonewood("check", "classical_guitar", "--all")[1].splitlines() if "second plane" in line]
    assert len(lines) == 13
    assert lines[0].startswith(f"  second plane: {rows[0]['string']} stop {rows[0]['stop']}")
    assert f"{len(rows) - 12} more" in lines[-1]
    shown = tonewood("modes", "classical_guitar", "--string", "D3", "--stop", "6", "--count", "1")[1]
    assert f"y {g_sharp['planes']['D3.y']['cents']:+.1f} (split" in shown
    assert "second plane" not in tonewood("check", "electric_bass")[1]


def test_check_names_a_string_that_misses_its_loss_law(tonewood: Run) -> None:
    bending_alone = "strings.A2.loss={law: woodhouse, eta_f: 0.0, eta_a: 0.0, eta_b: 0.02}"
    steep = tonewood("check", "monochord", "--set", bending_alone, "--set", "strings.A2.bending_stiffness=5e-5")
    assert "partial 1 at stop 0 decays at 1." in steep[1]
    assert "the law grows too steeply" in steep[1]
    assert "decays at" not in tonewood("check", "monochord")[1]


def test_check_warns_of_a_string_that_moves_no_body(tonewood: Run) -> None:
    """Its bridge moves in z alone: a string that vibrates in y is silent."""
    aside = ("monochord", "--set", "strings.A2.polarizations=[y]", "--set", "stops.count=0")
    code, out, _ = tonewood("check", *aside)
    assert code == 0
    assert "  warning: strings.A2: shares no direction with the body's points it ends on" in out
    assert "  warning: output bridge is silent whatever is played" in out
    assert out.splitlines()[-1] == "ok, with 2 warnings"
    assert len(json.loads(tonewood("check", *aside, "--json")[1])["model"]) == 1


@pytest.mark.parametrize(
    ("column", "factor", "said"),
    [
        (0, 1e-3, "body: no mode above 20 Hz: check the unit of its frequencies"),  # kHz
        (1, 1e-3, "body: 3 modes do not oscillate: check their Q, or zeta"),  # zeta in the place of Q
        (3, 0.0, "output bridge is silent whatever is played"),
        (0, 1.0, ""),
    ],
)
def test_check_doubts_a_body_that_nobody_can_hear(
    tonewood: Run, tmp_path: Path, column: int, factor: float, said: str
) -> None:
    folder = tmp_path / "mine"
    shutil.copytree(tw.load_instrument("monochord").folder, folder)
    table = folder / "body.csv"
    *notes, numbers = table.read_text().partition("f_Hz,Q,modal_mass,bridge\n")
    rows = [[float(x) for x in row.split(",")] for row in numbers.splitlines()]
    lines = [",".join(str(x * factor if i == column else x) for i, x in enumerate(row)) for row in rows]
    table.write_text("".join(notes) + "\n".join(lines))
    code, out, _ = tonewood("check", folder, "--set", "stops.count=0")
    assert code == 0
    warnings = [line for line in out.splitlines() if line.startswith("  warning: ")]
    assert len(warnings) == bool(said)
    assert said in out


@pytest.mark.slow
def test_check_warns_of_a_table_that_is_another(tonewood: Run, tmp_path: Path) -> None:
    folder = tmp_path / "mine"
    shutil.copytree(tw.load_instrument("african_harp").folder, folder)
    (folder / "body.csv").write_text((folder / "body.csv").read_text() + "# mine\n")
    code, out, _ = tonewood("check", folder)
    assert code == 0
    assert "  warning: body: body.csv is not the table that its provenance calls stand_in" in out
    assert len(json.loads(tonewood("check", folder, "--json")[1])["table_doubts"]) == 1


def test_check_warns_of_microphones_that_hear_nothing(tonewood: Run, tmp_path: Path) -> None:
    """A table in MHz has no mode below the highest that is stepped."""
    folder = tmp_path / "mine"
    shutil.copytree(tw.load_instrument("classical_guitar").folder, folder)
    table = folder / "radiation.csv"
    lines = table.read_text().splitlines()
    numbers = 1 + next(i for i, line in enumerate(lines) if line.startswith("f_Hz"))
    rows = [line.split(",") for line in lines[numbers:]]
    table.write_text("\n".join([*lines[:numbers], *(",".join([f"{float(f) * 1e6}", *rest]) for f, *rest in rows)]))
    few = [word for name in ("E2", "A2", "D3", "G3", "B3", "E4") for word in ("--set", f"strings.{name}.stops=0")]
    code, out, _ = tonewood("check", folder, "--fs", 16000, *few)
    assert code == 0
    assert "warning: microphones.bass hears nothing of the strings" in out


@pytest.mark.slow
def test_modes_of_a_drawn_body_are_listed_and_drawn(tonewood: Run, tmp_path: Path) -> None:
    picture, coarse = tmp_path / "modes.png", ("--set", "body.fmax=1500", "--set", "body.cell=0.015")
    code, text, _ = tonewood("modes", "drawn_guitar", "--string", "E4", "--count", 1, "--plot", picture, *coarse)
    assert code == 0
    assert "A0 10" in text
    assert "hinged" in text
    assert "(T1, Q" in text
    assert picture.stat().st_size > 50_000


@pytest.mark.slow
def test_check_and_modes_name_a_bridge_that_the_pitch_leaves_out(tonewood: Run) -> None:
    """Bridge and thread cut off 6 to 11 of 1000 mm, so the sound is 10 to 19 cents above the pitch without them."""
    sound = tw.render(
        tw.Score([tw.Note(0.0, 2.0, note="C3")]), "tanpura", outputs=("bridge",), max_duration=1.0, effects="all"
    ).samples[:, 0]
    spectrum = np.abs(np.fft.rfft(sound * np.hanning(len(sound)), 1 << 20))
    freq = np.fft.rfftfreq(1 << 20, 1 / 48000)
    near = (freq > 255.0) & (freq < 270.0)
    cents = 1200 * np.log2(freq[near][np.argmax(spectrum[near])] / 261.79)  # of the second partial on the body alone
    assert 10.0 < cents < 19.0
    line = "left out: bridge, which touches C3 at rest: pitch and decay of the sound differ from those stated here"
    for command in ("check", "modes"):
        assert line in tonewood(command, "tanpura")[1]
        assert json.loads(tonewood(command, "tanpura", "--json")[1])["touched_at_rest"] == {"bridge": ["C3"]}
    assert "left out" not in tonewood("modes", "monochord")[1]
