"""Playing a score on a sound card."""

from __future__ import annotations

from typing import Any

from tonewood.sound.files.inputs import InstrumentLike, ScoreLike
from tonewood.sound.level.limiter import Limiter
from tonewood.sound.live.stream import AudioStream, Playback
from tonewood.sound.render.options import RenderOptions
from tonewood.sound.render.renderer import Renderer

#: blocks rendered ahead of the sound card
_AHEAD = 8


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
    source : a score or the path of a score's file, played on `instrument`; or a renderer, which has an instrument and
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
    TypeError : a score without an instrument, or a renderer with one.
    """
    if isinstance(source, Renderer):
        if instrument is not None or fs is not None or options is not None or settings:
            raise TypeError("a renderer has its instrument and options already")
        renderer = source
    elif instrument is None:
        raise TypeError("a score is played on an instrument")
    else:
        renderer = Renderer(source, instrument, options=RenderOptions.of(options, fs, settings))
    blocks = renderer.blocks(block_size)
    sound = AudioStream(
        blocks if limiter is None else limiter.process(blocks),
        block_size,
        ahead=_AHEAD,
        fs=renderer.fs,
        n_channels=len(renderer.channels),
    )
    return sound.play(device, stream)
