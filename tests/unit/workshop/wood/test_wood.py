"""Constants of a board and of a stick: closed forms, other people's finite elements and measurements, coverage."""

from __future__ import annotations

import csv
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tonewood.errors import TonewoodError
from tonewood.physics.plate.outline import circle
from tonewood.physics.plate.plate import FREE, Plate
from tonewood.physics.plate.wood import SPECIES, Wood
from tonewood.workshop.taps.strongest import strongest
from tonewood.workshop.wood.board import MatchedPeak, estimate_board, losses_of, typical
from tonewood.workshop.wood.peaks import read_peaks
from tonewood.workshop.wood.rectangle import SENSOR_AT, Rectangle
from tonewood.workshop.wood.stick import bar_freq, estimate_stick
from tonewood.workshop.wood.thickness import gore_thickness, panel_freq, thickness_for

PLATES = Path(os.environ.get("TONEWOOD_PLATES", Path(__file__).parents[4].parent / "shared/plates"))
SIZE = (0.58, 0.217, 4.7e-3)


def mass_of(wood: Wood, size: tuple[float, float, float] = SIZE) -> float:
    return wood.density * float(np.prod(size))


@pytest.fixture(scope="module")
def rectangle() -> Rectangle:
    nominal = typical("sitka_spruce", 420.0)
    return Rectangle.of(*SIZE, mass_of(nominal), nominal)


def free_plate(wood: Wood, size: tuple[float, float, float], count: int = 16) -> np.ndarray:
    """Frequencies of a free rectangle, on a grid that the estimate does not use."""
    length, width, h = size
    ring = np.array([[0.0, 0.0], [length, 0.0], [length, width], [0.0, width]])
    return np.asarray(Plate([ring], wood, h, FREE, size=length / 23).modes(count=count + 3).freq[3:])


def board(rng: np.random.Generator) -> Wood:
    """A board of spruce as boards differ."""
    sitka = SPECIES["sitka_spruce"].wood
    e, r, g, long, rolling = np.exp(rng.normal(0.0, [0.2, 0.25, 0.2, 0.3, 0.4]))
    return replace(
        sitka, E_L=sitka.E_L * e * 0.9, E_R=sitka.E_R * r, G_LR=sitka.G_LR * g * 0.6,
        nu_LR=float(np.clip(rng.normal(0.38, 0.06), 0.15, 0.6)), density=420.0, G_LT=sitka.G_LT * long,
        G_RT=sitka.G_RT * rolling,
    )  # fmt: skip


@pytest.mark.slow
def test_any_wood_of_the_rectangle_is_that_of_a_whole_solution(rectangle: Rectangle, rng: np.random.Generator) -> None:
    """Within 1 % far from the nominal one, which is the second pass's; shares of the energy add up to one."""
    wood = board(rng)
    whole = free_plate(wood, SIZE)[:12]
    freq, shares = rectangle.solution(wood)
    assert freq[:12] == pytest.approx(whole, rel=0.01)
    near = replace(wood, E_L=1.05 * wood.E_L, E_R=0.95 * wood.E_R, G_LR=1.05 * wood.G_LR, G_RT=0.8 * wood.G_RT)
    second = Rectangle.of(*SIZE, mass_of(wood), near)
    assert second.solution(wood)[0][:12] == pytest.approx(whole, rel=1e-3)
    assert shares.sum(axis=0)[:12] == pytest.approx(1.0, abs=1e-9)


@pytest.mark.slow
def test_a_board_is_found_again(rectangle: Rectangle, rng: np.random.Generator) -> None:
    """From exact frequencies of which two are missing and one is none of the board's."""
    wood = board(rng)
    freq = np.delete(free_plate(wood, SIZE)[:14], [3, 7])
    peaks = np.sort(np.append(freq, 150.5))
    solution = estimate_board(rectangle, peaks, 1e-4 * peaks)
    for name in ("E_L", "E_R", "G_LR"):
        assert getattr(solution.wood, name) == pytest.approx(getattr(wood, name), rel=0.03)
    assert solution.wood.nu_LR == pytest.approx(wood.nu_LR, abs=0.15)
    assert solution.misfit < 3e-3
    assert len(solution.pairs) >= 12


