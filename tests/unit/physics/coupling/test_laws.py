"""Laws of nonlinear connections: their discrete gradients against arithmetic of 60 digits, work, slope and monotony."""

from __future__ import annotations

import ctypes
import dataclasses
import math
from decimal import Decimal, getcontext

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tonewood.physics.coupling.laws import CompiledPotential, Contact, Friction, HardeningSpring, SampledPotential

getcontext().prec = 60
DT = 1 / 48000


def power(x, n):
    return Decimal(x) ** Decimal(n) if x > 0 else Decimal(0)


def exact_gradient(potential, new, old):
    return float((potential(new) - potential(old)) / (Decimal(new) - Decimal(old)))


@given(
    old=st.floats(1e-12, 1e-2), ratio=st.sampled_from([1e-14, 3e-12, 1e-9, 1e-5, 9e-5, 2e-4, 0.3, 2.0, 999.0, 1e9]),
    exponent=st.sampled_from([1.0, 1.3, 1.5, 2.3, 3.0]), closing=st.booleans(),
)  # fmt: skip
def test_contact_stores_exactly_its_potential(old, ratio, exponent, closing):
    new = old * (1 + ratio)
    if new == old:
        return
    law = Contact(4e8, exponent)
    here, there = (new, old) if closing else (old, new)
    expected = exact_gradient(lambda p: Decimal(400_000_000) * power(p, exponent + 1) / Decimal(exponent + 1), new, old)
    f, slope = law.force(here, there, DT)
    assert f == pytest.approx(expected, rel=3e-15 * 20)
    # the slope rises from K alpha p^(alpha - 1) / 2 at the closing edge, so bounds by the ends hold it
    low, high = min(old, new), max(old, new)
    bounds = [0.5 * 4e8 * exponent * p ** (exponent - 1) for p in (low, high)]
    assert 0.2 * bounds[0] * min(1.0, 2 / exponent) <= slope <= bounds[1] * 2 * (1 + 1e-3)


@pytest.mark.parametrize(("new", "old"), [(1e-5, -1e-3), (-1e-3, 1e-5), (0.0, 1e-5), (1e-5, 0.0), (1e-300, 1e-5)])
def test_contact_across_its_edge(new, old):
    law = Contact(1e10, 2.3)
    expected = exact_gradient(lambda p: Decimal(10_000_000_000) * power(p, 2.3 + 1) / Decimal(2.3 + 1), new, old)
    f, slope = law.force(new, old, DT)
    assert f == pytest.approx(expected, rel=1e-13)
    step = 1e-4 * abs(new - old)
    rise = (law.force(new + step, old, DT)[0] - law.force(new - step, old, DT)[0]) / (2 * step)
    assert slope == pytest.approx(rise, rel=1e-3, abs=1e-6 * abs(f / (new - old)))
    assert law.force(-1e-9, -1e-3, DT) == (0.0, 0.0)


def polynomial(x):
    return 0.5 * 3e3 * x**2 + 0.25 * 7e8 * x**4


CFUNC = ctypes.CFUNCTYPE(ctypes.c_double, ctypes.c_double, ctypes.c_void_p)
LAWS = {
    "contact": Contact(1e7, 1.7, loss=0.4),
    "spring": HardeningSpring(3e3, 7e8, damping=0.3, quadratic_damping=2.0),
    "potential": SampledPotential.from_potential(
        np.linspace(-3e-3, 3e-3, 25), polynomial(np.linspace(-3e-3, 3e-3, 25)), damping=0.1
    ),
    "force": SampledPotential.from_force([-2e-3, -1e-3, 0.0, 1e-3], [50.0, 10.0, 0.0, 0.0], loss=0.2),
    "compiled": CompiledPotential(
        CFUNC(lambda d, _: polynomial(d)), CFUNC(lambda d, _: 3e3 * d + 7e8 * d**3), damping=0.2
    ),
}


@pytest.mark.parametrize("name", LAWS)
def test_no_law_gives_more_than_it_stored(name, rng):
    law = LAWS[name]
    for _ in range(400):
        old = rng.normal() * 1.5e-3
        new = old + rng.normal() * 10 ** rng.uniform(-9, -2.5)
        f, slope = law.force(new, old, DT)
        stored = law.energy(new) - law.energy(old)
        size = abs(law.energy(new)) + abs(law.energy(old))
        assert f * (new - old) >= stored - 4e-15 * size - 1e-30
        assert slope >= 0.0


@pytest.mark.parametrize("name", LAWS)
def test_force_only_rises_with_the_compression(name, rng):
    law = LAWS[name]
    for _ in range(100):
        old, low = rng.normal(size=2) * 1e-3
        high = low + abs(rng.normal()) * 10 ** rng.uniform(-7, -3)
        f_low, f_high = law.force(low, old, DT)[0], law.force(high, old, DT)[0]
        assert f_high >= f_low - 1e-12 * (abs(f_low) + abs(f_high))


