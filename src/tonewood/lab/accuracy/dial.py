"""The user's dial: what ``draft``, ``standard`` and ``reference`` differ by on an instrument, and what they cost.

One note is rendered with each; partials of the sound are then compared with those of ``reference``: pitch from the
drift of their phase, decay from the slope of their level, and the level itself.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tonewood.instrument.bundle import Instrument
from tonewood.instrument.registry import list_instruments
from tonewood.lab.accuracy.study import Tell, silent
from tonewood.lab.accuracy.tables import markdown, number
from tonewood.output.accuracy import LEVELS
from tonewood.output.render import Renderer
from tonewood.score.note import Note, Score

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]

#: of the note; Hz of the sound; s of it, from when on partials are compared
FORCE, FS, DURATION, SETTLED = 1.0, 48000, 1.5, 0.1
#: partials that are looked for, and how far below the loudest they may be, dB
PARTIALS, RANGE_DB = 20, 40.0
#: how far `standard` may be from `reference`: cents, share of a decay rate, dB
LIMITS = (1.0, 0.05, 1.0)
#: label of `reference` with a thousandth more force
NUDGED = "reference, force +0.1 %"

TEXT = """\
## The user's dial: `--accuracy`

| `tonewood render --accuracy` | engine runs at | modes up to | arithmetic |
| --- | --- | --- | --- |
| `draft` | the rate of the sound | 10 kHz | 32 bit |
| `standard`, the default | the rate of the sound | 0.45 of it | 64 bit |
| `reference` | four times it, brought down by a linear-phase filter | 0.45 of that | 64 bit |

The middle string of every instrument, one open note at 48 kHz. Median / worst over the partials, of the first twenty,
that lie within 40 dB of the loudest, against `reference`, from 0.1 s to 1.5 s after the note. Time is wall time of the
engine. Where a thousandth more force changes `reference` itself, contacts or a bow make the motion sensitive: that
much of a difference tells nothing of the setting, what goes beyond it does. Where contacts hold a string for as long
as it sounds, the compliance of the modes that are not stepped gives way there with a loss proportional to the step:
decay then follows the rate to first order only."""

#: cents and dB that leaving an effect out may cost
BUDGETS = ((0.05, -120.0), (0.5, -80.0), (5.0, -40.0))
BUDGET_TEXT = """\
## Effects and their budgets

