"""What listeners just noticed in experiments, as others published it: thresholds for changes of an instrument.

Every threshold is that of a trained or the best listener under quiet conditions: a change below it is hardly heard, one
above it may be.

Sources: of one resonance, Delta F = 0.079 F / sqrt(Q), J. P. Gagné and P. M. Zurek, Resonance-frequency discrimination,
J. Acoust. Soc. Am. 83 (1988) 2293, for Q from 1 to 36 and 300 to 2000 Hz, extrapolated here; of all body modes of a
guitar together, J. Woodhouse, E. K. Y. Manuel, L. A. Smith, A. J. C. Wheble and C. Fritz, Perceptual thresholds for
acoustical guitar models, Acta Acust. united Acust. 98 (2012) 475: about 1 % of frequency, as others cite it, and about
20 % of damping, which was not checked in the paper; of level, Delta I / I = 0.463 (I / I_0)^-0.072, W. Jesteadt,
C. C. Wier and D. M. Green, J. Acoust. Soc. Am. 61 (1977) 169, 40 dB above threshold; of decay, H. Järveläinen and
T. Tolonen, Perceptual tolerances for decay parameters in plucked string synthesis, J. Audio Eng. Soc. 49 (2001) 1049.
"""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Threshold:
    """Least change that was noticed.

    less, more : size of the least change downwards and upwards, in the unit of the change, above 0.
    source : authors and year.
    """

    less: float
    more: float
    source: str

    def times(self, change: float) -> float:
        """How many times the least change a change is."""
        return abs(change) / (self.less if change < 0 else self.more)


def resonance(q: float) -> Threshold:
    """Of the frequency of one resonance, %."""
    least = 7.9 / math.sqrt(max(q, 1.0))
    return Threshold(least, least, "Gagné and Zurek 1988")


BODY_FREQ = Threshold(1.0, 1.0, "Woodhouse et al. 2012")
BODY_DAMPING = Threshold(20.0, 20.0, "Woodhouse et al. 2012")
#: dB, of a sound 40 dB above the threshold of hearing
_LEVEL = 10 * math.log10(1 + 0.463 * 10 ** (-0.072 * 4))
LEVEL = Threshold(_LEVEL, _LEVEL, "Jesteadt et al. 1977")
#: % of a decay's time constant
DECAY = Threshold(25.0, 40.0, "Järveläinen and Tolonen 2001")
