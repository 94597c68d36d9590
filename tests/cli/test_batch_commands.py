from __future__ import annotations

import json
from pathlib import Path

import pytest

from tonewood.cli.batch import _Bars
from tonewood.cli.main import run
from tonewood.support.yaml_io import load_yaml

EXAMPLE = Path(__file__).parents[2] / "examples" / "listening_test" / "harp_damping.yaml"


def command(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, str, str]:
    with pytest.raises(SystemExit) as ended:
        run([str(a) for a in arguments])
    printed = capsys.readouterr()
    return int(ended.value.code or 0), printed.out, printed.err


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The worked example, one short note and one stiffness."""
    data = load_yaml(EXAMPLE)
    data["scores"] = {"string4": data["scores"]["string4"]}
    data["pages"][5]["times"] = 1
    data["factors"]["stiffness"]["levels"] = {"nominal": {"scale": 1.0}}
    data["exclude"] = []
    data["repeats"] = 1
    data["render"]["tail"] = {"energy_db": -20, "cap": 0.3}
    path = tmp_path_factory.mktemp("example") / "harp.yaml"
    path.write_text(json.dumps(data))
    return path


@pytest.fixture(scope="module")
def done(small: Path) -> Path:
    out = small.parent / "out"
    with pytest.raises(SystemExit) as ended:
        run(["batch", str(small), "-o", str(out), "--jobs", "1", "--json"])
    assert ended.value.code == 0
    return out


@pytest.mark.slow
def test_the_worked_example_from_manifest_to_pages(done: Path) -> None:
    test = json.loads((done / "test.json").read_text())
    assert [t["page"] for t in test["trials"]] == [4, 4, 6, 6]
    record = json.loads((done / "manifest.json").read_text())
    assert len(record["files"]) == 2 * 4 + 2 * 2  # two anchors for each page of two pluck places
    by_condition = {f["condition"]: f["identity"]["parameters"]["body"]["damping_case"] for f in record["files"]}
    assert {name.split(".")[2]: case for name, case in by_condition.items()} == {
        "damping=complex": "complex",
        "damping=proportional": "proportional",
    }
    sounds = {f["condition"]: f["sha256"] for f in record["files"] if f["group"].startswith("page6")}
    assert len(set(sounds.values())) == 4


@pytest.mark.slow
def test_the_plan(small: Path, done: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, out, _ = command(capsys, "batch", small, "-o", small.parent / "new", "--dry-run", "--json")
    plan = json.loads(out)
    assert (code, plan["to_render"], plan["files"], plan["trials"]) == (0, 4, 12, 4)
    needed = {row["page"]: row["listeners"] for row in plan["power"]}
    assert needed[4] == pytest.approx(48, abs=3)  # 5 points of sd 12: the t test of the differences needs 48
    assert needed[6] == 38  # 76 answers, two a listener
    assert plan["predicted_seconds"] > 0
    assert not (small.parent / "new").exists()
    code, out, _ = command(capsys, "batch", small, "-o", done, "--dry-run")
    assert (code, out.splitlines()[0]) == (0, "harp.string4.damping=complex.stiffness=nominal.pluck=middle")
    assert "4 conditions: 0 to render, 4 rendered; 12 files, 4 trials" in out
    assert f"page 4, mushra: {needed[4]} listeners for 5 points, sd 12, " in out


def test_a_second_run_renders_nothing(small: Path, done: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = {p.name: p.read_bytes() for p in (done / "stimuli").iterdir()}
    code, out, _ = command(capsys, "batch", small, "-o", done, "--jobs", "1")
    assert code == 0
    assert "12 files from 0 new and 4 earlier renders" in out
    assert {p.name: p.read_bytes() for p in (done / "stimuli").iterdir()} == before


def test_a_failing_condition_sets_the_exit_code(small: Path, capsys: pytest.CaptureFixture[str]) -> None:
    data = load_yaml(small)
    data["factors"]["damping"]["levels"]["none"] = "nothing"
    data["pages"] = [{"type": "html"}]
    path = small.parent / "failing.yaml"
    path.write_text(json.dumps(data))
    code, out, err = command(capsys, "batch", path, "-o", small.parent / "failing", "--jobs", "1")
    assert code == 1
    assert "4 files" in out
    assert "failed: harp.string4.damping=none" in err
    assert "body.damping_case" in err


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (("absent.yaml", "-o", "out"), "absent.yaml: cannot be read"),
        ((EXAMPLE, "-o", EXAMPLE), f"{EXAMPLE}: would replace a file that is read"),
        ((EXAMPLE, "-o", "out", "--jobs", "0"), "--jobs: is 0;"),
        ((EXAMPLE, "-o", "out", "--workers", "elves"), "--workers: is 'elves'; processes or threads"),
    ],
)
def test_mistakes_are_one_line(arguments: tuple, line: str, capsys: pytest.CaptureFixture[str]) -> None:
    code, out, err = command(capsys, "batch", *arguments)
    assert code == 2
    assert not out
    assert line in err
    assert err.count("\n") == 1


def test_a_misspelt_factor_is_one_line(small: Path, capsys: pytest.CaptureFixture[str]) -> None:
    data = load_yaml(small)
    data["factors"]["damping"]["path"] = "body.dampingcase"
    path = small.parent / "misspelt.yaml"
    path.write_text(json.dumps(data))
    for extra in ((), ("--dry-run",)):
        code, out, err = command(capsys, "batch", path, "-o", small.parent / "misspelt", *extra)
        assert (code, out) == (2, "")
        assert err.count("\n") == 1
        assert "misspelt.yaml: no condition can be resolved: " in err
        assert "dampingcase" in err


@pytest.mark.slow
def test_a_level_that_fails_everywhere_is_one_line(small: Path, capsys: pytest.CaptureFixture[str]) -> None:
    data = load_yaml(small)
    data["factors"]["damping"]["levels"]["none"] = "nothing"
    path = small.parent / "level.yaml"
    path.write_text(json.dumps(data))
    code, _, err = command(capsys, "batch", path, "-o", small.parent / "level", "--dry-run")
    failed = [line for line in err.splitlines() if "failed" in line]
    assert code == 1
    assert len(failed) == 1
    assert "damping=none" in failed[0]
    assert "and 1 other conditions" in failed[0]


@pytest.mark.slow
def test_simulated_listeners_and_their_results(done: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("jinja2")
    code, _, err = command(capsys, "results", done)
    assert (code, err.count("\n")) == (2, 1)
    assert "answers: holds no answers" in err
    code, out, _ = command(capsys, "simulate", done, "--panel", EXAMPLE.with_name("harp_panel.yaml"), "--listeners", 6)
    assert (code, out) == (0, f"{done}: 6 simulated listeners\n")
    code, out, _ = command(capsys, "results", done)
    assert code == 0
    assert "harp_damping: 6 simulated listeners, 95 % intervals" in out
    assert "value ~ damping + pluck + damping:pluck" in out
    page = (done / "results" / "report.html").read_text()
    assert "simulated listeners" in page
    assert "loudness BS.1770, LUFS" in page
    assert {p.name for p in (done / "results").glob("*.csv")} == {"answers.csv", "means.csv"}
    code, out, _ = command(capsys, "results", done, "--json", "--confidence", "0.9")
    found = json.loads(out)
    assert (found["simulated"], found["confidence"], len(found["pages"])) == (6, 0.9, 2)
    for arguments in (("--confidence", "2"), ("--key", done / "test.json"), ("--key", "gone.json")):
        code, _, err = command(capsys, "results", done, *arguments)
        assert (code, err.count("\n")) == (2, 1)


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (("gone",), "gone/test.json: cannot be read: No such file or directory; `tonewood batch` writes it"),
        ((".", "--port", "70000"), "--port: is 70000"),
        ((".", "--host", " "), "--host: is empty"),  # it was listened at all interfaces
        ((".", "--name", "https://test.example"), "--name: is 'https://test.example'; a name or an address alone"),
        ((".", "--name", "test.example:80"), "--name: is 'test.example:80'"),
        ((".", "--name", "[::1]"), "test.json: cannot be read"),
    ],
)
def test_mistakes_of_serve_are_one_line(arguments: tuple, line: str, capsys: pytest.CaptureFixture[str]) -> None:
    code, _, err = command(capsys, "serve", *arguments)
    assert code == 2
    assert line in err
    assert err.count("\n") == 1


def test_progress_goes_to_a_log_where_there_is_no_terminal(capsys: pytest.CaptureFixture[str]) -> None:
    """A line every 15 s, and one at the end of a stage that had some; nothing of short stages."""
    now = 0.0
    bars = _Bars(lambda: now)
    for done in range(101):
        now = float(done)
        bars("renders", done, 100)
    for done in range(1, 11):
        now += 1.0
        bars("files", done, 10)
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 7
    assert lines[0] == "tonewood: renders: 15 of 100 (15 %), about 85 s to go"
    assert lines[-1] == "tonewood: renders: 100 of 100 (100 %), 100 s"


def test_schemas_of_manifests_are_printed(capsys: pytest.CaptureFixture[str]) -> None:
    for kind, key in (("test", "pages"), ("dataset", "sampling"), ("instrument", "strings")):
        with pytest.raises(SystemExit) as end:
            run(["schema", kind])
        assert end.value.code == 0
        assert key in json.loads(capsys.readouterr().out)["properties"]


def test_faults_of_a_manifest_are_a_line_each(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "m.yaml"
    text = """\
schema: tonewood-batch/1
name: two
seed: -1
instruments: {harp: african_harp}
scores: {a: {phrase: [{time: 0.0}]}}
pages:
  - {type: html}
  - {type: rating}
"""
    path.write_text(text)
    with pytest.raises(SystemExit) as end:
        run(["batch", str(path), "-o", str(tmp_path / "out")])
    assert end.value.code == 2
    lines = capsys.readouterr().err.splitlines()
    assert lines[0].startswith(f"tonewood: {path}: line 3: seed: ")
    assert lines[1] == f"tonewood: {path}: line 8: page 2.scales: is missing"
    assert len(lines) == 2


def test_exports_are_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end:
        run(["batch", "x.yaml", "-o", str(tmp_path), "--export", "qualtrics"])
    assert end.value.code == 2
    assert "--export: is 'qualtrics'; webmushra, jspsych, psychopy, bids are allowed" in capsys.readouterr().err
