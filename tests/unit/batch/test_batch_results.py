from __future__ import annotations

import copy
import csv
import json
from pathlib import Path

import batch_fakes as fakes
import numpy as np
import pytest
from scipy import stats

from tonewood.batch.answers import ResultsError
from tonewood.batch.conditions import expand
from tonewood.batch.layout import lay_out
from tonewood.batch.manifest import check_manifest
from tonewood.batch.records import key_of, write_json
from tonewood.batch.results import analyse, write_plot
from tonewood.errors import TonewoodError

RATED = {"group_by": ["score", "pluck"], "reference": {"damping": "complex"}}
PAGES = [
    {"type": "mushra", "anchors": [3500, 7000], **RATED},
    {"type": "bs1116", **RATED},
    {"type": "paired_comparison", "pairs": {"damping": [["complex", "block"], ["complex", "proportional"]]}},
]
MUSHRA = ("trial_id", "rating_stimulus", "rating_score", "rating_time", "rating_comment")


@pytest.fixture
def key(tmp_path: Path) -> dict:
    data = check_manifest(fakes.manifest(pages=PAGES))
    conditions = expand(data, tmp_path)
    groups, _ = lay_out(data, conditions)
    made = key_of(data, groups, {c.name: c for c in conditions})
    write_json(tmp_path / "key.json", made)
    return made


def trials(key: dict, kind: str) -> dict:
    return {t: entry for t, entry in key["trials"].items() if entry["type"] == kind}


def code_of(key: dict, trial: str, damping: str) -> str:
    stimuli = key["trials"][trial]["stimuli"]
    return next(c for c in stimuli if key["stimuli"][c]["levels"]["damping"] == damping)


