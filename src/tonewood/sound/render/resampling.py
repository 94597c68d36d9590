"""Changes the rate of a streamed sound by a linear-phase filter: from the engine's rate to that of the sound."""

from __future__ import annotations

from fractions import Fraction

import numpy as np

from tonewood.support.arrays import Floats

#: attenuation of frequencies that would alias, dB; width of the transition re the lower of the two rates
_ATTENUATION_DB, _TRANSITION = 110.0, 0.1


class Resampler:
    """Streams a sound from p steps to q frames, without delay: flat to 0.45 of the lower rate, then -110 dB.

    Frame m lies at sample m p / q. Its value is the sum over samples s of x_s h(m p - s q), h being the taps of a
    filter at the rate of both, p times that of the frames.

    ratio : p / q, samples that go in per frame that comes out; 1 leaves the sound as it is.
    n_channels : columns.
    """

    def __init__(self, ratio: Fraction, n_channels: int):
        self.ratio = ratio
        p, q = ratio.numerator, ratio.denominator
        self._half, taps = 0, np.ones(1)
        if ratio != 1:
            from scipy.signal import firwin, kaiserord

            # the transition goes from 0.9 to 1.0 of the lower Nyquist frequency
            factor = max(p, q)
            length, beta = kaiserord(_ATTENUATION_DB, _TRANSITION / factor)
            self._half = -(-(length // 2) // p) * p
            taps = q * firwin(2 * self._half + 1, 0.95 / factor, window=("kaiser", beta))
        size = -(-len(taps) // q)
        padded = np.zeros(size * q)
        padded[: len(taps)] = taps
        # taps of each phase, the earliest sample first, cut into those of every p-th sample
        phases = padded.reshape(size, q).T[:, ::-1]
        self._phases = [[phase[r::p].copy() for r in range(p)] for phase in phases]
        self.memory: Floats = np.zeros((size - 1, n_channels))

    def frame(self, sample: int) -> int:
        """Return the first frame that the samples before `sample` do not determine: the next one that comes out."""
        p, q = self.ratio.numerator, self.ratio.denominator
        return -((self._half - sample * q) // p)

    def samples(self, frames: float) -> float:
        """Samples in so many frames."""
        return frames * self.ratio.numerator / self.ratio.denominator

    def __call__(self, sound: Floats, sample: int) -> Floats:
        """Return the frames that the next samples of a sound complete.

        sound : (n, n_channels), the samples from number `sample` on; those before are in the memory.
        Returns (n_frames, n_channels), frames `frame(sample)` to `frame(sample + n)`, the latter not included.
        """
        if self.ratio == 1:
            return sound
        p, q = self.ratio.numerator, self.ratio.denominator
        joined = np.concatenate([self.memory, sound])
        self.memory = joined[len(joined) - len(self.memory) :]
        first, stop = self.frame(sample), self.frame(sample + len(sound))
        out = np.empty((stop - first, sound.shape[1]))
        for k in range(min(q, stop - first)):
            last, phase = divmod((first + k) * p + self._half, q)
            count = len(range(first + k, stop, q))
            for channel in range(out.shape[1]):
                out[k::q, channel] = _correlated(joined[last - sample :, channel], self._phases[phase], count)
        return out


def _correlated(x: Floats, parts: list[Floats], count: int) -> Floats:
    """Sums over r and i of x[j p + r + i p] parts[r][i], j from 0 to count - 1; they do not depend on `count`."""
    strided = [x[r :: len(parts)] if len(parts) > 1 else x for r in range(len(parts))]
    sums = [np.correlate(taps[: count + len(part) - 1], part) for taps, part in zip(strided, parts, strict=True)]
    return np.asarray(sum(sums[1:], sums[0]))
