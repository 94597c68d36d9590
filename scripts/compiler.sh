#!/usr/bin/env bash
# Builds the kernel with another compiler and runs the kernel's tests on it, in the environment that is active, which
# needs tonewood's dependencies with the extra `test`.
#     scripts/compiler.sh COMPILER [ARGUMENTS OF PYTEST...]      e.g. clang++-16
set -euo pipefail
cd "$(dirname "$0")/.."

compiler=${1:?the name of a C++ compiler is wanted}
shift
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
export OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 PIP_DISABLE_PIP_VERSION_CHECK=1 MPLBACKEND=Agg

tests=("$@")
[ ${#tests[@]} -gt 0 ] || tests=(-n 2 tests/unit/physics/{stepping,coupling} tests/stability/test_kernel_door.py)
CXX=$compiler pip install -q --no-deps --target "$work/built" --config-settings=build-dir="$work/build" . >"$work/log" 2>&1 || { tail -50 "$work/log"; exit 1; }
export PYTHONPATH=$work/built
python -c "import tonewood._kernel as k; assert k.__file__.startswith('$work'), k.__file__; print(k.COMPILER)"
python -m pytest -q -p no:cacheprovider "${tests[@]}"
