"""``tonewood play``: a MIDI file to the sound card."""

from __future__ import annotations

from typing import Annotated

import typer

from tonewood.cli.common import InstrumentName, Overrides, ScorePath, load, warn


def play(
    score: ScorePath,
    instrument: InstrumentName,
    fs: Annotated[int, typer.Option(help="sampling rate, Hz")] = 48000,
    block: Annotated[int, typer.Option(help="frames per block")] = 1024,
    precision: Annotated[str, typer.Option(help="f64 or f32")] = "f64",
    gain: Annotated[float, typer.Option(help="dB")] = 0.0,
    device: Annotated[str | None, typer.Option(help="sound device, by name or number")] = None,
    settings: Overrides = None,
) -> None:
    """Play SCORE on an instrument."""
    from tonewood.output.play import play as play_renderer
    from tonewood.output.render import Renderer
    from tonewood.score.midi import read_midi

    renderer = Renderer(read_midi(score), load(instrument, settings), fs, precision=precision, gain_db=gain)
    chosen = int(device) if device and device.isdigit() else device
    played = play_renderer(renderer, block_size=block, device=chosen)
    warn(list(renderer.summary().warnings))
    for drop in renderer.summary().notes_dropped:
        warn([f"not played at {drop.time:.2f} s: {drop.reason}"])
    print(f"played {played.frames / fs:.2f} s, {played.underruns} underruns")
