"""Beginning and end of a stimulus: equal onsets to the sample, and no silence at the end.

The *onset* is the first sample whose absolute value, in any channel, reaches `level_db` re the sound's peak. It is
shifted to the same sample of every file, so that switching between two sounds compares their attacks. The fade-in lies
before it.

The *end* is that of the last block whose level is above `level_db` re the loudest block. The level of a block is its
mean square over time, in the loudest channel:

    L = 10 log10( max_c (1/N) sum_n x_c[n]^2 )

With -60 dB, a sound played at 70 dB SPL ends below 10 dB SPL, under the noise of a quiet room.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Samples = NDArray[np.float64]


def onset(audio: Samples, level_db: float) -> int:
    """Index of the first sample at or above a level re the peak; 0 for silence.

    audio : (n, channels).
    level_db : dB re the largest absolute sample.
    """
    envelope = np.abs(audio).max(axis=1, initial=0.0)
    peak = float(envelope.max(initial=0.0))
    return int(np.argmax(envelope >= peak * 10.0 ** (level_db / 20.0))) if peak > 0.0 else 0


def shifted(audio: Samples, by: int) -> Samples:
    """The sound with `by` zeros put before it, or, if negative, so many samples cut from its beginning."""
    return audio[-by:] if by <= 0 else np.pad(audio, ((by, 0), (0, 0)))


def end(audio: Samples, block: int, level_db: float) -> int:
    """Length up to the end of the last block above a level re the loudest block; at least one block.

    audio : (n, channels).
    block : samples.
    level_db : dB re the loudest block.
    """
    n = len(audio)
    squares = np.pad(audio**2, ((0, -n % block), (0, 0))).reshape(-1, block, audio.shape[1])
    level = squares.mean(axis=1).max(axis=1)
    above = np.flatnonzero(level > level.max(initial=0.0) * 10.0 ** (level_db / 10.0))
    return min(n, (int(above[-1]) + 1 if above.size else 1) * block)


def convolved(audio: Samples, response: Samples) -> Samples:
    """The sound in a room: each channel with its channel of the impulse response, or one with all of the other.

    audio, response : (n, c) and (m, d); c and d are equal, or one of them is 1.
    Returns (n + m - 1, max(c, d)).
    """
    from scipy.signal import oaconvolve

    channels = max(audio.shape[1], response.shape[1])
    sound, room = (np.broadcast_to(x, (len(x), channels)) for x in (audio, response))
    return np.asarray(oaconvolve(sound, room, axes=0), dtype=np.float64)
