"""Air and sound of plates against the two-oscillator model, pistons and the far field of a hinged plate."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg as sla
from scipy.special import j1

from tonewood.physics.plate.air import AIR_DENSITY, SOUND_SPEED, air_matrices, couple_air, hole_loss
from tonewood.physics.plate.microphones import microphone, pressure
from tonewood.physics.plate.radiation import Sources, gathered_sources

KAPPA = AIR_DENSITY * SOUND_SPEED**2 / 0.0127
HOLE = (np.pi * 0.0425**2, 0.07)
NO_CAVITY = (np.zeros(0), np.zeros((0, 1)), np.zeros(0))


def test_two_oscillators() -> None:
    """Christensen & Vistisen 1980: f+^2 + f-^2 = f_p'^2 + f_h^2 and f+ f- = f_p f_h."""
    plate, volume = 190.0, 0.35
    found = couple_air(np.array([plate]), np.array([volume]), 0.0127, HOLE, NO_CAVITY)
    shut = np.sqrt(plate**2 + KAPPA * volume**2 / (2 * np.pi) ** 2)
    helmholtz = SOUND_SPEED / (2 * np.pi) * np.sqrt(HOLE[0] / (0.0127 * HOLE[1]))
    assert (found.freq**2).sum() == pytest.approx(shut**2 + helmholtz**2, rel=1e-12)
    assert found.freq.prod() == pytest.approx(plate * helmholtz, rel=1e-12)
    assert found.plates[0, 0] * found.hole[0] < 0 < found.plates[0, 1] * found.hole[1]
    assert found.kinetic.sum(axis=0) == pytest.approx(np.ones(2), rel=1e-12)


def random_air(rng: np.random.Generator):
    freq, outward = np.sort(rng.uniform(150, 900, 6)), rng.normal(size=6)
    cavity = (np.array([350.0, 570.0, 750.0]), rng.normal(size=(3, 6)), rng.normal(size=3))
    return freq, outward, cavity


def test_the_cavity_obeys_its_wave_equation(rng: np.random.Generator) -> None:
    """With eta eliminated p'' + omega_m^2 p = -kappa (b q'' + psi Y''), in every coupled mode."""
    freq, outward, cavity = random_air(rng)
    found = couple_air(freq, outward, 0.0127, HOLE, cavity)
    omega = 2 * np.pi * found.freq
    for w, q, y, eta in zip(omega, found.plates.T, found.hole, found.cavity.T, strict=True):
        flow = cavity[1] @ q + cavity[2] * y
        p = -KAPPA * (flow - eta)
        left = ((2 * np.pi * cavity[0]) ** 2 - w**2) * p
        assert left == pytest.approx(KAPPA * w**2 * flow, rel=1e-6, abs=1e-8 * KAPPA * w**2 * np.abs(flow).max())


def test_air_stores_energy(rng: np.random.Generator) -> None:
    for _ in range(20):
        freq, outward, cavity = random_air(rng)
        root = 1e-5 * rng.normal(size=(4, 4))
        mass, stiffness, _ = air_matrices(freq, outward, 0.0127, HOLE, cavity, root @ root.T)
        assert mass.min() > 0
        assert np.abs(stiffness - stiffness.T).max() <= 1e-15 * np.abs(stiffness).max()
        assert sla.eigvalsh(stiffness).min() > -1e-9 * np.abs(stiffness).max()


def test_modes_left_out_yield_to_the_air(rng: np.random.Generator) -> None:
    """Plate modes at 20 kHz and more as a compliance in place of modes: the same frequencies and pressures."""
    freq, outward, cavity = random_air(rng)
    high, more = np.array([2e4, 3e4]), 40 * rng.normal(size=(4, 2))
    whole = couple_air(np.append(freq, high), np.append(outward, more[0]), 0.0127, HOLE,
                       (cavity[0], np.hstack([cavity[1], more[1:]]), cavity[2]))  # fmt: skip
    compliance = (more / (2 * np.pi * high) ** 2) @ more.T
    found = couple_air(freq, outward, 0.0127, HOLE, cavity, compliance)
    bare = couple_air(freq, outward, 0.0127, HOLE, cavity)
    n = 8
    assert found.freq[:n] == pytest.approx(whole.freq[:n], rel=1e-3)
    assert np.abs(bare.freq[:n] / whole.freq[:n] - 1).max() > 5e-3
    assert np.abs(found.pressure[:, :4]) == pytest.approx(np.abs(whole.pressure[:, :4]), rel=2e-2)


