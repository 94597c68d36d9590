#!/usr/bin/env bash
# Runs the tests of arrays and lab, and `tonewood validate`, as other machines would: under each processor kernel of
# OpenBLAS, under each instruction set of the kernel, and under BLAS's default number of threads. A processor kernel is
# run together with the instruction set of its time, so that three runs meet all of them; the same tests under one of
# the two alone say which one fails. Names those this processor lacks, and leaves out those that the plain test command
# runs anyway. The environment that is active needs tonewood with its extra `test`. Arguments go to pytest, in place of
# the default choice of tests.
set -euo pipefail
cd "$(dirname "$0")/.."

python=${PYTHON:-python}
export MPLBACKEND=Agg
tests=("$@")
if [ ${#tests[@]} -eq 0 ]; then
    tests=(-n 2 tests/unit/physics/{modal,coupling,stepping,energy,passivity} tests/unit/lab tests/analytic tests/convergence)
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

here=$("$python" -c "from tonewood.support.blas import blas_libraries; print(*blas_libraries(), sep=', ')")
sets=$("$python" -c "from tonewood import _kernel; print(*_kernel.instruction_sets())")
echo "here: BLAS $here; instruction sets $sets"
lacking=()
threads=(-u OMP_NUM_THREADS -u OPENBLAS_NUM_THREADS) # of the first run alone: threads change sums of arrays
run=${sets%% *} # instruction sets that were run; the first is the one taken by default
while read -r core isa flags; do
    settings=()
    # shellcheck disable=SC2086  # flags are words
    if ! has $flags; then
        lacking+=("OPENBLAS_CORETYPE=$core")
    elif [[ $here != *" $core"* ]]; then
        settings+=("OPENBLAS_CORETYPE=$core")
    fi
    if [[ " $sets " != *" $isa "* ]]; then
        lacking+=("TONEWOOD_ISA=$isa")
    elif [[ " $run " != *" $isa "* ]]; then
        settings+=("TONEWOOD_ISA=$isa")
        run+=" $isa"
    fi
    if [ ${#settings[@]} -gt 0 ]; then
        under "${threads[@]}" "${settings[@]}"
        threads=()
    fi
done <<'TABLE'
Zen avx2 avx2 fma
Haswell avx2 avx2 fma
Prescott baseline pni
SkylakeX avx512 avx512f avx512dq avx512bw avx512vl
TABLE
echo "not run, as this processor lacks it: ${lacking[*]:-nothing}"
