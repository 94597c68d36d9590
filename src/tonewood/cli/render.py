"""``tonewood render``: a MIDI file to a sound file."""

from __future__ import annotations

import math
import time
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tonewood.cli.commands import InterruptError
from tonewood.cli.common import (
    AllowCode,
    Json,
    LevelOption,
    OneInstrument,
    Overrides,
    ScorePath,
    Start,
    Stop,
    StringSetName,
    Subtype,
    Tempo,
    Tracks,
    Transpose,
    allow,
    dropped_notes_listed,
    load,
    need,
    print_json,
    progress,
    reading,
    warn_of_dropped,
    warn_of_kinds,
)
from tonewood.cli.options import takes_render_options
from tonewood.errors import OutputError, TonewoodError
from tonewood.sound.render.options import RenderOptions
from tonewood.support.units import counted, decibel

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from tonewood.performance.effects.base import EffectReport
    from tonewood.performance.score.note import Score
    from tonewood.sound.ensemble.mix import EnsemblePart
    from tonewood.sound.files.tags import Tags
    from tonewood.sound.level.limiter import Limiter
    from tonewood.sound.live.take import Replay
    from tonewood.sound.render.level import LevelName
    from tonewood.sound.render.renderer import Renderer, Summary


@takes_render_options(without=["energy"])
def render(
    score: ScorePath,
    output: Annotated[Path, typer.Option("-o", "--output", help="sound file: .wav, .flac, .rf64, .ogg or .mp3")],
    options: RenderOptions,
    instrument: OneInstrument = None,
    part: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NUMBER=INSTRUMENT[@GAINdB][@panPAN]",
            help="render a part on an instrument and mix; may be given again, e.g. 2=electric_bass@-3dB@pan-0.3",
        ),
    ] = None,
    ensemble: Annotated[Path | None, typer.Option(help="YAML file of parts, in place of --part")] = None,
    programs: Annotated[
        Path | None,
        typer.Option(help="YAML table of programs and their instruments, for a SCORE without -i, --part, --ensemble"),
    ] = None,
    stems: Annotated[
        Path | None, typer.Option(help="folder for one file a part, or of one instrument one an output group")
    ] = None,
    stems_by: Annotated[
        str, typer.Option(metavar="WHAT", help="stems of one instrument by output, or by string: renders a second time")
    ] = "output",
    start: Start = 0.0,
    stop: Stop = None,
    transpose: Transpose = 0.0,
    tempo: Tempo = 1.0,
    tracks: Tracks = None,
    block: Annotated[int, typer.Option(help="frames written at a time; does not change the samples")] = 4096,
    subtype: Subtype = None,
    level: LevelOption = None,
    normalize: Annotated[float | None, typer.Option(help="level peak with this peak, dBFS, instead of -1")] = None,
    limiter: Annotated[
        bool, typer.Option("--limiter", help="hold peaks below -0.1 dBFS by a look-ahead limiter")
    ] = False,
    energy: Annotated[
        list[Path] | None,
        typer.Option(
            metavar="FILE",
            help="account of energy every 64 samples: .json, .csv or .png; may be given again; many times slower",
        ),
    ] = None,
    live: Annotated[
        bool, typer.Option("--live", help="play SCORE as it comes, as live: repeats a take of `play --record`")
    ] = False,
    strings: StringSetName = None,
    settings: Overrides = None,
    allow_code: AllowCode = False,
    as_json: Json = False,
) -> None:
    """Render SCORE on an instrument to a sound file; without one, each part on the instrument of its program."""
    began = time.perf_counter()
    from tonewood.cli.stems import check_stem_folder, stem_files, write_output_stems, write_string_stems
    from tonewood.performance.score.reading import read_score
    from tonewood.sound.files.audio import file_format
    from tonewood.sound.files.tags import Tags
    from tonewood.sound.level.limiter import Limiter
    from tonewood.sound.live.take import Replay
    from tonewood.sound.render.energy import check_energy_file, save_energy
    from tonewood.sound.render.level import PEAK, level_name, meaning
    from tonewood.sound.render.renderer import SILENT, Renderer, assembled

    fs = options.fs
    subtype = file_format(output, subtype)[1]
    allow("--block", block, 1, 1 << 24, "frames")
    if normalize is not None:
        allow("--normalize", normalize, -200.0, 0.0, "dB")
        level = level or "peak"
    wanted = level_name(level, gain_db=options.gain_db, limiter=limiter)
    if wanted != "calibrated" and limiter:
        raise TonewoodError(f"the level {wanted} leaves no peaks to limit; one of both is allowed", key="--limiter")
    if wanted == "LUFS":
        need("batch", "pyloudnorm")
    for path in energy or ():
        check_energy_file(path)
    given = reading(start, stop, transpose, tempo, tracks)
    target = PEAK if normalize is None else normalize
    if programs is not None and (instrument is not None or part or ensemble is not None):
        raise TonewoodError("is for a score without -i, --part and --ensemble", key="--programs")
    if instrument is None or part or ensemble is not None:
        used: dict[str, object] = {
            "--instrument": instrument,
            "--energy": energy,
            "--set": settings,
            "--strings": strings,
        }
        used |= {"--limiter": limiter, "--live": live, "--allow-code": allow_code}
        used["--tracks"] = tracks if part or ensemble is not None else None
        for option, value in used.items():
            if value:
                raise TonewoodError("is for one instrument, chosen by -i", key=option)
        players, left_out = _players(score, given, part or (), ensemble, programs)
        del given["tracks"]
        from tonewood.cli.ensemble import render_parts
        from tonewood.support.whole_files import AtomicFile

        AtomicFile(output).discard()  # parts are mixed before the file is begun: to know now that it can be
        if stems is not None:
            check_stem_folder(stems, parents=True)
        render_parts(
            score, players, output, options, reading=given, subtype=subtype, level=wanted, target=target,
            stems=stems, as_json=as_json, left_out=left_out,
        )  # fmt: skip
        return
    if stems_by not in ("output", "string"):
        raise TonewoodError(f"is {stems_by!r}; output, string are allowed", key="--stems-by")
    if stems_by == "string" and (stems is None or live or limiter):
        reason = "is for --stems without --live and --limiter, which strings have in common"
        raise TonewoodError(reason, key="--stems-by")
    if stems is not None and not stems.parent.exists():
        raise TonewoodError(f"there is no folder {stems.parent}", key="--stems")
    if stems is not None:
        check_stem_folder(stems)
    bundle = load(instrument, settings, allow_code, strings)
    music: Score | None = None
    with dropped_notes_listed():
        renderer: Renderer | Replay
        if live:
            if given != reading(0.0, None, 0.0, 1.0, tracks):
                raise TonewoodError("repeats a take as it was: no excerpt, transposition, tempo", key="--live")
            renderer = Replay(score, bundle, options=options.at(energy=bool(energy)), channels=given["tracks"])
        else:
            music = read_score(score, **given)
            renderer = Renderer(music, bundle, options=options.at(energy=bool(energy)))
    by_string = assembled(bundle, options, by_string=True) if stems_by == "string" else None
    files = [] if stems is None else stem_files(stems, [g.name for g in (by_string or renderer.model).outputs], output)
    loaded = time.perf_counter()
    hold = Limiter(fs) if limiter else None
    tags = Tags.of(music, [bundle])
    clipped, peak, gain = _write(renderer, output, subtype, block, wanted, target, hold, tags)
    try:
        if by_string is not None:
            again = Renderer(read_score(score, **given), bundle, options=options, model=by_string)
            write_string_stems(again, files, subtype, gain, renderer.summary().frames, tags)
        elif files:
            write_output_stems(output, files, subtype, renderer, tags)
    except KeyboardInterrupt:
        raise InterruptError(f"{output} is written, its stems are not") from None
    gain += options.gain_db
    account = renderer.energy
    for path in energy or ():
        if account is not None:
            save_energy(account, path)
    summary = renderer.summary()
    warnings = list(summary.warnings)
    if clipped:
        fate = "beyond full scale" if subtype.upper() in ("FLOAT", "DOUBLE") else "clipped"
        were = "sample was" if clipped == 1 else "samples were"
        warnings.append(f"{clipped} {were} {fate}; lower --gain, or use --level peak or --limiter")
    if hold is not None and hold.reduction_db > 0:
        warnings.append(f"the limiter took away up to {hold.reduction_db:.1f} dB")
    silent = summary.peak_dbfs <= decibel(SILENT) or peak < 0.5 * _STEPS.get(subtype.upper(), 0.0)
    if silent and summary.peak_dbfs > decibel(SILENT):
        warnings.append(f"{output} is silent: its peak of {decibel(peak):.0f} dBFS is below its smallest step")
    if as_json:
        report = _report(renderer, output, clipped, peak, loaded - began, warnings)
        print_json("render", report | {"level": wanted, "gain_db": gain}, ok=not silent)
        if silent:
            raise typer.Exit(1)
        return
    warn_of_kinds(warnings)
    warn_of_dropped(summary.notes_dropped)
    played, lost = summary.notes, len(summary.notes_dropped)
    print(
        f"{output}: {summary.duration_s:.2f} s, {counted(len(renderer.channels), 'channel')} at {fs} Hz, "
        f"peak {decibel(peak):.1f} dBFS; {counted(played, 'note')}, {lost} dropped; "
        f"{summary.realtime_factor:.1f} x real time; ended: {summary.end}"
    )
    print(f"  level {wanted}: {meaning(renderer.model.outputs, gain)}")
    if summary.room is not None:
        print(f"  room {summary.room}")
    if summary.ignored:
        print(f"  without effect: {', '.join(f'{n} {kind}' for kind, n in summary.ignored.items())}")
    for tension in summary.tensions:
        print(f"  {tension.line()}")
    if summary.zero_frame:
        print(f"  score time 0 is frame {summary.zero_frame}")
    if summary.onset_step_dbfs is not None:
        step = f"{summary.onset_step_dbfs:.0f} dBFS"
        print(f"  a step of {step} at the first frame was smoothed: sound before it was cut off (see --lead-in)")
    for line in _left_out(summary):
        print(line)
    for file in files:
        print(f"  {file}")
    if account is not None:
        print(
            f"  energy: peak {account.peak:.3g} J, balance open by {account.worst_residual:.1e} of it in an interval, "
            f"{account.worst_cumulative_residual:.1e} summed up: {', '.join(str(path) for path in energy or ())}"
        )
    if silent:
        raise typer.Exit(1)


