"""What ran and what was left out, sample by sample, and what that saved."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tonewood.coupling.connections import SpringDashpot
from tonewood.coupling.system import Compiled, System
from tonewood.engine.costs import Costs
from tonewood.engine.rungs import BANDS
from tonewood.instrument.assembly import Model
from tonewood.instrument.contract import Plugin
from tonewood.instrument.effects import Effect

Floats = NDArray[np.float64]

#: re the loudest sample: as good as silence
_NOTHING = 1e-20


@dataclass(frozen=True, slots=True)
class EffectReport:
    """One effect on one component in a render.

    Attributes
    ----------
    name : of the effect.
    component : string, ``body`` or output group.
    seconds_active : of sound while it was stepped; of a contact or a finger, while it touched.
    seconds_saved : of computing, from what steps took in this render; from the declared costs where none were made.
    bound : on what leaving it out cost, in `unit`; None where it never was left out, or was without being watched.
        Nothing is lost by leaving out contacts that touch nothing: there it is 0. That of ``high_modes`` and
        ``sympathetic_strings`` is an estimate that mostly lies far above what is missed, no bound.
    unit : dB re the loudest sample, or cents.
    bound_db : of a tension, besides `bound`: what was missing at the outputs without its sidebands, dB re the loudest
        sample; None as there.
    """

    name: str
    component: str
    seconds_active: float
    seconds_saved: float
    bound: float | None
    unit: str
    bound_db: float | None = None


@dataclass(eq=False)
class Spans:
    """Samples from START up to STOP, in order.

    Attributes
    ----------
    samples : how many they are together.
    all : (start, stop) of each.
    """

    samples: int = 0
    all: list[tuple[int, int]] = field(default_factory=list)

    def add(self, start: int, n: int) -> None:
        """Enter n samples, which join the last ones where they follow at once."""
        self.samples += n
        if self.all and self.all[-1][1] == start:
            self.all[-1] = (self.all[-1][0], start + n)
        else:
            self.all.append((start, start + n))


class Ledger:
    """Counts samples.

    Parameters
    ----------
    model : whose effects are counted.
    """

    def __init__(self, model: Model):
        self.model = model
        self.samples = 0
        #: samples in which any tension rose
        self.any_tense = 0
        #: steps of single modes, and what they took
        self.mode_samples, self.costs = 0, Costs()
        self._compiled: tuple[Compiled, ...] = ()
        self._stepped = 0
        #: string -> when some of its modes slept, when all did, and how many steps of them that saved
        self.asleep: dict[str, Spans] = defaultdict(Spans)
        self.silent: dict[str, Spans] = defaultdict(Spans)
        self.left_to_sleep: dict[str, int] = defaultdict(int)
        #: string -> bound on what it would have added meanwhile, ratio to the loudest sample
        self.unheard: dict[str, float] = defaultdict(float)
        #: string -> when its tension rose, when a finger held it; (string, part) -> when they touched
        self.tense: dict[str, Spans] = defaultdict(Spans)
        self.held: dict[str, Spans] = defaultdict(Spans)
        self.touched: dict[tuple[str, str], Spans] = defaultdict(Spans)
        #: string -> largest rise of tension that was left out, and that was foreseen or seen, cents
        self.left_out: dict[str, float] = {}
        self.largest: dict[str, float] = defaultdict(float)
        #: string -> largest of its sidebands and phantom partials that was left out, ratio to the loudest sample
        self.sidebands: dict[str, float] = {}
        self._modes = {name: self.n_modes(name) for name in model.strings}
        # columns of the forces of each string's contacts with one part
        columns: dict[tuple[str, str], list[int]] = defaultdict(list)
        for j, connection in enumerate(model.system.connections):
            string, _, rest = connection.name.partition(".")
            part = rest.partition(".")[0]
            law = model.resting.get(connection.name, connection).law
            if part in self._parts and not isinstance(law, SpringDashpot):
                columns[string, part].append(j)
        self.contacts = {key: np.array(value) for key, value in columns.items()}

    @property
    def _parts(self) -> Mapping[str, Plugin[Any]]:
        return {**self.model.instrument.attachments, **self.model.exciters}

    def count(
        self,
        start: int,
        n: int,
        acted: NDArray[np.intp],
        tense: Collection[str],
        held: Collection[str],
        system: System,
        asleep: Mapping[str, tuple[int, int]],
        seconds: float,
    ) -> bool:
        """Enter a run of n samples from `start`, and tell whether a contact acted in it.

        Parameters
        ----------
        acted : connections that had a force, linear ones left out or not.
        tense, held : strings whose tension rises, or fingers hold.
        system : what was stepped.
        asleep : strings that sleep -> their level, and how many modes do.
        seconds : that its steps took.
        """
        self.samples += n
        if system.compiled is not self._compiled:
            self._compiled = system.compiled
            self._stepped = sum(compiled.basis.n_modes for compiled in system.compiled)
        self.mode_samples += n * self._stepped
        for name, (level, modes) in asleep.items():
            self.asleep[name].add(start, n)
            self.left_to_sleep[name] += n * modes
            if level == BANDS:
                self.silent[name].add(start, n)
        for name in tense:
            self.tense[name].add(start, n)
        self.costs.add(seconds, n, self._stepped, sum(self._modes[name] for name in tense))
        self.any_tense += n if tense else 0
        for name in held:
            self.held[name].add(start, n)
        touched = False
        if acted.size and system.elimination.others.laws:
            pushed = np.zeros(len(system.connections), dtype=bool)
            pushed[acted] = True
            for key, columns in self.contacts.items():
                if np.any(pushed[columns]):
                    touched = True
                    self.touched[key].add(start, n)
        return touched

    def rises(self, rises: Mapping[str, float], levels: Mapping[str, float], tense: Collection[str]) -> None:
        """Enter a look at the strings: cents by which each would rise, what that adds besides, and which do."""
        for name, cents in rises.items():
            self.rise(name, cents, levels.get(name, 0.0), name not in tense)

    def rise(self, name: str, cents: float, level: float, left_out: bool) -> None:
        """Enter by how much a string's tension rises or is about to, what that adds, and whether it is left out."""
        self.largest[name] = max(self.largest[name], cents)
        if left_out:
            self.left_out[name] = max(self.left_out.get(name, 0.0), cents)
            self.sidebands[name] = max(self.sidebands.get(name, 0.0), level)

    def reports(self) -> list[EffectReport]:
        """All effects."""
        model, fs = self.model, self.model.fs
        whole, modes, rates = self.samples / fs, self._modes, self.costs.rates()
        per_unit = rates.mode
        # what any rising tension takes is saved while none rises: by the strings' shares of the modes
        still = (self.samples - self.any_tense) * rates.tense / max(sum(modes[t.name] for t in model.system.rising), 1)
        out: list[EffectReport] = []

        def add(
            effect: Effect,
            component: str,
            active: float,
            saved: float = 0.0,
            bound: float | None = None,
            bound_db: float | None = None,
        ) -> None:
            out.append(EffectReport(effect.name, component, active, saved, bound, effect.unit, bound_db))

        choice = model.choice
        for name, string in model.strings.items():
            for effect in string.resonator.effects:
                if effect.name == "tension_modulation":
                    if string.resonator.axial_stiffness <= 0:
                        continue
                    off = self.samples - self.tense[name].samples
                    saved = modes[name] * (off * rates.tense_mode + still)
                    lost = _decibel(self.sidebands.get(name))
                    add(effect, name, self.tense[name].samples / fs, saved, self.left_out.get(name), lost)
                elif effect.name == "second_polarization":
                    if len(model.instrument.polarizations(name)) < 2:
                        continue
                    there = effect.name in choice.names
                    saved = 0.0 if there else self.samples * effect.cost(modes[name]) * per_unit
                    add(effect, name, whole if there else 0.0, saved)
                elif effect.name == "longitudinal":
                    if string.longitudinal is None:
                        add(effect, name, 0.0, self.samples * effect.cost(modes[name]) * per_unit)
                        continue
                    # what it takes besides stands with the rising tension, which comes and goes with it
                    add(effect, name, self.tense[name].samples / fs, 0.0, _decibel(self.sidebands.get(name)))
                elif effect.name in ("high_modes", "sympathetic_strings"):
                    high = effect.name == "high_modes"
                    slept = (self.asleep if high else self.silent)[name].samples
                    saved = self.left_to_sleep[name] * effect.cost(1) * per_unit if high else 0.0
                    add(
                        effect,
                        name,
                        (self.samples - slept) / fs,
                        saved,
                        _decibel(self.unheard[name]) if slept else None,
                    )
                else:
                    add(effect, name, whole)
        for part, plugin in self._parts.items():
            for effect in plugin.effects:
                there = effect.name in choice.names
                for name in model.strings:
                    held = effect.name == "dampers"
                    samples = (self.held[name] if held else self.touched[name, part]).samples
                    reaches = samples > 0 if held else (name, part) in self.contacts
                    if reaches:
                        add(effect, name, samples / fs, bound=0.0 if samples < self.samples else None)
                if not there:
                    add(effect, part, 0.0)
        for effect in model.instrument.body.effects:
            add(effect, "body", whole)
        made = {group.name for group in model.outputs}
        for group, pickup in model.instrument.pickups.items():
            for effect in pickup.effects:
                add(effect, group, whole if group in made else 0.0)
        return out

    def n_modes(self, name: str) -> int:
        """Modes of an open string, all polarizations."""
        system = self.model.system
        return sum(system.compiled[system.slot(c)].basis.n_modes for c in self.model.strings[name].components)


def _decibel(ratio: float | None) -> float | None:
    return None if ratio is None else 20 * math.log10(max(ratio, _NOTHING))


def finite(value: float | None) -> float | None:
    """For JSON: None where there is no number."""
    return value if value is not None and math.isfinite(value) else None