def table(path: Path, columns: tuple[str, ...], rows: list[tuple], asked: tuple[str, ...] = ("listener",)) -> Path:
    with path.open("w", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(["session_test_id", *asked, *columns])
        writer.writerows(["damping", *row] for row in rows)
    return path


def mushra_rows(key: dict, scores: dict[str, dict[str, float]], who: list[str]) -> list[tuple]:
    """`scores`: label -> listener -> score, the same in every trial."""
    rows = []
    for listener in who:
        for trial in trials(key, "mushra"):
            for label, by_listener in scores.items():
                name = label if label in ("reference", "anchor35", "anchor70") else code_of(key, trial, label)
                rows.append((listener, trial, name, by_listener[listener], 1000, ""))
    return rows


def test_mushra_means_and_intervals(tmp_path: Path, key: dict) -> None:
    rng = np.random.default_rng(1)
    who = [f"p{i}" for i in range(12)]
    marks = {
        label: dict(zip(who, np.clip(rng.normal(centre, 6, 12), low, 100).round(), strict=True))
        for label, centre, low in (
            ("reference", 98, 91), ("block", 60, 0), ("proportional", 80, 0), ("anchor35", 15, 0), ("anchor70", 40, 0),
        )
    }  # fmt: skip
    path = table(tmp_path / "mushra.csv", MUSHRA, mushra_rows(key, marks, who))
    found = analyse(path, tmp_path / "key.json")
    assert (found.kind, found.listeners, found.screened, found.notes) == ("mushra", 12, (), ())
    labels = [m.label for m in found.overall]
    assert labels == ["damping=block", "damping=proportional", "anchor35", "anchor70", "reference"]
    for mean in found.overall:
        scores = np.array(list(marks[mean.label.removeprefix("damping=")].values()))
        interval = stats.t.interval(0.95, 11, scores.mean(), stats.sem(scores))
        assert mean.mean == pytest.approx(scores.mean(), rel=1e-12)
        assert (mean.low, mean.high) == pytest.approx(interval, rel=1e-12)
        assert mean.median == np.median(scores)
        assert (mean.listeners, mean.ratings) == (12, 12 * 4)
    assert len(found.per_trial) == 4 * 5
    assert json.loads(json.dumps(found.to_dict()))["overall"][0]["label"] == "damping=block"
    write_plot(found, tmp_path / "plot.png")
    assert (tmp_path / "plot.png").read_bytes().startswith(b"\x89PNG")


def test_a_listener_counts_once_however_many_trials(tmp_path: Path, key: dict) -> None:
    # two listeners, every trial another score: the interval is that of the two means 50 and 60, t(0.975, 1) = 12.706
    first, second, *_ = trials(key, "mushra")
    rows = [
        ("a", first, code_of(key, first, "block"), 40, 1, ""), ("a", second, code_of(key, second, "block"), 60, 1, ""),
        ("b", first, code_of(key, first, "block"), 50, 1, ""), ("b", second, code_of(key, second, "block"), 70, 1, ""),
    ]  # fmt: skip
    (mean,) = analyse(table(tmp_path / "r.csv", MUSHRA, rows), tmp_path / "key.json").overall
    assert mean.mean == 55.0
    assert mean.high - mean.mean == pytest.approx(12.7062047 * np.std([50, 60], ddof=1) / np.sqrt(2), rel=1e-6)


def test_screening_follows_bs1534(tmp_path: Path, key: dict) -> None:
    who = ["good", "deaf", "edge", "mid"]
    marks = {
        "reference": {"good": 100, "deaf": 50, "edge": 90, "mid": 95},
        "anchor70": {"good": 40, "deaf": 40, "edge": 90, "mid": 30},
        "block": dict.fromkeys(who, 60),
    }
    rows = mushra_rows(key, marks, who)
    one = next(i for i, r in enumerate(rows) if r[0] == "mid" and r[2] == "anchor70")
    rows[one] = (*rows[one][:3], 95, *rows[one][4:])  # above 90 in one of four trials: 25 % > 15 %
    path = table(tmp_path / "r.csv", MUSHRA, rows)
    found = analyse(path, tmp_path / "key.json")
    assert [(s.listener, s.reason) for s in found.screened] == [
        ("deaf", "hidden reference below 90 in 4 of 4 trials"),
        ("mid", "mid anchor above 90 in 1 of 4 trials"),
    ]
    assert next(m for m in found.overall if m.label == "reference").mean == 95.0
    everyone = analyse(path, tmp_path / "key.json", screening=False)
    assert not everyone.screened
    assert next(m for m in everyone.overall if m.label == "reference").listeners == 4


def test_an_anchor_most_find_good_does_not_screen(tmp_path: Path, key: dict) -> None:
    who = ["a", "b", "c"]
    marks = {"reference": dict.fromkeys(who, 100), "anchor70": {"a": 95, "b": 95, "c": 20}}
    path = table(tmp_path / "r.csv", MUSHRA, mushra_rows(key, marks, who))
    assert analyse(path, tmp_path / "key.json").screened == ()


def test_nobody_left(tmp_path: Path, key: dict) -> None:
    path = table(tmp_path / "r.csv", MUSHRA, mushra_rows(key, {"reference": {"a": 10}}, ["a"]))
    with pytest.raises(ResultsError, match="none of 1 listeners passes the screening"):
        analyse(path, tmp_path / "key.json")


def test_bs1116_difference_grades(tmp_path: Path, key: dict) -> None:
    columns = (
        "trial_id", "rating_reference", "rating_non_reference", "rating_reference_score",
        "rating_non_reference_score", "rating_time", "choice_comment",
    )  # fmt: skip
    trial = next(iter(trials(key, "bs1116")))
    code = code_of(key, trial, "block")
    grades = {"a": (5.0, 4.0), "b": (5.0, 3.5), "c": (4.8, 5.0)}
    rows = [(who, trial, "reference", code, r, n, 10, "") for who, (r, n) in grades.items()]
    found = analyse(table(tmp_path / "r.csv", columns, rows), tmp_path / "key.json")
    (mean,) = found.overall
    differences = [-1.0, -1.5, 0.2]
    assert mean.mean == pytest.approx(np.mean(differences))
    assert (mean.low, mean.high) == pytest.approx(
        stats.t.interval(0.95, 2, np.mean(differences), stats.sem(differences))
    )
    write_plot(found, tmp_path / "plot.png")


def test_choices(tmp_path: Path, key: dict) -> None:
    columns = ("trial_id", "choice_reference", "choice_non_reference", "choice_answer", "choice_time", "choice_comment")
    pairs = {t: e["stimuli"][0] for t, e in trials(key, "paired_comparison").items()}
    block = [(t, c) for t, c in pairs.items() if key["stimuli"][c]["levels"]["damping"] == "block"]
    given = ["correct"] * 9 + ["incorrect"] * 1 + ["undecided"] * 2
    rows = [(f"p{i % 3}", *block[i // 3], answer) for i, answer in enumerate(given)]
    rows = [(who, trial, "reference", code, answer, 1, "") for who, trial, code, answer in rows]
    found = analyse(table(tmp_path / "r.csv", columns, rows), tmp_path / "key.json", confidence=0.9)
    (rate,) = found.overall
    assert rate.label == "damping=block"
    assert (rate.correct, rate.incorrect, rate.undecided, rate.unknown, rate.listeners) == (9, 1, 2, 0, 3)
    assert rate.rate == 0.9
    # Clopper-Pearson by the beta distribution, and the binomial tail by hand: (10 + 1) / 2^10
    assert rate.low == pytest.approx(stats.beta.ppf(0.05, 9, 2), rel=1e-9)
    assert rate.high == pytest.approx(stats.beta.ppf(0.95, 10, 1), rel=1e-9)
    assert rate.p_value == pytest.approx(11 / 1024)
    assert sum(r.correct for r in found.per_trial) == 9
    write_plot(found, tmp_path / "plot.png")


def test_sessions_without_names_are_distinguished(tmp_path: Path, key: dict) -> None:
    trial = next(iter(trials(key, "mushra")))
    code = code_of(key, trial, "block")
    rows = [(trial, name, score, 1, "") for score in (10, 20, 30) for name in (code, "reference")]
    found = analyse(table(tmp_path / "r.csv", MUSHRA, rows, asked=()), tmp_path / "key.json", screening=False)
    assert found.listeners == 3
    assert found.overall[0].mean == 20.0


def test_the_uuid_tells_sessions_apart(tmp_path: Path, key: dict) -> None:
    trial = next(iter(trials(key, "mushra")))
    rows = [("same", uuid, trial, "reference", 100, 1, "") for uuid in ("u1", "u2")]
    path = table(tmp_path / "r.csv", MUSHRA, rows, asked=("listener", "session_uuid"))
    assert analyse(path, tmp_path / "key.json").listeners == 2


def test_missing_answers_are_reported(tmp_path: Path, key: dict) -> None:
    rows = mushra_rows(key, {"reference": {"a": 100, "b": 100}, "block": {"a": 50, "b": 40}}, ["a", "b"])[:-1]
    found = analyse(table(tmp_path / "r.csv", MUSHRA, rows), tmp_path / "key.json")
    assert found.notes == ("b gave 7 of 8 answers",)


def test_semicolons_and_a_byte_order_mark(tmp_path: Path, key: dict) -> None:
    trial = next(iter(trials(key, "mushra")))
    text = "\ufeffsession_test_id;who;" + ";".join(MUSHRA) + f"\r\ndamping;a;{trial};reference;95;1;\r\n\r\n"
    (tmp_path / "r.csv").write_text(text)
    assert analyse(tmp_path / "r.csv", tmp_path / "key.json").overall[0].mean == 95.0


@pytest.mark.parametrize(
    ("column", "value", "words"),
    [
        ("session_test_id", "other", "session_test_id: line 2: 'other' is not the batch of the key, damping"),
        ("trial_id", "nonsense", "trial_id: line 2: 'nonsense' is not a mushra trial of the key"),
        ("rating_stimulus", "zzzzzz", "rating_stimulus: line 2: 'zzzzzz' is not a stimulus of its trial"),
        ("rating_score", "", "rating_score: line 2: '' is not a number from 0 to 100"),
        ("rating_score", "101", "rating_score: line 2: '101' is not a number from 0 to 100"),
        ("rating_score", "nan", "rating_score: line 2: 'nan' is not a number"),
    ],
)
def test_rows_that_do_not_fit(tmp_path: Path, key: dict, column: str, value: str, words: str) -> None:
    row = {"session_test_id": "damping", "listener": "a", "trial_id": next(iter(trials(key, "mushra")))}
    row |= {"rating_stimulus": "reference", "rating_score": "90", "rating_time": "1", "rating_comment": ""}
    row[column] = value
    path = tmp_path / "r.csv"
    path.write_text(",".join(row) + "\n" + ",".join(row.values()) + "\n")
    with pytest.raises(ResultsError) as caught:
        analyse(path, tmp_path / "key.json")
    assert str(caught.value).startswith(f"{path}: {words}")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "is empty"),
        ("a,b\n1,2\n", "not a table of webMUSHRA: one of the columns rating_score,"),
        ("session_test_id,rating_stimulus,rating_score\n", "column trial_id is missing"),
        ("session_test_id,trial_id,rating_stimulus,rating_score\n", "holds no answers"),
        ("session_test_id,trial_id,rating_stimulus,rating_score\na,b\n", "line 2: 2 cells; the header has 4"),
    ],
)
def test_tables_that_are_none(tmp_path: Path, key: dict, text: str, words: str) -> None:
    (tmp_path / "r.csv").write_text(text)
    with pytest.raises(ResultsError, match=words):
        analyse(tmp_path / "r.csv", tmp_path / "key.json")


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"schema": "tonewood-key/1", "name": "x", "trials": 3}', "\x00"])
def test_keys_that_are_none(tmp_path: Path, text: str) -> None:
    (tmp_path / "r.csv").write_text("a")
    (tmp_path / "key.json").write_text(text)
    with pytest.raises(ResultsError, match=r"key\.json"):
        analyse(tmp_path / "r.csv", tmp_path / "key.json")
    with pytest.raises(ResultsError, match="cannot be read"):
        analyse(tmp_path / "r.csv", tmp_path / "absent.json")


