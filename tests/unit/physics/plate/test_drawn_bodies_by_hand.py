"""Radiation, air and whole drawn bodies, by values worked out by hand."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import scipy.linalg as sla
from plates_by_hand import SPRUCE, SQUARE

from tonewood.physics.plate import plate_parts
from tonewood.physics.plate.air import AIR_DENSITY, SOUND_SPEED, air_matrices, cavity_modes, couple_air
from tonewood.physics.plate.beams import Beam
from tonewood.physics.plate.body import (
    BodyDrawing,
    PlateDrawing,
    body_modes,
    cell_of,
    first_modes,
    made_plate,
    mouth_of,
    opening_of,
    point_loads,
)
from tonewood.physics.plate.figures import draw_shapes
from tonewood.physics.plate.microphones import Bank, _frequencies, microphone, pressure
from tonewood.physics.plate.outline import (
    circle,
)
from tonewood.physics.plate.plate import CLAMPED, FREE, HINGED, Edge, Plate, cell_size
from tonewood.physics.plate.radiation import Sources, gathered_sources
from tonewood.physics.plate.tracking import followed
from tonewood.physics.plate.two_oscillators import displaced_volumes, pressure_shapes
from tonewood.physics.plate.whole_body import Lump, WholeBody, body_change, with_cells
from tonewood.physics.plate.wood import SPECIES

# -- air ---------------------------------------------------------------------------------------------------------------


def test_a_single_source_is_a_point_source_on_a_wall() -> None:
    """p = rho V'' exp(-j k R) / 2 pi R; R = rho omega^2 V^2 / 2 pi c; two of them with sin(k d) / k d."""
    still = [0.0, 0.0]
    source = Sources(np.array([[0.3, 0.4], [9.0, 9.0]]), np.array([[2e-3, -1e-3], still]), labels=("A0", "plate"))
    at, freq = (0.0, 0.0, 1.2), np.array([100.0, 700.0])
    assert source.distances(at)[0] == pytest.approx(1.3)
    k = 2 * np.pi * freq / SOUND_SPEED
    expected = AIR_DENSITY * 2e-3 / (2 * np.pi * 1.3) * np.exp(-1j * k * 1.3)
    np.testing.assert_allclose(source.pressure(at, freq)[0], expected, rtol=1e-12)
    np.testing.assert_allclose(source.pressure(at, freq, 1.3 / SOUND_SPEED)[1], -np.abs(expected) / 2, rtol=1e-9)
    alone = AIR_DENSITY * (2 * np.pi * freq) ** 2 * np.array([2e-3, -1e-3]) ** 2 / (2 * np.pi * SOUND_SPEED)
    np.testing.assert_allclose(source.resistance(freq, exact=True), alone, rtol=1e-9)
    pair = Sources(np.array([[0.0, 0.0], [0.3, 0.0]]), np.array([[1.0], [1.0]]))
    for exact, within in ((True, 1e-12), (False, 1e-5)):
        found = pair.resistance([700.0], exact=exact)[0]
        both = 2 + 2 * np.sin(k[1] * 0.3) / (k[1] * 0.3)
        assert found == pytest.approx(
            AIR_DENSITY * (2 * np.pi * 700) ** 2 / (2 * np.pi * SOUND_SPEED) * both, rel=within
        )
    open_air = replace(pair, baffled=False)
    assert open_air.shelf == pytest.approx(2 * SOUND_SPEED / 0.3)
    assert open_air.shelf_at(np.array([0.0, open_air.shelf])) == pytest.approx([0.5, 0.75])
    corner = open_air.shelf / (2 * np.pi)
    assert open_air.resistance([corner])[0] == pytest.approx(0.75 * pair.resistance([corner])[0], rel=1e-6)
    ratio = open_air.pressure(at, corner) / pair.pressure(at, corner)
    assert ratio[0, 0] == pytest.approx((1j + 0.5) / (1j + 1))
    some = source.of(np.array([False, True]))
    assert (some.volumes.tolist(), some.labels, some.behind_volumes.size) == ([[-1e-3], [0.0]], ("plate",), 0)
    behind = replace(source, labels=(), behind=np.array([[0.0, 0.4, -0.5]]), behind_volumes=np.array([[3.0, 4.0]]))
    assert behind.of(np.array([True, False])).behind_volumes.tolist() == [[3.0]]
    assert behind.distances_behind((0.0, 0.0, 0.0)) == pytest.approx([np.sqrt(0.41)])
    box = replace(behind, baffled=False)
    turned = box.pressure(at, freq) * np.exp(2j * np.pi * freq * 2e-3)
    np.testing.assert_allclose(box.pressure(at, freq, 2e-3), turned, rtol=1e-9)
    many = Sources(np.array([[0.01 * i, 0.0] for i in range(130)]), np.ones((130, 1)))  # more than a block
    apart = 0.01 * np.abs(np.subtract.outer(np.arange(130), np.arange(130)))
    total = np.sinc(k[1] * apart / np.pi).sum() * AIR_DENSITY * (2 * np.pi * 700) ** 2 / (2 * np.pi * SOUND_SPEED)
    assert many.resistance([700.0])[0] == pytest.approx(total, rel=1e-5)


def test_a_bank_is_its_partial_fractions() -> None:
    poles, residues = np.array([-5 + 300j, -40.0]), np.array([[2 - 1j, 3.0], [0.5, 1.0]])
    bank = Bank(poles, residues, 0.0, (0.0, 0.0))
    s = 2j * np.pi * 70.0
    expected = residues[0] / (s - poles[0]) + residues[0].conj() / (s - poles[0].conj()) + residues[1] / (s + 40.0)
    np.testing.assert_allclose(bank.response(70.0), [expected], rtol=1e-12)


def test_pressure_of_a_mode_at_a_microphone() -> None:
    source, pole = Sources(np.array([[0.0, 0.0]]), np.array([[2e-3]])), np.array([-5 + 900j])
    s = 2j * np.pi * np.array([100.0, 143.0])
    found = pressure(source, (0.0, 0.0, 2.0), pole, np.array([[3.0], [-1.0]]), np.array([100.0, 143.0]), 1e-3)
    gain = AIR_DENSITY * 2e-3 / (4 * np.pi) * np.exp(-s * (2.0 / SOUND_SPEED - 1e-3))
    expected = gain * s**2 / ((s - pole[0]) * (s - pole[0].conj()))
    np.testing.assert_allclose(found, np.outer(expected, [3.0, -1.0]), rtol=1e-12)
    freq = _frequencies(2 * np.pi * np.array([-2 + 300j, -1 + 6000j]), 5000.0)
    assert (freq[0], freq[-1], len(freq)) == (pytest.approx(5.0), pytest.approx(5000.0), 1207)
    for off in (-2, -1, -0.5, 0, 0.5, 1, 2):
        assert np.abs(freq - (abs(-2 + 300j) + 2 * off)).min() < 1e-9
    modes = 2 * np.pi * np.array([300.0, 520.0, 800.0]) * (-0.01 + 1j)
    wide = Sources(
        np.array([[0.0, 0.0], [0.2, 0.1]]), 1e-3 * np.array([[1.0, 2.0, -1.0], [2.0, -1.0, 0.5]]), baffled=False
    )
    bank = microphone(wide, (0.0, 0.0, 1.0), modes, np.ones((1, 3)), 10000.0)
    np.testing.assert_array_equal(bank.poles[:3], modes)
    assert bank.poles[3] == pytest.approx(-wide.shelf)
    assert not bank.residues[3].imag.any()
    fitted = _frequencies(modes, 10000.0)
    fitted = fitted[(fitted >= 50.0) & (fitted <= np.abs(modes).max() / (2 * np.pi))]
    wanted = pressure(wide, (0.0, 0.0, 1.0), modes, np.ones((1, 3)), fitted, bank.delay)
    off = 20 * np.log10(1 + np.abs(bank.response(fitted) / wanted - 1))
    assert bank.error_db == pytest.approx((np.median(off), np.percentile(off, 95)), rel=1e-6)
    assert bank.error_db[0] < 0.2
    f = np.geomspace(60, 780, 50)
    exact = pressure(wide, (0.0, 0.0, 1.0), modes, np.ones((1, 3)), f, bank.delay)
    assert np.median(np.abs(bank.response(f) / exact - 1)) < 0.03
    late = microphone(wide, (0.0, 0.0, 1.0), modes, np.ones((1, 3)), 10000.0, delay=0.0)
    assert late.delay == 0.0
    turned = np.exp(-2j * np.pi * f * bank.delay)[:, None]
    assert np.median(np.abs(late.response(f) / (exact * turned) - 1)) < 0.05


def test_air_of_one_plate_mode_and_one_of_the_cavity_by_hand() -> None:
    kappa, w = AIR_DENSITY * SOUND_SPEED**2 / 0.02, 2 * np.pi * 200.0
    cavity = (np.array([400.0]), np.array([[0.3]]), np.array([0.7]))
    mass, stiffness, pressures = air_matrices(np.array([200.0]), np.array([0.5]), 0.02, (0.005, 0.06), cavity)
    np.testing.assert_allclose(mass, [1.0, AIR_DENSITY * 0.06 / 0.005, kappa / (2 * np.pi * 400) ** 2])
    rows = np.array([[0.5, 1.0, 0.0], [0.3, 0.7, -1.0]])
    np.testing.assert_allclose(stiffness, kappa * rows.T @ rows + np.diag([w * w, 0, 0]))
    np.testing.assert_allclose(pressures, -kappa * rows)
    modes = couple_air(np.array([200.0]), np.array([0.5]), 0.02, (0.005, 0.06), cavity)
    values, vectors = sla.eigh(stiffness, np.diag(mass))
    np.testing.assert_allclose(modes.freq, np.sqrt(np.abs(values)) / (2 * np.pi), atol=1e-4)
    got = np.vstack([modes.plates, modes.hole, modes.cavity])
    np.testing.assert_allclose(np.abs(got), np.abs(vectors), rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(modes.kinetic, mass[:, None] * vectors**2, atol=1e-9)
    np.testing.assert_allclose(modes.stored[0, 1:], (w * vectors[0, 1:]) ** 2 / values[1:], rtol=1e-6)
    np.testing.assert_allclose(modes.pressure, pressures @ got, rtol=1e-9)
    shut = couple_air(np.array([200.0]), np.array([0.5]), 0.02, None, (np.zeros(0), np.zeros((0, 1)), np.zeros(0)))
    assert (shut.hole.tolist(), shut.kinetic.tolist()) == ([0.0], [[1.0], [0.0], [0.0]])


def test_shapes_of_a_cavity_have_a_mean_square_of_one() -> None:
    ring = SQUARE * [0.5, 0.3]
    cavity = cavity_modes(ring, 0.1, 900.0)
    c = SOUND_SPEED / 2
    m, n = np.array([[1, 0, 1, 2, 2], [0, 1, 1, 0, 1]])
    np.testing.assert_allclose(cavity.freq, c * np.hypot(m / 0.5, n / 0.3), rtol=1e-4)
    assert cavity.volume == pytest.approx(0.015)
    points = np.array([[0.0, 0.1], [0.25, 0.1], [0.5, 0.0]])
    first = cavity.shapes(points)[:, 0]
    np.testing.assert_allclose(first / first[0], [1.0, 0.0, -1.0], atol=1e-3)
    assert abs(first[0]) == pytest.approx(np.sqrt(2.0), rel=1e-3)  # cos^2 has a mean of 1/2
    assert cavity_modes(ring, 0.2, 900.0).volume == pytest.approx(0.03)
    with pytest.raises(ValueError, match="read-only"):
        cavity.freq[0] = 1.0


def test_volumes_and_pressures_of_two_oscillators_by_hand() -> None:
    freq, loss = np.array([60.0, 100.0, 200.0, 950.0, 1000.0]), np.array([0.03, 0.03, 0.03, 0.02, 0.001])
    bridge, signs = np.array([1.0, 1.3, 3.5, 1.0, 2.0]), np.array([[1, 1, 1, -1, 1], [1, 1, 1, 1, -1.0]])
    heard = pressure_shapes(freq, loss, bridge, (1, 2), 0.013, 3.0, 0.004, signs)
    volumes = displaced_volumes((100.0, 200.0), (1.3, 3.5), 0.013)
    assert heard[:, 0].tolist() == [0.0, 0.0]
    np.testing.assert_allclose(heard[:, 1:3], [AIR_DENSITY * np.array(volumes) / (12 * np.pi)] * 2)
    above = np.sqrt(AIR_DENSITY * SOUND_SPEED * np.array([0.004, 0.001]) / (4 * np.pi * 2 * np.pi * freq[3:])) / 3
    np.testing.assert_allclose(heard[:, 3:], signs[:, 3:] * above)
    total = 1.3**2 + 3.5**2
    shut = (1.69 * 1e4 + 12.25 * 4e4) / total
    hole = 5e4 - shut
    A = np.sqrt((2 * np.pi) ** 2 * (shut - 4e8 / hole) / (total * AIR_DENSITY * SOUND_SPEED**2 / 0.013))
    assert volumes == pytest.approx((A * 1.3 * 1e4 / (1e4 - hole), A * 3.5 * 4e4 / (4e4 - hole)))
    for freqs, shapes in (((100.0, 200.0), (0.0, 1.0)), ((100.0, 200.0), (1.0, 0.0))):
        with pytest.raises(ValueError, match=r"modes at 100\.0 and 200\.0 Hz"):
            displaced_volumes(freqs, shapes, 0.013)


# -- drawn bodies ------------------------------------------------------------------------------------------------------


def drawing(**changes) -> BodyDrawing:
    top = PlateDrawing(SPRUCE, 2.5e-3, HINGED, size=0.04)
    plain = BodyDrawing(
        outline=SQUARE * [0.30, 0.22], hole=circle(0.03, (0.08, 0.12), 90), top=top, back=None, depth=0.09,
        cavity_to=1000.0, end_correction=1.5, air_loss=0.0, extra_loss=0.0, baffled=True, fmax=900.0,
        points=np.array([[0.2, 0.1], [0.24, 0.06]]), directions=np.array([[0.0, 0.0, 1.0], [0.6, 0.0, 0.8]]),
        heights=np.array([0.0, 0.01]),
    )  # fmt: skip
    return replace(plain, **changes)


@pytest.fixture(scope="module")
def modes():
    return body_modes(drawing())


def test_numbers_of_a_drawn_body_fit_together(modes) -> None:
    n, hole = len(modes.freq), int(modes.hole_from[0])
    whole = 0.3 * 0.22 - np.pi * 0.0009
    assert modes.masses == pytest.approx([whole * 2.5e-3 * SPRUCE.density, 0.0], rel=1e-3)
    assert modes.areas[:hole].sum() == pytest.approx(whole, rel=1e-3)
    assert modes.areas[hole:].sum() == pytest.approx(np.pi * 0.0009, rel=1e-3)
    assert len(modes.sources) == len(modes.areas) == len(modes.volumes)
    np.testing.assert_allclose(modes.kinetic.sum(axis=0), 1.0, rtol=1e-9)
    assert (modes.volumes.shape[1], modes.shapes.shape, modes.back_volumes.shape) == (n, (2, n), (0, n))
    assert np.all(modes.freq <= 900.0)
    assert list(modes.arrays())[:3] == ["freq", "loss", "radiation_loss"]
    omega = 2 * np.pi * modes.freq
    heard = Sources(modes.sources, modes.volumes).resistance(modes.freq) / omega
    np.testing.assert_allclose(modes.radiation_loss, heard, rtol=1e-6)
    assert modes.labels()[modes.named()["A0"]] == "A0"
    assert modes.cavity_freq == pytest.approx([SOUND_SPEED / 0.6, SOUND_SPEED / 0.44, 1000 * 0.9654], rel=0.02)
    free = replace(modes, freq=np.append(0.0, modes.freq[1:]))
    assert free.named() == {}
    parts = np.array(["plate", "hole", "cavity"])[np.argmax(modes.kinetic, axis=0)]
    assert free.labels() == tuple(parts)


def test_losses_are_added_by_their_shares_of_the_energy(modes) -> None:
    glued, airy = body_modes(drawing(extra_loss=0.01)), body_modes(drawing(air_loss=0.02))
    plates, air = (glued.loss - modes.loss) / 0.01, (airy.loss - modes.loss) / 0.02
    np.testing.assert_allclose(plates + air, 1.0, rtol=1e-6)
    assert plates.min() > 0
    assert air.min() > 0
    open_air = body_modes(drawing(baffled=False))
    shelf = replace(Sources(modes.sources, modes.volumes), baffled=False)
    heard = shelf.resistance(modes.freq) / (2 * np.pi * modes.freq)
    np.testing.assert_allclose(modes.loss - open_air.loss, modes.radiation_loss - heard, rtol=1e-4, atol=1e-9)


def test_static_compliance_does_not_depend_on_the_highest_mode(modes) -> None:
    def static(of):
        return (of.shapes / (2 * np.pi * of.freq) ** 2) @ of.shapes.T + of.residual

    low = body_modes(drawing(fmax=450.0))
    assert len(low.freq) < len(modes.freq)
    np.testing.assert_allclose(static(low), static(modes), rtol=1e-3)
    few = modes.below(300.0)
    assert few.freq.tolist() == modes.freq[modes.freq < 300.0].tolist()
    np.testing.assert_allclose(static(few), static(modes), rtol=1e-9)
    for name in ("loss", "radiation_loss", "kinetic", "shapes", "volumes"):
        np.testing.assert_array_equal(getattr(few, name), getattr(modes, name)[..., : len(few.freq)])
    assert modes.below(1e4) is modes


def test_a_plate_without_air_has_its_own_modes() -> None:
    bare = body_modes(drawing(depth=0.0, hole=None))
    plate = Plate([SQUARE * [0.30, 0.22]], SPRUCE, 2.5e-3, HINGED, size=0.04).modes(900.0)
    np.testing.assert_allclose(bare.freq, plate.freq, rtol=1e-9)
    np.testing.assert_allclose(bare.vacuum_freq, plate.freq, rtol=1e-9)
    np.testing.assert_allclose(bare.loss - bare.radiation_loss, plate.loss, rtol=1e-9)
    np.testing.assert_allclose(np.abs(bare.shapes[0]), np.abs(plate.shapes([[0.2, 0.1]])[0]), rtol=1e-6, atol=1e-9)
    assert (bare.cavity_freq.size, bare.kinetic[0].min(), int(bare.hole_from[0])) == (0, 1.0, len(bare.sources))
    free = body_modes(drawing(depth=0.0, hole=None, top=PlateDrawing(SPRUCE, 2.5e-3, FREE, size=0.04)))
    assert free.freq[:3].tolist() == [0.0] * 3
    assert free.freq[3] > 0
    assert free.vacuum_freq[0] == pytest.approx(free.freq[3])
    assert not free.loss[:3].any()


def test_a_back_adds_its_mass_and_its_volume() -> None:
    back = PlateDrawing(SPECIES["mahogany"].wood, 3e-3, HINGED, size=0.04)
    both, rigid = body_modes(drawing(back=back, fmax=500.0)), body_modes(drawing(fmax=500.0))
    assert both.masses[1] == pytest.approx(0.3 * 0.22 * 3e-3 * 545.0, rel=1e-4)
    assert both.masses[0] == rigid.masses[0]
    assert both.back_volumes.shape == (len(both.back_sources), len(both.freq))
    assert both.freq[0] < rigid.freq[0]  # a wall that yields makes the air softer
    np.testing.assert_allclose(both.kinetic.sum(axis=0), 1.0, rtol=1e-9)
    heard = sum(
        Sources(p, v).resistance(both.freq)
        for p, v in ((both.sources, both.volumes), (both.back_sources, both.back_volumes))
    )
    np.testing.assert_allclose(both.radiation_loss, heard / (2 * np.pi * both.freq), rtol=1e-6)


def test_parts_of_a_drawing_by_hand() -> None:
    body = drawing()
    points, weights = mouth_of(body.hole)
    assert weights.sum() == pytest.approx(np.pi * 0.0009, rel=1e-3)
    assert opening_of(body, (points, weights)) == (pytest.approx(np.pi * 0.0009, rel=1e-3), 2.5e-3)
    assert opening_of(body, None) is None
    sloped = replace(body, top=replace(body.top, thickness=lambda p: 2e-3 + 0.01 * p[..., 0]))
    assert opening_of(sloped, (points, weights))[1] == pytest.approx(2.8e-3, rel=0.02)
    plate = made_plate([body.outline], body.top, 900.0)
    load = point_loads(plate, body)
    w = np.random.default_rng(1).normal(size=plate.functions)
    at, step = body.points[1], 1e-6
    value = plate.operator([at]) @ w
    beside = np.array([step, 0.0])
    slope = (plate.operator([at + beside]) @ w - plate.operator([at - beside]) @ w) / (2 * step)
    assert load[0] @ w == pytest.approx((plate.operator([body.points[0]]) @ w)[0])
    assert load[1] @ w == pytest.approx((0.8 * value - 0.01 * 0.6 * slope)[0], rel=1e-6)
    assert cell_of(body.outline, body.top, 900.0) == 0.04
    auto = replace(body.top, size=0.0)
    assert cell_of(body.outline, auto, 4000.0) == cell_size(SPRUCE, 2.5e-3, 4000.0)
    varied = replace(auto, thickness=lambda p: 2e-3 + 0.01 * p[..., 0])  # 2 to 5 mm, mean over the ring's corners
    assert cell_of(body.outline, varied, 4000.0) == cell_size(SPRUCE, 3.5e-3, 4000.0)
    # three fields a cell (w and two shear strains), five with beams
    fine = replace(body.top, size=np.sqrt(0.3 * 0.22 * 3 / 25_001))
    with pytest.raises(ValueError, match="some 25001 unknowns, of which 25000 are allowed"):
        made_plate([body.outline], fine, 900.0)
    low, high = first_modes(replace(body, fmax=700.0), [Edge(1e4, 0.0), CLAMPED])
    assert low["T1"] < high["T1"]
    named = body_modes(drawing(fmax=700.0, top=replace(body.top, edge=CLAMPED)))
    assert high == pytest.approx({name: named.freq[k] for name, k in named.named().items()})


def test_lumps_on_a_whole_body_by_hand() -> None:
    """Mass, spring and dashpot at point 1 counted half: Rayleigh's quotient to first order, and 2 sigma = d phi^2."""
    body = WholeBody(drawing())
    values, vectors = body.modes(count=6)
    plain = body.described(values, vectors)
    lump = Lump(1, 0.5, 1e-5, 30.0, 0.02)
    loaded = WholeBody(drawing(), [lump])
    assert loaded.mass == pytest.approx(body.mass + 1e-5)
    assert body.size == loaded.size
    phi = 0.5 * plain.shapes[1]
    moved = values + phi**2 * (30.0 - values * 1e-5)
    np.testing.assert_allclose(loaded.modes(count=6)[0], moved, rtol=2e-5)
    damped = WholeBody(drawing(), [Lump(1, 0.5, 0.0, 0.0, 0.02)]).described(values, vectors)
    np.testing.assert_allclose(damped.loss - plain.loss, 0.02 * phi**2 / np.sqrt(values), rtol=1e-9)
    np.testing.assert_allclose(plain.freq, np.sqrt(values) / (2 * np.pi))
    assert not body.described(values, vectors, residual=False).residual.any()
    static = (plain.shapes / values) @ plain.shapes.T + plain.residual
    more = body.described(*body.modes(count=20))
    np.testing.assert_allclose(
        (more.shapes / (2 * np.pi * more.freq) ** 2) @ more.shapes.T + more.residual, static, rtol=1e-4
    )
    f = np.random.default_rng(2).normal(size=(body.size, 2))
    y = body.solve(f)
    back = body.stiffness(y) + body.shift * (body.mass_matrix @ y)
    np.testing.assert_allclose(back, f, atol=1e-5 * np.abs(f).max())  # 1.0 to 1.5e-6 by the kernel of BLAS
    below = body.modes(below=0.5 * (plain.freq[3] + plain.freq[4]))[0]
    np.testing.assert_allclose(below, values[:4], rtol=1e-6)
    omega = np.sqrt(values)
    radiated, swept = body._radiated(omega, vectors)
    (top,), (opening, shares) = body.plates, mouth_of(body.drawing.hole)
    motion = top.operator(top.quadrature.points) @ vectors[: top.stiffness.shape[0]][-top.functions :]
    points, _, volumes = gathered_sources(top.quadrature.points, top.quadrature.weights, motion, 0.02)
    np.testing.assert_allclose(swept, top.quadrature.weights @ motion, rtol=1e-9, atol=1e-12)
    disc, parts, _ = gathered_sources(opening, shares, np.zeros((len(shares), 0)), 0.02)
    flow = vectors[top.stiffness.shape[0]]
    points, volumes = np.vstack([points, disc]), np.vstack([volumes, np.outer(parts / parts.sum(), flow)])
    apart = np.hypot(*(points[:, None] - points).T)
    for k, w in enumerate(omega):
        total = volumes[:, k] @ np.sinc(w / SOUND_SPEED * apart / np.pi) @ volumes[:, k]
        assert radiated[k] == pytest.approx(AIR_DENSITY * w**2 / (2 * np.pi * SOUND_SPEED) * total, rel=1e-9)
    fixed = with_cells(replace(drawing(), top=replace(drawing().top, size=0.0)), 1000.0)
    assert (fixed.fmax, fixed.top.size, fixed.back) == (1000.0, cell_size(SPRUCE, 2.5e-3, 1000.0), None)


