"""The bundle format ``tonewood-instrument/2``: every key an ``instrument.yaml`` may have.

SI throughout; other units only where the key says so (``_deg``, ``_cents``, ``_db``). A part that a plugin makes has
the keys of that plugin beside those listed here.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import ConfigDict, Field, field_validator, model_validator

from tonewood.instrument.bundle.added_schema import Added
from tonewood.instrument.bundle.equalizer_schema import EqualizerBand
from tonewood.instrument.bundle.key_schema import MOST_STRINGS, Keys, Name
from tonewood.instrument.bundle.string_schema import Fretboard, MadeOf, Scatter
from tonewood.instrument.contract.directions import Direction
from tonewood.instrument.contract.gestures import StringPlace
from tonewood.support.params import Number, Parameters, Vector, described, quantity

SCHEMA = "tonewood-instrument/2"

#: parts of one kind that an instrument may have
MOST_PARTS = 100

_CC = r"^cc([0-9]|[1-9][0-9]|1[01][0-9]|12[0-7])$"
_MOVED = r"^(channel_pressure|cc([0-9]|[1-9][0-9]|1[01][0-9]|12[0-7]))$"


class Source(Parameters):
    """Source of figures."""

    text: str = described("author, title, place of publication")
    doi: str | None = described("digital object identifier", default=None)
    url: str | None = described("address, where there is no DOI", default=None)
    licence: str = described("SPDX name, or `facts` for figures without an author")
    changes: str | None = described("changes made to the data, and by whom", default=None)


class Provenance(Parameters):
    """Kind and source of figures."""

    kind: Literal["measured", "estimated", "published", "computed", "authored", "stand_in", "unknown"] = described(
        "measured on the instrument; estimated from its recorded sound; published in a text; computed from such; "
        "authored by ear or judgement; stand_in for figures that are not published; unknown where no source is stated"
    )
    source: str | None = described(
        "key of `sources`; needed if measured, estimated, published or computed", default=None
    )
    note: str | None = described("remark on them", default=None)
    sha256: Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")] | None = described(
        "SHA-256 of the bytes of the table that these figures are; `check` tells when it is another", default=None
    )


class PluginPart(Parameters):
    """A part made by a plugin: the plugin's name, and keys that are checked against the plugin's own parameters."""

    model_config = ConfigDict(extra="allow")
    plugin: str = described("name of the plugin that makes it, or FILE.py:CLASS for one in the bundle's folder")

    @property
    def values(self) -> dict[str, Any]:
        """Keys of the plugin itself."""
        return dict(self.model_extra or {})


class BodyPart(PluginPart):
    """The body, to which strings are joined."""

    added: list[Added] = described(
        "masses, springs, dashpots and tuned dampers put on it", default=[], max_length=MOST_PARTS
    )


class StringPoint(Parameters):
    """A named place on a string, to be heard or joined."""

    from_bridge: StringPlace = described("m, or {fraction: of the open speaking length}")
    width: float = quantity("m", low=0.0, high=0.2, default=0.0, doc="of the string about it whose mean it stands for")


class StringSetEntry(Parameters):
    """A string of a set that can be bought; see ``string_sets.yaml``."""

    note: str = described("of the open string")
    length: float | None = quantity("m", low=0.02, high=5.0, default=None, doc="if not that of the set")
    tension: float | None = quantity(
        "N", low=1.0, high=2000.0, usual=(10.0, 1500.0), default=None, doc="at that length and note"
    )
    diameter: float | None = quantity("m", low=1e-5, high=0.05, default=None, doc="of the whole string")
    core: float = quantity("1", low=0.05, high=1.0, default=1.0, doc="share of the diameter that bends and stretches")
    density: float | None = quantity("kg/m^3", low=100.0, high=3e4, default=None, doc="effective, of the whole string")
    linear_density: float | None = quantity("kg/m", low=1e-5, high=0.3, default=None, doc="mass per length")
    young: float | None = quantity("Pa", low=1e8, high=1e12, default=None, doc="of the part that bends and stretches")
    bending_stiffness: float | None = quantity("N m^2", low=0.0, high=1.0, default=None, doc="E I")
    made_of: MadeOf | None = described("gauge and materials, for what the others leave out", default=None)
    fretting_stiffness: float | None = quantity("N", low=0.0, high=1e7, default=None, doc="E A in slow stretch")
    loss: dict[str, Any] | None = described("loss law and its numbers", default=None)

    @model_validator(mode="after")
    def _mass(self) -> StringSetEntry:
        ways = (self.linear_density, self.tension, self.made_of, self.density and self.diameter)
        if not any(ways):
            raise ValueError("a linear density, a tension, a density and a diameter, or `made_of` are wanted")
        return self


class StringSet(Parameters):
    """A set of strings that can be bought, from bass to treble."""

    maker: str = described("who makes it")
    product: str = described("its name and gauge")
    length: float = quantity("m", low=0.02, high=5.0, doc="at which its tensions hold")
    source: Source = described("where its figures come from")
    strings: list[StringSetEntry] = described("from bass to treble", min_length=1)


class StringPart(PluginPart):
    """A string; `defaults` gives keys for all of them."""

    note: str | Number | None = described("pitch of the open string: note name or MIDI number", default=None)
    freq: float | None = quantity("Hz", low=8.0, high=8000.0, default=None, doc="instead of `note`")
    cents: float = quantity("cents", low=-100.0, high=100.0, default=0.0, doc="by which it is tuned above its note")
    end: str | list[str] = described("body.POINT the string ends on; several for several directions at one place")
    axis: Vector = described("from fixed end to bridge, length 1", default=(1.0, 0.0, 0.0))
    polarizations: list[Direction] = described(
        "one or two directions; the first is kept when effects are left out",
        default=["z", "y"],
        min_length=1,
        max_length=2,
    )
    tilt_deg: float = quantity("deg", low=-90.0, high=90.0, default=0.0, doc="of the principal axes about the string")
    split_cents: float = quantity(
        "cents", low=-50.0, high=50.0, default=0.0, doc="by how much the second polarization is sharper"
    )
    break_angle_deg: float | None = quantity(
        "deg",
        low=0.0,
        high=90.0,
        default=None,
        doc="by which the string bends down behind the bridge; `check` computes the force",
    )
    scatter: Scatter = described("of tilt and split, from string to string and stop to stop", default=Scatter())
    freq_upper: float = quantity("Hz", low=100.0, high=1e5, default=20000.0, doc="highest mode")
    end_compliance: float = quantity(
        "m/N", low=0.0, high=1e-4, default=2e-8, doc="local compliance of the string's seat on the bridge"
    )
    stops: int | None = described(
        "number of stops of this string, if not that of `stops`", default=None, ge=0, le=200, strict=True
    )
    points: dict[Name, StringPoint] = described("further places on the string", default={}, max_length=MOST_PARTS)
    made_of: MadeOf | None = described(
        "gauge and materials; they give mass, stiffness and loss where these are left out", default=None
    )
    fretting_stiffness: float | None = quantity(
        "N", low=0.0, high=1e7, default=None, doc="E A in slow stretch; `axial_stiffness` where left out"
    )
    fretboard: Fretboard = described("of this string, if not that of `stops`", default=Fretboard())

    @property
    def ends(self) -> tuple[str, ...]:
        """Points of the body that the string ends on, ``body.POINT`` each."""
        return (self.end,) if isinstance(self.end, str) else tuple(self.end)

    @property
    def body_points(self) -> tuple[str, ...]:
        """Points of the body that it ends on."""
        return tuple(end.partition(".")[2] for end in self.ends)

    def label(self, polarization: int) -> str:
        """Name of one of its polarizations: its direction, or p1 and p2 where that is a vector."""
        direction = self.polarizations[polarization]
        return direction if isinstance(direction, str) else f"p{polarization + 1}"

    @model_validator(mode="after")
    def _pitch(self) -> StringPart:
        if (self.note is None) == (self.freq is None):
            raise ValueError("either `note` or `freq` is wanted")
        return self


class ConnectionPart(PluginPart):
    """Contacts and masses on strings: frets, a curved bridge, a loose part."""

    strings: list[Name] | None = described("those it touches; all where left out", default=None)


class Finger(Parameters):
    """A fingertip that stops a string: the skin, and behind it the mass that the hand presses down."""

    skin_stiffness: float = quantity("N/m", low=1.0, high=1e7, default=1e5, doc="between string and fingertip")
    skin_damping: float = quantity("N s/m", low=0.0, high=1e3, default=1.0, doc="between string and fingertip")
    mass: float = quantity("kg", low=1e-5, high=1.0, default=5e-3, doc="of the fingertip")
    freq: float = quantity("Hz", low=1.0, high=1e4, default=600.0, doc="of the fingertip on the board it presses")
    damping_ratio: float = quantity("1", low=0.0, high=10.0, default=0.5, doc="of the same")


class Stops(Parameters):
    """Stops of the strings."""

    kind: Literal["none", "frets", "continuous"] = described(
        "none: open strings; frets: whole steps of the scale; continuous: any place up to `count` steps", default="none"
    )
    count: int = described("number of steps of the scale", default=0, ge=0, le=200, strict=True)
    model: Literal["ideal", "finger"] = described(
        "ideal: the string beyond the stop is out of play; finger: a soft finger holds the whole string there",
        default="ideal",
    )
    finger: Finger = described("where the model is finger", default=Finger())
    fretboard: Fretboard = described("nut, frets and saddle; see `tuning.at`", default=Fretboard())


class TuningSettings(Parameters):
    """Pitch."""

    reference_freq: float = quantity("Hz", low=200.0, high=1000.0, default=440.0, doc="of A4")
    scale: str = described("equal_12, or a Scala .scl file of the bundle", default="equal_12")
    keymap: str | None = described("Scala .kbm file of the bundle", default=None)
    compensate: Literal["coupled", "none"] = described(
        "coupled: tensions are set so that the string on its body sounds the note; none: as they stand",
        default="coupled",
    )
    hold: Literal["pitch", "tension"] = described(
        "where coupled, an open string keeps its pitch (its note; the tension follows) or its tension (that "
        "of the bundle; the pitch of the string and of its stops follows)",
        default="pitch",
    )
    at: Literal["each_stop", "open_only", "frets"] = described(
        "each_stop: every stop is tuned to its note; open_only: stops have the open string's tension; frets: stops "
        "sound where `fretboard`, rising tension and stiffness put them",
        default="each_stop",
    )
    stretch: Literal["none", "octaves"] = described(
        "octaves: open strings are tuned so that octaves beat least, by their own inharmonicity", default="none"
    )


class Velocity(Parameters):
    """From MIDI velocity to a parameter: low at 1, high at 127."""

    parameter: str = described("EXCITER.PARAMETER", default="pluck.force")
    low: float = quantity("1", default=0.4, doc="at velocity 1, in the parameter's unit")
    high: float = quantity("1", default=4.0, doc="at velocity 127")
    curve: Literal["exponential", "linear"] = described(
        "exponential: low (high / low)^((v - 1) / 126); linear: low + (high - low) (v - 1) / 126", default="exponential"
    )

    @model_validator(mode="after")
    def _positive(self) -> Velocity:
        if self.curve == "exponential" and not (self.low > 0 and self.high > 0):
            raise ValueError("an exponential curve needs low and high above 0")
        return self

    @property
    def exciter(self) -> str:
        """EXCITER of `parameter`."""
        return self.parameter.partition(".")[0]

    def value(self, velocity_midi: float) -> float:
        """Parameter at a velocity of 1 .. 127; below and above the ends hold."""
        share = (min(max(velocity_midi, 1.0), 127.0) - 1.0) / 126.0
        if self.curve == "linear":
            return self.low + (self.high - self.low) * share
        return float(self.low * (self.high / self.low) ** share)


class NoteEnd(Parameters):
    """End of a note."""

    kind: Literal["ring", "damp"] = described("ring: nothing; damp: the string is damped", default="ring")
    t60: float = quantity("s", low=1e-3, high=100.0, default=0.12, doc="decay time of a damped string")
    idle: Literal["ring", "damp"] = described(
        "strings that no note is on: ring: they ring with the others; damp: a hand lies on them", default="ring"
    )


class HandNoises(Parameters):
    """Exciters that play the noises of hands and keys besides the notes of a score; none where left out."""

    on: bool = described("whether they are played", default=False, strict=True)
    fretting: Name | None = described("as a finger comes to another stop, or leaves one", default=None)
    touch: Name | None = described("as a note is damped", default=None)
    squeak: Name | None = described("as the hand slides along a string to another stop", default=None)
    least_shift: float = quantity("1", low=0.0, high=100.0, default=2.0, doc="steps of the scale of a hand that slides")
    key: Name | None = described("with each note: its key goes down", default=None)
    release: Name | None = described("as a key comes up", default=None)

    @property
    def named(self) -> dict[str, str]:
        """Noise -> exciter, of those that there are."""
        return {k: v for k in ("fretting", "touch", "squeak", "key", "release") if (v := getattr(self, k)) is not None}


class Slurs(Parameters):
    """Exciters of notes that begin while the one before on their string still lasts in the score."""

    overlap: float = quantity("s", low=0.0, high=10.0, default=0.02, doc="least time for which both last")
    up: Name | None = described("of a higher note, e.g. a hammer-on; none: plucked", default=None)
    down: Name | None = described("of a lower note, e.g. a pull-off; none: plucked", default=None)
    far: Name | None = described("of one more than `reach` away, e.g. a slide; none: plucked", default=None)
    reach: float = quantity("1", low=0.0, high=200.0, default=4.0, doc="steps of the scale that fingers span")

    @property
    def named(self) -> dict[str, str]:
        """Way -> exciter, of those that are given."""
        return {k: v for k in ("up", "down", "far") if (v := getattr(self, k)) is not None}


class ControllerMap(Parameters):
    """A controller that moves a parameter from low (0) to high (127)."""

    parameter: str = described("EXCITER.PARAMETER")
    low: float = quantity("1", doc="at 0, in the parameter's unit")
    high: float = quantity("1", doc="at 127")

    def value(self, position: float) -> float:
        """Parameter at a controller's position 0 .. 1."""
        return self.low + (self.high - self.low) * min(max(position, 0.0), 1.0)


