#!/usr/bin/env bash
# Builds tonewood into a throwaway environment with the oldest version of every dependency that pyproject.toml allows,
# and runs commands and tests of arrays, files and scores there. Takes two to four minutes, most of it downloads.
# Arguments go to pytest, in place of the default choice of tests.
set -euo pipefail
cd "$(dirname "$0")/.."

python=${PYTHON:-python3}
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
export OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 PIP_DISABLE_PIP_VERSION_CHECK=1 MPLBACKEND=Agg

tests=("$@")
if [ ${#tests[@]} -eq 0 ]; then
    tests=(tests/unit/physics/stepping/test_kernel.py tests/unit/physics/modal/test_synthesis.py tests/unit/test_blas.py
        tests/unit/test_yaml_io.py tests/unit/performance/score tests/unit/workshop/batch/test_batch_engine.py tests/cli)
fi
echo "== building"
"$python" -m venv "$work/venv"
# shellcheck disable=SC1091
. "$work/venv/bin/activate"
pip install -q uv
uv pip compile -q --resolution lowest-direct --extra test pyproject.toml -o "$work/oldest.txt"
uv pip install -q -r "$work/oldest.txt"
pip install -q --no-deps --config-settings=build-dir="$work/build" .
pip list --format=freeze | grep -i -E '^(numpy|scipy|soundfile|mido|ruamel.yaml|pydantic|rich|typer|click|threadpoolctl)='
echo "== commands and tests"
tonewood render examples/scores/scale.mid -i monochord -o "$work/scale.wav"
python -m pytest -q -n 2 -p no:cacheprovider "${tests[@]}"
