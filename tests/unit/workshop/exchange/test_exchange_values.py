"""Values of exports and of answers that come in, word by word."""

from __future__ import annotations

import csv
import json
import re
import xml.etree.ElementTree as ET
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from ruamel.yaml import YAML

from tonewood.errors import OutputError
from tonewood.workshop.batch.pages import (
    AbPage,
    AbxPage,
    AfcPage,
    Bs1116Page,
    ConsentPage,
    FinishPage,
    HtmlPage,
    InstructionsPage,
    LevelPage,
    MushraPage,
    PairedPage,
    QuestionnairePage,
    RatingPage,
    StaircasePage,
)
from tonewood.workshop.exchange.answers import (
    _limits,
    _number,
    _questionnaire,
    _rate,
    _record,
    _right,
    _take_plain,
    _take_webmushra,
    _TrialAnswer,
    _values,
    _who,
    joined,
    read_answers,
)
from tonewood.workshop.exchange.bids import COLUMNS
from tonewood.workshop.exchange.bids import write as write_bids
from tonewood.workshop.exchange.course import Exported, codes_of, course, left_out, shown_pages, words
from tonewood.workshop.exchange.export import PROGRAMS, check_programs, export
from tonewood.workshop.exchange.jspsych import write as write_jspsych
from tonewood.workshop.exchange.psychopy import _experiment, _rows, _sequence
from tonewood.workshop.exchange.psychopy import write as write_psychopy
from tonewood.workshop.exchange.webmushra import _config, _html, _trial
from tonewood.workshop.exchange.webmushra import write as write_webmushra
from tonewood.workshop.listening.checked_answer import choices
from tonewood.workshop.listening.definition import ListeningError, ListeningTest, ServedTrial
from tonewood.workshop.listening.table import read_key

KINDS: dict[str, Any] = {
    "consent": ConsentPage, "instructions": InstructionsPage, "level": LevelPage, "mushra": MushraPage,
    "bs1116": Bs1116Page, "abx": AbxPage, "ab": AbPage, "afc": AfcPage, "paired_comparison": PairedPage,
    "rating": RatingPage, "questionnaire": QuestionnairePage, "html": HtmlPage, "staircase": StaircasePage,
}  # fmt: skip
PAIRS = {"pairs": {"f": "all"}}
SCALES = [{"name": "dry", "label": "Dry", "low": -2.0, "high": 2.0, "low_label": "wet"}, {"name": "loud", "label": "L"}]


def page(type: str, **fields: Any) -> Any:  # the manifest's word
    return KINDS[type].model_validate({"type": type, **fields})


PAGES = [
    page("consent", name="Hello & you", content="one\n\ntwo <b>"),
    page("level"),
    page("mushra", reference={"f": "a"}, waveform=True, switch="restart", loop="region"),
    page("bs1116", reference={"f": "a"}),
    page("abx", unforced=True, **PAIRS),
    page("ab", **PAIRS),
    page("afc", intervals=2, **PAIRS),
    page("paired_comparison", question="Which?", tie=True, **PAIRS),
    page("rating", scales=SCALES),
    page("questionnaire", questions=[
        {"name": "age", "label": {"en": "Age", "de": "Alter"}, "kind": "number", "low": 1.0, "high": 99.0},
        {"name": "plays", "label": "Plays", "kind": "choice", "choices": {"y": "yes"}, "optional": True},
        {"name": "pain", "label": "Pain", "kind": "scale"},
    ]),
    page("html"),
    page("staircase", path="b.x", start=2.0, lowest=1.0, highest=3.0),
]  # fmt: skip
TRIALS = (
    ServedTrial("tm", 2, "ra", ("sb", "sc")), ServedTrial("tg", 3, "ra", ("sb",)), ServedTrial("tx", 4, "ra", ("sb",)),
    ServedTrial("ts", 5, "ra", ("sb",)), ServedTrial("tf", 6, "ra", ("sb",)), ServedTrial("tp", 7, "ra", ("sb",)),
    ServedTrial("tr", 8, None, ("sb",)), ServedTrial("tq", 8, None, ("sc",)),
)  # fmt: skip


@pytest.fixture
def test(tmp_path: Path) -> ListeningTest:
    import soundfile

    stimuli = SimpleNamespace(fs=8000, channels=1, loudness=SimpleNamespace(target_lufs=-23.0))
    manifest: Any = SimpleNamespace(
        name="my-test", language="en", texts={}, title={"en": "Mine <x>"}, pages=PAGES, seed=3, stimuli=stimuli,
        output=SimpleNamespace(page_order="listed", key="key.json"),
    )  # fmt: skip
    made = ListeningTest(tmp_path / "batch", tmp_path, manifest, TRIALS, "hash")
    made.sound("x").parent.mkdir(parents=True)
    for code, seconds in (("ra", 0.5), ("sb", 1.0), ("sc", 0.25)):
        soundfile.write(made.sound(code), [0.0] * round(8000 * seconds), 8000)
    return made


# -- the course of a test ---------------------------------------------------------------------------------------------


