"""Blocks computed ahead of a sound card by a thread of their own, and the time that takes."""

from __future__ import annotations

import queue
import threading
import time
import weakref
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

import numpy as np

from tonewood.errors import OutputError, TonewoodError
from tonewood.sound.live.instrument import Live
from tonewood.sound.render.renderer import Renderer
from tonewood.support.arrays import Floats

#: takes a block (n, n_channels) and the sampling rate in Hz, returns one of as many channels
Processor = Callable[[Floats, int], Floats]


T = TypeVar("T")
#: s, for which a message may wait for the next block; beyond that, blocks were not computed as they should be
PATIENCE = 0.05
#: instruments that streams play now
_STREAMED = weakref.WeakSet[Live]()
_STREAMED_LOCK = threading.Lock()


@dataclass(frozen=True, slots=True)
class Playback:
    """Summary of a playback.

    Attributes
    ----------
    frames : how many.
    underruns : times that no block was ready and the card got silence, or that the card reported a gap.
    clipped : samples beyond full scale.
    load : computing time of the blocks re their length, mean.
    worst_block_s : longest computing time of a block.
    late : underruns in which no block was ready; in the others blocks were, and the device or the system was late.
    """

    frames: int
    underruns: int
    clipped: int = 0
    load: float = 0.0
    worst_block_s: float = 0.0
    late: int = 0


class Arrivals(Generic[T]):
    """Messages that wait for the block that they come before.

    One that has just come is due at once. Where the oldest has waited for longer than `PATIENCE`, because sound had not
    begun or was interrupted, the messages that came until then keep their distances. Those that come later are taken at
    twice their pace until none waits any more: a stream that never pauses, such as a clock's, is in time again after
    twice the interruption.

    fs, block_size : Hz, frames per block.
    clock : s, of the times of arrival.
    """

    def __init__(self, fs: int, block_size: int, clock: Callable[[], float] = time.monotonic):
        self._fs, self._block_size, self._clock = fs, block_size, clock
        self._waiting: deque[tuple[float, T]] = deque()
        #: time of arrival and frame of the message that was late, and frames that it had waited; None where none is
        self._late: tuple[float, int, float] | None = None

    def add(self, time: float, message: T) -> None:
        """Add a message that came at a time, s; of several in their order."""
        self._waiting.append((time, message))

    def due(self, frame: int) -> Iterator[T]:
        """Yield the messages due before the block that begins at a frame."""
        if self._late is None and self._waiting and (waited := self._clock() - self._waiting[0][0]) > PATIENCE:
            self._late = self._waiting[0][0], frame, waited * self._fs
        while self._waiting:
            if self._late is not None:
                time, first, missed = self._late
                reached = frame - first + self._block_size
                if (self._waiting[0][0] - time) * self._fs >= reached + max(reached - missed, 0.0):
                    return
            yield self._waiting.popleft()[1]
        self._late = None

    def rest(self) -> Iterator[T]:
        """Yield all that wait."""
        while self._waiting:
            yield self._waiting.popleft()[1]


