"""``tonewood accuracy``: error against computing time."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer

from tonewood.cli.common import Json, need, print_json, progress
from tonewood.errors import OutputError, TonewoodError


def accuracy(
    system: Annotated[
        str | None, typer.Option("--system", metavar="NAME", help="one system; all of them if not given")
    ] = None,
    quick: Annotated[
        bool, typer.Option("--quick", help="fewer points and repeats: a minute on two idle cores")
    ] = False,
    stability: Annotated[
        bool,
        typer.Option("--stability", help="instead: which methods stay stable, by modes, pluck force and sampling rate"),
    ] = False,
    plot: Annotated[
        Path | None, typer.Option("--plot", metavar="FILE.png", help="Pareto charts, one per system")
    ] = None,
    report: Annotated[
        Path | None, typer.Option("--report", metavar="FILE.html", help="everything on one page, .html or .md")
    ] = None,
    as_json: Json = False,
) -> None:
    """Compare error and time of this project with methods of the literature, and of each of its own settings."""
    from tonewood.lab.accuracy import catalogue

    catalogue.selected(system)
    for path in (plot, report):
        if path is not None and not path.absolute().parent.is_dir():
            raise OutputError(f"there is no folder {str(path.parent)!r}", file=path)
    if plot is not None and plot.suffix.lower() != ".png":
        raise TonewoodError(f"is {plot.name!r}; a name ending in .png is allowed", key="--plot")
    if report is not None and report.suffix.lower() not in (".html", ".md"):
        raise TonewoodError(f"is {report.name!r}; a name ending in .html or .md is allowed", key="--report")
    if stability:
        _stability(system, quick, plot, report, as_json)
        return
    drawing = plot is not None or (report is not None and report.suffix.lower() == ".html")
    if drawing:
        need("plot", "matplotlib")

    from tonewood.lab.accuracy import dial, tables, timing
    from tonewood.lab.accuracy.report import HEADLINE, SHORT, Study
    from tonewood.whole_files import write_whole

    more: dict[str, tuple[str, object]] = {}
    with progress("comparing", 1.05) as advance:
        outcomes = list(catalogue.run(system, quick=quick, tell=advance))
        if system is None:
            points = dial.run(quick=quick, tell=lambda share: advance(1 + 0.05 * share))
            more["dial"] = (dial.section(points), [p.to_dict() for p in points])
            budgets = dial.budgets(quick=quick)
            more["effects"] = (dial.budget_section(budgets), [p.to_dict() for p in budgets])
    study = Study(outcomes, timing.machine(), quick, more)
    png = b""
    if drawing:
        from tonewood.lab.accuracy.picture import pareto_png

        png = pareto_png(outcomes)
    # everything is made before anything is written
    contents: list[tuple[Path, str | bytes]] = []
    if plot is not None:
        contents.append((plot, png))
    if report is not None and report.suffix.lower() == ".html":
        contents.append((report, study.html(png)))
    elif report is not None:
        seen = None if plot is None else Path(os.path.relpath(plot, report.absolute().parent)).as_posix()
        contents.append((report, study.markdown(seen)))
    for path, content in contents:
        write_whole(path, content)
    if as_json:
        print_json("accuracy", study.to_json())
        return
    print(study.machine_line)
    for outcome in outcomes:
        print(f"\n{tables.section(outcome)}", end="")
    if len(outcomes) > 1:
        print(f"\n{HEADLINE}\n\n{tables.headline_tables(outcomes)}")
    for text, _ in more.values():
        print(f"\n{text}")
    print(f"\n{SHORT}\n\n{tables.summary_table(outcomes)}")
    for path, _ in contents:
        print(path)


def _stability(system: str | None, quick: bool, plot: Path | None, report: Path | None, as_json: bool) -> None:
    from tonewood.lab.accuracy import stability
    from tonewood.whole_files import write_whole

    if system is not None or plot is not None:
        raise TonewoodError(
            "has neither systems to choose nor charts; --json and --report are allowed", key="--stability"
        )
    if report is not None and report.suffix.lower() != ".md":
        raise TonewoodError(f"is {report.name!r}; with --stability a name ending in .md is allowed", key="--report")
    with progress("stability", 1.0) as advance:
        grid = stability.run(quick, advance)
    if report is not None:
        write_whole(report, grid.markdown())
    if as_json:
        print_json("stability", grid.to_json())
        return
    print(grid.table(), end="")
    if report is not None:
        print(report)