@pytest.mark.parametrize("name", LAWS)
def test_without_loss_the_work_is_what_is_stored(name, rng):
    law = LAWS[name]
    losses = {key: 0.0 for key in ("loss", "damping", "quadratic_damping") if hasattr(law, key)}
    law = dataclasses.replace(law, **losses)
    for _ in range(200):
        old = rng.normal() * 1.5e-3
        new = old + rng.normal() * 10 ** rng.uniform(-9, -2.5)
        f, size = law.force(new, old, DT)[0], abs(law.energy(new)) + abs(law.energy(old))
        assert f * (new - old) == pytest.approx(law.energy(new) - law.energy(old), rel=1e-12, abs=4e-15 * size + 1e-17)


def test_sampled_and_compiled_potentials_are_the_polynomial():
    spring = HardeningSpring(3e3, 7e8)
    for law in (LAWS["potential"], LAWS["compiled"]):
        for new, old in ((1e-3, -4e-4), (2e-4, 2.0001e-4), (-1.7e-3, -1.7e-3)):
            f = law.force(new, old, DT)[0] - law.damping * (new - old) / DT
            assert f == pytest.approx(spring.force(new, old, DT)[0], rel=2e-3)


def test_a_line_goes_on_beyond_the_samples():
    law = SampledPotential.from_force([0.0, 1e-3], [0.0, -2.0])
    assert law.energy(-3e-3) == pytest.approx(0.5 * 2e3 * 9e-6)
    assert law.force(-2e-3, -2e-3, DT)[0] == pytest.approx(-4.0)


@pytest.mark.parametrize(
    "make",
    [
        lambda: Contact(-1.0),
        lambda: Contact(1.0, 0.5),
        lambda: HardeningSpring(1.0, cubic=-1.0),
        lambda: SampledPotential.from_force([0.0, 1.0, 2.0], [0.0, -1.0, 0.0]),
        lambda: SampledPotential.from_potential([0.0, 1.0, 2.0, 3.0], [0.0, 1.0, 1.0, 0.0]),
        lambda: SampledPotential.from_force([-1.0, 1.0], [1.0, -1.0], loss=0.1),
        lambda: SampledPotential.from_force([1.0, 0.0], [1.0, -1.0]),
        lambda: Friction(1.0, static=0.2, dynamic=0.3),
        lambda: CompiledPotential(ctypes.CFUNCTYPE(ctypes.c_float, ctypes.c_float)(abs), LAWS["compiled"].slope),
    ],
)
def test_laws_that_could_create_energy_are_refused(make):
    with pytest.raises(ValueError, match=r"must|needs|double|only"):
        make()


def test_user_data_reaches_the_function():
    from scipy import LowLevelCallable

    stiffness = ctypes.c_double(500.0)

    def value(data):
        return ctypes.cast(data, ctypes.POINTER(ctypes.c_double))[0]

    data = ctypes.cast(ctypes.pointer(stiffness), ctypes.c_void_p)
    law = CompiledPotential(
        LowLevelCallable(CFUNC(lambda d, k: 0.5 * value(k) * d * d), data),
        LowLevelCallable(CFUNC(lambda d, k: value(k) * d), data),
    )
    assert law.force(2e-3, 1e-3, DT)[0] == pytest.approx(0.75)
    assert law.force(2e-3, 2e-3, DT) == pytest.approx((1.0, 250.0))


class TestFriction:
    law = Friction(2.0, static=0.8, dynamic=0.3, speed=0.1)

    def mu(self, v):
        return 0.3 + 0.5 / (1 + abs(v) / 0.1)

    @pytest.mark.parametrize("load", [0.01, 0.1, 0.5, 5.0])
    @pytest.mark.parametrize("before", [0.0, 0.2, -0.2])
    def test_solves_its_equation(self, load, before):
        for free in np.linspace(-6, 6, 241):
            v = self.law.velocity_after(free, load, before)
            if v == 0.0:
                assert abs(free) <= load * 0.8
            else:
                assert v + load * math.copysign(self.mu(v), v) == pytest.approx(free, rel=1e-12, abs=1e-14)

    def test_keeps_its_branch_while_it_can(self):
        load = 2.0  # steeper than the curve's fall: three solutions between the two limits
        stuck = [self.law.velocity_after(v, load, 0.0) == 0.0 for v in (1.5, 1.59, 1.61)]
        assert stuck == [True, True, False]
        # sliding goes on below the stick limit until the curve is tangent to the load line
        limit = next(v for v in np.arange(1.6, 0.0, -1e-4) if self.law.velocity_after(v, load, 1.0) == 0.0)
        a, d = 0.1, 2.0 * 0.5
        assert limit == pytest.approx(2.0 * 0.3 - a + 2 * math.sqrt(d * a), abs=2e-4)
        assert self.law.velocity_after(-1.0, load, 1.0) == 0.0
        assert self.law.velocity_after(-3.0, load, 1.0) < 0.0


@pytest.mark.parametrize("values", [{"loss": -1.0}, {"damping": -1.0}, {"loss": float("nan")}])
def test_a_potential_of_c_functions_with_a_negative_loss_is_refused(values):
    function = ctypes.CFUNCTYPE(ctypes.c_double, ctypes.c_double)(lambda d: 0.0)
    with pytest.raises(ValueError, match="loss and damping must not be negative"):
        CompiledPotential(function, function, **values)