class AudioStream:
    """Computes blocks ahead of a sound card, in a thread, and gives them out in a callback.

    The thread takes the calls that `send` has left, asks the source for a block and passes it through the chain. The
    callback has the form that `sounddevice.OutputStream` asks for; it only copies a block that is ready, or counts an
    underrun and gives silence.

    Parameters
    ----------
    source : an instrument played live, a renderer, or any iterable of blocks (n, n_channels).
    block_size : frames per block.
    ahead : blocks that may be ready before they are needed, 1 or more: each adds its length to the latency, and lets a
        block take that much longer now and then.
    chain : processors, e.g. ``lambda block, fs: board(block.T, fs, reset=False).T`` for a pedalboard. One that holds
        samples back makes the stream later, not shorter.
    before : called in the thread before each block of an instrument played live: take its events there.
    fs, n_channels : of an iterable; a renderer and an instrument have their own.

    Attributes
    ----------
    fs, block_size, n_channels : Hz, frames, channels given out: one channel is given out twice.
    done : set when the source has ended and everything was given out.
    frames, underruns, clipped, late : so far, as of `Playback`.
    loads : computing time of the last blocks re their length.
    worst_block_s : longest computing time of a block, s.
    device_latency : s, of the sound card, as it says itself once it is open.
    """

    def __init__(
        self,
        source: Live | Renderer | Iterable[Floats],
        block_size: int = 128,
        *,
        ahead: int = 2,
        chain: Sequence[Processor] = (),
        before: Callable[[], None] | None = None,
        fs: int | None = None,
        n_channels: int | None = None,
    ):
        if not (isinstance(ahead, int | np.integer) and 1 <= ahead <= 4096):
            raise TonewoodError(f"is {ahead!r} blocks; 1 to 4096 are allowed", key="ahead")
        if not (isinstance(block_size, int | np.integer) and 1 <= block_size <= 1 << 20):
            raise TonewoodError(f"is {block_size!r} frames; 1 to {1 << 20} are allowed", key="block_size")
        is_ours = isinstance(source, Live | Renderer)
        if is_ours == (fs is not None or n_channels is not None):
            raise TypeError("fs and n_channels are given with an iterable of blocks, and only then")
        self.fs: int = source.fs if isinstance(source, Live | Renderer) else fs or 0
        channels = len(source.channels) if isinstance(source, Live | Renderer) else n_channels or 0
        self.block_size, self.ahead, self.n_channels = block_size, ahead, max(2, channels)
        self._before, self._chain = before, tuple(chain)
        self._played, self._source = source, self._blocks(source)
        self._calls = Arrivals[Callable[[], Any]](self.fs, block_size)
        self._ready: queue.Queue[Floats | None] = queue.Queue(maxsize=ahead)
        self.done, self._primed = threading.Event(), threading.Event()
        self._failed: list[Exception] = []
        #: whether the source's last block was given out
        self._ended = False
        self.frames = self.underruns = self.clipped = self.late = 0
        self._blocks_made, self._busy_s, self.worst_block_s = 0, 0.0, 0.0
        self.device_latency = 0.0
        self.loads: deque[float] = deque(maxlen=256)
        self._filler = threading.Thread(target=self._fill, daemon=True)

    def send(self, function: Callable[..., Any], *arguments: Any, **keywords: Any) -> None:
        """Call a function before the next block, in the thread that computes: ``send(live.note_on, "A2", 90)``.

        Calls that were sent before there was sound keep their distances.
        """
        self._calls.add(time.monotonic(), lambda: function(*arguments, **keywords))

    def close(self) -> None:
        """Stop computing, and wait for the thread."""
        self.done.set()
        while self._filler.is_alive():
            try:
                self._ready.get(timeout=0.05)
            except queue.Empty:
                continue

    def start(self) -> None:
        """Start computing, and wait until the queue is full, so that the stream does not begin with underruns.

        Raises
        ------
        TonewoodError : it was started before, or another stream plays this instrument.
        NumericalError, ... : as the source raised it.
        """
        if self._filler.ident is not None:
            raise TonewoodError("this stream was started before; each playing needs one of its own")
        if isinstance(self._played, Live):
            with _STREAMED_LOCK:
                if self._played in _STREAMED:
                    raise TonewoodError("this instrument is played by another stream; one at a time is allowed")
                _STREAMED.add(self._played)
        self._filler.start()
        self._primed.wait()
        if self._failed:
            raise self._failed[0]

    def __enter__(self) -> AudioStream:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def latency(self) -> float:
        """Longest time from an event to the block that it reaches, s: until the next block is computed, in the making,
        and until the blocks ahead of it have been given out.
        """
        return (self.ahead + 2) * self.block_size / self.fs

    def playback(self) -> Playback:
        """Return the summary so far; an error of the computing thread is raised here.

        Raises
        ------
        NumericalError, ... : as the source raised it.
        """
        if self._failed:
            raise self._failed[0]
        length = self._blocks_made * self.block_size / self.fs
        load = self._busy_s / length if length else 0.0
        return Playback(self.frames, self.underruns, self.clipped, load, self.worst_block_s, self.late)

    def play(
        self,
        device: Any = None,
        stream: Any = None,
        wait: Callable[[], bool] | None = None,
        *,
        low_latency: bool = False,
    ) -> Playback:
        """Play on a sound card until the source has ended.

        Parameters
        ----------
        device : as sounddevice names it; None is the default.
        stream : class with sounddevice's ``OutputStream`` interface, instead of that one.
        wait : called some 10 times per second; playing ends when it returns False.
        low_latency : ask the device for its lowest latency, in place of its safest.

        Raises
        ------
        OutputError : there is no PortAudio or no such device, or it has stopped by itself; in one line.
        """
        make, stopped = stream or _output_stream(), False
        try:
            self.start()
            with make(
                samplerate=self.fs, blocksize=self.block_size, channels=self.n_channels, dtype="float32",
                callback=self.callback, finished_callback=self.done.set, device=device,
                **({"latency": "low"} if low_latency else {}),
            ) as opened:  # fmt: skip
                self.device_latency = float(getattr(opened, "latency", 0.0))
                while not self.done.wait(0.1):
                    if wait is not None and not wait():
                        break
                stopped = self.done.is_set() and not self._ended
        finally:
            self.close()
        playback = self.playback()
        if stopped:
            raise OutputError(f"the sound device has stopped by itself, after {self.frames / self.fs:.1f} s")
        return playback

    def callback(self, out: Any, n: int, _time: Any = None, status: Any = None) -> None:
        """Fill `out`, (n, n_channels), with n frames of a block; a sound card's callback, `status` its flags.

        An error ends the stream; `playback` raises it.
        """
        try:
            ended = self._give(out, status)
        except Exception as error:
            self._failed.append(error)
            self.done.set()
            out[:] = 0.0
            raise
        if ended:
            self._ended = True
            self.done.set()
            raise _stop()

    def _give(self, out: Any, status: Any) -> bool:
        """Fill `out`; whether the source has ended."""
        if getattr(status, "output_underflow", False):
            self.underruns += 1
        try:
            block = self._ready.get_nowait()
        except queue.Empty:
            self.underruns, self.late = self.underruns + 1, self.late + 1
            out[:] = 0.0
            return False
        if block is None:
            out[:] = 0.0
            return True
        out[: len(block)] = block
        out[len(block) :] = 0.0
        self.frames += len(block)
        return False

    def _blocks(self, source: Live | Renderer | Iterable[Floats]) -> Iterator[Floats]:
        if isinstance(source, Renderer):
            yield from source.blocks(self.block_size)
        elif isinstance(source, Live):
            while True:
                if self._before is not None:
                    self._before()
                yield source.process(self.block_size)
        else:
            yield from source

    def _chained(self) -> Iterator[Floats]:
        """Yield blocks of `block_size` frames out of the chain, the last one shorter."""
        pending = np.zeros((0, 0))
        for block in self._source:
            for processor in self._chain:
                block = np.asarray(processor(block, self.fs), dtype=np.float64)
            if not len(pending) and len(block) == self.block_size:
                yield block
                continue
            pending = np.concatenate([pending, block]) if len(pending) else block
            while len(pending) >= self.block_size:
                yield pending[: self.block_size]
                pending = pending[self.block_size :]
        if len(pending):
            yield pending

    def _take_calls(self) -> None:
        for call in self._calls.due(self._blocks_made * self.block_size):
            call()

    def _fill(self) -> None:
        length = self.block_size / self.fs
        try:
            self._take_calls()
            began = time.perf_counter()
            for block in self._chained():
                self.clipped += int(np.count_nonzero(np.abs(block) > 1.0))
                shown = np.clip(np.repeat(block, 2, axis=1) if block.shape[1] == 1 else block, -1, 1)
                took = time.perf_counter() - began
                self._blocks_made, self._busy_s = self._blocks_made + 1, self._busy_s + took
                self.worst_block_s = max(self.worst_block_s, took)
                self.loads.append(took / length)
                self._ready.put(shown)
                if self._ready.full():
                    self._primed.set()
                if self.done.is_set():
                    return
                began = time.perf_counter()
                self._take_calls()
        except Exception as error:  # raised again in `playback`
            self._failed.append(error)
        finally:
            if isinstance(self._played, Live):
                _STREAMED.discard(self._played)
            self._primed.set()
            self._ready.put(None)


def _output_stream() -> Any:
    try:
        import sounddevice
    except ImportError:
        raise OutputError("playing needs sounddevice: pip install 'tonewood[play]'") from None
    except OSError:
        raise OutputError("playing needs the PortAudio library, which is not installed") from None

    @contextmanager
    def make(**options: Any) -> Iterator[Any]:
        try:
            opened = sounddevice.OutputStream(**options)
            opened.start()
        except (sounddevice.PortAudioError, ValueError) as error:
            reason = f"cannot open the sound device: {error}"
            if options.get("device") is None:
                reason += " (the usual one; --device names another, and `tonewood render` writes a file)"
            raise OutputError(reason) from None
        try:
            yield opened
        finally:
            opened.stop()
            opened.close()

    return make


def _stop() -> BaseException:
    try:
        import sounddevice
    except (ImportError, OSError):
        return StopIteration()
    stop: BaseException = sounddevice.CallbackStop()
    return stop
