"""``tonewood render``: a MIDI file to a sound file."""

from __future__ import annotations

import math
import time
from contextlib import nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tonewood.cli import common
from tonewood.cli.commands import InterruptError
from tonewood.cli.options import takes_render_options
from tonewood.cli.stems import check_stem_folder, stem_files, stem_folder, write_output_stems, write_string_stems
from tonewood.errors import OutputError, TonewoodError
from tonewood.sound.render.options import RenderOptions
from tonewood.support.units import decibel

if TYPE_CHECKING:
    from collections.abc import Sequence

    from tonewood.cli.render_report import WrittenSound
    from tonewood.instrument.bundle.loading import Instrument
    from tonewood.performance.score.note import Score
    from tonewood.sound.ensemble.mix import EnsemblePart
    from tonewood.sound.files.tags import Tags
    from tonewood.sound.live.take import Replay
    from tonewood.sound.render.level import LevelName
    from tonewood.sound.render.renderer import Renderer


@takes_render_options(without=["energy"])
def render(
    score: common.ScorePath,
    output: Annotated[Path, typer.Option("-o", "--output", help="sound file: .wav, .flac, .rf64, .ogg or .mp3")],
    options: RenderOptions,
    instrument: common.OneInstrument = None,
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
    start: common.Start = 0.0,
    stop: common.Stop = None,
    transpose: common.Transpose = 0.0,
    tempo: common.Tempo = 1.0,
    tracks: common.Tracks = None,
    block: Annotated[int, typer.Option(help="frames written at a time; does not change the samples")] = 4096,
    subtype: common.Subtype = None,
    level: common.LevelOption = None,
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
    strings: common.StringSetName = None,
    settings: common.Overrides = None,
    allow_code: common.AllowCode = False,
    as_json: common.Json = False,
) -> None:
    """Render SCORE on an instrument to a sound file; without one, each part on the instrument of its program."""
    from tonewood.cli.render_report import print_summary, report
    from tonewood.sound.files.audio import check_rate_and_channels, file_format
    from tonewood.sound.render.energy import check_energy_file, save_energy
    from tonewood.sound.render.level import PEAK, level_name

    subtype = file_format(output, subtype)[1]
    check_rate_and_channels(output, options.fs)
    common.allow("--block", block, 1, 1 << 24, "frames")
    if normalize is not None:
        common.allow("--normalize", normalize, -200.0, 0.0, "dB")
        level = level or "peak"
    level_kind = level_name(level, gain_db=options.gain_db, limiter=limiter)
    if normalize is not None and level_kind != "peak":
        raise TonewoodError(f"sets the peak of --level peak; --level is {level_kind}", key="--normalize")
    if level_kind != "calibrated" and limiter:
        raise TonewoodError(f"the level {level_kind} leaves no peaks to limit; one of both is allowed", key="--limiter")
    if level_kind == "LUFS":
        common.need("batch", "pyloudnorm")
    accounts = energy or []
    for path in accounts:
        check_energy_file(path)
    form = _Form(output, subtype, block, level_kind, PEAK if normalize is None else normalize, limiter)
    keywords = common.reading(start, stop, transpose, tempo, tracks)
    if programs is not None and (instrument is not None or part or ensemble is not None):
        raise TonewoodError("is for a score without -i, --part and --ensemble", key="--programs")
    if instrument is None or part or ensemble is not None:
        one: dict[str, object] = {"--instrument": instrument, "--energy": energy, "--set": settings}
        one |= {"--strings": strings, "--limiter": limiter, "--live": live, "--allow-code": allow_code}
        one["--tracks"] = tracks if part or ensemble is not None else None
        _refuse(one)
        players, lines = _players(score, keywords, part or (), ensemble, programs)
        _render_parts(score, players, options, form, keywords, stems, lines, as_json)
        return
    split = _Stems(stems, stems_by)
    split.check(live=live, limiter=limiter)
    if live and keywords != common.reading(0.0, None, 0.0, 1.0, tracks):
        raise TonewoodError("repeats a take as it was: no excerpt, transposition, tempo", key="--live")
    began = time.perf_counter()
    bundle = common.load(instrument, settings, allow_code, strings)
    if options.preset is not None and "lead_in" not in options.model_fields_set and not live:
        options = options.at(lead_in="auto")  # a finished sound begins with the first finger on a string
    rendered = _render_one(score, bundle, options.at(energy=bool(accounts)), form, keywords, split, began, live=live)
    account = rendered.renderer.energy
    for path in accounts:
        if account is not None:
            save_energy(account, path)
    if as_json:
        common.print_json("render", report(rendered), ok=not rendered.silent)
    else:
        print_summary(rendered, accounts)
    if rendered.silent:
        raise typer.Exit(1)


@dataclass(frozen=True)
class _Form:
    """How a sound is written.

    output, subtype : the file, and its format of samples.
    block : frames written at a time.
    level, target : its level, and the peak of that, dBFS.
    limited : whether it goes through a limiter.
    """

    output: Path
    subtype: str
    block: int
    level: LevelName
    target: float
    limited: bool


@dataclass(frozen=True)
class _Stems:
    """Folder of the stems of one instrument, and by what they are split."""

    folder: Path | None
    by: str

    def check(self, *, live: bool, limiter: bool) -> None:
        """Refuse stems that cannot be made, before anything is rendered."""
        common.allow_word("--stems-by", self.by, ("output", "string"))
        if self.by == "string" and (self.folder is None or live or limiter):
            reason = "is for --stems without --live and --limiter, which strings have in common"
            raise TonewoodError(reason, key="--stems-by")
        if self.folder is not None:
            if not self.folder.parent.exists():
                raise TonewoodError(f"there is no folder {self.folder.parent}", key="--stems")
            check_stem_folder(self.folder)


