from __future__ import annotations

import csv
import io
import re

import pytest

from tonewood.support.csv_text import csv_text


@pytest.mark.parametrize(
    "text",
    ["=1+2", "+1+2", "-1+2", "@SUM(A1)", "\t=1", "\r=1", "\r\n=1", "\n=1", " =1", "\0=1", "\uff1d1+2", "-",
     "+cmd|' /C calc'!A0"],
)  # fmt: skip
def test_a_formula_becomes_text(text: str) -> None:
    for columns, row in (([text], {text: "x"}), (["a"], {"a": text})):
        rows = list(csv.reader(io.StringIO(csv_text(columns, [row]), newline="")))
        assert len(rows) == 2
        (cell,) = rows[0] if columns == [text] else rows[1]
        assert cell.startswith("'")
        plain = text.replace("\r", "\n").replace("\n\n", "\n")
        assert cell.replace("'", "").splitlines() == plain.replace("'", "").splitlines()


@pytest.mark.parametrize(
    "text", ["a;=1+1", "x\t=cmd|' /C calc'!A0", "a\n=1", "a\r\n+1+1", "a; =1;@b", "a;\t-x", "\t=1", ";=1"]
)
@pytest.mark.parametrize("separator", ["\t", ";", ",;\t"])
def test_no_separator_makes_a_formula_of_a_part(text: str, separator: str) -> None:
    """Spreadsheets of some countries split at semicolons only, imports may split at several characters."""
    table = csv_text(["listener", "answer"], [{"listener": "P07", "answer": text}])
    for line in table.splitlines():
        for part in re.split(f"[{separator}]", line):
            assert not part.lstrip(' "').startswith(("=", "+", "-", "@"))


def test_numbers_and_other_texts_stay_as_they_are() -> None:
    row = {
        "a": -1.5,
        "b": "-12.5",
        "c": "+3e2",
        "d": 'said "=1", and',
        "e": "d1=2",
        "f": True,
        "g": "ä\r\nb",
        "i": "a; -5; b",
    }
    rows = list(csv.reader(io.StringIO(csv_text([*row, "h"], [row]), newline="")))
    assert rows[0] == [*row, "h"]
    assert rows[1] == ["-1.5", "-12.5", "+3e2", 'said "=1", and', "d1=2", "True", "ä\nb", "a; -5; b", ""]