def test_losses_of_a_whole_body_are_added_by_their_shares() -> None:
    body = WholeBody(drawing())
    values, vectors = body.modes(count=5)
    described = {
        name: WholeBody(drawing(**change)).described(values, vectors, residual=False)
        for name, change in (("plain", {}), ("glue", {"extra_loss": 0.01}), ("air", {"air_loss": 0.02}),
                             ("open", {"baffled": False}))
    }  # fmt: skip
    plain = described["plain"].loss
    glue, air = (described["glue"].loss - plain) / 0.01, (described["air"].loss - plain) / 0.02
    wood = vectors[: body.plates[0].stiffness.shape[0]]
    stored = np.einsum("ij,ij->j", wood, body.plates[0].stiffness @ wood) / values
    np.testing.assert_allclose(glue, stored, rtol=1e-6)
    np.testing.assert_allclose(air, 1 - stored, rtol=1e-6, atol=1e-9)
    heard = body._radiated(np.sqrt(values), vectors)[0] - WholeBody(drawing(baffled=False))._radiated(
        np.sqrt(values), vectors
    )[0]  # fmt: skip
    np.testing.assert_allclose(plain - described["open"].loss, heard / np.sqrt(values), rtol=1e-6, atol=1e-12)
    known = body_modes(drawing())
    np.testing.assert_allclose(plain, known.loss[:5], rtol=0.02)
    same = body_change(body, values, vectors, body, body, 1e-3, 3, residual=False)
    for side in (same.less, same.more):
        np.testing.assert_allclose(side.freq, described["plain"].freq[:3], rtol=1e-12)
        np.testing.assert_allclose(side.loss, plain[:3], rtol=1e-9)
    assert same.step == 1e-3
    back = PlateDrawing(SPECIES["mahogany"].wood, 3e-3)
    fixed = with_cells(drawing(back=back), 1200.0)
    assert fixed.back.size == cell_size(back.wood, 3e-3, 1200.0)


