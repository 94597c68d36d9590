"""From answers to results: the table, and for each page its means, models, sensitivities or thresholds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from tonewood.support.csv_text import csv_text
from tonewood.support.parquet import write_parquet
from tonewood.support.whole_files import write_whole
from tonewood.workshop.batch.pages import (
    AnyPage,
    Bs1116Page,
    HtmlPage,
    MushraPage,
    PairedPage,
    RatingPage,
    StaircasePage,
    localised,
)
from tonewood.workshop.listening.answer_file import LeftOut, ListenerAnswers, answers_of, withdrawn
from tonewood.workshop.listening.definition import ListeningError, ListeningTest, load_test
from tonewood.workshop.listening.detection import Detection, adjusted, detections, task_of
from tonewood.workshop.listening.means import CellMean, ScreenedListener, cell_means, screen, unique
from tonewood.workshop.listening.models import (
    END_SHARE,
    LinearAnalysis,
    RankAnalysis,
    ScaleValue,
    bradley_terry,
    linear_analysis,
    rank_analysis,
)
from tonewood.workshop.listening.ordinal import OrdinalAnalysis, ordinal_analysis
from tonewood.workshop.listening.shown import kind_of_texts
from tonewood.workshop.listening.table import COLUMNS, VERSUS, AnswerTable, read_key, tidy
from tonewood.workshop.listening.thresholds import Thresholds, thresholds

FOLDER = "results"


@dataclass(frozen=True)
class PageResults:
    """Results of one page, or of one scale of a page with several.

    heading : its title, and the scale.
    rows : answers that count, after screening.
    per_factor, cells, helpers : means by each factor, by all, and of hidden reference and anchors.
    pairs, detections, by_listener : discrimination of each pair over all other factors, by cell, and by cell and
        listener.
    everybody : the analyses with the listeners who were left out, if any were.
    ordinal : whether the scale's grades have an order only.
    odds : the cumulative logit model, where `ordinal` or many answers stand at an end of the scale.
    """

    page: int
    kind: str
    heading: str
    listeners: int
    factors: tuple[str, ...]
    rows: tuple[dict[str, Any], ...]
    screened: tuple[ScreenedListener, ...] = ()
    per_factor: tuple[CellMean, ...] = ()
    cells: tuple[CellMean, ...] = ()
    helpers: tuple[CellMean, ...] = ()
    linear: LinearAnalysis | None = None
    everybody: PageResults | None = None
    ordinal: bool = False
    odds: OrdinalAnalysis | None = None
    ranks: RankAnalysis | None = None
    pairs: tuple[Detection, ...] = ()
    detections: tuple[Detection, ...] = ()
    by_listener: tuple[Detection, ...] = ()
    scale: tuple[ScaleValue, ...] = ()
    thresholds: Thresholds | None = None

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready, without the rows."""
        everybody = None if self.everybody is None else replace(self.everybody, rows=())
        return {k: v for k, v in asdict(replace(self, rows=(), everybody=everybody)).items() if k != "rows"}


