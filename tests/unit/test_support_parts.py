"""Parts that the others stand on: units, texts, tables, figures, stages, locks, files and messages."""

from __future__ import annotations

import codecs
import gc
import math
import os
import struct
import sys
import threading
from pathlib import Path

import matplotlib
import numpy as np
import pytest
import soundfile as sf

from tonewood.errors import OutputError, TonewoodError
from tonewood.support import moved, plotting, sound_rates, stages, tables, text_files, units, whole_files
from tonewood.support.folder_lock import FILE, _holder, locked
from tonewood.support.garbage import without_collecting
from tonewood.support.one_user import OneReader, OneUser, alone
from tonewood.support.page.offline import fixed, offline_page
from tonewood.support.params import Parameters, described, quantity, validated
from tonewood.support.parquet import write_parquet
from tonewood.support.plain_values import finite
from tonewood.support.validation_messages import did_you_mean, unit_of, usual_values
from tonewood.support.yaml_edit import Edit, apply_edits, edit_text
from tonewood.support.yaml_io import located, parse_yaml
from tonewood.support.yaml_parser import MAX_DEPTH, line_of

MINUS = "\N{MINUS SIGN}"


# numbers and units


def test_units_that_people_use() -> None:
    assert units.cents(1.5) == pytest.approx(701.955, abs=1e-3)
    assert units.ratio_of_cents(-1200.0) == 0.5
    assert units.decibel(10.0) == 20.0
    assert units.decibel(0.0) == units.decibel(-1.0) == -math.inf
    assert units.t60(math.log(1000) / 2) == pytest.approx(2.0)
    assert units.t60(0.0) == math.inf
    assert [units.as_float(x) for x in (3, 10**400, -(10**400))] == [3.0, math.inf, -math.inf]
    assert [units.counted(n, "mode") for n in (0, 1, 2)] == ["0 modes", "1 mode", "2 modes"]
    for text, value in ((" 1.5e3 ", 1500.0), (".5", 0.5), ("-2.", -2.0), ("+7E-1", 0.7)):
        assert units.number_in(text) == value
    for text in ("1_82", "inf", "", ".", "1e", "1.5.2", "0x10", "٣"):
        assert math.isnan(units.number_in(text))


@pytest.mark.parametrize(
    ("value", "digits", "signed", "text"),
    [
        (None, 2, False, "–"),
        (math.nan, 2, False, "–"),
        (math.inf, 2, False, "∞"),
        (-math.inf, 2, False, f"{MINUS}∞"),
        (1.005, 1, False, "1.0"),
        (2.5, 1, True, "+2.5"),
        (-2.56, 1, True, f"{MINUS}2.6"),
        (-0.04, 1, False, "0.0"),
        (0.04, 1, True, "0.0"),
    ],
)
def test_numbers_with_so_many_decimals(value, digits, signed, text) -> None:
    assert fixed(value, digits, signed) == text


def test_pages_escape_texts_and_know_their_script() -> None:
    page = offline_page(
        "{{ a }}|{{ b | shown }}|{{ c | fixed(1) }}|{{ d | twice }}|{{ script_hash }}",
        {"twice": lambda x: 2 * x},
        a="<b>",
        b={"x": 1},
        c=2.0,
        d="u",
    )
    a, b, c, d, script = page.split("|")
    assert (a, c, d) == ("&lt;b&gt;", "2.0", "uu")
    assert "{&#34;x&#34;: 1}" in b
    assert script.startswith("sha256-")
    assert offline_page("{{ x | shown }}", x="word") == "word"


def test_plain_values_have_no_numpy_and_no_infinity() -> None:
    value = {1: np.float64(2.0), "a": (np.array([1.0, np.nan]), math.inf), "b": [True, None, 3], "c": np.bool_(False)}
    assert finite(value) == {"1": 2.0, "a": [[1.0, None], None], "b": [True, None, 3], "c": False}


# tables


