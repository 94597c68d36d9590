"""Zeros of joined receptances, each once; roots of pairings; poles of the real form."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
import scipy.linalg as sla

from tonewood.errors import PassivityError
from tonewood.physics.modal.complex_modes import _inverse_root
from tonewood.physics.modal.conjugates import real_form
from tonewood.physics.modal.modes import ModalBasis
from tonewood.physics.modal.receptance import Joint, Ports

OMEGA, SIGMA = np.array([500.0, 900.0, 1400.0, 2100.0]), np.array([3.0, 5.0, 4.0, 9.0])
SHAPE = np.array([1.0, 2.0, 1.0, 0.7])


def exact_zeros():
    """Zeros of sum_k r_k^2 / (s^2 + 2 sigma_k s + omega_k^2) as roots of the numerator."""
    terms = [np.array([1.0, 2 * s, w * w]) for s, w in zip(SIGMA, OMEGA, strict=True)]
    numerator = np.zeros(1)
    for k, r in enumerate(SHAPE):
        product = np.ones(1)
        for i, term in enumerate(terms):
            product = np.polymul(product, term) if i != k else product
        numerator = np.polyadd(numerator, r * r * product)
    roots = np.roots(numerator)
    return np.sort_complex(roots[roots.imag > 0] * 1j) / 1j


def test_zeros_that_were_found_are_divided_out():
    """Newton's rule from one place again and again comes to all of them, and to none twice."""
    basis = ModalBasis.real(OMEGA, SIGMA, {"p": SHAPE})
    joint = Joint([Ports.of(basis, np.ones((1, 1)))])
    exact = exact_zeros()
    found = joint.zeros([complex(-4.0, 760.0)] * 12, multiply=[complex(p) for p in basis.poles])
    assert len(found) == len(exact) == 3
    np.testing.assert_allclose(sorted(found, key=lambda s: s.imag), sorted(exact, key=lambda s: s.imag), rtol=1e-9)
    # without poles in the way, from beside each: a start that leads to the same zero gives no second one
    near = [s * factor for s in exact for factor in (1.0001, 0.9999, 1.0)]
    assert len(joint.zeros(near)) == 3


def test_at_a_pole_that_no_gap_moves_the_receptance_is_that_of_the_others():
    """As in a search from the mode of two dampers that move against each other."""
    whole, others = (ModalBasis.real(OMEGA[:n], SIGMA[:n], {"p": [*SHAPE[:2], 0.0][:n]}) for n in (3, 2))
    first, second = (Joint([Ports.of(basis, np.ones((1, 1)))]) for basis in (whole, others))
    for found, wanted in zip(first.receptance(whole.poles[2]), second.receptance(whole.poles[2]), strict=True):
        np.testing.assert_allclose(found, wanted, rtol=1e-12)


def test_the_root_of_a_pairing():
    rng = np.random.default_rng(3)
    U = sla.qr(rng.normal(size=(4, 4)))[0]
    d = np.array([2.0, -0.5, 3.0, -1.0])
    indefinite = (U * d) @ U.T
    for W in (np.diag(d) + 1e-14j, indefinite + 1e-14j):  # real but for rounding
        root = _inverse_root(W)
        assert not root.imag.any()
        np.testing.assert_allclose(root @ W @ root, (U * np.sign(d)) @ U.T if W[0, 1].real else _sign(W), atol=1e-9)
    turned = indefinite @ indefinite + 0.3j * (U * [1.0, 2.0, 0.5, 0.1]) @ U.T
    root = _inverse_root(turned)
    np.testing.assert_allclose(root @ turned @ root, np.eye(4), atol=1e-9)


def _sign(W):
    d, U = sla.eigh(W.real)
    return (U * np.sign(d)) @ U.T


def test_the_real_form_has_the_poles_and_the_mobility():
    poles = np.array([-3 + 40j, -20.0, -1 + 0.5j])
    rng = np.random.default_rng(4)
    right, left = rng.normal(size=(2, 2, 3)) + 1j * rng.normal(size=(2, 2, 3))
    right[:, 1], left[:, 1] = right[:, 1].real, left[:, 1].real
    form = real_form(poles, right, left)
    got = sla.eigvals(form.A)
    for pole in [*poles, poles[0].conj(), poles[2].conj()]:
        assert np.abs(got - pole).min() < 1e-12 * 40
    s = 1j * 7.0
    mobility = form.C @ np.linalg.solve(s * np.eye(5) - form.A, form.B) + form.D
    expected = sum(
        s / (s - p) * np.outer(r, x) for p, r, x in zip(
            [*poles, poles[0].conj(), poles[2].conj()], [*right.T, right[:, 0].conj(), right[:, 2].conj()],
            [*left.T, left[:, 0].conj(), left[:, 2].conj()], strict=True,
        )
    )  # fmt: skip
    np.testing.assert_allclose(mobility, expected, rtol=1e-10)
    with pytest.raises(PassivityError, match="Im > 0"):
        real_form(poles.conj(), right, left)


@pytest.mark.parametrize("size", [2, 3, 5])
def test_null_vectors_of_a_complex_matrix(size, rng):
    """M v = 0 and w M = 0, of norm 1; M has neither symmetry nor real numbers."""
    M = rng.normal(size=(size, size)) + 1j * rng.normal(size=(size, size))
    M[-1] = rng.normal(size=size - 1) @ M[:-1] * 1j
    v, w = Joint.null(SimpleNamespace(size=size, receptance=lambda s: (M, None)), 0j)
    assert [np.linalg.norm(v), np.linalg.norm(w)] == pytest.approx([1.0, 1.0])
    assert max(np.abs(M @ v).max(), np.abs(w @ M).max()) < 1e-12
