"""The user's dial: differences between ``draft``, ``standard`` and ``reference`` on an instrument, and their cost.

A note is rendered with each, and its partials are held against those of ``reference`` (`partials.compare`): once where
the motion is regular, many times with forces a little apart where it is sensitive.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, astuple, dataclass, replace
from operator import attrgetter
from typing import Any

from tonewood.instrument.bundle.loading import Instrument
from tonewood.instrument.contract.registry import INSTRUMENTS, entries
from tonewood.lab.accuracy.partials import PartialErrors
from tonewood.lab.accuracy.strokes import NUDGE, SENSITIVE, SPREAD, STEADY, VELOCITY_MIDI, NoteCase, Strokes, forces
from tonewood.lab.accuracy.timing import Tell, silent
from tonewood.lab.tables import number, table
from tonewood.sound.render.accuracy import LEVELS

#: Hz and s of the sound
FS, DURATION = 48000, 4.0
#: s, in a quick run
SHORT = 1.5
#: renders of which the median is timed
REPEATS = 3
#: how far `standard` may be from `reference`: cents, share of a decay rate, dB
LIMITS = (1.0, 0.05, 1.0)
#: measures of a `PartialErrors`, and their units in print
MEASURES = {
    "cents": " cents", "cents_worst": " cents", "decay": "", "decay_worst": "", "level": " dB", "level_worst": " dB",
    "waveform": "",
}  # fmt: skip
#: of a sensitive motion
STROKES = 32
#: labels of `reference` with a thousandth more force, and of one half of its strokes against the other
NUDGED, OTHERS = "reference, force +0.1 %", "reference, other strokes"

TEXT = f"""\
## The user's dial: `--accuracy`

| `tonewood render --accuracy` | engine runs at | modes up to |
| --- | --- | --- |
| `draft` | half the rate of `standard`, or three quarters of it where a bundle asks for it | 0.45 of it |
| `standard`, the default | the rate of the sound, or twice or four times it where a bundle asks for it | 0.45 of it |
| `reference` | four times that of `standard` | 0.45 of that |

A linear-phase filter leads from the engine's rate to that of the sound.

