"""Scores to sound: `Renderer.blocks` streams, everything else stands on it."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from tonewood.engine.engine import GRID, Engine, Snapshot
from tonewood.engine.ledger import EffectReport
from tonewood.engine.playing import Performance, perform
from tonewood.errors import TonewoodError
from tonewood.instrument.assembly import FREQ_LIMIT, assemble
from tonewood.instrument.bundle import Instrument
from tonewood.numerics.energy_trace import EnergyTrace
from tonewood.output.accuracy import Decimator, accuracy_level
from tonewood.output.audio import Audio, decibels
from tonewood.score.note import Dropped, Score

Floats = NDArray[np.float64]

#: ticks of the control grid from one look at the tail to the next, whatever the blocks asked for
_TICKS = 8
#: frames at a time where nobody asks for any
_BLOCK = 4096
#: s over which the decayed tail is judged
_WINDOW = 0.2
FS_RANGE = (8000, 768000)


@dataclass(frozen=True, slots=True)
class Tail:
    """When a render ends after the last event.

    Attributes
    ----------
    level_db : the sound has decayed when a fifth of a second stays this far below the loudest sample.
    cap : s, longest tail.
    """

    level_db: float = -60.0
    cap: float = 10.0


DEFAULT_TAIL = Tail()


@dataclass(frozen=True, slots=True)
class Summary:
    """What a render did.

    Attributes
    ----------
    frames, fs, duration_s : length of what was rendered.
    render_s : seconds of computing, without import and load.
    realtime_factor : seconds of sound per second of computing.
    n_modes : modes that were stepped, at most at a time.
    notes : notes played.
    notes_dropped : what could not be played, and why.
    peak_dbfs : largest sample re full scale.
    end : why it ended: decayed, tail cap or maximum duration.
    warnings : one line each.
    effects : what ran and what was left out, one per effect and component.
    ignored : kind of MIDI message or controller that nothing was made of -> how many there were.
    """

    frames: int
    fs: int
    duration_s: float
    render_s: float
    realtime_factor: float
    n_modes: int
    notes: int
    notes_dropped: Sequence[Dropped]
    peak_dbfs: float
    end: str
    warnings: Sequence[str]
    effects: Sequence[EffectReport] = ()
    ignored: Mapping[str, int] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Checkpoint:
    """Snapshot of a renderer between two blocks."""

    engine: Snapshot
    held: Floats
    pending: Floats
    frames: int
    loudest: float
    recent: tuple[tuple[int, float], ...]
    end: str


class Renderer:
    """Streams a score on an instrument.

    Frame 0 is score time 0: what is needed before it (the ramp of a pluck that sounds at once) is computed and
    discarded. Samples do not depend on the block size, to the last bit.

    Parameters
    ----------
    score : notes and controllers.
    instrument : a loaded instrument.
    fs : sampling rate, Hz.
    accuracy : ``draft``, ``standard`` or ``reference``: settings of the engine's dials, see `output.accuracy`.
    precision : ``f64`` or ``f32`` (of states and coefficients); that of `accuracy` where left out.
    outputs : names of output groups; by default the instrument's first.
    tail : when to end after the last event.
    max_duration : s, hard end.
    gain_db : on all channels.
    channel_per_string : MIDI channel 1 plays the first string, and so on.
    effects : ``auto``, ``all``, ``none`` or names of effects that run; the bundle's choice where left out.
    budget_db, budget_cents : what leaving an effect out may cost; the bundle's where left out.
    energy : keep an account of energy, in `energy`; many times slower, with the same samples. Balances close to
        rounding in ``f64``.

    Raises
    ------
    TonewoodError : something cannot be played or is out of range; one line.
    """

    def __init__(
        self,
        score: Score,
        instrument: Instrument,
        fs: int = 48000,
        *,
        accuracy: str = "standard",
        precision: str | None = None,
        outputs: Sequence[str] | None = None,
        tail: Tail = DEFAULT_TAIL,
        max_duration: float | None = None,
        gain_db: float = 0.0,
        channel_per_string: bool = False,
        effects: str | Sequence[str] | None = None,
        budget_db: float | None = None,
        budget_cents: float | None = None,
        energy: bool = False,
    ):
        low, high = FS_RANGE
        if not low <= fs <= high:
            raise TonewoodError(f"is {fs} Hz; {low} to {high} are allowed", key="fs")
        level = accuracy_level(accuracy)
        precision = level.precision if precision is None else precision
        if precision not in ("f64", "f32"):
            raise TonewoodError(f"is {precision!r}; f64 or f32 are allowed", key="precision")
        if max_duration is not None and not max_duration > 0:
            raise TonewoodError(f"is {max_duration} s; more than 0 is allowed", key="max_duration")
        self.fs, self.tail, self.max_duration = int(fs), tail, max_duration
        # an instrument may need finer steps to be as accurate as others are
        finer = level.oversampling * (instrument.spec.oversampling if level.as_asked else 1)
        engine_fs = finer * self.fs
        limit = None if level.freq_limit is None else min(level.freq_limit, FREQ_LIMIT * engine_fs)
        chosen = with_effects(instrument, effects, budget_db, budget_cents)
        self.model = assemble(chosen, engine_fs, freq_limit=limit, outputs=outputs)
        self.performance: Performance = perform(score, self.model, channel_per_string=channel_per_string)
        self.engine = Engine(self.model, self.performance.timeline, precision=precision, energy=energy)
        if tail.level_db < self.model.choice.budget_db:
            self.engine.sleeper.tail = max(self.expected_duration - self.performance.timeline.stop, 0.0)
        groups = self.model.outputs
        columns = [i for group in groups for i in group.readouts]
        whole = columns == list(range(len(self.model.system.readouts)))
        self._columns: slice | list[int] = slice(None) if whole else columns
        gain = 10 ** (gain_db / 20)
        scales = [group.full_scale for group in groups for _ in group.channels]
        self._scale = gain / (scales[0] if len(set(scales)) == 1 else np.array(scales))
        self._decimator = Decimator(finer, len(columns))
        self._pending = np.zeros((0, len(columns)))
        self._frames, self._seconds, self._loudest = 0, 0.0, 0.0
        self._recent: list[tuple[int, float]] = []
        self._end = ""

    @property
    def channels(self) -> tuple[str, ...]:
        """Names of the output channels."""
        groups = self.model.outputs
        alone = len(groups) == 1
        return tuple(name if alone else f"{group.name}.{name}" for group in groups for name in group.channels)

    @property
    def energy(self) -> EnergyTrace | None:
        """Account of energy so far, an entry per 64 samples of the engine's rate; None if it was not asked for."""
        return None if self.engine.books is None else self.engine.books.trace()

    @property
    def expected_duration(self) -> float:
        """Upper bound of the length in s: last event plus the tail's cap."""
        longest = self.performance.timeline.stop + self.tail.cap
        return longest if self.max_duration is None else min(longest, self.max_duration)

    @property
    def time(self) -> float:
        """Score time reached, s."""
        return self.engine.state.sample / self.model.fs

    def blocks(self, block_size: int = 1024) -> Iterator[Floats]:
        """Yield (n, n_channels) arrays of `block_size` frames, the last one shorter, until the sound has ended.

        Raises
        ------
        NumericalError : the state is no longer finite; nothing of that block is yielded.
        """
        if block_size < 1:
            raise TonewoodError(f"is {block_size}; 1 or more is allowed", key="block_size")
        while True:
            while len(self._pending) < block_size and not self._end:
                self._fill(block_size - len(self._pending))
            if not len(self._pending):
                return
            block, self._pending = self._pending[:block_size], self._pending[block_size:]
            self._frames += len(block)
            yield block

    def summary(self) -> Summary:
        """What was done so far."""
        duration = self._frames / self.fs
        return Summary(
            frames=self._frames,
            fs=self.fs,
            duration_s=duration,
            render_s=self._seconds,
            realtime_factor=duration / self._seconds if self._seconds > 0 else 0.0,
            n_modes=self.model.n_modes,
            notes=len(self.performance.timeline.plays),
            notes_dropped=self.performance.dropped,
            peak_dbfs=decibels(self._loudest),
            end=self._end or "not ended",
            warnings=[*self.model.warnings, *self.performance.warnings],
            effects=self.engine.ledger.reports(),
            ignored=self.performance.ignored,
        )

    def snapshot(self) -> Checkpoint:
        """Copy of all that moves, to `restore` later in this renderer or another one made alike."""
        return Checkpoint(
            self.engine.snapshot(),
            self._decimator.held.copy(),
            self._pending.copy(),
            self._frames,
            self._loudest,
            tuple(self._recent),
            self._end,
        )

    def restore(self, checkpoint: Checkpoint) -> None:
        """Go back to a snapshot; what follows is the same to the last bit."""
        self.engine.restore(checkpoint.engine)
        self._decimator.held = checkpoint.held.copy()
        self._pending, self._frames = checkpoint.pending.copy(), checkpoint.frames
        self._loudest, self._recent, self._end = checkpoint.loudest, list(checkpoint.recent), checkpoint.end

    def _fill(self, frames: int) -> None:
        """Step on for some frames; one span after another from where the sound may be found to have ended."""
        factor, span = self._decimator.factor, _TICKS * GRID
        # the first frame that comes out of the decimator, which looks ahead
        first = self.engine.state.sample // factor - self._decimator.lead
        room = math.inf if self.max_duration is None else round(self.max_duration * self.fs) - max(first, 0)
        lively = int(self.performance.timeline.stop * self.model.fs) - self.engine.state.sample - span
        spans = max(1, min(math.ceil(min(frames, room) * factor / span), lively // span))
        began = time.perf_counter()
        sound = self._decimator(self.engine.advance(spans * _TICKS)[:, self._columns] * self._scale)
        self._seconds += time.perf_counter() - began
        sound = sound[max(0, -first) :]
        if len(sound) >= room:
            sound, self._end = sound[: int(room)], "maximum duration"
        self._pending = np.concatenate([self._pending, sound]) if len(self._pending) else sound
        self._watch(float(np.max(np.abs(sound), initial=0.0)))

    def _watch(self, peak: float) -> None:
        """Notice when the sound has decayed."""
        now = self.engine.state.sample // self._decimator.factor
        self._loudest = max(self._loudest, peak)
        self._recent.append((now, peak))
        since_end = self.time - self.performance.timeline.stop
        while len(self._recent) > 1 and self._recent[0][0] <= now - _WINDOW * self.fs - _TICKS * GRID:
            self._recent.pop(0)
        if self._end or not self.engine.done or since_end < _WINDOW:
            return
        if max(p for _, p in self._recent) <= self._loudest * 10 ** (self.tail.level_db / 20):
            self._end = "decayed"
        elif since_end >= self.tail.cap:
            self._end = "tail cap"


def with_effects(
    instrument: Instrument,
    effects: str | Sequence[str] | None,
    budget_db: float | None,
    budget_cents: float | None,
) -> Instrument:
    """Return the instrument with another choice of effects; None leaves a thing to the bundle.

    Raises
    ------
    TonewoodError : a name or a budget is not allowed; one line.
    """
    if isinstance(effects, str) and effects not in ("auto", "all", "none"):
        effects = [effects]
    given = {"mode": effects, "budget_db": budget_db, "budget_cents": budget_cents}
    changes = {
        f"effects.{key}": value if isinstance(value, (str, float, int)) else list(value)
        for key, value in given.items()
        if value is not None
    }
    return instrument.replace(changes)


def render(
    score: Score,
    instrument: Instrument,
    fs: int = 48000,
    *,
    accuracy: str = "standard",
    precision: str | None = None,
    outputs: Sequence[str] | None = None,
    tail: Tail = DEFAULT_TAIL,
    max_duration: float | None = None,
    gain_db: float = 0.0,
    channel_per_string: bool = False,
    effects: str | Sequence[str] | None = None,
    budget_db: float | None = None,
    budget_cents: float | None = None,
    energy: bool = False,
    progress: Callable[[float], None] | None = None,
) -> Audio:
    """Render a whole score in memory; see `Renderer` for the parameters.

    Parameters
    ----------
    progress : called with the score time reached (s) after every block.

    Returns
    -------
    The sound; with `energy` it carries the account of energy, too.
    """
    renderer = Renderer(
        score,
        instrument,
        fs,
        accuracy=accuracy,
        precision=precision,
        outputs=outputs,
        tail=tail,
        max_duration=max_duration,
        gain_db=gain_db,
        channel_per_string=channel_per_string,
        effects=effects,
        budget_db=budget_db,
        budget_cents=budget_cents,
        energy=energy,
    )
    blocks = []
    for block in renderer.blocks(_BLOCK):
        blocks.append(block)
        if progress is not None:
            progress(renderer.time)
    samples = np.concatenate(blocks) if blocks else np.zeros((0, len(renderer.channels)))
    return Audio(samples, renderer.fs, renderer.channels, renderer.energy)