def test_a_table_of_columns() -> None:
    table = tables.Table({"f, Hz": [1.0, 123456789.0], "name": ["a", "<b>"]})
    assert (table.columns, len(table), list(table)) == (("f, Hz", "name"), 2, ["f, Hz", "name"])
    assert table["f, Hz"] == [1.0, 123456789.0]
    assert table.rows() == [(1.0, "a"), (123456789.0, "<b>")]
    assert repr(table).splitlines() == ["      f, Hz  name", "          1     a", "1.23457e+08   <b>"]
    assert "<td>&lt;b&gt;</td>" in table._repr_html_()
    assert repr(tables.Table({"n": range(61)})).splitlines()[-1] == "and 1 rows more"
    assert len(repr(tables.Table({"n": range(60)})).splitlines()) == 61
    assert "<p>and 2 rows more</p>" in tables.Table({"n": range(62)})._repr_html_()
    assert len(tables.Table({})) == 0
    with pytest.raises(ValueError, match="equally long"):
        tables.Table({"a": [1], "b": [1, 2]})
    assert tables.properties_html("<t>", {"a": "<1>"}) == (
        "<strong>&lt;t&gt;</strong><table><tr><th style='text-align:left'>a</th>"
        "<td style='text-align:left'>&lt;1&gt;</td></tr></table>"
    )


def test_types_of_parquet_columns(tmp_path) -> None:
    reader = pytest.importorskip("pyarrow.parquet")
    large = [{"a": 2**63 - 1, "b": 2**63, "c": 10**400}, {"a": -(2**63), "b": 1, "c": 0.5}]
    write_parquet(tmp_path / "large.parquet", ["a", "b", "c"], large)
    assert reader.read_table(tmp_path / "large.parquet").to_pylist() == [
        {"a": 2**63 - 1, "b": str(2**63), "c": str(10**400)}, {"a": -(2**63), "b": "1", "c": "0.5"}
    ]  # fmt: skip
    rows = [{"i": 1, "f": 1, "s": "x", "b": True, "m": 1, "l": [1, 2]}, {"f": 2.5, "m": "y"}, {"i": 3, "b": False}]
    write_parquet(tmp_path / "new" / "t.parquet", ["i", "f", "s", "b", "m", "l", "none"], rows)
    found = reader.read_table(tmp_path / "new" / "t.parquet")
    assert found.to_pydict() == {
        "i": [1, None, 3],
        "f": [1.0, 2.5, None],
        "s": ["x", None, None],
        "b": [True, None, False],
        "m": ["1", "y", None],
        "l": ["[1, 2]", None, None],
        "none": [None] * 3,
    }
    assert [str(found.schema.field(name).type) for name in "ifsbml"] == [
        "int64",
        "double",
        "string",
        "bool",
        "string",
        "string",
    ]


# figures