The middle string of every instrument, one open note of MIDI velocity {VELOCITY_MIDI} at 48 kHz, heard for
{DURATION:g} s. Median / worst over the partials, of the first twenty, that lie within 40 dB of the loudest, against
`reference`: pitch and level from {STEADY:g} s after the note on; decay as the slope, in dB per second, of the energy
still to come (Schroeder's backward integration, ISO 3382-1), which is the rate of an exponential and still a number
where partials beat or feed each other. A bow plays for half of the time; the decay is that after it. Waveform: the
relative difference in the first second, under a Hann window, after the mean delay is taken out (accelerations are means
over the step that begins at a frame, half a step early).

Time is processor time of one thread, the median of {REPEATS} renders that take turns (`reference`: one). Where a
thousandth more force changes `reference` by more than a fifth of a limit, contacts or a bow make the motion sensitive:
two strokes never sound alike, and no step is fine enough to tell which one follows. Properties that strokes have in
common are compared then: the mean pitch of {STROKES} strokes with forces spread over {100 * SPREAD:g} % to either side,
and the mean energy of their partials. *{OTHERS}* holds one half of them against the other: that much is left to
chance."""

WHY = """\
### Why a draft makes longer steps

A draft used to step modes up to 10 kHz only, at the rate of the sound, and lay nearer to `reference` in pitch than
`standard` did. The cause: a force that is constant over a step of length h reaches a mode of frequency ω as

    (φ²/ω²) (1 - cos ωh) cos(Ωh/2) / (cos Ωh - cos ωh)        instead of        φ²/(ω² - Ω²)

at the frequency Ω, apart from a factor that all modes share. Below the Nyquist frequency the difference is
Ω²h² (φ²/ω²) e(θ), θ = ωh/2, e = 1/(4 sin²θ) - 1/(4θ²) - 1/12 = θ²/60 + ...: for θ small each mode adds the same,
φ² h⁴ Ω²/240, and those near the Nyquist frequency add more (1.4 times at 0.45 of the rate). So the error of pitch grows
with the number of modes stepped, all of which the held force drives alike, and with h³ to h⁴; leaving modes out makes
the pitch better, the sound duller, and is hardly cheaper. The formula foretells the errors of coupled partials within
some per cent (`tests/convergence/test_highest_modes.py`). Longer steps cost less and are farther off by every
measure."""

#: cents and dB that leaving an effect out may cost
BUDGETS = ((0.05, -120.0), (0.5, -80.0), (5.0, -40.0))
#: N, of the pluck there
FORCE = 2.0
BUDGET_TEXT = f"""\
## Effects and their budgets

The same comparison for `--effects`: a string of the steel-string guitar plucked with {FORCE:g} N, against all effects.
Auto leaves out effects within `--budget-cents` and `--budget-db`, bounds on pitch and on the sound added, so
differences of the pitch lie below them. A rise that is left out turns the phase of partials: that is the difference of
waveforms, which no budget bounds, and in two planes that beat the one of decay."""


@dataclass(frozen=True, slots=True)
class DialPoint:
    """One setting on one string of one instrument.

    instrument, string, accuracy : names.
    errors : against ``reference``.
    seconds : of computing per second of sound.
    n_modes : stepped.
    strokes : whose means were compared; 1 where the motion is regular.
    """

    instrument: str
    string: str
    accuracy: str
    errors: PartialErrors
    seconds: float
    n_modes: int
    strokes: int

    def to_dict(self) -> dict[str, object]:
        """Flat, for JSON."""
        plain = asdict(self)
        errors = plain.pop("errors")
        return {**plain, **errors}


def measure(instrument: Instrument, string: str, *, nudge: bool = True) -> list[DialPoint]:
    """All settings on the open string of an instrument.

    nudge : also the notes of `reference` for a thousandth more force; where that is much, strokes are compared by their
        means. Without it one stroke is, and not for so long.
    """
    case = NoteCase.of(instrument, string, DURATION if nudge else SHORT, fs=FS)
    options: dict[str, dict[str, Any]] = {name: {"accuracy": name} for name in LEVELS}
    if not nudge:
        return _against(case, {label: case.strokes(setting) for label, setting in options.items()}, "reference")
    truth = case.strokes(options["reference"])
    again = case.strokes(options["reference"], NUDGE)
    chance = case.errors(again, truth)
    spread = (chance.cents, chance.decay, chance.level)
    if all(e <= SENSITIVE * limit for e, limit in zip(spread, LIMITS, strict=True)):
        rendered = {label: case.strokes(setting) for label, setting in options.items() if label != "reference"}
        return _against(case, {**rendered, "reference": truth, NUDGED: again}, "reference", _timed(case, options))
    rendered = {label: case.strokes(setting, forces(STROKES)) for label, setting in options.items()}
    truth = rendered["reference"]
    points = _against(case, rendered, "reference", _timed(case, options))
    return [*points, _point(case, OTHERS, *truth.halves())]


def _point(case: NoteCase, label: str, strokes: Strokes, truth: Strokes) -> DialPoint:
    """One setting."""
    errors, name = case.errors(strokes, truth), case.instrument.spec.name
    return DialPoint(name, case.string, label, errors, strokes.seconds, strokes.n_modes, len(strokes.sounds))


def _timed(case: NoteCase, options: Mapping[str, Mapping[str, Any]]) -> dict[str, float]:
    """Seconds per second of all settings but `reference`, which takes long enough to be timed once."""
    short = {label: setting for label, setting in options.items() if label != "reference"}
    return dict(zip(short, case.timed(list(short.values()), REPEATS), strict=True))


def _against(
    case: NoteCase, rendered: Mapping[str, Strokes], truth: str, seconds: Mapping[str, float] | None = None
) -> list[DialPoint]:
    """All settings against one; `seconds` where they were timed in turns."""
    points = [_point(case, label, strokes, rendered[truth]) for label, strokes in rendered.items()]
    return [replace(point, seconds=(seconds or {}).get(point.accuracy, point.seconds)) for point in points]


def budgets(*, quick: bool = False) -> list[DialPoint]:
    """Measure time and errors of effects: the steel-string guitar with all of them, with budgets, without."""
    instrument = Instrument.load("steel_strings")
    options: dict[str, dict[str, Any]] = {"all": {"effects": "all"}}
    for cents, db in BUDGETS:
        named = f"auto, {cents:g} cents, {db:g} dB"
        options[named] = {"effects": "auto", "budget_cents": cents, "budget_db": db}
    options["none"] = {"effects": "none"}
    case = NoteCase.of(instrument, middle_string(instrument), SHORT if quick else DURATION, force=FORCE, fs=FS)
    times = None if quick else dict(zip(options, case.timed(list(options.values()), REPEATS), strict=True))
    return _against(case, {label: case.strokes(setting) for label, setting in options.items()}, "all", times)


def run(*, quick: bool = False, tell: Tell = silent) -> list[DialPoint]:
    """Every instrument of this package, its middle string; in a quick run the guitar alone."""
    shipped = [name for name, entry in entries(INSTRUMENTS).items() if entry.distribution == "tonewood"]
    names: Sequence[str] = ["classical_guitar"] if quick else shipped
    out: list[DialPoint] = []
    for done, name in enumerate(names, 1):
        instrument = Instrument.load(name)
        out += measure(instrument, middle_string(instrument), nudge=not quick)
        tell(done / len(names))
    return out


def section(points: Sequence[DialPoint]) -> str:
    """Markdown."""
    rows = _table(points, "--accuracy", "standard", "reference")
    return f"{TEXT}\n\n{rows}\n\n{_within(points)}\n\n{_order(points)}\n\n{WHY}"


def out_of_order(points: Sequence[DialPoint]) -> list[str]:
    """Measures of one instrument by which `standard` is farther from `reference` than `draft`, worded.

    A difference counts that is larger than the change by which the reference itself is uncertain: that from a
    thousandth more force or from other strokes, and a tenth of the errors compared.
    """
    at = {p.accuracy: p.errors for p in points}
    chance = next((at[label] for label in (OTHERS, NUDGED) if label in at), None)
    out = []
    for name, unit in MEASURES.items():
        coarse, fine = getattr(at["draft"], name), getattr(at["standard"], name)
        if coarse is None or fine is None:
            continue
        allowed = 1.1 * coarse + (0.0 if chance is None else getattr(chance, name) or 0.0)
        if fine > allowed:
            out.append(f"{name} {number(fine)} against {number(coarse)}{unit}")
    return out


def _order(points: Sequence[DialPoint]) -> str:
    """Whether each step of the dial leads nearer to the reference."""
    by_name: dict[str, list[DialPoint]] = {}
    for p in points:
        by_name.setdefault(p.instrument, []).append(p)
    wrong = {name: measures for name, points_of in by_name.items() if (measures := out_of_order(points_of))}
    cheaper = [points_of[1].seconds / points_of[0].seconds for points_of in by_name.values()]
    text = f"`draft` takes {number(1 / max(cheaper), 2)} to {number(1 / min(cheaper), 2)} of the time of `standard`"
    if not wrong:
        return f"{text}, and by no measure does it lie nearer to `reference`, beyond chance."
    listed = "; ".join(f"{name} ({', '.join(measures)})" for name, measures in wrong.items())
    return f"{text}; it lies nearer to `reference`: {listed}."


def beyond(errors: PartialErrors, *, worst: bool = False) -> str:
    """Limits that the median, or the worst partial, does not keep: `1.4 cents, 7 % of the decay`; empty if none."""
    values = astuple(errors)[1:6:2] if worst else astuple(errors)[:6:2]
    units = zip(values, LIMITS, (1, 100, 1), ("cents", "% of the decay", "dB"), strict=True)
    return ", ".join(f"{number(scale * v)} {unit}" for v, limit, scale, unit in units if not v <= limit)


def _within(points: Sequence[DialPoint]) -> str:
    """Which instruments keep the limits with `standard`, and which do not."""
    points = [p for p in points if p.accuracy == "standard"]
    outside = {p.instrument: missed for p in points if (missed := beyond(p.errors))}
    worse = {
        p.instrument: missed for p in points if (missed := beyond(p.errors, worst=True)) and p.instrument not in outside
    }
    inside = [p.instrument for p in points if p.instrument not in outside and p.instrument not in worse]
    cents, decay, level = LIMITS
    text = f"`standard` is within {cents:g} cent, {100 * decay:g} % of the decay and {level:g} dB of `reference`"
    parts = [f"in every partial on {', '.join(inside) or 'none'}"]
    for which, names in (("in the median of the partials on", worse), ("not on", outside)):
        if names:
            worst = "worst: " if names is worse else ""
            parts.append(f"{which} {', '.join(f'{name} ({worst}{missed})' for name, missed in names.items())}")
    return f"{text} {'; '.join(parts)}."


def budget_section(points: Sequence[DialPoint]) -> str:
    """Markdown."""
    return f"{BUDGET_TEXT}\n\n{_table(points, '--effects', 'all', 'all')}"


def _table(points: Sequence[DialPoint], heading: str, unit: str, truth: str) -> str:
    """Rows of errors against `truth` and times in those of `unit`."""
    seconds = {p.instrument: p.seconds for p in points if p.accuracy == unit}

    def errors(median: str, scale: float = 1.0) -> Callable[[DialPoint], str]:
        pair = attrgetter(median, f"{median}_worst")
        return lambda p: "" if p.accuracy == truth else " / ".join(number(scale * e) for e in pair(p.errors))

    def waveform(p: DialPoint) -> str:
        return "" if p.accuracy == truth or p.errors.waveform is None else number(100 * p.errors.waveform)

    def cost(per: Callable[[DialPoint], float]) -> Callable[[DialPoint], str]:
        return lambda p: "" if p.accuracy in (NUDGED, OTHERS) else number(p.seconds / per(p), 3)

    columns: Mapping[str, Callable[[DialPoint], str]] = {
        "instrument": lambda p: p.instrument,
        heading: lambda p: p.accuracy,
        "modes": lambda p: str(p.n_modes),
        "cents": errors("cents"),
        "decay %": errors("decay", 100.0),
        "level dB": errors("level"),
        "waveform %": waveform,
        "s per s": cost(lambda p: 1.0),
        "time ratio": cost(lambda p: seconds[p.instrument]),
    }
    return table(points, columns, left=2)


def middle_string(instrument: Instrument) -> str:
    """Name of one in the middle; of a key with several strings the first, which its note plays."""
    names = list(instrument.groups)
    return names[len(names) // 2]
