"""A wheel built from this checkout, installed elsewhere, renders; and its contents."""

from __future__ import annotations

import doctest
import importlib.util
import json
import os
import re
import shutil
import subprocess
import sys
import tomllib
import zipfile
from importlib import import_module
from pathlib import Path
from types import ModuleType

import pytest

import tonewood as tw
from tonewood import authoring
from tonewood.support import moved

ROOT = Path(__file__).parents[1]

PUBLIC_IN_0_1 = """
Attached Attachment Audio Body BodyPoint BridgeForce BundleError CompiledPotential Connection Contact Control DAMPERS
Direction Drive Dropped DroppedNotesWarning Effect EffectReport Event Exciter Fraction Friction Gesture
HardeningSpring Hold Instrument LONGITUDINAL Longitudinal LossLaw ModalBasis Model Motion Norms Note
NothingPlayedError Number NumericalError OutputError Parameters PassivityError Pickup PickupRows Place Plan Playback
Plugin PluginError Probe Readout Renderer Resonator SampledPotential Scene Score ScoreError Segment Site SpringDashpot
StringPlace Summary TENSION_MODULATION Tail Term TonewoodError Vector assemble check_basis contact_effect described
dot list_instruments list_plugins load_instrument loose_mass metres partials pitch pitches plan play quantity
read_midi render repair_basis retuned smooth_step string_basis string_carry string_transfer unit_vector wavenumber
with_damping_case write_midi
"""


def test_every_public_name_is_there_and_typed() -> None:
    for name in tw.__all__:
        assert getattr(tw, name) is not None
    text = (ROOT / "src" / "tonewood" / "__init__.py").read_text(encoding="utf-8")
    typed = set(re.findall(r"import (\w+) as \1", text))
    assert typed == set(tw.__all__) - {"__version__"}
    with pytest.raises(AttributeError, match="no attribute 'rendre'"):
        _ = tw.rendre


def test_names_that_have_moved_still_work_and_say_where_they_are() -> None:
    """Every public name of version 0.1, one release later."""
    for name in PUBLIC_IN_0_1.split():
        if name in tw.__all__:
            continue
        with pytest.warns(DeprecationWarning, match=f"tonewood.{name} is deprecated since 0.2") as reported:
            value = getattr(tw, name)
        place, _, last = str(reported[0].message).rpartition(" ")[2].rpartition(".")
        assert getattr(import_module(place), last) is value
    assert len(tw.__all__) <= 21


OLD_MODULES = """
blas errors params plotting tables units yaml_io coupling.connections coupling.laws coupling.system energy.account
engine.effects.base engine.engine engine.gestures engine.playing engine.timeline fit.fit instrument.added
instrument.assembly instrument.effects instrument.gestures instrument.registry instrument.schema instrument.strings
instrument.tuning instrument.wolf listening.models live.receiver modal.modes modal.string_modes output.audio
output.live output.options output.render output.stream passivity.basis plate.body score.midi score.note score.scales
stepping.kernel stepping.stepper batch.manifest report.facts
"""