class HumanVariation(Parameters):
    """Human variation from note to note: standard deviations; off unless there is a seed."""

    seed: int | None = described("of the performance; none where left out", default=None, ge=0)
    time: float = quantity("s", low=0.0, high=1.0, default=0.008, doc="of a note's beginning")
    force_db: float = quantity("dB", low=0.0, high=20.0, default=1.5, doc="of its force")
    from_bridge: float = quantity("m", low=0.0, high=0.2, default=0.010, doc="of its place: fingers alternate")
    angle_deg: float = quantity("deg", low=0.0, high=90.0, default=10.0, doc="of its direction")
    nail: float = quantity("1", low=0.0, high=1.0, default=0.15, doc="of the share of nail")


class Playing(Parameters):
    """From notes to gestures."""

    exciter: str | None = described("of notes that name no technique; the velocity's where left out", default=None)
    velocity: Velocity = described("velocity curve", default=Velocity())
    note_end: NoteEnd = described("end of a note", default=NoteEnd())
    variation: HumanVariation = described("from note to note", default=HumanVariation())
    noises: HandNoises = described("of a hand between notes", default=HandNoises())
    slurs: Slurs = described("of notes that overlap on a string", default=Slurs())
    controls: dict[Annotated[str, Field(pattern=_MOVED)], ControllerMap] = described(
        "ccN or channel_pressure -> parameter", default={}
    )
    keyswitches: dict[str, Name] = described("key -> exciter that notes after it ask for, on its channel", default={})
    switches: dict[Annotated[str, Field(pattern=_CC)], Name] = described(
        "ccN -> exciter that notes ask for while it is at 64 or more", default={}
    )

    @property
    def default_exciter(self) -> str:
        """Exciter of notes that name no technique."""
        return self.exciter or self.velocity.exciter


