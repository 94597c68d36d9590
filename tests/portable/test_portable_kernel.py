"""The kernel without Python: a C++ program steps systems that Python assembled, on this processor and on aarch64."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import pytest
import saved

import tonewood as tw
from tonewood.errors import OutputError, TonewoodError
from tonewood.instrument.model.assembly import assemble
from tonewood.physics.coupling import elimination
from tonewood.physics.coupling.inverse import InverseInParts
from tonewood.physics.coupling.system import Injection, System
from tonewood.physics.stepping.forcing import compile_force
from tonewood.physics.stepping.stepper import NumpyStepper
from tonewood.sound.render.model_file import save_model, write_arrays

ROOT = Path(__file__).parents[2]
HERE, KERNEL, EMBED = Path(__file__).parent, ROOT / "src" / "kernel", ROOT / "src" / "embed"
FLAGS = ["-std=c++20", "-O2", "-fno-math-errno", "-fno-trapping-math"]
LOW = {"connections.frets.action_first": 2.5e-4, "connections.frets.action_twelfth": 1.2e-3}
#: instrument, changes, samples; contacts enlarge a rounding with every touch, so those scenes are short
SCENES: dict[str, tuple[str, dict[str, Any], int]] = {
    "linear": ("classical_guitar", {}, 4800),
    "in parts": ("classical_guitar", {}, 4800),
    "contacts": ("steel_strings", {"strings.*.axial_stiffness": 0.0, **LOW}, 1200),
    "tension": ("steel_strings", {}, 2400),
    "longitudinal": ("steel_strings", {"strings.*.plugin": "geometric_string"}, 600),
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
    if name == "in parts":  # as hundreds of strings are
        with patch.multiple(elimination, LEAST_IN_PARTS=6, MOST_IN_PART=4):
            assert isinstance(system.solve.by, InverseInParts)
    return system, injections, n


@pytest.fixture(scope="session")
def files(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder, out = tmp_path_factory.mktemp("saved"), {}
    for name in SCENES:
        system, injections, n = scene(name)
        out[name] = folder / f"{name}.arrays"
        write_arrays(out[name], saved.record(system, n, injections))
    return out


@pytest.mark.parametrize("name", SCENES)
def test_files_hold_what_was_saved(files: dict[str, Path], name: str) -> None:
    system, injections, n = scene(name)
    arrays, wanted = saved.read(files[name]), saved.record(system, n, injections)
    assert list(arrays) == list(wanted)
    for key, values in wanted.items():
        assert np.array_equal(arrays[key], values)
        assert arrays[key].shape == values.shape
    assert bool(system.potentials) == (name in ("tension", "longitudinal")) == ("potentials/0/kind" in arrays)
    assert (name == "longitudinal") == ("potentials/0/parts/0/slopes" in arrays)
    samples = arrays["samples"]
    assert samples.shape == (n, len(system.readouts))
    assert np.all(np.max(np.abs(samples), axis=0) > 0.0)


def program(compiler: str, contract: str, folder: Path, source: Path = HERE / "compare.cpp") -> Path:
    """A C++ program, built without Python; `contract`: fast lets products and sums fuse, as the kernel is built."""
    out = folder / source.stem
    table = ['-DTONEWOOD_ISA_NAME="baseline"', "-DTONEWOOD_ISA_TABLE=table_baseline"]
    includes = [f"-I{path}" for path in (EMBED, KERNEL)]
    sources = [KERNEL / "isa.cpp", KERNEL / "kernel.cpp", source]
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
    compare = program(compiler, contract, tmp_path)
    for allowed, names in ((1e-12, ["linear", "in parts"]), (tolerance, ["contacts", "tension", "longitudinal"])):
        command = [*emulator, compare, str(allowed), *(files[name] for name in names)]
        done = subprocess.run(command, capture_output=True, text=True)
        print(done.stdout)
        assert done.returncode == 0, f"{names}: samples, peak, largest difference / peak\n{done.stdout}{done.stderr}"


def test_a_saved_instrument_has_its_plucks_and_scales(tmp_path: Path) -> None:
    guitar = tw.load_instrument("classical_guitar")
    save_model(tmp_path / "guitar.tonewood", guitar, 24000, stops={"A2": 3})
    arrays = saved.read(tmp_path / "guitar.tonewood")
    assert (arrays["fs"], arrays["n_channels"]) == (pytest.approx(24000.0), 2)
    assert np.allclose(arrays["scale"], 1 / 40)
    assert {name.split("/")[1] for name in arrays if name.startswith("plucks/")} == set("012345")
    with pytest.raises(TonewoodError, match="stops: there is no string H2; there are E2, A2"):
        save_model(tmp_path / "a.tonewood", guitar, stops={"H2": 3})
    for stop in (99, -1, 2.5, float("nan"), "3"):
        with pytest.raises(TonewoodError, match=rf"^stops: A2 is {stop!r}; whole numbers from 0 to 19 are allowed"):
            save_model(tmp_path / "a.tonewood", guitar, stops={"A2": stop})  # type: ignore[dict-item]
    for fs in (0, float("nan"), -1.0, 1e9, "48000"):
        with pytest.raises(TonewoodError, match=r"^fs: is .*; 1000 to 1e"):
            save_model(tmp_path / "a.tonewood", guitar, fs)  # type: ignore[arg-type]
    with pytest.raises(TonewoodError, match="moves a partner"):
        save_model(tmp_path / "a.tonewood", "bowed_monochord")
    with pytest.raises(OutputError, match="there is no folder"):
        save_model(tmp_path / "none" / "a.tonewood", "monochord")
    assert not (tmp_path / "a.tonewood").exists()


@pytest.mark.validate
def test_the_example_of_embedding_plays_what_python_plays(tmp_path: Path) -> None:
    """Both channels of the WAV file, to a unit of its 16 bits; strings are plucked every 0.25 s, in whole blocks."""
    import soundfile as sf

    if shutil.which("c++") is None:
        pytest.skip("needs c++")
    save_model(tmp_path / "guitar.tonewood", "classical_guitar")
    pluck = program("c++", "fast", tmp_path, ROOT / "examples" / "embedding" / "pluck.cpp")
    done = subprocess.run(
        [pluck, tmp_path / "guitar.tonewood", tmp_path / "a.wav", "1"], capture_output=True, text=True
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert "6 strings" in done.stdout
    arrays, system = (
        saved.read(tmp_path / "guitar.tonewood"),
        assemble(tw.load_instrument("classical_guitar"), 48000).system,
    )
    sound, fs = sf.read(tmp_path / "a.wav")
    assert (fs, sound.shape[1]) == (48000, 2)
    # the first pluck alone sounds for 0.25 s: its injections, stepped by the NumPy stepper on the system of the model
    stepper = NumpyStepper(system)
    state, n = system.start(), 9600
    first = [name for name in arrays if name.startswith("plucks/0/") and name.endswith("/2")]
    injections = []
    for name in first:
        slot, start, vectors, values = (arrays[name[:-1] + key] for key in "0123")
        modes = vectors[:, :, : system.compiled[int(slot)].basis.n_modes]  # without the padding
        injections.append(Injection(system.names[int(slot)], int(start), modes.swapaxes(1, 2), values))
    wanted = stepper.run(state, n, injections)[0] * arrays["scale"]
    scale = np.vdot(wanted, sound[:n]) / np.vdot(wanted, wanted)
    assert np.abs(sound[:n] - scale * wanted).max() < 2 / 32768