def test_words_scales_and_questions_of_pages(test: ListeningTest) -> None:
    texts = test.texts("en")
    shown = {row["type"]: row for row in shown_pages(test)}
    assert [row["page"] for row in shown_pages(test)] == list(range(1, 11))
    assert words(test, PAGES[0]) == ("Hello & you", "one\n\ntwo <b>")
    assert (shown["consent"]["button"], shown["consent"]["tone"]) == (texts["consent_agree"], "")
    assert (shown["level"]["button"], shown["level"]["tone"]) == (texts["next"], "tone2.wav")
    assert (shown["paired_comparison"]["question"], shown["abx"]["question"], shown["abx"]["scales"]) == (
        "Which?",
        "",
        [],
    )
    grades = texts["mushra_scale"].split("|")
    assert shown["mushra"]["scales"] == [
        {"name": "", "label": "", "low": 0.0, "high": 100.0, "low_label": grades[0], "high_label": grades[-1]}
    ]
    assert [shown["bs1116"]["scales"][0][k] for k in ("low", "high")] == [1.0, 5.0]
    assert shown["rating"]["scales"] == [
        {"name": "dry", "label": "Dry", "low": -2.0, "high": 2.0, "low_label": "wet", "high_label": ""},
        {"name": "loud", "label": "L", "low": 0.0, "high": 100.0, "low_label": "", "high_label": ""},
    ]
    assert shown["questionnaire"]["questions"][:2] == [
        {"name": "age", "kind": "number", "low": 1.0, "high": 99.0, "optional": False, "label": "Age", "choices": {}},
        {"name": "plays", "kind": "choice", "low": 1.0, "high": 5.0, "optional": True, "label": "Plays",
         "choices": {"y": "yes"}},
    ]  # fmt: skip


def test_a_course_has_every_trial_with_its_choices(test: ListeningTest) -> None:
    rows = course(test, 1)
    assert [row["trial"] for row in rows] == [t.id for t in TRIALS]
    assert [row["page"] for row in rows] == [3, 4, 5, 6, 7, 8, 9, 9]
    assert [row["repetition"] for row in rows] == [1] * 8
    choices = {row["trial"]: row["choices"] for row in rows}
    assert (choices["tm"], choices["tx"]) == ([], ["A", "B", "undecided"])
    assert (choices["ts"], choices["tf"], choices["tp"]) == (["same", "different"], ["1", "2"], ["A", "B", "tie"])
    by_trial = {row["trial"]: row["slots"] for row in rows}
    assert sorted(by_trial["tm"]) == ["A", "B", "C", "reference"]
    assert by_trial["tm"]["reference"] == "ra"
    assert by_trial["tr"] == {"A": "sb"}
    assert codes_of(rows) == ["ra", "sb", "sc"]
    assert left_out(test, "p", (ConsentPage, MushraPage, StaircasePage), " yet") == tuple(
        f"p: page {i} ({PAGES[i - 1].type}) is left out: the export has no counterpart yet"
        for i in (2, 4, 5, 6, 7, 8, 9, 10)
    )
    last: Any = SimpleNamespace(
        manifest=SimpleNamespace(pages=[FinishPage.model_validate({"type": "finish"}), PAGES[10]])
    )
    assert left_out(last, "p", ()) == ()
    assert Exported(Path("f")).notes == ()
    check_programs(["bids", "jspsych"])
    with pytest.raises(Exception, match="--export"):
        check_programs(["bids", "other"])
    assert list(PROGRAMS) == ["webmushra", "jspsych", "psychopy", "bids"]


# -- programs ---------------------------------------------------------------------------------------------------------


def test_webmushra_s_configuration(test: ListeningTest, tmp_path: Path) -> None:
    done = write_webmushra(test, tmp_path / "out")
    assert any("answers to questions stay in its tables" in note for note in done.notes)
    config = YAML(typ="safe", pure=True).load(tmp_path / "out" / "configs" / "my-test.yaml")
    sounds = "configs/resources/my-test"
    assert config == json.loads(json.dumps(_config(test, sounds, course(test, 0))))
    consent, level, mushra, grades, abx, finish = config.pop("pages")
    assert config == {
        "testname": "Mine <x>", "testId": "my-test", "bufferSize": 2048, "stopOnErrors": True,
        "showButtonPreviousPage": False, "remoteService": "service/write.php",
    }  # fmt: skip
    assert consent == {
        "type": "consent", "id": "page1", "name": "Hello &amp; you", "content": "<p>one</p><p>two &lt;b&gt;</p>",
        "mustConsent": True,
    }  # fmt: skip
    assert (level["type"], level["id"], level["stimulus"], level["defaultVolume"]) == (
        "volume", "page2", f"{sounds}/tone2.wav", 0.5
    )  # fmt: skip
    order, trial = mushra
    assert order == "random"
    told = {
        "type": "mushra", "id": "tm-1", "showWaveform": True, "enableLooping": True, "reference": f"{sounds}/ra.wav",
        "stimuli": {c: f"{sounds}/{c}.wav" for c in ("sb", "sc")}, "createAnchor35": False, "createAnchor70": False,
        "strict": False, "randomize": True, "showConditionNames": False, "switchBack": True,
    }  # fmt: skip
    assert {key: trial[key] for key in told} == told
    assert set(trial) == {*told, "name", "content"}
    assert (grades[1]["type"], grades[1]["showWaveform"], grades[1]["enableLooping"]) == ("bs1116", False, False)
    assert "switchBack" not in grades[1]
    assert (abx[1]["type"], abx[1]["unforced"], abx[1]["id"]) == ("paired_comparison", "?", "tx-1")
    row = {"trial": "tx", "repetition": 2, "slots": {"A": "ra", "B": "sb", "X": "sb"}}
    pair = _trial(page("abx", **PAIRS), {"id": "p"}, row, "s")
    assert (pair["reference"], pair["stimuli"], pair["id"]) == ("s/sb.wav", {"ra": "s/ra.wav"}, "tx-2")
    assert "unforced" not in pair
    assert finish.pop("questionnaire") == [
        {"type": "text", "label": "Your number or name", "name": "listener"},
        {"type": "number", "label": "Age", "name": "age", "min": 1.0, "max": 99.0, "default": ""},
        {"type": "likert", "label": "Plays", "name": "plays", "response": [{"value": "y", "label": "yes"}],
         "optional": True},
        {"type": "number", "label": "Pain", "name": "pain", "min": 1.0, "max": 5.0, "default": ""},
    ]  # fmt: skip
    assert (finish["showResults"], finish["writeResults"], finish["content"]) == (False, True, "")
    files = {p.name for p in (tmp_path / "out" / sounds).iterdir()}
    assert files == {"ra.wav", "sb.wav", "sc.wav", "tone2.wav"}
    assert sum("is left out" in note for note in done.notes) == 5
    assert _html("a\n\n \n\nb") == "<p>a</p><p>b</p>"