def test_axes_and_curves_of_figures() -> None:
    chart, axes = plotting.figure(2, 3, heights=[1.0, 2.5])
    assert axes.shape == (2, 3)
    assert chart.get_size_inches().tolist() == [10.0, 3.7]
    assert plotting.figure(2)[0].get_size_inches().tolist() == [10.0, 8.2]
    ax = axes[0, 0]
    plotting.frequency_axis(ax, 50.0, 2000.0)
    assert ax.get_xticks().tolist() == [50, 100, 200, 500, 1000, 2000]
    assert [t.get_text() for t in ax.get_xticklabels()] == ["50", "100", "200", "500", "1k", "2k"]
    assert ax.get_xlim() == (50.0, 2000.0)
    plotting.title(ax, "costs $5 " * 20)
    assert max(map(len, ax.get_title().replace("\\$", "$").splitlines())) <= 64
    assert "\\$" in ax.get_title()
    freq = np.array([100.0, 200.0, 400.0])
    many = {f"c{i}": np.full(3, 10.0**-i) for i in range(9)}
    figure = plotting.mobility_figure(freq, many, heading="h", marks=(110.0, 220.0), of="points")
    lines = figure.axes[0].lines
    assert [float(line.get_ydata()[0]) for line in lines[:9]] == pytest.approx([-20.0 * i for i in range(9)])
    assert lines[7].get_color() == lines[0].get_color()
    assert lines[7].get_linestyle() != lines[0].get_linestyle()
    assert [line.get_xdata()[0] for line in lines[9:]] == [110.0, 220.0]
    assert figure.axes[0].get_legend().get_title().get_text() == "points"
    quiet = plotting.mobility_figure(freq, {"a": np.zeros(3)}).axes[0].lines[0]
    assert quiet.get_ydata().tolist() == [-240.0] * 3
    points = plotting.points_figure(
        [0.0, 100.0, 200.0, 400.0], {"Q": [5.0, 10.0, -1.0, 30.0], "m": [1.0, np.nan, 2.0, 3.0]}
    )
    assert [line.get_xdata().tolist() for line in (points.axes[0].lines[0], points.axes[1].lines[0])] == [
        [100.0, 400.0],
        [200.0, 400.0],
    ]
    assert points.axes[0].get_xlim() == pytest.approx((100 / 1.15, 400 * 1.15))
    assert plotting.points_figure([0.0], {"Q": [1.0]}).axes[0].get_xlim() == (20.0, 20000.0)
    image = plotting.draw_spectrogram(
        ax, [0.5, 1.0, 1.5], [0.0, 4000.0], np.array([[-9.0, 1, 2], [3, 4, 5]]), floor_db=-60.0
    )
    assert image.get_extent() == [0.5, 1.5, 0.0, 4.0]
    assert image.get_clim() == (-60.0, 0.0)
    assert image.get_array()[1].tolist() == [3, 4, 5]
    assert image.origin == "lower"
    assert plotting.data_uri(b"abc", "x/y") == "data:x/y;base64,YWJj"


def test_pictures_are_the_same_bytes_and_have_their_kind(tmp_path) -> None:
    def drawn():
        chart, axes = plotting.figure(heights=[1.0])
        axes[0, 0].plot([1, 2], [1, 2], label="a")
        plotting.legend_above(chart, axes[0, 0])
        return chart

    chart = drawn()
    assert len(chart.legends) == 1
    assert (text := plotting.svg(chart)) == plotting.svg(drawn())
    assert b"dc:date" not in text
    assert plotting.png(chart, 20).startswith(b"\x89PNG")
    assert struct.unpack(">II", plotting.png(chart, 20)[16:24]) == (200, 24)
    assert chart._repr_png_().startswith(b"\x89PNG")
    assert plotting.save(chart, tmp_path / "new" / "a.SVG", make_folder=True).read_bytes().startswith(b"<?xml")
    with matplotlib.rc_context({"text.usetex": True}):  # of somebody's matplotlibrc: labels are no TeX
        named = drawn()
        named.axes[0].set_xlabel("100 % of a_b")
        assert plotting.png(named, 20).startswith(b"\x89PNG")
    empty, axes = plotting.figure(heights=[1.0])
    plotting.legend_above(empty, axes[0, 0])
    plotting.legend(axes[0, 0])
    assert empty.legends == []
    assert axes[0, 0].get_legend() is None


# sound files


