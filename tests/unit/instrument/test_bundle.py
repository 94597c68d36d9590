"""Bundles: values read, faults refused and their messages, changes by overrides."""

from __future__ import annotations

import hashlib
import os
import pickle
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import tonewood as tw
from tonewood.errors import BundleError, PluginError, TonewoodError
from tonewood.instrument.bundle.identity import content_hash
from tonewood.instrument.bundle.loading import Instrument
from tonewood.instrument.bundle.overrides import apply_overrides, parse_assignment
from tonewood.instrument.model.assembly import assemble

Make = Callable[..., Instrument]


def test_defaults_are_merged_under_every_string(make: Make) -> None:
    small = make()
    assert small.string_names == ("A2", "D3")
    assert small.resolved["strings"]["D3"]["length"] == 0.65
    assert small.resolved["strings"]["D3"]["loss"]["sigma1"] == 2e-4
    assert small.resolved["strings"]["D3"]["split_cents"] == 0.0  # the schema's own default, written out
    assert small.resolved["exciters"]["pluck"]["release_time"] == 2e-4  # the plugin's


def test_resolved_values_make_the_same_instrument(make: Make) -> None:
    small = make()
    again = make(dict(small.resolved))
    assert again.resolved == small.resolved
    assert again.content_hash == small.content_hash


def test_the_hash_follows_values_and_tables(make: Make, tmp_path: Path) -> None:
    small = make()
    assert small.replace({"strings.A2.tension": 73.8}).content_hash != small.content_hash
    (tmp_path / "body.csv").write_text((tmp_path / "body.csv").read_text() + "900,30,0.3,1,1\n")
    assert make().content_hash != small.content_hash


def put(values: dict[str, Any], path: str, value: Any) -> dict[str, Any]:
    *above, last = path.split(".")
    at = values
    for key in above:
        at = at[int(key)] if isinstance(at, list) else at[key]
    if value is None:
        del at[last]
    else:
        at[last] = value
    return values


KEY = {"note": "A2", "strings": ["A2"]}


def entries(*keys: dict[str, Any]) -> dict[str, Any]:
    """Keys k0, k1, ... of a bundle."""
    return {"entries": {f"k{i}": key for i, key in enumerate(keys)}}


