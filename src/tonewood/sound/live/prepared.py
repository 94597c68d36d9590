"""Ways to hold strings, compiled before they are played."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import replace

from tonewood.instrument.contract.gestures import Event
from tonewood.instrument.model.assembly import Model
from tonewood.performance.player.between_notes import damping
from tonewood.performance.player.fretting import FrettedBases, Fretting
from tonewood.performance.player.player import rounded
from tonewood.performance.player.voices import CONTINUED

#: compiled ways to hold a string that are kept, besides those of `prepare`
_ROOM = 256


class PreparedBases:
    """Compiles how strings are held, all at once or while nothing else is to be done; the samples do not depend on it.

    model : instrument.
    fingerboard : that keeps the bases.
    capo : stop of the idle strings.
    """

    def __init__(self, model: Model, fingerboard: FrettedBases, capo: int):
        self._model, self._fingerboard = model, fingerboard
        fingerboard.room = max(fingerboard.room, _ROOM)
        strings = model.strings.items()
        self._places = [(name, stop) for name, string in strings for stop in range(capo, string.n_stops + 1)]
        #: (string, stop, values) of ways to pluck that are still to be compiled
        self._waiting: deque[tuple[str, int, Mapping[str, float]]] = deque()

    @property
    def waiting(self) -> bool:
        """Whether something is still to be compiled."""
        return bool(self._waiting)

    def prepare(self) -> None:
        """Compile how strings are held at every stop by the default technique, and damped, and all tensions.

        Without this a note takes up to 10 ms more the first time that its stop is played, and so do stops of a slide.
        """
        for string in self._model.strings.values():
            string.tuning.prepare_all()
        for name, stop in self._places:
            fretting = self._compile(name, stop, {})
            under = replace(fretting, damper=1.0) if self._model.strings[name].places.damper else None
            damped = replace(fretting, added_damping=damping(self._model.playing.note_end))
            for way in (fretting, under or damped):
                self._fingerboard.prepare(name, way)

    def moved(self, kind: str, value: float) -> None:
        """Begin to compile the frettings for plucks at the position that a controller asks for."""
        control = self._model.playing.controls.get(kind)
        if control is not None and control.parameter == f"{self._model.default_exciter}.from_bridge":
            values = {"from_bridge": rounded(control.value(value))}
            self._waiting = deque((name, stop, values) for name, stop in self._places)

    def compile_one(self) -> bool:
        """Compile one way that waits; whether there was one."""
        if self._waiting:
            self._compile(*self._waiting.popleft())
            return True
        return False

    def _compile(self, name: str, stop: int, values: Mapping[str, float]) -> Fretting:
        """Compile how a string is held at a stop when it is plucked with some values of the default technique."""
        string, fingerboard = self._model.strings[name], self._fingerboard
        event = Event(values, string.freq(stop), CONTINUED, stop, 0.0, string.length(0.0))
        gesture = self._model.exciter(self._model.default_exciter, name).gesture(event, self._model.place(name, stop))
        request = Fretting(float(stop), place=gesture.from_bridge, width=gesture.width)
        fretting = fingerboard.playable(name, request)
        bases = fingerboard.bases(name, fretting)
        for component in () if gesture.on else string.weights(gesture.angle_deg):
            bases[component].impulses("pluck")
        return fretting
