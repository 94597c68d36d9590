"""``tonewood results``: the answers of a listening test, opened and counted."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tonewood.cli.common import Json, need, print_json, warn

if TYPE_CHECKING:
    from tonewood.batch.results import Rate, RatingMean, Results


def results(
    table: Annotated[Path, typer.Argument(metavar="RESULTS", help="CSV file of webMUSHRA, of any test type")],
    key: Annotated[Path, typer.Option(help="key.json of the batch")],
    plot: Annotated[Path | None, typer.Option(help="PNG of the means; beside RESULTS by default")] = None,
    confidence: Annotated[float, typer.Option(help="of the intervals")] = 0.95,
    screening: Annotated[bool, typer.Option(help="leave listeners out after BS.1534-3")] = True,
    per_trial: Annotated[bool, typer.Option("--per-trial", help="list every trial too")] = False,
    as_json: Json = False,
) -> None:
    """Means, confidence intervals, post-screening and a plot of RESULTS."""
    need("batch", "matplotlib")
    from tonewood.batch.results import analyse, write_plot

    found = analyse(table, key, confidence=confidence, screening=screening)
    picture = plot or table.with_suffix(".png")
    write_plot(found, picture)
    if as_json:
        print_json("results", {**found.to_dict(), "plot": str(picture)})
        return
    _print(found, per_trial)
    print(f"plot: {picture}")


def _print(found: Results, per_trial: bool) -> None:
    for screened in found.screened:
        warn([f"{screened.listener} is left out: {screened.reason}"])
    warn(list(found.notes))
    counted = found.listeners - len(found.screened)
    print(
        f"{found.name}, {found.kind}: {counted} of {found.listeners} listeners, {100 * found.confidence:g} % intervals"
    )
    for row in found.overall:
        print("  " + _line(row))
    if per_trial:
        for row in found.per_trial:
            print(f"  {row.trial}: {_line(row)}")


def _line(row: RatingMean | Rate) -> str:
    from tonewood.batch.results import Rate

    if isinstance(row, Rate):
        share = "none decided" if row.rate is None else f"{100 * row.rate:.1f} % right{_interval(row, 100)}"
        chance = "" if row.p_value is None else f", p = {row.p_value:.3g}"
        return f"{row.label}: {row.correct} right, {row.incorrect} wrong, {row.undecided} undecided; {share}{chance}"
    return (
        f"{row.label}: {row.mean:.2f}{_interval(row, 1)}, median {row.median:.1f} "
        f"({row.lower_quartile:.1f} to {row.upper_quartile:.1f}), {row.ratings} ratings"
    )


def _interval(row: RatingMean | Rate, scale: float) -> str:
    if row.low is None or row.high is None:
        return ""
    return f" [{scale * row.low:.2f}, {scale * row.high:.2f}]"