@pytest.mark.slow
def test_a_sensor_at_a_corner_is_found_and_makes_the_board_no_softer(rectangle: Rectangle) -> None:
    """Against Rayleigh: a small mass m lowers a mode's ln f by m phi^2 / 2; 3 g change E_L and G_LR by 5 % and more."""
    wood, mass = rectangle.nominal, 3e-3
    ring = np.array([[0.0, 0.0], [SIZE[0], 0.0], [SIZE[0], SIZE[1]], [0.0, SIZE[1]]])
    modes = Plate([ring], wood, SIZE[2], FREE, size=SIZE[0] / 23).modes(count=17)
    phi = modes.shapes([[SENSOR_AT, SENSOR_AT]])[0, 3:]
    small = rectangle.solution(wood, sensor=1e-5)[0][:10] / rectangle.solution(wood)[0][:10] - 1
    assert small == pytest.approx(-0.5e-5 * phi[:10] ** 2, rel=0.05)
    freq = rectangle.solution(wood, sensor=mass)[0][:13]
    for sensor in (None, mass):
        solution = estimate_board(rectangle, freq, 1e-3 * freq, sensor=sensor)
        assert solution.sensor == pytest.approx(mass, rel=0.3)
        for name in ("E_L", "G_LR"):
            assert getattr(solution.wood, name) == pytest.approx(getattr(wood, name), rel=0.02)
    assert estimate_board(rectangle, freq, 1e-3 * freq, sensor=0.0).wood.G_LR < 0.97 * wood.G_LR
    free = rectangle.solution(wood)[0][:13]
    assert estimate_board(rectangle, free, 1e-3 * free).sensor == 0.0


@pytest.mark.slow
def test_losses_are_those_of_the_energies(rectangle: Rectangle) -> None:
    wood = rectangle.nominal
    freq, shares = rectangle.solution(wood)
    eta = np.array([0.008, 0.02, 0.015])
    grouped = np.array([shares[0] + shares[2] / 2, shares[1] + shares[2] / 2, shares[3:].sum(axis=0)])
    solution = estimate_board(rectangle, freq[:12], 1e-4 * freq[:12], (1 / (eta @ grouped))[:12])
    found = [getattr(solution.wood, name) for name in ("loss_L", "loss_R", "loss_shear")]
    assert found == pytest.approx(eta, rel=0.05)


def test_a_slender_bar_is_euler_s_and_a_thick_one_is_lower() -> None:
    """cosh x cos x = 1; a bar of 20 to 1, which shears, against a narrow plate of the same size."""
    young, rho, length = 1.1e10, 430.0, 0.5
    slender = bar_freq(length, 1e-4, rho, young, 1e15, count=5)
    roots = np.array([4.730040745, 7.853204624, 10.99560784, 14.13716549, 17.27875966])
    euler = roots**2 / (2 * np.pi) * 1e-4 / np.sqrt(12) / length**2 * np.sqrt(young / rho)
    assert slender == pytest.approx(euler, rel=2e-5)
    thick = bar_freq(length, 0.025, rho, young, 0.06 * young, count=3)
    assert np.all(thick < euler[:3] * 250)
    narrow = Wood(young, 0.9e9, 0.7e9, 0.0, rho, G_LT=0.06 * young, G_RT=0.06 * young)
    ring = np.array([[0.0, 0.0], [length, 0.0], [length, 0.02], [0.0, 0.02]])
    plate = Plate([ring], narrow, 0.025, FREE, size=length / 30).modes(count=12)
    assert np.min(np.abs(plate.freq / thick[0] - 1)) < 2e-3


def test_a_stick_is_found_again() -> None:
    length, width, height, young, rho = 0.45, 0.008, 0.016, 1.25e10, 410.0
    freq = bar_freq(length, height, rho, young, 0.05 * young, count=3)
    mass = rho * length * width * height
    solution = estimate_stick(
        length, width, height, mass, [*freq, 700.0], 1e-4 * np.append(freq, 700.0), [120.0] * 4, shear_ratio=0.061
    )
    assert pytest.approx(young, rel=0.02) == solution.E_L
    assert solution.loss_L == pytest.approx(1 / 120, rel=1e-6)
    assert solution.peaks_without_mode == (700.0,)
    low, high = solution.intervals["E_L"]
    assert low < young < high
    with pytest.raises(ValueError, match="no peak"):
        estimate_stick(length, width, height, mass, [], [], shear_ratio=0.061)


