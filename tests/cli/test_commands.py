"""The command line in this process: its output, on which stream, and its exit codes."""

from __future__ import annotations

import contextlib
import json
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import soundfile as sf

import tonewood as tw
from cli_runs import refused
from midi_bytes import control, midi_file, note, write

Run = Callable[..., tuple[int, str, str]]


@pytest.fixture
def score(tmp_path: Path) -> Path:
    return write(tmp_path / "score.mid", [*note(0.0, 0.2, 45), *note(0.1, 0.2, 50), *note(0.2, 0.1, 20)])


def test_render_writes_the_samples_of_the_renderer(tonewood: Run, score: Path, tmp_path: Path) -> None:
    wav = tmp_path / "out.wav"
    code, out, _ = tonewood(
        "render", score, "-i", "monochord", "-o", wav, "--subtype", "DOUBLE", "--max-duration", 0.3, "--gain", -6
    )
    assert code == 0
    assert str(wav) in out
    samples, fs = sf.read(str(wav), always_2d=True)
    audio = tw.render(tw.read_midi(score), tw.load_instrument("monochord"), max_duration=0.3, gain_db=-6.0)
    assert fs == 48000
    assert np.array_equal(samples, audio.samples)


def test_json_is_one_object_and_nothing_else(tonewood: Run, score: Path, tmp_path: Path) -> None:
    wav = tmp_path / "out.wav"
    code, out, err = tonewood(
        "render", score, "-i", "monochord", "-o", wav, "--max-duration", 0.4, "--fs", 32000, "--json"
    )
    assert code == 0
    assert err == ""
    report = json.loads(out)
    assert report["schema"] == "tonewood-render/1"
    assert report["output"] == str(wav)
    assert report["outputs"] == ["bridge"]
    assert (report["fs"], report["frames"], report["channels"]) == (32000, 12800, 1)
    assert sf.info(str(wav)).frames == 12800
    assert report["duration_s"] == pytest.approx(0.4)
    assert report["load_s"] > 0
    assert report["render_s"] > 0
    assert report["realtime_factor"] == pytest.approx(0.4 / report["render_s"])
    assert isinstance(report["n_modes"], int)
    assert report["notes"] == 2
    assert isinstance(report["notes"], int)
    (dropped,) = report["notes_dropped"]
    assert dropped["note"] == 20
    assert dropped["channel"] == 0
    assert dropped["time_s"] == pytest.approx(0.2)
    assert dropped["reason"]
    peak = np.abs(sf.read(str(wav))[0]).max()
    assert report["peak_dbfs"] == pytest.approx(20 * np.log10(peak), abs=1e-3)
    assert report["clipped"] == 0
    assert isinstance(report["warnings"], list)


def test_dropped_notes_are_listed_on_stderr(tonewood: Run, score: Path, tmp_path: Path) -> None:
    _, out, err = tonewood("render", score, "-i", "monochord", "-o", tmp_path / "a.wav", "--max-duration", 0.3)
    assert "1 dropped" in out
    assert "not played at 0.20 s" in err


def test_normalize_limiter_and_clipping(tonewood: Run, score: Path, tmp_path: Path) -> None:
    def report(name: str, *more: object) -> dict[str, Any]:
        common = ("render", score, "-i", "monochord", "-o", tmp_path / name, "--max-duration", 0.3, "--json")
        found: dict[str, Any] = json.loads(tonewood(*common, *more)[1])
        return found

    plain = report("plain.wav", "--subtype", "DOUBLE", "--level", "calibrated")
    normal = report("normal.wav", "--subtype", "DOUBLE", "--normalize", -3)
    assert normal["peak_dbfs"] == pytest.approx(-3.0, abs=1e-9)
    a, b = (sf.read(str(tmp_path / f"{n}.wav"))[0] for n in ("plain", "normal"))
    assert np.allclose(b, a * (10 ** (-3 / 20) / np.abs(a).max()), rtol=1e-12, atol=0)
    assert not list(tmp_path.glob(".*"))
    loud = report("loud.wav", "--gain", 60)
    assert loud["clipped"] == int(np.count_nonzero(np.abs(a) * 1000 > 1.0))
    assert any("clipped" in w for w in loud["warnings"])
    limited = report("limited.wav", "--gain", 60, "--limiter")
    assert limited["clipped"] == 0
    assert limited["peak_dbfs"] < -0.09
    assert any("limiter" in w for w in limited["warnings"])
    assert plain["frames"] == limited["frames"]


