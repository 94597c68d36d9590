"""``tonewood plan``: which effects a render will run, when and why, and how long it will take."""

from __future__ import annotations

import json
from dataclasses import asdict
from typing import Annotated

import typer

from tonewood.cli.common import (
    BudgetCents,
    BudgetDb,
    EffectsChoice,
    InstrumentName,
    Json,
    Overrides,
    ScorePath,
    allow,
    chosen_effects,
    drops_told,
    load,
    progress,
    warn_of_dropped,
)


def plan(
    score: ScorePath,
    instrument: InstrumentName,
    fs: Annotated[int, typer.Option(help="sampling rate, Hz")] = 48000,
    tail: Annotated[float, typer.Option(help="longest ring after the last event, s")] = 10.0,
    max_duration: Annotated[float | None, typer.Option(help="hard end, s")] = None,
    outputs: Annotated[str | None, typer.Option(help="output groups, comma-separated; default: the first")] = None,
    effects: EffectsChoice = None,
    budget_db: BudgetDb = None,
    budget_cents: BudgetCents = None,
    settings: Overrides = None,
    as_json: Json = False,
) -> None:
    """Foresee the render of SCORE: effects that will run, when, why, and its cost."""
    from tonewood.output.plan import plan as foresee
    from tonewood.output.render import Tail
    from tonewood.score.midi import read_midi

    allow("--tail", tail, 0.0, 3600.0, "s")
    if max_duration is not None:
        allow("--max-duration", max_duration, 1e-3, 86400.0, "s")
    wanted = chosen_effects(effects, budget_db, budget_cents)
    bundle, notes = load(instrument, settings), read_midi(score)
    longest = max((n.time + n.duration for n in notes.notes), default=0.0) + tail
    bar = progress("sketching", longest if max_duration is None else min(longest, max_duration))
    with drops_told(), bar as advance:
        found = foresee(
            notes,
            bundle,
            fs,
            effects=wanted,
            budget_db=budget_db,
            budget_cents=budget_cents,
            outputs=[name.strip() for name in outputs.split(",")] if outputs else None,
            tail=Tail(cap=tail),
            max_duration=max_duration,
            progress=advance,
        )
    if as_json:
        report = {"schema": "tonewood-plan/1", "score": str(score), "instrument": bundle.name, "fs": fs}
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
