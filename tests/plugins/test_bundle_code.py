"""Plugins in a bundle's folder: refused unless allowed, then the same as installed ones, and known by their hash."""

from __future__ import annotations

import hashlib
import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

import tonewood as tw
from tonewood.cli.main import run
from tonewood.errors import PluginError
from tonewood.workshop.batch.manifest import ManifestError
from tonewood.workshop.batch.rendering import EngineRenderer
from tonewood.workshop.batch.runner import run_batch
from tonewood.workshop.batch.workers import Workers

ROOT = Path(__file__).parents[2]
SOURCE = (ROOT / "plugins" / "pluck_ramp.py").read_text(encoding="utf-8")
SCORE = tw.Score([tw.Note(0.0, 0.1, note=45, force=1.0)])
REFUSED = (
    "exciters.pluck.plugin: the bundle holds code, hand.py, which could do anything that you can do; to run it, give"
)


@pytest.fixture
def bundle(tmp_path: Path) -> Path:
    """The monochord, plucked by a copy of a built-in plugin in its own folder that leaves a trace when it is run."""
    folder = tmp_path / "own"
    shutil.copytree(tw.list_instruments()["monochord"], folder)
    values = yaml.safe_load((folder / "instrument.yaml").read_text(encoding="utf-8"))
    assert values["exciters"]["pluck"]["plugin"] == "pluck_ramp"
    values["exciters"]["pluck"]["plugin"] = "hand.py:PluckRamp"
    (folder / "instrument.yaml").write_text(yaml.safe_dump(values, sort_keys=False), encoding="utf-8")
    trace = f"\nimport pathlib\npathlib.Path({str(tmp_path / 'was_run')!r}).touch()\n"
    (folder / "hand.py").write_text(SOURCE + trace, encoding="utf-8")
    return folder


def test_it_sounds_like_the_installed_one_and_leaves_nothing(bundle: Path) -> None:
    mine = tw.load_instrument(bundle, allow_code=True)
    installed = tw.load_instrument("monochord")
    ours, theirs = (tw.render(SCORE, i, max_duration=0.05, effects="all").samples for i in (mine, installed))
    assert np.array_equal(ours, theirs)
    # `replace`, by which a render chooses effects, made it again
    assert mine.replace({"tuning.reference_freq": 441.0}).allow_code
    assert not list(bundle.rglob("__pycache__"))


def test_it_is_not_run_unless_allowed(bundle: Path) -> None:
    for load in (tw.load_instrument, tw.Instrument.load):
        with pytest.raises(PluginError) as caught:
            load(bundle)
        assert str(caught.value).startswith(f"{bundle / 'instrument.yaml'}: line {caught.value.line}: {REFUSED}")
    with pytest.raises(PluginError, match="holds code"):
        tw.load_instrument("monochord").replace({"exciters.pluck.plugin": "hand.py:PluckRamp"})
    assert not (bundle.parent / "was_run").exists()


