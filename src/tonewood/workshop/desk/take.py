"""A phrase on one model, rendered as far as it is heard, with all that is shown of it while it rings."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tonewood.instrument.bundle.loading import Instrument
from tonewood.instrument.model.assembly import Model
from tonewood.performance.engine.engine import Engine
from tonewood.performance.score.note import Score
from tonewood.physics.stepping.motion import to_motion
from tonewood.sound.level.loudness import BLOCK, loudest
from tonewood.sound.render.options import RenderOptions
from tonewood.sound.render.renderer import Checkpoint, Renderer
from tonewood.support.units import decibel
from tonewood.workshop.desk.phrase import LONGEST, ChosenPhrase

Singles = NDArray[np.float32]

#: frames that are rendered at once
PIECE = 512
#: frames between two checkpoints, and checkpoints that are kept
_APART, _KEPT = 2048, 16
#: dBFS of the loudest sample of a phrase on the first model that plays it
_PEAK = -4.0


@dataclass(frozen=True, slots=True)
class Ringing:
    """What rings at a frame: J in each string, in the body; J that have left as sound so far, where that is known."""

    frame: int
    strings: dict[str, float]
    body: float
    sound: float | None


class PhraseTake:
    """A phrase on one model.

    options : of the render, as `DeskSession.command` states them.
    preview : words on how the model differs from the design; empty where it does not.
    """

    def __init__(
        self, score: Score, model: Model, options: RenderOptions, design: dict[str, Any], preview: str = ""
    ) -> None:
        self.score, self.model, self.options, self.design, self.preview = score, model, options, design, preview
        self.renderer = Renderer(score, model.instrument, options=options, model=model)
        self._blocks = self.renderer.blocks(PIECE)
        self._sound: Singles = np.zeros((int(4 * options.fs), 2), dtype=np.float32)
        #: frames rendered; whether that is all; frames that another take rendered
        self.frames, self.ended, self.foreign = 0, False, 0
        self._checkpoints: deque[tuple[int, Checkpoint]] = deque(maxlen=_KEPT)
        self.moments: deque[Ringing] = deque(maxlen=2048)
        self._heard = 0.0

    @property
    def fs(self) -> int:
        """Sampling rate, Hz."""
        return self.options.fs

    def ensure(self, frames: int) -> None:
        """Render on until so many frames are there, or all of the phrase."""
        while self.frames < frames and not self.ended:
            block = next(self._blocks, None)
            if block is None:
                self.ended = True
                return
            n = len(block)
            if self.frames + n > len(self._sound):
                self._sound = np.concatenate([self._sound, np.zeros_like(self._sound)])
            left, right = block[:, 0], block[:, min(1, block.shape[1] - 1)]
            self._sound[self.frames : self.frames + n] = np.stack([left, right], axis=1)
            self.frames += n
            if self.frames % _APART < n:
                self._checkpoints.append((self.frames, self.renderer.snapshot()))
                self._observe()

    def read(self, start: int, frames: int) -> Singles:
        """Return (n, 2) frames from `start` on, fewer where the phrase ends."""
        self.ensure(start + frames)
        return self._sound[start : min(start + frames, self.frames)]

    def sound(self) -> Singles:
        """Return the whole phrase, (n, 2)."""
        self.ensure(round(LONGEST * self.fs))
        return self._sound[: self.frames]

    def loudness(self) -> float:
        """LUFS of the loudest 0.4 s of the whole phrase."""
        return loudest(self.sound().astype(np.float64), self.fs, BLOCK)

    def forked(self, frame: int, instrument: Instrument, design: dict[str, Any]) -> tuple[PhraseTake, int] | None:
        """Go on with other hands while strings and body ring on.

        frame : from which on another take may begin.
        instrument : with these hands; strings and body are the same.
        Returns the take, and the frame at which it begins; None where no checkpoint lies there.
        """
        self.ensure(frame + _APART)
        at, checkpoint = next(((at, point) for at, point in self._checkpoints if at >= frame), (0, None))
        if checkpoint is None:
            return None
        other = PhraseTake(self.score, with_hands(self.model, instrument), self.options, design, self.preview)
        other.renderer.take_over(checkpoint)
        other._sound = self._sound.copy()
        other.frames = other.foreign = at
        other.moments.extend(moment for moment in self.moments if moment.frame <= at)
        other._heard = (other.moments[-1].sound or 0.0) if other.moments else 0.0
        return other, at

    def again(self) -> PhraseTake:
        """Return a take of the same model from the beginning; this one, where it was rendered from there."""
        if not self.foreign:
            return self
        return PhraseTake(self.score, self.model, self.options, self.design, self.preview)

    def _observe(self) -> None:
        moment = stored(self.renderer.engine, self.frames)
        if moment.sound is not None:  # power of this moment over the time since the last one
            self._heard += moment.sound * _APART / self.fs
            moment = replace(moment, sound=self._heard)
        self.moments.append(moment)

    def effects(self) -> list[dict[str, Any]]:
        """Effects that this model may run: of the steps of all modes, and of each effect, the title, the components,
        the seconds in which it ran on each; of those that are switched the components on which it runs now, and the
        share of the sound's time that its steps take there.
        """
        engine = self.renderer.engine
        rates, usage = engine.usage.costs.rates(), engine.usage
        modes = self.model.n_modes
        rows: dict[str, dict[str, Any]] = {
            "": {
                "title": f"{modes} modes", "active": {"": self.frames / self.fs}, "on": None,
                "cost": rates.mode * modes * self.fs, "saved": 0.0,
            }
        }  # fmt: skip
        for report in self.renderer.summary().effects:
            row = rows.setdefault(
                report.name, {"title": report.title, "active": {}, "on": None, "cost": None, "saved": 0.0}
            )
            row["active"][report.component] = round(report.seconds_active, 3)
            row["saved"] += report.seconds_saved
        for name, switching in engine.switchings.items():
            if name in rows and name in usage.loads:
                load = sum(usage.loads[name].get(component, 0.0) for component in switching.on)
                seconds = rates.running.get(name, 0.0) * bool(switching.on) + rates.load.get(name, 0.0) * load
                rows[name] |= {"on": sorted(switching.on), "cost": seconds * self.model.fs}
        return list(rows.values())


class LeveledTakes:
    """Takes of the chosen phrase, all at one gain: that of the first model that plays it."""

    def __init__(self, phrase: ChosenPhrase, instrument: Instrument, options: RenderOptions) -> None:
        self._phrase, self.options = phrase, options
        self.score = phrase.score(instrument)
        #: dB; None before a model has played the phrase
        self.gain_db: float | None = None

    def choose(self, kind: str, notes: str, velocity: float, instrument: Instrument, model: Model | None) -> None:
        """Choose another phrase. Raises TonewoodError : it cannot be played; the one before stays."""
        before = self._phrase.asked
        self._phrase.asked = {"kind": kind, "notes": notes, "velocity": velocity}
        try:
            score = self._phrase.score(instrument)
            if model is not None:
                PhraseTake(score, model, self.options, {})
        except Exception:  # of a wrong value, too, which the server reports
            self._phrase.asked = before
            self._phrase.score(instrument)
            raise
        self.score, self.gain_db = score, None

    def take(self, model: Model, changes: Mapping[str, Any], preview: str = "") -> PhraseTake:
        """Return a take of a model; the arguments are those of `PhraseTake`."""
        if self.gain_db is None:
            peak = float(abs(PhraseTake(self.score, model, self.options, {}).sound()).max(initial=0.0))
            self.gain_db = round(_PEAK - decibel(peak), 1) if peak > 0 else 0.0
        return PhraseTake(self.score, model, self.options.at(gain_db=self.gain_db), dict(changes), preview)


def with_hands(model: Model, instrument: Instrument) -> Model:
    """Return a model played by the hands of another instrument, whose strings and body are the same."""
    player = instrument.replace({f"effects.{k}": v for k, v in model.instrument.resolved["effects"].items()})
    default = player.spec.playing.default_exciter
    return replace(model, instrument=player, exciters=player.exciters, default_exciter=default)


def stored(engine: Engine, frame: int) -> Ringing:
    """Return the energy of the modes of every string and of the body now.

    E = (q'^2 + omega^2 q^2) / 2 summed over a component's modes; `sound` is the power sum 2 sigma s E over the body's
    modes, W, where s is the share of a mode's loss that is sound. Components whose modes are not real are left out.
    """
    system, state = engine.system, engine.state
    strings: dict[str, float] = dict.fromkeys(engine.model.strings, 0.0)
    body, power = 0.0, None
    for slot, (name, compiled) in enumerate(zip(system.names, system.compiled, strict=True)):
        basis = compiled.basis
        if system.layout.driven[slot] or not basis.is_real or not basis.n_modes:
            continue
        q, velocity = to_motion(basis, np.asarray(system.modes_of(state, name), dtype=np.float64))
        energy = 0.5 * (velocity**2 + basis.stiffness * q**2)
        if name == "body":
            body = float(energy.sum())
            share = np.asarray(basis.metadata.get("radiated", ()), dtype=np.float64)
            if len(share) == basis.n_modes:
                power = float(np.sum(2 * basis.damping_rate * share * energy))
        elif (owner := system.layout.owners.get(name)) in strings:
            strings[str(owner)] += float(energy.sum())
    return Ringing(frame, strings, body, power)
