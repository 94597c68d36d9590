"""Small wrong edits, and whether a test notices each: ``python scripts/mutants.py PACKAGE... [--edits 15] [--seed 1]``.

Edits are drawn from the syntax of a package's sources: a sign, a factor of 2, a term or a condition dropped, < for <=,
off by one, min for max, `not`, a conjugate dropped, arguments swapped, a constant returned. Texts, types, messages and
limits of keys are left alone. Each edit is made in a copy of the tree, in which those test files of the package that
call the edited function run until a test fails. Tests beyond the time limit decide nothing; tests that fail without any
edit do not run; a package whose tests do not end without any edit is left out. `kernel` is the C++ kernel,
built again for each edit, without optimisation and for one instruction set. Edits that no test noticed are for a person
to read: one that changes nothing is no gap. ``--where FILE`` or ``FILE:LINE`` draws edits there alone; ``--tests
PATH...`` replaces the tests.
"""

from __future__ import annotations

import argparse
import importlib
import importlib.util
import json
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from types import FrameType

import pytest
from small_edits import ROOT, Edit, candidates, draw

#: package, a folder of the sources -> its tests; `near` keeps those that call what is edited
LAWS, PHYSICS = "tests/analytic/test_laws_against_ode.py", "tests/unit/physics"
TESTS = {name: [f"{PHYSICS}/{name}"] for name in ("modal", "passivity", "energy", "plate")} | {
    "coupling": [LAWS, f"{PHYSICS}/coupling", f"{PHYSICS}/stepping"],
    "stepping": [LAWS, f"{PHYSICS}/stepping"],
    "instrument": ["tests/unit/instrument"],
    "score": ["tests/unit/performance/score"],
    "player": ["tests/unit/performance/player", "tests/unit/performance/engine", "tests/plugins/test_hand_noises.py"],
    "engine": [
        "tests/plugins/test_broken_plugins.py",
        "tests/unit/performance/engine",
        "tests/unit/performance/player",
        "tests/effects/test_switching.py",
    ],
    "effects": ["tests/effects", "tests/unit/performance/engine"],
    "sound": ["tests/unit/sound", "tests/unit/test_notebook.py"],
    "fit": ["tests/unit/workshop/fit"],
    "listening": ["tests/unit/workshop/listening"],
    "batch": ["tests/unit/workshop/batch"],
    "dataset": ["tests/unit/workshop/dataset"],
    "sampling": ["tests/unit/workshop/sampling"],
    "report": ["tests/unit/workshop/report", "tests/unit/test_notebook.py"],
    "lab": ["tests/unit/lab", "tests/analytic/test_chinnakonda.py"],
    "cli": ["tests/cli"],
    "support": [*sorted(str(f.relative_to(ROOT)) for f in (ROOT / "tests/unit").glob("test_*.py")), "tests/cli"],
    "plugins": ["tests/plugins"],
    "kernel": [LAWS, f"{PHYSICS}/stepping", f"{PHYSICS}/coupling", "tests/effects"],
}
#: imported once, before the package and its tests are
LIBRARIES = """numpy scipy.linalg scipy.signal scipy.optimize scipy.integrate scipy.interpolate scipy.sparse.linalg
scipy.special scipy.spatial scipy.stats scipy.ndimage hypothesis pydantic yaml mido matplotlib.pyplot"""
#: what decides nothing begins so
_LONGER, _NO_BUILD = "longer than", "does not compile"


