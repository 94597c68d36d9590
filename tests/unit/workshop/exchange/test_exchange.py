from __future__ import annotations

import ast
import csv
import json
import os
import re
import shutil
import subprocess
import sys
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import pytest
from ruamel.yaml import YAML

sys.path.append(str(Path(__file__).parents[1] / "listening"))
import listening_fakes as fakes

from browser import CHROMEDRIVER, CHROMIUM, driven
from tonewood.cli.main import run
from tonewood.workshop.exchange.answers import read_answers
from tonewood.workshop.exchange.course import COURSES, course, words
from tonewood.workshop.exchange.export import PROGRAMS, export
from tonewood.workshop.listening.definition import ListeningError, ListeningTest
from tonewood.workshop.listening.panel import SimulatedPanel, simulate
from tonewood.workshop.listening.results import analyse

#: a Python that has PsychoPy
PSYCHOPY = os.environ.get("TONEWOOD_PSYCHOPY")
BIDS = shutil.which("bids-validator-deno")
#: keys of webMUSHRA's doc/experimenter.md (version of May 2025) by type of page
DOCUMENTED = {
    "config": "testname testId bufferSize stopOnErrors showButtonPreviousPage remoteService pages",
    "generic": "type id name content",
    "consent": "type id name mustConsent content",
    "volume": "type id name content stimulus defaultVolume",
    "mushra": "type id name content showWaveform enableLooping strict reference createAnchor35 createAnchor70 "
    "randomize showConditionNames stimuli switchBack",
    "bs1116": "type id name content showWaveform enableLooping reference createAnchor35 createAnchor70 stimuli",
    "paired_comparison": "type id name unforced content showWaveform enableLooping reference stimuli",
    "finish": "type name content showResults writeResults",
}


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> ListeningTest:
    """A test with every kind of page and two simulated listeners, exported for every program."""
    pages = [*fakes.ALL, {"type": "headphones"}]
    test = fakes.made(tmp_path_factory.mktemp("exchange"), pages)
    panel = SimulatedPanel.model_validate(
        {"schema": "tonewood-panel/1", "thresholds": {"13": {"mean": 1.0, "slope": 2.0}}}
    )
    simulate(test, panel, 2, 1)
    export(test.folder, list(PROGRAMS))
    return test


def exported(test: ListeningTest, name: str) -> Path:
    return test.folder / "export" / name


def texts_of(folder: Path) -> Iterator[tuple[Path, str]]:
    for path in sorted(folder.rglob("*")):
        if path.is_file() and path.suffix != ".wav" and path.name != "tonewood.js":
            yield path, path.read_text("utf-8")


@pytest.mark.parametrize("name", sorted(PROGRAMS))
def test_codes_stay_blind(made: ListeningTest, name: str) -> None:
    """No condition, level or right answer stands in an export, and all its sounds are the test's."""
    key = json.loads((made.folder / "key.json").read_text())
    words = {sound["condition"] for sound in key["stimuli"].values()} | {"complex", "proportional", "anchor35"}
    for path, text in texts_of(exported(made, name)):
        assert not [word for word in words if word in text], path
        assert "correct" not in text.replace("storeCorrect", ""), path
    sounds = list(exported(made, name).rglob("*.wav"))
    assert len(sounds) > 10
    for path in sounds:
        assert path.stem.startswith("tone") or path.read_bytes() == made.sound(path.stem).read_bytes()


def test_courses_are_those_that_are_served(made: ListeningTest) -> None:
    """Every trial of every page, each listener in another order, with the slots of a session."""
    first, second = course(made, 0), course(made, 1)
    assert first != second
    trials = {trial.id for trial in made.trials if trial.page != 12}
    assert {row["trial"] for row in first} == {row["trial"] for row in second} == trials
    assert all(
        set(row["slots"].values()) <= {c for t in made.trials if t.id == row["trial"] for c in t.codes} for row in first
    )


