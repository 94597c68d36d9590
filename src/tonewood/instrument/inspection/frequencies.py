"""Properties of an assembled instrument, without playing it: pitches, partials, wolf notes, mobility, microphones."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from tonewood.instrument.model.assembly import Model
from tonewood.instrument.model.strings import StringModel
from tonewood.instrument.model.tuning import CoupledMode, TunedStop, ends_at_rest
from tonewood.instrument.model.untuned_bases import held_freq
from tonewood.physics.modal.modes import ModalBasis
from tonewood.physics.modal.receptance import Joint, Ports
from tonewood.support.arrays import Complexes, Floats
from tonewood.support.units import cents, t60

#: a string-dominated mode farther than this from its pitch is reported, cents
TOLERANCE_CENTS = 1.0
#: a plane farther than this from the pitch that its split gives it is reported, cents
PLANE_CENTS = 5.0
#: change of the bridge's displacement by a new stop that counts as rounding, relative to its largest shape
_KEPT_BRIDGE = 1e-6


@dataclass(frozen=True, slots=True)
class PlanePitch:
    """One polarization of a string at a stop on its body.

    The tuner gives the first one the note; its tension gives the others theirs, which a body mode shifts otherwise.

    component : of the polarization.
    freq : Hz, of the coupled mode with the largest share of its energy in it.
    cents : of that mode above the note.
    split_cents : by which the bundle has it sharper than the first.
    share : of the mode's energy in it.
    """

    component: str
    freq: float
    cents: float
    split_cents: float
    share: float

    @property
    def off_cents(self) -> float:
        """Cents above the pitch that the note and the split give it."""
        return self.cents - self.split_cents


@dataclass(frozen=True, slots=True)
class Pitch:
    """A string at a stop as it sounds on its body.

    string, stop : name of the string, number of the stop.
    note : MIDI number, fractional in other tunings.
    wanted_freq : Hz, of the note.
    tension : N, of the first polarization.
    modes : coupled modes near the pitch, the string-dominated one first.
    wolf : a second mode that disturbs the first, or None.
    planes : every polarization, the first one first.
    """

    string: str
    stop: int
    note: float
    wanted_freq: float
    tension: float
    modes: tuple[CoupledMode, ...]
    wolf: CoupledMode | None
    planes: tuple[PlanePitch, ...]

    @property
    def freq(self) -> float:
        """Frequency of the string-dominated mode, Hz."""
        return self.modes[0].freq

    @property
    def error_cents(self) -> float:
        """Cents of the string-dominated mode above the note."""
        return cents(self.freq / self.wanted_freq)

    @property
    def t60(self) -> float:
        """T60 of the string-dominated mode, s."""
        return t60(-self.modes[0].pole.real)


@dataclass(frozen=True, slots=True)
class Partial:
    """A partial of one string on its body.

    number : 1 is the fundamental.
    freq : Hz.
    cents : from `number` times the note.
    t60 : s.
    shares : of the modal energy: one per polarization, then the body's.
    """

    number: int
    freq: float
    cents: float
    t60: float
    shares: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class MicrophoneResponse:
    """Strongest response of a microphone, or of another readout of a one-way bank, to the force of one string.

    output, channel, unit : name of the output group and of its channel; unit of its samples.
    n_modes : of the bank below the highest frequency that is stepped.
    peak, freq : unit per N and Hz, the largest magnitude from 20 Hz on; 0 and nan where it hears no string.
    full_scale : value at 0 dBFS, in `unit`.
    """

    output: str
    channel: str
    unit: str
    n_modes: int
    peak: float
    freq: float
    full_scale: float


@dataclass(frozen=True, slots=True)
class StringFeel:
    """An open string under the hands and on the bridge.

    from_bridge : m, where it is plucked.
    newton_per_mm : N/mm, force that pushes it aside there; None where that place is an end.
    break_angle_deg : angle over the bridge; None where the bundle has none.
    force_on_bridge : N, down on the bridge; None without an angle.
    """

    from_bridge: float
    newton_per_mm: float | None
    break_angle_deg: float | None
    force_on_bridge: float | None


def feel(model: Model, name: str) -> StringFeel:
    """Force that pushes an open string aside, and force down on its bridge.

    A stretched string gives way to F at a from one end and b from the other by F a b / (T (a + b)), and presses on the
    bridge with T sin(angle).
    """
    string = model.strings[name]
    tension, a = string.tension(0.0), string.places.pluck
    b = string.length() - a
    angle = model.instrument.spec.strings[name].break_angle_deg
    return StringFeel(
        from_bridge=a,
        newton_per_mm=1e-3 * tension * (a + b) / (a * b) if a > 0 and b > 0 else None,
        break_angle_deg=angle,
        force_on_bridge=None if angle is None else tension * math.sin(math.radians(angle)),
    )


def pitch(model: Model, string: str, stop: int = 0) -> Pitch:
    """Return the pitch of a string at one stop of a `model`: tuned, or at the bundle's tension without compensation."""
    string_model = model.strings[string]
    tuned = string_model.tuned(stop)
    freq, planes = string_model.freq(stop), _planes(string_model, stop, tuned)
    return Pitch(string, stop, string_model.open_note + stop, freq, tuned.tension, tuned.modes, tuned.wolf, planes)


