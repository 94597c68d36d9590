"""``tonewood accuracy``: its output and files, its refusals, and the files left when it is stopped."""

from __future__ import annotations

import json
import os
import pty
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from pydantic import ValidationError

from midi_bytes import note, write
from tonewood.cli.main import run
from tonewood.workshop.batch.manifest import RenderSettings


def call(*arguments: object) -> object:
    with pytest.raises(SystemExit) as exit_:
        run(["accuracy", *map(str, arguments)])
    return exit_.value.code


@pytest.mark.slow
def test_one_small_system_in_every_form(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("matplotlib")
    assert call("--system", "klosner_d", "--quick") == 0
    out, err = capsys.readouterr()
    assert err == ""
    assert "problem D" in out
    assert "velocity Verlet" in out
    files = {name: tmp_path / name for name in ("a.png", "a.html")}
    assert (
        call("--system", "klosner_d", "--quick", "--json", "--plot", files["a.png"], "--report", files["a.html"]) == 0
    )
    assert sorted(tmp_path.iterdir()) == sorted(files.values())
    assert files["a.png"].read_bytes().startswith(b"\x89PNG")
    assert files["a.html"].read_text().startswith("<!DOCTYPE html>")
    found = json.loads(capsys.readouterr().out, parse_constant=pytest.fail)
    assert (found["schema"], found["ok"], found["quick"]) == ("tonewood-accuracy/1", True, True)
    assert {"processor", "system", "instruction_set", "fma_peak"} == set(found["machine"])
    (system,) = found["systems"]
    assert system["name"] == "klosner_d"
    assert "DOP853" in system["reference"]
    points = {(p["method"], p["fs"]): p for p in system["points"]}
    ours = [points["tonewood", fs] for fs in (500.0, 1000.0, 2000.0)]
    # of order 2
    assert ours[0]["waveform"] / ours[2]["waveform"] == pytest.approx(16, rel=0.2)
    assert all(p["seconds_low"] <= p["seconds"] <= p["seconds_high"] for p in ours)
    assert points["verlet", 500.0]["stable"] == "NaN"
    assert points["verlet", 500.0]["waveform"] is None
    (headline,) = system["headline"]
    assert (headline["method"], headline["measure"]) == ("verlet", "waveform")


@pytest.mark.slow
def test_a_page_in_markdown_names_the_picture(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    (tmp_path / "pictures").mkdir()
    plot = tmp_path / "pictures" / "a.png"
    assert call("--system", "klosner_d", "--quick", "--plot", plot, "--report", tmp_path / "a.md") == 0
    assert "](pictures/a.png)" in (tmp_path / "a.md").read_text()
    assert "(`klosner_d`)" in (tmp_path / "a-tables.md").read_text()


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--system", "violin"], "--system: is 'violin'; there are fabre_guitar"),
        (["--plot", "a.svg"], "--plot: is 'a.svg'; a name ending in .png is allowed"),
        (["--report", "a.txt"], "--report: is 'a.txt'; a name ending in .html or .md is allowed"),
        (["--report", "nowhere/a.md"], "there is no folder 'nowhere'"),
        (["--sytem", "harp"], "--sytem"),
    ],
)
def test_refusals_are_one_line_and_code_2(
    options: list[str], said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert call(*options) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("tonewood: ")
    assert err.count("\n") == 1
    assert said in err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_ctrl_c_leaves_nothing(tmp_path: Path) -> None:
    reader, writer = pty.openpty()  # a terminal, so that there is a bar to wait for
    process = subprocess.Popen(
        [sys.executable, "-m", "tonewood", "accuracy", "--report", tmp_path / "a.md"],
        stdout=subprocess.PIPE, stderr=writer,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # a shell's background jobs ignore it
    )  # fmt: skip
    os.close(writer)
    seen = b""
    while b"comparing" not in seen:
        seen += os.read(reader, 4096)
    process.send_signal(signal.SIGINT)
    out, _ = process.communicate(timeout=600)
    while b"nothing was written" not in seen:
        seen += os.read(reader, 4096)
    os.close(reader)
    assert process.returncode == 130
    assert out == b""
    assert list(tmp_path.iterdir()) == []


def test_render_takes_a_setting_by_name(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    score = write(tmp_path / "score.mid", note(0.0, 0.1, 45))
    modes = {}
    for name in ("draft", "standard"):
        options = ("-i", "monochord", "-o", tmp_path / "out.wav", "--max-duration", "0.1", "--json", "--accuracy", name)
        with pytest.raises(SystemExit) as exit_:
            run(["render", str(score), *map(str, options)])
        assert exit_.value.code == 0
        modes[name] = json.loads(capsys.readouterr().out)["n_modes"]
    assert modes["draft"] < modes["standard"]
    with pytest.raises(SystemExit) as exit_:
        run(["render", str(score), "-i", "monochord", "-o", str(tmp_path / "b.wav"), "--accuracy", "best"])
    assert exit_.value.code == 2
    assert capsys.readouterr().err == "tonewood: --accuracy: is 'best'; draft, standard, reference are allowed\n"


def test_batches_take_a_setting_by_name() -> None:
    assert RenderSettings().accuracy == "standard"
    with pytest.raises(ValidationError, match="draft"):
        RenderSettings.model_validate({"accuracy": "best"})
