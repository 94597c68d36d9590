"""Scores and instruments as a caller gives them: ready made, or by name."""

from __future__ import annotations

import os

from tonewood.errors import BundleError, ScoreError, kind_of
from tonewood.instrument.bundle.loading import Instrument
from tonewood.performance.score.note import Score

ScoreLike = Score | str | os.PathLike[str]
InstrumentLike = Instrument | str | os.PathLike[str]


def as_score(score: ScoreLike) -> Score:
    """Return a score, read from a file where a path is given.

    Raises ScoreError : it is neither, or the file cannot be read.
    """
    if isinstance(score, Score):
        return score
    if isinstance(score, str | os.PathLike):
        from tonewood.performance.score.reading import (
            read_score,  # scores of MIDI files and written music are not always read
        )

        return read_score(score)
    raise ScoreError(f"is {kind_of(score)}; a Score or the path of a score's file is allowed", key="score")


def as_instrument(instrument: InstrumentLike) -> Instrument:
    """Return an instrument, loaded where its name or folder is given.

    Raises BundleError : it is neither, or there is no such instrument.
    """
    if isinstance(instrument, Instrument):
        return instrument
    if isinstance(instrument, str | os.PathLike):
        return Instrument.load(instrument)
    raise BundleError(f"is {kind_of(instrument)}; an Instrument, its name or its folder is allowed", key="instrument")