class OutputPart(PluginPart):
    """A group of output channels, made by a pickup plugin."""

    name: Name = described("of the group")
    full_scale: float = quantity("1", low=1e-12, high=1e12, doc="value at 0 dBFS, in the pickup's unit")
    gain_db: float = quantity("dB", low=-120.0, high=60.0, default=0.0, doc="of its channels")
    pan: float | None = quantity(
        "1",
        low=-1.0,
        high=1.0,
        default=None,
        doc="-1 left to 1 right, at constant power: one channel becomes two, two are balanced",
    )
    delay: float = quantity("s", low=0.0, high=0.1, default=0.0, doc="of its channels, to the nearest frame")
    equalizer: list[EqualizerBand] = described("gain of its channels over frequency", default=[], max_length=MOST_PARTS)
    note: str | None = described("meaning and limits of this output", default=None)


class Effects(Parameters):
    """Effects that a render may leave out, and the largest error of that."""

    mode: Literal["auto", "all", "none"] | list[str] = described("auto, all, none or names", default="auto")
    budget_db: float = quantity("dB", low=-300.0, high=0.0, default=-80.0, doc="for effects that add something")
    budget_cents: float = quantity("cents", low=0.0, high=100.0, default=0.5, doc="for effects that change pitch")


class Preset(Parameters):
    """Options of a render under one name; those that a user gives come first."""

    outputs: list[Name] | None = described("output groups; the instrument's first where left out", default=None)
    room: Literal["studio", "small", "hall"] | None = described("none where left out", default=None)
    room_distance: float | None = quantity("m", low=0.1, high=60.0, default=None, doc="of the microphones in it")
    room_mix_db: float = quantity("dB", low=-100.0, high=40.0, default=0.0, doc="of the room's own sound")
    humanize: int | None = described("seed of human variation; none where left out", default=None, ge=0)
    noises: bool = described("noises of the hands between notes", default=False, strict=True)


