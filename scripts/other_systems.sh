#!/usr/bin/env bash
# Compiles the kernel, every instruction set of it, and the program of examples/embedding for systems that are not here,
# with the compiler of PyPI's ziglang. Objects only: nothing is linked or run, and Python's interface is left out.
#     scripts/other_systems.sh [TARGET...]     default: Windows, macOS on both processors, Linux on aarch64
set -euo pipefail
cd "$(dirname "$0")/.."

targets=("$@")
[ ${#targets[@]} -gt 0 ] || targets=(x86_64-windows-gnu x86_64-macos aarch64-macos aarch64-linux-gnu)
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
"${PYTHON:-python3}" -m venv "$work/venv"
"$work/venv/bin/pip" install -q ziglang
compile() { # target, source, flags
    "$work/venv/bin/python" -m ziglang c++ -target "$1" -std=c++20 -O1 -ffp-contract=fast -fno-math-errno \
        -fno-trapping-math -Isrc/kernel -Isrc/embed "${@:3}" -c "$2" -o "$work/unit.o"
    printf '%-20s %-8s %s\n' "$1" "$(stat -c %s "$work/unit.o")" "$2 ${*:3}"
}
unit() { compile "$1" src/kernel/isa.cpp "-DTONEWOOD_ISA_NAME=\"$2\"" "-DTONEWOOD_ISA_TABLE=table_$2" "${@:3}"; }
for target in "${targets[@]}"; do
    unit "$target" baseline
    have=()
    if [[ $target == x86_64-* ]]; then
        unit "$target" avx2 -mavx2 -mfma
        unit "$target" avx512 -mavx512f -mavx512dq -mavx512vl -mfma -mprefer-vector-width=512
        have=(-DTONEWOOD_HAVE_X86)
    fi
    compile "$target" src/kernel/kernel.cpp "${have[@]}"
    compile "$target" examples/embedding/pluck.cpp
done
