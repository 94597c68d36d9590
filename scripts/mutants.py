"""Small wrong edits, and whether a test notices each: ``python scripts/mutants.py PACKAGE... [--edits 15] [--seed 1]``.

Edits are drawn from the syntax of a package's sources: a sign, a factor of 2, a term or a condition dropped, < for <=,
off by one, min for max, `not`, a conjugate dropped, arguments swapped, a constant returned. Texts, types, messages and
limits of keys are left alone. Each edit is made in a copy of the tree, in which those tests of the package, or else
of files that import the module, run until one fails that reach the edited line (coverage.py has seen them once). Tests
beyond the time limit decide nothing; tests that fail without any edit do not run; a package whose tests do not end is
left out. `kernel` is the C++ kernel, built again for each edit, with -O1 and for one instruction set.
Edits that no test noticed are for a person to read: one that changes nothing is no gap. ``--where FILE`` or
``FILE:LINE`` draws edits there alone; ``--tests PATH...`` replaces the tests.
"""

from __future__ import annotations

import argparse
import functools
import gc
import hashlib
import importlib
import importlib.util
import itertools
import json
import math
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import coverage
import pytest
from small_edits import ROOT, Edit, candidates, draw

#: package, a folder of the sources -> its tests; `near` keeps those that reach what is edited
LAWS, PHYSICS = "tests/analytic/test_laws_against_ode.py", "tests/unit/physics"
TESTS = {name: [f"{PHYSICS}/{name}"] for name in ("modal", "passivity", "energy", "plate")} | {
    "coupling": [LAWS, f"{PHYSICS}/coupling", f"{PHYSICS}/stepping"],
    "stepping": [LAWS, f"{PHYSICS}/stepping"],
    "instrument": [
        "tests/unit/instrument",
        *(f"tests/plugins/test_{name}.py" for name in ("contract", "bundle_code", "loss_laws")),
        "tests/unit/performance/score/test_scales.py",
    ],
    "score": ["tests/unit/performance/score"],
    "player": ["tests/unit/performance/player", "tests/unit/performance/engine", "tests/plugins/test_hand_noises.py"],
    "engine": [
        "tests/plugins/test_broken_plugins.py",
        "tests/unit/performance/engine",
        "tests/unit/performance/player",
        "tests/effects/test_switching.py",
    ],
    "effects": ["tests/effects", "tests/unit/performance/engine", "tests/plugins/test_third_party_effect.py"],
    "sound": ["tests/unit/sound", "tests/unit/test_notebook.py"],
    "fit": ["tests/unit/workshop/fit"],
    "listening": ["tests/unit/workshop/listening"],
    "batch": ["tests/unit/workshop/batch", "tests/cli/test_migrate.py"],
    "dataset": ["tests/unit/workshop/dataset"],
    "sampling": ["tests/unit/workshop/sampling"],
    "report": [
        "tests/unit/workshop/report",
        "tests/unit/test_notebook.py",
        "tests/cli/test_body_alone.py",
        "tests/cli/test_compare_command.py",
    ],
    "lab": ["tests/unit/lab", "tests/analytic/test_chinnakonda.py"],
    "cli": ["tests/cli"],
    "design": ["tests/unit/workshop/design"],
    "desk": ["tests/unit/workshop/desk"],
    "estimate": ["tests/unit/workshop/estimate"],
    "exchange": ["tests/unit/workshop/exchange"],
    "taps": ["tests/unit/workshop/taps", "tests/cli/test_wood_command.py"],
    "web": ["tests/unit/workshop/desk", "tests/unit/workshop/exchange", "tests/unit/workshop/listening"],
    "wood": ["tests/unit/workshop/wood", "tests/cli/test_wood_command.py"],
    "support": [
        *sorted(str(f.relative_to(ROOT)) for f in (ROOT / "tests/unit").glob("test_*.py")),
        "tests/test_layers.py",
        "tests/cli",
    ],
    "plugins": ["tests/plugins"],
    "kernel": [LAWS, f"{PHYSICS}/stepping", f"{PHYSICS}/coupling", "tests/stability/test_kernel_door.py"],
}
#: module that steps the kernel
STEPS = "src/tonewood/physics/stepping/kernel.py"
#: imported once, before the package and its tests are
LIBRARIES = """numpy scipy.linalg scipy.signal scipy.optimize scipy.integrate scipy.interpolate scipy.sparse.linalg
scipy.special scipy.spatial scipy.stats scipy.ndimage hypothesis pydantic yaml mido matplotlib.pyplot"""
#: what the tests of a file reach is kept here, until that file or a source that they reach changes
REACHED = ROOT / "build" / "reached"
ELSEWHERE = "unit effects plugins analytic"
#: options of pytest, for tests of other tiers than the default one
TIERS: list[str] = []
CACHED = type(functools.cache(len))
#: what decides nothing begins so
_LONGER, _NO_BUILD = "longer than", "does not compile"


