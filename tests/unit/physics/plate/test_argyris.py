"""An independent solution: conforming Argyris triangles, quintic with continuous slope, by scikit-fem."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scipy.sparse as sp
import scipy.sparse.linalg as spla

from tonewood.physics.plate import beams
from tonewood.physics.plate.beams import Beam, torsion_constant
from tonewood.physics.plate.outline import circle
from tonewood.physics.plate.plate import CLAMPED, FREE, Plate
from tonewood.physics.plate.wood import SPECIES

skfem = pytest.importorskip("skfem")

#: that does not shear through its thickness, as the triangles do not
SPRUCE, THICK = replace(SPECIES["sitka_spruce"].wood, G_LT=np.inf, G_RT=np.inf), 0.003


def argyris(mesh, grain: float, count: int) -> np.ndarray:
    """First frequencies (Hz) of a free spruce plate."""
    from skfem.helpers import dd

    basis = skfem.Basis(mesh, skfem.ElementTriArgyris(), intorder=8)
    q = SPRUCE.stiffness(grain) * THICK**3 / 12

    @skfem.BilinearForm
    def stiffness(u, v, _):
        a, b = ([d[0, 0], d[1, 1], 2 * d[0, 1]] for d in (dd(u), dd(v)))
        return sum(q[i, j] * a[i] * b[j] for i in range(3) for j in range(3))

    @skfem.BilinearForm
    def mass(u, v, _):
        return SPRUCE.density * THICK * u * v

    k, m = stiffness.assemble(basis), mass.assemble(basis)
    scale = 1 / np.sqrt(np.abs(k.diagonal()))
    k, m = (a.multiply(scale[:, None]).multiply(scale).tocsc() for a in (k, m))
    values = spla.eigsh(k, count, m, sigma=-((2 * np.pi * 20.0) ** 2), return_eigenvectors=False)
    return np.sqrt(np.maximum(np.sort(values), 0.0)) / (2 * np.pi)


def test_a_rectangle_with_its_grain_askew() -> None:
    """First 20 modes within 0.02 %."""
    ring, grain = np.array([[0.0, 0.0], [0.36, 0.0], [0.36, 0.24], [0.0, 0.24]]), 0.4
    mesh = skfem.MeshTri.init_tensor(np.linspace(0, 0.36, 9), np.linspace(0, 0.24, 7))
    found = Plate([ring], SPRUCE, THICK, FREE, size=0.015, grain=grain).modes(count=23).freq
    assert found[3:] == pytest.approx(argyris(mesh, grain, 23)[3:], rel=2e-4)


@pytest.mark.validate
def test_a_plate_with_a_hole() -> None:
    """Of twelve sides with a hole of twelve: corners that point inwards converge slowly, from above in both."""
    outer, hole = circle(0.2, count=12), circle(0.05, (0.02, 0.0), 12)
    rings = np.stack([hole + (outer - hole) * t for t in np.linspace(0, 1, 6)])
    points = rings.reshape(-1, 2)
    squares = [(12 * i + j, 12 * i + (j + 1) % 12, 12 * (i + 1) + j, 12 * (i + 1) + (j + 1) % 12)
               for i in range(5) for j in range(12)]  # fmt: skip
    triangles = [t for a, b, c, d in squares for t in ((a, b, c), (b, c, d))]
    mesh = skfem.MeshTri(points.T, np.array(triangles).T).refined(1)
    found = Plate([outer, hole], SPRUCE, THICK, FREE, size=0.01).modes(count=23).freq
    assert found[3:] == pytest.approx(argyris(mesh, 0.0, 23)[3:], rel=2e-3)


def braced_argyris(size: int, count: int) -> np.ndarray:
    """Hz, of a clamped spruce plate with a brace beside its middle surface on the strip 0.183 < x < 0.187.

    Argyris triangles for w, quartic ones for the motion in the plane; energies of the brace per area of its
    strip, edges of the mesh on its sides. Its sections stay normal to the plate.
    """
    from skfem.helpers import dd, grad

    x = np.unique(np.concatenate([np.linspace(0, 0.183, size), [0.185], np.linspace(0.187, 0.36, size)]))
    mesh = skfem.MeshTri.init_tensor(x, np.linspace(0, 0.24, 2 * size - 1))
    mesh = mesh.with_subdomains({"strip": lambda p: (p[0] > 0.183) & (p[0] < 0.187)})
    parts = (skfem.ElementTriArgyris(), skfem.ElementVector(skfem.ElementTriP4()))
    bases = [skfem.Basis(mesh, part, intorder=8) for part in parts]
    strips = [skfem.Basis(mesh, part, intorder=8, elements="strip") for part in parts]
    q, wide, tall = SPRUCE.stiffness(), 0.004, 0.012
    stretch, bend = SPRUCE.E_L * tall, SPRUCE.E_L * tall**3 / 12
    twist, offset = SPRUCE.G_LR * float(torsion_constant(wide, np.array(tall))) / wide, (tall + THICK) / 2

    def strains(a):
        g = grad(a)
        return [g[0, 0], g[1, 1], g[0, 1] + g[1, 0]]

    def product(a, b):
        return sum(q[i, j] * a[i] * b[j] for i in range(3) for j in range(3))

    def curvature(a):
        d = dd(a)
        return [d[0, 0], d[1, 1], 2 * d[0, 1]]

    plate_w = skfem.BilinearForm(lambda u, v, _: THICK**3 / 12 * product(curvature(u), curvature(v)))
    plate_u = skfem.BilinearForm(lambda u, v, _: THICK * product(strains(u), strains(v)))
    brace_w = skfem.BilinearForm(
        lambda u, v, _: (bend + stretch * offset**2) * dd(u)[1, 1] * dd(v)[1, 1] + twist * dd(u)[0, 1] * dd(v)[0, 1]
    )
    brace_u = skfem.BilinearForm(lambda u, v, _: stretch * grad(u)[1, 1] * grad(v)[1, 1])
    across = skfem.BilinearForm(lambda u, v, _: stretch * offset * grad(u)[1, 1] * dd(v)[1, 1])
    mass = skfem.BilinearForm(lambda u, v, _: SPRUCE.density * THICK * u * v)
    rotary = SPRUCE.density * tall * (tall**2 / 12 + offset**2)
    heavy = skfem.BilinearForm(
        lambda u, v, _: SPRUCE.density * tall * u * v + rotary * (grad(u)[0] * grad(v)[0] + grad(u)[1] * grad(v)[1])
    )
    k_w = plate_w.assemble(bases[0]) + brace_w.assemble(strips[0])
    k_u = plate_u.assemble(bases[1]) + brace_u.assemble(strips[1])
    k_wu = across.assemble(strips[1], strips[0])
    m = mass.assemble(bases[0]) + heavy.assemble(strips[0])
    # clamped: w and its slopes vanish along the edge, and with them second derivatives but that across it
    held = bases[0].get_dofs().all(["u", "u_x", "u_y", "u_xy", "u_n"])
    for axis, name in ((0, "u_yy"), (1, "u_xx")):
        side = bases[0].get_dofs(lambda p, i=axis: (p[i] < 1e-9) | (p[i] > mesh.p[i].max() - 1e-9))
        held = np.union1d(held, side.all([name]))
    inner = np.setdiff1d(np.arange(k_w.shape[0]), held)
    # the plane carries no mass; a trace of stiffness holds it against rigid motion
    k_u = k_u + 1e-9 * k_u.diagonal().max() * sp.eye(k_u.shape[0])
    k_uw = k_wu.T.tocsc()[:, inner]
    touched = np.unique(k_uw.nonzero()[1])
    moved = spla.splu(k_u.tocsc()).solve(k_uw[:, touched].toarray())
    condensed = sp.lil_matrix((len(inner), len(inner)))
    condensed[np.ix_(touched, touched)] = k_uw[:, touched].T @ moved
    k = (k_w.tocsc()[inner][:, inner] - condensed.tocsc()).tocsc()
    m = m.tocsc()[inner][:, inner]
    scale = 1 / np.sqrt(np.abs(k.diagonal()))
    k, m = (a.multiply(scale[:, None]).multiply(scale).tocsc() for a in (k, m))
    values = spla.eigsh(k, count, m, sigma=0.0, return_eigenvectors=False)
    return np.sqrt(np.sort(values)) / (2 * np.pi)


@pytest.mark.validate
def test_a_plate_with_a_brace(monkeypatch: pytest.MonkeyPatch) -> None:
    """First 15 modes of a clamped plate whose brace does not shear: median within 0.2 %, all within 0.8 %.

    The worst are those in which the brace twists: here its whole strip stays plane, and not its mean only.
    """
    monkeypatch.setattr(beams, "_SHEAR", 1e6)
    ring = np.array([[0.0, 0.0], [0.36, 0.0], [0.36, 0.24], [0.0, 0.24]])
    brace = Beam(np.array([0.185, 0.0]), np.array([0.185, 0.24]), 0.004, np.array([0.012]), SPRUCE)
    found = Plate([ring], SPRUCE, THICK, CLAMPED, [brace], size=0.008).modes(count=15).freq
    apart = np.abs(found / braced_argyris(7, 15) - 1)
    assert np.median(apart) < 2e-3
    assert apart.max() < 8e-3
