"""Files in other encodings: the error names the encoding and what to do."""

from __future__ import annotations

import codecs
from pathlib import Path

import pytest

from tonewood.errors import BundleError, TonewoodError
from tonewood.instrument.contract.files import Files
from tonewood.instrument.scales import read_scl
from tonewood.sound.ensemble.mix import read_ensemble
from tonewood.support.text_files import decoded, json_value
from tonewood.support.yaml_io import load_yaml
from tonewood.workshop.batch.manifest import ManifestError, load_manifest

TEXT = "schema: tonewood-batch/1\nname: a test\n"
CODINGS = {
    "utf-16-le": "seems to be UTF-16 without a byte-order mark",
    "utf-16-be": "seems to be UTF-16 without a byte-order mark",
    "utf-32-le": "seems to be UTF-32 without a byte-order mark",
    "utf-32-be": "seems to be UTF-32 without a byte-order mark",
    "utf-16": "is UTF-16, not UTF-8: save the file as UTF-8",
    "utf-32": "is UTF-32, not UTF-8: save the file as UTF-8",
}


def refusal(raw: bytes) -> str:
    with pytest.raises(TonewoodError) as caught:
        decoded(raw, file="a.csv")
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize("coding", CODINGS)
@pytest.mark.parametrize("text", [TEXT, "a,b\n1,2\n", "e", "name: größe Ωμέγα — and so on\n"])
def test_another_encoding_is_named(coding: str, text: str) -> None:
    assert CODINGS[coding] in refusal(text.encode(coding))


@pytest.mark.parametrize("marks", [2, 3, 7])
def test_several_marks_are_counted(marks: int) -> None:
    assert f"begins with {marks} byte-order marks" in refusal(marks * codecs.BOM_UTF8 + TEXT.encode())


def test_other_bytes_are_placed() -> None:
    assert "byte 8 (line 2) is not UTF-8 ('é' in Windows-1252)" in refusal("name: 1\né: 2\n".encode("latin-1"))
    assert "byte 2 (line 1) is not UTF-8: " in refusal(b"ab\x81")
    assert "byte 50 (line 2) is zero" in refusal(b"x" * 20 + b"\n" + b"y" * 29 + b"\0")


@pytest.mark.parametrize("text", ["", "a", TEXT, "größe: 1\n", "\N{EIGHTH NOTE}" * 300, "音: 1\n"])
def test_utf_8_is_read_with_a_mark_and_without(text: str) -> None:
    assert decoded(text.encode(), file="a") == text
    assert decoded(codecs.BOM_UTF8 + text.encode(), file="a") == text


def test_every_kind_of_file_that_people_write_says_so(tmp_path: Path) -> None:
    file = tmp_path / "a.yaml"
    for raw, reason in (
        (TEXT.encode("utf-16-le"), "UTF-16 without"),
        (2 * codecs.BOM_UTF8 + TEXT.encode(), "2 byte-order marks"),
        (TEXT.encode("utf-16"), "is UTF-16"),
    ):
        file.write_bytes(raw)
        for read, error in ((load_yaml, TonewoodError), (load_manifest, ManifestError), (read_ensemble, BundleError)):
            with pytest.raises(error, match=reason):
                read(file)
        with pytest.raises(TonewoodError, match=reason):
            Files(tmp_path).table("a.yaml")
        with pytest.raises(TonewoodError, match=reason):
            read_scl(file)


def test_two_values_of_one_key_are_refused() -> None:
    """In an object within another, too; one key in two objects is none of these."""
    assert json_value('{"a": {"b": 1}, "c": [{"b": 2}]}') == {"a": {"b": 1}, "c": [{"b": 2}]}
    for text in ('{"a": 1, "b": 2, "a": 1}', '[{"c": {"a": 1, "a": 2}}]'):
        with pytest.raises(ValueError, match="the key 'a' stands twice in one object"):
            json_value(text)
