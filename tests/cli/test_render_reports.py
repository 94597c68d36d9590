"""Reports of renders, sessions and stems."""

from __future__ import annotations

import inspect
import json
import math
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace

import mido
import numpy as np
import pytest
import soundfile as sf
from cli_refusals import refused

from tonewood.cli import (
    accuracy,
    batch,
    check,
    common,
    compare,
    design,
    desk,
    distance,
    ensemble,
    estimate,
    fit,
    intonation,
    listing,
    live,
    migrate,
    modes,
    new,
    plan,
    play,
    render,
    render_report,
    results,
    sample,
    schema,
    serve,
    simulate,
    stems,
    strings,
    tab,
    taptone,
    validate,
    wood,
)
from tonewood.cli.commands import COMMANDS
from tonewood.cli.options import _metavar
from tonewood.errors import OutputError
from tonewood.sound.ensemble import mix
from tonewood.sound.ensemble.mix import EnsemblePart
from tonewood.sound.files.tags import Tags
from tonewood.sound.level.loudness import true_peak
from tonewood.sound.render.options import RenderOptions

# -- sessions and sounds -----------------------------------------------------------------------------------------------


def test_velocities_and_ranges_of_keys() -> None:
    assert sample._numbers("32, 64") == [32, 64]
    for text in ("", "1,,2", "-1", "x", "٣"):
        refused("numbers from 1 to 127", sample._numbers, text)
    assert sample._range(None) == (None, None)
    assert sample._range("E2-E5") == (40, 76)
    assert sample._range("40-76") == (40, 76)
    for host, names in (("127.0.0.1", ["127.0.0.1"]), ("::1", ["[::1]"]), ("name", ["name"])):
        assert serve._names(host) == names
    assert serve._names("0.0.0.0")[0] == "127.0.0.1"
    assert len(serve._names("::")) == 2


def test_a_session_tells_its_figures(capsys) -> None:
    effects = [
        SimpleNamespace(title=t, bound=b, seconds_active=s)
        for t, b, s in (("x", 0.1, 1.0), ("y", 0.0, 1.0), ("z", 0.1, 2.0), ("x", 0.1, 0.5))
    ]
    summary = SimpleNamespace(
        ignored={"a": 1},
        dropped={"no string": 2, "too low": 1},
        clipped=1,
        notes=5,
        cut=3,
        peak_dbfs=-3.25,
        frames=96000,
        effects=effects,
    )
    stage = SimpleNamespace(
        live=SimpleNamespace(summary=lambda: summary, fs=48000),
        receiver=SimpleNamespace(ignored={"b": 4}, messages=9),
        stream=SimpleNamespace(block_size=480),
        latency={},
        take=SimpleNamespace(messages=[1, 2]),
    )
    played = SimpleNamespace(underruns=2, late=1, frames=72000, load=0.256, worst_block_s=0.0045)
    live._tell(stage, played, Path("r.mid"), as_json=False)
    out, err = capsys.readouterr()
    assert out.splitlines() == [
        "played 1.50 s, 5 notes, 3 dropped, 3 ended by another on their string; 2 underruns (1 for want of a block, "
        "others by the device or system)",
        "  load 26 %, worst block 4.50 ms of 10.00 ms; peak -3.2 dBFS",
        "  left out at times within the budget: x",
        "  without effect: 1 a, 4 b",
        "  r.mid: 2 messages",
    ]
    assert [line.removeprefix("tonewood: warning: ") for line in err.splitlines()] == [
        "1 sample clipped; lower --gain",
        "2 not played: no string",
        "1 not played: too low",
    ]
    quiet = SimpleNamespace(underruns=0, late=0, frames=72000, load=0.0, worst_block_s=0.0)
    summary.clipped = 0
    live._tell(stage, quiet, None, as_json=False)
    assert capsys.readouterr().out.splitlines()[0].endswith("; 0 underruns")


