"""``tonewood results``: the answers of a listening test, opened and analysed."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tonewood.cli.common import Json, need, print_json, warn
from tonewood.errors import TonewoodError
from tonewood.support.text_files import json_value

if TYPE_CHECKING:
    from tonewood.workshop.listening.results import PageResults, PanelResults


def results(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="output folder of `tonewood batch`, with answers")],
    key: Annotated[Path | None, typer.Option(help="key of the batch, if it is not in DIR")] = None,
    output: Annotated[Path | None, typer.Option("-o", "--output", help="folder; DIR/results by default")] = None,
    confidence: Annotated[float, typer.Option(help="of the intervals")] = 0.95,
    screening: Annotated[bool, typer.Option(help="leave listeners out after BS.1534-3")] = True,
    answers: Annotated[
        list[Path] | None,
        typer.Option(help="table of answers given elsewhere: of webMUSHRA, or a plain CSV file; repeatable"),
    ] = None,
    as_json: Json = False,
) -> None:
    """Write the table of answers of DIR, means, models, sensitivities and thresholds, and a report with figures."""
    need("results", "jinja2", "matplotlib", "pyarrow")
    from tonewood.workshop.exchange.answers import joined, read_answers
    from tonewood.workshop.listening.definition import load_test
    from tonewood.workshop.listening.plain import methods, summary
    from tonewood.workshop.listening.report import write_report
    from tonewood.workshop.listening.results import FOLDER, analyse, write_tables

    others = joined([read_answers(path, test) for path in answers or () for test in [load_test(folder)]])
    analysis = analyse(
        folder,
        key=key,
        confidence=confidence,
        screening=screening,
        others=others.listeners,
        others_left_out=others.left_out,
    )
    target = output or folder / FOLDER
    write_tables(analysis, target)
    page = write_report(analysis, target, _facts(folder))
    if as_json:
        sentences = {"summary": summary(analysis), "methods": methods(analysis)}
        print_json("results", {**analysis.to_dict(), **sentences, "report": str(page)})
        return
    _print(analysis)
    print(f"{page}; answers.csv and answers.parquet have one row an answer")


def _facts(folder: Path) -> dict[str, Any] | None:
    """Facts of the stimuli, from the record of the batch if it was written. Raises TonewoodError : it is damaged."""
    path = folder / "manifest.json"
    if not path.exists():
        return None
    try:
        return _facts_of(json_value(path.read_text("utf-8-sig")))
    except (OSError, ValueError, RecursionError, AttributeError, LookupError, TypeError):
        raise TonewoodError("is not the record of a batch; `tonewood batch` writes it again", file=path) from None


def _facts_of(record: Any) -> dict[str, Any] | None:
    files = record["files"]
    names = {
        "length, s": [f["frames"] / f["fs"] for f in files],
        "loudness BS.1770, LUFS": [f["lufs"] for f in files],
        "loudest 400 ms, LUFS": [f["momentary_lufs"] for f in files],
        "true peak, dBTP": [f["true_peak_dbtp"] for f in files],
    }
    rows = [
        {"name": name, "low": min(values), "high": max(values)}
        for name, figures in names.items()
        if (values := [v for v in figures if v is not None])
    ]
    onset = record["manifest"].get("stimuli", {}).get("onset", {}).get("at", 0.010)
    return {"count": len(files), "fs": files[0]["fs"], "onset_ms": 1000 * onset, "rows": rows} if files else None


def _print(analysis: PanelResults) -> None:
    from tonewood.workshop.listening.plain import summary

    for page in analysis.pages:
        warn([f"{s.listener} is left out: {s.reason}" for s in page.screened])
    warn([f"{who} did not finish" for who in analysis.unfinished])
    warn([f"{who} did not pass the check of headphones" for who in analysis.not_passed])
    if analysis.withdrawn:
        warn([f"{analysis.withdrawn} withdrew; their answers were deleted"])
    warn([f"left out: {one.reason}" for one in analysis.left_out])
    if analysis.left_out:
        count = sum(one.answers for one in analysis.left_out)
        warn([f"{count} {'answer is' if count == 1 else 'answers are'} left out"])
    print(f"{analysis.test.manifest.name}: {analysis.who}, {100 * analysis.confidence:g} % intervals")
    for line in summary(analysis):
        print(f"  {line}")
    for page in analysis.pages:
        print(f"{page.page}. {page.heading} ({page.kind}, {page.listeners} listeners)")
        for line in _lines(page):
            print("   " + line)


def _lines(page: PageResults) -> list[str]:
    lines = []
    for mean in (*page.cells, *page.helpers):
        bounds = "" if mean.low is None else f" [{mean.low:.2f}, {mean.high:.2f}]"
        lines.append(f"{mean.label}: {mean.mean:.2f}{bounds}")
    if page.linear is not None:
        lines.append(f"{page.linear.formula}; {page.linear.method}")
        for term in page.linear.terms:
            lines.append(
                f"  {term.name}: {term.difference:+.2f} [{term.low:.2f}, {term.high:.2f}], "
                f"p by Holm = {term.p_holm:.3g}, d = {term.cohens_d:.2f}"
            )
        for test in page.linear.tests:
            lines.append(
                f"  {test.name}: F({test.df:.1f}, {test.df2 or 0:.1f}) = {test.statistic:.2f}, p = {test.p_value:.3g}"
            )
        lines += [f"  {note}" for note in page.linear.notes]
    for pair in page.ranks.pairs if page.ranks is not None else ():
        lines.append(
            f"ranks, {pair.factor}: {pair.second} over {pair.first}: r = {pair.r:.2f}, p by Holm = {pair.p_holm:.3g}"
        )
    for one in (*page.pairs, *(page.detections if len(page.detections) > len(page.pairs) else ())):
        cell = ", ".join(f"{k}={v}" for k, v in one.cell.items())
        if one.share is None:
            lines.append(f"{cell}: none decided")
            continue
        d = "" if one.d_prime is None else f", d' = {one.d_prime:.2f}"
        lines.append(
            f"{cell}: {one.right} of {one.answers} right, {100 * one.share:.1f} % "
            f"[{100 * (one.low or 0):.1f}, {100 * (one.high or 0):.1f}], p by Holm = {one.p_holm:.3g}{d}"
        )
    for value in page.scale:
        lines.append(f"{value.level}: {value.value:+.2f} [{value.low:.2f}, {value.high:.2f}] logits")
    if page.thresholds is not None:
        limits = page.thresholds
        low, high = ("\N{EN DASH}" if x is None else f"{x:.4g}" for x in (limits.low, limits.high))
        bounds = f" [{low}, {high}]" if len(limits.listeners) > 1 else ""
        lines.append(f"threshold {limits.mean:.4g}{bounds} {limits.unit}, at {100 * limits.share:.1f} % right")
    return lines
