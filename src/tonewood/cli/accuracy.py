"""``tonewood accuracy``: error against computing time."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tonewood.cli.common import AllowCode, Json, Overrides, allow, allow_file, load, need, print_json, progress
from tonewood.errors import TonewoodError

if TYPE_CHECKING:
    from tonewood.instrument.bundle.loading import Instrument


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
    instrument: Annotated[
        str | None,
        typer.Option("-i", "--instrument", help="instead: the cheapest setting of this bundle that meets --target"),
    ] = None,
    target: Annotated[
        str | None, typer.Option("--target", help="with -i: 1cent, 5%decay, 0.5dB, -60dB, or several with commas")
    ] = None,
    notes: Annotated[
        str, typer.Option("--notes", metavar="STRING[:STOP],...", help="with -i; default: outer strings and the middle")
    ] = "",
    fs: Annotated[int, typer.Option("--fs", help="with -i: sampling rate of the sound, Hz")] = 48000,
    bandwidth: Annotated[
        float, typer.Option("--bandwidth", help="with -i: no setting is tried whose modes end below this, Hz")
    ] = 10e3,
    apply: Annotated[
        bool, typer.Option("--apply", help="with -i: print nothing but the options for `tonewood render`")
    ] = False,
    settings: Overrides = None,
    allow_code: AllowCode = False,
    plot: Annotated[
        Path | None, typer.Option("--plot", metavar="FILE.png", help="error against time, one quantity a row")
    ] = None,
    report: Annotated[
        Path | None,
        typer.Option("--report", metavar="FILE.html", help="a page, .html or .md; beside the latter FILE-tables.md"),
    ] = None,
    as_json: Json = False,
) -> None:
    """Compare error and time of this project with methods of the literature, and of each of its own settings."""
    allow_file("--plot", plot, ".png")
    allow_file("--report", report, ".html", ".md")
    if instrument is not None:
        if system is not None or quick or stability or report is not None:
            raise TonewoodError("--system, --quick, --stability and --report are of another comparison", key="-i")
        _target(load(instrument, settings, allow_code), target, notes, fs, bandwidth, apply, plot, as_json)
        return
    if target is not None or notes or apply or settings:
        raise TonewoodError("--target, --notes, --apply and --set need -i INSTRUMENT", key="-i")
    from tonewood.lab.accuracy import catalogue

    catalogue.selected(system)
    if stability:
        _stability(system, quick, plot, report, as_json)
        return
    html = report is not None and report.suffix.lower() != ".md"
    drawing = html or plot is not None
    if drawing:
        need(*(("report", "jinja2") if html else ("plot",)), "matplotlib")

    from tonewood.lab.accuracy import dial, tables, timing
    from tonewood.lab.accuracy.report import HEADLINE, SHORT, Study
    from tonewood.lab.accuracy.study import run
    from tonewood.support.whole_files import write_whole

    more: dict[str, tuple[str, object]] = {}
    with progress("comparing", 1.05) as advance:
        outcomes = list(run(system, quick=quick, tell=advance))
        if system is None:
            points = dial.run(quick=quick, tell=lambda share: advance(1 + 0.05 * share))
            more["dial"] = (dial.section(points), [p.to_dict() for p in points])
            budgets = dial.budgets(quick=quick)
            more["effects"] = (dial.budget_section(budgets), [p.to_dict() for p in budgets])
    study = Study(outcomes, timing.machine(), quick, more)
    png = b""
    if drawing:
        from tonewood.lab.accuracy.least_time import chart_png

        png = chart_png(outcomes)
    # everything is made before anything is written
    contents: list[tuple[Path, str | bytes]] = []
    if plot is not None:
        contents.append((plot, png))
    if report is not None and html:
        contents.append((report, study.html(png)))
    elif report is not None:
        seen = None if plot is None else Path(os.path.relpath(plot, report.absolute().parent)).as_posix()
        contents.append((report, study.markdown(seen)))
        contents.append((report.with_name(f"{report.stem}-tables.md"), study.tables()))
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


def _target(
    instrument: Instrument, target: str | None, notes: str, fs: int, bandwidth: float, apply: bool,
    plot: Path | None, as_json: bool,
) -> None:  # fmt: skip
    from tonewood.lab.accuracy.target import Target, search
    from tonewood.sound.render.options import RenderOptions, limits
    from tonewood.support.whole_files import write_whole

    if target is None:
        raise TonewoodError(
            "is missing; 1cent, 5%decay, 0.5dB, -60dB or several with commas are allowed", key="--target"
        )
    limit = Target.parse(target)
    options = RenderOptions.model_fields
    for key, value, field in (("--fs", fs, "fs"), ("--bandwidth", bandwidth, "freq_limit")):
        low, high = limits(options[field]) or (0.0, 0.0)
        allow(key, value, low, high, "Hz")
    if plot is not None:
        need("plot", "matplotlib")
    listed = [name for name in (word.strip() for word in notes.split(",")) if name]
    with progress("searching") as advance:
        frontier = search(instrument, limit, notes=listed, fs=fs, bandwidth=bandwidth, tell=advance)
    from tonewood.lab.accuracy import target_report

    if apply and frontier.cheapest is None:
        raise TonewoodError(f"no setting meets {target}; without --apply the nearest is named", key="--target")
    if plot is not None:
        write_whole(plot, target_report.chart_png(frontier))
    if as_json:
        print_json("accuracy-target", target_report.to_json(frontier))
    elif frontier.cheapest is not None and apply:
        print(frontier.cheapest.setting.words)
    else:
        print(target_report.summary(frontier))
        if plot is not None:
            print(plot)


def _stability(system: str | None, quick: bool, plot: Path | None, report: Path | None, as_json: bool) -> None:
    from tonewood.lab.accuracy import attacks, stability
    from tonewood.support.whole_files import write_whole

    if system is not None or plot is not None:
        raise TonewoodError(
            "has neither systems to choose nor charts; --json and --report are allowed", key="--stability"
        )
    if report is not None and report.suffix.lower() != ".md":
        raise TonewoodError(f"is {report.name!r}; with --stability a name ending in .md is allowed", key="--report")
    with progress("stability") as advance:
        grid = stability.run(quick, advance)
    if report is not None:
        write_whole(report, grid.markdown())
    if as_json:
        print_json("stability", grid.to_json())
        return
    print(f"{attacks.section(grid.attacks)}\n\n{grid.table()}", end="")
    if report is not None:
        print(report)