def test_takes_are_kept_once_a_second(monkeypatch, tmp_path) -> None:
    now, saved = [0.0], []
    monkeypatch.setattr(live.time, "monotonic", lambda: now[0])
    take = SimpleNamespace(messages=[], save=lambda record, of, frames: saved.append((record, frames)))
    kept = live.Kept(take, tmp_path / "t.mid", SimpleNamespace(frames=7))
    for at, count in ((0.5, 1), (0.99, 1), (1.0, 2), (1.5, 3), (2.5, 3), (9.0, 3)):
        now[0] = at
        take.messages[:] = range(count)
        kept.now_and_then()
    assert len(saved) == 2  # at 1 s and, of the third message, at 2.5 s
    kept.save()
    assert saved[-1] == (tmp_path / "t.mid", 7)
    live.Kept(None, None, None).now_and_then()


def test_a_take_that_cannot_be_kept_is_said_while_it_is_played(monkeypatch, tmp_path, capsys) -> None:
    """Once, as is a take that has grown too long to be read again; the last error ends the command."""
    now = [0.0]
    monkeypatch.setattr(live.time, "monotonic", lambda: now[0])
    monkeypatch.setattr(live, "MAX_MESSAGES", 3)

    def full(*_: object) -> None:
        raise OutputError("the disk is full", file="t.mid")

    take = SimpleNamespace(messages=[], save=full)
    kept = live.Kept(take, "t.mid", SimpleNamespace(frames=7))
    for at in (1.0, 2.0, 3.0, 4.0, 5.0):
        now[0] = at
        take.messages.append(at)
        kept.now_and_then()
    assert [line.removeprefix("tonewood: warning: ") for line in capsys.readouterr().err.splitlines()] == [
        "t.mid: the disk is full; it is tried again until the end",
        "t.mid: `render --live` reads 3 messages at most; begin another take",
    ]
    refused("the disk is full", kept.save)


def test_files_of_takes_are_checked_before(tmp_path) -> None:
    live._check_record(tmp_path / "new.mid")
    refused("there is no folder", live._check_record, tmp_path / "no" / "t.mid")
    refused("cannot be written", live._check_record, tmp_path)


class Fixed:
    """A renderer of given samples."""

    def __init__(self, samples, fs=8000):
        self.samples, self.fs, self.channels, self.time = samples, fs, ("a", "b"), 0.0
        self.expected_duration = len(samples) / fs

    def blocks(self, size):
        for first in range(0, len(self.samples), size):
            yield self.samples[first : first + size]


@pytest.mark.parametrize(
    ("level", "target", "gain"), [("calibrated", 0.0, 0.0), ("peak", -1.0, 20 * math.log10(4) - 1.0)]
)
def test_a_sound_is_written_at_its_level(tmp_path, level, target, gain) -> None:
    t = np.arange(4000) / 8000
    samples = 0.25 * np.stack([np.sin(2 * np.pi * 1000 * t), 0.5 * np.cos(2 * np.pi * 500 * t)], 1)
    form = render._Form(tmp_path / "a.wav", "FLOAT", 300, level, target, False)
    written = render._write(Fixed(samples), form, Tags())
    out, fs = sf.read(tmp_path / "a.wav")
    assert fs == 8000
    assert written.gain_db == pytest.approx(gain, abs=0.02)
    assert out == pytest.approx(samples * 10 ** (written.gain_db / 20), abs=1e-6)
    assert written.peak == pytest.approx(10 ** (target / 20) if level == "peak" else 0.25, rel=2e-3)
    assert (written.clipped, written.level, written.limiter) == (0, level, None)
    assert [path.name for path in tmp_path.iterdir()] == ["a.wav"]