@pytest.mark.slow
def test_modules_that_have_moved_still_answer_and_say_where_they_are() -> None:
    """Modules of version 0.2, under the names that they had; the very same objects."""
    program = (
        "import importlib, sys, warnings\nwarnings.simplefilter('always')\n"
        "for name in sys.argv[1:]:\n"
        "    with warnings.catch_warnings(record=True) as seen:\n"
        "        module = importlib.import_module(f'tonewood.{name}')\n"
        "    text = [str(w.message) for w in seen if issubclass(w.category, DeprecationWarning)]\n"
        "    new = text[-1].rpartition(' ')[2] if text else f'tonewood.{name}'\n"
        "    assert module is importlib.import_module(new) and module.__spec__.name == new, (name, new)\n"
        "    assert (name == 'errors') == (not text), (name, text)\n"
        "    assert not text or seen[-1].filename.endswith('importlib/__init__.py'), seen[-1].filename\n"
        "from tonewood.instrument.contract import Resonator\n"
        "from tonewood.instrument.bundle import load_instrument\n"
        "from tonewood.instrument.inspection import pitch\n"
        "from tonewood.instrument.contract import Exciter\n"
    )
    done = subprocess.run([sys.executable, "-c", program, *OLD_MODULES.split()], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("module", [tw, authoring], ids=lambda m: m.__name__)
def test_examples_in_docstrings_of_public_modules_run(module: ModuleType) -> None:
    assert doctest.testmod(module).attempted > 0
    assert doctest.testmod(module).failed == 0


def test_importing_costs_nothing() -> None:
    program = "import sys, tonewood; print([m for m in ('numpy', 'scipy', 'pydantic', 'typer') if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_versions_agree() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert tw.__version__ == project["version"]
    assert f"version: {project['version']}" in (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert f"## [{project['version']}]" in (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    assert project["license"] == "MIT AND CC-BY-4.0"


def test_every_bundled_folder_is_announced() -> None:
    folders = {p.parent.name for p in (ROOT / "instruments").glob("*/instrument.yaml")}
    assert folders <= set(tw.list_instruments())
    modules = {p.stem for p in (ROOT / "plugins").glob("[a-z]*.py")}
    announced = {plugin.__module__.rpartition(".")[2] for plugin in tw.list_plugins().values()}
    assert modules <= announced


@pytest.mark.validate
def test_a_wheel_renders_in_a_fresh_environment(tmp_path: Path) -> None:
    """Dependencies are borrowed from this environment, tonewood is not."""
    dist, venv, home = tmp_path / "dist", tmp_path / "venv", tmp_path / "home"
    home.mkdir()
    build = [sys.executable, "-m", "pip", "wheel", "-q", "--no-deps", "-w", dist, str(ROOT)]
    subprocess.run(build, check=True, cwd=home)
    (wheel,) = dist.glob("tonewood-*.whl")
    names = zipfile.ZipFile(wheel).namelist()
    for wanted in ("tonewood/py.typed", "tonewood/plugins/stiff_string.py", "tonewood/_kernel.pyi"):
        assert wanted in names
    for folder in (ROOT / "instruments").glob("*/instrument.yaml"):
        for file in folder.parent.iterdir():
            assert f"tonewood/instruments/{folder.parent.name}/{file.name}" in names
    assert any(n.startswith("tonewood/_kernel.") and n.endswith((".so", ".pyd")) for n in names)
    assert any(n.endswith("licenses/LICENSE") for n in names)
    assert not [n for n in names if n.startswith(("tests", "docs", "examples"))]
    here = tmp_path / "here"
    install = [sys.executable, "-m", "pip", "install", "-q", "--no-deps", "--target", here, wheel]
    subprocess.run(install, check=True, cwd=home)
    # a fresh environment runs no .pth files of this one, which might lead back to the checkout
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", venv], check=True)
    python = venv / "bin" / "python"
    packages = [str(here), *(p for p in sys.path if "site-packages" in p)]
    env = {**os.environ, "PYTHONPATH": os.pathsep.join(packages), "HOME": str(home)}
    program = "import tonewood; print(tonewood.__file__)"
    found = subprocess.run([python, "-c", program], env=env, cwd=home, capture_output=True, text=True, check=True)
    assert found.stdout.startswith(str(here))
    score = ROOT / "examples" / "scores" / "chords.mid"
    command = [python, "-m", "tonewood", "render", score, "-i", "classical_guitar", "-o", "chords.wav", "--json"]
    done = subprocess.run(command, env=env, cwd=home, capture_output=True, text=True, check=True)
    report = json.loads(done.stdout)
    assert report["notes"] == 24
    assert report["peak_dbfs"] == pytest.approx(-1.0, abs=1e-6)  # --level peak
    assert (home / "chords.wav").stat().st_size > 1e6


def test_the_licence_is_the_text_of_an_approved_one() -> None:
    text = (ROOT / "LICENSE").read_text(encoding="utf-8")
    assert text.startswith("MIT License\n")
    assert "Permission is hereby granted, free of charge" in text
    assert (ROOT / "LICENSES" / "CC-BY-4.0.txt").stat().st_size > 10_000


def script_of(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, ROOT / "scripts" / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    script = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(script)
    return script


def test_links_of_the_packages_page_lead_to_the_repository() -> None:
    """An index of packages has no folder `docs`; every target is there, in the repository."""
    page = script_of("package_page").absolute((ROOT / "README.md").read_text(encoding="utf-8"), "https://h.invalid/t")
    links = re.findall(r"(!?)\[[^\]]*\]\(([^)]*)\)", page)
    assert len(links) > 20
    for picture, target in links:
        folder = "https://h.invalid/t/raw/main/" if picture else "https://h.invalid/t/blob/main/"
        assert target.startswith(folder), target
        assert (ROOT / target.removeprefix(folder)).is_file(), target
    kept = "[a](https://b.invalid/c) [d](#e)"
    assert script_of("package_page").absolute(kept, "https://h.invalid/t") == kept


def test_one_command_writes_the_address_of_the_project(tmp_path: Path) -> None:
    script = script_of("project_address")
    placeholder, _ = script.addresses()
    listed = subprocess.run(["git", "grep", "-lF", placeholder], cwd=ROOT, capture_output=True, text=True, check=False)
    named = set(listed.stdout.split()) - {"scripts/project_address.py"}
    assert not named or named == {name for name in script.FILES if placeholder in (ROOT / name).read_text("utf-8")}
    for name in script.FILES:
        shutil.copy(ROOT / name, tmp_path / name)
    source, docs = "https://forge.invalid/group/tonewood", "https://pages.invalid/tonewood"
    assert script.write(source, docs, tmp_path)
    assert script.addresses(tmp_path) == (source, docs)
    assert placeholder not in "".join((tmp_path / name).read_text(encoding="utf-8") for name in script.FILES)
    assert script.write("https://b.invalid/tonewood", "https://c.invalid/d", tmp_path)  # and once more
    assert "forge.invalid" not in "".join((tmp_path / name).read_text(encoding="utf-8") for name in script.FILES)


def test_every_deprecated_package_has_its_line() -> None:
    page = (ROOT / "docs" / "deprecations.md").read_text(encoding="utf-8")
    for package in moved._PACKAGES:
        assert package.split(".")[0] in page
    for _, new in moved._MODULES:
        assert new.split(".")[0] in page
