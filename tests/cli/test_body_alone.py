"""A body without strings: three lines of YAML, looked at and compared, but not played."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import tonewood as tw
from tonewood.cli.main import run
from tonewood.errors import BundleError
from tonewood.instrument.model.assembly import assemble

TOP = """schema: tonewood-instrument/2
name: top
body: {plugin: drawn_body, fmax: 500, cell: 0.04, outline: {points: [[0, 0], [0.5, 0], [0.5, 0.2], [0, 0.2]]},
  wood: {species: sitka_spruce}, thickness: 4.0e-3, edge: {kind: free}}
"""


@pytest.fixture
def top(tmp_path: Path) -> Path:
    (tmp_path / "top").mkdir()
    (tmp_path / "top/instrument.yaml").write_text(TOP)
    return tmp_path / "top"


def out(capsys: pytest.CaptureFixture[str], *words: object, code: int = 0) -> str:
    with pytest.raises(SystemExit) as end:
        run([str(word) for word in words])
    found = capsys.readouterr()
    assert end.value.code == code, found.err
    return found.err if code else found.out


@pytest.mark.slow
def test_modes_and_picture(top: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The first bending mode along and the twist lie where free beams and Rayleigh's w = x y say, within 6 %."""
    report = json.loads(out(capsys, "modes", top, "--json", "--plot", top / "modes.png"))
    freq = [mode["freq"] for mode in report["body"]["modes"]]
    wood, h = tw.load_instrument(top).body.drawing.top.wood, 4e-3
    along = 1.0279 * h / 0.5**2 * np.sqrt(wood.E_L / wood.density)
    twist = 1.103 / 1.05 * h / (0.5 * 0.2) * np.sqrt(wood.G_LR / wood.density)
    assert min(freq) > 30
    assert any(f == pytest.approx(along, rel=0.06) for f in freq)
    assert any(f == pytest.approx(twist, rel=0.06) for f in freq)
    assert (top / "modes.png").stat().st_size > 10_000
    assert "3 of these are rigid-body motion" in " ".join(report["body"]["facts"])


@pytest.mark.slow
def test_compare_pairs_modes_by_their_shapes(top: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Three quarters of the thickness: every mode of a thin plate falls to 0.75, nearly, whatever its place."""
    report = json.loads(
        out(capsys, "compare", top, "--variant", "body.thickness=3e-3", "-o", top / "page.html", "--json")
    )
    pairs = [row["modes"] for row in report["modes"] if all(row["modes"])]
    ratios = [b["freq"] / a["freq"] for a, b in pairs]
    assert len(ratios) > 6
    assert ratios == pytest.approx([0.75] * len(ratios), rel=0.03)


def test_check_takes_it(top: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert "a body alone, without strings" in out(capsys, "check", top)


def test_it_is_not_played(top: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(BundleError, match="strings: there are none, and so nothing can be played"):
        assemble(tw.load_instrument(top), 48000)
    assert "a body alone" in out(capsys, "modes", top, "--string", "E2", code=2)
    assert "plays none" in out(capsys, "report", top, "--notes", "E2", code=2)


def test_strings_still_need_ways_of_playing(top: Path) -> None:
    text = TOP + "strings: {a: {plugin: stiff_string, note: A2, end: body.corner, length: 0.6, linear_density: 1e-3}}\n"
    (top / "instrument.yaml").write_text(text)
    with pytest.raises(BundleError, match="title: is missing"):
        tw.load_instrument(top)


@pytest.mark.parametrize("command", ["check", "modes"])
def test_an_instrument_whose_strings_are_taken_off_is_a_body(capsys: pytest.CaptureFixture[str], command: str) -> None:
    """Its exciters stay in the bundle, and have no string on which to be placed."""
    report = json.loads(out(capsys, command, "monochord", "--set", "strings={}", "--fs", 16000, "--json"))
    assert report["ok"]
    assert not report["strings"]