def test_sounds_of_psychopy_follow_each_other(test: ListeningTest) -> None:
    """After half a second each, half a second apart."""
    lengths = {"ra": 0.5, "sb": 1.0, "sc": 0.25}
    assert _sequence(["ra", "sb"], lengths) == {
        "sound1": "stimuli/ra.wav", "start1": 0.5, "sound2": "stimuli/sb.wav", "start2": 1.5, "ends": 2.5
    }  # fmt: skip
    assert _sequence(["x"], {"x": 1 / 3})["ends"] == 0.833  # to the millisecond
    assert _sequence(["x", "x"], {"x": 1 / 3})["start2"] == 1.333
    rows = {row["trial"]: row for row in course(test, 0)}
    rated = _rows(test, rows["tm"], lengths)
    assert {r["stimulus"] for r in rated} == {"ra", "sb", "sc"}
    one = next(r for r in rated if r["stimulus"] == "sc")
    assert one == {
        "page": 3, "trial": "tm", "repetition": 1, "stimulus": "sc", "sound1": "stimuli/ra.wav", "start1": 0.5,
        "sound2": "stimuli/sc.wav", "start2": 1.5, "ends": 1.75,
    }  # fmt: skip
    (alone,) = _rows(test, rows["tr"], lengths)
    assert (alone["stimulus"], alone["sound1"], alone["ends"]) == ("sb", "stimuli/sb.wav", 1.5)
    (pair,) = _rows(test, rows["tx"], lengths)
    slots = rows["tx"]["slots"]
    assert {s: pair[s] for s in "ABX"} == slots
    assert pair["ends"] == pytest.approx(0.5 * 3 + sum(lengths[c] for c in slots.values()))


def test_a_dollar_is_no_code_of_psychopy(test: ListeningTest) -> None:
    """`You get $10` would have been evaluated as Python."""
    rated = page("mushra", name="$5", reference={"f": "a"})
    manifest: Any = test.manifest
    manifest.pages = [page("consent", content="You get $10"), PAGES[1], rated, *PAGES[3:]]
    texts = [p.get("val") or "" for p in _experiment(test, course(test, 0)).iter("Param") if p.get("name") == "text"]
    assert any(r"You get \$10" in text for text in texts)
    assert not any(re.search(r"^\$|[^\\]\$", text) for text in texts)  # PsychoPy's own expression for code


