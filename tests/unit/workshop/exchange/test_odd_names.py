"""Names and texts that other programs take for something else, in exports of listening tests."""

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
from decimal import Decimal
from http.server import SimpleHTTPRequestHandler
from importlib.resources import files
from pathlib import Path
from queue import Queue
from typing import Any

import pytest
from ruamel.yaml import YAML

sys.path.append(str(Path(__file__).parents[1] / "listening"))
import listening_fakes as fakes

from browser import CHROMEDRIVER, CHROMIUM, answering, driven
from tonewood.errors import TonewoodError
from tonewood.workshop.exchange import course, webmushra
from tonewood.workshop.exchange.answers import read_answers
from tonewood.workshop.exchange.export import export
from tonewood.workshop.listening.definition import ListeningTest

#: a folder with webMUSHRA
WEBMUSHRA = os.environ.get("TONEWOOD_WEBMUSHRA")
LONG = " ".join(f'it\'s {i}: "x" # {{y}}' for i in range(40))
SCALES = [
    {"name": "dull-bright", "label": "B", "low": 123456789.0, "high": 123456790.0},
    {"name": "dull_bright", "label": "C", "low": 0.1234567891, "high": 1.0},
    {"name": "1st+2nd", "label": "D"},
]
QUESTIONS = [
    {"name": "listener", "label": LONG, "optional": True},
    {"name": "a+b", "label": "A\u2028B\nC", "kind": "number"},
    {"name": "1st", "label": "x", "kind": "choice", "choices": {"much": "a <lot>", "little": "little"}},
]


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> ListeningTest:
    pages = [
        {"type": "instructions", "name": LONG, "content": f"{LONG}\n\ntwo\nlines"},
        {"type": "mushra", "group_by": ["pluck"], "reference": {"damping": "complex"}},
        {"type": "rating", "scales": SCALES},
        {"type": "questionnaire", "questions": QUESTIONS},
    ]
    test = fakes.made(tmp_path_factory.mktemp("odd"), pages, title="Bows & strings")
    export(test.folder, ["webmushra", "psychopy"])
    return test


def test_identifiers_are_different_and_begin_with_a_letter() -> None:
    assert course.identifiers(["a", "a+b", "a_b", "a-b", "1", "listener", "q1"]) == [
        "a", "a_b_", "a_b", "a_b__", "q1_", "listener", "q1"
    ]  # fmt: skip
    assert course.identifiers(["listener", "listener"]) == ["listener", "listener_"]


def test_webmushra_s_reader_of_yaml_gets_one_value_a_line(made: ListeningTest) -> None:
    """As in its own configs/default.yaml: a list in a list begins on its own line, and no text goes on on the next."""
    text = (made.folder / "export" / "webmushra" / "configs" / "damping.yaml").read_text("utf-8")
    line = re.compile(r"(  )*(-|\w+:)( (\"([^\"\\]|\\[\"\\])*\"|-?[\d.]+|true|false))?")
    assert [one for one in text.split("\n")[:-1] if not line.fullmatch(one)] == []
    assert not set(text) & set("\u2028\u2029\x85\t\r")
    config = YAML(typ="safe", pure=True).load(text)
    first, rated, finish = config["pages"]
    assert config["testname"] == "Bows & strings"  # it is shown as text, and pages as HTML
    assert (first["name"].count("&#x27;"), first["content"].count("<p>")) == (40, 2)
    assert first["content"].endswith("<p>two lines</p>")
    assert (rated[0], {page["type"] for page in rated[1:]}) == ("random", {"mushra"})
    asked = {one["name"]: one for one in finish["questionnaire"]}
    assert list(asked) == ["listener", "listener_", "a_b", "q1st"]
    assert [one.get("optional", False) for one in asked.values()] == [False, True, False, False]
    assert (asked["a_b"]["label"], asked["a_b"]["default"]) == ("A B C", "")
    assert asked["q1st"]["response"] == [
        {"value": "much", "label": "a &lt;lot&gt;"}, {"value": "little", "label": "little"}
    ]  # fmt: skip


@pytest.mark.parametrize("fault", [KeyboardInterrupt(), OSError(28, "No space left on device")])
def test_no_part_of_an_export_is_left(
    made: ListeningTest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fault: BaseException
) -> None:
    """The texts are written before the sounds; the third sound cannot be."""
    folder = shutil.copytree(made.folder, tmp_path / "test")
    original, copied = shutil.copyfile, []

    def copy(source: Path, target: Path) -> None:
        copied.append(target)
        if len(copied) == 3:
            raise fault
        original(source, target)

    monkeypatch.setattr(shutil, "copyfile", copy)
    with pytest.raises(KeyboardInterrupt if isinstance(fault, KeyboardInterrupt) else TonewoodError):
        export(folder, ["psychopy", "webmushra"])
    assert len(copied) == 3
    assert not (folder / "export" / "psychopy").exists()


