#!/usr/bin/env bash
# Runs the tests of arrays and lab, and `tonewood validate`, as other machines would: under each processor kernel of
# OpenBLAS, each instruction set of the kernel, and BLAS's default number of threads, one of these changed at a time.
# Names those this processor lacks, and leaves out what the plain test command runs anyway. The environment that is
# active needs tonewood with its extra `test`. Arguments go to pytest, in place of the default choice of tests.
set -euo pipefail
cd "$(dirname "$0")/.."

python=${PYTHON:-python}
export MPLBACKEND=Agg
tests=("$@")
if [ ${#tests[@]} -eq 0 ]; then
    tests=(-n 2 tests/unit/{modal,coupling,stepping,energy,passivity,lab} tests/analytic tests/convergence)
fi

has() { # whether the processor has all of these flags
    for flag in "$@"; do grep -qw -- "$flag" /proc/cpuinfo 2>/dev/null || return 1; done
}
under() { # the settings VARIABLE=VALUE or -u VARIABLE
    echo "-- $*"
    env "$@" "$python" -m pytest -q -r fE -p no:cacheprovider "${tests[@]}"
    env "$@" "$python" -m tonewood validate >"$log" || { cat "$log"; exit 1; }
    tail -n 1 "$log"
}
log=$(mktemp)
trap 'rm -f "$log"' EXIT

here=$("$python" -c "from tonewood.blas import blas_libraries; print(*blas_libraries(), sep=', ')")
sets=$("$python" -c "from tonewood import _kernel; print(*_kernel.instruction_sets())")
echo "here: BLAS $here; instruction sets $sets"
lacking=()
while read -r core flags; do
    # shellcheck disable=SC2086  # flags are words
    if ! has $flags; then
        lacking+=("OPENBLAS_CORETYPE=$core")
    elif [[ $here != *" $core"* ]]; then
        under "OPENBLAS_CORETYPE=$core"
    fi
done <<'TABLE'
Prescott pni
Haswell avx2 fma
Zen avx2 fma
SkylakeX avx512f avx512dq avx512bw avx512vl
TABLE
for isa in avx512 avx2 baseline; do
    if [[ " $sets " != *" $isa "* ]]; then
        lacking+=("TONEWOOD_ISA=$isa")
    elif [[ $sets != "$isa"* ]]; then # the first is the one taken by default
        under "TONEWOOD_ISA=$isa"
    fi
done
if [ $# -eq 0 ]; then # threads change sums of arrays; lab only reads them
    tests=(-n 2 tests/unit/{modal,coupling,stepping,energy,passivity})
fi
under -u OMP_NUM_THREADS -u OPENBLAS_NUM_THREADS
echo "not run, as this processor lacks it: ${lacking[*]:-nothing}"
