"""Conventions of all commands: help, completion, hints at names, lines of YAML files, one shape of JSON."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

import tonewood as tw
from midi_bytes import note, write
from tonewood.cli.commands import COMMANDS

Run = Callable[..., tuple[int, str, str]]


@pytest.fixture
def bundle(tmp_path: Path) -> Path:
    """A copy of the monochord."""
    original = tw.list_instruments()["monochord"]
    (tmp_path / "m").mkdir()
    for name in ("instrument.yaml", "body.csv"):
        (tmp_path / "m" / name).write_text((original / name).read_text())
    return tmp_path / "m"


@pytest.mark.parametrize("command", [[], *([name] for name in COMMANDS)], ids=lambda words: " ".join(words))
@pytest.mark.parametrize("option", ["-h", "--help"])
def test_help_of_every_command(tonewood: Run, command: list[str], option: str) -> None:
    code, out, err = tonewood(*command, option)
    assert (code, err) == (0, "")
    assert "Usage: tonewood" in out
    assert "-h" in out


@pytest.mark.slow
@pytest.mark.parametrize(
    ("words", "offered"),
    [("tonewood rend", {"render"}), ("tonewood check mono", {"monochord"}),
     ("tonewood plan s.mid --max", {"--max-duration"}), ("tonewood render s.mid -i classical", {"classical_guitar"})],
)  # fmt: skip
def test_completion(words: str, offered: set[str]) -> None:
    request = {"_TONEWOOD_COMPLETE": "complete_bash", "COMP_WORDS": words, "COMP_CWORD": str(words.count(" "))}
    done = subprocess.run(
        [sys.executable, "-c", "import sys; from tonewood.cli.main import run; sys.argv = ['tonewood']; run()"],
        env=os.environ | request, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert (done.returncode, set(done.stdout.split())) == (0, offered), done.stderr


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["rendr"], "Did you mean 'render'? See: tonewood -h"),
        (["check", "monochrd"], "did you mean monochord? installed: "),
        (["check"], "Missing argument 'INSTRUMENT'. See: tonewood check -h"),
        (["check", "monochord", "--sett", "a=1"], "No such option: --sett. Did you mean --set? See: tonewood check -h"),
        (["check", "monochord", "--set", "string.A2.tension=3"], "there is no 'string'; did you mean strings?"),
        (["check", "monochord", "--set", "strings.A2.tensoin=3"], "did you mean tension?"),
        (
            ["check", "monochord", "--set", "body.plugin=modal_tabel"],
            "'modal_tabel' of kind body; did you mean modal_table?",
        ),
        (["check", "monochord", "--set", "strings.A2.end=body.brige"], "'body.brige'; did you mean body.bridge?"),
        (["check", "monochord", "--set", "playing.exciter=plukc"], "no exciter 'plukc'; did you mean pluck?"),
        (["modes", "classical_guitar", "--string", "e2"], "no string 'e2'; did you mean E2?"),
        (["check", "classical_guitar", "--set", "effects.mode=[seond_polarization]"], "mean second_polarization?"),
        (
            ["check", "monochord", "--set", "strings.A2.length=650"],
            "at most 5 m: did you mean 650 mm (0.65)?",
        ),
    ],
)
def test_names_that_resemble_others(tonewood: Run, arguments: list[str], said: str) -> None:
    code, out, err = tonewood(*arguments)
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert said in err


def test_a_misspelt_key_comes_before_the_missing_one_with_its_line(tonewood: Run, bundle: Path) -> None:
    manifest = bundle / "instrument.yaml"
    lines = manifest.read_text().splitlines()
    at = next(i for i, line in enumerate(lines) if "tension: 58.8" in line)
    lines[at] = lines[at].replace("tension", "tensoin")
    manifest.write_text("\n".join(lines))
    code, _, err = tonewood("check", bundle)
    place = f"tonewood: {manifest}: line {at + 1}: strings.A2.tensoin: "
    assert (code, err.partition("allowed")[0]) == (2, f"{place}is not a known key; did you mean tension? ")
    # found only when the instrument is assembled
    lines[at] = lines[at].replace("tensoin: 58.8", "tension: 1")
    manifest.write_text("\n".join(lines))
    note_at = next(i for i, line in enumerate(lines) if "note: A2" in line)
    assert tonewood("check", bundle)[2].startswith(f"tonewood: {manifest}: line {note_at + 1}: strings.A2.note: ")
    # the value is not the file's
    assert tonewood("check", bundle, "--set", "strings.A2.tension=9e9")[2].startswith(
        f"tonewood: {manifest}: strings.A2"
    )


def test_reports_begin_alike(tonewood: Run, bundle: Path, tmp_path: Path) -> None:
    score, wav = write(tmp_path / "s.mid", note(0.0, 0.1, 45)), tmp_path / "s.wav"
    short = ("--max-duration", 0.05, "--fs", 16000, "--gain", -3)
    calls = {
        "list": ["list"],
        "check": ["check", "monochord", "--fs", 16000],
        "modes": ["modes", "monochord", "--fs", 16000, "--count", 1],
        "plan": ["plan", score, "-i", "monochord", "-o", wav, "--subtype", "PCM_16", *short],
        "render": ["render", score, "-i", "monochord", "-o", wav, "--subtype", "PCM_16", *short],
        "migrate": ["migrate", "--check", bundle],
    }
    for command, arguments in calls.items():
        code, out, err = tonewood(*arguments, "--json")
        assert (code, err, out.count("\n")) == (0, "", 1), command
        found = json.loads(out, parse_constant=pytest.fail)
        assert list(found)[:2] == ["schema", "ok"]
        assert (found["schema"], found["ok"]) == (f"tonewood-{command}/1", True)


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["check"], {"kind": "UsageError", "file": None, "line": None, "key": None, "exit_code": 2}),
        (["check", "no_such"], {"kind": "BundleError", "file": None, "line": None, "key": None, "exit_code": 2}),
        (["modes", "monochord", "--count", "0"], {"kind": "TonewoodError", "key": "--count", "exit_code": 2}),
    ],
)
def test_errors_are_objects_too(tonewood: Run, arguments: list[str], expected: dict[str, object]) -> None:
    code, out, err = tonewood(*arguments, "--json")
    found = json.loads(out)
    assert (list(found), found["schema"], found["ok"]) == (["schema", "ok", "error"], "tonewood-error/1", False)
    assert expected.items() <= found["error"].items()
    assert (code, err.count("\n")) == (2, 1)
    assert found["error"]["reason"] in err


def test_a_plan_refuses_a_file_that_a_render_would_refuse(tonewood: Run, tmp_path: Path) -> None:
    score = write(tmp_path / "s.mid", note(0.0, 0.1, 45))
    for name in ("a.txt", "no/a.wav"):
        code, out, err = tonewood("plan", score, "-i", "monochord", "-o", tmp_path / name)
        assert (code, out, err.count("\n")) == (2, "", 1)
        assert err == tonewood("render", score, "-i", "monochord", "-o", tmp_path / name)[2]