class Reached:
    """A plugin of pytest: lines of the package that each test reaches, and the processor time that it takes, s.

    What a fixture or a cached function of the package does counts for all tests of a file that use it.
    """

    def __init__(self, folder: Path):
        self.folder, self.test = folder, ""
        sources = [str((folder / part).resolve() / "*") for part in ("src", "plugins")]
        self.cover = coverage.Coverage(data_file=None, include=sources, config_file=False)
        self.seconds, self.shared, self.failed = dict[str, float](), dict[str, list[str]](), set[str]()

    def pytest_sessionstart(self) -> None:
        """Begin, before the package is imported."""
        self.cover.start()

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Iterator[None]:
        """Turn to a test and time it; empty the package's caches at the first of a file."""
        if item.nodeid.partition("::")[0] != self.test.partition("::")[0]:
            for kept in gc.get_objects():
                if type(kept) is CACHED and str(kept.__module__).startswith("tonewood"):
                    kept.cache_clear()
        self.test = item.nodeid
        self.cover.switch_context(self.test)
        for made in item._fixtureinfo.name2fixturedefs.values():  # type: ignore[attr-defined]  # private in pytest
            self.shared.setdefault(f"{made[-1].baseid} {made[-1].argname}", []).append(self.test)
        began = sum(os.times()[:4])  # of this process and those that it has waited for
        ran = yield
        self.seconds[self.test] = sum(os.times()[:4]) - began
        return ran  # type: ignore[return-value]  # passed on

    @pytest.hookimpl(wrapper=True)
    def pytest_fixture_setup(self, fixturedef: pytest.FixtureDef[object]) -> Iterator[None]:
        """Turn to a fixture."""
        self.cover.switch_context(f"{fixturedef.baseid} {fixturedef.argname}")
        made = yield
        self.cover.switch_context(self.test)
        return made  # type: ignore[return-value]  # passed on

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Note that a test failed."""
        self.failed |= {report.nodeid} if report.failed else set()

    def pytest_sessionfinish(self) -> None:
        """Write all that for each file of tests."""
        self.cover.stop()
        data, lines = self.cover.get_data(), dict[str, dict[str, set[int]]]()
        for file in data.measured_files():
            name = str(Path(file).relative_to(self.folder.resolve()))
            for line, contexts in data.contexts_by_lineno(file).items():
                for context in contexts:
                    for test in self.shared.get(context, [context]):
                        lines.setdefault(test, {}).setdefault(name, set()).add(line)
        files = dict[str, dict[str, Any]]()
        for test, seconds in self.seconds.items():
            reached = {name: sorted(at) for name, at in lines.get(test, {}).items()}
            files.setdefault(test.partition("::")[0], {})[test] = [seconds, reached, test in self.failed]
        REACHED.mkdir(parents=True, exist_ok=True)
        for file, tests in files.items():
            sources = {name for _, reached, _ in tests.values() for name in reached}
            digests = {name: digest(self.folder / name) for name in sorted(sources)}
            record(self.folder, file).write_text(json.dumps([digests, tests]))


def digest(file: Path) -> str:
    """Hash of a file."""
    return hashlib.sha256(file.read_bytes()).hexdigest()[:16] if file.exists() else ""


def record(folder: Path, test: str) -> Path:
    """File of what the tests of a file reach."""
    return REACHED / f"{Path(test).stem}-{digest(folder / test)}{''.join(TIERS)}.json"


def recorded(folder: Path, test: str) -> dict[str, list[Any]] | None:
    """What the tests of a file reach; None where it is not known or a source that they reach has changed."""
    if not (file := record(folder, test)).exists():
        return None
    digests, tests = json.loads(file.read_text())
    return tests if all(digest(folder / name) == known for name, known in digests.items()) else None


class Copy:
    """A copy of the tree, imported in place of the installed package."""

    def __init__(self, folder: Path):
        self.folder, self.package = folder, folder / "lib" / "tonewood"
        listed = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
        files = subprocess.run(listed, cwd=ROOT, capture_output=True, text=True, check=True).stdout
        for name in filter(None, files.split("\0")):
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, folder / name)
        self.package.mkdir(parents=True)
        for part in [*(folder / "src/tonewood").iterdir(), folder / "plugins", folder / "instruments"]:
            (self.package / part.name).symlink_to(part)
        for name in ("_kernel", "_methods"):
            shutil.copy2(str(getattr(importlib.util.find_spec(f"tonewood.{name}"), "origin", "")), self.package)
        for name in [name for name in sys.modules if name.partition(".")[0] == "tonewood"]:
            del sys.modules[name]  # imported to find the kernel
        for name in LIBRARIES.split():
            importlib.import_module(name)
        # the finder of an editable install would come before the path
        hook = "import sys\nsys.meta_path[:] = [f for f in sys.meta_path if 'editable' not in type(f).__module__]\n"
        (folder / "lib" / "sitecustomize.py").write_text(hook)

    def put(self, file: Path, text: str) -> None:
        """Write a file, and remove its compiled form."""
        (self.folder / file).write_text(text, encoding="utf-8")
        for compiled in (self.folder / "pyc").rglob(f"{file.stem}.*.pyc"):
            compiled.unlink()

    def build(self) -> bool:
        """Build the kernel; return whether it compiles."""
        out = self.folder / "out"
        if not out.exists():
            options = ["-G", "Ninja", f"-DPython_EXECUTABLE={sys.executable}", "-DTONEWOOD_QUICK_BUILD=ON"]
            subprocess.run(["cmake", "-S", self.folder, "-B", out, *options], check=True, stdout=subprocess.DEVNULL)
        done = subprocess.run(["cmake", "--build", out, "--target", "_kernel"], capture_output=True, check=False)
        if done.returncode == 0:
            shutil.copy2(next(out.glob("_kernel.*")), self.package)
        return done.returncode == 0

    def known(self, tests: list[str]) -> dict[str, list[Any]]:
        """Of each test: its time, the lines that it reaches, whether it fails without any edit; run where not kept."""
        files = sorted({str(f.relative_to(self.folder)) for t in tests for f in self.files(self.folder / t)})
        if fresh := [f for f in files if recorded(self.folder, f) is None]:
            self.fault(fresh, 3600.0, [Reached(self.folder)])
        return {test: row for f in files for test, row in (recorded(self.folder, f) or {}).items()}

    def files(self, path: Path) -> list[Path]:
        """Files of tests at a path."""
        return [path] if path.is_file() else sorted(path.rglob("test_*.py"))

    def elsewhere(self, edit: Edit) -> list[str]:
        """Files of tests, of other packages too, that import the edited module."""
        module = edit.file.parent.name if edit.file.stem == "__init__" else edit.file.stem
        pattern = re.compile(rf"from tonewood[\w.]*\.{module} import")
        files = (f for part in ELSEWHERE.split() for f in self.files(self.folder / "tests" / part))
        return [str(f.relative_to(self.folder)) for f in files if pattern.search(f.read_text(encoding="utf-8"))]

    def near(self, edit: Edit, known: dict[str, list[Any]]) -> tuple[list[str], list[str]]:
        """Tests that reach the edited lines, and other tests of their files, or of those that start processes."""
        source, lines = str(edit.file), set(edit.lines)
        name = rf"\b{edit.file.stem}\b"
        forms = rf"from [\w.]*{name} import|import [\w.]*{name}|from [\w.]+ import (?:\([^)]*|[^\n(]*){name}"
        pattern = re.compile(rf"^ *(?:{forms})", re.M)
        texts = {f: (self.folder / f).read_text(encoding="utf-8") for f in {t.partition("::")[0] for t in known}}
        first = [t for t, row in known.items() if (at := row[1].get(source)) and (not lines or lines & set(at))]
        if not lines or edit.in_signature:  # whoever imports it may read it without running a line of its module
            first += [t for t in known if t not in first and pattern.search(texts[t.partition("::")[0]])]
        files = {t.partition("::")[0] for t in first}
        files |= set() if first else {f for f, text in texts.items() if re.search("subprocess|Popen|_in_process", text)}
        second = [t for t in known if t not in first and t.partition("::")[0] in files]

        def order(test: str) -> tuple[bool, float]:
            return not pattern.search(texts[test.partition("::")[0]]), known[test][0]

        return sorted(first, key=order), sorted(second, key=order)

    def stepped(self, known: dict[str, list[Any]]) -> list[str]:
        """Tests that load the kernel, the quickest first."""
        files = {t.partition("::")[0] for t in known}
        direct = {f for f in files if "import _kernel" in (self.folder / f).read_text(encoding="utf-8")}
        used = (t for t, row in known.items() if t.partition("::")[0] in direct or STEPS in row[1])
        return sorted(used, key=lambda t: known[t][0])

    def fault(self, tests: list[str], limit: float, plugins: Sequence[object] = ()) -> str:
        """Run tests until one fails, in a fork that has the libraries already; return its name, or an empty text.

        With plugins all tests run.
        """
        said, library = self.folder / "said", str(self.package.parent)
        if (child := os.fork()) == 0:
            os.setsid()
            os.chdir(self.folder)
            sys.pycache_prefix = str(self.folder / "pyc")
            os.environ.update(PYTHONPATH=library, PYTHONPYCACHEPREFIX=sys.pycache_prefix)
            sys.meta_path[:] = [f for f in sys.meta_path if "editable" not in type(f).__module__]
            sys.path[:] = [library, str(self.folder), *(p for p in sys.path if not p.startswith(str(ROOT / "s")))]
            sys.modules["__main__"] = pytest  # what spawned processes import again
            out = os.open(said, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
            os.dup2(out, 1)
            os.dup2(out, 2)
            how = ["--continue-on-collection-errors"] if plugins else ["-x"]
            code = pytest.main(["-q", "--tb=no", *how, *TIERS, "-p", "no:cacheprovider", *tests], plugins=plugins)
            sys.stdout.flush()
            os._exit(int(code))
        end = time.monotonic() + limit
        while (ended := os.waitpid(child, os.WNOHANG))[0] == 0:
            time.sleep(0.1)
            if time.monotonic() > end:
                os.killpg(child, signal.SIGKILL)
                os.waitpid(child, 0)
                return f"{_LONGER} {limit:.0f} s"
        text = said.read_text(errors="replace")
        lines = re.findall(r"^(?:FAILED|ERROR) (.*)", text, re.M)
        return "" if ended[1] == 0 else lines[0] if lines else " ".join(text.split()[-12:])

    def judged(self, package: str, edits: list[Edit], tests: list[str], limit: float, seconds: float) -> int:
        """Make edits one by one, print the verdict on each, return how many no test noticed; 1 if tests do not run."""
        if package == "kernel" and not self.build():
            sys.exit("kernel: it does not compile without any edit")
        known = self.known(tests)
        if failed := [test for test, row in known.items() if row[2]]:
            print(f"{package}: fail without any edit: {failed}", flush=True)
        if not (known := {test: row for test, row in known.items() if not row[2]}):
            print(f"{package}: left out, its tests do not run to their end", flush=True)
            return 1
        survivors = undecided = 0
        for edit in edits:
            start = time.monotonic()
            first, second = (self.stepped(known), []) if package == "kernel" else self.near(edit, known)
            if not first and package == "kernel":
                sys.exit("kernel: no test that runs loads it")
            if not first:
                others = {test: row for test, row in self.known(self.elsewhere(edit)).items() if not row[2]}
                known |= others
                first = self.near(edit, others)[0]
            self.put(edit.file, edit.made)
            compiles = package != "kernel" or self.build()
            spent = itertools.accumulate(known[test][0] for test in first)
            ran = first[: max(1, sum(s <= seconds for s in spent))]
            fault = (self.fault(ran, limit) if ran else "") if compiles else _NO_BUILD
            if not fault and second and len(ran) == len(first):  # fixtures and caches may have hidden who reaches it
                late = self.fault(second, limit)
                fault = "" if late.startswith(_LONGER) else late
            self.put(edit.file, edit.source)
            survivors += not fault
            undecided += (open_ := fault.startswith((_LONGER, _NO_BUILD)))
            print("undecided" if open_ else "noticed" if fault else "UNNOTICED", edit, flush=True)
            took = f"{time.monotonic() - start:.0f} s, {len(ran)} of {len(first)} tests that reach it"
            print(f"    {took}. {fault}", flush=True)
        decided = len(edits) - undecided
        print(f"{package}: {decided - survivors} of {decided} edits noticed, {undecided} undecided", flush=True)
        return survivors


def main() -> int:
    """Draw, make and judge edits; return 1 where one was not noticed."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("packages", nargs="+", choices=TESTS, metavar="PACKAGE", help=", ".join(TESTS))
    parser.add_argument("--edits", type=int, default=15)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--limit", type=float, default=300.0, help="s, of the tests of one edit")
    parser.add_argument("--seconds", type=float, default=math.inf, help="s of a processor, of the tests of one edit")
    parser.add_argument("--where", default="", help="FILE or FILE:LINE")
    parser.add_argument("--tests", nargs="+", help="in place of the package's own")
    parser.add_argument("--slow", action="store_true", help="slow tests, too")
    parser.add_argument("--validate", action="store_true", help="the long tier, too")
    given = parser.parse_args()
    TIERS.extend(f"--{tier}" for tier in ("slow", "validate") if vars(given)[tier])
    with tempfile.TemporaryDirectory() as folder:
        copy, survivors = Copy(Path(folder)), 0
        for package in given.packages:
            edits = [e for e in candidates(package) if f"{e.place}:".startswith(given.where)]
            drawn = list(draw(edits, given.edits, random.Random(f"{package} {given.seed}")))
            survivors += copy.judged(package, drawn, given.tests or TESTS[package], given.limit, given.seconds)
    return min(survivors, 1)


if __name__ == "__main__":
    sys.exit(main())