def _planes(string: StringModel, stop: int, tuned: TunedStop) -> tuple[PlanePitch, ...]:
    """Pitches of a string's polarizations: of each the mode, of `tuned` or near it, with most of its energy there."""
    poles = [(mode.pole, mode.shares) for mode in tuned.modes]
    out = []
    for i, (polarization, split) in enumerate(zip(string.polarizations, string.tuning.plane_cents(stop), strict=True)):
        modes = poles[:1] if i == 0 else poles
        if i and max(shares[i] for _, shares in modes) < 0.5:  # the tuner has looked for the first one
            coupled = string.tuning.coupled(stop)
            joint, freq = coupled.joint(tuned.tension), held_freq(coupled.bases(tuned.tension)[i])
            pole = None if freq is None else joint.newton(2 * math.pi * freq * complex(-1e-3, 1.0))
            modes = modes if pole is None else [*modes, (pole, tuple(float(x) for x in joint.shares(pole)))]
        pole, shares = max(modes, key=lambda mode: mode[1][i])
        freq = pole.imag / (2 * math.pi)
        out.append(PlanePitch(polarization.component, freq, cents(freq / string.freq(stop)), split, shares[i]))
    return tuple(out)


def pitches(model: Model, strings: Sequence[str] | None = None) -> list[Pitch]:
    """Return the pitches of `strings` of a `model` at every whole stop; of each key's first where none are named."""
    names = model.groups if strings is None else strings
    return [pitch(model, name, stop) for name in names for stop in range(model.strings[name].n_stops + 1)]


def partials(model: Model, string: str, stop: int = 0, *, count: int = 12) -> list[Partial]:
    """Find the partials of a string on its body: string-dominated coupled modes.

    The search for each begins at the partial of that number of the same string, at its tension, on a rigid bridge.

    Parameters
    ----------
    model : assembled instrument.
    string, stop : name of the string; number of its stop, 0 open.
    count : of partials at most; they lie below the string's highest mode.

    Returns
    -------
    Partials from the first on, each with frequency, cents, T60 and shares of energy.
    """
    at, coupled = pitch(model, string, stop), model.strings[string].tuning.coupled(stop)
    joint = coupled.joint(at.tension)
    rigid = held_partials(coupled.bases(at.tension)[0], count)
    coupled_partials = []
    for number, freq in enumerate(rigid, 1):
        near = [
            (s, shares) for s, shares in coupled.poles(joint, freq) if abs(s.imag / (2 * math.pi) - freq) < rigid[0] / 2
        ]
        if near:
            s, shares = near[0]
            f = s.imag / (2 * math.pi)
            coupled_partials.append(Partial(number, f, cents(f / (number * at.wanted_freq)), t60(-s.real), shares))
    return coupled_partials


def held_partials(basis: ModalBasis, count: int) -> list[float]:
    """Frequencies of a string held at the bridge, Hz, from the fundamental on, at most `count`."""
    if ends_at_rest(basis):
        return [float(freq) for freq in np.sort(basis.natural_freq)[:count]]
    joint = Joint([Ports.of(basis, np.eye(len(basis.points))[[basis.index("bridge")]])])
    out: list[float] = []
    last, step = 0.0, held_freq(basis) or math.inf
    while len(out) < count and last + step < float(basis.natural_freq.max()):
        zero = joint.newton(2 * math.pi * (last + step) * complex(-1e-4, 1.0), steps=80)
        if zero is None or zero.imag / (2 * math.pi) <= last + step / 2:
            break
        freq = zero.imag / (2 * math.pi)
        last, step = freq, freq - last
        out.append(freq)
    return out


def bridge_mobility(
    model: Model, freq: Sequence[float] | Floats, strings: Sequence[str] | None = None
) -> dict[str, Complexes]:
    """Driving-point mobility of the body where each string ends, (m/s)/N; without strings, with the parts added to it.

    freq : (n,) Hz.
    strings : their names; the first of every key, and all that have no key, where left out.
    Returns string -> (n,), along the body point's direction; a string on a rigid end is left out. Of a body without
        strings, point -> (n,).
    """
    if not model.strings:
        return {point: model.body.frf(freq, point, point) for point in model.body_points}
    out: dict[str, Complexes] = {}
    for name in model.groups if strings is None else strings:
        string = model.strings[name]
        ends = string.polarizations[0].ends
        if ends:
            point = max(ends, key=lambda p: abs(ends[p]))
            out[name] = model.body.frf(freq, point, point)
    return out


