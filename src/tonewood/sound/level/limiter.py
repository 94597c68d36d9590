"""A look-ahead peak limiter: nothing leaves it above its ceiling, and it is off unless asked for.

    r[n]  = min(0, ceiling - 20 lg |x[n]|)          gain that sample n needs, dB (the loudest channel decides for all)
    m[n]  = min r[n .. n + L]                       held from L samples before a peak on,
    g[n]  = min(m[n], g[n-1] + release)             and let go at a constant rate,
    y[n]  = x[n] 10^(mean g[n-L .. n] / 20)         ramped over L samples

The mean takes only values that are at most r[n], so |y| <= ceiling holds for every sample.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from tonewood.errors import TonewoodError
from tonewood.support.arrays import Floats

#: samples worked on at a time, counted from the first one: the result does not depend on the blocks that come in
_CHUNK = 4096


class Limiter:
    """Limits a stream; one object per stream.

    fs : sampling rate, Hz.
    ceiling_db : largest level let through, dB re full scale, below 0.
    look_ahead : s.
    release_db_s : how fast the gain comes back, dB/s.
    reduction_db : largest reduction so far, 0 where nothing was limited.
    """

    def __init__(
        self, fs: float, *, ceiling_db: float = -0.1, look_ahead: float = 0.005, release_db_s: float = 60.0
    ) -> None:
        if not -60.0 <= ceiling_db < 0.0:
            raise TonewoodError(f"is {ceiling_db} dB; -60 to just below 0 are allowed", key="ceiling_db")
        self.ceiling_db = ceiling_db
        self.reduction_db = 0.0
        self._length = max(1, round(look_ahead * fs))
        self._release = release_db_s / fs

    def process(self, blocks: Iterable[Floats]) -> Iterator[Floats]:
        """Yield the same number of samples in blocks of the same sizes; the delay of L samples is taken out again.

        blocks : (n, n_channels) each.
        """
        waiting: list[int] = []
        ready: Floats | None = None
        for chunk in self._gained(_regular(blocks, waiting)):
            ready = chunk if ready is None else np.concatenate([ready, chunk])
            while waiting and len(ready) >= waiting[0]:
                size = waiting.pop(0)
                yield ready[:size]
                ready = ready[size:]

    def _gained(self, chunks: Iterable[Floats]) -> Iterator[Floats]:
        L = self._length
        delayed: Floats | None = None  # samples whose gain is not known yet
        needed, smooth, last = np.zeros(0), np.zeros(0), 0.0
        for chunk in chunks:
            delayed = chunk if delayed is None else np.concatenate([delayed, chunk])
            peak = np.max(np.abs(chunk), axis=1, initial=0.0)
            level = 20 * np.log10(np.maximum(peak, 1e-300))
            needed = np.concatenate([needed, np.minimum(0.0, self.ceiling_db - level)])
            n = len(needed) - L
            if n <= 0:
                continue
            done, smooth, last = self._apply(delayed, needed, smooth, last, n)
            delayed, needed = delayed[n:], needed[n:]
            yield done
        if delayed is not None and len(delayed):
            needed = np.concatenate([needed, np.zeros(L)])
            yield self._apply(delayed, needed, smooth, last, len(delayed))[0]

    def _apply(self, x: Floats, needed: Floats, before: Floats, last: float, n: int) -> tuple[Floats, Floats, float]:
        """Gain n samples; returns them, the last L gains, and the gain before the mean."""
        L = self._length
        ahead = sliding_window_view(needed[: n + L], L + 1).min(axis=1)
        slope = self._release * np.arange(1, n + 1)
        gain = np.minimum(np.minimum.accumulate(ahead - slope), last) + slope
        gain = np.minimum(gain, 0.0)
        # the first gain holds for all that was before the stream
        run = np.concatenate([before if before.size else np.full(L, gain[0]), gain])
        mean = sliding_window_view(run, L + 1).mean(axis=1)
        self.reduction_db = max(self.reduction_db, -float(mean.min()))
        # the mean is below each gain needed but for rounding
        limit = 10 ** (self.ceiling_db / 20)
        y = np.where(mean[:, None] < 0.0, np.clip(x[:n] * 10 ** (mean[:, None] / 20), -limit, limit), x[:n])
        return y, run[-L:], float(run[-1])


def _regular(blocks: Iterable[Floats], sizes: list[int]) -> Iterator[Floats]:
    """Yield the samples in chunks of one size, the last one shorter; appends the sizes of the blocks to `sizes`."""
    parts: list[Floats] = []
    n = 0
    for block in blocks:
        sizes.append(len(block))
        parts.append(block)
        n += len(block)
        if n >= _CHUNK:
            pending = np.concatenate(parts)
            for start in range(0, n - _CHUNK + 1, _CHUNK):
                yield pending[start : start + _CHUNK]
            parts, n = [pending[n - n % _CHUNK :]], n % _CHUNK
    if n:
        yield np.concatenate(parts)