def _players(
    score: Path, given: dict[str, Any], parts: Sequence[str], ensemble: Path | None, programs: Path | None
) -> tuple[list[EnsemblePart], list[str] | None]:
    """Parts and their instruments, from the command line, a file, or by their programs; then also lines to print."""
    from tonewood.performance.score.reading import read_score
    from tonewood.sound.ensemble.mix import parse_part, read_ensemble
    from tonewood.sound.ensemble.programs import choose_players, read_programs

    if parts and ensemble is not None:
        raise TonewoodError("one of --part and --ensemble is allowed", key="--ensemble")
    if parts or ensemble is not None:
        return ([parse_part(text) for text in parts] if ensemble is None else read_ensemble(ensemble)), None
    table = read_programs(programs)
    music = read_score(score, **given)
    return choose_players(music.parts, table, score)


def _write(
    renderer: Renderer | Replay,
    output: Path,
    subtype: str,
    block: int,
    level: LevelName,
    target: float,
    limiter: Limiter | None,
    tags: Tags,
) -> tuple[int, float, float]:
    """Stream to the file; unless calibrated, through a scratch file of full precision beside it.

    Returns
    -------
    clipped, peak : samples beyond full scale, and the largest one, of the file.
    gain : dB, of the level.
    """
    from tonewood.sound.files.audio import SoundWriter
    from tonewood.support.whole_files import AtomicFile, remove_leftovers

    channels, fs = len(renderer.channels), renderer.fs
    frames = math.ceil(renderer.expected_duration * fs)
    sound = renderer.blocks(block)
    with progress("rendering", renderer.expected_duration) as advance:
        if level == "calibrated":
            remove_leftovers(output.with_suffix(".rf64"))  # of a scratch file
            with SoundWriter(output, fs, channels, subtype, frames=frames, tags=tags) as writer:
                for samples in sound if limiter is None else limiter.process(sound):
                    writer.write(samples)
                    advance(renderer.time)
            return writer.clipped, writer.peak, 0.0
        import soundfile as sf

        try:
            scratch = AtomicFile(output.with_suffix(".rf64"))
        except OutputError as error:
            raise OutputError(error.reason, file=output) from None
        try:
            with SoundWriter(scratch, fs, channels, "DOUBLE", frames=frames) as writer:
                for samples in sound:
                    writer.write(samples)
                    advance(renderer.time)
            gain = target - decibel(writer.peak) if writer.peak > 0 else 0.0
            if level == "LUFS" and writer.peak > 0:
                gain = min(gain, _loudness_gain(scratch.path))
            factor = 10 ** (gain / 20)
            with (
                SoundWriter(output, fs, channels, subtype, frames=frames, tags=tags) as final,
                sf.SoundFile(scratch.path) as source,
            ):
                for samples in source.blocks(65536, dtype="float64", always_2d=True):
                    final.write(samples * factor)
        except OutputError as error:
            raise OutputError(error.reason, file=output) from None
        finally:
            scratch.discard()
        return final.clipped, final.peak, gain