@pytest.mark.parametrize(
    ("path", "value", "reason"),
    [
        ("schema", "tonewood-instrument/3", "schema: tonewood-instrument/3 is of a later version of tonewood"),
        ("schema", "instrument", "schema: Input should be 'tonewood-instrument/2', not 'instrument'"),
        ("title", None, "title: is missing"),
        ("tittle", "x", "tittle: is not a known key; did you mean title? allowed: schema, name, title"),
        ("strings.A2.tension", "tight", "strings.A2.tension: Input should be a valid number, not 'tight'"),
        ("strings.A2.tension", True, "strings.A2.tension"),
        ("strings.A2.tension", 1e9, "strings.A2.tension: is 1000000000 N; at most 2000 N is allowed"),
        ("strings.A2.tensoin", 7.0, "strings.A2.tensoin: is not a known key; did you mean tension?"),
        ("strings.A2.note", "H2", "strings.A2.note: 'H2' is not a note"),
        ("strings.A2.note", None, "strings.A2: either `note` or `freq` is wanted"),
        ("strings.A2.end", "body.wings", "no point 'body.wings'; did you mean body.wing? there are body.bridge"),
        ("strings.A2.axis", [1, 1, 0], "strings.A2.axis: has length 1.414"),
        ("strings.A2.polarizations", ["x", "z"], "strings.A2.polarizations: lies along the string"),
        ("strings.A2.polarizations", ["z", "z"], "strings.A2.polarizations: lies along the string, or repeats"),
        ("strings.A2.plugin", "pluck_ramp", "strings.A2.plugin: plugin 'pluck_ramp' is of kind exciter"),
        ("strings.A2.plugin", "no_such", "strings.A2.plugin: there is no plugin 'no_such' of kind resonator; "),
        ("strings.A2.loss", {"law": "woodhouse"}, "strings.A2.loss.eta_f: is missing"),
        ("strings.defaults", 3, "strings.defaults: holds keys that are merged"),
        ("strings.body", {"note": "A2"}, "a string cannot be called body"),
        ("strings.2A", {"note": "A2"}, "strings.2A"),
        ("body.points", {}, "body.points"),
        ("body.points.bridge.direction", "w", "body.points.bridge.direction"),
        ("stops.count", 2.5, "stops.count: Input should be a valid integer, not 2.5"),
        ("stops.model", "soft", "stops.model: Input should be 'ideal' or 'finger'"),
        ("exciters", {}, "exciters"),
        ("connections", {"k": {"plugin": "tip_mass", "strings": ["E5"]}}, "connections.k"),
        ("playing.exciter", "plukc", "playing.exciter: there is no exciter 'plukc'; did you mean pluck?"),
        ("playing.noises", {"key": "pluck"}, "playing.noises.key: 'pluck' acts on strings; an exciter with `at`"),
        ("playing.noises", {"touch": "tap"}, "playing.noises.touch: 'tap' acts on body.wing; an exciter of strings"),
        ("playing.slurs", {"up": "tap"}, "playing.slurs.up: 'tap' acts on body.wing; an exciter of strings, without"),
        ("playing.noises", {"key": "tip"}, "playing.noises.key: there is no exciter 'tip'; there are pluck, tap"),
        ("playing.keyswitches", {"H1": "pluck"}, "playing.keyswitches.H1"),
        ("playing.keyswitches", {"C1": "bow"}, "playing.keyswitches.C1: there is no exciter 'bow'; "),
        ("keys", entries(KEY | {"strings": ["A2", "X"]}), "keys.entries.k0.strings: there is no string 'X'"),
        ("keys", entries(KEY | {"note": "H2"}), "keys.entries.k0.note: 'H2' is not a note"),
        ("keys", entries(KEY | {"note": "B2"}), "k0.note: is B2, and its string A2 sounds A2; the same note is"),
        ("keys", entries(KEY | {"note": 45.4, "una_corda": 2}), "k0.una_corda: is 2; 1 to 1, the number of its"),
        ("keys", entries(KEY, KEY), "keys.entries.k1.strings: string 'A2' is one of key k0; a string has one key"),
        ("keys", entries(KEY) | {"exciter": "ham"}, "keys.exciter: there is no exciter 'ham'"),
        ("strings_from", "ej46", "ej46 has 6 strings (E2, A2, D3, G3, B3, E4); this instrument has 2"),
        ("exciters.tap.at", "body.no", "exciters.tap.at: there is no point 'body.no'"),
        ("playing.velocity", {"parameter": "bow.force"}, "playing.velocity.parameter: there is no exciter 'bow'"),
        ("playing.velocity", {"parameter": "pluck.speed"}, "no parameter of pluck 'speed'; there are force"),
        ("playing.velocity", {"low": 0.0}, "playing.velocity: an exponential curve needs low and high above 0"),
        ("playing.velocity", {"parameter": "pluck.from_bridge", "low": 0.1, "high": 0.2}, "is no force or speed"),
        ("playing.velocity", {"high": 4e5}, "playing.velocity.high: pluck.force is 400000 N; at most 1000 N"),
        ("playing.velocity", {"parameter": "pluck.linear"}, "playing.velocity.low: pluck.linear Input should be a"),
        ("playing.controls.cc74", {"parameter": "tap.duration", "low": -1, "high": 1}, "playing.controls.cc74.low: "),
        ("playing.controls.cc999", {"parameter": "pluck.force", "low": 0, "high": 1}, "playing.controls.cc999"),
        ("outputs.0.full_scale", 0, "outputs.0.full_scale"),
        ("outputs.1.name", "bridge", "the output name 'bridge' is taken"),
        ("outputs.1.name", "A2", "the output name 'A2' is taken"),
        ("effects", {"budget_db": 3}, "effects.budget_db: is 3 dB; at most 0 dB is allowed"),
        ("provenance", {"body": {"kind": "measured", "source": "x"}}, "provenance.body.source: there is no source 'x'"),
        ("provenance", {"body": {"kind": "measured"}}, "provenance.body.source: measured figures need a source"),
        ("provenance", {"body": {"kind": "guessed"}}, "provenance.body.kind"),
    ],
)  # fmt: skip
def test_faults_are_one_line_with_file_and_key(
    make: Make, values: dict[str, Any], path: str, value: Any, reason: str
) -> None:
    with pytest.raises((BundleError, PluginError)) as fault:
        make(put(values, path, value))
    line = str(fault.value)
    assert "\n" not in line
    assert "instrument.yaml" in line
    assert reason in line


