"""The figures of an instrument that are estimated, and the overrides that put them into it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from tonewood.instrument.bundle.loading import Instrument
from tonewood.instrument.contract.losses import StringData
from tonewood.sound.equalizer import response_db
from tonewood.support.arrays import Floats
from tonewood.workshop.estimate import gain
from tonewood.workshop.estimate.laws import LinearLoss
from tonewood.workshop.estimate.playing import Stage, strings_of


@dataclass(frozen=True, eq=False)
class Figures:
    """Figures in one state of the estimate.

    laws : string that gives a pitch -> its loss law.
    bending : string -> N m^2.
    place : m, or a fraction of the speaking length, as the bundle says it; None where it is not estimated.
    gains : output -> (15,) dB at `gain.KNOTS`, on top of the bundle's own equalizer.
    split : cents, standard deviation between the two polarizations; None where strings have one.
    modes : Hz of a body mode in its table -> ratios by which its frequency and its Q are moved.
    edge : m, radius over which the string slips, of the default exciter; None where that has none.
    forces : N at MIDI velocity 1 and 127; None where the velocity is not a force.
    estimated : string -> whether its own notes say anything; the others follow their neighbours.
    """

    laws: Mapping[str, LinearLoss]
    bending: Mapping[str, float]
    place: float | None
    gains: Mapping[str, Floats]
    split: float | None
    modes: Mapping[float, tuple[float, float]] = field(default_factory=dict)
    edge: float | None = None
    forces: tuple[float, float] | None = None
    estimated: Mapping[str, bool] = field(default_factory=dict)

    def overrides(self, instrument: Instrument) -> dict[str, Any]:
        """Overrides of the instrument that it was begun with."""
        out: dict[str, Any] = {}
        for lead, law in self.laws.items():
            for name in strings_of(instrument, lead):
                for parameter, value in zip(law.names, law.values, strict=True):
                    out[f"strings.{name}.loss.{parameter}"] = _rounded(value)
                if self.bending[lead] > 0:
                    out[f"strings.{name}.bending_stiffness"] = _rounded(self.bending[lead])
                if self.split is not None:
                    out[f"strings.{name}.{split_key(instrument)}"] = _rounded(self.split)
        exciter = instrument.spec.playing.default_exciter
        if self.place is not None:
            out[f"exciters.{exciter}.from_bridge"] = _place(instrument, self.place)
        if self.edge != edge_of(instrument) and self.edge is not None:
            out[f"exciters.{exciter}.edge"] = _rounded(self.edge)
        if self.forces != forces_of(instrument) and self.forces is not None:
            out |= {f"playing.velocity.{k}": _rounded(v) for k, v in zip(("low", "high"), self.forces, strict=True)}
        for path, moved in self.moved_modes(instrument).items():
            out[f"{path}.moved_modes"] = moved
        for output, curve in self.gains.items():
            if np.any(curve):
                bands = gain.bands_of(curve + _own_gain(instrument, output))
                out[f"outputs.{output}.equalizer"] = [
                    {"freq": f, "gain_db": g} | ({} if q is None else {"q": q}) for f, g, q in bands
                ]
        return out

    def moved_modes(self, instrument: Instrument) -> dict[str, list[dict[str, float]]]:
        """Path of the body and of outputs with tables that hold a mode -> entries of its `moved_modes`."""
        out: dict[str, list[dict[str, float]]] = {}
        for path, (freq, q) in mode_tables(instrument).items():
            out[path] = []
            for near, (by_freq, by_q) in self.modes.items():
                k = int(np.argmin(np.abs(np.log(freq / near))))
                moves = abs(np.log(by_freq)) > _STILL or abs(np.log(by_q)) > 10 * _STILL
                if moves and abs(np.log(freq[k] / near)) < np.log(_SAME_MODE):
                    row = {"near": freq[k], "freq": freq[k] * by_freq, "q": q[k] * by_q}
                    out[path].append({name: _rounded(value) for name, value in row.items()})
        return {path: rows for path, rows in out.items() if rows}


#: largest ratio between the frequencies of one mode in the tables of a body and of its microphones
_SAME_MODE = 1.04
#: logarithm of the ratio of a frequency below which a mode stays; ten times that for Q
_STILL = 0.003


def mode_tables(instrument: Instrument) -> dict[str, tuple[Floats, Floats]]:
    """Path -> frequencies (Hz) and Q of a table whose modes can be moved: the body's, and those of outputs."""
    parts = {"body": instrument.body} | {f"outputs.{name}": part for name, part in instrument.pickups.items()}
    out = {}
    for path, part in parts.items():
        if hasattr(part.parameters, "moved_modes"):
            table = part.files.table(part.parameters.table, f"{path}.table")
            out[path] = table["f_Hz"], table["Q"] if "Q" in table else 0.5 / table["zeta"]
    return out if "body" in out else {}


def edge_of(instrument: Instrument) -> float | None:
    """Radius (m) of the edge of the default exciter; None where it has none."""
    parameters = instrument.exciters[instrument.spec.playing.default_exciter].parameters
    edge = getattr(parameters, "edge", None)
    return getattr(getattr(parameters, "tip", None), "edge", None) if edge is None else float(edge)