def test_stems_that_cannot_be_made_are_refused(tmp_path) -> None:
    render._Stems(None, "output").check(live=True, limiter=True)
    render._Stems(tmp_path / "s", "string").check(live=False, limiter=False)
    assert not (tmp_path / "s").exists()
    for folder, by, how, said in (
        (None, "part", {}, "output, string are allowed"),
        (None, "string", {}, "is for --stems"),
        (tmp_path / "s", "string", {"live": True}, "is for --stems"),
        (tmp_path / "s", "string", {"limiter": True}, "is for --stems"),
        (tmp_path / "no" / "s", "output", {}, "there is no folder"),
    ):
        refused(said, render._Stems(folder, by).check, **{"live": False, "limiter": False} | how)
    render._refuse({"--a": None, "--b": False, "--c": []})
    refused("--b: is for one instrument", render._refuse, {"--a": None, "--b": True})
    refused("one of --part and --ensemble", render._players, tmp_path, {}, ["a"], tmp_path, None)
    with pytest.raises(OutputError):
        render._write(
            Fixed(np.zeros((10, 2))), render._Form(tmp_path / "no" / "a.wav", "FLOAT", 5, "peak", 0.0, False), Tags()
        )


def test_infinite_sensitivities_are_refused() -> None:
    refused("1e999 is not allowed", fit._numbers, "2,1e999")


def test_placeholders_of_options_are_their_words() -> None:
    fields = RenderOptions.model_fields
    assert _metavar(fields["lead_in"]).split("|")[-1] == "SECONDS"
    assert "auto" in _metavar(fields["lead_in"])
    assert _metavar(fields["outputs"]).endswith("NAMES")
    assert _metavar(fields["fs"]) == ""


# -- renders -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("loudness", "gain"), [(-6.0, -6.0), (99.0, 20 * math.log10(4) - 1.0)])
def test_a_loudness_is_reached_unless_the_peak_would_be_too_high(tmp_path, monkeypatch, loudness, gain) -> None:
    monkeypatch.setattr(render, "_loudness_gain", lambda path: loudness)
    samples = 0.25 * np.sin(2 * np.pi * np.arange(4000) / 8)[:, None] * [1.0, 0.5]
    form = render._Form(tmp_path / "a.wav", "FLOAT", 300, "LUFS", -1.0, False)
    assert render._write(Fixed(samples), form, Tags()).gain_db == pytest.approx(gain, abs=0.02)


@pytest.mark.parametrize("channels", [[1], [1, 2]])
def test_stems_of_outputs_are_their_channels_of_the_file(tmp_path, channels) -> None:
    whole = np.random.default_rng(3).uniform(-0.5, 0.5, (300, sum(channels)))
    sf.write(tmp_path / "a.wav", whole, 8000, subtype="DOUBLE")
    groups = [SimpleNamespace(channels=tuple("lr"[:n])) for n in channels]
    renderer = SimpleNamespace(model=SimpleNamespace(outputs=groups), options=RenderOptions(), fs=8000)
    files = [tmp_path / f"s{i}.wav" for i in range(len(groups))]
    stems.write_output_stems(tmp_path / "a.wav", files, "DOUBLE", renderer, Tags())
    found = [sf.read(file, always_2d=True)[0] for file in files]
    assert [x.shape[1] for x in found] == channels
    assert np.array_equal(np.concatenate(found, axis=1), whole)


@pytest.mark.parametrize("frames", [400, 1500])
def test_stems_of_strings_are_as_long_as_the_mix_and_at_its_gain(tmp_path, frames) -> None:
    """Blocks of 1000 samples of two groups, of one channel and of two: cut, or filled with silence."""
    samples = np.arange(3000.0).reshape(1000, 3) / 6000
    renderer = Fixed(samples)
    renderer.columns = [[0], [1, 2]]
    files = [tmp_path / "a.wav", tmp_path / "b.wav"]
    parts = [samples[:300], samples[300:600], samples[600:]]
    renderer.blocks = lambda size: iter(parts)
    stems.write_string_stems(renderer, files, "FLOAT", -6.0, frames, Tags())
    wanted = np.zeros((frames, 3))
    wanted[: min(frames, 1000)] = samples[:frames] * 10 ** (-6 / 20)
    for file, columns in zip(files, renderer.columns, strict=True):
        assert sf.read(file, always_2d=True)[0] == pytest.approx(wanted[:, columns], abs=1e-6)