def test_webmushra_has_documented_keys(made: ListeningTest) -> None:
    config = YAML(typ="safe", pure=True).load(exported(made, "webmushra") / "configs" / "damping.yaml")
    assert set(config) == set(DOCUMENTED["config"].split())
    *pages, finish = config["pages"]
    assert finish.pop("questionnaire")[0] == {"type": "text", "label": "Your number or name", "name": "listener"}
    assert set(finish) == set(DOCUMENTED["finish"].split())
    flat = [one for page in pages for one in (page[1:] if isinstance(page, list) else [page])]
    assert all(page[0] == "random" for page in pages if isinstance(page, list))
    for page in flat:
        assert set(page) <= set(DOCUMENTED[page["type"]].split()), page["type"]
        for file in [page[k] for k in ("reference", "stimulus") if k in page] + [*page.get("stimuli", {}).values()]:
            assert (exported(made, "webmushra") / file).is_file()
    assert {page["type"] for page in flat} == set(DOCUMENTED) - {"config", "finish"}
    # nobody begins without consent, and no sound is made that is not among the test's
    assert all(page["mustConsent"] is True for page in flat if page["type"] == "consent")
    rated = [page for page in flat if page["type"] in ("mushra", "bs1116")]
    assert not any(page["createAnchor35"] or page["createAnchor70"] for page in rated)
    mushra = next(page for page in flat if page["type"] == "mushra")
    trial = next(trial for trial in made.trials if mushra["id"] == f"{trial.id}-1")
    assert set(mushra["stimuli"]) == set(trial.stimuli)


def test_psychopy_s_loops_have_the_columns_that_components_read(made: ListeningTest) -> None:
    folder = exported(made, "psychopy")
    root = ET.parse(folder / "damping.psyexp").getroot()
    routines = {routine.get("name"): routine for routine in root.iter("Routine") if len(routine)}
    flow = root.find("Flow")
    assert flow is not None
    assert {one.get("name") for one in flow if one.tag == "Routine"} == set(routines)
    names = [c.get("name") for routine in routines.values() for c in routine]
    assert len(names) == len(set(names))
    loops = [one for one in flow if one.tag == "LoopInitiator"]
    assert len(loops) == 8
    for number in range(1, COURSES + 1):
        for loop in loops:
            page = str(loop.get("name")).removeprefix("trials")
            with (folder / "conditions" / f"course{number}_page{page}.csv").open(encoding="utf-8") as stream:
                rows = list(csv.DictReader(stream))
            used = {
                p.get("val", "")[1:] for p in routines[f"page{page}"].iter("Param") if p.get("val", "").startswith("$")
            }
            assert used <= set(rows[0]), (page, used)
            files = {row[f"sound{i}"] for row in rows for i in range(1, 5) if row.get(f"sound{i}")}
            assert all((folder / file).is_file() for file in files)


def test_sliders_run_over_the_answers_that_are_allowed(made: ListeningTest) -> None:
    """Points from 0 to 100 (BS.1534), grades from 1 to 5 (BS.1116), scales as declared; both ends have words."""
    root = ET.parse(exported(made, "psychopy") / "damping.psyexp").getroot()
    sliders: dict[str, dict[str, Any]] = {}
    for part in root.iter("SliderComponent"):
        values = {str(p.get("name")): p.get("val", "") for p in part}
        sliders[str(part.get("name"))] = {key: ast.literal_eval(values[key]) for key in ("ticks", "labels")}
    scale = next(page for page in made.pages if page.type == "rating").scales[0]
    ends = {"rate5_points": (0, 100), "rate6_points": (1, 5), "rate12_bright": (scale.low, scale.high)}
    assert {name: slider["ticks"] for name, slider in sliders.items()} == ends
    for slider in sliders.values():
        assert len(slider["labels"]) == 2
        assert all(slider["labels"])


@pytest.mark.skipif(PSYCHOPY is None, reason="TONEWOOD_PSYCHOPY names no Python with PsychoPy")
def test_psychopy_reads_the_experiment_and_writes_its_script(made: ListeningTest) -> None:
    script = """
import sys
from psychopy import experiment
made = experiment.Experiment()
made.loadFromXML(sys.argv[1])
assert not [c for r in made.routines.values() for c in r if "Unknown" in type(c).__name__]
code = made.writeScript(expPath=sys.argv[1])
compile(code, "made.py", "exec")
print(len(made.routines), len(made.flow), "answer7 = keyboard" in code)
"""
    command = [str(PSYCHOPY), "-c", script, str(exported(made, "psychopy") / "damping.psyexp")]
    done = subprocess.run(command, capture_output=True, text=True, cwd=exported(made, "psychopy"), timeout=300)
    assert done.returncode == 0, done.stderr[-2000:]
    assert done.stdout.split()[-3:] == ["11", "27", "True"]