def test_levels_differ_by_the_gain_that_is_reported(tonewood: Run, score: Path, tmp_path: Path) -> None:
    meter = pytest.importorskip("pyloudnorm")
    sounds, reports = {}, {}
    for level in ("calibrated", "peak", "LUFS"):
        wav = tmp_path / f"{level}.wav"
        common = ("render", score, "-i", "monochord", "-o", wav, "--max-duration", 1.5, "--subtype", "DOUBLE")
        reports[level] = json.loads(tonewood(*common, "--level", level, "--json")[1])
        sounds[level] = sf.read(str(wav))[0]
        assert reports[level]["level"] == level
        factor = 10 ** (reports[level]["gain_db"] / 20)
        assert np.allclose(sounds[level], factor * sounds["calibrated"], rtol=1e-12, atol=0)
    assert reports["calibrated"]["gain_db"] == 0.0
    assert reports["peak"]["peak_dbfs"] == pytest.approx(-1.0)
    loudness = meter.Meter(48000).integrated_loudness(sounds["LUFS"])
    assert loudness == pytest.approx(-23.0, abs=0.1) or reports["LUFS"]["peak_dbfs"] == pytest.approx(-1.0)
    out = tonewood("render", score, "-i", "monochord", "-o", tmp_path / "a.wav", "--max-duration", 0.2)[1]
    assert "level peak: gain" in out
    assert "0 dBFS is" in out
    refused(
        tonewood("render", score, "-i", "monochord", "-o", tmp_path / "a.wav", "--level", "loud"), "--level", "LUFS"
    )
    refused(tonewood("play", score, "-i", "monochord", "--level", "LUFS"), "--level", "peak")


def test_settings_and_outputs_reach_the_instrument(tonewood: Run, score: Path, tmp_path: Path) -> None:
    common = ("-i", "classical_guitar", "--max-duration", 0.05, "--fs", 16000, "--json")
    code, out, _ = tonewood(
        "render", score, *common, "-o", tmp_path / "a.wav",
        "--outputs", "bridge,microphones", "--set", "strings.E2.note=D2", "--set", "strings.*.loss.eta_a={scale: 2}",
    )  # fmt: skip
    assert code == 0
    report = json.loads(out)
    assert report["outputs"] == ["bridge", "microphones"]
    assert report["channel_names"] == ["bridge.acceleration", "microphones.bass", "microphones.treble"]
    assert sf.info(str(tmp_path / "a.wav")).channels == 3


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--fs", "0"], ["fs", "8000"]),
        (["--fs", "fast"], ["--fs", "integer"]),
        (["--block", "0"], ["--block"]),
        (["--subtype", "PCM_12"], ["PCM_12", "PCM_24"]),
        (["--tail", "-1"], ["--tail"]),
        (["--tail", "nan"], ["--tail"]),
        (["--max-duration", "0"], ["--max-duration"]),
        (["--max-duration", "inf"], ["--max-duration"]),
        (["--gain", "nan"], ["--gain"]),
        (["--normalize", "3"], ["--normalize"]),
        (["--normalize", "-1", "--limiter"], ["--limiter"]),
        (["--normalize", "-3", "--level", "LUFS"], ["--normalize", "LUFS"]),
        (["--outputs", "ceiling"], ["ceiling", "bridge"]),
        (["--set", "strings.A2.tension"], ["PATH=VALUE"]),
        (["--set", "strings.A2.tensoin=3"], ["strings.A2.tensoin", "instrument.yaml", "tension"]),
        (["--set", "strings.A2.tension=fast"], ["strings.A2.tension", "number"]),
        (["--set", "strings.A2.tension=-4"], ["strings.A2.tension"]),
        (["--set", "body.table=other.csv"], ["other.csv"]),
        (["--loud"], ["--loud"]),
        (["again.mid"], ["again.mid"]),
    ],
)
def test_bad_options_are_refused_in_one_line(
    tonewood: Run, score: Path, tmp_path: Path, arguments: list[str], said: list[str]
) -> None:
    wav = tmp_path / "out.wav"
    refused(tonewood("render", score, "-i", "monochord", "-o", wav, *arguments), *said)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["score.mid"]