#: of a render's options, where a command has them
RENDERS = {"fs": 48000, "accuracy": "standard", "tail": 10.0, "tail_level_db": -60.0, "gain_db": 0.0, "capo": 0,
           "lead_in": "0", "room_mix_db": 0.0, "start": 0.0, "transpose": 0.0, "tempo": 1.0}  # fmt: skip


@pytest.mark.parametrize(
    ("command", "defaults"),
    [
        (accuracy.accuracy, {"fs": 48000, "bandwidth": 10000.0, "notes": ""}),
        (batch.batch, {"jobs": -1, "workers": "processes"}),
        (check.check, {"fs": 48000}),
        (compare.compare, {"duration": 4.0, "velocity": 80.0, "fs": 48000}),
        (compare.report, {"duration": 4.0, "velocity": 80.0, "fs": 48000}),
        (design.design, {}),
        (desk.desk, {"port": 8137, "fs": 48000}),
        (distance.distance, {"transpose": 0}),
        (estimate.estimate, {"transpose": 0, "iterations": 3}),
        (fit.fit, {"scale": 1.0, "damping": "auto", "estimator": "H1"}),
        (intonation.intonation, {"frets": 12, "fs": 48000}),
        (listing.list_installed, {}),
        (migrate.migrate, {}),
        (modes.modes, {"stop": 0, "count": 12, "fs": 48000}),
        (new.new, {}),
        (plan.plan, RENDERS),
        (play.play, {**RENDERS, "ramp": 5.0, "spacing": 2, "ahead": 4}),
        (render.render, {**RENDERS, "block": 4096, "stems_by": "output"}),
        (results.results, {"confidence": 0.95, "screening": True}),
        (sample.sample, {"velocities": "32,64,96,120", "every": 3, "round_robins": 2, "duration": 8.0, "releases": True,
                         "sound_format": "flac", "jobs": 1, "fs": 48000, "accuracy": "standard",
                         "tail_level_db": -60.0}),
        (schema.schema, {"kind": "instrument"}),
        (serve.serve, {"host": "127.0.0.1", "port": 8000}),
        (simulate.simulate, {"listeners": 20, "seed": 1}),
        (strings.strings_for_sale, {}),
        (tab.tab, {"transpose": 0.0, "capo": 0}),
        (taptone.taptone, {"channel": 1, "band": (50.0, 1000.0), "names": True}),
        (validate.validate, {}),
        (wood.wood, {"species": "sitka_spruce", "thickness_error": 5e-5, "band": (30.0, 800.0)}),
        (common.print_json, {"ok": True}),
    ],
)  # fmt: skip
def test_regression_of_defaults_of_options(command, defaults) -> None:
    """Figures of the help of commands: a change of one changes what users get. All others are left out or off."""
    given = {p.name: p.default for p in inspect.signature(command).parameters.values() if p.default is not p.empty}
    assert {name: value for name, value in given.items() if value is not None and value is not False} == defaults


def test_the_defaults_of_all_commands_are_held() -> None:
    (table,) = (m for m in test_regression_of_defaults_of_options.pytestmark if m.name == "parametrize")
    held = {(c.__module__.rpartition(".")[2], c.__name__) for c, _ in table.args[1]}
    assert {tuple(where.split(":")) for where in COMMANDS.values()} <= held


def test_a_bar_on_a_terminal_moves_to_its_end_and_no_farther(monkeypatch) -> None:
    from rich.progress import Progress

    done, totals = [], []
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True, raising=False)
    monkeypatch.setattr(Progress, "update", lambda self, task, *, completed: done.append(completed))
    monkeypatch.setattr(Progress, "add_task", lambda self, label, *, total: totals.append((label, total)))
    with common.progress("rendering", 10.0) as advance:
        for position in (0.0, 4.0, 10.0, 12.5):
            advance(position)
    assert (done, totals) == ([0.0, 4.0, 10.0, 10.0], [("rendering", 10.0)])
    with common.progress("searching") as advance:  # shares
        advance(1.5)
    assert (done[4:], totals[1:]) == ([1.0], [("searching", 1.0)])
    monkeypatch.setattr(sys.stderr, "isatty", lambda: False, raising=False)
    with common.progress("rendering", 10.0) as advance:
        advance(3.0)
    assert len(done) == 5


