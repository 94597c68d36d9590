"""The reader of saved models in C++ under sanitizers: of a damaged file it gives samples or one line, never more.

`mutate.cpp` damages and reads; `small_models.py` has the files that it begins with.
"""

from __future__ import annotations

import re
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import saved
from small_models import NAMES, write_small_models

from tonewood.sound.render.model_file import MAGIC, Arrays, write_arrays

ROOT = Path(__file__).parents[2]
KERNEL, EMBED = ROOT / "src" / "kernel", ROOT / "src" / "embed"
SANITIZERS = ["-O1", "-g1", "-fsanitize=address,undefined", "-fno-sanitize-recover=all", "-D_GLIBCXX_ASSERTIONS"]
MUTATIONS, PROCESSES = 1_000_000, 2
ENVIRONMENT = {
    "ASAN_OPTIONS": "allocator_may_return_null=0:max_allocation_size_mb=2500:detect_leaks=0",
    "UBSAN_OPTIONS": "halt_on_error=1:print_stacktrace=1",
}


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    return {file.stem: file for file in write_small_models(tmp_path_factory.mktemp("models"))}


def test_the_small_models_have_what_a_model_can_have(files: dict[str, Path]) -> None:
    """Every group of arrays that the reader knows is in one of them."""
    assert len(files) == len(NAMES) + 1
    names = {name for file in files.values() for name in saved.read(file)}
    wanted = (
        "components/0/contact_rows", "components/0/kick", "linear/inverse", "linear/parts/0/places", "linear/hub/span",
        "nonlinear/samples/0/1", "potentials/0/at", "potentials/0/parts/0/slopes", "plucks/0/0/0",
        "potentials/0/parts/0/weights", "fs", "scale", "capacity", "n_channels",
    )  # fmt: skip
    assert not set(wanted) - names
    kinds = {int(kind) for file in files.values() for kind in saved.read(file)["nonlinear/kinds"]}
    assert kinds == {0, 1, 2, 4}  # 3 are C functions, which no file can hold
    ports = [len(saved.read(files["many_ports"])[f"components/{i}/w"]) for i in range(18)]
    assert max(ports) >= 16  # modal/shape_step.hpp


@pytest.fixture(scope="session")
def mutate(tmp_path_factory: pytest.TempPathFactory) -> Path:
    compiler = next((c for c in ("clang++", "clang++-16", "c++") if shutil.which(c)), None)
    if compiler is None:
        pytest.skip("needs a C++ compiler")
    out = tmp_path_factory.mktemp("sanitized") / "mutate"
    table = ['-DTONEWOOD_ISA_NAME="baseline"', "-DTONEWOOD_ISA_TABLE=table_baseline", f"-I{EMBED}", f"-I{KERNEL}"]
    sources = [KERNEL / "isa.cpp", KERNEL / "kernel.cpp", Path(__file__).with_name("mutate.cpp")]
    command = [compiler, "-std=c++20", *SANITIZERS, "-Wno-psabi", *table, *sources, "-o", out]
    done = subprocess.run(command, capture_output=True, text=True)
    if "cannot find -lasan" in done.stderr or "libclang_rt" in done.stderr:
        pytest.skip("needs the libraries of the sanitizers")
    assert done.returncode == 0, done.stderr
    return out


def read_by(mutate: Path, file: Path) -> subprocess.CompletedProcess[str]:
    """The file read and played, undamaged."""
    return subprocess.run([mutate, "0", "0", file], capture_output=True, text=True, env=ENVIRONMENT, cwd=file.parent)


def set_to(name: str, value: object) -> Callable[[Arrays], None]:
    def change(arrays: Arrays) -> None:
        arrays[name] = np.asarray(value)

    return change


def at(name: str, index: int | tuple[int, ...], value: float) -> Callable[[Arrays], None]:
    def change(arrays: Arrays) -> None:
        arrays[name][index] = value

    return change


def without(name: str) -> Callable[[Arrays], None]:
    def change(arrays: Arrays) -> None:
        del arrays[name]

    return change