@dataclass(frozen=True)
class PanelResults:
    """Results of a test.

    left_out : answers that do not count because their files are damaged, or of another version of the test.
    not_passed : listeners whom the check of headphones stopped.
    withdrawn : number of listeners who had their answers deleted.
    """

    test: ListeningTest
    confidence: float
    table: AnswerTable
    listeners: int
    simulated: int
    unfinished: tuple[str, ...]
    left_out: tuple[LeftOut, ...]
    pages: tuple[PageResults, ...]
    not_passed: tuple[str, ...] = ()
    withdrawn: int = 0

    @property
    def who(self) -> str:
        """Number of listeners in words; those that are simulated are called so."""
        if self.simulated == self.listeners:
            return f"{self.listeners} simulated listeners"
        return f"{self.listeners} listeners" + (f", {self.simulated} of them simulated" if self.simulated else "")

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready."""
        keys = ("confidence", "listeners", "simulated", "unfinished", "not_passed", "withdrawn")
        return {
            "name": self.test.manifest.name,
            **{key: list(v) if isinstance(v := getattr(self, key), tuple) else v for key in keys},
            "left_out": [asdict(one) for one in self.left_out],
            "pages": [page.to_dict() for page in self.pages],
        }


def analyse(
    folder: Path,
    *,
    key: Path | None = None,
    confidence: float = 0.95,
    screening: bool = True,
    others: Sequence[ListenerAnswers] = (),
    others_left_out: Sequence[LeftOut] = (),
) -> PanelResults:
    """Read the answers in a batch's folder and work out the results.

    key : if it is not in the folder.
    screening : leave listeners out after BS.1534-3 (MUSHRA pages only).
    others, others_left_out : answers that were given elsewhere, and those of them that do not count.
    Raises ListeningError : a file cannot be read, something does not fit, or there are no answers.
    """
    if not 0.0 < confidence < 1.0:
        raise ListeningError(f"is {confidence:g}; a number between 0 and 1 is allowed", key="--confidence")
    test = load_test(folder)
    opened = read_key(key or folder / test.manifest.output.key)
    every = answers_of(test)
    answers = (*every.listeners, *others)
    if not any(one.records for one in answers):
        damaged = sum(one.answers for one in every.left_out)
        first = every.left_out[0].reason if every.left_out else ""
        why = f" that can be used; {damaged} are left out, the first because: {first}"
        raise ListeningError(f"holds no answers{why if damaged else ''}", file=folder / "answers")
    table = tidy(test, opened, answers)
    finish = max(number for number, page in enumerate(test.pages, start=1) if not isinstance(page, HtmlPage))
    not_passed = [one.listener for one in answers if one.failed]
    unfinished = [
        one.listener
        for one in every.listeners
        if not one.failed and (not one.records or one.records[-1]["page"] != finish)
    ]
    pages: list[PageResults] = []
    for index, page in enumerate(test.pages):
        rows = _in_order(table.of_page(index), table)
        if rows:
            pages += _page_results(test, index, page, rows, table, confidence, screening)
    began = [one for one in answers if one.records]
    simulated = sum(bool(one.header.get("simulated")) for one in began)
    return PanelResults(
        test, confidence, table, len(began), simulated, tuple(unfinished),
        (*every.left_out, *others_left_out), tuple(pages),
        tuple(not_passed), withdrawn(test),
    )  # fmt: skip


def _page_results(
    test: ListeningTest,
    index: int,
    page: AnyPage,
    rows: list[dict[str, Any]],
    table: AnswerTable,
    confidence: float,
    screening: bool,
) -> list[PageResults]:
    language = test.manifest.language
    heading = localised(page.name, language) or test.texts(language)[f"{kind_of_texts(page)}_title"]
    random = test.manifest.random
    base: dict[str, Any] = {"page": index + 1, "kind": page.type, "heading": heading}
    if isinstance(page, MushraPage):
        out = screen(rows) if screening else ()
        kept = [row for row in rows if row["listener"] not in {s.listener for s in out}]
        if not kept:
            raise ListeningError(f"page {index + 1}: no listener passes the screening; --no-screening keeps all")
        whole = _rated(base, rows, table, page, confidence, random, (0.0, 100.0)) if out else None
        rated = _rated(base, kept, table, page, confidence, random, (0.0, 100.0), out)
        return [replace(rated, everybody=whole)]
    if isinstance(page, Bs1116Page):
        return [_rated(base, _difference_grades(rows), table, page, confidence, random, (-4.0, 4.0))]
    if isinstance(page, RatingPage):
        labels = {scale.name: localised(scale.label, language) for scale in page.scales}
        ordinal = {scale.name for scale in page.scales if scale.ordinal}
        limits = {scale.name: (scale.low, scale.high) for scale in page.scales}
        return [
            _rated(
                {**base, "heading": f"{heading}: {labels[name]}", "ordinal": name in ordinal},
                [row for row in rows if row["item"] == name], table, page, confidence, random, limits[name],
            )
            for name in unique([row["item"] for row in rows])
        ]  # fmt: skip
    if isinstance(page, StaircasePage):
        unit = localised(page.unit, language)
        fit = thresholds(rows, page, unit, confidence)
        return [PageResults(**base, listeners=len(fit.listeners), factors=(), rows=tuple(rows), thresholds=fit)]
    counts: dict[str, Any] = {"listeners": _count(rows), "factors": _used(rows, table.factors), "rows": tuple(rows)}
    by = counts["factors"] or ("type",)
    if isinstance(page, PairedPage):
        decided = [row for row in rows if row["value"] is not None]
        cells = tuple(_share(mean) for mean in cell_means(decided, by, confidence))
        scale = bradley_terry(decided, next(iter(page.pairs)), confidence)
        return [PageResults(**base, **counts, cells=cells, scale=scale)]
    if (task := task_of(page)) is not None:
        pair = tuple(f for f in by if any(VERSUS in str(row.get(f)) for row in rows)) or by
        pairs, cells_of = (adjusted(detections(rows, names, task, confidence)) for names in (pair, by))
        by_listener = tuple(detections(rows, (*by, "listener"), task, confidence))
        return [PageResults(**base, **counts, pairs=pairs, detections=cells_of, by_listener=by_listener)]
    return []


def _share(mean: CellMean) -> CellMean:
    """The mean of shares, with bounds between 0 and 1."""
    if mean.low is None or mean.high is None:
        return mean
    return replace(mean, low=max(mean.low, 0.0), high=min(mean.high, 1.0))


def _rated(
    base: dict[str, Any],
    rows: list[dict[str, Any]],
    table: AnswerTable,
    page: AnyPage,
    confidence: float,
    random: Sequence[str],
    ends: tuple[float, float] | None,
    screened: tuple[ScreenedListener, ...] = (),
) -> PageResults:
    sounds = [row for row in rows if row["role"] in ("sound", "reference") and row["value"] is not None]
    reference = getattr(page, "reference", {})  # its factors are the question: they come first
    used = _used(sounds, sorted(table.factors, key=lambda factor: factor not in reference))
    by = used or ("type",)
    levels = levels_of(table, page)
    linear = linear_analysis(sounds, used, confidence, levels, random, ends)
    bent = base.get("ordinal", False) or (linear is not None and (linear.at_ends or 0.0) > END_SHARE)
    return PageResults(
        **base,
        listeners=_count(rows),
        factors=used,
        rows=tuple(rows),
        screened=screened,
        per_factor=tuple(mean for factor in used for mean in cell_means(sounds, (factor,), confidence)),
        cells=tuple(cell_means(sounds, by, confidence)),
        helpers=tuple(cell_means([row for row in rows if row["role"] != "sound"], ("role",), confidence)),
        linear=linear,
        odds=ordinal_analysis(sounds, used, confidence, levels, random, ends) if bent else None,
        ranks=rank_analysis(sounds, used, confidence),
    )


def _in_order(rows: list[dict[str, Any]], table: AnswerTable) -> list[dict[str, Any]]:
    """Answers by the levels heard, in the manifest's order; those to the same levels stay as they are."""

    def place(row: dict[str, Any]) -> list[int]:
        first = [(f, str(row[f]).partition(VERSUS)[0]) for f in table.factors if f in table.levels]
        return [table.levels[f].index(level) if level in table.levels[f] else -1 for f, level in first]

    return sorted(rows, key=place)