def test_friction_in_the_hole() -> None:
    """Q of a Helmholtz resonator by it alone, omega rho L / r, with Stokes' boundary layer of half a millimetre."""
    none = np.zeros(0)
    found = couple_air(none, none, 0.0127, HOLE, (none, np.zeros((0, 0)), none))
    (loss,) = hole_loss(found.freq, found.hole, HOLE[0], 0.0025)
    omega = 2 * np.pi * found.freq[0]
    layer = np.sqrt(2 * 1.5e-5 / omega)
    assert loss == pytest.approx(2 * layer * (1 + 0.0025 / 0.085) / HOLE[1], rel=1e-9)
    assert 100 < 1 / loss < 400


def test_closed_body() -> None:
    """Air only stiffens: f^2 grows by kappa a^2."""
    found = couple_air(np.array([200.0]), np.array([0.4]), 0.0127, None, NO_CAVITY)
    assert (2 * np.pi * found.freq[0]) ** 2 == pytest.approx((2 * np.pi * 200.0) ** 2 + KAPPA * 0.16, rel=1e-12)


def piston(radius: float, size: float = 0.004) -> Sources:
    """A disc of unit velocity, as squares whose parts outside are cut by finer squares."""
    fine = size / 8
    x = np.arange(-radius - size, radius + size, fine) + fine / 2
    points = np.stack(np.meshgrid(x, x), axis=-1).reshape(-1, 2)
    points = points[np.hypot(*points.T) < radius]
    cell = np.floor(points / size).astype(int)
    _, which = np.unique(cell, axis=0, return_inverse=True)
    count = np.bincount(which.ravel())
    centres = np.column_stack([np.bincount(which.ravel(), c) / count for c in points.T])
    area = np.pi * radius**2 * count / count.sum()
    return Sources(centres, area[:, None])


@pytest.mark.parametrize("ka", [0.1, 1.0, 3.0, 10.0])
def test_piston(ka: float) -> None:
    """On its axis |p| = 2 rho c |sin k/2 (sqrt(z^2 + a^2) - z)|; resistance rho c S (1 - J1(2 ka) / ka)."""
    a = 0.1
    disc, k = piston(a), ka / a
    freq = k * SOUND_SPEED / (2 * np.pi)
    p = np.abs(disc.pressure((0.0, 0.0, 1.0), freq)[0, 0]) * 2 * np.pi * freq
    expected = 2 * AIR_DENSITY * SOUND_SPEED * abs(np.sin(k / 2 * (np.sqrt(1 + a * a) - 1)))
    assert 20 * np.log10(p / expected) == pytest.approx(0.0, abs=0.02)
    resistance = AIR_DENSITY * SOUND_SPEED * np.pi * a * a * (1 - j1(2 * ka) / ka)
    assert disc.resistance([freq])[0] == pytest.approx(resistance, rel=3e-3)


def hinged(m: int, n: int, size: float = 0.01) -> Sources:
    x, y = np.meshgrid(np.arange(size / 2, 0.4, size), np.arange(size / 2, 0.3, size), indexing="ij")
    shape = np.sin(m * np.pi * x / 0.4) * np.sin(n * np.pi * y / 0.3)
    return Sources(np.column_stack([x.ravel(), y.ravel()]), shape.ravel()[:, None] * size**2)


