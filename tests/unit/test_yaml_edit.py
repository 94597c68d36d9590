"""An edit of a YAML file changes the value that it names and no other byte."""

from __future__ import annotations

import pytest

from tonewood.errors import TonewoodError
from tonewood.support.yaml_edit import Edit, apply_edits, edit_text
from tonewood.support.yaml_io import parse_yaml

OUT = Edit("render.precision", None, "remove render.precision")


@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        ("schema: a/1   # why\nx: 2e11\n", "schema: a/2   # why\nx: 2e11\n"),
        ("x: 1\nschema: 'a/1'", "x: 1\nschema: a/2"),
        ("\ufeffx: 1\r\nschema: a/1 # c\r\n", "\ufeffx: 1\r\nschema: a/2 # c\r\n"),
        ("{x: 1, schema: a/1}\n", "{x: 1, schema: a/2}\n"),
        ('{"schema":"a/1","x":[1.0]}', '{"schema":a/2,"x":[1.0]}'),
    ],
)
def test_a_value_is_replaced(text: str, wanted: str) -> None:
    assert edit_text(text, [Edit("schema", "a/2", "")]) == wanted


@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        ("render: {fs: 48000, precision: f64, effects: all}  # c\n", "render: {fs: 48000, effects: all}  # c\n"),
        ("render: {fs: 48000, precision: f64}\n", "render: {fs: 48000}\n"),
        ("render: {precision: f64}\nx: 1\n", "render: {}\nx: 1\n"),
        ("render:\n  {fs: 1,\n   precision: f32, # a\n   e: 3}\n", "render:\n  {fs: 1,\n   e: 3}\n"),
        ("render:\n  # b\n  fs: 1\n  precision: f32  # c\n  # a\n  e: 2\n", "render:\n  # b\n  fs: 1\n  # a\n  e: 2\n"),
        ("render:\n  fs: 1\n  precision: f32\n\nx: 1", "render:\n  fs: 1\n\nx: 1"),
        ("render:\r\n  precision: f32\r\n  fs: 1\r\n", "render:\r\n  fs: 1\r\n"),
        ("x: 1\nrender:\n  fs: 1\n  precision: f32", "x: 1\nrender:\n  fs: 1\n"),
        ('render:\n  precision: "f32"  # why\n# d\nx: 1\n', "render:\n  {}  # why\n# d\nx: 1\n"),
    ],
)
def test_a_key_is_removed(text: str, wanted: str) -> None:
    assert edit_text(text, [OUT]) == wanted
    assert parse_yaml(wanted) == apply_edits(parse_yaml(text), [OUT])


def test_several_edits() -> None:
    text = "schema: a/1\nrender: {precision: f32, fs: 1}\n"
    assert edit_text(text, [Edit("schema", "a/2", ""), OUT]) == "schema: a/2\nrender: {fs: 1}\n"


def test_what_cannot_be_edited_is_left_alone() -> None:
    text = "render:\n  ? precision\n  : f32\n"  # the only key, written the long way
    with pytest.raises(TonewoodError, match=r"m\.yaml: cannot be rewritten automatically; remove render\.precision by"):
        edit_text(text, [OUT], file="m.yaml")