@pytest.mark.parametrize(
    "name", ["../body.csv", "/etc/hostname", "sub/../../body.csv", "no.csv", "a\\b.csv", "C:x", ""]
)
def test_tables_stay_inside_the_bundle(make: Make, values: dict[str, Any], tmp_path: Path, name: str) -> None:
    (tmp_path.parent / "body.csv").write_text("f_Hz,Q,bridge,wing\n100,20,1,1\n")
    instrument = make(put(values, "body.table", name))
    with pytest.raises(BundleError, match=r"body\.table: .*(leads out of the bundle|no file)"):
        assemble(instrument, 16000)


def test_links_out_of_the_bundle_are_refused(make: Make, values: dict[str, Any], tmp_path: Path) -> None:
    outside = tmp_path.parent / "outside.csv"
    outside.write_text("f_Hz,Q,bridge,wing\n100,20,1,1\n")
    os.symlink(outside, tmp_path / "link.csv")
    with pytest.raises(BundleError, match="leads out of the bundle"):
        assemble(make(put(values, "body.table", "link.csv")), 16000)


def test_loading_by_path_and_by_name(tmp_path: Path) -> None:
    with pytest.raises(BundleError, match=r"'no_such_harp': is neither installed nor a folder; installed: african"):
        Instrument.load("no_such_harp")
    with pytest.raises(BundleError, match=r"there is no instrument\.yaml in it"):
        Instrument.load(tmp_path)
    (tmp_path / "instrument.yaml").write_text("schema: tonewood-instrument/1\nname: [\n")
    with pytest.raises(BundleError, match=r"instrument\.yaml: line \d"):
        Instrument.load(tmp_path)
    installed = Instrument.load("monochord")
    assert Instrument.load(installed.folder).resolved == installed.resolved
    assert Instrument.load(installed.folder / "instrument.yaml").resolved == installed.resolved


def test_overrides(make: Make) -> None:
    small = make()
    changed = small.replace(
        {
            "strings.*.bending_stiffness": {"scale": 2},
            "strings.D3.note": "C3",
            "exciters.pluck.from_bridge": {"fraction": 0.4},
            "outputs.bridge.full_scale": 100,
            "body.truncation.residual_compliance": 1e-8,
        }
    )
    assert changed.resolved["strings"]["A2"]["bending_stiffness"] == 8e-5
    assert changed.open_note("D3") == 48
    assert changed.resolved["outputs"][0]["full_scale"] == 100
    assert small.resolved["strings"]["A2"]["bending_stiffness"] == 4e-5
    assert small.replace({}) is small
    freq = small.replace({"strings.A2.freq": 108.0})  # takes the note's place
    assert freq.resolved["strings"]["A2"]["note"] is None
    assert freq.open_note("A2") == pytest.approx(45 - 0.31767, abs=1e-4)


@pytest.mark.parametrize(
    ("path", "value", "reason"),
    [
        ("strings.E2.note", "D2", "strings.E2.note: there is no 'E2'; there is A2, D3"),
        ("strings.A2.note.x", 1, "holds a value, nothing lies below it"),
        ("strings..note", 1, "is not a dotted path"),
        ("strings.A2.note", {"scale": 2}, "strings.A2.note: 'A2' cannot be scaled by 2"),
        ("strings.A2.tension", {"scale": "x"}, "cannot be scaled"),
        ("outputs.drum.full_scale", 1, "there is no 'drum' in outputs; there is bridge, wing"),
        ("strings.*.tension", -1, "strings.A2.tension"),
        ("strings.A2.strength", 1, "strings.A2.strength: is not a known key"),
    ],
)
def test_wrong_overrides(make: Make, path: str, value: Any, reason: str) -> None:
    with pytest.raises(TonewoodError) as fault:
        make().replace({path: value})
    assert reason in str(fault.value)
    assert "\n" not in str(fault.value)


