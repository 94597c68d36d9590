"""Constants of boards whose modes do not mix, so that each is of closed form; pairs, priors, losses, bars, peaks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import brentq

from tonewood.errors import TonewoodError
from tonewood.physics.plate.wood import Wood
from tonewood.workshop.wood import board, stick, thickness
from tonewood.workshop.wood.board import _paired, _Problem, estimate_board, losses_of, sorted_peaks, typical
from tonewood.workshop.wood.peaks import BoardPeak, read_peaks
from tonewood.workshop.wood.rectangle import Rectangle, stiffness_constants, wood_with
from tonewood.workshop.wood.stick import bar_freq, estimate_stick

NOMINAL = typical("sitka_spruce", 420.0)
#: kinds of its modes: constant of `stiffness_constants`, and Hz of the nominal wood
MODES = [(0, 60.0), (3, 45.0), (1, 95.0), (3, 110.0), (0, 165.0), (1, 262.0), (3, 190.0), (0, 324.0), (3, 300.0)]


def plate(modes=MODES, corner=1.0) -> Rectangle:
    """Three rigid modes, and modes each of one constant alone."""
    parts = np.zeros((6, 3 + len(modes), 3 + len(modes)))
    for k, (i, f) in enumerate(modes, 3):
        parts[i, k, k] = (2 * np.pi * f) ** 2
    return Rectangle(0.5, 0.2, 4e-3, 0.168, NOMINAL, parts, np.append(np.zeros(3), np.full(len(modes), corner)))


def freq_of(wood, h=4e-3, modes=MODES):
    """Hz in order, by hand: f^2 in proportion to its constant times h^3 at one mass."""
    ratio = stiffness_constants(wood) / stiffness_constants(NOMINAL) * (h / 4e-3) ** np.array([3, 3, 3, 3, 1, 1])
    return np.sort([f * np.sqrt(ratio[i]) for i, f in modes])


def test_constants_of_plane_stress_and_back() -> None:
    wood = Wood(1.2e10, 9e8, 8e8, 0.37, 410.0, G_LT=7e8, G_RT=6e7)
    free = 1 - 0.37**2 * 9e8 / 1.2e10
    wanted = [1.2e10 / free, 9e8 / free, 0.37 * 9e8 / free, 8e8, 7e8, 6e7]
    assert stiffness_constants(wood) == pytest.approx(wanted)
    back = wood_with(np.array(wanted), 410.0)
    for name in ("E_L", "E_R", "G_LR", "nu_LR", "density", "G_LT", "G_RT"):
        assert getattr(back, name) == pytest.approx(getattr(wood, name))


def test_modes_of_a_board_follow_its_constants_thickness_and_sensor() -> None:
    wood = wood_with(stiffness_constants(NOMINAL) * [1.2, 0.8, 1.0, 1.5, 1.0, 1.0], 420.0)
    whole = plate()
    for h in (4e-3, 4.4e-3):
        freq, shares = whole.solution(wood, h)
        assert freq == pytest.approx(freq_of(wood, h))
        assert shares.sum(axis=0) == pytest.approx(1.0)
        assert sorted(np.argmax(shares, axis=0).tolist()) == sorted(i for i, _ in MODES)
    one = plate(MODES[:1], 2.0)
    assert one.solution(NOMINAL, sensor=0.01)[0] == pytest.approx([60.0 / np.sqrt(1 + 0.01 * 4.0)])
    two = plate(MODES[:2], 2.0)  # against K - w^2 (1 + m phi phi^T)
    mass = np.eye(2) + 0.01 * np.full((2, 2), 4.0)
    stiff = np.diag([(2 * np.pi * f) ** 2 for _, f in MODES[:2]])
    wanted = np.sqrt(np.sort(np.linalg.eigvals(np.linalg.solve(mass, stiff)).real)) / 2 / np.pi
    assert two.solution(NOMINAL, sensor=0.01)[0] == pytest.approx(wanted)
    shear = plate([(4, 80.0), (5, 90.0)])
    thick = shear.solution(NOMINAL, 5e-3)[0]
    assert thick == pytest.approx(np.array([80.0, 90.0]) * np.sqrt(1.25))  # shear grows with h, bending with h^3


def test_a_board_of_closed_form_is_found_again() -> None:
    """A peak too many, one too few; a looser thickness and size widen intervals by what they change."""
    wood = wood_with(stiffness_constants(NOMINAL) * [1.15, 0.9, 1.0, 1.2, 1.0, 1.0], 420.0)
    freq = freq_of(wood)
    peaks = np.append(np.delete(freq, 4), 77.7)[::-1]
    q = np.append(np.delete(100 + np.arange(9.0), 4), 0.0)[::-1]
    found = estimate_board(plate(), peaks, 1e-3 * peaks, q, sensor=0.0, size_error=0.0)
    for name in ("E_L", "E_R", "G_LR"):
        low, high = found.intervals[name]
        assert getattr(found.wood, name) == pytest.approx(getattr(wood, name), rel=0.02)
        assert low < getattr(found.wood, name) < high
        assert low * high == pytest.approx(getattr(found.wood, name) ** 2)
    assert found.wood.density == 420.0
    assert found.peaks_without_mode == (77.7,)
    assert found.modes_without_peak == pytest.approx([freq[4]], rel=0.01)
    assert [p.measured for p in found.pairs] == np.delete(freq, 4).tolist()
    assert [p.q for p in found.pairs] == np.delete(100 + np.arange(9.0), 4).tolist()
    assert found.misfit == pytest.approx(np.sqrt(np.mean([np.log(p.measured / p.computed) ** 2 for p in found.pairs])))
    assert {p.kind for p in found.pairs} == {"bending along", "bending across", "twist"}
    wide = estimate_board(plate(), peaks, 1e-3 * peaks, sensor=0.0, size_error=2e-3)
    for name, more in (
        ("E_L", np.hypot(3 * 0.004, 0.01)),
        ("E_R", np.hypot(0.004, 0.03)),
        ("G_LR", np.hypot(0.004, 0.01)),
    ):
        narrow, broad = (np.log(b / a) / 2 / 1.645 for a, b in (found.intervals[name], wide.intervals[name]))
        assert broad == pytest.approx(np.hypot(narrow, more), rel=1e-6)
    assert {"loss_L", "loss_R", "loss_shear"} <= set(found.intervals)
    assert not set(wide.intervals) - {"E_L", "E_R", "G_LR"}
    with pytest.raises(ValueError, match="2 peaks; 3 or more are wanted"):
        estimate_board(plate(), peaks[:2], peaks[:2])
    with pytest.raises(ValueError, match="fewer than three peaks fit any wood"):
        estimate_board(plate(), [2000.0, 3000.0, 4000.0], [1.0] * 3, sensor=0.0)


def test_a_thickness_that_is_not_known_widens_the_constants_threefold() -> None:
    """f^2 goes with E h^3: the interval of each is three relative errors of the thickness."""
    freq = freq_of(NOMINAL)
    spread = {}
    for error in (1e-9, 8e-5):
        found = estimate_board(
            plate(), freq, 1e-6 * freq, sensor=0.0, thickness_error=error, size_error=0.0, model_error=1e-4
        )
        spread[error] = [np.log(b / a) / 2 / 1.645 for a, b in found.intervals.values()]
    assert spread[8e-5] == pytest.approx([3 * 8e-5 / 4e-3] * 3, rel=0.1)
    assert max(spread[1e-9]) < 0.02


def test_the_problem_of_a_board_has_its_priors() -> None:
    problem = _Problem(plate(), 1e-4, NOMINAL, 2e-3, 5e-4)
    n = NOMINAL
    wanted = [np.log(n.E_L), np.log(n.E_R), np.log(n.G_LR), n.nu_LR, np.log(n.G_LT / n.E_L), np.log(n.G_RT / n.E_L)]
    assert problem.mean == pytest.approx([*wanted, np.log(4e-3), 2e-3])
    assert problem.sd == pytest.approx([0.5, 0.6, 0.7, 0.08, 0.5, 0.7, 0.025, 5e-4])
    wood, h, sensor = problem.wood(problem.mean)
    for name in ("E_L", "E_R", "G_LR", "nu_LR", "G_LT", "G_RT"):
        assert getattr(wood, name) == pytest.approx(getattr(n, name))
    assert (h, sensor) == pytest.approx((4e-3, 2e-3))
    odd = problem.mean + np.array([0, 0, 0, 50.0, 0, 0, 0, -1.0])
    wood, _, sensor = problem.wood(odd)
    assert wood.nu_LR == pytest.approx(0.9 * np.sqrt(n.E_L / n.E_R))
    assert sensor == -2e-4
    assert problem.wood(problem.mean - np.array([0, 0, 0, 9.0, 0, 0, 0, 0]))[0].nu_LR == 0.01
    bare = _Problem(plate(), 1e-4, NOMINAL, 0.0)
    peaks, spread = freq_of(NOMINAL)[:2] * 1.01, np.array([0.01, 0.02])
    both = (np.arange(2), np.arange(2))
    assert bare.squares(bare.mean, both, peaks, spread) == pytest.approx(np.log(1.01) ** 2 * (1e4 + 2500), rel=1e-6)
    away = bare.mean + np.array([0.5, 0, 0, 0.08, 0, 0, 0, 0])
    assert bare.squares(away, (np.zeros(0, int), np.zeros(0, int)), peaks, spread) == pytest.approx(2.0)
    # ln f by ln G_LR is a half for a twisting mode, by ln h three halves
    jacobian, f = bare._slopes(bare.mean, np.array([0]))
    assert f == pytest.approx([np.log(45.0)])
    assert jacobian[0, [2, 6]] == pytest.approx([0.5, 1.5], rel=1e-5)
    assert abs(jacobian[0, 0]) < 1e-6
    covariance = bare.covariance(bare.mean, np.array([0]), np.array([0.01]), np.array([0.0]))
    information = np.outer(jacobian[0], jacobian[0]) * 1e4 + np.diag(1 / bare.sd**2)
    assert covariance == pytest.approx(np.linalg.inv(information), rel=1e-5, abs=1e-12)
    worse = bare.covariance(bare.mean, np.array([0]), np.array([0.01]), np.array([0.03]))
    information = np.outer(jacobian[0], jacobian[0]) * 1e4 / 9 + np.diag(1 / bare.sd**2)
    assert worse == pytest.approx(np.linalg.inv(information), rel=1e-5, abs=1e-12)


def test_peaks_and_modes_are_paired_at_least_cost() -> None:
    modes = np.log([100.0, 150.0, 200.0, 300.0, 400.0])
    peaks = np.log([101.0, 170.0, 299.0])
    (i, j), cost = _paired(peaks, modes, 0.02)
    assert (i.tolist(), j.tolist()) == ([0, 2], [0, 3])
    near = (np.log(1.01) / 0.02) ** 2 + (np.log(299 / 300) / 0.02) ** 2
    assert cost == pytest.approx(near + 9.0 + 1.0)  # a peak without a mode; of three modes below 299 Hz two have none
    (i, j), cost = _paired(peaks[1:2], modes, 0.02)
    assert (len(i), cost) == (0, 9.0)


def test_a_sensor_is_taken_into_account_where_it_explains_the_board() -> None:
    """0.1 m phi^2 differs by mode, so that no other constants give these frequencies."""
    rows = plate()
    corner = rows.corner.copy()
    corner[3:] = [1.0, 4.0, 2.0, 5.0, 1.0, 3.0, 4.5, 0.5, 5.0]
    rows = replace(rows, corner=corner)
    freq = rows.solution(NOMINAL, sensor=4e-3)[0]
    found = estimate_board(rows, freq, 1e-4 * freq, model_error=1e-3)
    assert found.sensor == pytest.approx(4e-3, rel=0.2)
    free = rows.solution(NOMINAL)[0]
    assert estimate_board(rows, free, 1e-4 * free, model_error=1e-3).sensor == 0.0


def test_losses_are_sums_over_shares() -> None:
    shares = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.5, 0.5, 0.0], [0.2, 0.3, 0.5]])
    eta = np.array([0.01, 0.03, 0.02])
    losses, ends = losses_of(1 / (shares @ eta), shares, board.LOSSES)
    assert list(losses.values()) == pytest.approx(eta)
    rows = shares / (shares @ eta)[:, None]
    error = 1.645 * 0.1 * np.sqrt(np.diag(np.linalg.inv(rows.T @ rows)))
    for name, at, by in zip(board.LOSSES, eta, error, strict=True):
        assert ends[name] == pytest.approx((max(at - by, 0.0), at + by))
    assert losses_of(np.array([100.0, 90.0, 80.0, 0.0]), shares[:4], board.LOSSES) == ({}, {})
    assert losses_of(np.array([100.0, 90.0, 80.0]), shares[:3], board.LOSSES, fewest=3)[0]
    assert losses_of(np.array([100.0, 90.0]), shares[:2], board.LOSSES, fewest=1) == ({}, {})


def test_peaks_are_put_in_order_with_their_spread() -> None:
    peaks, spread, q = sorted_peaks([200.0, 100.0], [2.0, 3.0], [50.0, 0.0], 0.004)
    assert (peaks.tolist(), q.tolist()) == ([100.0, 200.0], [0.0, 50.0])
    assert spread == pytest.approx(np.hypot([0.03, 0.01], 0.004))
    assert sorted_peaks([200.0, 100.0], [2.0, 3.0], [], 0.004)[2].tolist() == [0.0, 0.0]
    assert typical("sitka_spruce", 333.0).density == 333.0


# sticks


@pytest.mark.parametrize("count", [1, 3])
def test_a_thick_bar_is_timoshenko_s(count) -> None:
    """Boundary conditions M = Q = 0 of both ends, written as a determinant over the waves along the bar."""
    length, h, rho, young, shear = 0.3, 0.02, 420.0, 1.1e10, 6e8
    found = bar_freq(length, h, rho, young, shear, count=count)
    area, inertia, k = h, h**3 / 12, 5 / 6  # per width

    def determinant(f):
        w = 2 * np.pi * f
        # waves exp(lambda x): kGA (y'' - phi') + rho A w^2 y = 0, E I phi'' + kGA (y' - phi) + rho I w^2 phi = 0
        a, b, c = k * shear * area, young * inertia, rho * w**2
        squares = np.roots([a * b, a * c * inertia + b * c * area, (c * inertia - a) * c * area])
        roots = np.concatenate([np.sqrt(squares + 0j), -np.sqrt(squares + 0j)])
        phi = (a * roots**2 + c * area) / (a * roots)
        rows = [np.exp(roots * x) * value for x in (0.0, length) for value in (phi * roots, roots - phi)]
        size = np.exp(np.abs(roots.real) * length)
        value = np.linalg.det(np.array(rows) / size)
        return value

    for f in found:
        near = np.linspace(0.999 * f, 1.001 * f, 9)
        values = np.array([determinant(x) for x in near])
        turn = values / values[np.argmax(np.abs(values))]
        assert np.sign(turn.real[0]) == -np.sign(turn.real[-1])
        zero = brentq(
            lambda x, way: (determinant(x) / way).real, near[0], near[-1], (values[np.argmax(np.abs(values))],)
        )
        assert zero == pytest.approx(f, rel=1e-6)
    assert len(found) == count


def test_two_peaks_by_one_mode_leave_the_farther() -> None:
    length, width, height, young, rho = 0.45, 0.008, 0.016, 1.2e10, 410.0
    freq = bar_freq(length, height, rho, young, 0.06 * young, count=3)
    mass = rho * length * width * height
    peaks = np.array([freq[0], freq[1], 1.06 * freq[1], freq[2]])
    found = estimate_stick(length, width, height, mass, peaks, 1e-4 * peaks, shear_ratio=0.06)
    assert found.peaks_without_mode == pytest.approx([1.06 * freq[1]])
    assert pytest.approx(young, rel=0.01) == found.E_L
    assert found.density == pytest.approx(rho)
    assert found.loss_L is None
    assert list(found.intervals) == ["E_L"]
    far = np.array([freq[0], 1.13 * freq[1]])
    assert estimate_stick(length, width, height, mass, far, 1e-4 * far, shear_ratio=0.06).peaks_without_mode == (
        far[1],
    )
    one = estimate_stick(
        length, width, height, mass, freq[:1], [0.0], shear_ratio=0.06, size_error=0.0, thickness_error=0.0
    )
    low, high = one.intervals["E_L"]
    assert low < young < high
    at = stick._nearest(
        np.array([1.0, 1.1, 1.3]), np.array([1.08, 2.0]), np.array([0, 0, 0]), np.array([True, True, False]), 0
    )
    assert at == 1


# thickness and peaks


def test_a_thickness_follows_its_frequency(monkeypatch) -> None:
    """Of a panel whose frequency is 20 Hz a millimetre: within 0.5 and 20 mm, both included."""
    monkeypatch.setattr(thickness, "panel_freq", lambda wood, outline, h: 2e4 * h)
    for freq, h in ((60.0, 3e-3), (10.0, 5e-4), (400.0, 2e-2)):
        assert thickness.thickness_for(NOMINAL, None, freq) == pytest.approx(h)
    for freq, said in ((9.9, "0.49"), (401.0, "20")):
        with pytest.raises(ValueError, match=f"{freq:g} Hz would need {said}"):
            thickness.thickness_for(NOMINAL, None, freq)
    monkeypatch.setattr(thickness, "panel_freq", lambda wood, outline, h: 4e4 * h**1.1)
    assert 4e4 * thickness.thickness_for(NOMINAL, None, 60.0) ** 1.1 == pytest.approx(60.0, rel=1e-5)
    assert set(thickness.TARGETS) == {"classical_top", "steel_string_top", "classical_back", "steel_string_back"}


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("a,b\n1,2\n", "no column freq_Hz; there are a, b"),
        ("", "no column freq_Hz; there are none"),
        ("freq_Hz\n100\n0\n", "row 3: is '0'; a number above 0 is allowed"),
        ("freq_Hz,Q\n100,-1\n", "row 2: is '-1'"),
        ("freq_Hz\n1000000\n", "row 2"),
        ("freq_Hz\nten\n", "row 2: is 'ten'"),
        ("freq_Hz\n51,5\n75,0\n", "row 2: has 2 cells under 1 names; decimal points"),
        ("freq_Hz,Q\n100,80\n,85\n", "row 3: has no frequency"),
        ("freq_Hz,Q\n100,80\n200,85\n100,85\n", "row 4: lists 100 Hz a second time"),
        ("freq_Hz,freq_low_Hz,freq_high_Hz\n100,101,99\n", "row 2: freq_low_Hz is above freq_high_Hz"),
    ],
)
def test_tables_that_are_refused(tmp_path, text, said) -> None:
    (tmp_path / "t.csv").write_text(text)
    with pytest.raises(TonewoodError, match=said):
        read_peaks([tmp_path / "t.csv"], (50.0, 1e6))


def test_peaks_at_both_ends_of_the_band_count(tmp_path) -> None:
    (tmp_path / "t.csv").write_text(
        "Hz,q,error_Hz,freq_low_Hz,freq_high_Hz\n300,9,2,,\n50,,,49,\n100,,5,99,101\n301,,,,\n49.9,,,,\n"
    )
    inside, outside = read_peaks([tmp_path / "t.csv"], (50.0, 300.0))
    assert inside == [BoardPeak(50.0, 0.1), BoardPeak(100.0, pytest.approx(1 / 1.6449)), BoardPeak(300.0, 2.0, 9.0)]
    assert outside == [49.9, 301.0]


def test_a_shear_modulus_that_is_not_known_widens_a_stick_s_interval() -> None:
    """One peak: ln f = ln E / 2 + b ln (G / E), with 0.4 for the deviation of the latter."""
    length, width, height, young, rho = 0.25, 0.02, 0.02, 1.2e10, 410.0
    freq = bar_freq(length, height, rho, young, 0.06 * young, count=1)
    size = {"size_error": 0.0, "thickness_error": 0.0}
    found = estimate_stick(
        length, width, height, rho * length * width * height, freq, 1e-2 * freq, shear_ratio=0.06, **size
    )
    less, more = (bar_freq(length, height, rho, young, 0.06 * young * np.exp(by), count=1)[0] for by in (-1e-3, 1e-3))
    slope = np.log(more / less) / 2e-3
    low, high = found.intervals["E_L"]
    assert np.log(high / low) / 2 / 1.645 == pytest.approx(2 * np.sqrt(1e-4 + 0.004**2 + (0.4 * slope) ** 2), rel=1e-3)
    assert 0.4 * slope > 0.01