@pytest.mark.skipif(BIDS is None, reason="needs bids-validator-deno")
def test_bids_is_valid(made: ListeningTest) -> None:
    done = subprocess.run(
        [str(BIDS), "--json", str(exported(made, "bids"))], capture_output=True, text=True, timeout=300
    )
    issues = json.loads(done.stdout)["issues"]["issues"]
    assert [one for one in issues if one["severity"] == "error"] == []


def test_bids_has_a_row_an_answer_and_no_names(made: ListeningTest) -> None:
    folder = exported(made, "bids")
    people = (folder / "participants.tsv").read_text().splitlines()
    assert people == ["participant_id\tsimulated", "sub-01\t1", "sub-02\t1"]
    with (folder / "sub-01" / "beh" / "sub-01_task-damping_beh.tsv").open() as stream:
        rows = list(csv.DictReader(stream, delimiter="\t"))
    found = analyse(made.folder)
    own = [row for row in found.table.rows if row["listener"] == found.table.rows[0]["listener"]]
    assert len(rows) == len(own)
    assert next(row["stim_file"] for row in rows if row["stim_file"] != "n/a").endswith(".wav")
    assert set(rows[0]) <= json.loads((folder / "task-damping_beh.json").read_text()).keys()


def webmushra_table(path: Path, columns: str, rows: list[list[Any]]) -> Path:
    with path.open("w", newline="") as stream:
        csv.writer(stream).writerows([columns.split(), *rows])
    return path


def test_answers_of_webmushra_give_the_means_that_were_given(made: ListeningTest, tmp_path: Path) -> None:
    """Columns of its service/write.php; every listener rates by a rule, so means are known."""
    key = json.loads((made.folder / "key.json").read_text())["stimuli"]
    points = {"complex": 100, "proportional": 60, "block": 30}
    trials = [trial for trial in made.trials if trial.page == 4]
    rows = []
    for k in range(3):
        for trial in trials:
            for code in trial.codes:
                role, level = key[code]["role"], key[code]["levels"]["damping"]
                score = points[level] - k if role == "sound" else 20
                name = "reference" if code == trial.reference else code
                rows.append(
                    ["damping", f"L{k}", f"u{k}", f"{trial.id}-1", name, score + k * (name == "reference"), 1000, ""]
                )
    rows.append(["damping", "L0", "u0", "nosuch-1", "reference", 50, 1000, ""])
    rows.append(["damping", "L0", "u0", f"{trials[0].id}-1", "reference", 150, 1000, ""])
    columns = "session_test_id listener session_uuid trial_id rating_stimulus rating_score rating_time rating_comment"
    table = read_answers(webmushra_table(tmp_path / "mushra.csv", columns, rows), made)
    assert [one.listener for one in table.listeners] == ["L0", "L1", "L2"]
    reasons = [one.reason for one in table.left_out]
    assert len(reasons) == 2
    assert f"mushra.csv: line {len(rows)}: trial: 'nosuch' is no trial" in reasons[0]
    assert "'150' is no number from 0 to 100" in reasons[1]
    for old in (made.folder / "answers").glob("*.jsonl"):
        old.rename(tmp_path / old.name)
    try:
        found = analyse(made.folder, others=table.listeners, others_left_out=table.left_out)
    finally:
        for old in tmp_path.glob("*.jsonl"):
            old.rename(made.folder / "answers" / old.name)
    assert (found.listeners, found.unfinished, len(found.left_out)) == (3, (), 2)
    (page,) = found.pages
    means = {mean.label: mean.mean for mean in page.per_factor if "damping" in mean.label}
    assert list(means.values()) == pytest.approx([100.0, 59.0, 29.0])


