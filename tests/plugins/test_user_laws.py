"""A plugin's own potential, as C functions from every door they come by and as a table: no kernel was touched."""

from __future__ import annotations

import ctypes
import importlib
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scene import instrument

import tonewood as tw
import tonewood.authoring as ta
from tonewood.instrument.contract import registry

STIFFNESS, EXPONENT, ROOM = 2e9, 2.0, 2e-4
SOURCE = """
double potential(double d) { return d < 0 ? -2e9 / 3 * d * d * d : 0; }
double slope(double d) { return d < 0 ? -2e9 * d * d : 0; }
double with_data(double d, void *k) { return d < 0 ? -*(double *)k / 3 * d * d * d : 0; }
double slope_with_data(double d, void *k) { return d < 0 ? -*(double *)k * d * d : 0; }
"""
MODULE = '''
import tonewood.authoring as ta

LAW = None


class CushionParameters(ta.Parameters):
    """Of the cushion."""

    from_bridge: float = ta.quantity("m", low=0.0, high=2.0, doc="place under the string")


class Cushion(ta.Attachment[CushionParameters]):
    """Something under the string that pushes back as its maker says."""

    api = 1
    Parameters = CushionParameters

    def attach(self, name, site):
        point = f"{name}.at"
        connection = ta.Connection(f"{site.string}.{point}", site.motion(point, (0.0, 0.0, 1.0)), LAW)
        return ta.Attached(places={point: self.parameters.from_bridge}, connections=(connection,))
'''


@pytest.fixture
def cushion(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """A foreign package's plugin ``cushion``, as if it were installed."""
    (tmp_path / "foreign_cushion.py").write_text(MODULE)
    info = tmp_path / "foreign_cushion-0.1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: foreign-cushion\nVersion: 0.1.0\n")
    (info / "entry_points.txt").write_text("[tonewood.plugins]\ncushion = foreign_cushion:Cushion\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    caches = (registry.entries, registry.plugin, registry.plugin_hash)
    for cached in caches:
        cached.cache_clear()
    monkeypatch.delitem(sys.modules, "foreign_cushion", raising=False)
    yield importlib.import_module("foreign_cushion")
    monkeypatch.delitem(sys.modules, "foreign_cushion", raising=False)
    for cached in caches:
        cached.cache_clear()


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> Path:
    compiler = shutil.which("cc")
    if compiler is None:
        pytest.skip("no C compiler")
    folder = tmp_path_factory.mktemp("laws")
    (folder / "law.c").write_text(SOURCE)
    made = folder / "law.so"
    subprocess.run([compiler, "-O2", "-shared", "-fPIC", str(folder / "law.c"), "-o", str(made)], check=True)
    return made


def by_ctypes(library: Path) -> tuple[Any, Any]:
    lib = ctypes.CDLL(str(library))
    double = ctypes.CFUNCTYPE(ctypes.c_double, ctypes.c_double)
    return ctypes.cast(lib.potential, double), ctypes.cast(lib.slope, double)


def by_cffi(library: Path) -> tuple[Any, Any]:
    cffi = pytest.importorskip("cffi")
    ffi = cffi.FFI()
    ffi.cdef("double potential(double); double slope(double);")
    lib = ffi.dlopen(str(library))
    return ffi.addressof(lib, "potential"), ffi.addressof(lib, "slope")


def with_data(library: Path) -> tuple[Any, Any]:
    """Functions that get their stiffness by a pointer."""
    from scipy import LowLevelCallable

    lib, stiffness = ctypes.CDLL(str(library)), ctypes.c_double(STIFFNESS)
    kind = ctypes.CFUNCTYPE(ctypes.c_double, ctypes.c_double, ctypes.c_void_p)
    data = ctypes.cast(ctypes.pointer(stiffness), ctypes.c_void_p)
    functions = (ctypes.cast(f, kind) for f in (lib.with_data, lib.slope_with_data))
    return tuple(LowLevelCallable(f, data) for f in functions)  # type: ignore[return-value]  # two of them


def by_numba(library: Path) -> tuple[Any, Any]:
    numba = pytest.importorskip("numba")
    potential = numba.cfunc("float64(float64)")(lambda d: -2e9 / 3 * d**3 if d < 0 else 0.0)
    slope = numba.cfunc("float64(float64)")(lambda d: -2e9 * d**2 if d < 0 else 0.0)
    return potential.ctypes, slope.ctypes


def heard(folder: Path, module: Any, law: Any) -> np.ndarray:
    """A note over the cushion with some law."""
    module.LAW = law
    made = instrument(folder, connections={"under": {"plugin": "cushion", "from_bridge": 0.15}})
    return tw.render(tw.Score([tw.Note(0.0, 0.2, string="S", force=1.5)]), made, max_duration=0.06).samples


@pytest.mark.parametrize("door", [by_ctypes, by_cffi, with_data, by_numba])
def test_c_functions_in_a_bundle_are_the_law(tmp_path: Path, cushion: Any, library: Path, door: Any) -> None:
    """They are the power law that the kernel has itself."""
    ours = heard(tmp_path, cushion, ta.CompiledPotential(*door(library), offset=-ROOM))
    theirs = heard(tmp_path, cushion, ta.Contact(STIFFNESS, EXPONENT, offset=-ROOM))
    away = heard(tmp_path, cushion, ta.Contact(STIFFNESS, EXPONENT, offset=-1.0))
    assert np.abs(theirs - away).max() > 0.1 * np.abs(theirs).max()  # it is met
    np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-8 * np.abs(theirs).max())


def test_a_table_in_a_bundle_comes_near(tmp_path: Path, cushion: Any) -> None:
    theirs = heard(tmp_path, cushion, ta.Contact(STIFFNESS, EXPONENT, offset=-ROOM))
    d, errors = -1e-4 * np.linspace(1.0, 0.0, 1001), []
    for every in (20, 2):
        x = np.append(d[::every], 1e-4)
        law = ta.SampledPotential.from_force(x, STIFFNESS * np.maximum(-x, 0.0) ** EXPONENT, offset=-ROOM)
        errors.append(np.abs(heard(tmp_path, cushion, law) - theirs).max() / np.abs(theirs).max())
    assert errors[0] < 0.05
    assert errors[1] < 0.1 * errors[0]
