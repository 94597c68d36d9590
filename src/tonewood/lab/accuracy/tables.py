"""Results of a study, as tables in Markdown and as JSON."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence

from tonewood.lab.accuracy.outcome import (
    MEASURES,
    PITCH,
    WAVEFORM,
    Headline,
    Measure,
    Outcome,
    Point,
    front,
    line,
    usual,
)
from tonewood.lab.methods import METHODS
from tonewood.lab.tables import markdown, number, table

#: methods of the short table, and their headings there
IN_SHORT = {
    "ab3": "Adams-Bashforth 3",
    "verlet": "velocity Verlet",
    "newmark": "Newmark",
    "p1": "P1",
    "superposition": "superposition",
}
#: worst pitch error to partial 20 that was expected on the guitar of Fabre et al. at 48 kHz, cents
EXPECTED_CENTS = 0.01


def summary_table(outcomes: Sequence[Outcome]) -> str:
    """A row per system: our error and time at 48 kHz, and the time of some methods at the same waveform error.

    A method that does not get there is reported with its smallest error, with the time it takes for that over our time.
    """
    rows = []
    for o in outcomes:
        measure = WAVEFORM if WAVEFORM in o.measures else o.measures[0]
        ours = usual(o.points, measure)
        if ours is None:
            continue
        unit = "" if measure is WAVEFORM else " cents"
        pitch = number(PITCH.of(ours))
        reached = {h.method: h for h in o.headlines[measure.name]}
        cells = [_reached(o, reached[method], ours, unit) if method in reached else "" for method in IN_SHORT]
        waveform = number(WAVEFORM.of(ours))
        rows.append([f"`{o.name}`", pitch, waveform, number(ours.seconds), *cells])
    heads = ["system", "cents, worst", "waveform", "s per s", *(IN_SHORT[m] for m in IN_SHORT)]
    return markdown(heads, rows)


def _reached(outcome: Outcome, h: Headline, ours: Point, unit: str) -> str:
    if h.ratio is not None:
        return f"{h.ratio:.2g} x"
    if h.best is None:
        return h.text
    cost = front(line(outcome.points, h.method, MEASURES[h.measure]))[-1][0]
    return f"{number(h.best)}{unit} at {cost / ours.seconds:.2g} x"


def headline_tables(outcomes: Sequence[Outcome]) -> str:
    """Time of every method at our error at 48 kHz, over our time: a table per measure, a column per system."""
    return "\n\n".join(
        headline_table(outcomes, m)
        for m in MEASURES.values()
        if any(o.headlines.get(m.name) for o in outcomes)
    )  # fmt: skip


def headline_table(outcomes: Sequence[Outcome], measure: Measure) -> str:
    """One of them."""
    columns = [o for o in outcomes if o.headlines.get(measure.name)]
    cells = [{h.method: h.text for h in o.headlines[measure.name]} for o in columns]
    methods = dict.fromkeys(method for column in cells for method in column)
    rows = [[METHODS[method].title, *(column.get(method, "") for column in cells)] for method in methods]
    rows.append(["error there", *(number(o.headlines[measure.name][0].error) for o in columns)])
    return f"By the {measure.title}:\n\n" + markdown(["method", *(o.name for o in columns)], rows)


def method_table(outcome: Outcome) -> str:
    """One system: time ratio at equal error by every measure, and the least error of each method."""
    names = [name for name, entry in outcome.headlines.items() if entry]
    if not names:
        return "Nothing to compare with in a quick run."
    rows = []
    for entries in zip(*(outcome.headlines[name] for name in names), strict=True):
        row = [METHODS[entries[0].method].title]
        for entry in entries:
            at_best = "" if entry.best is None else "not reached by ours"
            row += [entry.text, number(entry.best), number(entry.ratio_at_best, 3) or at_best]
        rows.append(row)
    heads = ["method"]
    for name in names:
        error = outcome.headlines[name][0].error
        heads += [f"{name}: time ratio at {number(error)}", "its best", "time ratio there"]
    return markdown(heads, rows)


def headline(outcome: Outcome) -> str:
    """One sentence per measure."""
    lines = []
    for name, best_of in outcome.headlines.items():
        ours = usual(outcome.points, MEASURES[name])
        if ours is None or not best_of:
            continue
        others = [h for h in best_of if h.method != "held_position"]
        reached = [f"{METHODS[h.method].title} {h.ratio:.3g}" for h in others if h.ratio is not None]
        never = [METHODS[h.method].title for h in others if h.ratio is None and h.best is not None]
        lost = [METHODS[h.method].title for h in others if h.best is None and h.stable]
        unstable = [METHODS[h.method].title for h in others if h.best is None and not h.stable]
        clauses = [
            f"times as long: {', '.join(reached)}" * bool(reached),
            f"not reached: {', '.join(never)}" * bool(never),
            f"partials lost: {', '.join(lost)}" * bool(lost),
            f"not stable: {', '.join(unstable)}" * bool(unstable),
        ]
        lines.append(
            f"- **{name}**: tonewood at {ours.value} has {number(MEASURES[name].of(ours))} ({MEASURES[name].title}) "
            f"for {number(ours.seconds)} s per second of sound. At that error, {'; '.join(filter(None, clauses))}."
        )
    return "\n".join(lines)


def expectation(outcome: Outcome) -> str:
    """Compare expectations of the guitar of Fabre et al. at 48 kHz and of Adams-Bashforth 3 with results."""
    ours = usual(outcome.points, PITCH)
    if ours is None:
        return ""
    verdict = "confirmed" if ours.cents_20 < EXPECTED_CENTS else "refuted"

    def lowest(method: str) -> str:
        stable = [p for p in outcome.points if p.method == method and p.stable == "stable"]
        least = min(stable, key=lambda p: p.fs, default=None)
        if least is None:
            return "at none of its rates"
        return f"from {least.fs / 1e3:.4g} kHz (decay rates {number(100 * least.decay_median)} % off there)"

    return (
        f"**Expected** of {outcome.title}: below {EXPECTED_CENTS} cent up to partial 20 at 48 kHz, where "
        "Adams-Bashforth 3 needs about 800 kHz to be stable at all. "
        f"**Measured:** {number(ours.cents_20)} cent at {ours.value}, {verdict}. "
        f"Adams-Bashforth 3 is stable {lowest('ab3')} with the same modes and {lowest('ab3_paper')} with the 150 "
        "string modes of the paper."
    )


def _spread(p: Point) -> str:
    if not math.isfinite(p.seconds):
        return ""
    return f"{number(p.seconds, 3)} ({number(p.seconds_low, 3)}-{number(p.seconds_high, 3)})"


#: heading -> cell
COLUMNS: Mapping[str, Callable[[Point], str]] = {
    "method": lambda p: METHODS[p.method].title,
    "dial": lambda p: p.value,
    "modes": lambda p: str(p.n_modes),
    "motion": lambda p: p.stable,
    "cents, median": lambda p: number(p.cents_median),
    "worst": lambda p: number(p.cents_worst),
    "to partial 20": lambda p: number(p.cents_20),
    "partials lost": lambda p: str(p.lost) if p.lost else "",
    "decay %, median": lambda p: number(100 * p.decay_median),
    "worst %": lambda p: number(100 * p.decay_worst),
    "waveform": lambda p: number(p.waveform),
    "spectrum, dB": lambda p: number(p.spectral_db),
    "spurious, dB": lambda p: "" if not math.isfinite(p.spurious_db) else f"{p.spurious_db:.0f}",
    "energy drift": lambda p: number(p.energy),
    "s per s": _spread,
}


def point_table(outcome: Outcome) -> str:
    """Every point of one system; columns that nothing is known of are left out."""
    ours = usual(outcome.points, outcome.measures[0])

    def ratio(p: Point) -> str:
        return "" if ours is None or not math.isfinite(p.seconds) else number(p.seconds / ours.seconds, 3)

    columns = {k: cell for k, cell in COLUMNS.items() if any(cell(p) for p in outcome.points)} | {"ratio": ratio}
    return table(outcome.points, columns, left=2)


def section(outcome: Outcome) -> str:
    """Heading, headline and tables of one system."""
    return (
        f"## {outcome.title} (`{outcome.name}`)\n\nReference: {outcome.truth}.\n\n{headline(outcome)}\n\n"
        f"{method_table(outcome)}\n\n{point_table(outcome)}\n"
    )


def to_json(outcome: Outcome) -> dict[str, object]:
    """Ready for `json.dumps`."""
    return {
        "name": outcome.name,
        "title": outcome.title,
        "reference": outcome.truth,
        "points": [p.to_dict() for p in outcome.points],
        "headline": [
            {
                "method": h.method,
                "measure": h.measure,
                "error": h.error,
                "time_ratio": h.ratio,
                "best_error": h.best,
                "time_ratio_at_best": h.ratio_at_best,
            }
            for entries in outcome.headlines.values()
            for h in entries
        ],
    }