def test_other_tables_of_webmushra(made: ListeningTest, tmp_path: Path) -> None:
    pair = next(trial for trial in made.trials if trial.page == 6)
    columns = "session_test_id listener trial_id choice_reference choice_non_reference choice_answer choice_time"
    rows = [["damping", "a", f"{pair.id}-1", "reference", pair.stimuli[0], answer, 5] for answer in ("correct",)]
    rows += [["damping", "b", f"{pair.id}-1", "reference", pair.stimuli[0], "incorrect", 5]]
    found = read_answers(webmushra_table(tmp_path / "paired_comparison.csv", columns, rows), made)
    assert [one.records[0]["right"] for one in found.listeners] == [True, False]
    graded = next(trial for trial in made.trials if trial.page == 5)
    columns = "session_test_id listener trial_id rating_reference rating_non_reference rating_reference_score"
    rows = [["damping", "a", f"{graded.id}-1", "reference", graded.stimuli[0], 5.0, 3.2]]
    table = webmushra_table(tmp_path / "bs1116.csv", f"{columns} rating_non_reference_score", rows)
    page = next(p for p in analyse(made.folder, others=read_answers(table, made).listeners).pages if p.kind == "bs1116")
    assert [row["value"] for row in page.rows if row["listener"] == "a"] == [pytest.approx(3.2 - 5.0)]


@pytest.mark.parametrize(
    ("columns", "missing"),
    [
        ("listener rating_stimulus rating_score", "trial_id"),
        ("listener trial_id rating_stimulus", "rating_score"),
        ("listener choice_answer", "trial_id"),
        ("listener trial_id rating_reference_score rating_non_reference", "rating_non_reference_score"),
    ],
)
def test_a_table_of_webmushra_without_a_column_is_one_line(
    made: ListeningTest, tmp_path: Path, columns: str, missing: str
) -> None:
    table = webmushra_table(tmp_path / "cut.csv", columns, [["a"] * len(columns.split())])
    with pytest.raises(ListeningError, match=f"has no column {missing}; trial_id, "):
        read_answers(table, made)


@pytest.mark.parametrize(
    ("columns", "values"),
    [
        ("rating_stimulus rating_score", ["reference", 4]),
        ("choice_answer", ["correct"]),
        ("rating_reference_score rating_non_reference rating_non_reference_score", [5, "CODE", 3]),
    ],
)
def test_answers_of_one_kind_of_page_do_not_count_for_another(
    made: ListeningTest, tmp_path: Path, columns: str, values: list[Any]
) -> None:
    """Grades from 1 to 5 would be points from 0 to 100."""
    types = {"rating_stimulus": "mushra", "choice_answer": "abx", "rating_reference_score": "bs1116"}
    for trial in made.trials:
        if (page := made.pages[trial.page].type) != types[columns.split()[0]]:
            cells = [trial.stimuli[0] if value == "CODE" else value for value in values]
            rows = [["a", trial.id, *cells]]
            with pytest.raises(ListeningError, match=f"trial {trial.id} is of a page {page}, which has no answers"):
                read_answers(webmushra_table(tmp_path / "other.csv", f"listener trial_id {columns}", rows), made)


def test_headings_and_numbers_that_are_odd(made: ListeningTest, tmp_path: Path) -> None:
    """Blanks round names of columns; numbers of thousands of digits; a question that is answered twice."""
    page = next(i + 1 for i, page in enumerate(made.pages) if page.type == "questionnaire")
    table = tmp_path / "odd.csv"
    digits = "9" * 5000
    table.write_text(f"listener, page , trial, item, value\na,{page},,age,40\na,{page},,age,41\na,{digits},,age,40\n")
    answers = read_answers(table, made)
    assert [r["answer"]["values"] for one in answers.listeners for r in one.records] == [{"age": 40}]
    assert [one.reason.partition(": ")[2][:8] for one in answers.left_out] == ["line 3: ", "line 4: "]
    trial = next(trial for trial in made.trials if made.pages[trial.page].type == "mushra")
    rows = [["a", f"{trial.id}-{digits}", "reference", 100]]
    with pytest.raises(ListeningError, match=r"trial_id: .99999(.)* \.\.\.$"):
        read_answers(
            webmushra_table(tmp_path / "long.csv", "listener trial_id rating_stimulus rating_score", rows), made
        )


