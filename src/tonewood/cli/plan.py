"""``tonewood plan``: which effects a render will run, when and why, and how long it will take."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tonewood.cli.common import (
    AllowCode,
    InstrumentName,
    Json,
    Overrides,
    ScorePath,
    Start,
    Stop,
    StringSetName,
    Subtype,
    Tempo,
    Tracks,
    Transpose,
    dropped_notes_listed,
    load,
    print_json,
    progress,
    reading,
    warn_of_dropped,
)
from tonewood.cli.options import takes_render_options
from tonewood.errors import OutputError
from tonewood.sound.render.options import RenderOptions

if TYPE_CHECKING:
    from tonewood.performance.effects.base import PlannedEffect
    from tonewood.sound.render.plan import Plan

#: least share of the computing time that is reported
_LEAST_SHARE = 0.02


@takes_render_options(without=["energy"])
def plan(
    score: ScorePath,
    instrument: InstrumentName,
    options: RenderOptions,
    strings: StringSetName = None,
    output: Annotated[
        Path | None,
        typer.Option(
            "-o", "--output", help="sound file of the render: its name and folder are checked, nothing is written"
        ),
    ] = None,
    subtype: Subtype = None,
    start: Start = 0.0,
    stop: Stop = None,
    transpose: Transpose = 0.0,
    tempo: Tempo = 1.0,
    tracks: Tracks = None,
    settings: Overrides = None,
    allow_code: AllowCode = False,
    as_json: Json = False,
    verbose: Annotated[
        bool, typer.Option("--verbose", help="every effect on every string, those that always run or never act, too")
    ] = False,
) -> None:
    """Predict the render of SCORE: effects that will run, when and why, and the time of computing."""
    from tonewood.performance.score.reading import read_score
    from tonewood.sound.files.audio import check_rate_and_channels, file_format
    from tonewood.sound.render.plan import plan as foresee

    if output is not None:
        file_format(output, subtype)
        check_rate_and_channels(output, options.fs)
        if not output.absolute().parent.is_dir():
            raise OutputError(f"there is no folder {str(output.parent)!r}", file=output)
    excerpt = reading(start, stop, transpose, tempo, tracks)
    bundle, notes = load(instrument, settings, allow_code, strings), read_score(score, **excerpt)
    longest = max((n.time + n.duration for n in notes.notes), default=0.0) + options.tail
    bar = progress("sketching", longest if options.max_duration is None else min(longest, options.max_duration))
    with dropped_notes_listed(), bar as advance:
        prediction = foresee(notes, bundle, options=options, progress=advance)
    if as_json:
        print_json("plan", {"score": str(score), "instrument": bundle.name, "fs": options.fs, **asdict(prediction)})
        return
    warn_of_dropped([drop for drop in prediction.notes_dropped if drop.time < prediction.duration_s])
    print(f"{prediction.duration_s:.2f} s of sound in about {prediction.predicted_s:.1f} s of computing")
    if prediction.sketched_s < prediction.duration_s:
        print(f"  only the first {prediction.sketched_s:.1f} s were looked at; the rest is taken to be like them")
    if prediction.bends:
        print(f"  strings are bent at {prediction.bends} points in time: {prediction.bends_s:.1f} s of it")
    if verbose:
        for effect in prediction.effects:
            shown = f"{effect.seconds:.2f} s{_when(effect)}{_cost([effect])}"
            print(f"  {effect.name} {effect.component}: {shown}: {effect.why}")
        return
    named: dict[str, list[PlannedEffect]] = {}
    for effect in prediction.effects:
        if matters(effect, prediction):
            named.setdefault(effect.name, []).append(effect)
    for name, effects in named.items():
        print(f"  {_line(name, effects)}")
    if rest := len(prediction.effects) - sum(map(len, named.values())):
        print(f"  {rest} more always run or never act: --verbose")


def matters(effect: PlannedEffect, whole: Plan) -> bool:
    """Whether an effect runs for a part of the sound, or takes a share of the computing that is worth a word."""
    costly = effect.predicted_s is not None and effect.predicted_s >= _LEAST_SHARE * whole.predicted_s
    return costly or 0.0 < effect.seconds < 0.999 * whole.duration_s


def _line(name: str, effects: Sequence[PlannedEffect]) -> str:
    """One effect on all its components, with the reason of the one on which it runs longest."""
    seconds = [effect.seconds for effect in effects]
    where = " and ".join(e.component for e in effects) if len(effects) <= 2 else f"{len(effects)} strings"
    low, high = min(seconds), max(seconds)
    span = f"{high:.2g} s" if f"{low:.2g}" == f"{high:.2g}" else f"{low:.2g} to {high:.2g} s"
    longest = max(effects, key=lambda effect: effect.seconds)
    return f"{name} of {where} for {span}{_cost(effects)}: {longest.why}"


def _when(effect: PlannedEffect) -> str:
    spans = ", ".join(f"{start:.2f}-{stop:.2f}" for start, stop in effect.spans_s[:3])
    more = len(effect.spans_s) - 3
    return f" [{spans}{f' and {more} more' if more > 0 else ''}]" if effect.spans_s else ""


def _cost(effects: Sequence[PlannedEffect]) -> str:
    predictions = [effect.predicted_s for effect in effects if effect.predicted_s is not None]
    return f" ({sum(predictions):.1f} s of computing)" if predictions else ""
