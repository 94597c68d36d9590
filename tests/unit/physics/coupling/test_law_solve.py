"""The solve of nonlinear laws: its forces put back into the equations of the step, written out here."""

from __future__ import annotations

import numpy as np
import pytest

from tonewood.physics.coupling.laws import Contact, Friction
from tonewood.physics.coupling.laws import friction as friction_module
from tonewood.physics.coupling.laws import solve as solve_module
from tonewood.physics.coupling.laws.friction import FrictionBranch, solve_branches
from tonewood.physics.coupling.laws.solve import Partners, find_forces

DT = 1e-4
LAWS = (
    Contact(3e5, 1.5, loss=0.1), Friction(0.4, 0.9, 0.3, 0.2), Contact(1e5, 1.0), Friction(0.2, 0.7, 0.4, 0.1),
)  # fmt: skip


def drawn(seed):
    """Compliances, m/N, that join all gaps; gaps before and without forces, m; motion of the partners."""
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(4, 4))
    Z = 2e-5 * root @ root.T
    gap, free = 1e-4 * rng.normal(size=(2, 4))
    offset, after = 1e-4 * rng.normal(size=(2, 4))
    return Z, free, gap, Partners(offset, after, rng.normal(size=4), rng.uniform(0.5, 2.0, 4))


def assert_solved(Z, free, gap, partners, f):
    reached = free + Z @ f
    size = np.abs(Z @ f).max() / np.diag(Z)
    for j, law in enumerate(LAWS):
        if isinstance(law, Contact):
            force, _ = law.force(partners.offset_after[j] - reached[j], partners.offset[j] - gap[j], DT)
            assert f[j] == pytest.approx(force * partners.scale[j], abs=1e-7 * size[j])
            continue
        v = (reached[j] - gap[j]) / DT - partners.velocity[j]
        pressed = law.normal_force * partners.scale[j]
        if abs(v) < 1e-9:
            assert abs(f[j]) <= pressed * law.static * (1 + 1e-9)
        else:
            coefficient = law.dynamic + (law.static - law.dynamic) / (1 + abs(v) / law.speed)
            assert f[j] == pytest.approx(-np.sign(v) * pressed * coefficient, abs=1e-7 * size[j])


@pytest.mark.parametrize("careful", [False, True])
@pytest.mark.parametrize("seed", range(12))
def test_forces_fulfil_every_law(seed, careful, monkeypatch):
    if careful:
        monkeypatch.setattr(solve_module, "FEW_SWEEPS", 1)  # so that Newton's method on the friction forces is needed
    Z, free, gap, partners = drawn(seed)
    branches = {j: FrictionBranch(law, partners.scale[j], 0.0) for j, law in enumerate(LAWS) if j in (1, 3)}
    guess = [np.zeros(4)]

    def solve():
        found = find_forces(LAWS, Z, free, gap, DT, partners, guess[0], branches, careful=careful)
        if not found.converged:
            raise ValueError("not found")
        guess[0] = found.forces
        return found

    assert_solved(Z, free, gap, partners, solve_branches(list(branches.values()), solve).forces)


@pytest.mark.parametrize("load", [0.02, 0.4, 3.0])
@pytest.mark.parametrize("branch", ["stuck", "ahead", "behind", "held"])
def test_friction_says_how_its_velocity_follows_the_motion(branch, load):
    """`follows` against differences of `meet`, on either side and below the slowest slide."""
    law = Friction(2.0, 0.8, 0.3, 0.1)
    friction = FrictionBranch(law, 1.0, 0.0, branch, held=0.05)

    def velocity(free):
        friction.meet(free, load / law.normal_force)
        return friction.velocity

    for free in (-4.0, -1.7, -0.1, 0.2, 1.7, 4.0):
        rise = (velocity(free + 1e-6) - velocity(free - 1e-6)) / 2e-6
        velocity(free)
        assert friction.follows() == pytest.approx(rise, rel=1e-6, abs=1e-9)


@pytest.mark.parametrize("turned", [1.0, -1.0])
@pytest.mark.parametrize(("free", "load"), [(0.3, 0.1), (1.5, 1.0), (4.0, 0.4), (0.2, 0.6), (2.0, 0.0)])
def test_halving_ends_where_the_curve_meets_the_rest_of_the_step(free, load, turned):
    """Of one gap alone, whose meeting is the root of a quadratic; below the limit of sticking, at rest."""
    law = Friction(2.0, 0.8, 0.3, 0.1)
    friction = FrictionBranch(law, 0.5, 0.0)
    friction_module._halve(friction, lambda: friction.meet(turned * free, load / 1.0 if load else 1e-12))
    if free <= load * law.static:
        assert friction.velocity == 0.0
    else:
        v = friction.velocity * turned
        pressed = law.normal_force * 0.5
        coefficient = law.dynamic + (law.static - law.dynamic) / (1 + v / law.speed)
        assert v + load * coefficient * pressed == pytest.approx(free, rel=1e-9)
    assert friction.branch == "held"