def test_bad_files_are_refused_in_one_line(tonewood: Run, score: Path, tmp_path: Path) -> None:
    wav = tmp_path / "out.wav"
    refused(tonewood("render", tmp_path / "no.mid", "-i", "monochord", "-o", wav), "no.mid")
    refused(tonewood("render", score, "-i", "no_such", "-o", wav), "no_such", "monochord")
    refused(tonewood("render", score, "-i", tmp_path, "-o", wav), "instrument.yaml")
    refused(tonewood("render", score, "-i", "monochord", "-o", tmp_path / "x.m4a"), "x.m4a", ".wav")
    refused(tonewood("render", score, "-i", "monochord", "-o", tmp_path / "no" / "x.wav"), "no folder")
    refused(tonewood("render", score, "-i", "monochord"), "--output")
    text = tmp_path / "text.mid"
    text.write_text("this is no music")
    refused(tonewood("render", text, "-i", "monochord", "-o", wav), "text.mid")
    cut = tmp_path / "cut.mid"
    cut.write_bytes(midi_file(note(0.0, 0.1, 45))[:19])
    refused(tonewood("render", cut, "-i", "monochord", "-o", wav), "cut.mid")
    assert not list(tmp_path.glob("*.wav*"))


def test_a_score_without_notes_is_refused(tonewood: Run, tmp_path: Path) -> None:
    empty = write(tmp_path / "empty.mid", [])
    refused(tonewood("render", empty, "-i", "monochord", "-o", tmp_path / "a.wav"), "no notes")
    assert not (tmp_path / "a.wav").exists()


def test_a_bundle_with_a_fault_names_file_and_key(tonewood: Run, score: Path, tmp_path: Path) -> None:
    folder = tmp_path / "mine"
    folder.mkdir()
    original = tw.load_instrument("monochord").folder
    for name in ("instrument.yaml", "body.csv"):
        (folder / name).write_text((original / name).read_text())
    manifest = folder / "instrument.yaml"
    manifest.write_text(manifest.read_text().replace("tension: 58.8", "tension: 58.8 N"))
    refused(
        tonewood("render", score, "-i", folder, "-o", tmp_path / "a.wav"), str(manifest), "strings.A2.tension", "58.8 N"
    )
    refused(tonewood("check", folder), str(manifest), "strings.A2.tension")


def test_unknown_commands_and_nothing_at_all(tonewood: Run) -> None:
    refused(tonewood("rendre"), "rendre")
    refused(tonewood("check"), "INSTRUMENT")
    code, out, _ = tonewood()
    assert code == 0
    for command in ("render", "play", "list", "check", "modes", "schema", "batch", "results"):
        assert command in out
    assert tonewood("--version")[1] == f"tonewood {tw.__version__}\n"


@pytest.mark.slow
def test_plan_names_what_matters_and_verbose_the_rest(tonewood: Run, score: Path) -> None:
    plan = ("plan", score, "-i", "sitar", "--fs", 16000, "--max-duration", 0.5)
    brief, whole = (tonewood(*plan, *more)[1].splitlines()[1:] for more in ((), ("--verbose",)))
    assert any(line.startswith("  outputs microphones: 0.50 s [0.00-0.50]") for line in whole)
    assert not any("outputs" in line for line in brief)
    (rest,) = re.findall(r"^  (\d+) more always run or never act: --verbose$", brief[-1])
    names = [line.split()[0] for line in brief[:-1]]
    assert len(set(names)) == len(names)
    assert int(rest) == sum(line.split()[0] not in names for line in whole)


@pytest.mark.parametrize(
    ("strings", "said"),
    [
        (["E4"], "  Left out: rising tension of E4 for 8 s, at most 0.3 cent. Saved 0.8 s of 2.8 s."),
        (
            ["D3", "E4"],
            "  Left out: rising tension of D3 for 8 s and E4 for 7 s, at most 0.3 cent. Saved 1.6 s of 3.6 s.",
        ),
        (
            ["D3", "G3", "E4"],
            "  Left out: rising tension of 3 strings for 6 to 8 s, at most 0.3 cent. Saved 2.4 s of 4.4 s.",
        ),
    ],
)
def test_what_was_left_out_and_what_it_saved(strings: list[str], said: str) -> None:
    from tonewood.cli.render_report import left_out_lines as _left_out
    from tonewood.performance.effects.base import EffectReport
    from tonewood.sound.render.renderer import Summary

    reports = [
        EffectReport("tension_modulation", name, 2.0 + i, 0.8, 0.3, "cents", title="rising tension")
        for i, name in enumerate(strings)
    ]
    summary = Summary(480000, 48000, 10.0, 2.0, 5.0, 9, 1, (), -3.0, "decayed", (), effects=reports)
    assert _left_out(summary) == [said]
    assert _left_out(replace(summary, effects=[replace(reports[0], seconds_saved=0.0)]))[0].endswith("0.3 cent.")