def test_rates_and_lengths_of_sound_files(tmp_path, monkeypatch) -> None:
    for rate, lowest, good in (
        (8000, 8000, True),
        (7999, 8000, False),
        (400_000, 8000, True),
        (400_001, 8000, False),
        (1000, 1000, True),
    ):
        if good:
            sound_rates.check_rate(rate, "a.wav", lowest)
        else:
            with pytest.raises(TonewoodError, match=f"has {rate} samples a second; {lowest} to 400000 are allowed"):
                sound_rates.check_rate(rate, "a.wav", lowest)
    path = tmp_path / "a.wav"
    sf.write(path, np.tile([[0.25, -0.5]], (1000, 1)), 8000, subtype="PCM_16")
    samples, fs = sound_rates.read_samples(path)
    assert (samples.shape, fs, samples[0].tolist()) == ((1000, 2), 8000, [0.25, -0.5])
    whole = path.read_bytes()
    path.write_bytes(whole[:-2])
    with pytest.raises(TonewoodError, match="is cut short: 3998 of 4000 bytes of samples are there"):
        sound_rates.read_samples(path)
    at = whole.index(b"data") + 4
    path.write_bytes(whole[:at] + (0x7FF00000).to_bytes(4, "little") + whole[at + 4 : -2])
    sound_rates.check_whole(path)
    path.write_bytes(whole[:at] + (0x7FEFFFFF).to_bytes(4, "little") + whole[at + 4 :])
    with pytest.raises(TonewoodError, match="is cut short"):
        sound_rates.check_whole(path)
    odd = whole[:12] + b"note" + (3).to_bytes(4, "little") + b"abc\0" + whole[12:-2]
    path.write_bytes(odd)  # a chunk of odd length is padded
    with pytest.raises(TonewoodError, match="3998 of 4000"):
        sound_rates.check_whole(path)
    path.write_bytes(b"RIFX" + whole[4:-2])
    sound_rates.check_whole(path)
    path.write_bytes(whole)
    monkeypatch.setattr(sound_rates, "MOST_SAMPLES", 2000)
    assert len(sound_rates.read_samples(path)[0]) == 1000
    monkeypatch.setattr(sound_rates, "MOST_SAMPLES", 1999)
    with pytest.raises(TonewoodError, match="1999 samples of 2"):
        sound_rates.read_samples(path)
    monkeypatch.setattr(sound_rates, "MOST_SAMPLES", 60_000_000)
    sf.write(path, np.array([0.0, -2e30]), 8000, subtype="DOUBLE")
    with pytest.raises(TonewoodError, match=r"has a sample of 2e\+30; up to 1e\+30 are allowed"):
        sound_rates.read_samples(path)


# texts


@pytest.mark.parametrize(
    ("raw", "said"),
    [
        ("aé".encode("utf-16"), "is UTF-16, not UTF-8"),
        (codecs.BOM_UTF32_LE + "a".encode("utf-32-le"), "is UTF-32, not UTF-8"),
        ("name: x".encode("utf-16-le"), "seems to be UTF-16 without a byte-order mark"),
        ("name: x".encode("utf-16-be"), "seems to be UTF-16 without a byte-order mark"),
        ("name: x".encode("utf-32-be"), "seems to be UTF-32 without a byte-order mark"),
        (b"a\nb\xe9c", r"byte 3 \(line 2\) is not UTF-8 \('é' in Windows-1252\)"),
        (b"a\x81", r"byte 1 \(line 1\) is not UTF-8: save"),
        (b"\xef\xbb\xbf\xef\xbb\xbfa", "begins with 2 byte-order marks, one is allowed"),
        (b"abcdefghijklmn\nop\0", r"byte 17 \(line 2\) is zero"),
    ],
)
def test_texts_of_other_encodings(raw, said) -> None:
    with pytest.raises(TonewoodError, match=said):
        text_files.decoded(raw, file="a.yaml")
    assert text_files.decoded(b"\xef\xbb\xbfa\xc3\xa9", file="a") == "aé"
    assert text_files.decoded(b"", file="a") == ""


def test_json_has_each_key_once() -> None:
    assert text_files.json_value('{"a": [1, {"b": null}]}') == {"a": [1, {"b": None}]}
    with pytest.raises(ValueError, match="the key 'b' stands twice in one object"):
        text_files.json_value('{"a": {"c": 1, "b": 1, "b": 2}}')