def test_psychopy_s_components(test: ListeningTest, tmp_path: Path) -> None:
    root = _experiment(test, course(test, 0))
    parts = {
        part.get("name"): {str(p.get("name")): (p.get("val"), p.get("valType"), p.get("updates")) for p in part}
        for routine in root.iter("Routine") for part in routine
    }  # fmt: skip
    assert parts["text1"]["text"][0] == f"Hello & you\n\none\n\ntwo <b>\n\n{test.texts('en')['consent_agree']}: space"
    assert parts["tone2"]["sound"] == ("stimuli/tone2.wav", "str", "constant")
    assert "tone1" not in parts
    assert parts["go1"]["allowedKeys"] == ("'space'", "list", "constant")
    assert parts["answer5"]["allowedKeys"][0] == "'a', 'b', 'u'"
    assert parts["answer5"]["startVal"] == ("$ends", "code", "constant")
    assert parts["text5"]["text"][0].endswith("A, B, X.  A: A  B: B  U: undecided")
    assert parts["text3"]["text"][0].endswith("\n\nRETURN: OK")
    assert "Which?" in parts["text8"]["text"][0]
    assert parts["sound5_3"]["sound"] == ("$sound3", "str", "set every repeat")
    assert parts["sound5_3"]["startVal"] == ("$start3", "code", "constant")
    assert "sound5_4" not in parts
    assert "sound3_2" in parts
    assert "sound3_3" not in parts  # reference and one sound
    assert "sound9_1" in parts
    assert "sound9_2" not in parts
    assert parts["rate9_dry"]["ticks"][0] == "(-2.0, 2.0)"
    assert parts["rate9_dry"]["labels"][0] == "['Dry: wet', '2']"
    assert parts["rate9_loud"]["labels"][0] == "['L: 0', '100']"
    assert (parts["rate9_dry"]["pos"][0], parts["rate9_loud"]["pos"][0]) == ("(0, -0.1)", "(0, -0.2)")
    assert "rate3_points" in parts
    loops = {e.get("name"): {str(p.get("name")): p.get("val") for p in e} for e in root.iter("LoopInitiator")}
    assert list(loops) == [f"trials{i}" for i in range(3, 10)]
    assert loops["trials5"]["conditionsFile"] == "$'conditions/course' + expInfo['course'] + '_page5.csv'"
    assert (loops["trials5"]["nReps"], loops["trials5"]["loopType"]) == ("1", "sequential")
    done = write_psychopy(test, tmp_path / "out")
    assert [note for note in done.notes if "one at a time" in note] == [
        f"psychopy: page {i}: its sounds are rated one at a time after the reference" for i in (3, 4)
    ]
    with (tmp_path / "out" / "conditions" / "course2_page3.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    assert sorted(row["stimulus"] for row in rows) == ["ra", "sb", "sc"]
    assert len(list((tmp_path / "out" / "conditions").iterdir())) == 20 * 7
    assert (tmp_path / "out" / "my-test.psyexp").read_text().startswith("<?xml version='1.0' encoding='utf-8'?>")
    assert ET.parse(tmp_path / "out" / "my-test.psyexp").getroot().get("version") == "2025.1.0"


def test_jspsych_s_data(test: ListeningTest, tmp_path: Path) -> None:
    write_jspsych(test, tmp_path / "out")
    text = (tmp_path / "out" / "test.js").read_text()
    data = json.loads(text.removeprefix("const TEST = ").removesuffix(";\n"))
    assert (data["name"], len(data["courses"]), len(data["pages"])) == ("my-test", 20, 10)
    assert data["courses"][4] == course(test, 4)
    texts = test.texts("en")
    assert len(data["texts"]) == 11
    assert all(data["texts"][key] == texts[key] for key in data["texts"])
    html = (tmp_path / "out" / "index.html").read_text()
    assert "<title>Mine &lt;x&gt;</title>" in html
    assert '<html lang="en">' in html
    sources = [line.split('"')[1] for line in html.splitlines() if line.startswith("<script")]
    assert [s.rpartition("/")[2] for s in sources] == ["index.browser.min.js"] * 3 + ["test.js", "tonewood.js"]
    package = json.loads((tmp_path / "out" / "package.json").read_text())
    assert package["private"] is True
    assert next(iter(package["dependencies"])) == "jspsych"


def record(kind: str, **fields: Any) -> dict[str, Any]:
    slots = {"reference": "ra", "A": "sb"}
    given = {"page": 3, "type": kind, "trial": "tm", "repetition": 2, "training": True, "slots": slots}
    return given | fields


@pytest.mark.parametrize(("listeners", "last"), [(1, "sub-01"), (9, "sub-09"), (99, "sub-99"), (100, "sub-100")])
def test_participants_are_numbered(
    test: ListeningTest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, listeners: int, last: str
) -> None:
    people = [
        SimpleNamespace(records=[record("abx", answer={"choice": "A", "seconds": 1.5})], header={"simulated": i == 0})
        for i in range(listeners)
    ]
    monkeypatch.setattr(
        "tonewood.workshop.exchange.bids.answers_of",
        lambda t: SimpleNamespace(listeners=[*people, SimpleNamespace(records=[])], left_out=()),
    )
    write_bids(test, tmp_path / "out")
    lines = (tmp_path / "out" / "participants.tsv").read_text().splitlines()
    assert (len(lines), lines[-1].split("\t")[0]) == (listeners + 1, last)
    assert [line.split("\t")[1] for line in lines[:3]] == ["simulated", "1", "0"][: len(lines)]
    first = "sub-001" if listeners > 99 else "sub-01"
    assert (tmp_path / "out" / first / "beh" / f"{first}_task-mytest_beh.tsv").exists()


def test_tables_of_bids(test: ListeningTest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    own = [
        record("mushra", answer={"ratings": {"A": 40.5}, "seconds": 3.0}),
        record("abx", answer={"choice": "B", "seconds": 1.5}, right=True, training=False),
        record("staircase", answer={"choice": "1"}, right=False, level=2.5, track=1, slots={"1": "standard"}),
        record("rating", answer={"values": {"dry": -1.0}, "seconds": 0.5}, slots={"A": "sc"}),
        record("questionnaire", answer={"values": {"plays": " two\nlines\t"}}, slots={}, trial=""),
        record("level", answer={"spl_db": 65.0}, slots={}),
        record("consent", answer={"agreed": True}, slots={}),
    ]
    listener = SimpleNamespace(records=own, header={"simulated": False})
    given = SimpleNamespace(listeners=[listener], left_out=[SimpleNamespace(reason="x.jsonl: line 3: not JSON")])
    monkeypatch.setattr("tonewood.workshop.exchange.bids.answers_of", lambda t: given)
    assert write_bids(test, tmp_path / "out").notes == ("bids: left out: x.jsonl: line 3: not JSON",)
    with (tmp_path / "out" / "sub-01" / "beh" / "sub-01_task-mytest_beh.tsv").open() as stream:
        rows = list(csv.DictReader(stream, delimiter="\t"))
    assert list(rows[0]) == list(COLUMNS)
    keys = ("type", "stim_file", "item", "response", "right", "level", "track", "response_time", "training", "slots")
    assert [[row[key] for key in keys] for row in rows] == [
        ["mushra", "sb.wav", "n/a", "40.5", "n/a", "n/a", "n/a", "3.0", "1", "reference=ra A=sb"],
        ["abx", "n/a", "n/a", "B", "1", "n/a", "n/a", "1.5", "0", "reference=ra A=sb"],
        ["staircase", "n/a", "n/a", "1", "0", "2.5", "1", "n/a", "1", "1=standard"],
        ["rating", "sc.wav", "dry", "-1.0", "n/a", "n/a", "n/a", "0.5", "1", "A=sc"],
        ["questionnaire", "n/a", "plays", "two lines", "n/a", "n/a", "n/a", "n/a", "1", "n/a"],
        ["level", "n/a", "n/a", "65.0", "n/a", "n/a", "n/a", "n/a", "1", "n/a"],
    ]
    assert {(row["page"], row["repetition"]) for row in rows} == {("3", "2")}
    files = {path.name for path in (tmp_path / "out" / "stimuli").iterdir()}
    assert files == {"ra.wav", "sb.wav", "sc.wav", "tone2.wav"}
    sidecar = json.loads((tmp_path / "out" / "task-mytest_beh.json").read_text())
    assert (sidecar["TaskName"], sidecar["TaskDescription"]) == ("my-test", "Mine <x>")
    assert sidecar["response_time"] == {"Description": COLUMNS["response_time"], "Units": "s"}
    described = json.loads((tmp_path / "out" / "dataset_description.json").read_text())
    assert (described["Name"], described["BIDSVersion"], described["DatasetType"]) == ("Mine <x>", "1.9.0", "raw")
    listener.records = []
    with pytest.raises(ListeningError, match="holds no answers; BIDS is of participants"):
        write_bids(test, tmp_path / "none")


def test_tables_have_200_million_bytes_at_most(
    test: ListeningTest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    text = "listener,page,trial,stimulus,value\na,3,tm,sb,70\n"
    monkeypatch.setattr("tonewood.workshop.exchange.answers._MOST_BYTES", len(text))
    assert len(read_answers(table(tmp_path / "t.csv", text), test).listeners) == 1
    with pytest.raises(ListeningError, match=f"is longer than the {len(text)} bytes allowed"):
        read_answers(table(tmp_path / "t.csv", text + "\n"), test)
    with pytest.raises(ListeningError, match=f"/dev/zero: is longer than the {len(text)} bytes allowed"):
        read_answers(Path("/dev/zero"), test)  # its size is 0, and it has no end
    monkeypatch.setattr("tonewood.workshop.listening.definition._MOST_BYTES", len(text))
    with pytest.raises(ListeningError, match=f"/dev/zero: is longer than the {len(text)} bytes allowed"):
        read_key(Path("/dev/zero"))


def test_each_program_is_exported_once_into_a_folder_of_its_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    written: list[Any] = []

    def write(test: Any, folder: Path) -> Exported:
        assert not folder.exists()  # an earlier export is removed
        written.append((test, folder))
        return Exported(folder, ("note",))

    for name in ("bids", "jspsych"):
        monkeypatch.setitem(PROGRAMS, name, write)
    monkeypatch.setattr("tonewood.workshop.exchange.export.load_test", lambda folder: f"test of {folder.name}")
    batch = tmp_path / "batch"
    (batch / "export" / "bids" / "old").mkdir(parents=True)
    (batch / "export" / "psychopy").mkdir()
    folders = [batch / "export" / name for name in ("jspsych", "bids")]
    assert export(batch, ["jspsych", "bids", "jspsych"]) == [Exported(folder, ("note",)) for folder in folders]
    assert written == [("test of batch", folder) for folder in folders]
    assert (batch / "export" / "psychopy").exists()
    assert export(batch, []) == []


@pytest.mark.parametrize("kind", ["link", "file"])
def test_an_earlier_export_that_stays_is_an_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str) -> None:
    """Errors were ignored: old and new sounds would have stood side by side."""
    monkeypatch.setattr("tonewood.workshop.exchange.export.load_test", lambda folder: None)
    monkeypatch.setitem(PROGRAMS, "bids", lambda test, folder: Exported(folder))
    (tmp_path / "export").mkdir()
    place = tmp_path / "export" / "bids"
    (tmp_path / "other").mkdir()
    place.symlink_to(tmp_path / "other") if kind == "link" else place.write_text("mine")
    with pytest.raises(OutputError, match="bids: cannot be removed: "):
        export(tmp_path, ["bids"])
    assert (tmp_path / "other").is_dir()


# -- answers that come in ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("index", "slots", "allowed"),
    [
        (4, {}, ["A", "B", "undecided"]),
        (5, {}, ["same", "different"]),
        (6, {"reference": "ra", "1": "ra", "2": "sb"}, ["1", "2"]),
        (7, {}, ["A", "B", "tie"]),
    ],
)
def test_choices_of_pages(index: int, slots: dict[str, str], allowed: list[str]) -> None:
    assert choices(PAGES[index], slots) == allowed
    assert (
        choices(page("abx", **PAIRS), {}) == choices(page("paired_comparison", question="?", **PAIRS), {}) == ["A", "B"]
    )


R, S = "ra", "sb"


@pytest.mark.parametrize(
    ("index", "slots", "response", "right"),
    [
        (4, {"A": R, "B": S, "X": S}, "B", True),
        (4, {"A": R, "B": S, "X": S}, "A", False),
        (4, {"A": R, "B": S, "X": S}, "undecided", False),
        (5, {"A": R, "B": R}, "same", True),
        (5, {"A": R, "B": R}, "different", False),
        (5, {"A": R, "B": S}, "different", True),
        (6, {"1": R, "2": S}, "2", True),
        (6, {"1": R, "2": S}, "1", False),
        (7, {"A": S, "B": R}, "A", None),
    ],
)
def test_right_answers(index: int, slots: dict[str, str], response: str, right: bool | None) -> None:
    assert _right(PAGES[index], TRIALS[index - 2], slots, response) is right


@pytest.mark.parametrize(
    ("index", "slots", "reason"),
    [
        (4, {"A": R, "B": S}, "has no sound in slot X"),
        (4, {"A": R, "B": R, "X": R}, "X is not one of A and B"),
        (4, {"A": R, "B": S, "X": "sc"}, "X is not one of A and B"),
        (5, {"A": R}, "has no sound in slot B"),
        (6, {"1": R}, "has no sound in slot 2"),
        (6, {"1": R, "2": S, "A": S}, "has a sound in slot A; 1, 2 are the slots of its page"),
        (5, {"A": R, "B": S, "X": R}, "has a sound in slot X; A, B are the slots of its page"),
        (6, {"1": R, "2": R}, "do not hold one other sound"),
        (6, {"1": S, "2": S}, "do not hold one other sound"),
        (7, {"A": R, "B": R}, "are not the two sounds of the trial"),
    ],
)
def test_slots_that_are_not_those_of_the_page(index: int, slots: dict[str, str], reason: str) -> None:
    with pytest.raises(ListeningError, match=reason):
        _right(PAGES[index], TRIALS[index - 2], slots, "A")


def test_limits_of_scales() -> None:
    assert _limits(PAGES[2], "x") == (0.0, 100.0, "")
    assert _limits(PAGES[3], "x") == (1.0, 5.0, "")
    assert _limits(PAGES[8], "dry") == (-2.0, 2.0, "dry")
    one = page("rating", scales=SCALES[:1])
    assert _limits(one, "") == _limits(one, "dry") == (-2.0, 2.0, "dry")
    for wrong in ("", "bright"):
        with pytest.raises(ListeningError, match="is not one of dry, loud"):
            _limits(PAGES[8], wrong)
    assert [_number(x, "k", 1.0, 2.0) for x in ("1", "2.0")] == [1.0, 2.0]
    for wrong in ("0.99", "2.01", "", "x", "nan", "inf"):
        with pytest.raises(ListeningError, match="is no number from 1 to 2"):
            _number(wrong, "k", 1.0, 2.0)


def test_ratings_are_of_sounds_of_the_trial_and_once() -> None:
    one = _TrialAnswer(TRIALS[0], 2, 1, {}, {})
    _rate(one, "sb", "", 3.0)
    _rate(one, "sb", "loud", 4.0)
    _rate(one, "ra", "", 5.0)
    assert one.ratings == {("sb", ""): 3.0, ("sb", "loud"): 4.0, ("ra", ""): 5.0}
    with pytest.raises(ListeningError, match="sb was rated before"):
        _rate(one, "sb", "", 3.0)
    with pytest.raises(ListeningError, match="'xx' is no sound of trial tm"):
        _rate(one, "xx", "", 3.0)


def test_values_and_names_of_rows() -> None:
    rated = page("rating", scales=SCALES)
    assert _values({"value": "3", "item": "dry", "rate9_dry.response": "4"}, rated) == {"dry": "3"}
    assert _values({"value": "3"}, rated) == {"": "3"}
    assert _values({"rate9_dry.response": "4", "rate9_loud.response": "", "rate9_x": "1"}, rated) == {"dry": "4"}
    row = {"email": "e", "session_uuid": "u", "participant": "p", "listener": "l"}
    for name in ("listener", "participant", "session_uuid", "email"):
        assert _who(row) == row.pop(name)
    for nobody in ("", "\u200b"):
        with pytest.raises(ListeningError, match="names no listener"):
            _who({"listener": nobody})


def test_answers_to_questions(test: ListeningTest) -> None:
    row = {"page": "10", "item": "age", "value": "41"}
    found = _questionnaire(test, row)
    assert found is not None
    assert (found["page"], found["type"], found["answer"]) == (10, "questionnaire", {"values": {"age": 41.0}})
    assert (found["training"], found["repetition"], found["slots"]) == (False, 1, {})
    text = _questionnaire(test, row | {"item": "plays", "value": "x" * 10_001})
    assert text is not None
    assert text["answer"] == {"values": {"plays": "x" * 10_000}}
    assert _questionnaire(test, row | {"item": "pain", "value": "2"})["answer"] == {"values": {"pain": 2.0}}  # type: ignore[index]
    for large in ("1e300", "-1e300"):
        assert _questionnaire(test, row | {"value": large})["answer"] == {"values": {"age": float(large)}}  # type: ignore[index]
        with pytest.raises(ListeningError, match="is no number from"):
            _questionnaire(test, row | {"value": large.replace("1", "1.1", 1)})
    for other in ({"value": ""}, {"trial": "tm"}, {"item": ""}):
        assert _questionnaire(test, row | other) is None
    for wrong in ({"page": "9"}, {"page": "0"}, {"page": "13"}, {"page": "x"}, {"item": "height"}):
        with pytest.raises(ListeningError, match="is no question of page"):
            _questionnaire(test, row | wrong)


def test_tables_of_webmushra_row_by_row(test: ListeningTest) -> None:
    trials = {trial.id: trial for trial in TRIALS}
    into: dict[Any, Any] = {}
    for name, score in (("reference", "100"), ("sb", "0")):
        row = {"session_uuid": "u", "trial_id": "tm-1", "rating_stimulus": name, "rating_score": score}
        _take_webmushra(test, "mushra", row, trials, into)
    with pytest.raises(ListeningError, match="answered before, in another session"):
        _take_webmushra(test, "mushra", row | {"session_uuid": "v", "rating_stimulus": "sc"}, trials, into)
    one = into["tm", 1]
    assert (one.repetition, one.page, one.ratings) == (1, 2, {("ra", ""): 100.0, ("sb", ""): 0.0})
    graded = {"trial_id": "tg", "rating_non_reference": "sb", "rating_reference_score": "5",
              "rating_non_reference_score": "1"}  # fmt: skip
    _take_webmushra(test, "bs1116", graded, trials, into)
    assert into["tg", 1].ratings == {("ra", ""): 5.0, ("sb", ""): 1.0}
    for key in ("rating_reference_score", "rating_non_reference_score"):
        for score in (1.0, 5.0):
            _take_webmushra(test, "bs1116", graded | {key: str(score)}, trials, ends := {})
            assert ends["tg", 1].ratings["ra" if key == "rating_reference_score" else "sb", ""] == score
        for score in (0.99, 5.01):
            with pytest.raises(ListeningError, match=f"{key}: '{score}' is no number from 1 to 5"):
                _take_webmushra(test, "bs1116", graded | {key: str(score)}, trials, {})
    for score in ("-0.1", "100.1"):
        with pytest.raises(ListeningError, match=f"rating_score: '{score}' is no number from 0 to 100"):
            _take_webmushra(
                test, "mushra", {"trial_id": "tm", "rating_stimulus": "sb", "rating_score": score}, trials, {}
            )
    for answer, choice, right in (("correct", "A", True), ("incorrect", "B", False), ("undecided", "undecided", False)):
        pair: dict[Any, Any] = {}
        _take_webmushra(test, "pair", {"trial_id": "tx-1.0", "choice_answer": answer}, trials, pair)
        given = pair["tx", 1]
        assert (given.choice, given.right, given.slots) == (choice, right, {"A": "ra", "B": "sb", "X": "ra"})
        with pytest.raises(ListeningError, match="answered before"):
            _take_webmushra(test, "pair", {"trial_id": "tx-1", "choice_answer": answer}, trials, pair)
    for count in ("2", "0", "x"):
        with pytest.raises(ListeningError, match="trial_id: "):
            _take_webmushra(test, "pair", {"trial_id": f"tx-{count}", "choice_answer": "correct"}, trials, {})
    with pytest.raises(ListeningError, match="is not one of correct"):
        _take_webmushra(test, "pair", {"trial_id": "tx", "choice_answer": "A"}, trials, {})


def test_plain_rows_one_by_one(test: ListeningTest) -> None:
    trials = {trial.id: trial for trial in TRIALS}
    into: dict[Any, Any] = {}
    asked = page("abx", unforced=True, times=1000, **PAIRS)
    test.__dict__["pages"] = (*PAGES[:4], asked, *PAGES[5:])  # a cached property
    base = {"page": "3", "trial": "tm", "repetition": "1", "seconds": "1.5"}
    _take_plain(test, base | {"stimulus": "sb", "value": "70"}, trials, into)
    _take_plain(test, base | {"stimulus": "ra", "value": "100"}, trials, into)
    one = into["tm", 1]
    assert (one.seconds, one.ratings) == (1.5, {("sb", ""): 70.0, ("ra", ""): 100.0})
    scaled = {"page": "9", "trial": "tr", "stimulus": "sb", "rate9_dry.response": "-2", "rate9_loud.response": "3"}
    _take_plain(test, scaled, trials, into)
    assert into["tr", 1].ratings == {("sb", "dry"): -2.0, ("sb", "loud"): 3.0}
    pair = {"page": "5", "trial": "tx", "A": "ra", "B": "sb", "X": "ra"}
    _take_plain(test, pair | {"response": "A", "repetition": "1"}, trials, into)
    assert (into["tx", 1].choice, into["tx", 1].right) == ("A", True)
    with pytest.raises(ListeningError, match="answered before"):
        _take_plain(test, pair | {"response": "B"}, trials, into)
    _take_plain(test, pair | {"answer5.keys": "u", "repetition": "3.0"}, trials, into)
    assert (into["tx", 3].choice, into["tx", 3].right) == ("undecided", False)
    same = {"page": "6", "trial": "ts", "A": "ra", "B": "sb", "answer6.keys": "d"}
    _take_plain(test, same, trials, into)
    assert (into["ts", 1].choice, into["ts", 1].right) == ("different", True)
    _take_plain(test, pair | {"response": "B", "repetition": "1000", "seconds": "3.2e8"}, trials, into)
    assert (into["tx", 1000].seconds, into["tx", 1000].right) == (3.2e8, False)
    for wrong, reason in (
        ({"response": "C"}, "'C' is not one of A, B, undecided"),
        ({"response": "A", "X": "zz"}, "'zz' is no sound of trial tx"),
        ({"response": "A", "page": "6"}, "is '6', and 5 is the page of trial tx"),
        ({"response": "A", "repetition": "1001"}, "from 1 to 1000"),
        ({"response": "A", "repetition": "1.5"}, "'1.5' is no repetition of a trial of this page, which asks 1000"),
        ({"response": "A", "seconds": "-1"}, "from 0 to"),
        ({"response": "A", "seconds": "3.3e8"}, "from 0 to 3.2e\\+08"),
    ):
        with pytest.raises(ListeningError, match=reason):
            _take_plain(test, pair | {"repetition": "9"} | wrong, trials, into)
    for rated, reason in (({"repetition": "2"}, "'2' is no repetition"), ({}, "value: is missing")):
        with pytest.raises(ListeningError, match=reason):
            _take_plain(test, {"page": "3", "trial": "tm", "stimulus": "sc"} | rated, trials, into)


def test_records_are_as_this_program_s_own(test: ListeningTest) -> None:
    rated = _TrialAnswer(TRIALS[0], 2, 3, {}, {("sb", ""): 7.0, ("ra", ""): 9.0}, seconds=1.5)
    assert _record(test, rated, 4) == {
        "index": 4, "page": 3, "type": "mushra", "trial": "tm", "training": False, "repetition": 3,
        "slots": {"reference": "ra", "A": "sb", "B": "ra"},
        "answer": {"seconds": 1.5, "ratings": {"A": 7.0, "B": 9.0}},
    }  # fmt: skip
    chosen = _record(test, _TrialAnswer(TRIALS[2], 4, 1, {"A": "ra"}, {}, "A", False), 0)
    assert (chosen["answer"], chosen["right"], chosen["slots"]) == ({"seconds": 0.0, "choice": "A"}, False, {"A": "ra"})
    assert "right" not in _record(test, _TrialAnswer(TRIALS[5], 7, 1, {"A": "ra"}, {}, "A"), 0)
    scaled = _record(test, _TrialAnswer(TRIALS[6], 8, 1, {}, {("sb", "dry"): 1.0}), 0)
    assert (scaled["slots"], scaled["answer"]["values"]) == ({"A": "sb"}, {"dry": 1.0})


def table(path: Path, text: str) -> Path:
    path.write_text(text)
    return path


def test_a_comma_in_a_number_does_not_change_it(test: ListeningTest, tmp_path: Path) -> None:
    """`70,5` in a table of commas is two cells; lines are counted where cells and rows have breaks, too."""
    rows = ("comment,listener,page,trial,stimulus,value", "", '"1', '2",a,3,tm,ra,100,', "", ",a,3,tm,sb,70,5")
    found = read_answers(table(tmp_path / "t.csv", "\n".join(rows)), test)
    assert [one.records[0]["answer"]["ratings"] for one in found.listeners] == [{"A": 100.0}]
    assert [one.reason.partition("t.csv: ")[2] for one in found.left_out] == [
        "line 6: '5' is a cell beyond the columns that the first row names"
    ]
    with pytest.raises(ListeningError, match=r"t\.csv: has two columns value"):
        read_answers(table(tmp_path / "t.csv", "listener,page,trial,stimulus,value,value\na,3,tm,sb,5,70\n"), test)


def test_a_listener_of_two_tables_is_one(test: ListeningTest, tmp_path: Path) -> None:
    head = "listener,page,trial,stimulus,value,item\n"
    first = read_answers(table(tmp_path / "1.csv", head + "a,3,tm,sb,70,\nb,3,tm,sb,60,\na,10,,,30,age\n"), test)
    second = read_answers(table(tmp_path / "2.csv", head + "a,4,tg,sb,3,\na,4,tg,ra,5,\na,3,tm,sb,50,\n"), test)
    found = joined([first, second])
    assert [one.listener for one in found.listeners] == ["a", "b"]
    assert [(r["index"], r["type"]) for r in found.listeners[0].records] == [
        (0, "mushra"), (1, "questionnaire"), (2, "bs1116"),
    ]  # fmt: skip
    assert found.listeners[0].records[0]["answer"]["ratings"] == {"A": 70.0}
    assert [one.reason.partition("2.csv: ")[2] for one in found.left_out] == [
        "a answered this in another table, too: 1 answer"
    ]
    assert len(joined([first, first]).listeners) == 2


def test_names_that_begin_alike_are_of_different_listeners(test: ListeningTest, tmp_path: Path) -> None:
    """Names were cut to 60 characters: two listeners became one, and of answers to one trial the first counted."""
    head, name = "listener,page,trial,stimulus,value", "p" * 60
    one, two = (
        read_answers(table(tmp_path / f"{k}.csv", f"{head}\n{name}a,3,tm,sb,70\n{name}{k},3,tm,sc,{k}0\n,,,,\n"), test)
        for k in (1, 2)
    )
    assert not one.left_out
    found = joined([one, two])
    assert [one.header["listener"][60:] for one in found.listeners] == ["a", "1", "2"]
    assert len(found.left_out) == 1
    digits = read_answers(table(tmp_path / "d.csv", f"{head}\na,3,tm,sb,70\na,3,tm,sc,{'9' * 5000}\n"), test)
    assert len(digits.left_out[0].reason.partition("d.csv: ")[2]) < 330
    nobody = read_answers(table(tmp_path / "n.csv", f"{head}\na,3,tm,sb,70\n,3,tm,sb,70\n"), test)
    assert [one.reason.partition("n.csv: ")[2] for one in nobody.left_out] == ["line 3: listener: names no listener"]


def test_a_table_is_read_by_listener(test: ListeningTest, tmp_path: Path) -> None:
    lines = (
        "listener,page,trial,stimulus,value,item", "b,4,tg,sb,3,", "b,4,tg,ra,5,", "a,3,tm,sb,70,", "a,10,,,30,age",
        "a,10,,,2,pain",
        "b,4,tg,sb,3,", "c,4,tg,sb,3,", "d,10,,,44,age", "a,1,,,,",
    )  # fmt: skip
    found = read_answers(table(tmp_path / "t.csv", "\n".join(lines)), test)
    assert [one.listener for one in found.listeners] == ["b", "a", "d"]
    assert [one.path.name for one in found.listeners] == ["t.csv#1", "t.csv#2", "t.csv#3"]
    first, second, third = (one.records for one in found.listeners)
    assert first[0]["answer"]["ratings"] == {"A": 3.0, "B": 5.0}
    assert [(r["index"], r["type"]) for r in second] == [
        (0, "mushra"), (1, "questionnaire"), (2, "questionnaire"),
    ]  # fmt: skip
    assert [(r["index"], r["answer"]) for r in third] == [(0, {"values": {"age": 44.0}})]
    assert ["line 7" in found.left_out[0].reason, len(found.left_out)] == [True, 2]
    assert "c has no grade of both sounds of trial tg" in found.left_out[1].reason
    assert found.listeners[0].header == {
        "listener": "b",
        "token": "b",
        "simulated": False,
        "started": "",
        "language": "",
    }
    beyond = read_answers(table(tmp_path / "b.csv", "\n".join([*lines[:3], "e,4,tg,sb,9,"])), test)
    assert ["'9' is no number" in one.reason for one in beyond.left_out] == [True]  # told once
    for text, reason in (
        ("page,trial\n3,tm\n", "has no column listener"),
        ("listener;page;trial\na;3;tm\n", "has ';' between its columns; commas are wanted"),
        ("listener,page,trial,value\na,3,,50\n", "line 2: trial: is missing"),
        ("listener,trial\na,tm\n", "has no column page"),
        ("listener,page\na,3\n", "has no column trial"), ("listener,page,trial\n", "holds no answers to this test$"),
    ):  # fmt: skip
        with pytest.raises(ListeningError, match=reason):
            read_answers(table(tmp_path / "w.csv", text), test)
