"""``tonewood play``: a score to the sound card, or an instrument played live."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from tonewood.cli import common
from tonewood.cli.options import takes_render_options
from tonewood.errors import TonewoodError
from tonewood.sound.render.options import RenderOptions
from tonewood.support.units import counted


@takes_render_options(without=["energy"])
def play(
    instrument: common.InstrumentName,
    options: RenderOptions,
    score: Annotated[Path | None, typer.Argument(help="score to play; none where it is played live")] = None,
    midi_in: Annotated[
        str | None,
        typer.Option("--midi-in", metavar="[PORT]", help="play live from a MIDI input; the first one, or PORT"),
    ] = None,
    keyboard: Annotated[bool, typer.Option("--keyboard", help="play live with the computer's keys")] = False,
    record: Annotated[
        Path | None, typer.Option(help="MIDI file of the live playing; `render --live` repeats it")
    ] = None,
    ramp: Annotated[float, typer.Option(help="longest preparation of a live pluck, ms: part of the latency")] = 5.0,
    spacing: Annotated[
        int, typer.Option(help="control intervals (64 steps) between beginnings of live notes that come together")
    ] = 2,
    ahead: Annotated[int, typer.Option(help="blocks computed ahead when played live: part of the latency")] = 4,
    duration: Annotated[float | None, typer.Option(help="end a live session after so many seconds")] = None,
    start: common.Start = 0.0,
    stop: common.Stop = None,
    transpose: common.Transpose = 0.0,
    tempo: common.Tempo = 1.0,
    tracks: common.Tracks = None,
    block: Annotated[int | None, typer.Option(help="frames per block; 1024, live 128")] = None,
    level: common.LevelOption = None,
    limiter: Annotated[bool, typer.Option("--limiter", help="hold peaks below -0.1 dBFS")] = False,
    device: Annotated[str | None, typer.Option(help="sound device, by name or number")] = None,
    strings: common.StringSetName = None,
    settings: common.Overrides = None,
    allow_code: common.AllowCode = False,
    as_json: common.Json = False,
) -> None:
    """Play SCORE on an instrument, or the instrument live from a MIDI input or the computer's keys."""
    from tonewood.performance.score.reading import read_score
    from tonewood.sound.level.limiter import Limiter
    from tonewood.sound.live.play import play as play_renderer
    from tonewood.sound.render.level import level_name, meaning, preview_gain
    from tonewood.sound.render.renderer import Renderer

    if block is not None:
        common.allow("--block", block, 16, 1 << 16, "frames")
    chosen = int(device) if device and device.isdecimal() else device
    if midi_in is not None or keyboard:
        if score is not None:
            raise TonewoodError(f"{score} is not played where the instrument is played live; one of both is allowed")
        if limiter or level not in (None, "calibrated", "peak"):
            raise TonewoodError(
                "a look-ahead limiter or a loudness needs the future; --gain is allowed live", key="--level"
            )
        common.allow("--ahead", ahead, 1, 64, "blocks")
        common.allow("--ramp", ramp, 1.0, 100.0, "ms")
        from tonewood.cli.live import play_live

        play_live(
            common.load(instrument, settings, allow_code, strings),
            options,
            port=midi_in,
            keyboard=keyboard,
            record=record,
            block_size=block or 128,
            ahead=ahead,
            ramp=1e-3 * ramp,
            spacing=spacing,
            duration=duration,
            device=chosen,
            channels=common.reading(start, stop, transpose, tempo, tracks)["tracks"],
            calibrated=level == "calibrated" or bool(options.gain_db),
            as_json=as_json,
        )
        return
    if score is None:
        raise TonewoodError("there is no SCORE; without one give --midi-in or --keyboard to play live")
    if record is not None:
        raise TonewoodError("records live playing; with a SCORE there is nothing to record", key="--record")
    keywords = common.reading(start, stop, transpose, tempo, tracks)
    level_kind, notes = level_name(level, gain_db=options.gain_db, limiter=limiter), read_score(score, **keywords)
    if level_kind == "LUFS":
        raise TonewoodError("the loudness of live playing is not known before; calibrated or peak", key="--level")
    with common.dropped_notes_listed():
        bundle = common.load(instrument, settings, allow_code, strings)
        if level_kind == "peak":
            options = options.at(gain_db=preview_gain(notes, bundle, options))
        renderer = Renderer(notes, bundle, options=options)
    hold = Limiter(options.fs) if limiter or level_kind == "peak" else None
    played = play_renderer(renderer, block_size=block or 1024, device=chosen, limiter=hold)
    summary = renderer.summary()
    seconds, warnings = played.frames / options.fs, list(summary.warnings)
    if played.clipped:
        warnings.append(f"{counted(played.clipped, 'sample')} clipped; lower --gain or use --limiter")
    if as_json:
        level_of = {"level": level_kind, "gain_db": options.gain_db}
        report = {"duration_s": seconds, "underruns": played.underruns, "clipped": played.clipped}
        dropped = [asdict(drop) for drop in summary.notes_dropped]
        common.print_json(
            "play", {**report, **level_of, "fs": options.fs, "notes_dropped": dropped, "warnings": warnings}
        )
        return
    common.warn_of_kinds(warnings)
    common.warn_of_dropped(summary.notes_dropped)
    print(f"played {seconds:.2f} s, {played.underruns} underruns; {summary.realtime_factor:.1f} x real time")
    print(f"  level {level_kind}: {meaning(renderer.model.outputs, options.gain_db)}")
