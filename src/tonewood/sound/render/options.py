"""The options of a render, declared once: Python, the command line and batches all take them from here."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self, get_args

from pydantic import Field, ValidationError, field_validator, model_validator
from pydantic.fields import FieldInfo

from tonewood.errors import TonewoodError
from tonewood.support.params import Number, Parameters, described, quantity
from tonewood.support.units import as_float
from tonewood.support.validation_messages import first_message, unit_of

if TYPE_CHECKING:
    from tonewood.instrument.bundle.loading import Instrument

AccuracyName = Literal["draft", "standard", "reference"]
EffectsMode = Literal["auto", "all", "none"]
#: s, longest sound before score time 0
LONGEST_LEAD_IN = 60.0


@dataclass(frozen=True, slots=True)
class Tail:
    """Deprecated: the options `tail` (s) and `tail_level_db` of a render, in one object."""

    level_db: float = -60.0
    cap: float = 10.0


class RenderOptions(Parameters):
    """Options of a render.

    The same options are keywords of `render`, `Renderer`, `plan` and `play`, options of the commands of these names,
    and keys under ``render`` in the manifest of a batch.

    Raises
    ------
    TonewoodError : an option is unknown, or a value is not allowed; one line.
    """

    fs: int = quantity("Hz", low=8000, high=768000, default=48000, doc="sampling rate")
    accuracy: AccuracyName = described("length of the engine's steps; see docs/accuracy.md", default="standard")
    oversampling: float | None = quantity(
        "steps per frame",
        low=0.25,
        high=16.0,
        default=None,
        doc="steps of the engine per frame, in quarters; default: that of accuracy on the instrument",
    )
    freq_limit: float | None = quantity(
        "Hz", low=100.0, high=768e3, default=None, doc="no mode is stepped above it; default: 0.45 of the engine's rate"
    )
    outputs: tuple[str, ...] | None = described(
        "output groups; default: the instrument's first", default=None, min_length=1
    )
    tail: float = quantity("s", low=0.0, high=3600.0, default=10.0, doc="longest ring after the last event")
    tail_level_db: float = quantity(
        "dB",
        low=-300.0,
        high=-1.0,
        default=-60.0,
        doc="the render ends when the ring has stayed for 0.2 s this far below the loudest sample",
    )
    max_duration: float | None = quantity(
        "s", low=1e-6, high=86400.0, default=None, doc="longest render, counted from score time 0"
    )
    gain_db: float = quantity("dB", low=-200.0, high=200.0, default=0.0, doc="gain of all channels")
    channel_per_string: bool = described("MIDI channel 1 plays the first string, and so on", default=False)
    capo: int = described("stop at which a capo holds all strings; 0 for none", default=0, ge=0, le=200)
    lead_in: Literal["auto"] | Annotated[Number, Field(ge=0.0, le=LONGEST_LEAD_IN)] = described(
        "seconds of sound kept from before score time 0, at most 60; auto: from the first gesture on", default=0.0
    )
    effects: EffectsMode | tuple[str, ...] | None = described(
        "effects that may run; default: the instrument's", default=None
    )
    budget_db: float | None = quantity(
        "dB",
        low=-300.0,
        high=0.0,
        default=None,
        doc="an additive effect may be left out while its bound re the peak is below this; default: the instrument's",
    )
    budget_cents: float | None = quantity(
        "cents",
        low=0.0,
        high=100.0,
        default=None,
        doc="a detuning effect may be left out while its bound is below this; default: the instrument's",
    )
    humanize: int | None = described(
        "seed of human variation in force, time and touch, see playing.variation; default: the instrument's",
        default=None,
        ge=0,
    )
    noises: bool | None = described(
        "noises of the hands between notes, see playing.noises; default: the instrument's", default=None, strict=True
    )
    preset: str | None = described(
        "dry, studio, stage or one of the bundle's: options under one name; single ones come first", default=None
    )
    room: str | None = described(
        "studio, small, hall, or a sound file with an impulse response: a room, not measured; one channel becomes two",
        default=None,
    )
    room_distance: float | None = quantity(
        "m", low=0.1, high=60.0, default=None, doc="from the instrument to the microphones; default: the room's"
    )
    room_mix_db: float = quantity("dB", low=-100.0, high=40.0, default=0.0, doc="gain of the room re its own level")
    energy: bool = described("keep an account of energy; many times slower, with the same samples", default=False)

    if not TYPE_CHECKING:  # checkers read the fields

        def __init__(self, **values: Any):
            try:
                super().__init__(**values)
            except ValidationError as fault:
                raise _error(fault, type(self)) from None

        # validation inside of another model does not call it, and reports the place in that model
        __init__.__pydantic_base_init__ = True

    @classmethod
    def of(cls, options: RenderOptions | None, fs: float | None, settings: Mapping[str, Any]) -> RenderOptions:
        """Return `options` with the sampling rate `fs` (Hz) and single settings in their place."""
        if options is not None and fs is None and not settings:
            return options
        values = {} if options is None else {name: getattr(options, name) for name in options.model_fields_set}
        return cls(**values | ({} if fs is None else {"fs": fs}) | dict(settings))

    @model_validator(mode="before")
    @classmethod
    def _plain(cls, values: Any) -> Any:
        """Numbers of NumPy, names in one text with commas, and a `Tail`, as plain values."""
        if not isinstance(values, Mapping):
            return values
        out = {name: value.item() if hasattr(value, "item") else value for name, value in values.items()}
        if isinstance(out.get("fs"), float) and out["fs"].is_integer():
            out["fs"] = int(out["fs"])
        for name in ("outputs", "effects"):
            value = out.get(name)
            if isinstance(value, list) or (isinstance(value, str) and value not in get_args(EffectsMode)):
                words = value.split(",") if isinstance(value, str) else value
                names = tuple(w for w in (w.strip() if isinstance(w, str) else w for w in words) if w != "")
                out[name] = names if names or not isinstance(value, str) else value  # "" is no name
        if isinstance(tail := out.get("tail"), Tail):
            text = "tail=Tail(level_db=..., cap=...) is deprecated since 0.2: give tail=seconds and tail_level_db=..."
            warnings.warn(text, DeprecationWarning, stacklevel=2)
            out |= {"tail": tail.cap, "tail_level_db": tail.level_db}
        return out

    @field_validator("oversampling")
    @classmethod
    def _quarters(cls, value: float | None) -> float | None:
        if value is not None and not (4 * value).is_integer():
            raise ValueError(f"is {value:.12g}; 0.25 to 16 in steps of 0.25 are allowed")
        return value

    @property
    def effect_changes(self) -> dict[str, Any]:
        """Overrides of an instrument for the effects and budgets that are given."""
        mode = list(self.effects) if isinstance(self.effects, tuple) else self.effects
        effects = {"mode": mode, "budget_db": self.budget_db, "budget_cents": self.budget_cents}
        return {f"effects.{key}": value for key, value in effects.items() if value is not None}

    def applied_to(self, instrument: Instrument) -> Instrument:
        """Return the instrument with effects, budgets, variation and noises that are given in place of its own.

        Raises
        ------
        TonewoodError : there is no effect of a name.
        """
        seed = {} if self.humanize is None else {"playing.variation.seed": self.humanize}
        noises = {} if self.noises is None else {"playing.noises.on": self.noises}
        return instrument.replace(self.effect_changes | seed | noises)

    def at(self, **settings: Any) -> Self:
        """Return a copy with settings that need no check, as other code has derived them."""
        return self.model_copy(update=settings)


def limits(field: FieldInfo) -> tuple[float, float] | None:
    """Smallest and largest value of a number; None for any other option."""
    low = next((m.ge for m in field.metadata if hasattr(m, "ge")), None)
    high = next((m.le for m in field.metadata if hasattr(m, "le")), None)
    return None if low is None or high is None else (float(low), float(high))


def choices(annotation: Any) -> list[str]:
    """Words that an option may be, in the order of its declaration."""
    if isinstance(annotation, str):
        return [annotation]
    return [word for member in get_args(annotation) for word in choices(member)]


def _error(fault: ValidationError, model: type[RenderOptions]) -> TonewoodError:
    """One line for the first value that is not allowed."""
    key, reason = first_message(fault, model)
    name = str(fault.errors()[0]["loc"][0])
    field, value = model.model_fields.get(name), fault.errors()[0]["input"]
    if field is not None and fault.errors()[0]["type"] != "value_error":
        span, words = limits(field), choices(field.annotation)
        shown = f"{as_float(value):.12g} {unit_of(field)}" if span and isinstance(value, (int, float)) else repr(value)
        if span:
            reason = f"is {shown}; {span[0]:.12g} to {span[1]:.12g} are allowed"
        elif name == "lead_in":
            reason = f"is {shown}; auto or 0 to {LONGEST_LEAD_IN:g} s are allowed"
        elif name == "outputs":
            reason = f"is {shown}; names of output groups are allowed"
        elif words:
            reason = f"is {shown}; {', '.join(words)}{' or names' if name == 'effects' else ''} are allowed"
    return TonewoodError(reason, key=name if field is not None else key)
