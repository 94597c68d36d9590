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