def levels_of(table: AnswerTable, page: AnyPage) -> dict[str, list[str]]:
    """Levels of each factor, that of the page's reference first."""
    reference: dict[str, str] = getattr(page, "reference", None) or {}
    return {f: sorted(levels, key=lambda level: level != reference.get(f)) for f, levels in table.levels.items()}


def _difference_grades(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """BS.1116: the sound's grade less that of the hidden reference, one row a trial."""
    hidden = {(r["listener"], r["index"]): r["value"] for r in rows if r["role"] == "reference"}
    return [
        {**row, "value": row["value"] - hidden[row["listener"], row["index"]]} for row in rows if row["role"] == "sound"
    ]


def _used(rows: Sequence[dict[str, Any]], factors: Sequence[str]) -> tuple[str, ...]:
    """Factors with several levels here, or with the two of a pair; repeats are no factor."""
    used = {f: {row[f] for row in rows} for f in factors if f != "repeat"}
    return tuple(f for f, levels in used.items() if len(levels) > 1 or any(VERSUS in str(x) for x in levels))


def _count(rows: Sequence[dict[str, Any]]) -> int:
    return len({row["listener"] for row in rows})


def write_tables(panel: PanelResults, folder: Path) -> None:
    """Write ``answers.csv``, the tidy table, and ``means.csv``, one row a mean, share or threshold; and as Parquet."""
    panel.table.write(folder / "answers.csv")
    write_parquet(folder / "answers.parquet", [*COLUMNS, *panel.table.factors], panel.table.rows)
    rows: list[dict[str, Any]] = []
    for page in panel.pages:
        head = {"page": page.page, "type": page.kind}
        cells = page.cells if len(page.factors) > 1 or not page.per_factor else ()
        for mean in (*page.per_factor, *cells, *page.helpers):
            rows.append({**head, "cell": mean.label, **_numbers(asdict(mean))})
        for one in (*page.detections, *page.by_listener):
            label = ", ".join(f"{k}={v}" for k, v in one.cell.items())
            rows.append({**head, "cell": label, **_numbers(asdict(one))})
        for value in page.scale:
            rows.append({**head, "cell": value.level, "mean": value.value, "low": value.low, "high": value.high})
        if page.thresholds is not None:
            for listener in page.thresholds.listeners:
                rows.append({**head, "cell": f"listener={listener.listener}", **_numbers(asdict(listener))})
    columns = list(dict.fromkeys(name for row in rows for name in row))
    write_whole(folder / "means.csv", csv_text(columns, rows), make_folder=True)
    write_parquet(folder / "means.parquet", columns, rows)


def _numbers(data: dict[str, Any]) -> dict[str, Any]:
    return {k: v for k, v in data.items() if k not in ("cell", "listener")}
