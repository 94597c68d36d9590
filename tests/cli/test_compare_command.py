"""``tonewood compare`` and ``tonewood report``: options, output, and refusals in one line."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest

Run = Callable[..., tuple[int, str, str]]
QUICK = ("--fs", 16000, "--duration", 0.2)


@pytest.mark.slow
def test_variants_are_compared_with_the_first(tonewood: Run) -> None:
    variant = "strings.A2.tension=50; strings.A2.loss.sigma0={scale: 2}"
    code, out, err = tonewood(
        "compare", "monochord", "--variant", variant, "--set", "tuning.hold=tension", *QUICK, "--json"
    )
    assert (code, err) == (0, "")
    found = json.loads(out)
    assert found["schema"] == "tonewood-compare/1"
    assert found["page"] is None
    assert [i["changes"] for i in found["instruments"]] == [
        ["tuning.hold=tension"],
        ["tuning.hold=tension", "strings.A2.tension=50", "strings.A2.loss.sigma0={scale: 2}"],
    ]
    assert {row["key"]: row["values"] for row in found["parameters"]} == {
        "strings.A2.tension": [58.8, 50.0],
        "strings.A2.loss.sigma0": [0.6, 1.2],
    }
    assert [i["strings"][0]["tension"] for i in found["instruments"]] == [58.8, 50.0]


@pytest.mark.slow
def test_a_sweep_has_a_row_for_each_value(tonewood: Run) -> None:
    sweep = (
        "--sweep",
        "strings.A2.tension=50:60:3",
        "--set",
        "tuning.hold=tension",
        "--variant",
        "strings.A2.tension=70",
    )
    code, out, _ = tonewood("compare", "monochord", *sweep, "--name", "high", *QUICK)
    assert code == 0
    assert "B: high (monochord; " in out
    rows = [line.split()[0] for line in out.splitlines() if " LUFS" in line]
    assert rows == ["50", "55", "58.8", "60", "70"]
    code, out, _ = tonewood("compare", "monochord", *sweep, *QUICK, "--json")
    found = json.loads(out)
    assert found["sweep"]["key"] == "strings.A2.tension"
    assert [row["value"] for row in found["sweep"]["rows"]] == [50, 55, 58.8, 60, 70]
    assert all("times" in row for rows in found["changes"] for row in rows)


@pytest.mark.slow
def test_a_report_is_printed_and_written(tonewood: Run, tmp_path: Path) -> None:
    page = tmp_path / "monochord.html"
    code, out, err = tonewood("report", "monochord", *QUICK, "--notes", "A2", "-o", page)
    assert (code, err) == (0, "")
    assert "wolf notes, the worst first" in out
    assert out.endswith(f"page: {page}\n")
    text = page.read_text(encoding="utf-8")
    assert text.startswith("<!DOCTYPE html>")
    assert text.count("<audio") == 1


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("compare", "monochord"), "another one, --variant or --sweep is wanted"),
        (("compare", "monochord", "clavichord", "--name", "stiff"), "--name: 1 names for 0 variants"),
        (
            ("compare", "monochord", "--sweep", "strings.A2.tension=50:60"),
            "PATH=LOW:HIGH:COUNT, LOW below HIGH, is allowed",
        ),
        (("compare", "monochord", "--sweep", "strings.A2.tension=50:60:9"), "--sweep: has 9 values; 2 to 5"),
        (("compare", "monochord", "nothing"), "instrument 'nothing': is neither installed nor a folder"),
        (("compare", "monochord", "--variant", "strings.A2"), "is not PATH=VALUE"),
        (("compare", "monochord", "--variant", " ; "), "--variant: is ' ; '; PATH=VALUE[;...], each path once"),
        (("compare", "monochord", "--variant", "strings.A2.tension=50; strings.A2.tension=60"), "each path once"),
        (("compare", "monochord", "--variant", "strings.B2.note=C3"), "there is no 'B2'"),
        (("report", "monochord", "--notes", ","), "--notes: is empty"),
        (("report", "monochord", "--notes", "E9"), "--notes E9: no string plays E9"),
        (("report", "monochord", "-o", "page.pdf"), "a name ending in .html is allowed"),
        (("report", "monochord", "-o", "nowhere/page.html"), "there is no folder 'nowhere'"),
        (("report", "monochord", "--duration", 0), "--duration: is 0 s"),
        (("report", "monochord", "--velocity", 128), "--velocity: is 128"),
        (("report", "monochord", "--fs", 1), "--fs: is 1 Hz"),
    ],
)
def test_refusals(tonewood: Run, arguments: tuple[object, ...], said: str) -> None:
    code, out, err = tonewood(*arguments)
    assert (code, out) == (2, "")
    assert err.count("\n") == 1
    assert said in err


def test_extras_that_are_missing_are_named_before_any_work(tonewood: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    import importlib.util

    find = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None if name == "jinja2" else find(name))
    code, _, err = tonewood("report", "monochord", "-o", "page.html")
    assert code == 2
    assert "pip install 'tonewood[report]'" in err