class Called:
    """A plugin of pytest: functions of the package that the tests of each file call, and how long these take, s."""

    def __init__(self, out: Path):
        self.out, self.calls, self.now = out, dict[str, set[tuple[str, int]]](), set[tuple[str, int]]()
        self.seconds: dict[str, float] = {}

    def trace(self, frame: FrameType, *_: object) -> None:
        """Note a call."""
        if "/tonewood/" in (name := frame.f_code.co_filename):
            self.now.add((name, frame.f_code.co_firstlineno))

    def pytest_runtest_protocol(self, item: pytest.Item) -> None:
        """Turn to the file of a test."""
        self.now = self.calls.setdefault(item.location[0], set())
        sys.settrace(self.trace)
        threading.settrace(self.trace)

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Add the time of a test."""
        file = report.location[0]
        self.seconds[file] = self.seconds.get(file, 0.0) + report.duration

    def pytest_sessionfinish(self) -> None:
        """Write both."""
        sys.settrace(None)
        calls = {file: sorted({(os.path.realpath(n), at) for n, at in seen}) for file, seen in self.calls.items()}
        self.out.write_text(json.dumps([calls, self.seconds]))


class Copy:
    """A copy of the tree, imported in place of the installed package."""

    def __init__(self, folder: Path):
        self.folder, self.package, self.left_out = folder, folder / "lib" / "tonewood", list[str]()
        self.runs = True  # whether the last tests came to an end, with faults or without
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
        options = ["-G", "Ninja", f"-DPython_EXECUTABLE={sys.executable}", "-DTONEWOOD_QUICK_BUILD=ON"]
        subprocess.run(["cmake", "-S", self.folder, "-B", out, *options], check=True, stdout=subprocess.DEVNULL)
        done = subprocess.run(["cmake", "--build", out, "--target", "_kernel"], capture_output=True, check=False)
        if done.returncode == 0:
            shutil.copy2(next(out.glob("_kernel.*")), self.package)
        return done.returncode == 0

    def near(self, edit: Edit, tests: list[str]) -> list[str]:
        """Test files that call the edited function, or start processes; all, of an edit outside functions."""
        if not (self.folder / "called").exists():
            return tests
        calls, seconds = json.loads((self.folder / "called").read_text())
        known = [str((self.folder / edit.file).resolve()), edit.function]
        files = [f for f, seen in calls.items() if not edit.function or known in seen]
        texts = {f: (self.folder / f).read_text(encoding="utf-8") for f in calls}
        files = files or list(calls)
        files += [f for f, text in texts.items() if f not in files and re.search("subprocess|Popen|_in_process", text)]
        pattern = re.compile(rf"\b(?:from|import) [\w.]*\b{edit.file.stem}\b")
        return sorted(files, key=lambda f: (f not in calls, not pattern.search(texts[f]), seconds[f]))

    def fault(self, tests: list[str], limit: float, plugins: Sequence[object] = ()) -> str:
        """Run tests until one fails, in a fork that has the libraries already; return its name, or an empty text.

        With plugins all tests run, and what fails is left out from then on.
        """
        said, library = self.folder / "said", str(self.package.parent)
        if (child := os.fork()) == 0:
            os.setsid()
            os.chdir(self.folder)
            sys.pycache_prefix = str(self.folder / "pyc")
            os.environ.update(PYTHONPATH=library, PYTHONPYCACHEPREFIX=sys.pycache_prefix)
            sys.meta_path[:] = [f for f in sys.meta_path if "editable" not in type(f).__module__]
            sys.path[:] = [library, str(self.folder), *(p for p in sys.path if not p.startswith(str(ROOT / "s")))]
            out = os.open(said, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
            os.dup2(out, 1)
            os.dup2(out, 2)
            how = ["--tb=no"] if plugins else ["-x", "--tb=no", *(f"--deselect={name}" for name in self.left_out)]
            code = pytest.main(["-q", *how, "-p", "no:cacheprovider", *tests], plugins=plugins)
            sys.stdout.flush()
            os._exit(int(code))
        end = time.monotonic() + limit
        while (ended := os.waitpid(child, os.WNOHANG))[0] == 0:
            time.sleep(0.1)
            if time.monotonic() > end:
                os.killpg(child, signal.SIGKILL)
                os.waitpid(child, 0)
                self.runs = False
                return f"{_LONGER} {limit:.0f} s"
        self.runs = os.waitstatus_to_exitcode(ended[1]) in (pytest.ExitCode.OK, pytest.ExitCode.TESTS_FAILED)
        text = said.read_text(errors="replace")
        lines = re.findall(r"^(?:FAILED|ERROR) (.*)", text, re.M)
        if plugins:
            self.left_out = [line.split(" - ")[0] for line in lines]
        return "" if ended[1] == 0 else lines[0] if lines else " ".join(text.split()[-12:])

    def judged(self, package: str, edits: list[Edit], tests: list[str], limit: float) -> int:
        """Make edits one by one, print the verdict on each, return how many no test noticed; 1 if tests do not run."""
        if package == "kernel" and not self.build():
            sys.exit("kernel: it does not compile without any edit")
        (self.folder / "called").unlink(missing_ok=True)
        if fault := self.fault(tests, 10 * limit, [Called(self.folder / "called")]):
            print(f"{package}: fail without any edit: {self.left_out or fault}", flush=True)
            if not self.runs:
                print(f"{package}: left out, its tests do not run to their end", flush=True)
                return 1
        survivors = undecided = 0
        for edit in edits:
            start = time.monotonic()
            self.put(edit.file, edit.made)
            compiles = package != "kernel" or self.build()
            fault = self.fault(self.near(edit, tests), limit) if compiles else _NO_BUILD
            self.put(edit.file, edit.source)
            survivors += not fault
            undecided += (open_ := fault.startswith((_LONGER, _NO_BUILD)))
            print("undecided" if open_ else "noticed" if fault else "UNNOTICED", edit, flush=True)
            print(f"    {time.monotonic() - start:.0f} s {fault}", flush=True)
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
    parser.add_argument("--where", default="", help="FILE or FILE:LINE")
    parser.add_argument("--tests", nargs="+", help="in place of the package's own")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        copy, survivors = Copy(Path(folder)), 0
        for package in given.packages:
            edits = [e for e in candidates(package) if f"{e.place}:".startswith(given.where)]
            drawn = list(draw(edits, given.edits, random.Random(f"{package} {given.seed}")))
            survivors += copy.judged(package, drawn, given.tests or TESTS[package], given.limit)
    return min(survivors, 1)


if __name__ == "__main__":
    sys.exit(main())