@pytest.mark.parametrize("sizes", [(2e-4, 0.0), (0.0, 4e-3)])
def test_a_stick_s_interval_is_that_of_its_size(sizes: tuple[float, float]) -> None:
    """At a given mass E follows f^2 L^3 / (w h^3): errors of h thrice, of L thrice and of w once."""
    length, width, height, young, rho = 0.45, 0.008, 0.016, 1.25e10, 410.0
    freq = bar_freq(length, height, rho, young, 0.06 * young, count=4)
    of_height, of_sides = sizes
    found = estimate_stick(
        length, width, height, rho * length * width * height, freq, 1e-7 * freq, shear_ratio=0.06,
        thickness_error=of_height, size_error=of_sides, model_error=0.0,
    )  # fmt: skip
    expected = np.sqrt((3 * of_height / height) ** 2 + (3 * of_sides / length) ** 2 + (of_sides / width) ** 2)
    low, high = found.intervals["E_L"]
    assert np.log(high / low) / (2 * 1.645) == pytest.approx(expected, rel=0.01)
    assert pytest.approx(young, rel=1e-4) == np.sqrt(low * high) == found.E_L
    assert found.measured == pytest.approx(found.computed, rel=1e-6)
    assert len(found.measured) >= 3


def test_a_loss_and_its_interval_are_those_of_least_squares() -> None:
    """1 = eta Q for each peak: eta = sum Q / sum Q^2, its error the scatter of the products over sqrt(sum Q^2)."""
    q = np.array([60.0, 0.0, 100.0, 190.0])
    known = q[q > 0]
    losses, ends = losses_of(q, np.ones((4, 1)), ("loss_L",), fewest=1)
    eta = known.sum() / (known**2).sum()
    scatter = ((1 - eta * known) ** 2).sum() / 2
    error = 1.645 * np.sqrt(scatter / (known**2).sum())
    assert losses["loss_L"] == pytest.approx(eta)
    assert ends["loss_L"] == pytest.approx((eta - error, eta + error), rel=1e-6)
    # a single one, and equal ones: a Q is known to a tenth at best
    assert losses_of(q[:1], np.ones((1, 1)), ("loss_L",), fewest=1)[1]["loss_L"] == pytest.approx(
        ((1 - 0.1645) / 60, (1 + 0.1645) / 60)
    )
    assert losses_of(q, np.ones((4, 1)), ("loss_L",)) == ({}, {})  # four or more


def test_a_table_of_peaks_states_errors_or_is_read_off(tmp_path: Path) -> None:
    """A standard deviation as it is, of an interval of 90 % a part, of nothing 0.2 % of the frequency."""
    text = "# board 7\n\n  # tapped\nf_Hz, Q, sd_Hz\n100, 80, 0.5\n400,,\n ,,\n200, 90,\n1500, 60,\n"
    (tmp_path / "a.csv").write_text(text)
    peaks, _ = read_peaks([tmp_path / "a.csv"], (50.0, 1000.0))
    assert [p.freq for p in peaks] == [100.0, 200.0, 400.0]
    assert [p.error for p in peaks] == pytest.approx([0.5, 0.4, 0.8])
    assert [p.q for p in peaks] == [80.0, 90.0, 0.0]
    (tmp_path / "b.csv").write_text("freq_Hz,freq_low_Hz,freq_high_Hz\n100,98.355,101.645\n")
    assert read_peaks([tmp_path / "b.csv"], (50.0, 1000.0))[0][0].error == pytest.approx(1.0, rel=1e-3)
    for paths, band, said in (
        ([], (50.0, 1000.0), "no file"),
        (["a.csv", "b.csv"], (50.0, 1000.0), "one table"),
        (["a.csv"], (1.0, 2.0), "no peak"),
    ):
        with pytest.raises(TonewoodError, match=said):
            read_peaks([tmp_path / path for path in paths], band)


