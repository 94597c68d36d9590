"""Files nobody should be able to hurt us with: each is one clear line, or a sound of finite numbers."""

from __future__ import annotations

import copy
import io
import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from ruamel.yaml import YAML

import tonewood as tw
from midi_bytes import bend, bend_range, control, midi_file
from midi_bytes import note as pressed
from tonewood.errors import TonewoodError
from tonewood.instrument.contract.registry import instrument_folder
from tonewood.instrument.model.assembly import assemble

FS = 8000
FOLDER = instrument_folder("monochord")
MANIFEST = (FOLDER / "instrument.yaml").read_text()
BODY = (FOLDER / "body.csv").read_text()
VALUES: dict[str, Any] = YAML(typ="safe", pure=True).load(MANIFEST)


def played(folder: Path, midi: Path | None = None) -> tw.Audio:
    """Load, assemble, render a moment; any fault must be one line that names the place."""
    instrument = tw.load_instrument(folder)
    note = tw.Note(0.0, 0.1, note=instrument.open_note(instrument.string_names[0]))
    score = tw.Score([note]) if midi is None else tw.read_midi(midi)
    return tw.render(score, instrument, FS, max_duration=0.02)


def assert_one_line_or_sound(folder: Path, midi: Path | None = None) -> str:
    """The line, or nothing if it sounded."""
    try:
        audio = played(folder, midi)
    except TonewoodError as fault:
        line = str(fault)
        assert line
        assert "\n" not in line
        assert len(line) < 2000
        return line
    assert np.isfinite(audio.samples).all()
    assert len(audio.samples) == round(0.02 * FS)
    return ""


def bundle(folder: Path, manifest: str, body: str = BODY) -> Path:
    folder.mkdir(exist_ok=True)
    (folder / "instrument.yaml").write_bytes(manifest.encode("utf-8", "surrogatepass"))
    (folder / "body.csv").write_bytes(body.encode("utf-8", "surrogatepass"))
    return folder


