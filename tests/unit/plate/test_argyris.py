"""An independent solution: conforming Argyris triangles, quintic with continuous slope, by scikit-fem."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse.linalg as spla

from tonewood.plate.outline import circle
from tonewood.plate.plate import FREE, Plate
from tonewood.plate.wood import SPECIES

skfem = pytest.importorskip("skfem")

SPRUCE, THICK = SPECIES["sitka_spruce"].wood, 0.003


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
