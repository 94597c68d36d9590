"""``tonewood play``: a MIDI file to the sound card."""

from __future__ import annotations

from typing import Annotated

import typer

from tonewood.cli.common import (
    BudgetCents,
    BudgetDb,
    EffectsChoice,
    InstrumentName,
    Overrides,
    ScorePath,
    allow,
    chosen_effects,
    drops_told,
    load,
    warn,
    warn_of_dropped,
)


def play(
    score: ScorePath,
    instrument: InstrumentName,
    fs: Annotated[int, typer.Option(help="sampling rate, Hz")] = 48000,
    block: Annotated[int, typer.Option(help="frames per block")] = 1024,
    tail: Annotated[float, typer.Option(help="longest ring after the last event, s")] = 10.0,
    gain: Annotated[float, typer.Option(help="dB")] = 0.0,
    limiter: Annotated[bool, typer.Option("--limiter", help="hold peaks below -0.1 dBFS")] = False,
    outputs: Annotated[str | None, typer.Option(help="output groups, comma-separated; default: the first")] = None,
    channel_per_string: Annotated[bool, typer.Option(help="MIDI channel 1 plays the first string, and so on")] = False,
    device: Annotated[str | None, typer.Option(help="sound device, by name or number")] = None,
    effects: EffectsChoice = None,
    budget_db: BudgetDb = None,
    budget_cents: BudgetCents = None,
    settings: Overrides = None,
) -> None:
    """Play SCORE on an instrument."""
    from tonewood.output.limiter import Limiter
    from tonewood.output.play import play as play_renderer
    from tonewood.output.render import Renderer, Tail
    from tonewood.score.midi import read_midi

    allow("--block", block, 16, 1 << 16, "frames")
    allow("--tail", tail, 0.0, 3600.0, "s")
    allow("--gain", gain, -200.0, 200.0, "dB")
    wanted = chosen_effects(effects, budget_db, budget_cents)
    with drops_told():
        renderer = Renderer(
            read_midi(score),
            load(instrument, settings),
            fs,
            outputs=[name.strip() for name in outputs.split(",")] if outputs else None,
            tail=Tail(cap=tail),
            gain_db=gain,
            channel_per_string=channel_per_string,
            effects=wanted,
            budget_db=budget_db,
            budget_cents=budget_cents,
        )
    chosen = int(device) if device and device.isdecimal() else device
    hold = Limiter(fs) if limiter else None
    played = play_renderer(renderer, block_size=block, device=chosen, limiter=hold)
    summary = renderer.summary()
    warn(list(summary.warnings))
    warn_of_dropped(summary.notes_dropped)
    if played.clipped:
        warn([f"{played.clipped} samples were clipped; lower --gain or use --limiter"])
    print(f"played {played.frames / fs:.2f} s, {played.underruns} underruns; {summary.realtime_factor:.1f} x real time")