def test_ratings_without_a_column_of_sounds_are_left_out(made: ListeningTest, tmp_path: Path) -> None:
    trial = next(trial for trial in made.trials if made.pages[trial.page].type == "mushra")
    (tmp_path / "x.csv").write_text(f"listener,page,trial,value\na,{trial.page + 1},{trial.id},50\n")
    with pytest.raises(ListeningError, match="stimulus: '' is no sound of trial"):
        read_answers(tmp_path / "x.csv", made)


def plain_rows(test: ListeningTest) -> list[dict[str, Any]]:
    """One listener who hears everything, in the plain table."""
    key = json.loads((test.folder / "key.json").read_text())["stimuli"]
    rows: list[dict[str, Any]] = []
    for step in course(test, 3):
        base = {"listener": "P1", "page": step["page"], "trial": step["trial"], "repetition": step["repetition"]}
        slots = step["slots"]
        kind = test.pages[step["page"] - 1].type
        if not step["choices"]:
            low = 1 if kind == "bs1116" else 0
            for slot, code in slots.items():
                if slot != "reference":
                    best = code == slots.get("reference")
                    rows.append({**base, "stimulus": code, "value": (5 if low else 100) if best else low + 1})
            continue
        of = {slot: key[code]["levels"] for slot, code in slots.items()}
        if kind == "abx":
            answer = "A" if slots["A"] == slots["X"] else "B"
        elif kind == "ab":
            answer = "same" if slots["A"] == slots["B"] else "different"
        elif kind == "afc":
            trial = next(t for t in test.trials if t.id == step["trial"])
            answer = next(s for s in step["choices"] if slots[s] == trial.stimuli[0])
        else:
            answer = max("AB", key=lambda slot: ["near", "middle", "far"].index(of[slot]["pluck"]))
        rows.append({**base, **slots, "response": answer})
    rows.append({"listener": "P1", "page": 14, "item": "age", "value": 40})
    return rows


def write_plain(path: Path, rows: list[dict[str, Any]]) -> Path:
    columns = list(dict.fromkeys(key for row in rows for key in row))
    with path.open("w", newline="") as stream:
        writer = csv.DictWriter(stream, columns)
        writer.writeheader()
        writer.writerows(rows)
    return path


def test_a_plain_table_is_analysed_like_answers_given_here(made: ListeningTest, tmp_path: Path) -> None:
    rows = plain_rows(made)
    table = read_answers(write_plain(tmp_path / "plain.csv", rows), made)
    assert table.left_out == ()
    found = analyse(made.folder, others=table.listeners)
    own = [row for row in found.table.rows if row["listener"] == "P1"]
    assert len(own) == len(rows)
    assert {row["type"] for row in own} == {
        "mushra", "bs1116", "abx", "ab", "paired_comparison", "afc", "rating", "questionnaire",
    }  # fmt: skip
    assert all(row["value"] == 1 for row in own if row["type"] in ("abx", "ab", "afc"))
    assert {row["role"]: row["value"] for row in own if row["type"] == "mushra"}["reference"] == 100
    assert [row["value"] for row in own if row["item"] == "age"] == [40]


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"trial": "x"}, "'x' is no trial of this test"),
        ({"page": 3}, "is '3', and 5 is the page of trial"),
        ({"stimulus": "bcdfgh"}, "'bcdfgh' is no sound of trial"),
        ({"value": "101"}, "'101' is no number from 0 to 100"),
        ({"value": "nan"}, "'nan' is no number"),
        ({"value": "5_0"}, "'5_0' is no number"),
        ({"value": "５０"}, "'５０' is no number"),
    ],
)
def test_rows_that_do_not_fit_are_named(
    made: ListeningTest, tmp_path: Path, change: dict[str, Any], reason: str
) -> None:
    first, *others = [row for row in plain_rows(made) if row["page"] == 5]
    found = read_answers(write_plain(tmp_path / "plain.csv", [first | change, *others]), made)
    (one,) = found.left_out
    assert reason in one.reason
    assert "plain.csv: line 2: " in one.reason
    with pytest.raises(ListeningError, match="holds no answers to this test; the first row is left out because: "):
        read_answers(write_plain(tmp_path / "bad.csv", [first | change]), made)