def mobility_peaks(model: Model, string: str, *, count: int = 6) -> list[tuple[float, float]]:
    """The strongest resonances of the body where a string ends: (Hz, (m/s)/N), by frequency; without strings."""
    freq = np.geomspace(20.0, 0.45 * model.fs, 20000)
    mobilities = bridge_mobility(model, freq, [string])
    if string not in mobilities:
        return []
    size = np.abs(mobilities[string])
    peaks = 1 + np.flatnonzero((size[1:-1] > size[:-2]) & (size[1:-1] >= size[2:]))
    strongest = peaks[np.argsort(-size[peaks])[:count]]
    return [(float(freq[i]), float(size[i])) for i in np.sort(strongest)]


def mobility_bands(basis: ModalBasis, points: Sequence[str], edges: ArrayLike) -> Floats:
    """(bands,) dB re 1 (m/s)/N: mean of 20 lg |Y| over points and 400 frequencies, even in logarithm, of each band.

    points : of the body, each driven and read in its own direction.
    edges : (bands + 1,) Hz.
    """
    levels = []
    for low, high in pairwise(np.asarray(edges, dtype=np.float64)):
        freq = np.geomspace(low, high, 400)
        levels.append(np.mean([20 * np.log10(np.abs(basis.frf(freq, point, point))) for point in points]))
    return np.array(levels)


def microphone_responses(model: Model) -> list[MicrophoneResponse]:
    """Strongest response of every channel that reads a one-way bank, in the order of the outputs."""
    compiled = dict(zip(model.system.names, model.system.compiled, strict=True))
    banks = {drive.component for drive in model.system.drives}
    out = []
    for group in model.outputs:
        if group.conversion is not None:
            continue  # its channels are no longer those of the bank
        for channel, column in zip(group.channels, group.columns, strict=True):
            readout = model.system.readouts[group.readouts[column]]
            probes = [probe for probe in readout.probes if probe.component in banks]
            if not probes:
                continue
            bases = [compiled[name].basis for name in sorted({probe.component for probe in probes})]
            resonances = np.concatenate([basis.natural_freq for basis in bases])
            freq = np.unique(np.concatenate([np.geomspace(20.0, 0.45 * model.fs, 500), resonances[resonances >= 20.0]]))
            by_connection: dict[str, Complexes] = {}
            form = "accelerance" if readout.quantity == "acceleration" else "receptance"
            for drive in model.system.drives:
                for probe in (probe for probe in probes if probe.component == drive.component):
                    frf = compiled[probe.component].basis.frf(freq, probe.point, drive.point, form)
                    heard = by_connection.setdefault(drive.connection, np.zeros(freq.shape, dtype=np.complex128))
                    heard += probe.factor * drive.factor * frf
            size = np.max([np.abs(h) for h in by_connection.values()], axis=0, initial=0.0) * np.ones(freq.shape)
            at = int(np.argmax(size))
            out.append(
                MicrophoneResponse(
                    group.name,
                    channel,
                    group.unit,
                    sum(basis.n_modes for basis in bases),
                    float(size[at]),
                    float(freq[at]) if size[at] > 0 else math.nan,
                    group.full_scale,
                )
            )
    return out


def check_transfers(model: Model) -> None:
    """Check the matrices by which every string's motion is carried from its open length to the first stop.

    Raises BundleError : names a string whose plugin gives matrices of another shape or with numbers that are not
        finite, or that move the bridge.
    """
    for string in model.strings.values():
        if not string.n_stops:
            continue
        opened, stopped = string.bases(0), string.bases(1)
        for component in string.components:
            old, new = opened[component], stopped[component]
            displacement, velocity = string.transfer(component, old, new)
            for quantity, matrix in (("displacement", displacement), ("velocity", velocity)):
                if matrix.shape != (new.n_modes, old.n_modes):
                    shape = f"{new.n_modes} x {old.n_modes}"
                    raise string.resonator.fault(f"transfer: {quantity} has shape {matrix.shape}; {shape} is wanted")
                if not np.isfinite(matrix).all():
                    raise string.resonator.fault(f"transfer: {quantity} holds numbers that are not finite")
            before = old.right[old.index("bridge")].real
            moved = float(np.abs(new.right[new.index("bridge")].real @ displacement - before).max())
            if moved > _KEPT_BRIDGE * float(np.abs(before).max()):
                raise string.resonator.fault("transfer: the string's end at the bridge moves when the stop changes")