def no_modes(arrays: Arrays) -> None:
    for name in ("e", "rows", "w"):
        arrays[f"components/0/{name}"] = arrays[f"components/0/{name}"][..., :0]


DAMAGES: list[tuple[str, Callable[[Arrays], None], str]] = [
    ("linear", set_to("components/0/e", np.ones((4, 16), dtype=int)), "components/0/e is i8, not f8"),
    ("linear", set_to("components/0/e", np.zeros((1,) * 40)), "components/0/e has a shape that is not allowed"),
    ("linear", without("components/1/e"), "components/1/e is missing"),
    ("linear", without("components/1/key"), "components/1/.* belongs to nothing"),
    ("linear", at("components/0/e", (0, 0), np.nan), "components/0/e is not finite at 0"),
    ("linear", at("components/0/w", (0, 0, 0), -np.inf), "components/0/w is not finite at 0"),
    ("linear", set_to("components/0/offset", 16), "offset"),
    ("linear", set_to("components/0/offset", -16), r"components/0/offset is -16, not 0 to"),
    ("linear", set_to("components/0/channels", [2**40]), "components/0/channels has the value"),
    ("linear", no_modes, "(offset|modes)"),
    ("linear", set_to("capacity", 2**40), "capacity is"),
    ("linear", set_to("capacity", 4096), "capacity is not the number of modes"),
    ("linear", set_to("n_channels", 2**31), "n_channels is"),
    ("linear", set_to("nonlinear/dt", 0.0), "nonlinear/dt is not above 0"),
    ("linear", set_to("nonlinear/dt", [0.1]), "nonlinear/dt is no single number"),
    ("linear", set_to("plucks/0/0/0", 9), "plucks/0/0/0 is 9, not 0 to 2"),
    ("linear", set_to("plucks/0/0/1", -(2**63)), "plucks/0/0/1 is -9223372036854775808"),
    ("linear", set_to("plucks/0/0/3", np.ones((3, 40))), "plucks/0/0/2 and 3 do not fit"),
    ("linear", set_to("plucks/0/0/2", np.ones((1, 2, 160))), "plucks/0/0/2 and 3 do not fit"),
    ("linear", set_to("fs", 1e300), "fs is not"),
    ("linear", set_to("scale", [1.0]), "scale has not one number a channel"),
    ("laws", set_to("nonlinear/kinds", [0, 1, 9, 4]), "no law has the number 9"),
    ("laws", set_to("nonlinear/kinds", [0, 1, 3, 4]), "nonlinear.functions: law 2 is missing"),
    ("laws", set_to("nonlinear/numbers", np.ones((1, 8))), "nonlinear/numbers has the shape"),
    ("laws", set_to("nonlinear/factors", np.ones(99)), "nonlinear/factors has the shape"),
    ("laws", set_to("nonlinear/terms", np.ones((2, 3), dtype=int)), "nonlinear/terms has another shape"),
    ("laws", set_to("nonlinear/samples/0/0", 7), "nonlinear/samples/0/0: there is no law 7"),
    ("laws", set_to("nonlinear/samples/0/1", [0.0, 0.0, 1.0]), "has not rising knots"),
    ("sampled", without("nonlinear/samples/0/1"), "nonlinear/samples/0/1 is missing"),
    ("tension", set_to("potentials/0/at", 2**31 - 1), "a state of so many numbers is not needed"),
    ("tension", set_to("potentials/1/slots", [0]), "component 0 belongs to another potential"),
    ("tension", set_to("potentials/0/kind", 7), "potentials/0/kind is 7, not 0 to 3"),
    ("tension", set_to("potentials/1/kind", 3), "function: none is given"),
    ("longitudinal", set_to("potentials/0/parts/0/slopes", np.ones((2, 999))), r"parts\[0\].slopes: they do not fit"),
    ("longitudinal", set_to("potentials/0/parts/1/slopes", np.ones((2, 0))), r"parts\[1\].slopes: they do not fit"),
    ("phantoms", set_to("potentials/0/at", 2**31 - 1), "a state of so many numbers is not needed"),
    ("phantoms", set_to("potentials/0/slots", [77]), "no component 77"),
    ("in_parts", set_to("linear/hub/ports", np.zeros(0, dtype=int)), "linear.hub"),
    ("in_parts", set_to("linear/hub/point", np.full(8, 99)), "linear.hub.point: there is no such point"),
    ("in_parts", at("linear/parts/0/places", (0, 0), 1e9), "there is no such connection"),
]


