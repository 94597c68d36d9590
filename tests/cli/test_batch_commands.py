from __future__ import annotations

import csv
import json
from pathlib import Path

import pytest

from tonewood.cli.main import run
from tonewood.yaml_io import load_yaml

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


def test_the_worked_example_from_manifest_to_pages(done: Path) -> None:
    experiment = load_yaml(done / "serve" / "webmushra.yaml")
    assert [p["type"] for p in experiment["pages"]] == ["mushra"] * 2 + ["paired_comparison"] * 2 + ["finish"]
    record = json.loads((done / "manifest.json").read_text())
    assert len(record["files"]) == 2 * 4
    by_condition = {f["condition"]: f["identity"]["parameters"]["body"]["damping_case"] for f in record["files"]}
    assert {name.split(".")[2]: case for name, case in by_condition.items()} == {
        "damping=complex": "complex",
        "damping=proportional": "proportional",
    }
    sounds = {f["condition"]: f["sha256"] for f in record["files"] if f["group"].startswith("page2")}
    assert len(set(sounds.values())) == 4
    assert "audio controls" in (done / "audition.html").read_text()


def test_the_plan(small: Path, done: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, out, _ = command(capsys, "batch", small, "-o", small.parent / "new", "--dry-run", "--json")
    plan = json.loads(out)
    assert (code, plan["to_render"], plan["files"], plan["trials"]) == (0, 4, 8, 4)
    assert plan["predicted_seconds"] > 0
    assert not (small.parent / "new").exists()
    code, out, _ = command(capsys, "batch", small, "-o", done, "--dry-run")
    assert (code, out.splitlines()[0]) == (0, "harp.string4.damping=complex.stiffness=nominal.pluck=middle")
    assert "4 conditions: 0 to render, 4 rendered; 8 files, 4 trials" in out


def test_a_second_run_renders_nothing(small: Path, done: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = {p.name: p.read_bytes() for p in (done / "serve" / "stimuli").iterdir()}
    code, out, _ = command(capsys, "batch", small, "-o", done, "--jobs", "1")
    assert code == 0
    assert "8 files from 0 new and 4 earlier renders" in out
    assert {p.name: p.read_bytes() for p in (done / "serve" / "stimuli").iterdir()} == before


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
        ((EXAMPLE, "-o", EXAMPLE), f"{EXAMPLE}: cannot be made: "),
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


def test_results(done: Path, capsys: pytest.CaptureFixture[str]) -> None:
    key = json.loads((done / "key.json").read_text())
    table = done.parent / "mushra.csv"
    with table.open("w", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(
            ["session_test_id", "listener", "trial_id", "rating_stimulus", "rating_score", "rating_time", "comment"]
        )
        for listener, score in (("1", 60), ("2", 70), ("3", 80)):
            for trial, entry in key["trials"].items():
                if entry["type"] == "mushra":
                    marks = {**dict.fromkeys(entry["stimuli"], score), "reference": 100 if listener != "3" else 40}
                    for name, mark in marks.items():
                        writer.writerow(["harp_damping", listener, trial, name, mark, 1, ""])
    code, out, err = command(capsys, "results", table, "--key", done / "key.json")
    assert code == 0
    assert "2 of 3 listeners" in out
    assert "damping=proportional: 65.00 [1.47, 128.53]" in out  # 65 -+ 12.7062 * 7.0711 / sqrt(2)
    assert "3 is left out: hidden reference below 90 in 2 of 2 trials" in err
    assert table.with_suffix(".png").exists()
    code, out, _ = command(capsys, "results", table, "--key", done / "key.json", "--no-screening", "--json")
    found = json.loads(out)
    assert [m["mean"] for m in found["overall"]] == [70.0, 80.0]
    code, _, err = command(capsys, "results", table, "--key", table)
    assert (code, err.count("\n")) == (2, 1)