def _refuse(options: dict[str, object]) -> None:
    """Refuse options of one instrument where parts choose theirs."""
    for option, value in options.items():
        if value:
            raise TonewoodError("is for one instrument, chosen by -i", key=option)


def _render_one(
    score: Path,
    bundle: Instrument,
    options: RenderOptions,
    form: _Form,
    keywords: dict[str, Any],
    stems: _Stems,
    began: float,
    *,
    live: bool,
) -> WrittenSound:
    """Render on one instrument, and write the file and its stems; loading began at a time."""
    from tonewood.performance.score.reading import read_score
    from tonewood.sound.files.tags import Tags
    from tonewood.sound.live.take import Replay
    from tonewood.sound.render.renderer import Renderer, assembled

    music: Score | None = None
    with common.dropped_notes_listed():
        renderer: Renderer | Replay
        if live:
            renderer = Replay(score, bundle, options=options, channels=keywords["tracks"])
        else:
            music = read_score(score, **keywords)
            renderer = Renderer(music, bundle, options=options)
    by_string = assembled(bundle, options, by_string=True) if stems.by == "string" else None
    outputs = (by_string or renderer.model).outputs
    files = [] if stems.folder is None else stem_files(stems.folder, [g.name for g in outputs], form.output)
    tags = Tags.of(music, [bundle])
    load_s = time.perf_counter() - began
    rendered = _write(renderer, form, tags)
    stems_clipped: dict[Path, int] = {}
    try:
        with nullcontext() if stems.folder is None else stem_folder(stems.folder):
            if by_string is not None:
                notes = read_score(score, **keywords)
                again = Renderer(notes, bundle, options=options.at(energy=False), model=by_string)
                frames = renderer.summary().frames
                stems_clipped = write_string_stems(again, files, form.subtype, rendered.gain_db, frames, tags)
            elif files:
                write_output_stems(form.output, files, form.subtype, renderer, tags)
    except KeyboardInterrupt:
        raise InterruptError(f"{form.output} is written, its stems are not") from None
    gain_db = rendered.gain_db + options.gain_db
    return replace(rendered, gain_db=gain_db, load_s=load_s, stems=files, stems_clipped=stems_clipped)


def _render_parts(
    score: Path,
    players: list[EnsemblePart],
    options: RenderOptions,
    form: _Form,
    keywords: dict[str, Any],
    stems: Path | None,
    lines: list[str] | None,
    as_json: bool,
) -> None:
    """Render each part on its instrument and mix them."""
    from tonewood.cli.ensemble import render_parts
    from tonewood.support.whole_files import AtomicFile

    AtomicFile(form.output).discard()  # parts are mixed before the file is begun: to know now that it can be
    if stems is not None:
        check_stem_folder(stems, parents=True)
    render_parts(
        score, players, form.output, options, reading={k: v for k, v in keywords.items() if k != "tracks"},
        subtype=form.subtype, level=form.level, target=form.target, stems=stems, as_json=as_json, left_out=lines,
    )  # fmt: skip


def _players(
    score: Path, keywords: dict[str, Any], parts: Sequence[str], ensemble: Path | None, programs: Path | None
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
    music = read_score(score, **keywords)
    return choose_players(music.parts, table, score)


def _write(renderer: Renderer | Replay, form: _Form, tags: Tags) -> WrittenSound:
    """Stream to the file; unless calibrated, through a scratch file of full precision beside it."""
    from tonewood.cli.render_report import WrittenSound
    from tonewood.sound.files.audio import SoundWriter, check_rate_and_channels
    from tonewood.sound.level.limiter import Limiter
    from tonewood.support.whole_files import AtomicFile, remove_leftovers

    output, channels, fs = form.output, len(renderer.channels), renderer.fs
    check_rate_and_channels(output, fs, channels)
    frames = math.ceil(renderer.expected_duration * fs)
    sound = renderer.blocks(form.block)
    limiter = Limiter(fs) if form.limited else None
    with common.progress("rendering", renderer.expected_duration) as advance:
        if form.level == "calibrated":
            remove_leftovers(output.with_suffix(".rf64"))  # of a scratch file
            with SoundWriter(output, fs, channels, form.subtype, frames=frames, tags=tags) as writer:
                for samples in sound if limiter is None else limiter.process(sound):
                    writer.write(samples)
                    advance(renderer.time)
            return WrittenSound(renderer, output, form.subtype, writer.clipped, writer.peak, form.level, 0.0, limiter)
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
            gain = form.target - decibel(writer.peak) if writer.peak > 0 else 0.0
            if form.level == "LUFS" and writer.peak > 0:
                gain = min(gain, _loudness_gain(scratch.path))
            factor = 10 ** (gain / 20)
            with (
                SoundWriter(output, fs, channels, form.subtype, frames=frames, tags=tags) as final,
                sf.SoundFile(scratch.path) as source,
            ):
                for samples in source.blocks(65536, dtype="float64", always_2d=True):
                    final.write(samples * factor)
        except OutputError as error:
            raise OutputError(error.reason, file=output) from None
        finally:
            scratch.discard()
        return WrittenSound(renderer, output, form.subtype, final.clipped, final.peak, form.level, gain, limiter)


def _loudness_gain(path: Path) -> float:
    """Gain (dB) that brings a sound file to `LOUDNESS`."""
    import soundfile as sf

    from tonewood.sound.render.level import LOUDNESS
    from tonewood.workshop.batch.stimuli import matching_gain_db

    samples, fs = sf.read(str(path), always_2d=True)
    return matching_gain_db(samples, fs, LOUDNESS)
