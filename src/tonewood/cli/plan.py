"""``tonewood plan``: which effects a render will run, when and why, and how long it will take."""

from __future__ import annotations

import json
from dataclasses import asdict

from tonewood.cli.common import (
    AllowCode,
    InstrumentName,
    Json,
    Overrides,
    ScorePath,
    StringSetName,
    drops_told,
    load,
    progress,
    warn_of_dropped,
)
from tonewood.cli.options import takes_render_options
from tonewood.output.options import RenderOptions


@takes_render_options(without=["energy", "gain_db"])
def plan(
    score: ScorePath,
    instrument: InstrumentName,
    options: RenderOptions,
    strings: StringSetName = None,
    settings: Overrides = None,
    allow_code: AllowCode = False,
    as_json: Json = False,
) -> None:
    """Predict the render of SCORE: effects that will run, when and why, and the time of computing."""
    from tonewood.output.plan import plan as foresee
    from tonewood.score.midi import read_midi

    bundle, notes = load(instrument, settings, allow_code, strings), read_midi(score)
    longest = max((n.time + n.duration for n in notes.notes), default=0.0) + options.tail
    bar = progress("sketching", longest if options.max_duration is None else min(longest, options.max_duration))
    with drops_told(), bar as advance:
        found = foresee(notes, bundle, options=options, progress=advance)
    if as_json:
        report = {"schema": "tonewood-plan/1", "score": str(score), "instrument": bundle.name, "fs": options.fs}
        print(json.dumps({**report, **asdict(found)}, allow_nan=False))
        return
    warn_of_dropped(found.notes_dropped)
    print(f"{found.duration_s:.2f} s of sound in about {found.predicted_s:.1f} s of computing")
    for effect in found.effects:
        spans = ", ".join(f"{start:.2f}-{stop:.2f}" for start, stop in effect.spans_s[:3])
        more = len(effect.spans_s) - 3
        when = f" [{spans}{f' and {more} more' if more > 0 else ''}]" if effect.spans_s else ""
        cost = f" ({effect.predicted_s:.1f} s of computing)" if effect.predicted_s is not None else ""
        print(f"  {effect.name} {effect.component}: {effect.seconds:.2f} s{when}{cost}: {effect.why}")
