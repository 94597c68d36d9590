"""Damping rates of a string's modes such that its partials decay by a loss law: after retuning, and for any real modes.

The laws themselves are plugins (base class `tonewood.instrument.contract.losses.Loss`, built-in ones in
``plugins/loss_laws.py``). A law holds for partials between fixed ends, and these are mixtures of the modes with the
bridge end free. The rates of the modes are therefore solved for (`string_modes.loss_rates`). The law evaluated at the
modes' own frequencies would give the first partials decay rates that are 4 to 19 % off.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import cast

import numpy as np
from numpy.typing import ArrayLike

from tonewood.physics.modal.held_modes import HeldModes
from tonewood.physics.modal.modes import ModalBasis
from tonewood.physics.modal.string_modes import loss_rates
from tonewood.physics.modal.string_transfer import retuned
from tonewood.support.arrays import Floats


def string_detuned(basis: ModalBasis, tension: float, loss: Callable[[Floats, Floats, float], ArrayLike]) -> ModalBasis:
    """Return a basis of `string_basis` at another tension: a string's `detuned`.

        omega^2 = T a_k + EI b_k,      s_k(T) = s_k sigma(omega(T), k, T) / sigma(omega, k, T0)

    Shapes stay. Each mode's rate is scaled by the ratio of the law at its new and its old frequency, so that the
    partials still follow the law: exactly if it is a power of the frequency, within some 0.6 % over 200 cents for the
    laws of strings.

    Parameters
    ----------
    basis : of `string_basis`, detuned or not.
    tension : N.
    loss : eta(omega rad/s, k 1/m, tension N), the law that the basis was made with, at any tension.

    Raises
    ------
    ValueError : the basis was not made by `string_basis`.
    """
    metadata = basis.metadata
    if missing := {"tension", "tension_part", "bending_part", "bending_stiffness", "wavenumber"} - set(metadata):
        raise ValueError(f"the basis was not made by string_basis: its metadata has no {sorted(missing)[0]}")
    a, b, wavenumber = (cast(Floats, metadata[key]) for key in ("tension_part", "bending_part", "wavenumber"))
    old_rad = np.sqrt(basis.stiffness)
    freq_rad = np.sqrt(tension * a + cast(float, metadata["bending_stiffness"]) * b)
    old = old_rad * np.asarray(loss(old_rad, wavenumber, cast(float, metadata["tension"])))
    new = freq_rad * np.asarray(loss(freq_rad, wavenumber, tension))
    sigma = basis.damping_rate * np.divide(new, old, out=np.ones_like(new), where=old > 0)
    return retuned(basis, freq_rad, sigma, {"tension": tension})


def with_partial_decays(basis: ModalBasis, law: Callable[[Floats], ArrayLike]) -> ModalBasis:
    """Return real modes with other losses: those with which the partials on a rigid bridge decay by a law.

    Parameters
    ----------
    basis : of a string's real modes with the point ``bridge``, which moves in each.
    law : sigma(omega), decay rates (1/s, 0 or more) of partials of these frequencies (rad/s).

    Returns
    -------
    The basis with these rates; ``loss_error`` in its metadata is the relative error of each partial's decay rate.

    Raises
    ------
    ValueError : modes are not real, two have one frequency, or the bridge does not move in one.
    """
    modes, freq_rad = HeldModes.of(basis, "bridge"), np.sqrt(basis.stiffness)
    target, guess = (np.broadcast_to(np.asarray(law(f), dtype=np.float64), f.shape) for f in (modes.freq_rad, freq_rad))
    rates = loss_rates(modes.vectors**2, target, guess)
    return retuned(basis, freq_rad, rates.mode, {"loss_error": rates.error})