def _loudness_gain(path: Path) -> float:
    """Gain (dB) that brings a sound file to `LOUDNESS`."""
    import soundfile as sf

    from tonewood.sound.render.level import LOUDNESS
    from tonewood.workshop.batch.stimuli import matching_gain_db

    samples, fs = sf.read(str(path), always_2d=True)
    return matching_gain_db(samples, fs, LOUDNESS)


#: smallest step of integers in a file
_STEPS = {"PCM_16": 2.0**-15, "PCM_24": 2.0**-23, "PCM_32": 2.0**-31}
#: strings that are named one by one; least share of the computing time that is reported
_NAMED, _LEAST_SHARE = 2, 0.02


def _left_out(summary: Summary) -> list[str]:
    """One line per effect that was left out for some time with a bound that is not 0; ``--json`` has all effects."""
    lines = []
    by_title: dict[str, list[EffectReport]] = {}
    for report in summary.effects:
        if report.bound is not None and report.bound != 0.0 and report.seconds_active < summary.duration_s:
            by_title.setdefault(report.title, []).append(report)
    for title, reports in by_title.items():
        seconds = [summary.duration_s - report.seconds_active for report in reports]
        if len(reports) <= _NAMED:
            where = " and ".join(f"{r.component} for {s:.2g} s" for r, s in zip(reports, seconds, strict=True))
        else:
            where = f"{len(reports)} strings for {min(seconds):.2g} to {max(seconds):.2g} s"
        bounds = [f"{max(values):.2g} {unit}" for values, unit in _bounds(reports)]
        lines.append(f"  Left out: {title} of {where}, at most {' and '.join(bounds)}.")
    saved = sum(report.seconds_saved for reports in by_title.values() for report in reports)
    whole = saved + summary.render_s
    if lines and saved >= _LEAST_SHARE * whole:
        lines[-1] += f" Saved {saved:.1f} s of {whole:.1f} s."
    return lines