def test_results_that_are_kept_are_those_made_anew() -> None:
    """Plates of one grid that differ in one number each, with what was kept of the others and without."""
    beam = Beam(np.array([0.05, 0.05]), np.array([0.25, 0.15]), 0.008, np.array([0.01]), SPRUCE)
    moved = (
        replace(beam, start=np.array([0.06, 0.05])), replace(beam, stop=np.array([0.25, 0.14])),
        replace(beam, width=0.009), replace(beam, heights=np.array([0.011])), replace(beam, above=True),
        replace(beam, wood=SPECIES["maple"].wood),
    )  # fmt: skip
    springs, thin = Edge(1e5, 100.0), replace(SPRUCE, G_LT=np.inf)  # most do not shear, which takes less time
    variants = [
        {}, {"thickness": 3.1e-3}, {"grain": 0.2}, {"edge": Edge(2e5, 100.0)}, {"edge": FREE}, {"beams": [beam]},
        {"edge": Edge(1e5, 200.0)}, {"wood": replace(thin, E_L=12e9)}, {"beams": [beam, moved[0]]},
        *({"beams": [b]} for b in moved), {"wood": SPRUCE}, {"wood": SPRUCE, "shear_factor": 0.7},
    ]  # fmt: skip

    def freq(change):
        given = {"wood": thin, "thickness": 3e-3, "edge": springs, "size": 0.1} | change
        return Plate([SQUARE * [0.3, 0.2]], **given).modes(count=6).freq

    together = [freq(change) for change in variants]
    for change, found in zip(variants, together, strict=True):
        for kept in plate_parts._RESULTS.values():
            kept.clear()
        np.testing.assert_allclose(freq(change), found, rtol=1e-9, atol=1e-6)
    assert len({tuple(np.round(f, 6)) for f in together}) == len(variants) - 1  # mirrored beams sound alike


