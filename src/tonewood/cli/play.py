"""``tonewood play``: a MIDI file to the sound card."""

from __future__ import annotations

from typing import Annotated

import typer

from tonewood.cli.common import (
    AllowCode,
    InstrumentName,
    Overrides,
    ScorePath,
    StringSetName,
    allow,
    drops_told,
    load,
    warn,
    warn_of_dropped,
)
from tonewood.cli.options import takes_render_options
from tonewood.output.options import RenderOptions


@takes_render_options(without=["energy"])
def play(
    score: ScorePath,
    instrument: InstrumentName,
    options: RenderOptions,
    block: Annotated[int, typer.Option(help="frames per block")] = 1024,
    limiter: Annotated[bool, typer.Option("--limiter", help="hold peaks below -0.1 dBFS")] = False,
    device: Annotated[str | None, typer.Option(help="sound device, by name or number")] = None,
    strings: StringSetName = None,
    settings: Overrides = None,
    allow_code: AllowCode = False,
) -> None:
    """Play SCORE on an instrument."""
    from tonewood.output.limiter import Limiter
    from tonewood.output.play import play as play_renderer
    from tonewood.output.render import Renderer
    from tonewood.score.midi import read_midi

    allow("--block", block, 16, 1 << 16, "frames")
    with drops_told():
        renderer = Renderer(read_midi(score), load(instrument, settings, allow_code, strings), options=options)
    chosen = int(device) if device and device.isdecimal() else device
    hold = Limiter(options.fs) if limiter else None
    played = play_renderer(renderer, block_size=block, device=chosen, limiter=hold)
    summary = renderer.summary()
    warn(list(summary.warnings))
    warn_of_dropped(summary.notes_dropped)
    if played.clipped:
        warn([f"{played.clipped} samples were clipped; lower --gain or use --limiter"])
    seconds = played.frames / options.fs
    print(f"played {seconds:.2f} s, {played.underruns} underruns; {summary.realtime_factor:.1f} x real time")