@pytest.mark.parametrize("command", ["render", "plan", "play", "check", "modes", "list", "batch"])
def test_every_command_that_loads_an_instrument_asks(
    command: str, bundle: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    tw.write_midi(SCORE, midi := tmp_path / "score.mid")
    short = ["--max-duration", "0.02", "--fs", "8000"]
    arguments = {
        "render": [str(midi), "-i", str(bundle), "-o", str(tmp_path / "a.wav"), *short],
        "plan": [str(midi), "-i", str(bundle), *short],
        "play": [str(midi), "-i", str(bundle), *short],
        "check": [str(bundle), "--fs", "8000"],
        "modes": [str(bundle), "--fs", "8000"],
        "list": [],
        "batch": [str(_manifest(tmp_path)), "-o", str(tmp_path / "out"), "--dry-run"],
    }[command]
    if command == "list":
        monkeypatch.setattr("tonewood.instrument.contract.registry.instrument_folder", lambda name: bundle)
    if command == "play":
        monkeypatch.setattr("tonewood.sound.live.play.play", lambda *a, **k: tw_playback())

    def ended(*more: str) -> tuple[int, str]:
        with pytest.raises(SystemExit) as end:
            run([command, *arguments, *more])
        said = capsys.readouterr()
        assert isinstance(end.value.code, int)
        return end.value.code, said.out + said.err

    code, said = ended()
    assert "--allow-code" in said
    assert REFUSED in said
    assert code == {"list": 0}.get(command, 2) or (command, code) == ("batch", 1)
    assert not (bundle.parent / "was_run").exists()
    code, said = ended("--allow-code")
    assert (code, "--allow-code" in said) == (0, False), said
    assert (bundle.parent / "was_run").exists()


def tw_playback() -> Any:
    from tonewood.sound.live.play import Playback

    return Playback(160, 0)


@pytest.mark.parametrize(
    ("name", "source", "line"),
    [
        ("hand.py:Nobody", SOURCE, "hand.py has no class Nobody"),
        ("absent.py:PluckRamp", SOURCE, "there is no file 'absent.py' in the bundle"),
        ("../hand.py:PluckRamp", SOURCE, "'../hand.py' leads out of the bundle"),
        ("hand.py:PluckRamp", "class PluckRamp(:", "hand.py cannot be run: SyntaxError: invalid syntax"),
        ("hand.py:PluckRamp", "1 / 0", "hand.py cannot be run: ZeroDivisionError: division by zero"),
        ("hand.py:PluckRamp", "raise SystemExit(3)", "hand.py cannot be run: SystemExit: 3"),
        ("hand.py:PluckRamp", "PluckRamp = 3", "plugin 'hand.py:PluckRamp' is not a class derived from"),
        ("hand.py:PluckRamp", SOURCE.replace("api = 1", "api = 7"), "was written for version 7 of the contract"),
        ("hand.py:PluckParameters", SOURCE, "is not a class derived from"),
        (
            "hand.py:Frets",
            "from tonewood.plugins.frets import Frets",
            "is of kind connection; one of kind exciter is wanted",
        ),
        ("hand.py", SOURCE, "there is no plugin 'hand.py' of kind exciter; installed: "),
    ],
)
def test_what_is_wrong_is_said_in_one_line(name: str, source: str, line: str, bundle: Path) -> None:
    manifest = bundle / "instrument.yaml"
    manifest.write_text(manifest.read_text().replace("hand.py:PluckRamp", name))
    (bundle / "hand.py").write_text(source)
    with pytest.raises(PluginError) as caught:
        tw.load_instrument(bundle, allow_code=True)
    said = str(caught.value)
    number = 1 + next(i for i, text in enumerate(manifest.read_text().splitlines()) if name in text)
    assert said.startswith(f"{manifest}: line {number}: exciters.pluck.plugin: ")
    assert line in said
    assert "\n" not in said


def test_a_link_out_of_the_folder_is_not_followed(bundle: Path, tmp_path: Path) -> None:
    shutil.move(bundle / "hand.py", tmp_path / "elsewhere.py")
    (bundle / "hand.py").symlink_to(tmp_path / "elsewhere.py")
    with pytest.raises(PluginError, match="leads out of the bundle"):
        tw.load_instrument(bundle, allow_code=True)


def test_hashes_follow_the_file_and_so_does_the_code(bundle: Path) -> None:
    before = tw.load_instrument(bundle, allow_code=True)
    hand = bundle / "hand.py"
    assert before.plugin_hashes["hand.py:PluckRamp"] == hashlib.sha256(hand.read_bytes()).hexdigest()
    content = before.content_hash
    hand.write_text(hand.read_text() + "\nPluckRamp.louder = True\n")
    after = tw.load_instrument(bundle, allow_code=True)
    assert after.content_hash != content
    assert after.plugin_hashes["hand.py:PluckRamp"] == hashlib.sha256(hand.read_bytes()).hexdigest()
    assert hasattr(after.exciters["pluck"], "louder")
    assert not hasattr(before.exciters["pluck"], "louder")
    # of the code that was run, not of the file there now
    assert before.plugin_hashes["hand.py:PluckRamp"] != after.plugin_hashes["hand.py:PluckRamp"]


def _manifest(folder: Path) -> Path:
    data = {
        "schema": "tonewood-batch/1", "name": "code", "seed": 1, "instruments": {"own": "./own"},
        "scores": {"note": {"phrase": [{"time": 0.0, "duration": 0.05, "note": 45.0, "force": 1.0}]}},
        "factors": {"low": {"path": "exciters.pluck.release_time", "levels": {"quick": 1e-4, "slow": 2e-3}}},
        "render": {"tail": 0.1, "fs": 16000},
    }  # fmt: skip
    path = folder / "batch.yaml"
    path.write_text(json.dumps(data))
    return path


@pytest.mark.slow
def test_a_batch_passes_it_to_its_workers_and_keeps_the_hash(bundle: Path, tmp_path: Path) -> None:
    path, out = _manifest(tmp_path), tmp_path / "out"
    with pytest.raises(ManifestError) as refused:
        run_batch(path, tmp_path / "none", EngineRenderer(), Workers(2, "processes"))
    assert REFUSED in str(refused.value)
    report = run_batch(path, out, EngineRenderer(allow_code=True), Workers(2, "processes"))
    assert (report.ok, report.rendered) == (True, 2)
    sha256 = hashlib.sha256((bundle / "hand.py").read_bytes()).hexdigest()
    for file in json.loads((out / "manifest.json").read_text())["files"]:
        assert file["identity"]["plugins"]["hand.py:PluckRamp"] == sha256
    assert run_batch(path, out, EngineRenderer(allow_code=True)).rendered == 0


def test_another_file_is_another_render(bundle: Path, tmp_path: Path) -> None:
    """In a process of its own kind: an instrument once loaded is kept while a batch runs."""
    from tonewood.workshop.batch import rendering
    from tonewood.workshop.batch.conditions import expand
    from tonewood.workshop.batch.manifest import load_manifest
    from tonewood.workshop.batch.store import content_key

    keys = []
    for more in ("", "# louder\n"):
        (bundle / "hand.py").write_text(SOURCE + more)
        rendering._loaded.cache_clear()
        condition = expand(load_manifest(_manifest(tmp_path)), tmp_path)[0]
        keys.append(content_key(EngineRenderer(allow_code=True).identity(condition)))
    assert keys[0] != keys[1]
