"""The cheapest setting of a render that meets a target, for an instrument and some of its notes.

Notes are rendered with the settings that `RenderOptions` has: steps per frame, highest mode, budgets of effects. Their
partials and waveforms are held against a reference of finer steps, whose own error is estimated from the errors of
half and a quarter of its rate (Richardson's extrapolation): with e ~ h^p, the errors found there are as
(4^p - 1) : (2^p - 1), which gives p, and the reference's own is the smaller one over 2^p - 1.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any

from tonewood.errors import TonewoodError
from tonewood.instrument.bundle.loading import Instrument
from tonewood.instrument.model.assembly import FREQ_LIMIT
from tonewood.lab.accuracy.partials import PartialErrors
from tonewood.lab.accuracy.strokes import NUDGE, SENSITIVE, NoteCase, Strokes, forces
from tonewood.lab.accuracy.timing import Tell, silent
from tonewood.performance.effects.base import SwitchedEffect

#: s of every note
DURATION = 2.0
#: steps per frame that are tried; the reference's, of which the finest is taken that its time allows; s for it
RATES, REFERENCES, REFERENCE_S = (0.25, 0.5, 0.75, 1.0, 1.5, 2.0, 3.0, 4.0), (8, 4, 2), 30.0
#: highest modes are also tried at shares of the way from the bandwidth to the highest of all, in octaves
SHARES = (0.0, 0.5)
#: budgets of effects that are tried, cents and dB, with so many of the cheapest settings that meet the target
BUDGETS, BUDGETED = ((5.0, -40.0), (0.5, -80.0), (0.05, -120.0)), 2
#: of a sensitive motion
STROKES = 8
#: after a setting that meets the target, rates up to so many times its own are tried, too
BEYOND = 3.0

_TARGET = re.compile(r"^([-+]?[0-9.]+(?:e[-+]?[0-9]+)?)\s*(cents?|% ?decay|db)$", re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class Worst:
    """Errors of the worst partial of the worst note: pitch (cents), decay (relative), level (dB), waveform (relative).

    None: not known, as is the waveform of motion that differs from stroke to stroke.
    """

    cents: float | None = None
    decay: float | None = None
    level: float | None = None
    waveform: float | None = None

    @classmethod
    def of(cls, errors: Sequence[PartialErrors]) -> Worst:
        """Return the worst errors of several notes."""
        waves = [e.waveform for e in errors]
        return cls(
            max(e.cents_worst for e in errors),
            max(e.decay_worst for e in errors),
            max(e.level_worst for e in errors),
            None if any(w is None for w in waves) else max(w for w in waves if w is not None),
        )

    @classmethod
    def reference_error(cls, half: Worst, quarter: Worst) -> Worst:
        """Error of a reference, from those found with half and a quarter of its steps."""
        out: dict[str, float | None] = {}
        for name in NAMES:
            a, b = getattr(half, name), getattr(quarter, name)
            order = min(max(math.log2(max(b / a - 1, 1e-3)), 1.0), 4.0) if a and b else 1.0
            out[name] = a if a is None else a / (2**order - 1)
        return cls(**out)

    def __add__(self, other: Worst) -> Worst:
        return Worst(**{n: None if None in (a := (getattr(self, n), getattr(other, n))) else sum(a) for n in NAMES})

    def largest(self, other: Worst) -> Worst:
        """The larger of each."""
        return Worst(
            **{n: max((v for w in (self, other) if (v := getattr(w, n)) is not None), default=None) for n in NAMES}
        )


#: measures of a `Worst`
NAMES = tuple(f.name for f in fields(Worst))


@dataclass(frozen=True, slots=True)
class Target:
    """Largest errors that are allowed; None where nothing is asked."""

    text: str
    limits: Worst

    @classmethod
    def parse(cls, text: str) -> Target:
        """Read ``1cent``, ``5%decay``, ``0.5dB`` (of level), ``-60dB`` (of the waveform), or several with commas.

        Raises TonewoodError : not of that form.
        """
        limits: dict[str, float] = {}
        for part in text.split(","):
            parsed = _TARGET.match(part.strip())
            value = float(parsed[1]) if parsed else 0.0
            unit = parsed[2].lower().replace(" ", "") if parsed else ""
            if unit.startswith("cent") and value > 0:
                limits["cents"] = value
            elif unit == "%decay" and value > 0:
                limits["decay"] = value / 100
            elif unit == "db" and value > 0:
                limits["level"] = value
            elif unit == "db" and value < 0:
                limits["waveform"] = 10 ** (value / 20)
            else:
                reason = f"is {part.strip()!r}; 1cent, 5%decay, 0.5dB, -60dB or several with commas are allowed"
                raise TonewoodError(reason, key="--target")
        return cls(text, Worst(**limits))

    def met(self, errors: Worst) -> bool:
        """Whether no error is larger; one that is not known counts as larger."""
        pairs = [(getattr(self.limits, n), getattr(errors, n)) for n in NAMES]
        return all(limit is None or (error is not None and error <= limit) for limit, error in pairs)

    def excess(self, errors: Worst) -> float:
        """Largest ratio of an error to its limit."""
        pairs = [(getattr(self.limits, n), getattr(errors, n)) for n in NAMES]
        return max(math.inf if error is None else error / limit for limit, error in pairs if limit is not None)


@dataclass(frozen=True, slots=True)
class Setting:
    """Options of a render.

    oversampling : steps of the engine per frame.
    freq_limit : Hz, no mode is stepped above it; None is 0.45 of the engine's rate.
    effects : ``all`` where the bundle has effects that are switched; None: as the bundle has them.
    budgets : cents and dB of effects that are switched; None: all run.
    """

    oversampling: float
    freq_limit: float | None = None
    effects: str | None = None
    budgets: tuple[float, float] | None = None

    @property
    def options(self) -> dict[str, Any]:
        """Keywords of a `Renderer`."""
        keywords: dict[str, Any] = {"oversampling": self.oversampling}
        if self.freq_limit is not None:
            keywords["freq_limit"] = self.freq_limit
        if self.effects is not None:
            keywords["effects"] = self.effects
        if self.budgets is not None:
            keywords |= {"budget_cents": self.budgets[0], "budget_db": self.budgets[1]}
        return keywords

    @property
    def words(self) -> str:
        """Options of ``tonewood render``."""
        return " ".join(
            f"--{name.replace('_', '-')} {value if isinstance(value, str) else f'{value:g}'}"
            for name, value in self.options.items()
        )


@dataclass(frozen=True, slots=True)
class Trial:
    """A setting, its errors, and its cost.

    setting, errors : against the reference.
    met : whether errors and the reference's own together stay within the target.
    seconds : of computing per second of sound, of the first note.
    n_modes : stepped.
    highest : Hz, up to which modes of strings are stepped.
    """

    setting: Setting
    errors: Worst
    met: bool
    seconds: float
    n_modes: int
    highest: float


@dataclass(frozen=True, eq=False)
class Frontier:
    """Settings that were tried, and their errors.

    instrument, target, notes, fs : of the question.
    trials : from cheap to dear.
    reference : steps per frame of the reference.
    reference_error : its own error.
    modes : change by twice as high a limit of the strings' modes, at twice the rate of `standard`; the bundle's
        limit is part of the instrument and counts in no error.
    strokes : whose means were compared; 1 where a thousandth more force changes little.
    default : errors and cost of a render without any options.
    """

    instrument: str
    target: Target
    notes: tuple[str, ...]
    fs: int
    bandwidth: float
    trials: tuple[Trial, ...]
    reference: float
    reference_error: Worst
    modes: Worst
    strokes: int
    default: Trial

    @property
    def cheapest(self) -> Trial | None:
        """The setting that meets the target in least time."""
        return next((t for t in self.trials if t.met), None)

    def within(self, name: str, value: float) -> Trial | None:
        """The cheapest setting whose error of one measure, the reference's own added, is no larger."""
        error = getattr(self.reference_error, name)
        sizes = ((t, getattr(t.errors, name)) for t in self.trials)
        return next((t for t, e in sizes if e is not None and error is not None and e + error <= value), None)

    def on_front(self, trial: Trial, name: str) -> bool:
        """Whether no cheaper setting has as small an error of one measure."""
        error = getattr(trial.errors, name)
        cheaper = (getattr(t.errors, name) for t in self.trials if t.seconds < trial.seconds)
        return error is not None and all(e is None or e > error for e in cheaper)

    @property
    def nearest(self) -> Trial:
        """The setting that comes nearest to the target."""
        return min(self.trials, key=lambda t: self.target.excess(t.errors))