def test_a_clamped_circle_s_thickness() -> None:
    """A clamped isotropic disc: 10.2158 / (2 pi a^2) sqrt(D / rho h) (Leissa, NASA SP-160, table 2.1)."""
    nu, young, rho, a = 0.3, 1e10, 400.0, 0.2
    disc = Wood(young, young, young / (2 * (1 + nu)), nu, rho)
    h = 2.5e-3
    closed = 10.2158 / (2 * np.pi * a**2) * np.sqrt(young * h**2 / (12 * (1 - nu**2)) / rho)
    assert panel_freq(disc, circle(a), h) == pytest.approx(closed, rel=3e-3)
    assert thickness_for(disc, circle(a), closed) == pytest.approx(h, rel=3e-3)
    with pytest.raises(ValueError, match=r"0\.5 to 20 mm are allowed"):
        thickness_for(disc, circle(a), 1e4)


def test_gore_and_gilet_s_panel_is_a_clamped_rectangle() -> None:
    """Rayleigh's quotient is that of its shape, and above the frequency of the plate itself by less than 3 %."""
    wood, (a, b) = SPECIES["sitka_spruce"].wood, (0.49, 0.39)
    ring = np.array([[0.0, 0.0], [a, 0.0], [a, b], [0.0, b]])
    assert 0.97 * 75 < panel_freq(wood, ring, gore_thickness(wood, a, b, 75.0)) < 75
    h = gore_thickness(wood, a, b, 75.0)
    nu_rl, product = 0.05, 0.02
    d_l, d_r, d_g = (e * h**3 / 12 for e in (wood.E_L / (1 - product), wood.E_R / (1 - product), wood.G_LR))

    def integrals(side: float) -> tuple[float, ...]:
        w = np.polynomial.Polynomial([0.0, 0.0, 1.0]) * np.polynomial.Polynomial([side, -1.0]) ** 2
        pairs = ((w, w), (w.deriv(2), w.deriv(2)), (w, w.deriv(2)), (w.deriv(), w.deriv()))
        return tuple(float((one * other).integ()(side)) for one, other in pairs)

    (x0, x2, x02, x1), (y0, y2, y02, y1) = integrals(a), integrals(b)
    energy = d_l * x2 * y0 + d_r * x0 * y2 + 2 * nu_rl * d_l * x02 * y02 + 4 * d_g * x1 * y1
    assert np.sqrt(energy / (wood.density * h * x0 * y0)) / (2 * np.pi) == pytest.approx(75.0, rel=1e-6)


def test_peaks_of_taps_are_those_of_their_poles(rng: np.random.Generator) -> None:
    fs, time = 16000, np.arange(16000) / 16000
    freq, q = np.array([80.0, 151.0, 233.0, 410.0]), np.array([60.0, 80.0, 50.0, 100.0])
    taps = []
    for _ in range(4):
        parts = rng.normal(1.0, 0.3, 4)[:, None] * np.sin(2 * np.pi * freq[:, None] * time + rng.uniform(0, 6, (4, 1)))
        sound = np.sum(parts * np.exp(-np.pi * freq / q * time[:, None]).T, axis=0)
        taps.append(sound + 1e-3 * rng.normal(size=len(time)))
    peaks = strongest(taps, fs, (50.0, 600.0))
    assert [p.freq for p in peaks] == pytest.approx(freq, rel=1e-3)
    assert [p.quality for p in peaks] == pytest.approx(q, rel=0.08)


def simulated(rectangle: Rectangle, rng: np.random.Generator, thickness_error: float = 5e-5) -> list[bool]:
    """Whether the intervals hold the truth: noise, an error of the thickness, a fifth of the peaks missing."""
    wood = board(rng)
    h = SIZE[2] + rng.normal(0.0, thickness_error)
    true = replace(wood, density=mass_of(wood) / (SIZE[0] * SIZE[1] * h))
    freq = free_plate(true, (SIZE[0], SIZE[1], h), 14)
    freq = freq[rng.random(len(freq)) < 0.8] * np.exp(rng.normal(0.0, 0.004))
    freq = freq * np.exp(rng.normal(0.0, 0.003, len(freq)))
    solution = estimate_board(rectangle, freq, 1e-3 * freq, thickness_error=thickness_error)
    return [a <= getattr(wood, key) <= b for key, (a, b) in solution.intervals.items()]