_ODD = [None, 0, -1, 1e300, "", "x", [], {}, [[]], {"a": 1}, ["x"], [None], True]


def test_a_damaged_key_is_one_line(tmp_path: Path, key: dict) -> None:
    """Every value of the key replaced or taken away: read, or one line that names the file."""
    label, who = "proportional", ["a", "b"]
    marks = {"reference": dict.fromkeys(who, 100), label: dict.fromkeys(who, 50)}
    answers = table(tmp_path / "mushra.csv", MUSHRA, mushra_rows(key, marks, who))
    path = tmp_path / "odd.json"

    def judge(data: object) -> str:
        path.write_text(json.dumps(data))
        line = ""
        try:
            analyse(answers, path)
        except TonewoodError as fault:
            line = str(fault)
        assert "\n" not in line
        assert not line or str(path) in line or str(answers) in line
        return line

    def places(value: object, at: tuple = ()) -> list[tuple]:
        inside = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
        return [at, *(p for k, v in inside for p in places(v, (*at, k)))]

    assert judge(key) == ""
    found = sorted(places(key)[1:], key=str)
    trial = next(i for i, p in enumerate(found) if p[0] == "trials" and len(p) > 1)
    for place in [p for p in found if len(p) == 1] + found[trial : trial + 20] + found[:40]:
        for odd in [*_ODD, ...]:
            data = copy.deepcopy(key)
            holder = data
            for step in place[:-1]:
                holder = holder[step]
            if odd is ...:
                del holder[place[-1]]
            else:
                holder[place[-1]] = odd
            judge(data)
    assert "trials" in judge(
        {**key, "trials": {"t": {"type": "mushra", "group": "g", "reference": "no", "stimuli": []}}}
    )
    path.write_text("[" * 100_000)
    with pytest.raises(ResultsError, match="not JSON"):
        analyse(answers, path)