def places(value: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """Every key and list member."""
    found = [path] if path else []
    if isinstance(value, dict):
        for key, item in value.items():
            found += places(item, (*path, key))
    if isinstance(value, list):
        for i, item in enumerate(value):
            found += places(item, (*path, i))
    return found


def put(values: dict[str, Any], path: tuple[Any, ...], new: Any) -> dict[str, Any]:
    out = copy.deepcopy(values)
    at: Any = out
    for key in path[:-1]:
        at = at[key]
    at[path[-1]] = new
    return out


PLACES = places(VALUES)
NASTY = [
    None, True, 0, -1, 1, 3, 1e-300, 1e300, -1e300, 10**400, 2**63, "", "x", "../body.csv", "/etc/passwd", "body.csv",
    "body.bridge", "A2", "Z9", "nan", "\x00", "é" * 5000, [], {}, [[]], [None], [1, 2, 3], [0, 0, 0], {"a": 1},
    {"fraction": 2}, {"fraction": 0.5}, ["z", "y"], ["z"] * 50, list(range(3000)),
]  # fmt: skip
anything = st.one_of(
    st.sampled_from(NASTY),
    st.floats(allow_nan=False, allow_infinity=False),
    st.integers(-(2**70), 2**70),
    st.text(max_size=20),
    st.recursive(st.none() | st.booleans() | st.integers(-5, 5), lambda s: st.lists(s, max_size=3), max_leaves=4),
)


@given(st.lists(st.tuples(st.sampled_from(PLACES), anything), min_size=1, max_size=2))
def test_values_of_every_kind_at_every_key(
    tmp_path_factory: pytest.TempPathFactory, changes: list[tuple[tuple[Any, ...], Any]]
) -> None:
    values = VALUES
    for path, new in changes:
        try:
            values = put(values, path, new)
        except (KeyError, TypeError, IndexError):  # the other change took its place away
            continue
    folder = tmp_path_factory.getbasetemp() / "fuzzed"
    assert_one_line_or_sound(bundle(folder, json.dumps(values)))


@given(st.data())
def test_damaged_manifests(tmp_path_factory: pytest.TempPathFactory, data: st.DataObject) -> None:
    """Bytes of the file cut out, put in, doubled."""
    text = MANIFEST
    for _ in range(data.draw(st.integers(1, 3))):
        at = data.draw(st.integers(0, len(text)))
        until = data.draw(st.integers(at, min(len(text), at + 60)))
        piece = data.draw(
            st.sampled_from(
                ["", "\t", "- ", ": ", "{", "}", "[", "&a ", "*a", "!!python/object:os.system ", "<<: ", "\n", "\x00",
                 "'", '"', "|\n", "---\n", "...", "%YAML 1.1\n", "#", "1e999", "0x", "2001-01-01"]
            )
            | st.text(max_size=5)
            | st.just(text[at:until] * 2)
        )  # fmt: skip
        text = text[:at] + piece + text[until:]
    assert_one_line_or_sound(bundle(tmp_path_factory.getbasetemp() / "damaged", text))


@pytest.mark.parametrize(
    ("manifest", "said"),
    [
        (MANIFEST.replace("table: body.csv", "table: ../body.csv"), "leads out of the bundle"),
        (MANIFEST.replace("table: body.csv", "table: /etc/hostname"), "leads out of the bundle"),
        (MANIFEST.replace("table: body.csv", "table: link.csv"), "leads out of the bundle"),
        (MANIFEST.replace("table: body.csv", "table: loop.csv"), "'loop.csv' cannot be followed"),
        (MANIFEST.replace("table: body.csv", "table: " + "n" * 5000), "cannot be followed to a file"),
        (MANIFEST.replace("table: body.csv", "table: ./"), "leads out of the bundle"),
        (MANIFEST.replace("from_bridge: 0.15", "from_bridge: -1"), "greater than or equal to 0"),
        (MANIFEST.replace("shapes: points", "shapes: points\n  truncation: {residual_compliance: 1e300}"), "1 m/N is"),
        (MANIFEST + "tuning: {scale: ../x.scl}\n", "leads out of the bundle"),
        (MANIFEST.replace("sources: {}", "sources: &a {}"), "anchor &a is not allowed"),
        (MANIFEST.replace("sources: {}", "sources: !!python/object/apply:os.system [ls]"), "tag "),
        (MANIFEST + "name: again\n", "key name stands twice"),
        (MANIFEST + "x: " + "[" * 5000 + "]" * 5000, "nested deeper than"),
        (MANIFEST + "# " + "x" * 1_000_001, "longer than the 1000000 bytes allowed"),
        (MANIFEST.replace("tension: 58.8", "tension: 1" + "0" * 5000), ""),
        (MANIFEST.replace("end: body.bridge", "end: body.bridge\n    freq_upper: 1.0e5\n    length: 5.0"), ""),
    ],
    ids=[
        "up", "absolute", "link", "loop", "name", "folder", "place", "soft", "scale",
        "anchor", "tag", "twice", "deep", "long", "digits",
        "many",
    ],
)  # fmt: skip
def test_known_attacks_are_one_line(tmp_path: Path, manifest: str, said: str) -> None:
    (tmp_path.parent / "body.csv").write_text(BODY)
    (tmp_path.parent / "x.scl").write_text("! x\nx\n1\n2/1\n")
    folder = bundle(tmp_path / "in", manifest)
    os.symlink("/etc/hostname", folder / "link.csv")
    os.symlink(folder / "loop.csv", folder / "loop.csv")
    assert said in assert_one_line_or_sound(folder)


def many(key: str, count: int) -> dict[str, Any]:
    values = copy.deepcopy(VALUES)
    if key == "strings":
        values["strings"] = {f"s{i}": values["strings"]["A2"] for i in range(count)}
    elif key == "points":
        values["body"]["points"] = {f"p{i}": {"column": "bridge"} for i in range(count)} | {"bridge": {}}
    elif key == "exciters":
        values["exciters"] |= {f"e{i}": values["exciters"]["pluck"] for i in range(count)}
    elif key == "string points":
        values["strings"]["A2"]["points"] = {f"p{i}": {"from_bridge": 0.1} for i in range(count)}
    else:
        values["outputs"] = [{**values["outputs"][0], "name": f"o{i}"} for i in range(count)]
    return values


@pytest.mark.slow
@pytest.mark.parametrize(
    ("key", "said"),
    [
        ("strings", "strings: Dictionary should have at most 1024 items"),
        ("points", "body.points: Dictionary should have at most 256 items"),
        ("exciters", "exciters: Dictionary should have at most 100 items"),
        ("string points", "strings.A2.points: Dictionary should have at most 100 items"),
        ("outputs", "outputs: List should have at most 100 items"),
    ],
)
def test_numbers_of_parts_are_limited(tmp_path: Path, key: str, said: str) -> None:
    line = assert_one_line_or_sound(bundle(tmp_path / "in", json.dumps(many(key, 1100 if key == "strings" else 300))))
    assert said in line


def test_numbers_of_modes_are_limited(tmp_path: Path) -> None:
    rows = "\n".join(f"{100 + i},30,1,1" for i in range(20_001))
    line = assert_one_line_or_sound(bundle(tmp_path / "in", MANIFEST, "f_Hz,Q,modal_mass,bridge\n" + rows))
    assert "20001 modes; 20000 are allowed" in line
    slack = put(VALUES, ("strings", "A2", "tension"), 1.9)
    slack["strings"]["A2"] |= {"note": None, "freq": 20.0, "freq_upper": 1e5, "bending_stiffness": 0.0}
    instrument = tw.load_instrument(bundle(tmp_path / "in", json.dumps(slack)))
    with pytest.raises(TonewoodError, match=r"strings\.A2: this string has some 4\d{3} modes .* at most 3000 are"):
        assemble(instrument, 768000)


cell = st.sampled_from(
    ["1", "-1", "0", "nan", "inf", "-inf", "1e308", "1e-320", "1e999", "", " ", "x", "0x10", "1_0", "١", '"1"', "1;2"]
) | st.floats().map(repr)


@given(
    st.lists(
        st.sampled_from(["f_Hz", "Q", "zeta", "modal_mass", "bridge", "", "x", " bridge", "#", '"Q"']),
        min_size=0, max_size=6,
    ),
    st.lists(st.lists(cell, min_size=0, max_size=6), max_size=5),
    st.sampled_from(["\n", "\r\n", "\r", "\n\n", "\x00\n", "\u2028"]),
)  # fmt: skip
@example(["f_Hz", "Q", "modal_mass", "bridge"], [["100", "-30", "1", "1"]], "\n")
@example(["f_Hz", "Q", "modal_mass", "bridge"], [["100", "1e-300", "1", "1"]], "\n")
@example(["f_Hz", "Q", "modal_mass", "bridge"], [["1e-300", "1e300", "1e-300", "1e300"]], "\n")
@example(["f_Hz", "Q", "modal_mass", "bridge"], [["100", "30", "1e-300", "1"]], "\n")
@example(["f_Hz", "Q", "modal_mass", "bridge"], [["100", "30", "1", "0"]], "\n")
@example(["f_Hz", "zeta", "modal_mass", "bridge"], [["100", "1.0", "1", "1"], ["100", "50", "1", "1"]], "\n")
def test_tables_of_every_kind(
    tmp_path_factory: pytest.TempPathFactory, header: list[str], rows: list[list[str]], end: str
) -> None:
    text = end.join(",".join(row) for row in [header, *rows])
    assert_one_line_or_sound(bundle(tmp_path_factory.getbasetemp() / "tables", MANIFEST, text))


@given(
    st.lists(
        st.sampled_from(["! note", "", "12", "2", "-3", "99999999999", "2/1", "3/2", "0/1", "1/0", "-2/1", "1200.",
                         "nan", "1e400.", "700.0 fifth", "x", "2/1/1", "9" * 4000, "440.0", "69", "0", "127", "60"])
        | st.text(max_size=6),
        max_size=20,
    ),
    st.booleans(),
)  # fmt: skip
def test_scales_of_every_kind(tmp_path_factory: pytest.TempPathFactory, lines: list[str], as_keymap: bool) -> None:
    folder = tmp_path_factory.getbasetemp() / "scales"
    octave = "! o\no\n12\n" + "\n".join(f"{100.0 * i}" for i in range(1, 12)) + "\n2/1\n"
    values = copy.deepcopy(VALUES)
    values["tuning"] = {"scale": "a.scl", **({"keymap": "a.kbm"} if as_keymap else {})}
    bundle(folder, json.dumps(values))
    fuzz = "\n".join(lines).encode("utf-8", "surrogatepass")
    (folder / "a.scl").write_bytes(octave.encode() if as_keymap else fuzz)
    (folder / "a.kbm").write_bytes(fuzz)
    assert_one_line_or_sound(folder)


GOOD = midi_file(
    [*bend_range(12), *pressed(0.0, 0.1, 45), bend(0.01, 4000), control(0.02, 64, 127), *pressed(0.05, 0.0, 57)]
)


@given(st.data())
def test_midi_of_every_kind_at_the_render(tmp_path_factory: pytest.TempPathFactory, data: st.DataObject) -> None:
    raw = bytearray(GOOD)
    for _ in range(data.draw(st.integers(1, 6))):
        at = data.draw(st.integers(0, len(raw) - 1))
        kind = data.draw(st.sampled_from(["set", "cut", "insert"]))
        if kind == "set":
            raw[at] = data.draw(st.integers(0, 255))
        elif kind == "insert":
            raw[at:at] = data.draw(st.binary(max_size=8))
        elif len(raw) > 2:
            del raw[at]
    folder = bundle(tmp_path_factory.getbasetemp() / "midi", MANIFEST)
    (folder / "a.mid").write_bytes(bytes(raw))
    assert_one_line_or_sound(folder, folder / "a.mid")


def test_the_manifest_is_what_the_dialect_reads() -> None:
    """The reference reader sees the same values, so that mutations start from valid files."""
    assert tw.load_instrument("monochord").spec.name == YAML(typ="safe", pure=True).load(io.StringIO(MANIFEST))["name"]
