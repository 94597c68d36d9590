#!/usr/bin/env bash
# Builds the kernel with AddressSanitizer and UndefinedBehaviorSanitizer into a throwaway environment and runs the tests
# that reach it there. Needs Clang with its sanitizer libraries (Debian: clang-16 and libclang-rt-16-dev), or GCC, which
# takes half an hour to build this; CXX names one. Arguments go to pytest, in place of the default choice of tests.
set -euo pipefail
cd "$(dirname "$0")/.."

python=${PYTHON:-python3}
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
export OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 PIP_DISABLE_PIP_VERSION_CHECK=1 MPLBACKEND=Agg

"$python" -m venv "$work/venv"
# shellcheck disable=SC1091
. "$work/venv/bin/activate"
if [ -z "${CXX:-}" ] && command -v clang++-16 >/dev/null && clang++-16 -print-runtime-dir >/dev/null; then
    export CXX=clang++-16
fi
if [[ ${CXX:-} == *clang* ]]; then
    LD_LIBRARY_PATH=$("$CXX" -print-runtime-dir)${LD_LIBRARY_PATH:+:$LD_LIBRARY_PATH}
    export LD_LIBRARY_PATH
fi
echo "== building by ${CXX:-c++}"
pip install -q ".[test]" --config-settings=build-dir="$work/build" --config-settings=cmake.define.TONEWOOD_SANITIZE=ON --config-settings=install.strip=false

module=$(cd "$work" && python -c "import importlib.util as u; print(u.find_spec('tonewood._kernel').origin)")
# the interpreter is not built with the sanitizer: its library has to come first, and with it that of C++, whose throw it
# wraps when it starts
library=$(ldd "$module" | awk '/lib(clang_rt\.)?asan/ { a = $3 } /libstdc\+\+|libc\+\+\.so/ { s = $3 } END { if (a) print a " " s }')
if [ -z "$library" ]; then
    echo "the kernel was not linked against AddressSanitizer: $module" >&2
    exit 1
fi

tests=("$@")
if [ ${#tests[@]} -eq 0 ]; then
    # whatever runs the kernel: linear, nonlinear, culled and tension-modulated contacts, geometric strings
    mapfile -t tests < <(grep -lE 'KernelStepper|_kernel' tests/unit/physics/{coupling,stepping,energy}/test_*.py)
    tests+=(tests/stability/test_kernel_door.py tests/stability/test_tails.py
        tests/unit/lab/test_compiled_methods.py)
fi
echo "== testing with $library"
# leaks are the interpreter's own at exit; a fault ends the run with its report
ASAN_OPTIONS=detect_leaks=0:halt_on_error=1:strict_string_checks=1 \
UBSAN_OPTIONS=halt_on_error=1:print_stacktrace=1 \
LD_PRELOAD="$library" python -m pytest -s -q -x -p no:cacheprovider "${tests[@]}"
echo "== no fault found"
