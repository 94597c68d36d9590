"""``tonewood wood``: from a table or recordings to a drawn body's wood."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import soundfile as sf

import tonewood as tw
from cli_runs import refused
from tonewood.cli.wood import _report
from tonewood.workshop.wood.board import Board, MatchedPeak, typical
from tonewood.workshop.wood.rectangle import Rectangle
from tonewood.workshop.wood.stick import bar_freq

Run = Callable[..., tuple[int, str, str]]
SIZE = (0.58, 0.217, 4.7e-3)
MASS = 420.0 * float(np.prod(SIZE))


@pytest.fixture(scope="module")
def rectangle() -> Rectangle:
    return Rectangle.of(*SIZE, MASS, typical("sitka_spruce", 420.0))


@pytest.mark.slow
def test_the_command_from_a_table_to_a_drawn_body(tonewood: Run, tmp_path: Path, rectangle: Rectangle) -> None:
    freq, _ = rectangle.solution(rectangle.nominal)
    rows = "\n".join(f"{f:.3f},{70 + i}" for i, f in enumerate(freq[:12]))
    (tmp_path / "peaks.csv").write_text(f"freq_Hz,Q\n{rows}\n", encoding="utf-8")
    words = ("wood", tmp_path / "peaks.csv", "--length", SIZE[0], "--width", SIZE[1], "--thickness", SIZE[2])
    words += ("--mass", MASS)
    code, out, _ = tonewood(
        *words, "--outline", 0.485, 0.278, 0.237, 0.365, "--stiffness", 75, "-o", tmp_path / "w.yaml"
    )
    assert code == 0
    assert "E_L" in out
    assert "75.0 Hz, bare and clamped at its outline" in out
    assert "Gore and Gilet's target of a classical top" in out
    text = (tmp_path / "w.yaml").read_text(encoding="utf-8")
    values = dict(line.strip().split(": ") for line in text.splitlines() if line.startswith("  "))
    assert float(values["E_L"]) == pytest.approx(rectangle.nominal.E_L, rel=0.02)
    drawn = tw.load_instrument("drawn_guitar").replace(
        {f"body.wood.{k}": float(v) for k, v in values.items() if k != "species"}
    )
    assert drawn.spec.body is not None
    refused(tonewood(*words[:-1], 25.0), "kg/m^3 is no wood", "--mass in kg")
    (tmp_path / "bad.csv").write_text("f,q\n1,2\n", encoding="utf-8")
    refused(tonewood("wood", tmp_path / "bad.csv", *words[2:]), "bad.csv", "no column freq_Hz")


@pytest.mark.slow
def test_recordings_of_taps_are_read(
    tonewood: Run, tmp_path: Path, rectangle: Rectangle, rng: np.random.Generator
) -> None:
    fs, freq = 16000, rectangle.solution(rectangle.nominal)[0][:12]
    time = np.arange(3 * fs) / fs
    taps = [1e-4 * rng.normal(size=fs // 2)]
    for _ in range(3):
        parts = rng.normal(1, 0.3, (12, 1)) * np.sin(2 * np.pi * freq[:, None] * time + rng.uniform(0, 6, (12, 1)))
        sound = np.sum(parts * np.exp(-np.pi * freq[:, None] / 70 * time), axis=0)
        taps.append(0.05 * sound + 1e-5 * rng.normal(size=len(time)))
    sf.write(tmp_path / "taps.wav", np.concatenate(taps), fs, subtype="FLOAT")
    words = ("--length", SIZE[0], "--width", SIZE[1], "--thickness", SIZE[2], "--mass", MASS)
    code, out, err = tonewood("wood", tmp_path / "taps.wav", *words)
    assert code == 0, err
    assert float(out.split("E_L")[1].split()[0]) == pytest.approx(rectangle.nominal.E_L / 1e9, rel=0.02)


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (("--thickness-error", 0), "--thickness-error: is 0 m; 1e-07 to 0.0006 are allowed"),
        (("--outline", 0.48, 0.28, "inf", 0.37), "--outline: is inf m; 0.01 to 3 are allowed"),
    ],
)
def test_errors_and_outlines_without_size_are_refused_before_the_search(
    tonewood: Run, tmp_path: Path, words: tuple, line: str
) -> None:
    (tmp_path / "p.csv").write_text("freq_Hz\n55.1\n98.2\n130.4\n")
    sizes = ("--length", 0.5, "--width", 0.2, "--thickness", 0.003, "--mass", 0.12)
    code, _, err = tonewood("wood", tmp_path / "p.csv", *sizes, *words)
    assert code == 2
    assert err == f"tonewood: {line}\n"


@pytest.mark.slow
def test_a_stick_gives_its_modulus_along_the_grain(tonewood: Run, tmp_path: Path) -> None:
    """Euler's slender bar by hand: E = 0.9464 rho f^2 L^4 / h^2, less what shear takes."""
    length, width, height, young, rho = 0.45, 0.008, 0.008, 1.2e10, 410.0
    freq = bar_freq(length, height, rho, young, 0.061 * young, count=2)
    assert 0.9464 * rho * freq[0] ** 2 * length**4 / height**2 == pytest.approx(young, rel=0.03)
    (tmp_path / "s.csv").write_text("freq_Hz,Q\n" + "".join(f"{f:.4f},110\n" for f in freq), encoding="utf-8")
    words = ("--length", length, "--width", width, "--thickness", height, "--mass", rho * length * width * height)
    code, out, err = tonewood("wood", tmp_path / "s.csv", *words, "--stick", "-o", tmp_path / "w.yaml")
    assert code == 0, err
    values = {
        line.split()[0]: float(line.split()[1]) for line in out.splitlines() if line.startswith(("E_L", "loss_L"))
    }
    assert values["E_L"] == pytest.approx(12.0, rel=0.02)
    assert values["loss_L"] == pytest.approx(1 / 110, rel=1e-3)
    assert "E_R" not in out


def test_peaks_that_are_not_used_are_named(tonewood: Run, tmp_path: Path) -> None:
    """Those outside the band, and a quarter of them or more that are no mode of the board."""
    (tmp_path / "s.csv").write_text("freq_Hz\n220\n606\n900\n1200.5\n")
    words = ("--length", 0.45, "--width", 0.008, "--thickness", 0.008, "--mass", 0.0118, "--stick")
    code, _, err = tonewood("wood", tmp_path / "s.csv", *words)
    assert code == 0
    assert "peaks outside --band 30 800 were not used: 900.0, 1200.5 Hz\n" in err
    wood = typical("sitka_spruce", 420.0)
    for strangers, pairs, doubtful in ((1, 3, True), (2, 7, False), (3, 9, True)):
        board = Board(wood, {}, (MatchedPeak(60.0, 60.0, (1.0, 0.0, 0.0), 0.0),) * pairs, (99.0,) * strangers, (), 0.0)
        warnings = _report(board, 420.0, [], False)["warnings"]
        line = f"{strangers} of {strangers + pairs} peaks are no mode of such a board: do not trust the constants"
        assert any(warning.startswith(line) for warning in warnings) == doubtful
