"""What ran and what was left out, sample by sample, and what that saved."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tonewood.instrument.assembly import Model
from tonewood.instrument.contract import Plugin
from tonewood.instrument.effects import TENSION_MODULATION, Effect
from tonewood.numerics.connections import SpringDashpot

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class EffectReport:
    """One effect on one component in a render.

    Attributes
    ----------
    name : of the effect.
    component : string, ``body`` or output group.
    seconds_active : of sound while it was stepped; of a contact or a finger, while it touched.
    seconds_saved : of computing, estimated from the declared costs and the time the render took.
    bound : on what leaving it out cost, in `unit`; None where it was left out without being watched. Nothing is lost by
        leaving out contacts that touch nothing: there it is 0 as it is where nothing was left out.
    unit : dB re the loudest sample, or cents.
    """

    name: str
    component: str
    seconds_active: float
    seconds_saved: float
    bound: float | None
    unit: str


class Ledger:
    """Counts samples.

    Parameters
    ----------
    model : whose effects are counted.
    """

    def __init__(self, model: Model):
        self.model = model
        self.samples = 0
        self.tense: dict[str, int] = defaultdict(int)
        self.held: dict[str, int] = defaultdict(int)
        self.touched: dict[tuple[str, str], int] = defaultdict(int)
        #: string -> largest rise of tension that was left out, cents
        self.left_out: dict[str, float] = defaultdict(float)
        # columns of the forces of each string's contacts with one part
        columns: dict[tuple[str, str], list[int]] = defaultdict(list)
        for j, connection in enumerate(model.system.connections):
            string, _, rest = connection.name.partition(".")
            part = rest.partition(".")[0]
            law = model.resting.get(connection.name, connection).law
            if part in self._parts and not isinstance(law, SpringDashpot):
                columns[string, part].append(j)
        self._columns = {key: np.array(value) for key, value in columns.items()}

    @property
    def _parts(self) -> Mapping[str, Plugin[Any]]:
        return {**self.model.instrument.attachments, **self.model.exciters}

    def count(self, forces: Floats, tense: Collection[str], held: Collection[str], nonlinear: bool) -> None:
        """Enter a run: connection forces (n, m), strings whose tension rises, strings that fingers hold."""
        n = len(forces)
        self.samples += n
        for name in tense:
            self.tense[name] += n
        for name in held:
            self.held[name] += n
        if nonlinear:
            acted: NDArray[np.bool_] = np.any(forces != 0.0, axis=0)
            for key, columns in self._columns.items():
                if np.any(acted[columns]):
                    self.touched[key] += n

    def rises(self, rises: Mapping[str, float], tense: Collection[str]) -> None:
        """Enter a look at the strings: cents by which each would rise, and which do."""
        for name, cents in rises.items():
            if name not in tense:
                self.left_out[name] = max(self.left_out[name], cents)

    def reports(self, render_s: float) -> list[EffectReport]:
        """All effects, with `render_s` seconds of computing for all that was counted."""
        model, fs = self.model, self.model.fs
        whole = self.samples / fs
        modes = {name: self._n_modes(name) for name in model.strings}
        units = self.samples * model.n_modes + sum(
            n * TENSION_MODULATION.cost(modes[name]) for name, n in self.tense.items()
        )
        per_unit = render_s / units if units else 0.0
        out: list[EffectReport] = []

        def add(effect: Effect, component: str, active: float, saved: float = 0.0, bound: float | None = 0.0) -> None:
            out.append(EffectReport(effect.name, component, active, saved, bound, effect.unit))

        choice = model.choice
        for name, string in model.strings.items():
            for effect in string.resonator.effects:
                if effect.name == "tension_modulation":
                    if string.resonator.axial_stiffness <= 0:
                        continue
                    off = self.samples - self.tense[name]
                    bound = self.left_out.get(name, 0.0) if effect.name in choice.names else None
                    saved = off * effect.cost(modes[name]) * per_unit
                    add(effect, name, self.tense[name] / fs, saved, bound)
                elif effect.name == "second_polarization":
                    if len(model.instrument.polarizations(name)) < 2:
                        continue
                    there = effect.name in choice.names
                    saved = 0.0 if there else self.samples * effect.cost(modes[name]) * per_unit
                    add(effect, name, whole if there else 0.0, saved, 0.0 if there else None)
                else:
                    add(effect, name, whole)
        for part, plugin in self._parts.items():
            for effect in plugin.effects:
                there = effect.name in choice.names
                for name in model.strings:
                    samples = self.held[name] if effect.name == "dampers" else self.touched[name, part]
                    reaches = (name, part) in self._columns if effect.name != "dampers" else samples > 0
                    if reaches:
                        add(effect, name, samples / fs)
                if not there:
                    add(effect, part, 0.0, 0.0, None)
        for effect in model.instrument.body.effects:
            add(effect, "body", whole)
        made = {group.name for group in model.outputs}
        for group, pickup in model.instrument.pickups.items():
            for effect in pickup.effects:
                add(effect, group, whole if group in made else 0.0)
        return out

    def _n_modes(self, name: str) -> int:
        system = self.model.system
        return sum(system.compiled[system.slot(c)].basis.n_modes for c in self.model.strings[name].components)


def finite(value: float | None) -> float | None:
    """For JSON: None where there is no number."""
    return value if value is not None and math.isfinite(value) else None