@pytest.mark.parametrize(
    ("kind", "changes"),
    [
        ("bs1116", {"value": ["0.9", "5.1"]}),
        ("mushra", {"value": ["-1", "100.5"]}),
        ("abx", {"response": ["C", ""], "seconds": ["-1", "1e9"], "repetition": ["0", "1001"]}),
        ("afc", {"response": ["A", "4"]}),
        ("questionnaire", {"item": ["height"], "page": ["0", "99", "x"]}),
    ],
)
def test_answers_beyond_what_a_page_asks_are_left_out(
    made: ListeningTest, tmp_path: Path, kind: str, changes: dict[str, list[str]]
) -> None:
    rows = plain_rows(made)
    types = {index + 1: page.type for index, page in enumerate(made.pages)}
    at = next(i for i, row in enumerate(rows) if types[int(row["page"])] == kind)
    for key, values in changes.items():
        for value in values:
            changed = [row | {key: value} if i == at else row for i, row in enumerate(rows)]
            found = read_answers(write_plain(tmp_path / "plain.csv", changed), made)
            assert found.left_out, (key, value)
            assert f"line {at + 2}: " in found.left_out[0].reason


def test_a_trial_of_one_sound_alone_is_left_out(made: ListeningTest, tmp_path: Path) -> None:
    rows = plain_rows(made)
    for row in rows:
        if "X" in row:
            changed = [other | {"A": row["X"], "B": row["X"]} if other is row else other for other in rows]
            found = read_answers(write_plain(tmp_path / "plain.csv", changed), made)
            assert "X is not one of A and B" in found.left_out[0].reason
            return


def test_ends_of_scales_and_times_are_taken(made: ListeningTest, tmp_path: Path) -> None:
    rows = plain_rows(made)
    types = {index + 1: page.type for index, page in enumerate(made.pages)}
    for row in rows:
        row |= {"bs1116": {"value": "5"}, "mushra": {"value": "0"}}.get(types[int(row["page"])], {}) | {"seconds": "0"}
    found = read_answers(write_plain(tmp_path / "plain.csv", rows), made)
    assert found.left_out == ()
    (one,) = found.listeners
    assert {
        v for record in one.records if record["type"] == "mushra" for v in record["answer"]["ratings"].values()
    } == {0.0}
    assert {
        v for record in one.records if record["type"] == "bs1116" for v in record["answer"]["ratings"].values()
    } == {5.0}


@pytest.mark.parametrize("text", ["", "a,b\n1,2\n", "page,trial\n5,x\n", '"listener","page","trial\n', "\x00\x01"])
def test_files_that_are_no_tables_are_one_line(made: ListeningTest, tmp_path: Path, text: str) -> None:
    path = tmp_path / "x.csv"
    path.write_text(text)
    with pytest.raises(ListeningError) as fault:
        read_answers(path, made)
    assert "\n" not in str(fault.value)


def test_answers_of_psychopy_s_tables_come_in(made: ListeningTest, tmp_path: Path) -> None:
    """Its wide table: columns of the conditions, keys and sliders, and rows of pages without trials."""
    folder = exported(made, "psychopy") / "conditions"
    rows: list[dict[str, Any]] = [{"participant": "P2", "go1.keys": "space"}]
    for page, column, answer in ((7, "answer7.keys", "a"), (12, "rate12_bright.response", 40)):
        with (folder / f"course2_page{page}.csv").open() as stream:
            rows += [{"participant": "P2", **row, column: answer} for row in csv.DictReader(stream)]
    found = read_answers(write_plain(tmp_path / "psychopy.csv", rows), made)
    assert found.left_out == ()
    (one,) = found.listeners
    assert one.listener == "P2"
    assert {record["answer"].get("choice") for record in one.records if record["type"] == "abx"} == {"A"}
    assert {record["answer"]["values"]["bright"] for record in one.records if record["type"] == "rating"} == {40.0}