def test_lines_of_yaml_are_the_configuration() -> None:
    value = {"a": ["random", {"b": 1.5, "c": {}, "d": []}], "e": True, "f": {"g": 'x: "y" \\ # z'}, "h": 1e-7}
    assert YAML(typ="safe", pure=True).load("\n".join(webmushra._yaml(value))) == value


def test_scales_of_psychopy_are_names_of_python_with_their_own_ends(made: ListeningTest, tmp_path: Path) -> None:
    """And the columns of its table are read back under the scales' own names."""
    folder = made.folder / "export" / "psychopy"
    sliders, labels = dict[str, Any](), dict[str, list[str]]()
    for slider in ET.parse(folder / "damping.psyexp").iter("SliderComponent"):
        params = {p.get("name"): p.get("val", "") for p in slider.iter("Param")}
        sliders[slider.get("name", "")] = params["ticks"]
        labels[slider.get("name", "")] = ast.literal_eval(params["labels"])
    assert labels["rate3_dull_bright_"] == ["B: 123456789", "123456790"]  # the words of the scale, too
    assert labels["rate3_q1st_2nd"] == ["D: 0", "100"]
    assert all(name.isidentifier() for name in sliders)
    ends = {name: tuple(map(float, ticks.strip("()").split(","))) for name, ticks in sliders.items()}
    assert [ends[f"rate3_{name}"] for name in ("dull_bright_", "dull_bright", "q1st_2nd")] == [
        (123456789.0, 123456790.0), (0.1234567891, 1.0), (0.0, 100.0)
    ]  # fmt: skip
    with (folder / "conditions" / "course1_page3.csv").open(encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    answers = {"rate3_dull_bright_": 123456789.25, "rate3_dull_bright": 0.5, "rate3_q1st_2nd": 7.0}
    cells = {f"{name}.response": value for name, value in answers.items()}
    with (tmp_path / "psychopy.csv").open("w", newline="", encoding="utf-8") as stream:
        writer = csv.DictWriter(stream, ["participant", *rows[0], *cells])
        writer.writeheader()
        writer.writerows({"participant": "p", **row, **cells} for row in rows)
    found = read_answers(tmp_path / "psychopy.csv", made)
    assert found.left_out == ()
    (listener,) = found.listeners
    assert len(listener.records) == len(rows)
    for record in listener.records:
        assert record["answer"]["values"] == {"dull-bright": 123456789.25, "dull_bright": 0.5, "1st+2nd": 7.0}


@pytest.mark.parametrize(("part", "kind"), [("questions", "questionnaire"), ("scales", "rating")])
def test_a_name_that_stands_twice_is_refused(tmp_path: Path, part: str, kind: str) -> None:
    """Answers stand under these names: the second answer would replace the first."""
    entries = [{"name": name, "label": "x"} for name in ("a", "b", "a", "A")]
    with pytest.raises(TonewoodError, match=rf"page 1\.{part}: a stands there twice$"):
        fakes.made(tmp_path, [{"type": kind, part: entries}])


@pytest.mark.skipif(shutil.which("node") is None, reason="needs node")
def test_no_field_of_jspsych_is_answered_before_it_is_touched() -> None:
    """A slider always has a value, so that its answer comes from the number beside it."""
    script = (files("tonewood.workshop.exchange") / "static/tonewood.js").read_text("utf-8")
    question = {"name": "pain", "label": "Pain", "kind": "scale", "low": 1, "high": 5, "optional": False}
    test = {"texts": {}, "pages": [{"page": 1, "title": "", "content": "", "questions": [question]}], "courses": [[]]}
    stubs = f"""
        const TEST = {json.dumps(test)}, jsPsychModule = {{ ParameterType: {{}} }}, jsPsychSurveyHtmlForm = "form";
        const document = {{ createElement: () => ({{ append(text) {{ this.innerHTML = text; }} }}) }};
        const location = {{ search: "" }};
        const initJsPsych = () => ({{ run: pages => console.log(pages[0].html) }});
    """
    done = subprocess.run(["node", "-e", stubs + script], capture_output=True, text=True, timeout=60, check=True)
    slider, number = re.findall("<input[^>]*>", done.stdout)
    assert ('type="range"' in slider, "name=" in slider) == (True, False)
    for attribute in ('type="number"', 'name="pain"', 'min="1"', 'max="5"', "required"):
        assert attribute in number
    assert " value=" not in number


@pytest.mark.skipif(shutil.which("node") is None, reason="needs node")
def test_sliders_of_jspsych_reach_the_right_end_of_every_scale() -> None:
    """A browser counts steps in decimals: 100 of 0.011000000000000001 are more than 1.1, so that 1.089 was the end."""
    script = (files("tonewood.workshop.exchange") / "static/tonewood.js").read_text("utf-8")
    ends = [(0, 1.1), (0, 0.9), (-0.3, 0.6), (1, 100), (0.1, 0.8), (0, 100)]
    scales = [{"name": f"s{i}", "label": "", "low": low, "high": high} for i, (low, high) in enumerate(ends)]
    page = {"title": "", "content": "", "scales": scales}
    step = {"page": 1, "trial": 1, "repetition": 1, "slots": {"A": "x"}}
    test = {"texts": {}, "pages": [], "courses": [[]]}
    stubs = f"""
        const TEST = {json.dumps(test)}, jsPsychModule = {{ ParameterType: {{}} }}, jsPsychSurveyHtmlForm = "form";
        const put = () => ({{ append() {{}}, setAttribute() {{}}, addEventListener() {{}}, dataset: {{}} }}), made = [];
        const document = {{ createElement: () => made[made.push(put()) - 1], addEventListener() {{}} }};
        const location = {{ search: "" }}, initJsPsych = () => ({{ run: () => {{}} }});
        class Audio {{}}
    """
    shown = f"""
        new TonewoodTrial({{}}).trial(put(), {{ page: {json.dumps(page)}, step: {json.dumps(step)} }});
        console.log(JSON.stringify(made.filter(one => one.type === "range").map(one => String(one.step))));
    """
    done = subprocess.run(
        ["node", "-e", stubs + script + shown], capture_output=True, text=True, timeout=60, check=True
    )
    steps = [Decimal(step) for step in json.loads(done.stdout)]
    assert len(steps) == len(ends)
    assert [(Decimal(str(high)) - Decimal(str(low))) / step for (low, high), step in zip(ends, steps, strict=True)] == [
        100
    ] * 6


@pytest.mark.validate
@pytest.mark.skipif(
    WEBMUSHRA is None or CHROMIUM is None or CHROMEDRIVER is None, reason="TONEWOOD_WEBMUSHRA names no copy of it"
)
def test_webmushra_shows_every_page_and_sends_its_answers(made: ListeningTest, tmp_path: Path) -> None:
    """In a browser; a server stands in for its PHP."""
    folder = shutil.copytree(str(WEBMUSHRA), tmp_path / "webmushra")
    shutil.copytree(made.folder / "export" / "webmushra" / "configs", folder / "configs", dirs_exist_ok=True)
    sent: Queue[str] = Queue()

    class Server(SimpleHTTPRequestHandler):
        def __init__(self, *words: Any) -> None:
            super().__init__(*words, directory=str(folder))

        def do_POST(self) -> None:
            sent.put(self.rfile.read(int(self.headers["Content-Length"])).decode())
            self.send_response(200)
            self.end_headers()

        def log_message(self, format: str, *args: object) -> None:
            """Says nothing."""

    with answering(Server) as port, driven(1000) as browser:
        browser.open(f"http://127.0.0.1:{port}/index.html?config=damping.yaml")
        browser.until("pageManager && document.querySelector('#page_content h1, #page_content p')")
        assert browser.run("return errorHandler.getErrors()") == []
        kinds = browser.run("return pageManager.pages.map(page => page.constructor.name)")
        assert (kinds[0], set(kinds[1:-1]), kinds[-1]) == ("GenericPage", {"MushraPage"}, "FinishPage")
        browser.run("while (pageManager.getPageIndex() < pageManager.getNumPages() - 1) pageManager.nextPage();")
        browser.run("""
            document.getElementById("listener").value = "P1";
            document.getElementById("a_b").value = "40";
            document.querySelector("input[type=radio][value=much]").checked = true;
        """)
        browser.until("!document.getElementById('send_results').disabled")
        browser.run("document.getElementById('send_results').click()")
        answers = json.loads(sent.get(timeout=30).removeprefix("sessionJSON="))
    assert answers["participant"] == {
        "name": ["listener", "listener_", "a_b", "q1st"], "response": ["P1", None, "40", "much"]
    }  # fmt: skip
    assert {trial["id"].partition("-")[0] for trial in answers["trials"]} == {
        trial.id for trial in made.trials if made.pages[trial.page].type == "mushra"
    }
