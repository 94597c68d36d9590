"""``tonewood play``: a MIDI file to the sound card."""

from __future__ import annotations

from dataclasses import asdict
from typing import Annotated

import typer

from tonewood.cli.common import (
    AllowCode,
    InstrumentName,
    Json,
    Overrides,
    ScorePath,
    allow,
    dropped_notes_listed,
    load,
    print_json,
    warn,
    warn_of_dropped,
)
from tonewood.cli.options import takes_render_options
from tonewood.output.options import RenderOptions
from tonewood.units import counted


@takes_render_options(without=["energy"])
def play(
    score: ScorePath,
    instrument: InstrumentName,
    options: RenderOptions,
    block: Annotated[int, typer.Option(help="frames per block")] = 1024,
    limiter: Annotated[bool, typer.Option("--limiter", help="hold peaks below -0.1 dBFS")] = False,
    device: Annotated[str | None, typer.Option(help="sound device, by name or number")] = None,
    settings: Overrides = None,
    allow_code: AllowCode = False,
    as_json: Json = False,
) -> None:
    """Play SCORE on an instrument."""
    from tonewood.output.limiter import Limiter
    from tonewood.output.play import play as play_renderer
    from tonewood.output.render import Renderer
    from tonewood.score.midi import read_midi

    allow("--block", block, 16, 1 << 16, "frames")
    with dropped_notes_listed():
        renderer = Renderer(read_midi(score), load(instrument, settings, allow_code), options=options)
    chosen = int(device) if device and device.isdecimal() else device
    hold = Limiter(options.fs) if limiter else None
    played = play_renderer(renderer, block_size=block, device=chosen, limiter=hold)
    summary = renderer.summary()
    seconds, warnings = played.frames / options.fs, list(summary.warnings)
    if played.clipped:
        warnings.append(f"{counted(played.clipped, 'sample')} clipped; lower --gain or use --limiter")
    if as_json:
        report = {"duration_s": seconds, "underruns": played.underruns, "clipped": played.clipped}
        dropped = [asdict(drop) for drop in summary.notes_dropped]
        print_json("play", {**report, "fs": options.fs, "notes_dropped": dropped, "warnings": warnings})
        return
    warn(warnings)
    warn_of_dropped(summary.notes_dropped)
    print(f"played {seconds:.2f} s, {played.underruns} underruns; {summary.realtime_factor:.1f} x real time")
