"""Imports point down only, and plugins import one public module: read from the sources."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

from tonewood import authoring

ROOT = Path(__file__).parents[1]
SOURCES = ROOT / "src" / "tonewood"

#: bottom to top; rooms, and below them their packages; those of one set may not import each other
LAYERS = (
    {"errors", "_kernel", "_methods"},
    {"support"},
    {"instrument/scales"},
    {"physics/modal", "physics/plate"},
    {"physics/coupling", "physics/passivity"},
    {"physics/stepping"},
    {"physics/energy"},
    {"performance/score"},
    {"instrument/contract"},
    {"instrument/bundle"},
    {"instrument/model"},
    {"instrument/inspection"},
    {"performance/player"},
    {"performance/effects"},
    {"performance/engine"},
    {"authoring"},
    {"sound/level", "sound/room", "sound/equalizer"},
    {"sound/files"},
    {"sound/render"},
    {"sound/live", "sound/ensemble"},
    {"workshop/batch", "workshop/design", "workshop/fit", "workshop/report", "workshop/web", "lab"},
    {
        "workshop/desk",
        "workshop/listening",
        "workshop/dataset",
        "workshop/estimate",
        "workshop/sampling",
        "workshop/taps",
    },
    {"workshop/exchange", "workshop/wood"},
    {"cli"},
    {"__init__", "__main__"},
)
RANK = {name: rank for rank, names in enumerate(LAYERS) for name in names}

#: packages that compute: arrays, no files, no formats
COMPUTING = ("modal", "plate", "coupling", "stepping", "energy", "passivity")
#: rooms that are divided into packages
ROOMS = ("physics", "instrument", "performance", "sound", "workshop")
#: and the packages that they may import
ARRAYS_ONLY = {"numpy", "scipy", "matplotlib", "threadpoolctl", "tonewood"}
STANDARD_FORBIDDEN = {"json", "csv", "io", "tempfile", "shutil", "subprocess"}


def imports(path):
    """(module, name or None, line) of everything a file imports, wherever in it."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from ((alias.name, None, node.lineno) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}:{node.lineno}: write whole module names"
            yield from ((node.module or "", alias.name, node.lineno) for alias in node.names)


def layer_of(module, name=None):
    """Name of the layer that ``from module import name`` reaches into; None for a room as a whole."""
    parts = module.split(".")[1:]
    if parts and parts[0] in ROOMS:
        inner = parts[1:2] or ([name] if name else [])
        return "/".join([parts[0], *inner]) if inner else None
    if parts:
        return parts[0]
    return name if name in RANK else "__init__"  # from tonewood import errors, or a public name


FILES = sorted(SOURCES.rglob("*.py"))
#: rooms' own files: a line about the room
HOMES = {Path(room) / "__init__.py" for room in ROOMS}


@pytest.mark.parametrize("room", sorted({p.relative_to(SOURCES).parts[0] for p in FILES}))
def test_imports_point_down(room):
    for path in FILES:
        relative = path.relative_to(SOURCES)
        if relative.parts[0] == room and relative not in HOMES:
            check_imports(path, relative)


def check_imports(path, relative):
    own = layer_of(".".join(("tonewood", *relative.with_suffix("").parts)))
    for module, name, line in imports(path):
        if module.split(".")[0] != "tonewood":
            continue
        other = layer_of(module, name)
        assert other in RANK, f"{path}:{line}: {other} is in no layer"
        if other == own or (module, name) in {("tonewood", "__version__"), ("tonewood", "support")}:
            continue
        if relative.name == "__init__.py" and module == "tonewood.support.moved":
            continue
        assert RANK[other] < RANK[own], f"{relative}:{line}: {own} must not import {other}"


def test_no_modules_import_each_other_in_a_circle():
    """Imports inside of functions and under TYPE_CHECKING count, too; not the version and compiled modules."""
    modules = {".".join(("tonewood", *p.relative_to(SOURCES).with_suffix("").parts)): p for p in FILES}
    modules = {name.removesuffix(".__init__"): path for name, path in modules.items()}
    needs, bare = {}, {"__version__", "_kernel", "_methods"}
    for own, path in modules.items():
        found = {name if (name := f"{m}.{n}") in modules else m for m, n, _ in imports(path) if n not in bare}
        needs[own] = (found & set(modules)) - {own}
    while free := [name for name, others in needs.items() if not others & set(needs)]:
        for name in free:
            del needs[name]
    # the rest lies in a circle, or imports one
    while tops := set(needs) - {other for others in needs.values() for other in others}:
        for name in tops:
            del needs[name]
    assert needs == {}


def test_files_are_short():
    lengths = {p.relative_to(SOURCES).as_posix(): len(p.read_text(encoding="utf-8").splitlines()) for p in FILES}
    long = {name for name, n in lengths.items() if n > 500}
    assert not long


def test_the_architecture_draws_these_layers():
    block = (ROOT / "ARCHITECTURE.md").read_text(encoding="utf-8").split("```text\n")[1].partition("```")[0]
    drawn = [set(line.split()) for line in block.splitlines()]
    layers = [{name for name in names if not name.startswith("_")} for names in reversed(LAYERS)]
    assert drawn == [names for names in layers if names]


