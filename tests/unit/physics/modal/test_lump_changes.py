"""Derivatives of a table of modes with respect to a lump, against differences at three step sizes."""

import numpy as np
import pytest

from tonewood.instrument.bundle.added import body_parts, stiffness_rate
from tonewood.instrument.bundle.added_schema import Added
from tonewood.instrument.contract.base import BodyPoint
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


@pytest.mark.parametrize("step", [1e-3, 3e-4, 1e-4])
@pytest.mark.parametrize("key", ["mass", "frequency", "q"])
def test_a_tuned_damper_on_a_table_of_modes(step, key):
    points = dict.fromkeys("ab", BodyPoint((0.0, 0.0, 1.0)))
    entry = Added(at="a", mass=0.02, frequency=205.0, q=4.0)

    def at(x):
        made = entry.model_copy(update={key: getattr(entry, key) * (1 + x)})
        found = body_parts([made], body(), points).body
        order = np.argsort(np.abs(found.poles))
        return found, order

    found, order = at(0.0)
    assert found.n_modes == 6
    rate, below = stiffness_rate(entry, key)
    scaled = [getattr(entry, key) * x for x in rate]
    poles, residues = (x[..., order] for x in lump_change(found, 0, scaled, False, below))
    (one, o0), (other, o1) = at(-step), at(step)
    change = (other.poles[o1] - one.poles[o0]) / (2 * step)
    np.testing.assert_allclose(poles, change, rtol=3e-5, atol=1e-6 * np.abs(poles).max())
    slope = ((other.right * other.left)[:, o1] - (one.right * one.left)[:, o0]) / (2 * step)
    np.testing.assert_allclose(residues, slope, atol=1e-4 * np.abs(slope).max())
