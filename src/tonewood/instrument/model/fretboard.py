"""The fretboard under a string, from the bundle: positions and heights of frets, nut and saddle."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from tonewood.errors import BundleError
from tonewood.instrument.bundle.loading import Instrument
from tonewood.instrument.bundle.string_schema import Fretboard
from tonewood.instrument.contract.registry import MANIFEST
from tonewood.physics.modal.fretted import FretboardGeometry, FrettedString

#: place of the finger behind its fret where the bundle gives none, m
_FINGER = 5e-3


def fretted_string(instrument: Instrument, name: str) -> FrettedString:
    """Return a string over its frets, at the tension of its note on a rigid body.

    Raises BundleError : heights, places of all frets or the stiffness in slow stretch are not stated; or the open
        string lies on a fret.
    """
    part, resonator = instrument.spec.strings[name], instrument.resonators[name]
    keys = _given(instrument, name)
    stiffness = part.fretting_stiffness
    if stiffness is None:
        stiffness = getattr(resonator.parameters, "axial_stiffness", None)
    if stiffness is None:
        raise _fault(
            instrument,
            f"strings.{name}.fretting_stiffness",
            "is missing; E A in slow stretch, in N, or `made_of`, or a string set that has it, is wanted for frets",
        )
    freq = instrument.tuning.freq(instrument.open_note(name))
    string = FrettedString(
        _fretboard(instrument, name, keys),
        resonator.linear_density * (2 * resonator.length * freq) ** 2 or resonator.tension,
        resonator.bending_stiffness,
        stiffness,
    )
    string = string.moved(keys.get("nut_setback", 0.0), keys.get("saddle_setback", 0.0))
    if fret := string.board.pressed(0).fret:
        raise _fault(instrument, "stops.fretboard", f"lets the open string {name} lie on fret {fret}: raise the action")
    return string


def _given(instrument: Instrument, name: str) -> Mapping[str, Any]:
    """Keys of the fretboard under a string: its own, those of all strings, those of a part that has frets."""
    spec, common = instrument.spec, Fretboard()
    fields = set(Fretboard.model_fields)
    for key, attachment in instrument.attachments.items():
        values = attachment.parameters.model_dump(include=fields)
        if "action_first" in values and name in (spec.connections[key].strings or [name]):
            common = Fretboard(**values)
    fretboard = spec.strings[name].fretboard.over(spec.stops.fretboard.over(common))
    return fretboard.model_dump(exclude_none=True)


def _fretboard(instrument: Instrument, name: str, keys: Mapping[str, Any]) -> FretboardGeometry:
    """Geometry without setbacks, its heights over the plane of the crowns without relief."""
    length = instrument.resonators[name].length
    places = _places(instrument, name, keys, length)

    def point(at_end: tuple[str, float], between: tuple[str, float]) -> tuple[float, float]:
        for key, x in (at_end, between):
            if key in keys:
                return x, float(keys[key])
        reason = f"is missing; it or `{between[0]}`, in m, is wanted for frets"
        raise _fault(instrument, f"stops.fretboard.{at_end[0]}", reason)

    # a line z(x) = height + slope x through two of the four
    start = point(("nut_height", 0.0), ("action_first", places[0]))
    end = point(("saddle_height", length), ("action_twelfth", length / 2))
    slope = (end[1] - start[1]) / (end[0] - start[0])
    height = start[1] - slope * start[0]
    relief, single = keys.get("relief", 0.0), keys.get("heights", {})
    shares = [x / places[-1] for x in places]
    crowns = [single.get(str(n), 0.0) - 4 * relief * s * (1 - s) for n, s in enumerate(shares, 1)]
    return FretboardGeometry(
        length,
        places,
        tuple(crowns),
        height,
        height + slope * length,
        finger=keys.get("finger", _FINGER),
        press_depth=keys.get("press_depth", 0.0),
        behind=keys.get("behind", 0.0),
    )


def _places(instrument: Instrument, name: str, keys: Mapping[str, Any], length: float) -> tuple[float, ...]:
    """Places of the frets of a string, m from the nut's end of the scale."""
    spec, part = instrument.spec, instrument.spec.strings[name]
    count = spec.stops.count if part.stops is None else part.stops
    if "places" in keys:
        places = keys["places"]
        if len(places) < count or (places and places[-1] >= length):
            reason = (
                f"has {len(places)} frets up to {max(places, default=0.0):g} m; {count} below {length:g} m are wanted"
            )
            raise _fault(instrument, "stops.fretboard.places", reason)
        return tuple(float(x) for x in places[:count])
    if "rule" in keys:
        return tuple(length * (1 - (1 - 1 / keys["rule"]) ** n) for n in range(1, count + 1))
    note = instrument.open_note(name)
    freqs = [instrument.tuning.freq(note + n) for n in range(count + 1)]
    return tuple(length * (1 - freqs[0] / freq) for freq in freqs[1:])


def _fault(instrument: Instrument, key: str, reason: str) -> BundleError:
    return BundleError(reason, file=instrument.folder / MANIFEST, key=key)