def forces_of(instrument: Instrument) -> tuple[float, float] | None:
    """Forces (N) at MIDI velocity 1 and 127; None where the velocity is not an exponential curve of a force."""
    velocity = instrument.spec.playing.velocity
    is_force = velocity.parameter.endswith(".force") and velocity.curve == "exponential"
    return (velocity.low, velocity.high) if is_force else None


def figures_of(stage: Stage) -> Figures:
    """Figures that an instrument has."""
    instrument = stage.instrument
    laws, bending = {}, {}
    for lead in instrument.groups:
        part = instrument.resolved["strings"][lead]
        loss = getattr(instrument.resonators[lead].parameters, "loss", None)
        if loss is None or not part.get("linear_density"):
            continue
        played = stage.at_open(lead)
        stiffness = float(part.get("bending_stiffness") or 0.0)
        law = LinearLoss.of(loss, StringData(played.tension, played.linear_density, stiffness))
        if law.names:
            laws[lead], bending[lead] = law, stiffness
    none = np.zeros(len(gain.KNOTS))
    return Figures(
        laws, bending, _place_now(instrument), {part.name: none for part in instrument.spec.outputs},
        _split_now(instrument), edge=edge_of(instrument), forces=forces_of(instrument),
    )  # fmt: skip


def with_laws(figures: Figures, values: Mapping[str, Floats], bending: Mapping[str, float], stage: Stage) -> Figures:
    """Figures with the laws and stiffnesses of some strings; those between them follow their neighbours.

    A string without a law of its own takes the ratios, new to old, of the strings above and below, straight between
    their open notes over the logarithm.
    """
    laws, stiff = dict(figures.laws), dict(figures.bending)
    pitch = {name: stage.open_note(name) for name in laws}
    for table, new in ((values, True), (bending, False)):
        measured = sorted((name for name in table if name in laws), key=pitch.__getitem__)
        if not measured:
            continue
        at = np.array([pitch[name] for name in measured])
        if new:
            logs = np.array([_log_ratio(values[name], figures.laws[name].values) for name in measured])
        else:
            logs = np.array([[np.log(bending[name] / figures.bending[name])] for name in measured])
        for name, law in figures.laws.items():
            same = [j for j, other in enumerate(measured) if figures.laws[other].names == law.names]
            if not same:
                continue
            ratio = np.exp([np.interp(pitch[name], at[same], column) for column in logs[same].T])
            if new:
                laws[name] = replace(laws[name], values=values[name] if name in values else law.values * ratio)
            else:
                stiff[name] = bending.get(name, figures.bending[name] * float(ratio[0]))
    laws = {name: replace(law, string=replace(law.string, bending_stiffness=stiff[name])) for name, law in laws.items()}
    by_notes = {name: name in values for name in laws}
    return replace(figures, laws=laws, bending=stiff, estimated=by_notes)


def _log_ratio(new: Floats, old: Floats) -> Floats:
    """ln(new / old), 0 where there was nothing."""
    return np.asarray(np.where(old > 0, np.log(np.maximum(new, 1e-300) / np.where(old > 0, old, 1.0)), 0.0))


def _place_now(instrument: Instrument) -> float | None:
    """Place of the default exciter, m or fraction; None where it has none, or every key has its own."""
    name = instrument.spec.playing.default_exciter
    if instrument.spec.keys is not None:
        return None
    value = instrument.resolved["exciters"][name].get("from_bridge")
    if isinstance(value, Mapping):
        return float(value["fraction"])
    return None if value is None else float(value)


def split_key(instrument: Instrument) -> str:
    """Key of a string for the splitting of its polarizations: the scatter over stops, where there is one."""
    scattered = any(part["scatter"]["split_cents"] > 0 for part in instrument.resolved["strings"].values())
    return "scatter.split_cents" if scattered else "split_cents"


def _split_now(instrument: Instrument) -> float | None:
    """Cents, median over the strings; None where strings move in one plane or are tuned together as a key."""
    strings = instrument.resolved["strings"].values()
    if instrument.spec.keys is not None or any(len(part.get("polarizations") or ()) < 2 for part in strings):
        return None
    scattered = split_key(instrument) != "split_cents"
    return float(np.median([part["scatter"]["split_cents"] if scattered else part["split_cents"] for part in strings]))


def _place(instrument: Instrument, value: float) -> Any:
    name = instrument.spec.playing.default_exciter
    now = instrument.resolved["exciters"][name]["from_bridge"]
    return {"fraction": _rounded(value)} if isinstance(now, Mapping) else _rounded(value)


def in_fractions(instrument: Instrument) -> bool:
    """Whether the place of the default exciter is a fraction of the speaking length."""
    name = instrument.spec.playing.default_exciter
    return isinstance(instrument.resolved["exciters"][name].get("from_bridge"), Mapping)


def _own_gain(instrument: Instrument, output: str) -> Floats:
    """Gain (dB) at `gain.KNOTS` of the equalizer that the output has already."""
    part = next(part for part in instrument.spec.outputs if part.name == output)
    return response_db([(band.freq, band.gain_db, band.q) for band in part.equalizer], gain.KNOTS)


def _rounded(value: float) -> float:
    """Five digits: more would pretend."""
    return float(f"{value:.5g}")