def test_names_of_the_package_are_those_of_its_modules() -> None:
    from tonewood.physics import plate as package

    for name in package.__all__:
        value = getattr(package, name)
        assert getattr(value, "__module__", "tonewood.physics.plate").startswith("tonewood.physics.plate")
    assert (package.SOUND_SPEED, package.Beam, package.body_modes) == (SOUND_SPEED, Beam, body_modes)
    with pytest.raises(AttributeError, match="no attribute 'Plates'"):
        _ = package.Plates


def test_modes_are_followed_where_they_cross() -> None:
    """Two shapes exchange their places between the second step and the third, and change their signs."""
    u, v, w = np.eye(3)
    steps = [
        SimpleNamespace(freq=np.array([100.0, 110.0, 300.0]), volumes=np.stack([u, v, w], axis=1)),
        SimpleNamespace(freq=np.array([104.0, 106.0, 300.0]), volumes=np.stack([u + 0.3 * v, v - 0.3 * u, w], axis=1)),
        SimpleNamespace(freq=np.array([103.0, 109.0, 300.0]), volumes=np.stack([-v, 50 * u, w], axis=1)),
    ]
    assert followed(steps, 2).tolist() == [[100.0, 110.0], [104.0, 106.0], [109.0, 103.0]]
    assert followed(steps[:1], 1).tolist() == [[100.0]]