#: keys of a bundle without strings, where it leaves them out
_BODY_ALONE: dict[str, Any] = {"licence": "not stated", "sources": {}, "strings": {}, "exciters": {}, "outputs": []}


class Bundle(Parameters):
    """An instrument, or a body alone: then `name` and `body` are enough."""

    schema_: Literal["tonewood-instrument/2"] = Field(alias="schema", description="version of this format")
    name: Name = described("as it is called on the command line")
    title: str = described("one line")
    description: str | None = described("remarks for users", default=None)
    licence: str = described("SPDX name, of the bundle's data")
    sources: dict[Name, Source] = described("key -> where figures come from")
    provenance: dict[str, Provenance] = described("dotted path, * for one level -> kind of figures", default={})
    body: BodyPart = described("part that the strings are joined to")
    strings: dict[Name, StringPart] = described(
        "name -> string, from bass to treble; none of a body alone", max_length=MOST_STRINGS
    )
    strings_from: str | None = described(
        "named string set, for values that `strings` leaves out; `tonewood list` has their names", default=None
    )
    keys: Keys | None = described("strings that one note plays together, their hammers and dampers", default=None)
    stops: Stops = described("frets", default=Stops())
    tuning: TuningSettings = described("pitch", default=TuningSettings())
    exciters: dict[Name, PluginPart] = described("name -> way of playing", max_length=MOST_PARTS)
    playing: Playing = described("from notes to gestures", default=Playing())
    outputs: list[OutputPart] = described("groups of channels; the first is the default", max_length=MOST_PARTS)
    effects: Effects = described("effects that may be left out", default=Effects())
    presets: dict[Name, Preset] = described("name -> options of a render; besides dry, studio, stage", default={})
    oversampling: Literal[1, 2, 4] = described(
        "steps per sample at standard accuracy: more where something lies on a string while it sounds", default=1
    )
    draft_oversampling: float = quantity(
        "1",
        low=0.25,
        high=1.0,
        default=0.5,
        doc="steps at draft accuracy per step at standard, in quarters: more where a draft would lose a contact",
    )
    connections: dict[Name, ConnectionPart] = described(
        "name -> part that touches strings besides the body", default={}
    )

    @model_validator(mode="before")
    @classmethod
    def _alone(cls, values: Any) -> Any:
        """Fill in what a body without strings has no need of."""
        if not isinstance(values, dict) or values.get("strings") or values.get("keys"):
            return values
        return {"title": values.get("name"), **_BODY_ALONE, **values}

    @model_validator(mode="after")
    def _fretted(self) -> Bundle:
        if self.tuning.at == "frets":
            for key, value, required in (
                ("stops.kind", self.stops.kind, "frets"),
                ("stops.model", self.stops.model, "ideal"),
                ("tuning.compensate", self.tuning.compensate, "coupled"),
            ):
                if value != required:
                    raise ValueError(f"tuning.at: frets wants {key}: {required}, which is {value}")
        return self

    @model_validator(mode="after")
    def _played(self) -> Bundle:
        if self.strings and not (self.exciters and self.outputs):
            raise ValueError(f"strings need {'outputs' if self.exciters else 'exciters'}: at least one is wanted")
        return self

    @field_validator("draft_oversampling")
    @classmethod
    def _quarters(cls, value: float) -> float:
        if not (4 * value).is_integer():
            raise ValueError("0.25, 0.5, 0.75 and 1 are allowed")
        return value

    @model_validator(mode="after")
    def _names(self) -> Bundle:
        names = [output.name for output in self.outputs]
        components = {"body", *self.strings}
        for name in names:
            if names.count(name) > 1 or name in components:
                raise ValueError(f"the output name {name!r} is taken")
        if "body" in self.strings or "defaults" in self.strings:
            raise ValueError("a string cannot be called body or defaults")
        for part in (*self.connections, *self.exciters):
            if part in self.connections and part in self.exciters:
                raise ValueError(f"the name {part!r} is both a connection's and an exciter's")
        return self
