"""From the quantities that a pickup reads to those that it delivers: a function without memory, then a circuit.

    v = f(readouts),    output(s) = H(s) v(s)

The function is evaluated at every step of the engine. A nonlinear one adds frequencies beyond those of its input, and
those above half the engine's rate alias. The circuit takes its input as a straight line between two steps (first-order
hold): a sinusoid comes out sinc^2(f / fs) as strong, 0.6 dB less at 0.15 fs.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tonewood.errors import PluginError, TonewoodError, words_of
from tonewood.support.arrays import Floats


@dataclass(frozen=True, eq=False)
class Circuit:
    """Linear circuit between a pickup and its channel, H(s) = numerator(s) / denominator(s).

    Attributes
    ----------
    numerator, denominator : coefficients of powers of s (rad/s), highest first; H is stable, and proper.
    """

    numerator: tuple[float, ...]
    denominator: tuple[float, ...]

    @cached_property
    def poles(self) -> NDArray[np.complex128]:
        """Return the poles, rad/s."""
        return np.asarray(np.roots(self.denominator), dtype=np.complex128)

    def response(self, freq: Floats) -> NDArray[np.complex128]:
        """Return H at frequencies.

        Parameters
        ----------
        freq : (n,) Hz.
        """
        s = 2j * np.pi * np.asarray(freq, dtype=np.float64)
        return np.asarray(np.polyval(self.numerator, s) / np.polyval(self.denominator, s))

    def discrete(self, dt: float) -> tuple[Floats, Floats]:
        """Return the coefficients (b, a) of the filter in steps of dt (s) for an input that is linear in between."""
        from scipy.signal import cont2discrete

        system: Any = (self.numerator, self.denominator)  # tuples of numbers, of which its types know nothing
        b, a, _ = cont2discrete(system, dt, method="foh")
        return np.asarray(b, dtype=np.float64).ravel(), np.asarray(a, dtype=np.float64).ravel()


@dataclass(frozen=True, eq=False)
class Conversion:
    """Readouts of a pickup to its channels.

    Attributes
    ----------
    function : (n, n_readouts) -> (n, n_channels) without memory, 0 at rest; None: a readout is a channel.
    circuit : of each channel; None without.
    """

    function: Callable[[Floats], Floats] | None = None
    circuit: Circuit | None = None


class Converter:
    """A conversion that runs: applied to one block after another.

    conversion : of the pickup.
    dt : step, s.
    n_channels : of the pickup.
    fault : makes the error of the pickup, of a reason.
    memory : (order, n_channels) of the circuit's filter.
    """

    def __init__(
        self, conversion: Conversion, dt: float, n_channels: int, fault: Callable[[str], TonewoodError] = PluginError
    ):
        self._function, self._filter, self._fault, self._n = conversion.function, None, fault, n_channels
        self.memory: Floats = np.zeros((0, n_channels))
        if conversion.circuit is not None:
            b, a = self._filter = conversion.circuit.discrete(dt)
            self.memory = np.zeros((max(len(a), len(b)) - 1, n_channels))

    def __call__(self, readouts: Floats) -> Floats:
        """(n, n_channels) from (n, n_readouts)."""
        out = readouts if self._function is None else self._called(self._function, readouts)
        if self._filter is None:
            return out
        from scipy.signal import lfilter

        out, self.memory = lfilter(*self._filter, out, axis=0, zi=self.memory)
        return np.asarray(out)

    def _called(self, function: Callable[[Floats], Floats], readouts: Floats) -> Floats:
        try:
            out = np.asarray(function(readouts))
        except (Exception, SystemExit) as raised:  # code of a third party may raise anything
            raise self._fault(f"conversion.function raises {words_of(raised)}") from raised
        if out.shape != (len(readouts), self._n) or out.dtype.kind not in "fi":
            requirement = f"real numbers of shape ({len(readouts)}, {self._n})"
            raise self._fault(f"conversion.function returns {out.dtype} of shape {out.shape}; {requirement} are wanted")
        return out
