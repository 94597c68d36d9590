"""What can be said of an instrument without playing it: coupled modes, tuning, wolf notes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from tonewood.instrument.assembly import Model
from tonewood.numerics.coupled_modes import CoupledModes, coupled_modes
from tonewood.score.scales import note_name
from tonewood.units import cents, t60


@dataclass(frozen=True, slots=True)
class StopReport:
    """One string at one stop.

    Attributes
    ----------
    string, stop, note : which, and the name of the note.
    target_freq, freq : Hz, asked for and of the string-dominated coupled mode.
    cents : how far the one is from the other.
    t60 : s, of that mode.
    string_share : of its energy, in all polarizations of the string.
    tension : N.
    wolf_freq, wolf_cents, wolf_db : a second strong mode and its distance and level from the first; None if there is none.
    """

    string: str
    stop: int
    note: str
    target_freq: float
    freq: float
    cents: float
    t60: float
    string_share: float
    tension: float
    wolf_freq: float | None = None
    wolf_cents: float | None = None
    wolf_db: float | None = None

    @property
    def is_wolf(self) -> bool:
        """Whether a second strong mode is near."""
        return self.wolf_freq is not None


def stop_reports(
    model: Model, *, strings: Sequence[str] | None = None, stops: Sequence[int] | None = None
) -> Iterator[StopReport]:
    """Tuning of every string at every stop, some ten milliseconds each."""
    for name in strings or model.strings:
        string = model.strings[name]
        for stop in range(string.n_stops + 1) if stops is None else stops:
            freq, tension = string.freq(stop), string.tension(stop)
            tuned = string.tuned(stop) or string.untuned(stop)
            first, wolf = tuned.modes[0], tuned.wolf
            yield StopReport(
                string=name,
                stop=stop,
                note=note_name(string.open_note + stop),
                target_freq=freq,
                freq=first.freq,
                cents=tuned.error_cents,
                t60=t60(-first.pole.real),
                string_share=sum(first.shares[:-1]),
                tension=tension,
                wolf_freq=wolf.freq if wolf else None,
                wolf_cents=cents(wolf.freq / first.freq) if wolf else None,
                wolf_db=wolf.level_db(first) if wolf else None,
            )


def wolf_notes(model: Model) -> list[StopReport]:
    """Stops with a second strong mode near their pitch."""
    return [report for report in stop_reports(model) if report.is_wolf]


def string_modes(model: Model, string: str, stop: float = 0, *, freq_upper: float | None = None) -> CoupledModes:
    """Every coupled mode of one string at a stop and the body, the other strings left out.

    Parameters
    ----------
    freq_upper : Hz, highest coupled mode wanted; component modes are kept up to twice that.
    """
    components = {"body": model.system.compiled[model.system.slot("body")].basis, **model.strings[string].bases(stop)}
    joints = {f"{component}.bridge" for component in model.strings[string].components}
    connections = [c for c in model.system.connections if c.name in joints]
    return coupled_modes(components, connections, freq_upper=None if freq_upper is None else 2 * freq_upper)