def test_the_architecture_names_files_where_they_are():
    """Each package's lines name modules of that package, or paths from the root or from the package's own folder."""
    block = (ROOT / "ARCHITECTURE.md").read_text(encoding="utf-8").split("```text\n")[2].partition("```")[0]
    folders, named = [SOURCES], 0
    for line in block.splitlines():
        indent = len(line) - len(line.lstrip())
        if entered := re.match(r" *((?:src/)?\w+)/ ", line):
            above = {
                0: [],
                4: [SOURCES, ROOT / "src" / "kernel"],
                8: [SOURCES / room for room in (*ROOMS, "lab")],
                12: [SOURCES / "physics" / "coupling"],
            }[indent]
            found = [path for base in [ROOT, *above] if (path := base / entered[1]).is_dir()]
            assert found, f"{line}: no such folder"
            folders = found
        elif line.startswith("src/"):
            folders = [ROOT / line.split("/ ")[0]]
        elif indent == 4:
            folders = [SOURCES, ROOT / "src" / "kernel"]
        for name in re.findall(r"[\w/]+\.(?:py|hpp)\b", line):
            places = [*folders, SOURCES, ROOT / "src", ROOT]
            assert any((place / name).exists() for place in places), f"{name} is not in {folders}"
            named += 1
    assert named > 150


def test_every_layer_is_there():
    present = {p.relative_to(SOURCES).as_posix().removesuffix(".py") for p in SOURCES.glob("*") if p.suffix != ".pyi"}
    present |= {
        p.relative_to(SOURCES).as_posix().removesuffix(".py") for room in ROOMS for p in SOURCES.glob(f"{room}/*")
    }
    present -= {*ROOMS, "py.typed"} | {name for name in present if "__pycache__" in name or name.endswith("/__init__")}
    present = {name for name in present if not name.startswith("_k") and not name.startswith("_m")}
    assert present == {name for name in RANK if not name.startswith(("_k", "_m"))}


def test_what_computes_knows_arrays_only():
    for path in (SOURCES / "physics").rglob("*.py"):
        for module, _, line in imports(path):
            root = module.split(".")[0]
            where = f"{path.relative_to(ROOT)}:{line}"
            assert root not in STANDARD_FORBIDDEN, f"{where}: reads and writes nothing"
            known = root in ARRAYS_ONLY or root in {"__future__", "collections", "dataclasses", "functools"}
            allowed = {
                "abc",
                "importlib",
                "ctypes",
                "enum",
                "itertools",
                "math",
                "os",
                "pathlib",
                "threading",
                "typing",
                "warnings",
                "weakref",
            }
            assert known or root in allowed, f"{where}: {module}"


def test_score_is_plain_data():
    """It knows no instrument classes: nothing above it (which the layers say), and no arrays of modes below it."""
    for path in (SOURCES / "performance" / "score").glob("*.py"):
        for module, _, line in imports(path):
            package = module.split(".")[2:3]
            assert not set(package) & set(COMPUTING), f"{path.relative_to(ROOT)}:{line}"


PLUGINS = sorted((ROOT / "plugins").glob("*.py")) + sorted((ROOT / "examples").rglob("*plugin*/**/*.py"))


@pytest.mark.parametrize("path", PLUGINS, ids=[p.name for p in PLUGINS])
def test_plugins_import_authoring_alone(path):
    """Another plugin that they derive from besides, and their tests `tonewood` itself."""
    allowed = {"tonewood.authoring"} | ({"tonewood"} if path.parent.name == "tests" else set())
    for module, name, line in imports(path):
        if module.split(".")[0] == "tonewood" and not module.startswith("tonewood.plugins."):
            assert module in allowed, f"{path.relative_to(ROOT)}:{line}: {module}"
            assert name is None or name in authoring.__all__, f"{path.relative_to(ROOT)}:{line}: {name}"


def test_nothing_but_the_package_is_imported_by_plugins():
    """numpy, scipy, pydantic and the standard library, besides tonewood itself; Numba in a module of its own."""
    import sys

    for path in PLUGINS:
        for module, _, line in imports(path):
            root = module.split(".")[0]
            allowed = root in sys.stdlib_module_names or root in {"numpy", "scipy", "pydantic", "tonewood", "pytest"}
            allowed |= root == "numba" and path.name == "_gong_energy_numba.py"
            own = any((p / at).exists() for p in path.parents for at in (root, f"{root}.py", f"src/{root}"))
            assert allowed or own, f"{path.relative_to(ROOT)}:{line}: {module}"


def test_importing_the_package_is_light():
    """Heavy parts of scipy and every drawing or audio library wait until they are used."""
    import subprocess
    import sys

    script = "import sys, tonewood; print(' '.join(sorted(sys.modules)))"
    loaded = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True).stdout.split()
    heavy = {"scipy.signal", "scipy.optimize", "matplotlib", "sounddevice", "dask", "pyloudnorm", "scipy.linalg"}
    assert heavy & set(loaded) == set()