The same comparison for `--effects`: a string of the steel-string guitar plucked with 2 N, against all effects. Auto
leaves out what stays within `--budget-cents` and `--budget-db`; these are bounds on each effect, so the differences
measured here lie below them."""


@dataclass(frozen=True, slots=True)
class PartialErrors:
    """Partials of a sound against those of another; medians and worst.

    Attributes
    ----------
    cents, cents_worst : pitch.
    decay, decay_worst : decay rate, relative.
    level, level_worst : dB.
    partials : how many were compared.
    """

    cents: float
    cents_worst: float
    decay: float
    decay_worst: float
    level: float
    level_worst: float
    partials: int


def compare(sound: Floats, truth: Floats, fs: float, freq: float) -> PartialErrors:
    """Compare the partials of two sounds (n,) that begin together.

    Each is shifted to zero frequency, smoothed by a Hann window of eight periods of `freq` and looked at four times in
    a window. With a and b the results, weighted by |b|^2: cents from the slope of arg(a / b), decay rates from the
    slopes of log |a| and log |b|, levels from the sums of |a|^2 and |b|^2.

    Parameters
    ----------
    freq : Hz, of the first partial; the others are sought near its multiples, and found where `truth` is loudest.
    """
    length = int(8 * fs / freq)
    window = np.hanning(length + 2)[1:-1]
    window /= window.sum()
    starts = np.arange(0, min(len(sound), len(truth)) - length, length // 4)
    t = np.asarray((starts + 0.5 * length) / fs, dtype=np.float64)
    found = []
    for f in _partials(truth, fs, freq):
        a, b = (_envelope(x, fs, f, window, starts) for x in (sound, truth))
        weight = np.asarray(np.abs(b), dtype=np.float64)
        found.append((f, a, b, weight))
    loudest = max(float(np.sum(w**2)) for *_, w in found)
    cents, decay, level = [], [], []
    for f, a, b, weight in found:
        if np.sum(weight**2) < loudest * 10 ** (-RANGE_DB / 10):
            continue
        turned = np.unwrap(np.angle(a * np.conj(b)))
        cents.append(abs(1200 / np.log(2) * _slope(t, turned, weight) / (2 * np.pi * f)))
        slopes = [_slope(t, np.log(np.maximum(np.abs(x), 1e-300)).astype(np.float64), weight) for x in (a, b)]
        decay.append(abs(slopes[0] - slopes[1]) / max(abs(slopes[1]), 0.1))
        level.append(abs(10 * np.log10(np.sum(np.abs(a) ** 2) / np.sum(weight**2))))
    (c, c_worst), (d, d_worst), (v, v_worst) = ((float(np.median(x)), float(np.max(x))) for x in (cents, decay, level))
    return PartialErrors(c, c_worst, d, d_worst, v, v_worst, len(cents))


def _partials(truth: Floats, fs: float, freq: float) -> list[float]:
    """Frequencies of the partials, Hz: maxima of the spectrum, each sought near where the last ones lead to."""
    from scipy.fft import rfft, rfftfreq

    n = 8 * len(truth)
    spectrum, grid = np.abs(rfft(truth * np.hanning(len(truth)), n)), rfftfreq(n, 1 / fs)
    out: list[float] = []
    for k in range(1, PARTIALS + 1):
        guess = freq if k == 1 else out[-1] * k / (k - 1)
        near = np.flatnonzero(np.abs(grid - guess) < 0.12 * freq)
        if guess > 0.4 * fs or not len(near):
            break
        out.append(float(grid[near[np.argmax(spectrum[near])]]))
    return out


def _envelope(x: Floats, fs: float, freq: float, window: Floats, starts: NDArray[np.intp]) -> Complexes:
    shifted = x * np.exp(-2j * np.pi * freq / fs * np.arange(len(x)))
    return np.array([window @ shifted[s : s + len(window)] for s in starts])


def _slope(t: Floats, y: Floats, weight: Floats) -> float:
    return float(np.polynomial.polynomial.polyfit(t, y, 1, w=weight)[1])


@dataclass(frozen=True, slots=True)
class DialPoint:
    """One setting on one string of one instrument.

    Attributes
    ----------
    instrument, string, accuracy : names.
    errors : against ``reference``.
    seconds : of computing per second of sound.
    n_modes : stepped.
    """

    instrument: str
    string: str
    accuracy: str
    errors: PartialErrors
    seconds: float
    n_modes: int

    def to_dict(self) -> dict[str, object]:
        """Flat, for JSON."""
        plain = asdict(self)
        errors = plain.pop("errors")
        return {**plain, **errors}


def measure(instrument: Instrument, string: str, *, force: float = FORCE, nudge: bool = True) -> list[DialPoint]:
    """All settings on the open string of an instrument.

    Parameters
    ----------
    nudge : also what `reference` does for a thousandth more force: where that changes as much, contacts have made the
        motion chaotic, and no setting could do better.
    """
    options: dict[str, dict[str, Any]] = {name: {"accuracy": name} for name in LEVELS}
    if nudge:
        options[NUDGED] = {"accuracy": "reference", "force": 1.001 * force}
    return _rendered(instrument, string, options, "reference", force)


def _rendered(
    instrument: Instrument, string: str, options: Mapping[str, Mapping[str, Any]], truth: str, force: float
) -> list[DialPoint]:
    """A note rendered with each of some options, all held against one of them."""
    sounds, costs = {}, {}
    for label, given in options.items():
        own = dict(given)
        note = Note(0.0, DURATION, string=string, stop=0, force=own.pop("force", force))
        renderer = Renderer(Score([note]), instrument, FS, max_duration=DURATION, **own)
        sounds[label] = np.concatenate(list(renderer.blocks(4096)))[:, 0]
        summary = renderer.summary()
        costs[label] = (1 / summary.realtime_factor, summary.n_modes)
    freq = instrument.tuning.freq(instrument.open_note(string))
    skip = int(SETTLED * FS)
    return [
        DialPoint(
            instrument.spec.name, string, label, compare(sound[skip:], sounds[truth][skip:], FS, freq), *costs[label]
        )
        for label, sound in sounds.items()
    ]  # fmt: skip


def budgets(*, tell: Tell = silent) -> list[DialPoint]:
    """What effects cost and add: the steel-string guitar with all of them, with budgets, without."""
    instrument = Instrument.load("steel_guitar")
    options: dict[str, dict[str, Any]] = {"all": {"effects": "all"}}
    for cents, db in BUDGETS:
        named = f"auto, {cents:g} cents, {db:g} dB"
        options[named] = {"effects": "auto", "budget_cents": cents, "budget_db": db}
    options["none"] = {"effects": "none"}
    out = _rendered(instrument, middle_string(instrument), options, "all", 2 * FORCE)
    tell(1.0)
    return out


def run(*, quick: bool = False, tell: Tell = silent) -> list[DialPoint]:
    """Every shipped instrument, its middle string; in a quick run the guitar alone."""
    names: Sequence[str] = ["classical_guitar"] if quick else list(list_instruments())
    out: list[DialPoint] = []
    for done, name in enumerate(names, 1):
        instrument = Instrument.load(name)
        out += measure(instrument, middle_string(instrument), nudge=not quick)
        tell(done / len(names))
    return out


def section(points: Sequence[DialPoint]) -> str:
    """Markdown."""
    return f"{TEXT}\n\n{_table(points, '--accuracy', 'standard', 'reference')}\n\n{_within(points)}"


def _within(points: Sequence[DialPoint]) -> str:
    """Which instruments keep the limits with `standard`, and which do not."""
    inside: list[str] = []
    outside: dict[str, str] = {}
    for p in points:
        if p.accuracy != "standard":
            continue
        e = p.errors
        found = zip((e.cents, e.decay, e.level), LIMITS, (1, 100, 1), ("cents", "% of the decay", "dB"), strict=True)
        beyond = [f"{number(scale * v)} {unit}" for v, limit, scale, unit in found if v > limit]
        if beyond:
            outside[p.instrument] = ", ".join(beyond)
        else:
            inside.append(p.instrument)
    cents, decay, level = LIMITS
    text = (
        f"`standard` is within {cents:g} cent, {100 * decay:g} % of the decay and {level:g} dB of `reference` in the "
    )
    text += f"median of the partials on {', '.join(inside) or 'none'}"
    if not outside:
        return text + "."
    return f"{text}; not on {'; '.join(f'{name} ({told})' for name, told in outside.items())}."


def budget_section(points: Sequence[DialPoint]) -> str:
    """Markdown."""
    return f"{BUDGET_TEXT}\n\n{_table(points, '--effects', 'all', 'all')}"


def _table(points: Sequence[DialPoint], heading: str, unit: str, truth: str) -> str:
    """Rows of errors against `truth` and times in those of `unit`."""
    seconds = {p.instrument: p.seconds for p in points if p.accuracy == unit}
    rows = []
    for p in points:
        e = p.errors
        pairs = [(e.cents, e.cents_worst), (100 * e.decay, 100 * e.decay_worst), (e.level, e.level_worst)]
        told = ["" if p.accuracy == truth else f"{number(middle)} / {number(worst)}" for middle, worst in pairs]
        cost = [] if p.accuracy == NUDGED else [number(p.seconds, 3), number(p.seconds / seconds[p.instrument], 3)]
        rows.append([p.instrument, p.accuracy, str(p.n_modes), *told, *(cost or ["", ""])])
    heads = ["instrument", heading, "modes", "cents", "decay %", "level dB", "s per s", "time ratio"]
    return markdown(heads, rows, left=2)


def middle_string(instrument: Instrument) -> str:
    """Name of one in the middle."""
    names = list(instrument.string_names)
    return names[len(names) // 2]
