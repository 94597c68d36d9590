from __future__ import annotations

import json
import pickle
from pathlib import Path

import pytest

from tonewood.errors import BundleError, TonewoodError
from tonewood.support import cache_folder
from tonewood.support.yaml_io import load_yaml, located, parse_yaml
from tonewood.support.yaml_parser import MAX_DEPTH


def test_yaml_1_2_scalars() -> None:
    text = """
a: 2e11
b: 57e-6
c: no
d: on
e: 0x1F
f: null
g: true
h: 012
i: '1'
j: -1
k: [1, {l: 2.5}]
m: E2
"""
    wanted = {"a": 2e11, "b": 57e-6, "c": "no", "d": "on", "e": 31, "f": None, "g": True}
    assert parse_yaml(text) == wanted | {"h": 12, "i": "1", "j": -1, "k": [1, {"l": 2.5}], "m": "E2"}


@pytest.mark.parametrize(
    ("text", "place", "words"),
    [
        ("a: 1\nb: &x 2\n", "line 2", "anchor &x"),
        ("a: &x {b: 1}\nc: *x\n", "line 1", "anchor &x"),
        ("a: 1\nc: *x\n", "line 2", "alias *x"),
        ("a: 1\n\nc: {<<: {b: 1}}\n", "line 3", "merge key"),
        ("a: !!python/object:os.system ls\n", "line 1", "tag"),
        ("a: !mine 1\n", "line 1", "tag"),
        ("a: !!float 1\n", "line 1", "tag"),
        ("a: 1\nb: 2\na: 3\n", "line 3", "key a stands twice"),
        ("a: {c: 1, c: 1}\n", "line 1", "key c stands twice"),
        ("a: {1: 2}\n", "line 1", "key 1 is not a word"),
        ("a: {true: 2}\n", "line 1", "key true is not a word"),
        ("? [1, 2]\n: 3\n", "line 1", "is not a word"),
        ("a: 2024-01-01\n", "line 1", "date"),
        ("%YAML 1.1\n---\na: yes\n", "line", "YAML 1.2"),
        ("a: 1\n---\nb: 2\n", "line 2", "another document"),
        ("a: [1, 2\nb: 3\n", "line 2", ""),
        ('a: 1\nb: "\\ud83d"\n', "line 2", "half a surrogate pair"),
        ('a: {b: ["x\\udfb8 y"]}\n', "line 1", "half a surrogate pair"),
        ('"\\ud800": 1\n', "line 1", "half a surrogate pair"),
        ('a: 1\nb: "x\\e[31m"\n', "line 2", "control character U+001B is not allowed"),
        ('"\\x9b31m": 1\n', "line 1", "control character U+009B is not allowed"),
        ('a: "\\uffff"\n', "line 1", "control character U+FFFF is not allowed"),  # YAML and XML have none
        ("a: .nan\n", "a", "finite"),
        ("a: {b: [0, 1e999]}\n", "a.b.1", "finite"),
        ("- 1\n", "", "a list; a mapping"),
        ("", "", "nothing; a mapping"),
        ("word\n", "", "a mapping"),
        ("a: \x07\n", "", "not YAML"),
        ("a: " + "9" * 5000 + "\n", "", "not YAML"),
        ("[" * 50_000, "line 1", f"deeper than the {MAX_DEPTH}"),
        ("a: " + "{b: " * (MAX_DEPTH + 1) + "1" + "}" * (MAX_DEPTH + 1), "line 1", "deeper"),
    ],
)
def test_refusals_are_one_line_with_a_place(text: str, place: str, words: str) -> None:
    with pytest.raises(TonewoodError) as caught:
        parse_yaml(text, file="x.yaml")
    line = str(caught.value)
    assert line.startswith("x.yaml: " + place)
    assert words in line
    assert "\n" not in line
    assert str(pickle.loads(pickle.dumps(caught.value))) == line


def test_pairs_of_escapes_that_json_writes_are_one_character() -> None:
    text = json.dumps({"a": "\U0001f3b8 in E", "\U0001f3b8": ["é"]})
    assert "\\ud83c\\udfb8" in text
    assert parse_yaml(text) == json.loads(text)


def test_files(tmp_path) -> None:
    good = tmp_path / "good.yaml"
    good.write_bytes(b"\xef\xbb\xbfname: harp\n")
    assert load_yaml(good) == {"name": "harp"}
    good.write_bytes(b"a: " + b"x" * 100)
    with pytest.raises(BundleError, match="longer than the 50 bytes"):
        load_yaml(good, max_bytes=50, error=BundleError)
    good.write_bytes(b"a: \xff\n")
    with pytest.raises(TonewoodError, match=r"byte 3 \(line 1\) is not UTF-8"):
        load_yaml(good)
    with pytest.raises(TonewoodError, match="cannot be read"):
        load_yaml(tmp_path / "absent.yaml")
    with pytest.raises(TonewoodError, match="cannot be read"):
        load_yaml(tmp_path)


PLACES = """\
schema: x
strings:
  defaults:
    loss: {law: sigma}
  A2:
    length: 1
    note:
      A2
outputs:
  - {name: air}
  - name: bridge
    at: body
"""


@pytest.mark.parametrize(
    ("key", "line"),
    [
        ("schema", 1), ("strings.A2.length", 6), ("strings.A2.note", 7), ("strings.A2.missing", 5), ("strings.B2", 2),
        ("strings.A2.loss.law", 4), ("outputs.0.name", 10), ("outputs.bridge.at", 12), ("outputs.1", 11),
        ("nothing.here", None), ("--option", None),
    ],
)  # fmt: skip
def test_errors_find_the_line_of_their_key(tmp_path: Path, key: str, line: int | None) -> None:
    file = tmp_path / "a.yaml"
    file.write_text(PLACES)
    fault = located(BundleError("is wrong", file=file, key=key))
    assert (fault.line, fault.key, type(fault)) == (line, key, BundleError)
    assert str(fault) == f"{file}: {f'line {line}: ' if line else ''}{key}: is wrong"
    assert str(pickle.loads(pickle.dumps(fault))) == str(fault)
    file.write_text("a: [")
    assert located(BundleError("is wrong", file=file, key=key)).line is None


def test_values_that_are_kept_are_those_of_the_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TONEWOOD_CACHE", str(tmp_path / "kept"))
    file = tmp_path / "a.yaml"
    file.write_text("a: [1, 2.5e-300, true, null, no, 'x', {b: -0.0}]\n" + "# long enough\n" * 100)
    first = load_yaml(file)
    (kept,) = (tmp_path / "kept").iterdir()
    again = load_yaml(file)
    assert again == first == parse_yaml(file.read_text())
    assert [type(x) for x in again["a"]] == [type(x) for x in first["a"]]
    key = kept.read_bytes().split()[2].decode()
    cache_folder.keep("yaml", key, b'{"a": 5}')
    assert load_yaml(file) == {"a": 5}  # it is read
    file.write_text(file.read_text().replace("2.5e-300", "3.5"))
    assert load_yaml(file)["a"][1] == 3.5
    monkeypatch.setenv("TONEWOOD_CACHE", "off")
    assert load_yaml(file)["a"][1] == 3.5
    file.write_text("a: &anchor 1\n" + "# long enough\n" * 100)
    with pytest.raises(TonewoodError, match="anchor"):
        load_yaml(file)
