"""Sentences of results, against figures worked out by hand."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest
from listening_by_hand import LEVITT, detected, found

from tonewood.workshop.listening.detection import sensitivity
from tonewood.workshop.listening.models import (
    END_SHARE,
    LinearAnalysis,
    ModelTerm,
    RankAnalysis,
    Superiority,
    linear_analysis,
)
from tonewood.workshop.listening.ordinal import (
    OddsTerm,
    OrdinalAnalysis,
)
from tonewood.workshop.listening.plain import (
    _cells,
    _detected,
    _difference,
    _of_page,
    summary,
)
from tonewood.workshop.listening.results import (
    PageResults,
)


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({}, "pluck near and far (body.detune 1.02 against 1) are told apart (30 of 40 answers, 75 % right, "
             "p by Holm = 0.020; d' = 2.00 (95 % interval 1.00 to 3.00), {jnd} just-noticeable differences by these "
             "answers)."),
        ({"d_high": None}, "d' = 2.00 (95 % interval from 1.00), "),
        ({"d_low": None, "d_high": None}, "d' = 2.00, "),
        ({"d_prime": None}, "p by Holm = 0.020; d' is at least 1.00)."),
        ({"d_prime": None, "d_low": None}, "75 % right, p by Holm = 0.020)."),
        ({"p_holm": 0.051}, "are not shown to be told apart (30 of 40 answers, 75 %, p by Holm = 0.051; "
             "d' is at most 3)."),
        ({"p_holm": 0.5, "d_high": None}, "75 %, p by Holm = 0.500)."),
        ({"share": None}, "pluck near and far: nobody decided."),
        ({"p_holm": 0.049}, "are told apart"),
        ({"cell": {"score": "low"}}, "score low are told apart"),
    ],
)  # fmt: skip
def test_a_pair_in_words(changes: dict[str, Any], text: str) -> None:
    from tonewood.workshop.batch.pages import AbxPage

    page = AbxPage.model_validate({"type": "abx", "pairs": {"pluck": "all"}})
    factor = SimpleNamespace(path="body.detune", levels={"near": 1.0, "far": 1.02})
    test = SimpleNamespace(pages=[page], manifest=SimpleNamespace(factors={"pluck": factor}))
    panel: Any = SimpleNamespace(test=test, confidence=0.95, pages=())
    own = PageResults(1, "abx", "A", 4, ("pluck",), ())
    jnd = 2.0 / sensitivity(2**-0.5, "abx")
    assert text.format(jnd=f"{jnd:.2g}") in _detected(panel, own, detected(**changes), "95 %")


def test_cells_of_pairs_in_words() -> None:
    sure, other = detected(cell={"pluck": "a|b", "score": "low"}, p_holm=0.0004), detected(p_holm=0.05)
    own = PageResults(1, "abx", "A", 4, (), (), detections=(other, sure, other))
    assert _cells(own, 0.05) == (
        "in 1 of 3 cells a pair is told apart by the answers of that cell alone (p by Holm): "
        "pluck a and b, score low (30 of 40 right, p < 0.001)."
    )
    none = replace(own, detections=(other, other))
    assert _cells(none, 0.05).startswith("in none of 2 cells is a pair shown")


def test_cells_are_told_of_pairs_in_several() -> None:
    panel: Any = SimpleNamespace(confidence=0.95)
    own = PageResults(1, "abx", "A", 4, (), (), pairs=(detected(share=None),), detections=(detected(),))
    assert _of_page(panel, own) == ["pluck near and far: nobody decided."]
    _, cells = _of_page(panel, replace(own, detections=(detected(), detected(p_holm=0.06))))
    assert cells.startswith("in 1 of 2 cells")


def linear(*terms: tuple[str, float, float, float, float], at_ends: float | None = None) -> LinearAnalysis:
    made = tuple(ModelTerm(n, ("d",), v, low, high, 9.0, p, p, 0.5, "a") for n, v, low, high, p in terms)
    return LinearAnalysis("", "", True, 10, 5, (), made, (), 3.0, at_ends)


def rated(model: LinearAnalysis, **changes: Any) -> PageResults:
    rows = tuple(
        {"d": d, "role": role} for role, d in (("anchor35", "x"), ("reference", "a"), ("sound", "b"), ("sound", "c"))
    )
    return PageResults(1, "mushra", "M", 5, ("d",), rows, linear=model, **changes)


def told_of(own: PageResults) -> tuple[float, str]:
    panel: Any = SimpleNamespace(test=SimpleNamespace(manifest=SimpleNamespace(factors={})), confidence=0.95, pages=())
    assert own.linear is not None
    p, text = _difference(panel, own, own.linear, own.linear.terms[0])
    return p, text.replace("\N{MINUS SIGN}", "-")


@pytest.mark.parametrize(
    ("term", "text"),
    [
        (("d=b", -7.5, -9.0, -6.0, 0.0004), "b is rated 7.5 points below a (95 % interval -9 to -6, p < 0.001)"),
        (("d=b", 7.5, 6.0, 9.0, 0.049), "b is rated 7.5 points above a (95 % interval 6 to 9, p = 0.049)"),
        (("d=b", 1.0, -2.0, 4.0, 0.051), "no difference between b and a is shown (1 points, 95 % interval -2 to 4, "
         "p = 0.051); one of more than 4 points is unlikely"),
        (("d=b", -1.0, -5.5, 4.0, 0.5), "; one of more than 5.5 points is unlikely"),
        (("d=b", 0.0, 0.0, 0.0, 1.0), "no difference between b and a is shown (every "
         "listener's answers to both are equal)"),
        (("d=b", 2.0, 2.0, 2.0, 0.25), "is shown (2 points, the same for every listener, sign test p = 0.250)"),
        (("d=b", 2.0, 2.0, 2.0, 0.01), "b is rated 2 points above a (the same for every listener, sign test "
         "p = 0.010)"),
    ],
)  # fmt: skip
def test_a_difference_of_ratings_in_words(term: Any, text: str) -> None:
    p, told = told_of(rated(linear(term, ("d=c", 0.0, 0.0, 0.0, 1.0))))
    assert p == term[-1]
    assert told == text if not text.startswith((";", "is shown")) else text in told


def test_a_difference_is_from_the_level_of_the_reference() -> None:
    """A level that one listener rated is left out; the others were said to differ from it, where it stood first."""
    rows = [
        {"listener": str(i), "d": d, "role": "sound", "value": v + i % 3 * (d == "b")}
        for d, v in (("x", 10.0), ("a", 90.0), ("b", 50.0))
        for i in range(1 if d == "x" else 6)
    ]
    model = linear_analysis(rows, ("d",), 0.95, {"d": ["a", "x", "b"]})
    assert model is not None
    assert [(t.name, t.first, round(t.difference, 9)) for t in model.terms] == [("d=b", "a", -39.0)]
    assert told_of(PageResults(1, "mushra", "M", 6, ("d",), tuple(rows), linear=model))[1].startswith(
        "b is rated 39 points below a ("
    )


def test_the_larger_p_of_those_with_and_without_the_screened_is_told() -> None:
    kept = linear(("d=b", -7.5, -9.0, -6.0, 0.001), ("d=c", 0.0, 0.0, 0.0, 1.0))
    every = linear(("d=b", -3.0, -7.0, 1.0, 0.2), ("d=c", 0.0, 0.0, 0.0, 1.0))
    p, told = told_of(rated(kept, everybody=rated(every)))
    assert (p, told.startswith("no difference between b and a is shown (-3 points")) == (0.2, True)
    assert told_of(rated(every, everybody=rated(kept)))[0] == 0.2


def test_shares_and_odds_are_told_where_the_scale_ends() -> None:
    share = Superiority("d", "a", "b", 5, 0.25, 0.1, 0.4, 0.01, 0.02)
    ranks = RankAnalysis((), (), (share,))
    odds = OrdinalAnalysis(5, 5, (OddsTerm("d=b", ("d",), 0.5, 0.25, 1.0, 4.0, 0.03, 0.06),), (), True)
    terms = (("d=b", -7.5, -9.0, -6.0, 0.001), ("d=c", 0.0, 0.0, 0.0, 1.0))
    said = "b is rated above a in 25 % of comparisons (95 % interval 10 to 40 %, p by Holm = 0.020)"
    ratio = "the odds of a higher rating are 0.5 times as large (95 % interval 0.25 to 1, p by Holm = 0.060)"
    _, plain = told_of(rated(linear(*terms, at_ends=END_SHARE), ranks=ranks, odds=odds))
    assert plain.endswith(f"p = 0.001); {ratio}")
    _, bent = told_of(rated(linear(*terms, at_ends=END_SHARE + 0.01), ranks=ranks, odds=odds))
    assert bent.endswith(f"; {said}; {ratio}")
    p, ordinal = told_of(rated(linear(*terms), ranks=ranks, odds=odds, ordinal=True))
    assert (p, ordinal) == (0.02, f"{said}; {ratio}")
    turned = RankAnalysis((), (), (replace(share, first="b", second="a", p_holm=0.051),))
    p, ordinal = told_of(rated(linear(*terms), ranks=turned, ordinal=True))
    assert p == 0.051
    assert ordinal == (
        "no difference between b and a is shown: b is rated above a in 75 % of comparisons (95 % interval 60 to 90 %, "
        "p by Holm = 0.051)"
    )


def test_results_of_too_few_are_said_not_to_be_tested() -> None:
    own = PageResults(1, "mushra", "M", 2, ("d",), ({"value": None}, {"value": 50.0}))
    panel: Any = SimpleNamespace(confidence=0.95, pages=(own,))
    assert summary(panel) == ["Page 1, M: no difference is tested, with answers of 2 listeners; three are needed."]
    (said,) = summary(SimpleNamespace(confidence=0.95, pages=(replace(own, screened=(1,)),)))  # type: ignore[arg-type]
    assert "of 2 listeners, 1 listener left out by the screening; three" in said
    silent = (replace(own, factors=()), replace(own, rows=({"value": None},)))
    assert summary(SimpleNamespace(confidence=0.95, pages=silent)) == []  # type: ignore[arg-type]


def test_results_are_written_without_their_rows() -> None:
    panel, own = found(LEVITT, 0.5, 0.4, 0.6)
    screened = replace(own, page=2, everybody=own)
    data = replace(panel, pages=(own, screened), unfinished=("u",), withdrawn=3).to_dict()
    whole, other = data.pop("pages")
    assert data == {
        "name": "t", "confidence": 0.95, "listeners": 2, "simulated": 0, "unfinished": ["u"], "not_passed": [],
        "withdrawn": 3, "left_out": [],
    }  # fmt: skip
    assert (whole["page"], whole["thresholds"]["mean"], whole["everybody"], "rows" in whole) == (1, 0.5, None, False)
    assert (other["everybody"]["page"], other["everybody"]["rows"]) == (1, ())