def _bounds(reports: Sequence[EffectReport]) -> Iterator[tuple[list[float], str]]:
    """Bounds of one effect, of each unit."""
    unit = {"cents": "cent"}.get(reports[0].unit, reports[0].unit)
    for values, name in (([r.bound for r in reports], unit), ([r.bound_db for r in reports], "dB")):
        used = [value for value in values if value is not None]
        if used:
            yield used, name


def _report(
    renderer: Renderer | Replay, output: Path, clipped: int, peak: float, load_s: float, warnings: list[str]
) -> dict[str, Any]:
    s, account = renderer.summary(), renderer.energy
    return {
        "output": str(output),
        "outputs": [group.name for group in renderer.model.outputs],
        "fs": s.fs,
        "frames": s.frames,
        "channels": len(renderer.channels),
        "channel_names": list(renderer.channels),
        "duration_s": s.duration_s,
        "load_s": load_s,
        "render_s": s.render_s,
        "realtime_factor": s.realtime_factor,
        "n_modes": s.n_modes,
        "notes": s.notes,
        "notes_dropped": [
            {"time_s": d.time, "note": d.note, "channel": d.channel, "reason": d.reason} for d in s.notes_dropped
        ],
        "midi_ignored": dict(s.ignored),
        "peak_dbfs": decibel(peak) if peak > 0 else None,
        "clipped": clipped,
        "end": s.end,
        "tensions": [{**asdict(t), "cents": t.cents} for t in s.tensions],
        "zero_frame": s.zero_frame,
        "onset_step_dbfs": s.onset_step_dbfs,
        "room": s.room,
        "warnings": warnings,
        "energy": None if account is None else account.balance(),
        "effects": [asdict(e) for e in s.effects],
    }