def test_edits_of_yaml_keep_everything_else() -> None:
    text = "a: {x: 1, y: 2, z: 3}   # first\nb:\n  c: old   # second\n  d: 4\ne:\n  f: 5\n"
    edits = [Edit("b.c", "new", "r"), Edit("a.y", None, "r")]
    assert edit_text(text, edits) == "a: {x: 1, z: 3}   # first\nb:\n  c: new   # second\n  d: 4\ne:\n  f: 5\n"
    assert edit_text(text, [Edit("a.z", None, "r")]).startswith("a: {x: 1, y: 2}   # first\n")
    assert edit_text(text, [Edit("b.d", None, "r")]) == text.replace("  d: 4\n", "")
    assert parse_yaml(edit_text(text, [Edit("e.f", None, "r")]))["e"] == {}
    assert edit_text("\ufeffa: v\n", [Edit("a", "w", "r")]) == "\ufeffa: w\n"
    assert apply_edits({"a": {"b": 1, "c": 2}}, [Edit("a.b", None, "r"), Edit("a.c", "w", "r")]) == {"a": {"c": "w"}}
    with pytest.raises(TonewoodError, match="cannot be rewritten automatically; say so by hand"):
        edit_text("a: 1\n", [Edit("a", "b: c: d", "say so")])


def test_lines_of_keys(tmp_path) -> None:
    text = "a: 1\nstrings:\n  defaults:\n    loss: 2\n  E2:\n    x: 3\nlist:\n  - name: p\n    q: 4\n  - r\n"
    for key, line in (
        ("a", 1),
        ("strings.E2.x", 6),
        ("strings.E2.loss", 4),
        ("list.p.q", 9),
        ("list.1", 10),
        ("a.b", 1),
        ("no", None),
    ):
        assert line_of(text, key) == line
    file = tmp_path / "i.yaml"
    file.write_text(text)
    assert located(TonewoodError("r", file=file, key="strings.E2.x")).line == 6
    assert located(TonewoodError("r", file=file, key="a", line=9)).line == 9
    assert located(TonewoodError("r", file=tmp_path / "i.csv", key="a")).line is None


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("a: &x 1\n", "anchor &x is not allowed"),
        ("a: 1\na: 2\n", "key a stands twice"),
        ("1: 2\n", "key 1 is not a word"),
        ("a: 2020-01-01\n", "would be read as a date"),
        ("- 1\n", "holds a list; a mapping of keys is wanted"),
        ("", "holds nothing; a mapping"),
        ("word\n", "holds only 'word'"),
        ("a: {b: [1, .inf]}\n", r"a\.b\.1: inf is not a finite number"),
        ("a: !x 1\n", "tag !x is not allowed"),
        ("%YAML 1.1\n---\na: 1\n", "directives are not allowed"),
        ("a: " + "[" * MAX_DEPTH + "]" * MAX_DEPTH, "nested deeper than the 24 levels"),
    ],
)
def test_yaml_that_is_refused(text, said) -> None:
    with pytest.raises(TonewoodError, match=said):
        parse_yaml(text)
    assert parse_yaml("a: " + "[" * (MAX_DEPTH - 1) + "]" * (MAX_DEPTH - 1))
    assert parse_yaml('a: "\\ud83c\\udfb8"\nb: no\nc: 2e11') == {"a": "🎸", "b": "no", "c": 2e11}


# parameters


class Spring(Parameters):
    """Numbers with units."""

    stiffness: float = quantity("N/m", low=1.0, high=1e6, doc="k")
    length: float = quantity("m", low=0.0, high=2.0, default=0.5, doc="l")
    pitch: float = quantity("Hz", low=0.0, usual=(20.0, 2000.0), default=100.0, doc="f")
    name: str = described("n", default="a")


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"stiffness": 0.5}, r"top\.stiffness: is 0.5 N/m; at least 1 N/m: did you mean 0.5 N/mm \(500\)\?"),
        ({"stiffness": 2e6}, r"is 2000000 N/m; at most 1000000 N/m is allowed"),
        ({"stiffness": 5.0, "length": 650.0}, r"length: is 650 m; at most 2 m: did you mean 650 mm \(0.65\)\?"),
        ({"stiffness": "5 N/m"}, "numbers are in SI units and stand without them"),
        ({}, "stiffness"),
        ({"stiffness": 5.0, "lenght": 1.0}, "length"),
    ],
)
def test_messages_of_numbers_beyond_their_bounds(values, said) -> None:
    with pytest.raises(TonewoodError, match=said):
        validated(Spring, values, key="top")
    assert validated(Spring, {"stiffness": 1.0}, key="").length == 0.5
    assert validated(Spring, {"stiffness": 1e6, "length": 0.0}, key="").stiffness == 1e6


