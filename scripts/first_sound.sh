#!/usr/bin/env bash
# Seconds of the processor from a wheel to the first sound in a fresh environment, with each installer: making the
# environment, installing, and rendering a scale. Packages are downloaded again each time.
#     scripts/first_sound.sh dist/tonewood-*.whl [INTERPRETER]
set -euo pipefail
wheel=$(realpath "$1") python=${2:-python3} score=$(realpath "$(dirname "$0")/../examples/scores/scale.mid")
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
export PIP_DISABLE_PIP_VERSION_CHECK=1 TIMEFORMAT="%U %S"
cd "$work"

spent() { { time "$@" >log 2>&1 || { tail -50 log >&3; exit 1; }; } 2>&1; } 3>&2
show() { printf '%s\n' "$@" | awk '{ each[NR] = $1 + $2; all += each[NR] } END { printf "%.1f = %.1f environment + %.1f install + %.1f render\n", all, each[1], each[2], each[3] }'; }

"$python" -m venv tools
tools/bin/pip install -q uv
for way in "pip" "pip --no-compile" "uv"; do
    rm -rf fresh
    case $way in
        uv) made=$(spent tools/bin/uv venv -p "$python" fresh) installed=$(spent tools/bin/uv pip install --no-cache -p fresh "$wheel") ;;
        *) made=$(spent "$python" -m venv fresh) installed=$(spent fresh/bin/pip install --no-cache-dir ${way#pip} "$wheel") ;;
    esac
    printf '%-18s' "$way"
    show "$made" "$installed" "$(spent fresh/bin/tonewood render "$score" -i monochord -o scale.wav)"
done