@pytest.mark.parametrize(("m", "n", "freq"), [(1, 1, 27.8), (1, 1, 2780.0), (2, 1, 279.0), (2, 1, 1500.0)])
def test_far_field_of_a_hinged_mode(m: int, n: int, freq: float) -> None:
    """C. E. Wallace, J. Acoust. Soc. Am. 51 (1972) 946, Eq. 3: at 20 m, 35 degrees from the normal, within 0.1 dB."""
    k, theta, phi, r = 2 * np.pi * freq / SOUND_SPEED, np.radians(35), np.radians(20), 20.0
    alpha, beta = k * 0.4 * np.sin(theta) * np.cos(phi), k * 0.3 * np.sin(theta) * np.sin(phi)
    parts = [((-1) ** q * np.exp(-1j * u) - 1) / ((u / (q * np.pi)) ** 2 - 1) for q, u in ((m, alpha), (n, beta))]
    expected = AIR_DENSITY * 0.4 * 0.3 / (2 * np.pi * r * m * n * np.pi**2) * abs(parts[0] * parts[1])
    at = r * np.array([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)]) + [0.2, 0.15, 0.0]
    found = abs(hinged(m, n).pressure(at, freq)[0, 0])
    assert 20 * np.log10(found / expected) == pytest.approx(0.0, abs=0.1)


def test_power_is_that_through_a_half_sphere() -> None:
    """1/2 R |v|^2 against the intensity |p|^2 / 2 rho c at 200 m."""
    source, freq = hinged(2, 1), 700.0
    u, w = np.polynomial.legendre.leggauss(16)
    total = 0.0
    for cosine, weight in zip((u + 1) / 2, w / 2, strict=True):
        for phi in np.arange(24) * np.pi / 12 + 0.1:
            sine = np.sqrt(1 - cosine**2)
            at = 200.0 * np.array([sine * np.cos(phi), sine * np.sin(phi), cosine]) + [0.2, 0.15, 0.0]
            p = abs(source.pressure(at, freq)[0, 0]) * 2 * np.pi * freq
            total += weight * np.pi / 12 * 200.0**2 * p**2 / (2 * AIR_DENSITY * SOUND_SPEED)
    assert 0.5 * source.resistance([freq])[0] == pytest.approx(total, rel=2e-3)


def test_free_air_halves_low_pressures_and_powers() -> None:
    disc = piston(0.1)
    open_air = Sources(disc.points, disc.volumes, baffled=False)
    for freq, share in ((2.0, 0.5), (2e5, 1.0)):
        ratio = abs(open_air.pressure((0.0, 0.0, 1.0), freq) / disc.pressure((0.0, 0.0, 1.0), freq))[0, 0]
        assert ratio == pytest.approx(share, rel=2e-3)
    assert open_air.resistance([2.0])[0] == pytest.approx(disc.resistance([2.0])[0] / 2, rel=1e-3)


def test_a_small_box_is_a_source_in_free_air() -> None:
    """At low frequencies top and back, moving outwards, make p = rho (V1 + V2)'' / 4 pi r."""
    disc = piston(0.1)
    behind = np.column_stack([disc.points, np.full(len(disc.points), -0.1)])
    box = Sources(disc.points, disc.volumes, baffled=False, behind=behind, behind_volumes=0.5 * disc.volumes)
    expected = AIR_DENSITY * 1.5 * np.pi * 0.01 / (4 * np.pi * 10.0)
    assert abs(box.pressure((0.0, 0.0, 10.0), 2.0)[0, 0]) == pytest.approx(expected, rel=0.01)