@pytest.mark.slow
def test_the_command_reads_a_table_and_writes_parquet_beside_csv(
    made: ListeningTest, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    table = write_plain(tmp_path / "plain.csv", plain_rows(made))
    with pytest.raises(SystemExit) as end:
        run(["results", str(made.folder), "--answers", str(table), "-o", str(tmp_path / "r")])
    assert end.value.code == 0, capsys.readouterr().err
    with (tmp_path / "r" / "answers.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    same = pq.read_table(tmp_path / "r" / "answers.parquet").to_pylist()
    assert [row["listener"] for row in rows] == [row["listener"] for row in same]
    assert [float(row["value"] or "nan") for row in rows] == pytest.approx(
        [float("nan") if row["value"] is None else row["value"] for row in same], nan_ok=True
    )
    assert pq.read_table(tmp_path / "r" / "means.parquet").num_rows > 10


@pytest.mark.validate
@pytest.mark.skipif(
    CHROMIUM is None or CHROMEDRIVER is None or shutil.which("npm") is None, reason="needs Chromium, npm"
)
def test_jspsych_runs_to_its_end_and_its_answers_come_in(made: ListeningTest, tmp_path: Path) -> None:
    folder = tmp_path / "jspsych"
    shutil.copytree(exported(made, "jspsych"), folder)
    done = subprocess.run(["npm", "install", "--silent"], cwd=folder, capture_output=True, timeout=600)
    if done.returncode != 0:
        pytest.skip("npm cannot fetch jsPsych")
    with driven(1000) as browser:
        browser.open(f"{(folder / 'index.html').as_uri()}?listener=P9&course=4")
        browser.until("document.querySelector('button')")
        while not browser.run("return Boolean(document.getElementById('saved'))"):
            browser.run("""
                const all = selector => [...document.querySelectorAll(selector)];
                const sounds = all("button.play");
                if (!sounds.length) {
                  const field = document.querySelector("select[required]");
                  if (field) field.value = field.options[1].value;
                  document.querySelector(".jspsych-btn, input[type=submit]").click();
                  return;
                }
                return new Promise(done => {
                  const old = window.Audio, began = document.querySelector("h1");
                  const wait = () => all("button.play:not(.heard)").length ? setTimeout(wait, 20) : answer();
                  const answer = () => {
                    for (const slider of all("input[type=range]")) {
                      slider.value = slider.getAttribute("aria-label").startsWith("A") ? slider.max : slider.min;
                      slider.dispatchEvent(new Event("input"));
                    }
                    document.querySelector("#send, button.answer").click();
                    done();
                  };
                  let i = 0;
                  const next = () => { if (i < sounds.length) { sounds[i].click(); const at = sounds[i++];
                    const look = () => at.classList.contains("heard") ? next() : setTimeout(look, 20); look(); } };
                  next(); wait();
                });
            """)
        text = browser.run("return window.answers")
    path = tmp_path / "answers.csv"
    path.write_text(text, newline="")
    found = read_answers(path, made)
    assert found.left_out == ()
    (one,) = found.listeners
    assert one.listener == "P9"
    assert len([r for r in one.records if r["trial"]]) == len(course(made, 4))
    assert re.search("P9", text)


def test_pages_have_the_words_that_listeners_read_here(made: ListeningTest) -> None:
    """Their own, else those of the language."""
    texts = made.texts("en")
    said = {page.type: words(made, page) for page in made.manifest.pages}
    assert said["consent"] == (texts["consent_title"], "<b>Read</b> & agree")
    assert said["instructions"] == ("Hello", "")
    assert said["mushra"] == (texts["mushra_title"], texts["mushra_text"])
    assert texts["mushra_text"]


def test_an_answer_by_key_counts_where_no_response_stands(made: ListeningTest, tmp_path: Path) -> None:
    """A column of responses that is empty in the rows of keys, as of two tables put together."""
    (row, *_) = [row for row in plain_rows(made) if row.get("response") == "A"]
    chosen = {key: value for key, value in row.items() if key != "response"}
    found = read_answers(write_plain(tmp_path / "plain.csv", [chosen | {"response": "", "answer7.keys": "a"}]), made)
    assert found.left_out == ()
    assert [one.records[0]["answer"]["choice"] for one in found.listeners] == ["A"]
