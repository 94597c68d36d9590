"""Derivatives of a table of modes with respect to a lump, against differences at three step sizes."""

import numpy as np
import pytest

from tonewood.physics.modal.loaded import loaded
from tonewood.physics.modal.lump_changes import lump_change
from tonewood.physics.modal.modes import ModalBasis


def body(residual=0.0):
    freq = np.array([100.0, 190.0, 280.0, 410.0, 560.0])
    rng = np.random.default_rng(5)
    shapes = {"a": rng.normal(size=5), "b": rng.normal(size=5)}
    omega = 2 * np.pi * freq
    return ModalBasis.real(omega, 0.01 * omega, shapes, residual=residual * np.eye(2))


@pytest.mark.parametrize("step", [1e-3, 3e-4, 1e-4])
@pytest.mark.parametrize("kind", ["mass", "damping", "stiffness"])
def test_lumps_on_a_table_of_modes(step, kind):
    lump = {"mass": 0.02, "damping": 0.5, "stiffness": 3e3}
    row = np.array([[1.0, 0.0]])

    def at(x):
        values = {**lump, kind: lump[kind] * (1 + x)}
        found = loaded(body(1e-9), row, [values["mass"]], [values["damping"]], [values["stiffness"]])
        order = np.argsort(np.abs(found.poles))[:5]  # not the mass on the residual compliance
        return found, found.poles[order], (found.right * found.left)[:, order]

    found, _, _ = at(0.0)
    rates = [lump[kind] * (kind == name) for name in ("mass", "damping", "stiffness")]
    order = np.argsort(np.abs(found.poles))[:5]
    poles, residues = (x[..., order] for x in lump_change(found, 0, rates))
    (_, p0, r0), (_, p1, r1) = at(-step), at(step)
    np.testing.assert_allclose(poles, (p1 - p0) / (2 * step), rtol=1e-6, atol=1e-6 * np.abs(poles).max())
    slope = (r1 - r0) / (2 * step)
    np.testing.assert_allclose(residues, slope, atol=1e-4 * np.abs(slope).max())