def test_plan_and_play_have_the_options_of_render(tonewood: Run, score: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    plan = ("plan", score, "-i", "classical_guitar", "--fs", 16000, "--json")
    found = json.loads(tonewood(*plan, "--max-duration", 0.1, "--lead-in", 0.05, "--outputs", "microphones")[1])
    assert found["duration_s"] == pytest.approx(0.15)
    assert [e["component"] for e in found["effects"] if e["name"] == "outputs" and e["spans_s"]] == ["microphones"]
    said = "--accuracy: is 'best'; draft, standard, reference are allowed"
    refused(tonewood(*plan[:-1], "--accuracy", "best"), said)
    refused(tonewood("play", score, "-i", "monochord", "--tail-level", 3), "--tail-level: is 3 dB; -300 to -1")

    class Stream:
        def __init__(self, **options: Any):
            self.options = options

        def __enter__(self) -> None:
            with contextlib.suppress(StopIteration):
                while True:
                    self.options["callback"](np.zeros((self.options["blocksize"], 2)), None, None, None)
            self.options["finished_callback"]()

        def __exit__(self, *error: object) -> None:
            pass

    monkeypatch.setattr("tonewood.sound.live.stream._output_stream", lambda: Stream)
    monkeypatch.setattr("tonewood.sound.live.stream._stop", StopIteration)
    play = ("play", score, "-i", "monochord", "--fs", 16000, "--max-duration", 0.2, "--lead-in", 0.1)
    code, out, _ = tonewood(*play)
    assert code == 0
    assert out.startswith("played 0.30 s")
    found = json.loads(tonewood(*play, "--json")[1])
    assert (found["schema"], found["ok"], found["duration_s"], found["clipped"]) == ("tonewood-play/1", True, 0.3, 0)


def test_play_without_a_sound_card_is_one_line(tonewood: Run, score: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import sys

    monkeypatch.setitem(sys.modules, "sounddevice", None)
    refused(tonewood("play", score, "-i", "monochord"), "sounddevice")


def test_a_score_of_which_nothing_can_be_played_ends_with_1(tonewood: Run, tmp_path: Path) -> None:
    low = write(tmp_path / "low.mid", [*note(0.0, 0.2, 20), *note(0.3, 0.2, 21)])
    for more in ((), ("--json",)):
        code, out, err = tonewood("render", low, "-i", "monochord", "-o", tmp_path / "a.wav", *more)
        assert (code, err.count("\n")) == (1, 1)
        assert (json.loads(out)["error"]["exit_code"] if more else out) == (1 if more else "")
        assert "none of 2 notes can be played: no string plays" in err
    assert not (tmp_path / "a.wav").exists()
    assert tonewood("plan", low, "-i", "monochord")[0] == 1


def test_plan_lists_dropped_notes(tonewood: Run, score: Path) -> None:
    code, _, err = tonewood("plan", score, "-i", "monochord", "--max-duration", 0.3, "--fs", 16000)
    assert code == 0
    assert err.count("not played at 0.20 s") == 1


def test_lead_in_and_step_are_stated(tonewood: Run, score: Path, tmp_path: Path) -> None:
    common = ("render", score, "-i", "monochord", "-o", tmp_path / "a.wav", "--max-duration", 0.1)
    plain = json.loads(tonewood(*common, "--json")[1])
    assert (plain["zero_frame"], plain["frames"]) == (0, 4800)
    assert plain["onset_step_dbfs"] > -100
    assert "at the first frame was smoothed" in tonewood(*common)[1]
    whole = json.loads(tonewood(*common, "--json", "--lead-in", "auto")[1])
    assert whole["zero_frame"] == 960  # the ramp's 20 ms
    assert whole["frames"] == 960 + 4800
    assert whole["onset_step_dbfs"] is None
    assert "score time 0 is frame 2400" in tonewood(*common, "--lead-in", 0.05)[1]
    refused(tonewood(*common, "--lead-in", "soon"), "--lead-in", "auto or 0 to 60 s are allowed")
    refused(tonewood(*common, "--lead-in", -1), "--lead-in", "0 to 60 s")


@pytest.mark.slow
def test_a_tension_put_back_by_the_tuner_is_reported(tonewood: Run, score: Path, tmp_path: Path) -> None:
    common = ("render", score, "-i", "monochord", "-o", tmp_path / "a.wav", "--max-duration", 0.02)
    heavy = ("--set", "strings.A2.tension=80")
    assert json.loads(tonewood(*common, "--json")[1])["tensions"] == []
    (reported,) = json.loads(tonewood(*common, *heavy, "--json")[1])["tensions"]
    assert (reported["string"], reported["given"], reported["held"]) == ("A2", 80.0, "pitch")
    assert reported["cents"] == pytest.approx(600 * np.log2(80.0 / reported["used"]))
    assert "tuned to its note at 58.83 N; the 80 N given would sound +266 cents" in tonewood(*common, *heavy)[1]
    held = ("--set", "tuning.hold=tension")
    (reported,) = json.loads(tonewood(*common, *heavy, *held, "--json")[1])["tensions"]
    assert (reported["used"], reported["held"]) == (80.0, "tension")
    text = tonewood("check", "monochord", *heavy, *held)[1]
    assert "its tension of 80 N is held; it sounds +26" in text
    assert "the 80 N given would sound" in tonewood("check", "monochord", *heavy)[1]


def test_a_room_adds_its_tail_and_says_that_it_is_not_measured(tonewood: Run, score: Path, tmp_path: Path) -> None:
    response = np.zeros(4800)
    response[[0, 2400]] = 1.0, 0.5
    sf.write(tmp_path / "room.wav", response, 48000, subtype="DOUBLE")
    short = ["render", score, "-i", "monochord", "--max-duration", 0.2, "--subtype", "DOUBLE", "--level", "calibrated"]
    assert tonewood(*short, "-o", tmp_path / "dry.wav")[0] == 0
    code, out, _ = tonewood(*short, "-o", tmp_path / "wet.wav", "--room", tmp_path / "room.wav")
    assert code == 0
    assert "not measured" in out
    dry, wet = (sf.read(tmp_path / f"{name}.wav")[0] for name in ("dry", "wet"))
    expected = dry.copy()
    expected[2400:] += 0.5 * dry[:-2400]
    assert wet == pytest.approx(np.column_stack([expected, expected]), abs=1e-12)
    refused(tonewood(*short, "-o", tmp_path / "x.wav", "--room", "cellar"), "room: is 'cellar'", "small, hall")


def test_a_silent_render_says_so_and_ends_with_1(tonewood: Run, tmp_path: Path) -> None:
    """Turned down by its own controller, or below the smallest step of the file; the file is there all the same."""
    turned_down = write(tmp_path / "a.mid", [control(0.0, 7, 0), *note(0.01, 0.2, 45)])
    loud = write(tmp_path / "b.mid", note(0.01, 0.2, 45))
    words = ("-i", "monochord", "-o", tmp_path / "a.wav", "--max-duration", 0.1, "--fs", 16000)
    for score, more in ((turned_down, ()), (turned_down, ("--level", "calibrated")), (loud, ("--gain", -150))):
        code, _, err = tonewood("render", score, *words, *more)
        assert code == 1
        assert err.count("\n") == 1
        assert "silent: its peak" in err
        assert np.abs(sf.read(str(tmp_path / "a.wav"))[0]).max() < 2.0**-22  # rounding at most
        code, out, _ = tonewood("render", score, *words, *more, "--json")
        assert (code, json.loads(out)["ok"]) == (1, False)
    assert tonewood("render", loud, *words, "--gain", -150, "--subtype", "FLOAT")[0] == 0
    parts = ("render", turned_down, "--part", "1=monochord", *words[2:])
    code, _, err = tonewood(*parts)
    assert code == 1
    assert "part 1: the sound is silent" in err
    with pytest.warns(UserWarning, match="the sound is silent"):
        tw.render(turned_down, "monochord", 16000, max_duration=0.1)


def test_warnings_are_one_line_a_kind_within_the_part_that_is_rendered(tonewood: Run, tmp_path: Path) -> None:
    """961 lines before: every note too low or too high, also of the minutes that were not rendered."""
    notes = [e for i in range(300) for e in note(0.05 * i, 0.04, (20 + i % 9) if i % 3 else 45)]
    score = write(tmp_path / "a.mid", notes)
    words = ("-i", "monochord", "-o", tmp_path / "a.wav", "--max-duration", 0.98, "--fs", 8000)
    for command in (("render", score), ("render", score, "--part", "1=monochord"), ("plan", score)):
        code, out, err = tonewood(command[0], *command[1:], *(words if len(command) < 3 else words[2:]))
        lines = [line for line in err.splitlines() if "not played" in line]
        assert code == 0
        assert len(lines) == 1
        # at 0.05 s and 12 more of 20 notes; a third of them can be played
        assert "not played at 0.05 s: no string plays A0" in lines[0]
        assert lines[0].endswith(", nor 12 other notes for such a reason")
        if command[0] == "render":
            assert "7 notes, 13 dropped" in out