@pytest.mark.parametrize(("level", "target"), [("peak", -7.0), ("LUFS", -1.0)])
def test_a_mix_is_the_sum_of_its_stems_at_its_level(monkeypatch, tmp_path, capsys, level, target) -> None:
    file, track = mido.MidiFile(), mido.MidiTrack()
    file.tracks.append(track)
    track += [mido.Message("note_on", note=60, velocity=80), mido.Message("note_off", note=60, time=480)]
    file.save(tmp_path / "a.mid")
    t = np.arange(48000) / 48000
    sounds = [0.2 * np.sin(2 * np.pi * f * t)[:, None] * [1.0, 0.5] for f in (500.0, 700.0)]
    summary = SimpleNamespace(notes=1, ignored={}, notes_dropped=[], warnings=[])
    parts = [EnsemblePart(part=i + 1, instrument="monochord") for i in range(3)]
    rendered = [SimpleNamespace(part=parts[i], samples=sounds[i], summary=summary) for i in range(2)]  # 3 is silent
    monkeypatch.setattr(mix, "render_ensemble", lambda *arguments, **options: rendered)
    ensemble.render_parts(
        tmp_path / "a.mid", parts, tmp_path / "a.wav", RenderOptions(fs=48000), reading={}, subtype="DOUBLE",
        level=level, target=target, stems=tmp_path / "new" / "stems", as_json=True, left_out=["part 9"],
    )  # fmt: skip
    told = json.loads(capsys.readouterr().out)
    whole = sf.read(tmp_path / "a.wav")[0]
    peak = 20 * math.log10(true_peak(sounds[0] + sounds[1]))
    gain = target - peak if level == "peak" else told["gain_db"]
    assert told["gain_db"] == pytest.approx(gain)
    assert whole == pytest.approx((sounds[0] + sounds[1]) * 10 ** (gain / 20), abs=1e-9)
    assert told["true_peak_dbtp"] == pytest.approx(peak + gain)
    names = [Path(name).name for name in told["stems"]]
    assert names == ["01_monochord.wav", "02_monochord.wav"]
    for name, sound in zip(names, sounds, strict=True):
        assert sf.read(tmp_path / "new" / "stems" / name)[0] == pytest.approx(sound * 10 ** (gain / 20), abs=1e-9)
    assert [row["peak_dbfs"] for row in told["parts"]] == pytest.approx([20 * math.log10(0.2) + gain] * 2, abs=1e-6)
    assert (told["frames"], told["duration_s"], told["fs"], told["clipped"]) == (48000, 1.0, 48000, 0)
    assert (told["ok"], told["level"], told["left_out"]) == (True, level, ["part 9"])
    if level == "LUFS":  # below the limit of the peak
        assert told["loudness_lufs"] == pytest.approx(-23.0, abs=0.1)


def test_shares_of_a_coupled_mode_add_up_to_its_energy(tonewood) -> None:
    code, out, err = tonewood("modes", "classical_guitar", "--string", "D3", "--stop", 2, "--count", 5, "--json")
    assert code == 0, err
    told = json.loads(out)
    row = told["strings"]["D3"]
    assert row["wanted_freq"] == pytest.approx(440 * 2 ** ((52 - 69) / 12))
    assert [p["number"] for p in row["partials"]] == [1, 2, 3, 4, 5]
    for p in row["partials"]:
        assert p["string_share"] + p["body_share"] == pytest.approx(1.0, rel=1e-6)
        assert 0 <= p["body_share"] < 0.5
        assert p["cents"] == pytest.approx(1200 * math.log2(p["freq"] / p["number"] / row["wanted_freq"]), abs=1e-6)