@pytest.mark.validate
@pytest.mark.parametrize(("name", "damage", "reason"), DAMAGES, ids=[f"{n}: {r}" for n, _, r in DAMAGES])
def test_what_does_not_fit_is_refused_by_its_name(
    mutate: Path, files: dict[str, Path], tmp_path: Path, name: str, damage: Callable[[Arrays], None], reason: str
) -> None:
    arrays = {key: values.copy() for key, values in saved.read(files[name]).items()}
    damage(arrays)
    write_arrays(tmp_path / "damaged", arrays)
    done = read_by(mutate, tmp_path / "damaged")
    assert done.returncode == 1
    assert re.fullmatch(rf"\S+: f: [ -~]*{reason}[ -~]*\n", done.stderr)


@pytest.mark.validate
def test_a_plane_whose_modes_all_lie_above_the_solved_band_plays(
    mutate: Path, files: dict[str, Path], tmp_path: Path
) -> None:
    arrays = dict(saved.read(files["longitudinal"]))
    slopes = arrays["potentials/0/parts/0/slopes"]
    arrays["potentials/0/parts/0/slopes"] = slopes[:, :0]
    write_arrays(tmp_path / "whole", arrays)
    done = read_by(mutate, tmp_path / "whole")
    assert (done.returncode, done.stderr) == (0, "")


HEADERS = [
    b"", b"tonewood-arrays/2\n", MAGIC + b"a f8 4294967296 4294967296\n", MAGIC + b"a f8 2305843009213693952\n",
    MAGIC + b"a f8 0 18446744073709551616\n", MAGIC + b"a f8 0 2147483647\n", MAGIC + b"a f8 -1\n",
    MAGIC + b"a f8 1.5\n" + bytes(16), MAGIC + b"a f8 2\n" + bytes(15), MAGIC + b"a f4 1\n" + bytes(8),
    MAGIC + b"a\n", MAGIC + b"n" * 10_000, MAGIC + b"\x1b[31m f8\n" + bytes(8), MAGIC + b"a f8\n" + bytes(8) + b"b",
    MAGIC + 2 * (b"a f8\n" + bytes(8)), MAGIC + b"\n", MAGIC,
]  # fmt: skip


@pytest.mark.validate
@pytest.mark.parametrize("number", range(len(HEADERS)))
def test_lines_that_do_not_fit_are_refused(mutate: Path, tmp_path: Path, number: int) -> None:
    """Sizes that overflow or exceed the file, and names with characters that a terminal would obey."""
    (tmp_path / "damaged").write_bytes(HEADERS[number])
    done = read_by(mutate, tmp_path / "damaged")
    assert done.returncode == 1
    assert done.stderr.startswith(f"{tmp_path / 'damaged'}: f: ")
    assert (done.stderr.count("\n"), done.stderr.isprintable()) == (1, False)  # the newline alone is not printable
    assert done.stderr[:-1].isprintable()


@pytest.mark.validate
def test_a_million_damaged_files_give_samples_or_one_line(mutate: Path, files: dict[str, Path], tmp_path: Path) -> None:
    each, running = MUTATIONS // PROCESSES, []
    for seed in range(PROCESSES):
        folder = tmp_path / str(seed)
        folder.mkdir()
        command = [mutate, str(each), str(seed * each), *files.values()]
        pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
        running.append(subprocess.Popen(command, env=ENVIRONMENT, cwd=folder, **pipes))
    for process in running:
        out, errors = process.communicate()
        assert process.returncode == 0, f"{process.args}: {errors[-3000:]}"
        n, played, refused = map(int, out.split())
        assert (n, played + refused) == (each, each)
        assert played > 0.1 * n  # some still play, so that the steps are reached as well
        assert refused > 0.1 * n
