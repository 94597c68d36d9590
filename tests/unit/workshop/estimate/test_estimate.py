"""A guitar of known figures is found again from its rendered notes, and the bundle, page and command that tell it."""

from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np
import pytest
from estimate_sounds import GUITAR, recorded

from pianos import some_keys
from tonewood.cli.main import run
from tonewood.instrument.bundle.loading import Instrument
from tonewood.sound.equalizer import response_db
from tonewood.workshop.estimate.bundle import RecordingOrigin, write_bundle
from tonewood.workshop.estimate.estimate import alternating, estimate
from tonewood.workshop.estimate.gain import KNOTS
from tonewood.workshop.estimate.playing import Stage
from tonewood.workshop.estimate.recordings import read_folder

#: CC0 recordings of a guitar; skipped where the folder is missing
FREE = Path(os.environ.get("TONEWOOD_NOTES", Path(__file__).parents[5] / "shared/listening/recordings"))
STRINGS = ("E2", "A2", "D3", "G3", "B3", "E4")
WOUND = STRINGS[:3]


def truth(strings) -> dict:
    """Changes of the guitar that a search has to find."""
    resolved = Instrument.load(GUITAR).resolved["strings"]
    out = {"exciters.pluck.from_bridge": 0.13}
    for k, name in enumerate(strings):
        out[f"strings.{name}.bending_stiffness"] = resolved[name]["bending_stiffness"] * (1.3, 0.8)[k % 2]
        out[f"strings.{name}.loss.eta_f"] = resolved[name]["loss"]["eta_f"] * (2.0, 0.6)[k % 2]
    return out


def rate_errors(found, changes, strings, freq):
    """Relative errors of decay rates at frequencies, and of B, by string."""
    rates, stiff = {}, {}
    wanted = Stage(Instrument.load(GUITAR).replace(changes))
    from tonewood.workshop.estimate.figures import figures_of

    true = figures_of(wanted)
    for name in strings:
        rates[name] = found.figures.laws[name].rate(freq) / true.laws[name].rate(freq) - 1
        stiff[name] = found.figures.bending[name] / true.bending[name] - 1
    return rates, stiff


@pytest.mark.slow
def test_a_string_of_known_figures_is_found_again_by_the_command(tmp_path, monkeypatch, capsys) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "notes").mkdir()
    changes = truth(["A2"])
    recorded(tmp_path / "notes", changes, [("A2", 0), ("A2", 4), ("A2", 7)], seconds=1.3)
    words = [
        "notes",
        "-o",
        "mine",
        "--from",
        GUITAR,
        "--iterations",
        "2",
        "--licence",
        "CC0-1.0",
        "--title",
        "a <guitar>",
    ]
    with pytest.raises(SystemExit) as ended:
        run(["estimate", *words, "--page", "mine.html", "--json"])
    assert ended.value.code == 0
    report = json.loads(capsys.readouterr().out)
    assert report["strings"]["A2"]["own_notes"]
    assert not report["strings"]["E4"]["own_notes"]
    made = Instrument.load(tmp_path / "mine")
    assert made.resolved["strings"]["A2"]["bending_stiffness"] == pytest.approx(
        changes["strings.A2.bending_stiffness"], rel=0.02
    )
    assert made.resolved["exciters"]["pluck"]["from_bridge"] == pytest.approx(0.13, abs=0.003)
    distances = report["distances"]["all notes"]
    assert distances["after"]["third_octaves"] < 0.5 * distances["before"]["third_octaves"]
    manifest = (tmp_path / "mine" / "instrument.yaml").read_text()
    assert "kind: estimated, source: recordings" in manifest
    assert "licence: CC0-1.0" in manifest
    page = (tmp_path / "mine.html").read_text()
    assert "a &lt;guitar&gt;" in page
    assert "http" not in page.replace("http-equiv", "").replace("http://www.w3.org", "")


@pytest.mark.slow
def test_strings_of_a_table_of_keys_are_written_there(tmp_path) -> None:
    piano = some_keys(tmp_path / "three_keys", ["A3", "C4", "E4"])
    begun = Instrument.load(piano)
    leads = [key.strings[0] for key in begun.spec.keys.entries.values()]
    stiffer = {
        f"strings.{name}.bending_stiffness": 1.2 * begun.resolved["strings"][name]["bending_stiffness"]
        for key in begun.spec.keys.entries.values()
        for name in key.strings
    }
    (tmp_path / "notes").mkdir()
    recorded(tmp_path / "notes", stiffer, [(name, 0) for name in leads], guitar=piano)
    found = estimate(read_folder(tmp_path / "notes"), begun, iterations=2)
    made = write_bundle(found, tmp_path / "mine", str(piano), RecordingOrigin(licence="CC0-1.0"))
    for name, wanted in stiffer.items():
        string = name.split(".")[1]
        assert made.resolved["strings"][string]["bending_stiffness"] == pytest.approx(wanted, rel=0.03)
        assert made.resolved["strings"][string]["loss"] == found.instrument.resolved["strings"][string]["loss"]


@pytest.mark.validate
def test_a_guitar_of_known_figures_is_found_again(tmp_path) -> None:
    changes = truth(STRINGS) | {
        "outputs.microphones.equalizer": [{"freq": 600.0, "gain_db": 6.0, "q": 0.7}, {"freq": 4000.0, "gain_db": -8.0}]
    }
    recorded(tmp_path, changes, [(name, stop) for name in STRINGS for stop in (0, 2, 3, 5)], seconds=2.5)
    found = estimate(read_folder(tmp_path), Instrument.load(GUITAR))
    rates, stiff = rate_errors(found, changes, STRINGS, np.array([500.0, 1000.0, 2000.0, 4000.0]))
    assert max(map(abs, stiff.values())) < 0.02
    assert found.figures.place == pytest.approx(0.13, abs=0.001)
    gain = found.figures.gains["microphones"]
    wanted = response_db([(600.0, 6.0, 0.7), (4000.0, -8.0, None)], KNOTS)
    inside = (KNOTS > 100) & (KNOTS < 8000)
    assert np.abs(gain - wanted - np.median((gain - wanted)[inside]))[inside].max() < 1.1
    assert max(np.median(np.abs(rates[name])) for name in WOUND) < 0.09
    for half in found.halves:
        assert half.after.third_octaves < 1.0
        assert half.after.decays < 1.04


@pytest.mark.validate
@pytest.mark.skipif(not FREE.is_dir(), reason="the recordings are not here")
def test_notes_held_back_come_nearer() -> None:
    found = estimate(read_folder(FREE), Instrument.load(GUITAR))
    assert len(found.notes) == 31
    for half in found.halves:
        assert set(half.fitted).isdisjoint(half.held_back)
        assert half.after.third_octaves < half.before.third_octaves - 1.0
        assert half.after.decays < half.before.decays
    first, second = alternating(found.notes)
    assert sorted(first + second) == list(range(31))