@dataclass
class Tension:
    cents: float = -3.0
    given: float = 70.0

    def line(self) -> str:
        return "string E2 is held"


def test_a_summary_of_a_render_has_every_figure(capsys) -> None:
    dropped = SimpleNamespace(time=1.5, note=20.0, channel=3, reason="no string plays it")
    summary = SimpleNamespace(
        notes=1, notes_dropped=[dropped], duration_s=2.5, fs=8000, frames=20000, realtime_factor=4.0, render_s=0.625,
        end="silent", room="hall", ignored={"aftertouch": 2}, tensions=[Tension()], zero_frame=400, n_modes=9,
        onset_step_dbfs=-50.4, effects=[], warnings=["loud"], peak_dbfs=-3.0,
    )  # fmt: skip
    account = SimpleNamespace(
        peak=0.0125, worst_residual=2e-9, worst_cumulative_residual=3e-8, balance=lambda: {"supplied": 1.0}
    )
    groups = [SimpleNamespace(name="mic", full_scale=40.0, unit="Pa", gain_db=0.0)]
    renderer = SimpleNamespace(
        summary=lambda: summary, energy=account, channels=("l", "r"), model=SimpleNamespace(outputs=groups)
    )
    rendered = render_report.WrittenSound(
        renderer, Path("a.wav"), "PCM_16", 0, 0.5, "peak", 6.0, None, 0.25, [Path("s/mic.wav")]
    )
    render_report.print_summary(rendered, [Path("e.json"), Path("e.csv")])
    out, err = capsys.readouterr()
    assert out.splitlines() == [
        "a.wav: 2.50 s, 2 channels at 8000 Hz, peak -6.0 dBFS; 1 note, 1 dropped; 4.0 x real time; ended: silent",
        "  level peak: gain +6.0 dB, 0 dBFS is 20.05 Pa",
        "  room hall",
        "  without effect: 2 aftertouch",
        "  string E2 is held",
        "  score time 0 is frame 400",
        "  a step of -50 dBFS at the first frame was smoothed: sound before it was cut off (see --lead-in)",
        "  s/mic.wav",
        "  energy: peak 0.0125 J, balance open by 2.0e-09 of it in an interval, 3.0e-08 summed up: e.json, e.csv",
    ]
    assert err.splitlines()[0] == "tonewood: warning: loud"
    assert "no string plays it" in err
    assert render_report.report(rendered) == {
        "output": "a.wav", "outputs": ["mic"], "fs": 8000, "frames": 20000, "channels": 2, "channel_names": ["l", "r"],
        "duration_s": 2.5, "load_s": 0.25, "render_s": 0.625, "realtime_factor": 4.0, "n_modes": 9, "notes": 1,
        "notes_dropped": [{"time_s": 1.5, "note": 20.0, "channel": 3, "reason": "no string plays it"}],
        "midi_ignored": {"aftertouch": 2}, "peak_dbfs": pytest.approx(20 * math.log10(0.5)), "clipped": 0,
        "end": "silent", "tensions": [{"cents": -3.0, "given": 70.0}], "zero_frame": 400, "onset_step_dbfs": -50.4,
        "room": "hall", "warnings": ["loud"], "energy": {"supplied": 1.0}, "effects": [], "level": "peak",
        "gain_db": 6.0,
    }  # fmt: skip
    for name in ("room", "onset_step_dbfs"):
        setattr(summary, name, None)
    summary.ignored, summary.tensions, summary.zero_frame, renderer.energy = {}, [], 0, None
    render_report.print_summary(replace(rendered, stems=[]), [])
    assert len(capsys.readouterr().out.splitlines()) == 2
    assert render_report.report(replace(rendered, peak=0.0))["peak_dbfs"] is None
    assert render_report.report(rendered)["energy"] is None
