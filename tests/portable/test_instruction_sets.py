"""The kernel runs on processors that lack the wider instruction sets it also holds."""

import importlib.util
import platform
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

SCORE = Path(__file__).parents[2] / "examples/scores/scale.mid"
#: the first byte of an instruction of AVX-512
EVEX = "62"


@pytest.mark.skipif(not (shutil.which("nm") and shutil.which("objdump")), reason="binutils are not installed")
@pytest.mark.parametrize("module", ["_kernel", "_methods"])
def test_functions_that_units_share_hold_no_avx512(module):
    """Units of all instruction sets instantiate the same functions of the standard library; the linker keeps one.

    A function that the baseline leaves inline may be that of AVX2: then only wider units call it.
    """
    spec = importlib.util.find_spec(f"tonewood.{module}")
    assert spec is not None
    assert spec.origin
    listed = subprocess.run(
        ["nm", "-D", "-S", "--defined-only", spec.origin], capture_output=True, text=True, check=True
    )
    shared = [row.split() for row in listed.stdout.splitlines() if re.search(r" [WV] ", row)]
    assert shared, "a module without shared functions tests nothing"
    spans = {(int(at, 16), int(at, 16) + int(size, 16), name) for at, size, _, name in shared}
    code = subprocess.run(["objdump", "-d", spec.origin], capture_output=True, text=True, check=True).stdout
    wide = [int(at, 16) for at in re.findall(rf"^ *([0-9a-f]+):\t{EVEX} ", code, re.M)]
    if platform.machine() == "x86_64" and module == "_kernel":
        assert wide, "nothing here was compiled for AVX-512, or objdump prints otherwise"
    assert not {name for at in wide for start, stop, name in spans if start <= at < stop}


@pytest.mark.validate
def test_a_processor_without_avx_renders(tmp_path):
    """On an emulated Nehalem the baseline set is chosen, and all of it can be executed."""
    if shutil.which("qemu-x86_64") is None:
        pytest.skip("needs qemu-x86_64")
    words = ["render", str(SCORE), "-i", "buzzing_monochord", "--stop", "0.5", "-o", str(tmp_path / "a.wav")]
    command = ["qemu-x86_64", "-cpu", "Nehalem", sys.executable, "-m", "tonewood", *words]
    done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "a.wav").stat().st_size > 10_000
