"""``tonewood plan``: which effects a render will run, when and why, and how long it will take."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from tonewood.cli.common import (
    AllowCode,
    InstrumentName,
    Json,
    Overrides,
    ScorePath,
    StringSetName,
    Subtype,
    dropped_notes_listed,
    load,
    print_json,
    progress,
    warn_of_dropped,
)
from tonewood.cli.options import takes_render_options
from tonewood.errors import OutputError
from tonewood.output.options import RenderOptions


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
    subtype: Subtype = "PCM_24",
    settings: Overrides = None,
    allow_code: AllowCode = False,
    as_json: Json = False,
) -> None:
    """Predict the render of SCORE: effects that will run, when and why, and the time of computing."""
    from tonewood.output.audio import file_format
    from tonewood.output.plan import plan as foresee
    from tonewood.score.midi import read_midi

    if output is not None:
        file_format(output, subtype)
        if not output.absolute().parent.is_dir():
            raise OutputError(f"there is no folder {str(output.parent)!r}", file=output)
    bundle, notes = load(instrument, settings, allow_code, strings), read_midi(score)
    longest = max((n.time + n.duration for n in notes.notes), default=0.0) + options.tail
    bar = progress("sketching", longest if options.max_duration is None else min(longest, options.max_duration))
    with dropped_notes_listed(), bar as advance:
        found = foresee(notes, bundle, options=options, progress=advance)
    if as_json:
        print_json("plan", {"score": str(score), "instrument": bundle.name, "fs": options.fs, **asdict(found)})
        return
    warn_of_dropped(found.notes_dropped)
    print(f"{found.duration_s:.2f} s of sound in about {found.predicted_s:.1f} s of computing")
    for effect in found.effects:
        spans = ", ".join(f"{start:.2f}-{stop:.2f}" for start, stop in effect.spans_s[:3])
        more = len(effect.spans_s) - 3
        when = f" [{spans}{f' and {more} more' if more > 0 else ''}]" if effect.spans_s else ""
        cost = f" ({effect.predicted_s:.1f} s of computing)" if effect.predicted_s is not None else ""
        print(f"  {effect.name} {effect.component}: {effect.seconds:.2f} s{when}{cost}: {effect.why}")