@pytest.mark.slow
def test_intervals_of_a_few_boards(rectangle: Rectangle) -> None:
    """Three quarters of them at least; the long tier counts 200 boards."""
    rng = np.random.default_rng(20261124)
    inside = [x for _ in range(3) for x in simulated(rectangle, rng)]
    assert np.mean(inside) >= 0.75


@pytest.mark.validate
def test_intervals_hold_the_truth_of_200_boards(rectangle: Rectangle) -> None:
    rng = np.random.default_rng(7)
    inside = np.array([simulated(rectangle, rng) for _ in range(200)])
    print("coverage of 90 % intervals, E_L, E_R, G_LR:", inside.mean(axis=0))
    assert np.all(inside.mean(axis=0) >= 0.85)
    assert inside.mean() <= 0.97


@pytest.mark.skipif(not PLATES.is_dir(), reason="other people's plates are not here")
@pytest.mark.parametrize("name", ["2L", "2R"])
@pytest.mark.slow
def test_measured_plates_of_others(name: str) -> None:
    """Peaks within 1 %; E_L, G_LR within two standard deviations (the authors: 3, 5 %)."""
    row = next(r for r in csv.DictReader((PLATES / "plates.csv").open()) if r["plate"] == name)
    size = [1e-3 * float(row[k]) for k in ("length_mm", "width_mm", "thickness_mm")]
    mass = 1e-3 * float(row["mass_g"])
    taps = np.load(PLATES / f"{name}.npz")["acceleration"]
    peaks = strongest([*taps], 48000, (30.0, 800.0))
    plate = Rectangle.of(*size, mass, typical("sitka_spruce", mass / float(np.prod(size))))
    solution = estimate_board(plate, [p.freq for p in peaks], [p.error for p in peaks], [p.quality for p in peaks])
    assert len(solution.pairs) >= 11
    assert max(abs(p.computed / p.measured - 1) for p in solution.pairs) < 0.01
    for key, sd in (("E_L", 0.03), ("G_LR", 0.05)):
        low, high = solution.intervals[key]
        own = np.log(high / low) / 2 / 1.645
        assert abs(np.log(getattr(solution.wood, key) / float(row[f"authors_{key}_Pa"]))) < 2 * np.hypot(own, sd)


@pytest.mark.skipif(not PLATES.is_dir(), reason="other people's plates are not here")
@pytest.mark.parametrize(
    "every", [pytest.param(600, marks=pytest.mark.slow), pytest.param(100, marks=pytest.mark.validate)]
)
def test_finite_elements_of_others_are_read_back(every: int) -> None:
    """Two, and twelve, of their 1200 plates: constants from frequencies alone, nine in ten within the intervals."""
    rows = list(csv.DictReader((PLATES / "fem_plates.csv").open()))[::every]
    inside = []
    for row in rows:
        freq = np.sort([float(v) for k, v in row.items() if k[0] == "f" and v])[:12]
        size = [float(row[k]) for k in "LWT"]
        mass = float(row["rho"]) * float(np.prod(size))
        plate = Rectangle.of(*size, mass, typical("sitka_spruce", float(row["rho"])))
        solution = estimate_board(plate, freq, 1e-3 * freq)
        true = {"E_L": "Ex", "E_R": "Ey", "G_LR": "Gxy"}
        inside += [a <= float(row[true[key]]) <= b for key, (a, b) in solution.intervals.items()]
    assert np.mean(inside) > 0.8


def test_a_mode_is_named_by_its_energy() -> None:
    """By the constant that has more than four fifths of it, else it is mixed."""
    said = [MatchedPeak(1.0, 1.0, shares, 0.0).kind for shares in ((0.9, 0.0, 0.1), (0.1, 0.85, 0.05), (0.3, 0.0, 0.7))]
    assert said == ["bending along", "bending across", "mixed, most twist"]
