"""Finding plugins and instruments by entry points, with a made-up distribution on the path."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

import tonewood as tw
from tonewood.cli.main import run
from tonewood.errors import BundleError, PluginError
from tonewood.instrument.bundle.new_bundle import new_bundle
from tonewood.instrument.contract import registry


@pytest.fixture
def foreign(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A distribution that announces the lines of its entry_points.txt."""
    (tmp_path / "foreign-1.0.dist-info").mkdir()
    (tmp_path / "foreign-1.0.dist-info" / "METADATA").write_text("Metadata-Version: 2.1\nName: foreign\nVersion: 1.0\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    for cached in (registry.entries, registry.plugin, registry.plugin_hash):
        cached.cache_clear()
    yield tmp_path
    for cached in (registry.entries, registry.plugin, registry.plugin_hash):
        cached.cache_clear()
    sys.modules.pop("foreign_plugin", None)


def announce(folder: Path, text: str) -> None:
    (folder / "foreign-1.0.dist-info" / "entry_points.txt").write_text(text)


def test_a_foreign_plugin_is_found(foreign: Path) -> None:
    announce(foreign, "[tonewood.plugins]\nknock = foreign_plugin:Knock\n")
    (foreign / "foreign_plugin.py").write_text(
        "from tonewood.authoring import Exciter, Gesture, Segment\n"
        "from tonewood.support.params import Parameters, quantity\n"
        "class P(Parameters):\n    force: float = quantity('N', default=1.0, doc='peak')\n"
        "class Knock(Exciter):\n    'A knock.'\n    Parameters = P\n"
        "    def gesture(self, event, place):\n        return Gesture((Segment(0.0, 1e-3, 1.0),))\n"
    )
    assert "knock" in registry.list_plugins()
    assert registry.plugin("knock", "exciter").kind == "exciter"
    assert len(registry.plugin_hash("knock")) == 64


def test_the_same_name_twice(foreign: Path) -> None:
    announce(foreign, "[tonewood.plugins]\npluck_ramp = foreign_plugin:Knock\n")
    said = r"'pluck_ramp' is announced twice .*foreign.*one of them must go"
    with pytest.raises(PluginError, match=said):
        registry.plugin("pluck_ramp")
    assert registry.broken_plugins().keys() == {"pluck_ramp"}
    assert "hammer" in registry.list_plugins()
    assert "pluck_ramp" not in registry.list_plugins()


def test_an_instrument_announced_twice_leaves_the_others(foreign: Path) -> None:
    announce(foreign, "[tonewood.instruments]\nmonochord = foreign_instruments\n")
    with pytest.raises(BundleError, match="'monochord' is announced twice"):
        registry.instrument_folder("monochord")
    assert "monochord" not in registry.list_instruments()
    assert registry.instrument_folder("sitar").is_dir()


@pytest.mark.parametrize(
    ("value", "source", "reason"),
    [
        ("no_such_module:X", "", "plugin 'knock' of foreign cannot be imported"),
        ("foreign_plugin:Missing", "x = 1\n", "plugin 'knock' of foreign cannot be imported"),
        ("foreign_plugin:X", "class X: pass\n", "plugin 'knock' of foreign is not a class derived from"),
        ("foreign_plugin:X", "def broken(:\n", "plugin 'knock' of foreign cannot be imported"),
        ("foreign_plugin:X", "1 / 0\n", "plugin 'knock' of foreign cannot be imported: ZeroDivisionError"),
        ("foreign_plugin:X", "raise SystemExit(3)\n", "plugin 'knock' of foreign cannot be imported: SystemExit"),
        ("foreign_plugin", "x = 1\n", "plugin 'knock' of foreign cannot be imported"),
    ],
)
def test_a_broken_plugin_names_its_distribution(foreign: Path, value: str, source: str, reason: str) -> None:
    announce(foreign, f"[tonewood.plugins]\nknock = {value}\n")
    (foreign / "foreign_plugin.py").write_text(source)
    with pytest.raises(PluginError, match=reason):
        registry.plugin("knock")
    with pytest.raises(PluginError, match="'hammer' is of kind exciter; one of kind body is wanted: drawn_body, modal"):
        registry.plugin("hammer", "body")
    assert "\n" not in registry.broken_plugins()["knock"]
    assert "knock" not in registry.list_plugins()


def test_a_foreign_instrument(foreign: Path) -> None:
    announce(foreign, "[tonewood.instruments]\nlyre = foreign_instruments\nghost = no_such_package\n")
    (foreign / "foreign_instruments" / "lyre").mkdir(parents=True)
    (foreign / "foreign_instruments" / "__init__.py").write_text("")
    assert registry.instrument_folder("lyre") == foreign / "foreign_instruments" / "lyre"
    with pytest.raises(BundleError, match="instrument 'ghost' of foreign is not there"):
        registry.instrument_folder("ghost")


def test_built_ins_are_announced_like_anyone() -> None:
    assert {e.distribution for e in registry.entries(registry.PLUGINS).values()} >= {"tonewood"}
    assert {"classical_guitar", "flamenco_guitar", "african_harp", "monochord"} <= set(registry.list_instruments())


def test_what_is_broken_is_listed_beside_the_rest(foreign: Path, capsys: pytest.CaptureFixture[str]) -> None:
    announce(
        foreign,
        "[tonewood.plugins]\nknock = no_such_module:X\nplop = foreign_plugin:X\n"
        "[tonewood.instruments]\nghost = no_such_package\n",
    )
    (foreign / "foreign_plugin.py").write_text("1 / 0\n")
    for arguments in (["list", "--json"], ["list"]):
        with pytest.raises(SystemExit) as exit_:
            run(arguments)
        assert exit_.value.code == 0
    as_json, *text = capsys.readouterr().out.splitlines()
    found = json.loads(as_json)
    broken = {
        row["name"]: row["broken"] for kind in ("plugins", "instruments") for row in found[kind] if "broken" in row
    }
    assert broken.keys() == {"knock", "plop", "ghost"}
    assert "ZeroDivisionError" in broken["plop"]
    assert {"hammer", "monochord"} <= {row["name"] for kind in ("plugins", "instruments") for row in found[kind]}
    assert len([line for line in text if "broken: " in line]) == 3
    # and the others play
    audio = tw.render(tw.Score([tw.Note(0.0, 0.1, note=45)]), tw.load_instrument("monochord"), 8000, max_duration=0.02)
    assert audio.samples.any()


def test_a_folder_is_loaded_also_where_an_installed_instrument_has_its_name(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    copy = new_bundle(Path("monochord"), "monochord")
    assert copy.folder.resolve() == tmp_path / "monochord"
    assert copy.spec.title.startswith("monochord, begun as a copy")
    assert registry.instrument_folder("monochord") != Path("monochord")


FIT = """sources: {measurement: {text: a fit, licence: CC0-1.0}}
provenance:
  body: {kind: measured, source: measurement}
body:
  plugin: modal_table
  table: body.csv
  shapes: points
  points:
POINTS
outputs:
  - name: bridge
    plugin: point_pickup
    quantity: acceleration
    at: {mean: [body.middle]}
    full_scale: 700.0
"""


@pytest.mark.parametrize(
    ("places", "strings", "ends"),
    [
        # along the bridge -1 to 1: six strings at -1, -0.6, -0.2, 0.2, 0.6, 1
        ({"bass": -1.0, "middle": 0.05, "treble": 1.0}, "ej46", "bass bass middle middle treble treble"),
        ({"bass": -0.7, "middle": 0.0, "treble": None}, "ej46", "bass bass middle middle middle middle"),
        ({"bass": -1.0, "middle": None}, "ej46", "bass bass bass bass bass bass"),  # the only one with a place
        ({"bass": None, "middle": None}, "ej46", "middle middle middle middle middle middle"),  # it was driven
    ],
)
def test_strings_of_a_fitted_body_end_at_the_nearest_points(
    tmp_path: Path, places: dict[str, float | None], strings: str, ends: str
) -> None:
    fit = tmp_path / "fitted"
    fit.mkdir()
    rows = [f"    {k}: {{direction: z{'' if u is None else f', u: {u}'}}}" for k, u in places.items()]
    (fit / "body.yaml").write_text(FIT.replace("POINTS", "\n".join(rows)))
    names = ",".join(places)
    (fit / "body.csv").write_text(f"f_Hz,Q,{names}\n200,30,{','.join('1' for _ in places)}\n")
    made = new_bundle(tmp_path / "mine", str(fit), strings=None if strings == "ej46" else strings)
    spec = made.spec
    assert [part.ends for part in spec.strings.values()] == [(f"body.{end}",) for end in ends.split()]
    assert [part.note for part in spec.strings.values()] == ["E2", "A2", "D3", "G3", "B3", "E4"]
    assert (made.name, spec.title) == ("mine", f"mine, a measured body with {strings} strings")
    assert (spec.licence, spec.provenance["body"].kind, spec.provenance["strings.*"].kind) == (
        "unknown", "measured", "unknown",
    )  # fmt: skip
    assert sorted(path.name for path in (tmp_path / "mine").iterdir()) == [
        "body.csv", "instrument.schema.json", "instrument.yaml",
    ]  # fmt: skip
    assert (tmp_path / "mine" / "body.csv").read_bytes() == (fit / "body.csv").read_bytes()


def test_what_a_new_bundle_cannot_be_made_of_leaves_nothing(tmp_path: Path) -> None:
    fit = tmp_path / "fitted"
    fit.mkdir()
    (fit / "body.yaml").write_text(FIT.replace("POINTS", "    middle: {direction: q}"))
    (fit / "body.csv").write_text("f_Hz,Q,middle\n200,30,1\n")
    for name, source, said in (
        ("mine", fit, "direction"), ("1st", fit, "cannot be the name of an instrument"),
        ("mine", tmp_path, "monochord"),
    ):  # fmt: skip
        with pytest.raises(BundleError, match=said):
            new_bundle(tmp_path / name, str(source))
    (fit / "body.yaml").write_text("sources: {}\nbody: {}\noutputs: []\n")
    with pytest.raises(BundleError, match="no file of a fit: this key is missing") as fault:
        new_bundle(tmp_path / "mine", str(fit))
    assert fault.value.key == "provenance"
    assert [path.name for path in tmp_path.iterdir()] == ["fitted"]


def test_a_copy_with_another_string_set_drops_what_the_set_says(tmp_path: Path) -> None:
    made = new_bundle(tmp_path / "mine", "classical_guitar", strings="ej46")
    original = tw.load_instrument("classical_guitar").spec
    assert made.spec.strings_from == "ej46"
    assert {key: (part.ends, part.note) for key, part in made.spec.strings.items()} == {
        key: (part.ends, part.note) for key, part in original.strings.items()
    }
    for path, entry in original.provenance.items():
        if not path.startswith("strings."):
            assert made.spec.provenance[path].kind == "unknown"
            assert f"where it is {entry.kind}" in str(made.spec.provenance[path].note)
    said = {path for path, entry in made.spec.provenance.items() if entry.source == "strings_ej46"}
    assert "strings.*.linear_density" in said
    text = (tmp_path / "mine" / "instrument.yaml").read_text()
    assert "linear_density" not in text.partition("strings:")[2].partition("\n\n")[0]
