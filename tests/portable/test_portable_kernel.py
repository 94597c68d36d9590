"""The kernel without Python: a C++ program steps systems that Python assembled, on this processor and on aarch64."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import saved

import tonewood as tw
from tonewood.coupling.system import Injection, System
from tonewood.instrument.assembly import assemble
from tonewood.stepping.forcing import compile_force

HERE, KERNEL = Path(__file__).parent, Path(__file__).parents[2] / "src" / "kernel"
FLAGS = ["-std=c++20", "-O2", "-fno-math-errno", "-fno-trapping-math"]
LOW = {"connections.frets.action_first": 2.5e-4, "connections.frets.action_twelfth": 1.2e-3}
#: instrument, changes, samples; contacts enlarge a rounding with every touch, so those scenes are short
SCENES: dict[str, tuple[str, dict[str, Any], int]] = {
    "linear": ("classical_guitar", {}, 4800),
    "contacts": ("steel_guitar", {"strings.*.axial_stiffness": 0.0, **LOW}, 1200),
    "tension": ("steel_guitar", {}, 2400),
    "longitudinal": ("steel_guitar", {"strings.*.plugin": "geometric_string"}, 600),
}


def scene(name: str) -> tuple[System, list[Injection], int]:
    """All strings of an instrument pulled by 2 N and let go together."""
    instrument, changes, n = SCENES[name]
    model = assemble(tw.load_instrument(instrument).replace({**changes, "tuning.compensate": "none"}), 48000)
    gesture = model.exciters["pluck"].gesture(tw.Event({"force": 2.0}, 82.4), model.place("E2"))
    system, injections = model.system, list[Injection]()
    for string in model.strings.values():
        for component, weight in string.weights(gesture.angle_deg).items():
            basis = system.compiled[system.slot(component)].basis
            injections += compile_force(
                component, basis, "pluck", gesture.segments, system.dt, time=0.004, factor=weight
            )  # fmt: skip
    return system, injections, n


@pytest.fixture(scope="session")
def files(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder, out = tmp_path_factory.mktemp("saved"), {}
    for name in SCENES:
        system, injections, n = scene(name)
        out[name] = folder / f"{name}.arrays"
        saved.write(out[name], saved.record(system, n, injections))
    return out


@pytest.mark.parametrize("name", SCENES)
def test_files_hold_what_was_saved(files: dict[str, Path], name: str) -> None:
    system, injections, n = scene(name)
    arrays, wanted = saved.read(files[name]), saved.record(system, n, injections)
    assert list(arrays) == list(wanted)
    for key, values in wanted.items():
        assert np.array_equal(arrays[key], values)
        assert arrays[key].shape == values.shape
    assert bool(system.tensions) == (name == "tension") == ("tensions/strings/0/0" in arrays)
    assert bool(system.geometric) == (name == "longitudinal") == ("geometric/0/scale" in arrays)
    samples = arrays["samples"]
    assert samples.shape == (n, len(system.readouts))
    assert np.all(np.max(np.abs(samples), axis=0) > 0.0)


def program(compiler: str, contract: str, folder: Path) -> Path:
    """The C++ program, built without Python; `contract`: fast lets products and sums fuse, as the kernel is built."""
    out = folder / "step"
    table = ['-DTONEWOOD_ISA_NAME="baseline"', "-DTONEWOOD_ISA_TABLE=table_baseline"]
    includes = [f"-I{path}" for path in (HERE, KERNEL)]
    sources = [KERNEL / "isa.cpp", KERNEL / "kernel.cpp", HERE / "step.cpp"]
    command = [compiler, *FLAGS, f"-ffp-contract={contract}", *table, *includes, *sources, "-static", "-o", out]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return out


#: compiler, emulator, contract; the samples are those of this processor's baseline set, which has no fused operation.
#: A fused one rounds once in place of twice: 7e-14 of the peak in the linear scene, and up to 9e-11 in the others, as
#: AVX2 and AVX-512 differ from the baseline by up to 7e-11 there.
BUILDS = {
    "here": ("c++", [], "fast", 1e-12),
    "aarch64-separate": ("aarch64-linux-gnu-g++", ["qemu-aarch64"], "off", 1e-12),
    "aarch64-fused": ("aarch64-linux-gnu-g++", ["qemu-aarch64"], "fast", 1e-9),
}


@pytest.mark.validate
@pytest.mark.parametrize(("compiler", "emulator", "contract", "tolerance"), BUILDS.values(), ids=BUILDS)
def test_the_kernel_alone_gives_the_same_samples(
    files: dict[str, Path], tmp_path: Path, compiler: str, emulator: list[str], contract: str, tolerance: float
) -> None:
    if missing := [tool for tool in (compiler, *emulator) if shutil.which(tool) is None]:
        pytest.skip(f"needs {missing[0]}")
    step = program(compiler, contract, tmp_path)
    for allowed, names in ((1e-12, ["linear"]), (tolerance, [name for name in SCENES if name != "linear"])):
        command = [*emulator, step, str(allowed), *(files[name] for name in names)]
        done = subprocess.run(command, capture_output=True, text=True)
        print(done.stdout)
        assert done.returncode == 0, f"{names}: samples, peak, largest difference / peak\n{done.stdout}{done.stderr}"
