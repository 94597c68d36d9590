"""``tonewood play``: a MIDI file to the sound card."""

from __future__ import annotations

from dataclasses import asdict
from typing import Annotated

import typer

from tonewood.cli.common import (
    AllowCode,
    InstrumentName,
    Json,
    LevelOption,
    Overrides,
    ScorePath,
    StringSetName,
    allow,
    dropped_notes_listed,
    load,
    print_json,
    warn,
    warn_of_dropped,
)
from tonewood.cli.options import takes_render_options
from tonewood.errors import TonewoodError
from tonewood.output.options import RenderOptions
from tonewood.units import counted


@takes_render_options(without=["energy"])
def play(
    score: ScorePath,
    instrument: InstrumentName,
    options: RenderOptions,
    block: Annotated[int, typer.Option(help="frames per block")] = 1024,
    level: LevelOption = None,
    limiter: Annotated[bool, typer.Option("--limiter", help="hold peaks below -0.1 dBFS")] = False,
    device: Annotated[str | None, typer.Option(help="sound device, by name or number")] = None,
    strings: StringSetName = None,
    settings: Overrides = None,
    allow_code: AllowCode = False,
    as_json: Json = False,
) -> None:
    """Play SCORE on an instrument."""
    from tonewood.output.level import level_name, meaning, preview_gain
    from tonewood.output.limiter import Limiter
    from tonewood.output.play import play as play_renderer
    from tonewood.output.render import Renderer
    from tonewood.score.midi import read_midi

    allow("--block", block, 16, 1 << 16, "frames")
    wanted, notes = level_name(level, gain_db=options.gain_db, limiter=limiter), read_midi(score)
    if wanted == "LUFS":
        raise TonewoodError("the loudness of what is played is not known before; calibrated or peak", key="--level")
    with dropped_notes_listed():
        bundle = load(instrument, settings, allow_code, strings)
        if wanted == "peak":
            options = options.at(gain_db=preview_gain(notes, bundle, options))
        renderer = Renderer(notes, bundle, options=options)
    chosen = int(device) if device and device.isdecimal() else device
    hold = Limiter(options.fs) if limiter or wanted == "peak" else None
    played = play_renderer(renderer, block_size=block, device=chosen, limiter=hold)
    summary = renderer.summary()
    seconds, warnings = played.frames / options.fs, list(summary.warnings)
    if played.clipped:
        warnings.append(f"{counted(played.clipped, 'sample')} clipped; lower --gain or use --limiter")
    if as_json:
        level_of = {"level": wanted, "gain_db": options.gain_db}
        report = {"duration_s": seconds, "underruns": played.underruns, "clipped": played.clipped}
        dropped = [asdict(drop) for drop in summary.notes_dropped]
        print_json("play", {**report, **level_of, "fs": options.fs, "notes_dropped": dropped, "warnings": warnings})
        return
    warn(warnings)
    warn_of_dropped(summary.notes_dropped)
    print(f"played {seconds:.2f} s, {played.underruns} underruns; {summary.realtime_factor:.1f} x real time")
    print(f"  level {wanted}: {meaning(renderer.model.outputs, options.gain_db)}")
