"""Keys of an output's equalizer."""

from __future__ import annotations

from tonewood.support.params import Parameters, quantity


class EqualizerBand(Parameters):
    """A band of an output's equalizer: a bell, or a first-order shelf. `tonewood.sound.equalizer` has the equations."""

    freq: float = quantity("Hz", low=1.0, high=1e5, doc="middle")
    gain_db: float = quantity("dB", low=-60.0, high=60.0, doc="of a bell in its middle; of a shelf far above it")
    q: float | None = quantity(
        "1",
        low=0.05,
        high=100.0,
        default=None,
        doc="quality of a bell; a shelf, half of whose gain is at `freq`, without",
    )