def test_assignments_on_the_command_line() -> None:
    assert parse_assignment("strings.E2.note=D2") == ("strings.E2.note", "D2")
    assert parse_assignment("a.b = 2e-3") == ("a.b", 2e-3)
    assert parse_assignment("a.b={scale: 2}") == ("a.b", {"scale": 2})
    assert parse_assignment("a.b=[0, 0, 1]") == ("a.b", [0, 0, 1])
    assert parse_assignment("a.b=null") == ("a.b", None)
    for text in ("a.b", "=3", "a=", "a=[1"):
        with pytest.raises(BundleError):
            parse_assignment(text)


def test_lists_by_number_and_star() -> None:
    values = {"outputs": [{"name": "a", "x": 1}, {"name": "b", "x": 2}]}
    assert apply_overrides(values, {"outputs.1.x": 5})["outputs"][1]["x"] == 5
    assert [o["x"] for o in apply_overrides(values, {"outputs.*.x": {"scale": 3}})["outputs"]] == [3, 6]
    assert values["outputs"][0]["x"] == 1


def test_provenance_takes_the_most_exact_path(make: Make, values: dict[str, Any]) -> None:
    values["sources"] = {"w": {"text": "a paper", "licence": "facts"}}
    values["provenance"] = {
        "strings.*": {"kind": "published", "source": "w"},
        "strings.*.tilt_deg": {"kind": "authored"},
        "strings.D3": {"kind": "stand_in"},
    }
    small = make(values)

    def kind(path: str) -> str | None:
        found = small.origins.of(path)
        return found.kind if found else None

    assert kind("strings.A2.tension") == "published"
    assert kind("strings.A2.tilt_deg") == "authored"
    assert kind("strings.D3.tension") == "stand_in"
    assert kind("body.table") is None
    assert small.origins.stand_ins() == ["strings.D3"]


def test_scales_of_the_bundle(make: Make, values: dict[str, Any], tmp_path: Path) -> None:
    (tmp_path / "just.scl").write_text("! just.scl\njust\n 12\n" + "\n".join(
        ["16/15", "9/8", "6/5", "5/4", "4/3", "45/32", "3/2", "8/5", "5/3", "9/5", "15/8", "2/1"]) + "\n")  # fmt: skip
    values["tuning"] = {"scale": "just.scl", "reference_freq": 440.0}
    string = assemble(make(values), 16000).strings["D3"]
    assert string.freq(7) / string.freq(0) == pytest.approx(40 / 27, rel=1e-9)  # D to A, the just scale's narrow fifth
    outside = tmp_path.parent / "outside.scl"
    outside.write_text((tmp_path / "just.scl").read_text().replace("3/2", "700.0"))
    for name in ("a" * 3000, "a\0b"):
        with pytest.raises(BundleError, match=r"tuning\.scale: .* cannot be followed to a file"):
            make().replace({"tuning.scale": name})
    changed = make().replace({"tuning.scale": str(outside)})  # whoever overrides may name any file
    assert changed.replace({"stops.count": 3}).tuning.freq(67) / changed.tuning.freq(60) == pytest.approx(2 ** (7 / 12))
    assert changed.content_hash != make(dict(make().resolved)).content_hash
    with pytest.raises(BundleError, match="leads out of the bundle"):
        make({**values, "tuning": {"scale": str(outside)}}).tuning  # noqa: B018
    values["tuning"] = {"scale": "none.scl"}
    with pytest.raises(BundleError, match=r"tuning\.scale: there is no file 'none\.scl'"):
        make(values).tuning  # noqa: B018


