"""Playing the blocks of a renderer on a sound card."""

from __future__ import annotations

import queue
import threading
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tonewood.errors import OutputError
from tonewood.output.inputs import InstrumentLike, ScoreLike
from tonewood.output.limiter import Limiter
from tonewood.output.options import RenderOptions
from tonewood.output.render import Renderer

Floats = NDArray[np.float64]

#: blocks rendered ahead of the sound card
_AHEAD = 8


@dataclass(frozen=True, slots=True)
class Playback:
    """Summary of a playback.

    Attributes
    ----------
    frames : how many.
    underruns : times that no block was ready and the card got silence, or that the card reported a gap.
    clipped : samples beyond full scale.
    """

    frames: int
    underruns: int
    clipped: int = 0


def play(
    source: Renderer | ScoreLike,
    instrument: InstrumentLike | None = None,
    fs: float | None = None,
    *,
    options: RenderOptions | None = None,
    block_size: int = 1024,
    device: Any = None,
    stream: Any = None,
    limiter: Limiter | None = None,
    **settings: Any,
) -> Playback:
    """Play a score on an instrument, or a renderer to its end.

    Parameters
    ----------
    source : a score or the path of a MIDI file, played on `instrument`; or a renderer, which has an instrument and
        options already. Its channels become the device's; one channel is played on both sides.
    instrument : an instrument, or its name or folder.
    fs, options : as for `Renderer`, single options as keywords too.
    block_size : frames per block.
    device : as sounddevice names it; None is the default.
    stream : class with sounddevice's ``OutputStream`` interface, instead of that one.
    limiter : holds peaks below full scale; without it they are clipped.

    Raises
    ------
    OutputError : there is no PortAudio or no such device, in one line.
    """
    if isinstance(source, Renderer):
        if instrument is not None or fs is not None or options is not None or settings:
            raise TypeError("a renderer has its instrument and options already")
        renderer = source
    elif instrument is None:
        raise TypeError("a score is played on an instrument")
    else:
        renderer = Renderer(source, instrument, options=RenderOptions.of(options, fs, settings))
    make = stream or _output_stream()
    n_channels = max(2, len(renderer.channels))
    blocks: queue.Queue[Floats | None] = queue.Queue(maxsize=_AHEAD)
    done, primed = threading.Event(), threading.Event()
    failed: list[Exception] = []
    frames = underruns = clipped = 0

    def fill() -> None:
        nonlocal clipped
        try:
            source = renderer.blocks(block_size)
            for block in source if limiter is None else limiter.process(source):
                clipped += int(np.count_nonzero(np.abs(block) > 1.0))
                blocks.put(np.clip(np.repeat(block, 2, axis=1) if block.shape[1] == 1 else block, -1, 1))
                if blocks.full():
                    primed.set()
                if done.is_set():
                    return
        except Exception as error:  # re-raised in the caller's thread
            failed.append(error)
        finally:
            primed.set()
            blocks.put(None)

    def callback(out: Any, n: int, _time: Any, status: Any) -> None:
        nonlocal frames, underruns
        if getattr(status, "output_underflow", False):
            underruns += 1
        try:
            block = blocks.get_nowait()
        except queue.Empty:
            underruns += 1
            out[:] = 0.0
            return
        if block is None:
            done.set()
            out[:] = 0.0
            raise _stop()
        out[: len(block)] = block
        out[len(block) :] = 0.0
        frames += len(block)

    filler = threading.Thread(target=fill, daemon=True)
    filler.start()
    try:
        # the stream starts when the queue is full, so that it does not begin with underruns
        primed.wait()
        with make(
            samplerate=renderer.fs, blocksize=block_size, channels=n_channels, dtype="float32",
            callback=callback, finished_callback=done.set, device=device,
        ):  # fmt: skip
            while not done.wait(0.1):
                pass
    finally:
        done.set()
        while filler.is_alive():
            try:
                blocks.get(timeout=0.05)
            except queue.Empty:
                continue
    if failed:
        raise failed[0]
    return Playback(frames, underruns, clipped)


def _output_stream() -> Any:
    try:
        import sounddevice
    except ImportError:
        raise OutputError("playing needs sounddevice: pip install 'tonewood[play]'") from None
    except OSError:
        raise OutputError("playing needs the PortAudio library, which is not installed") from None

    def make(**options: Any) -> Any:
        try:
            return sounddevice.OutputStream(**options)
        except (sounddevice.PortAudioError, ValueError) as error:
            raise OutputError(f"cannot open the sound device: {error}") from None

    return make


def _stop() -> BaseException:
    try:
        import sounddevice
    except (ImportError, OSError):
        return StopIteration()
    stop: BaseException = sounddevice.CallbackStop()
    return stop