def cases_of(instrument: Instrument, notes: Sequence[str], fs: int) -> list[NoteCase]:
    """Cases of notes, each ``STRING`` or ``STRING:STOP``; by default the outer strings and the one in the middle.

    Raises TonewoodError : there is no such string, or it has no such stop.
    """
    names = instrument.string_names
    texts = list(notes) or [names[0], names[len(names) // 2], names[-1]]
    out = []
    for text in dict.fromkeys(texts):
        string, _, stop = text.partition(":")
        if string not in names:
            raise TonewoodError(f"there is no string {string!r}; there is {', '.join(names)}", key="--notes")
        if not (stop or "0").isascii() or not (stop or "0").isdigit():
            raise TonewoodError(f"is {text!r}; STRING or STRING:STOP is allowed, STOP a whole number", key="--notes")
        try:
            out.append(NoteCase.of(instrument, string, DURATION, stop=int(stop or 0), fs=fs))
        except TonewoodError as fault:
            raise TonewoodError(f"{text} cannot be played: {fault.reason}", key="--notes") from None
    return out


def search(
    instrument: Instrument, target: Target, *, notes: Sequence[str] = (), fs: int = 48000, bandwidth: float = 10e3,
    tell: Tell = silent,
) -> Frontier:  # fmt: skip
    """Find the cheapest setting for a target.

    notes : as for `cases_of`.
    fs : Hz of the sound.
    bandwidth : Hz; settings that step no modes up to it are not tried.
    tell : called with the share that is done.
    Raises TonewoodError : a note cannot be played, or no rate steps modes up to `bandwidth`.
    """
    return _Search(instrument, target, cases_of(instrument, notes, fs), fs, bandwidth, tell).run()


@dataclass(eq=False)
class _Search:
    instrument: Instrument
    target: Target
    cases: list[NoteCase]
    fs: int
    bandwidth: float
    tell: Tell
    factors: tuple[float, ...] = (1.0,)
    truths: list[Strokes] = field(default_factory=list)
    reference_error: Worst = field(default_factory=Worst)
    effects: str | None = None

    def run(self) -> Frontier:
        standard = float(self.instrument.spec.oversampling)
        self.effects = "all" if self._switched() else None
        base = Setting(standard, effects=self.effects)
        plain = [case.strokes(base.options) for case in self.cases]
        pairs = zip(self.cases, plain, strict=True)
        nudged = Worst.of([case.errors(case.strokes(base.options, NUDGE), strokes) for case, strokes in pairs])
        if self.target.excess(replace(nudged, waveform=0.0)) > SENSITIVE:
            self.factors = forces(STROKES)
        spent = sum(p.seconds * case.duration for p, case in zip(plain, self.cases, strict=True)) * len(self.factors)
        finest = next((k for k in REFERENCES if k * standard <= 16 and k * spent < REFERENCE_S), REFERENCES[-1])
        self.tell(0.1)
        reference = finest * standard
        self.truths = self._strokes(Setting(reference, effects=self.effects))
        self.tell(0.35)
        half, quarter = (self._errors(Setting(reference / n, effects=self.effects)) for n in (2, 4))
        self.reference_error = Worst.reference_error(half, quarter)
        if len(self.factors) > 1:
            pieces = [truth.halves() for truth in self.truths]
            chance = [case.errors(*two) for case, two in zip(self.cases, pieces, strict=True)]
            self.reference_error = self.reference_error.largest(Worst.of(chance))
        self.tell(0.5)
        trials = self._trials(reference)
        default = self._try_default(standard)
        return Frontier(
            self.instrument.spec.name,
            self.target,
            tuple(f"{c.string}:{c.stop}" if c.stop else c.string for c in self.cases),
            self.fs,
            self.bandwidth,
            tuple(trials),
            reference,
            self.reference_error,
            self._modes(base),
            len(self.factors),
            default,
        )

    def _strokes(self, setting: Setting, overrides: Mapping[str, Any] | None = None) -> list[Strokes]:
        return [case.strokes(setting.options, self.factors, overrides) for case in self.cases]

    def _errors(self, setting: Setting) -> Worst:
        return self._held_against(self._strokes(setting))

    def _held_against(self, strokes: Sequence[Strokes]) -> Worst:
        triples = zip(self.cases, strokes, self.truths, strict=True)
        return Worst.of([case.errors(rendered, truth) for case, rendered, truth in triples])

    def _trials(self, reference: float) -> list[Trial]:
        """Settings from the lowest rate up, until well beyond the first that meets the target."""
        out: list[Trial] = []
        allowed = [r for r in RATES if FREQ_LIMIT * r * self.fs >= self.bandwidth and r <= reference / 2]
        if not allowed:
            raise TonewoodError(
                f"is {self.bandwidth:g} Hz; up to {FREQ_LIMIT * max(RATES) * self.fs:g} are allowed", key="--bandwidth"
            )
        for i, rate in enumerate(allowed):
            out += [self._try(setting) for setting in self._limits(rate)]
            first = next((t.setting.oversampling for t in out if t.met), math.inf)
            self.tell(0.5 + 0.3 * (i + 1) / len(allowed))
            if rate >= BEYOND * first:
                break
        if self.effects is not None:
            for t in sorted((t for t in out if t.met), key=lambda t: t.seconds)[:BUDGETED]:
                for budgets in BUDGETS:
                    out.append(self._try(replace(t.setting, effects="auto", budgets=budgets)))
                    if out[-1].met:
                        break
        return self._timed(out)

    def _limits(self, rate: float) -> list[Setting]:
        """Settings of one rate: all modes that it steps, and fewer."""
        top = self._top(rate)
        lower = [round(self.bandwidth * (top / self.bandwidth) ** share, -2) for share in SHARES]
        whole = Setting(rate, effects=self.effects)
        return [whole, *(replace(whole, freq_limit=f) for f in lower if self.bandwidth <= f < 0.9 * top)]

    def _try(self, setting: Setting) -> Trial:
        strokes = self._strokes(setting)
        errors = self._held_against(strokes)
        return self._trial(setting, strokes, errors)

    def _trial(self, setting: Setting, strokes: Sequence[Strokes], errors: Worst) -> Trial:
        top = self._top(setting.oversampling)
        limit, met = min(top, setting.freq_limit or top), self.target.met(errors + self.reference_error)
        return Trial(setting, errors, met, strokes[0].seconds, strokes[0].n_modes, limit)

    def _top(self, rate: float) -> float:
        """Highest mode of strings at a rate, Hz."""
        return min(FREQ_LIMIT * rate * self.fs, max(p.freq_upper for p in self.instrument.spec.strings.values()))

    def _try_default(self, standard: float) -> Trial:
        strokes = [case.strokes({}, self.factors) for case in self.cases]
        setting = Setting(standard, effects=self.effects and "auto")
        return self._trial(setting, strokes, self._held_against(strokes))

    def _timed(self, trials: Sequence[Trial]) -> list[Trial]:
        """Return the settings from cheap to dear, timed on the first note, all in turn."""
        options = [t.setting.options for t in trials]
        times = self.cases[0].timed(options, 2, lambda share: self.tell(0.8 + 0.15 * share))
        timed = (replace(t, seconds=seconds) for t, seconds in zip(trials, times, strict=True))
        return sorted(timed, key=lambda t: t.seconds)

    def _switched(self) -> bool:
        """Whether the instrument has effects that budgets switch."""
        effects = self.cases[0].renderer({"effects": "auto"}).engine.effects
        return any(isinstance(effect, SwitchedEffect) and effect.watched for effect in effects)

    def _modes(self, base: Setting) -> Worst:
        """Changes that twice as high a limit of the strings' modes makes."""
        uppers = {n: p.freq_upper for n, p in self.instrument.spec.strings.items()}
        wider = {f"strings.{name}.freq_upper": min(2 * f, 1e5) for name, f in uppers.items()}
        rate = replace(base, oversampling=2 * base.oversampling)
        pairs = zip(self.cases, self._strokes(rate, wider), self._strokes(rate), strict=True)
        return Worst.of([case.errors(wide, usual) for case, wide, usual in pairs])