def test_velocity_and_controllers(make: Make) -> None:
    playing = make().spec.playing
    velocity = playing.velocity  # 0.4 N to 4 N, exponentially
    assert [velocity.value(v) for v in (1, 64, 127)] == pytest.approx([0.4, 0.4 * 10**0.5, 4.0])
    assert (velocity.value(0), velocity.value(200)) == (pytest.approx(0.4), pytest.approx(4.0))
    linear = make().replace({"playing.velocity.curve": "linear"}).spec.playing.velocity
    assert linear.value(64) == pytest.approx(2.2)
    control = playing.controls["cc74"]
    assert [control.value(x) for x in (0.0, 0.5, 1.0)] == pytest.approx([0.03, 0.14, 0.25])


def test_an_instrument_crosses_processes_whole(make: Make) -> None:
    small = make().replace({"strings.D3.note": "C3"})
    again = pickle.loads(pickle.dumps(small))
    assert again.resolved == small.resolved
    assert again.open_note("D3") == 48


@pytest.mark.parametrize("name", sorted(tw.list_instruments()))
def test_shipped_tables_are_those_of_their_provenance(name: str) -> None:
    instrument = tw.load_instrument(name)
    assert instrument.origins.table_doubts() == []
    entry = instrument.origins.of("body.table")
    assert entry is not None
    assert entry.sha256 is not None or entry.kind in ("authored", "stand_in")


def test_another_table_does_not_keep_its_measurement(tmp_path: Path) -> None:
    """One figure changed in a copy; then the hash taken out; then the entry made true."""
    folder = tmp_path / "mine"
    shutil.copytree(tw.list_instruments()["classical_guitar"], folder)
    table, manifest = folder / "body.csv", folder / "instrument.yaml"
    old = hashlib.sha256(table.read_bytes()).hexdigest()
    lines = table.read_text().splitlines(keepends=True)
    table.write_text("".join([*lines[:-1], lines[-1].replace("1", "2", 1)]))
    new = hashlib.sha256(table.read_bytes()).hexdigest()
    (line,) = tw.load_instrument(folder).origins.table_doubts()
    assert line.startswith(
        f"body: body.csv is not the table that its provenance calls measured (body): its SHA-256 is {new}"
    )
    manifest.write_text(manifest.read_text().replace(f",\n    sha256: {old}", ""))
    (line,) = tw.load_instrument(folder).origins.table_doubts()
    assert line.startswith("body: its provenance says measured (body) without the SHA-256 of body.csv")
    manifest.write_text(manifest.read_text().replace("body: {kind: measured, source: body}", "body: {kind: authored}"))
    assert tw.load_instrument(folder).origins.table_doubts() == []


def test_a_table_put_in_by_an_override_is_doubted(tmp_path: Path) -> None:
    folder = tmp_path / "mine"
    shutil.copytree(tw.list_instruments()["classical_guitar"], folder)
    (folder / "other.csv").write_bytes((folder / "body.csv").read_bytes() + b"\n")
    (line,) = tw.load_instrument(folder).replace({"body.table": "other.csv"}).origins.table_doubts()
    assert "other.csv is not the table" in line


def test_a_content_hash_is_of_values_files_and_plugins_and_of_no_order(tmp_path: Path) -> None:
    def hashed(**changes: Any) -> str:
        given = {"resolved": {"a": 1.0, "b": {"c": 2, "d": 3}}, "granted": [], "plugins": {"x": "1", "y": "2"}}
        return content_hash(folder=tmp_path, **given | changes)

    (tmp_path / "table.csv").write_text("1,2\n")
    one = hashed()
    assert hashed(resolved={"b": {"d": 3, "c": 2}, "a": 1.0}, plugins={"y": "2", "x": "1"}) == one
    others = [hashed(resolved={"a": 1.0, "b": {"c": 2, "d": 4}}), hashed(plugins={"x": "1", "y": "3"})]
    (tmp_path / "table.csv").write_text("1,3\n")
    others.append(hashed())
    (tmp_path / "table.csv").rename(tmp_path / "chart.csv")
    others.append(hashed())
    assert len({one, *others}) == 5