def test_usual_values_lie_within_the_bounds() -> None:
    fields = Spring.model_fields
    assert usual_values(fields["stiffness"]) == pytest.approx((10.0, 1e5))
    assert usual_values(fields["length"]) == pytest.approx((2e-3, 2.0))
    assert usual_values(fields["pitch"]) == (20.0, 2000.0)
    assert usual_values(fields["name"]) == (math.inf, -math.inf)
    assert [unit_of(fields[name]) for name in ("stiffness", "name")] == ["N/m", ""]
    assert "length" in did_you_mean("lenght", ["length", "mass"])
    assert did_you_mean("zzz", ["length"]) == ""


# processes and threads


def test_stages_are_told_to_listeners_in_order(monkeypatch) -> None:
    told = []
    stages.listen([told.append])
    try:
        with stages.stages("work", 2) as begin:
            begin("one")
            begin("two")
    finally:
        stages.listen(())
    with stages.stages("work", 1) as begin:
        begin("silent")
    assert told == ["work 1/2: one", "work 2/2: two", ""]
    monkeypatch.setattr(sys.stderr, "isatty", lambda: False, raising=False)
    assert stages.on_terminal() == ()


def in_thread(call):
    out = []

    def run() -> None:
        try:
            out.append(call())
        except TonewoodError as fault:
            out.append(str(fault))

    thread = threading.Thread(target=run)
    thread.start()
    thread.join()
    return out[0]


def test_one_thread_at_a_time() -> None:
    class Thing:
        def __init__(self) -> None:
            self.use = OneUser("thing", "copy it")

        @alone
        def double(self, x: int) -> int:
            return 2 * x

    thing = Thing()
    with thing.use:
        assert thing.double(2) == 4
        assert in_thread(lambda: thing.double(2)) == "this thing is in use by another thread; copy it"
    assert in_thread(lambda: thing.double(3)) == 6
    reader = OneReader("player")
    with reader.begun() as first:
        with first:
            pass
        assert "blocks of this player are taken by another thread" in in_thread(lambda: reader.begun().__enter__())
        with reader.begun() as second:
            with second:
                pass
            with pytest.raises(TonewoodError, match="another iteration over the blocks of this player has begun since"):
                first.__enter__()
    iteration = in_thread(lambda: reader.begun().__enter__())
    assert not isinstance(iteration, str)


def test_the_collector_is_as_it_was() -> None:
    seen = []

    @without_collecting
    def work(x):
        seen.append(gc.isenabled())
        return x + 1

    assert gc.isenabled()
    assert work(1) == 2
    assert gc.isenabled()
    gc.disable()
    try:
        work(1)
        assert not gc.isenabled()
    finally:
        gc.enable()
    assert seen == [False, False]


def test_a_folder_has_one_user(tmp_path) -> None:
    with locked(tmp_path / "new", "batch"):
        assert (tmp_path / "new" / FILE).read_bytes() == f"\0batch, process {os.getpid()}\n".encode()
        with (
            pytest.raises(OutputError, match=f"is in use by batch, process {os.getpid()}: stop it first"),
            locked(tmp_path / "new", "x"),
        ):
            pass
    assert not (tmp_path / "new" / FILE).exists()
    with locked(tmp_path / "new", "again"):
        pass
    assert _holder(b"\0" + b"a" * 300) == "a" * 200
    assert _holder(b"") == "another process"
    (tmp_path / "odd").mkdir()
    (tmp_path / "odd" / FILE).mkdir()
    with pytest.raises(OutputError), locked(tmp_path / "odd", "x"):
        pass