def test_pictures_of_shapes_show_height_flow_and_names() -> None:
    from matplotlib.figure import Figure

    x, y = (a.ravel() for a in np.meshgrid(np.linspace(0.05, 0.95, 7), np.linspace(0.05, 0.95, 7)))
    points = np.vstack([np.column_stack([x, y]), [[0.5, 0.5]]])
    hole = circle(0.06, (0.5, 0.5), 12)
    points = np.vstack([points[np.hypot(*(points - 0.5).T) > 0.1], [[0.5, 0.5]]])
    areas = np.full(len(points), 0.02)
    heights = np.column_stack([points[:, 0] - 0.3, points[:, 1] - 0.5])
    heights[-1] = 3.0, -2.0
    sources = Sources(points, heights * areas[:, None], areas=areas, rings=(SQUARE, hole), labels=("A0", "plate"))
    axes = Figure().subplots(1, 3)
    draw_shapes(axes, sources, np.array([98.7, 181.2]), np.array([33.4, 51.6]))
    assert [ax.get_title() for ax in axes] == ["A0 99 Hz, Q 33", "181 Hz, Q 52", ""]
    assert [ax.yaxis_inverted() for ax in axes] == [True, True, False]
    assert [len(ax.lines) for ax in axes] == [2, 2, 0]
    assert [ax.patches[0].get_facecolor()[:3] for ax in axes[:2]] == [
        pytest.approx((0xF0 / 255, 0xB7 / 255, 0xA0 / 255)), pytest.approx((0xA6 / 255, 0xCD / 255, 0xE3 / 255)),
    ]  # fmt: skip
    still = replace(sources, volumes=0.0 * sources.volumes)
    (ax,) = Figure().subplots(1, 1, squeeze=False)[0]
    draw_shapes([ax], still, np.array([50.0]), np.array([9.0]))
    assert not ax.collections[0].get_array().any()  # a mode that does not move is white, and no number is missing
    for ax, column in zip(axes[:2], heights[:-1].T, strict=True):
        mesh = next(c for c in ax.collections if c.get_array() is not None and len(c.get_array()) == len(points) - 1)
        largest = np.quantile(np.abs(column), 0.99)
        np.testing.assert_allclose(mesh.get_array(), np.clip(column / largest, -1, 1))
        assert mesh.get_clim() == (-1.2, 1.2)
        np.testing.assert_allclose(ax.lines[0].get_xdata(), [*SQUARE[:, 1], SQUARE[0, 1]])
        np.testing.assert_allclose(ax.lines[0].get_ydata(), [*SQUARE[:, 0], SQUARE[0, 0]])
