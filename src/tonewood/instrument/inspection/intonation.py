"""Intonation of strings over real frets, and the nut and saddle that even it out."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from tonewood.instrument.bundle.loading import Instrument
from tonewood.instrument.inspection.frequencies import pitches
from tonewood.instrument.model.assembly import assemble
from tonewood.physics.modal.fretted import FrettedString, compensated
from tonewood.support.units import cents

#: keys with which an instrument's stops sound where its frets put them
REAL_FRETS = {"tuning.at": "frets"}


@dataclass(frozen=True, slots=True)
class Setup:
    """Nut and saddle under one string, and what the frets then sound.

    nut_setback, saddle_setback : m, as in the key `fretboard`.
    cents : of the stops that count, from the first on, above their notes, on a rigid body.
    """

    nut_setback: float
    saddle_setback: float
    cents: tuple[float, ...]

    @property
    def rms(self) -> float:
        """Root of the mean square of `cents`."""
        return math.sqrt(sum(x * x for x in self.cents) / len(self.cents))


@dataclass(frozen=True, slots=True)
class StopIntonation:
    """A stop of a string over its frets; cents above its note.

    stop : its number.
    frets : cents by the places of the frets alone.
    stretch : cents that the rise of tension adds.
    stiffness : cents that bending stiffness adds.
    rests_on : fret at which the string ends; another one than the stop's where a fret stands out.
    planes : component -> cents of its mode on the body.
    """

    stop: int
    frets: float
    stretch: float
    stiffness: float
    rests_on: int
    planes: dict[str, float]

    @property
    def rigid(self) -> float:
        """Cents on a body that does not move."""
        return self.frets + self.stretch + self.stiffness


@dataclass(frozen=True, slots=True)
class StringIntonation:
    """A string over its frets.

    name : of the string.
    string : its geometry, tension and stiffness.
    stops : from the first on.
    built, saddle_alone, both : nut and saddle as they are; the best saddle with this nut; the best saddle and nut. None
        where there is none within a tenth of the scale.
    """

    name: str
    string: FrettedString
    stops: tuple[StopIntonation, ...]
    built: Setup
    saddle_alone: Setup | None
    both: Setup | None


def intonation(instrument: Instrument, *, frets: int = 12, fs: float = 48000.0) -> list[StringIntonation]:
    """Return the intonation of every string of an instrument that has frets.

    instrument : with the keys that `tuning.at: frets` needs; whether it is tuned so does not matter.
    frets : number of stops, from the first on, that the best nut and saddle even out.
    fs : Hz, sampling rate at which strings and body are assembled.
    Raises BundleError : a figure is missing; names the key.
    """
    model = assemble(instrument.replace(REAL_FRETS), fs, alone=True)
    names = [name for name in model.groups if model.strings[name].n_stops]
    tones = pitches(model, names)
    out = []
    for name in names:
        string = model.strings[name]
        fretted = string.stopping.fretted
        assert fretted is not None
        freqs = string.tuning.stops.freqs
        ratios = [freq / freqs[0] for freq in freqs[1:]]
        flexible = replace(fretted, bending_stiffness=0.0)
        rows = []
        for p in (p for p in tones if p.string == name and p.stop):
            opened, pressed = fretted.board.pressed(0), fretted.board.pressed(p.stop)
            by = [opened.length / pressed.length, flexible.ratio(p.stop), fretted.ratio(p.stop)]
            fret_cents, stretched, stiff = (cents(ratio / ratios[p.stop - 1]) for ratio in by)
            planes = {plane.component: plane.cents for plane in p.planes}
            row = StopIntonation(p.stop, fret_cents, stretched - fret_cents, stiff - stretched, pressed.fret, planes)
            rows.append(row)
        out.append(StringIntonation(name, fretted, tuple(rows), *_setups(fretted, ratios[:frets])))
    return out


def _setups(string: FrettedString, ratios: list[float]) -> tuple[Setup, Setup | None, Setup | None]:
    """Nut and saddle as built, the best saddle alone, and the best of both."""

    def setup(s: FrettedString) -> Setup:
        errors = tuple(float(x) for x in s.cents(ratios))
        return Setup(s.board.nut_setback, s.board.saddle_setback, errors)

    best: list[Setup | None] = []
    for nut in (False, True):
        try:
            best.append(setup(compensated(string, ratios, nut=nut)))
        except ValueError:
            best.append(None)
    return setup(string), best[0], best[1]