def test_files_appear_whole_and_read_ones_are_not_replaced(tmp_path) -> None:
    target = tmp_path / "a.txt"
    whole_files.write_whole(target, "é")
    assert target.read_bytes() == "é".encode()
    file = whole_files.AtomicFile(target)
    assert file.path == tmp_path / ".a.0.part.txt"
    second = whole_files.AtomicFile(target)
    assert second.path == tmp_path / ".a.1.part.txt"
    file.path.write_text("new")
    file.complete()
    assert target.read_text() == "new"
    assert whole_files.completed[-1] == target.resolve()
    second.discard()
    assert [p.name for p in tmp_path.iterdir()] == ["a.txt"]
    (tmp_path / "link").symlink_to(target)
    whole_files.protect([target, tmp_path / "none"])
    try:
        for name in ("a.txt", "link"):
            with pytest.raises(OutputError, match="would replace a file that is read"):
                whole_files.AtomicFile(tmp_path / name)
        whole_files.check_unread(tmp_path / "other")
    finally:
        whole_files.protect([])
    (tmp_path / ".a.0.part.txt").write_text("of a killed program")
    (tmp_path / ".a.7.part.txt").write_text("of a killed program")
    whole_files.remove_leftovers(target)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.txt", "link"]
    for path, said in (
        (tmp_path, "is a folder"),
        (tmp_path / "no" / "x", "there is no folder"),
        (Path("/dev/null"), "a device"),
    ):
        with pytest.raises(OutputError, match=said):
            whole_files.AtomicFile(path)

    def fails():
        with whole_files.whole_file(target) as stream:
            stream.write(b"half")
            raise KeyError

    with pytest.raises(KeyError):
        fails()
    assert target.read_text() == "new"
    whole_files.check_new_folder(tmp_path / "fresh")
    for path, said in ((target, "is there already"), (tmp_path / "a" / "b", "there is no folder")):
        with pytest.raises(OutputError, match=said):
            whole_files.check_new_folder(path)


def test_names_of_an_earlier_version() -> None:
    for old, new in (
        ("tonewood.modal", "tonewood.physics.modal"),
        ("tonewood.engine.live", "tonewood.performance.player.player"),
        ("tonewood.engine.effects.reverb", "tonewood.performance.effects.reverb"),
        ("tonewood.engine.costs", "tonewood.performance.effects.costs"),
        ("tonewood.score.scales", "tonewood.instrument.scales"),
        ("tonewood.coupling.tension_solve", "tonewood.physics.coupling.potentials.solve"),
        ("tonewood.blas", "tonewood.support.blas"),
        ("tonewood.output.render", "tonewood.sound.render.renderer"),
        ("tonewood.modal.modes", "tonewood.physics.modal.modes"),
        ("tonewood.nothing", None),
    ):
        assert moved.new_name(old) == new
    with pytest.warns(
        DeprecationWarning, match=r"a\.cents is deprecated since 0.3 .* it is tonewood\.support\.units\.cents"
    ):
        assert moved.attribute("a", "cents", "tonewood.support.units") is units.cents
    for name in ("none", "__doc__"):
        with pytest.raises(AttributeError, match="module 'a' has no attribute"):
            moved.attribute("a", name, "tonewood.support.units")
    with pytest.warns(DeprecationWarning, match=r"m\.Old is deprecated .* it is m\.Spring"):
        assert moved.renamed("m", "Old", {"Old": Spring}) is Spring
    with pytest.raises(AttributeError, match="module 'm' has no attribute 'New'"):
        moved.renamed("m", "New", {"Old": Spring})
    before = len(sys.meta_path)
    moved.install()
    assert len(sys.meta_path) == before