def test_the_back_of_a_box_is_heard_by_what_the_shelf_leaves() -> None:
    """1 - H = (omega_b / 2) / (j omega + omega_b) of the back in a baffle: half of it down low, none up high."""
    disc = piston(0.1)
    behind = np.column_stack([disc.points, np.full(len(disc.points), -0.1)])
    front = Sources(disc.points, disc.volumes, baffled=False)
    box = Sources(disc.points, disc.volumes, baffled=False, behind=behind, behind_volumes=0.5 * disc.volumes)
    alone = Sources(disc.points, 0.5 * disc.volumes)
    omega_b = 2 * 343.0 / np.ptp(disc.points[:, 0])
    freq = np.array([5.0, omega_b / (2 * np.pi), 20000.0])
    back = alone.pressure((0.1, 0.2, 1.1), freq)[0]
    share = 0.5 * omega_b / (2j * np.pi * freq + omega_b)
    heard = box.pressure((0.1, 0.2, 1.0), freq)[0] - front.pressure((0.1, 0.2, 1.0), freq)[0]
    np.testing.assert_allclose(heard, share * back, rtol=0.01)


@pytest.mark.parametrize(("at", "median", "most"), [((0.2, 0.1, 1.0), 0.01, 0.1), ((0.7, 0.5, 0.8), 0.01, 0.1)])
def test_a_bank_follows_the_rayleigh_sum(at, median: float, most: float) -> None:
    """Of a hinged plate's first modes, driven at two points: error in dB over frequency, and nothing at rest."""
    orders = [(m, n) for m in range(1, 13) for n in range(1, 10)]
    freq = np.array([25.0 * m * m + 45.0 * n * n for m, n in orders])
    sources = Sources(hinged(1, 1).points, np.hstack([hinged(m, n).volumes for m, n in orders]), baffled=False)
    shapes = np.array(
        [[4 * np.sin(m * np.pi * x) * np.sin(n * np.pi * y) for m, n in orders] for x, y in ((0.3, 0.4), (0.62, 0.8))]
    )
    poles = 2 * np.pi * freq * (-0.01 + 1j * np.sqrt(1 - 1e-4))
    bank = microphone(sources, at, poles, shapes, 20000.0)
    f = np.geomspace(60.0, 3000.0, 777)
    exact = pressure(sources, at, poles, shapes, f, bank.delay)
    error = 20 * np.log10(1 + np.abs(bank.response(f) / exact - 1))
    assert np.median(error) < median
    assert np.percentile(error, 95) < most
    assert bank.delay == pytest.approx(sources.distances(at).min() / SOUND_SPEED)
    low = np.abs(bank.response([0.0, 1.0]))
    assert low.max() < 1e-4 * np.abs(exact).max()


def test_sources_gathered_in_squares_keep_area_moment_and_volume(rng: np.random.Generator) -> None:
    points, weights, shapes = rng.uniform(-0.1, 0.2, (500, 2)), rng.uniform(1e-5, 2e-5, 500), rng.normal(size=(500, 3))
    centres, area, volumes = gathered_sources(points, weights, shapes, 0.05)
    assert len(area) <= 49
    assert area.sum() == pytest.approx(weights.sum(), rel=1e-12)
    assert area @ centres == pytest.approx(weights @ points, rel=1e-10)
    assert volumes.sum(axis=0) == pytest.approx(weights @ shapes, rel=1e-9)
    corner = points.min(axis=0)
    cells = np.floor((centres - corner) / 0.05)  # each centre lies in a square of its own, with all points of that
    assert len(np.unique(cells, axis=0)) == len(area)
    for cell, one, volume in zip(cells, area, volumes, strict=True):
        inside = np.all(np.floor((points - corner) / 0.05) == cell, axis=1)
        assert one == pytest.approx(weights[inside].sum(), rel=1e-12)
        assert volume == pytest.approx(weights[inside] @ shapes[inside], rel=1e-9, abs=1e-18)


def test_pressure_is_reciprocal() -> None:
    """Source and listener may change places."""
    one = Sources(np.array([[0.1, 0.2]]), np.array([[1.0]]))
    other = Sources(np.array([[0.4, -0.3]]), np.array([[1.0]]))
    there, back = one.pressure((0.4, -0.3, 0.0), 440.0), other.pressure((0.1, 0.2, 0.0), 440.0)
    assert there == pytest.approx(back, rel=1e-14)
