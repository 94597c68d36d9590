"""Small wrong edits, and whether a test notices each: ``python scripts/mutants.py PACKAGE... [--edits 15] [--seed 1]``.

Edits are drawn from the syntax of a package's sources: a sign, a factor of 2, a term dropped, < for <=, off by one, min
for max, `not`, `and` for `or`, a conjugate dropped, arguments swapped, a constant returned. Texts, types, messages and
loops that only bound an iteration are left alone. Each edit is made in a copy of the tree, in which the tests of the
package run until one fails; what outlasts the time limit counts as noticed. `kernel` is the C++ kernel, built again for
each edit, without optimisation and for one instruction set. Printed is a line for each edit; those that no test noticed
are to be read by a person: an edit that changes nothing is no gap.

Further options: ``--where FILE:LINE`` draws edits of these lines alone; ``--tests PATH...`` replaces the tests.
"""

from __future__ import annotations

import argparse
import ast
import importlib
import importlib.util
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
#: package -> its tests, those that fail soonest first
TESTS = {
    "modal": "tests/unit/modal",
    "coupling": "tests/analytic/test_laws_against_ode.py tests/unit/coupling tests/unit/stepping",
    "passivity": "tests/unit/passivity",
    "energy": "tests/unit/energy",
    "stepping": "tests/analytic/test_laws_against_ode.py tests/unit/stepping",
    "instrument": "tests/unit/instrument",
    "engine": "tests/unit/engine tests/effects",
    "output": "tests/unit/output",
    "score": "tests/unit/score",
    "plate": "tests/unit/plate",
    "fit": "tests/unit/fit",
    "listening": "tests/unit/listening",
    "batch": "tests/unit/batch",
    "plugins": "tests/plugins",
    "kernel": "tests/analytic/test_laws_against_ode.py tests/unit/stepping tests/unit/coupling tests/effects",
}
SWAPPED = {
    ast.Add: ("+", "-"), ast.Sub: ("-", "+"), ast.Mult: ("*", "/"), ast.Div: ("/", "*"), ast.Lt: ("<", "<="),
    ast.LtE: ("<=", "<"), ast.Gt: (">", ">="), ast.GtE: (">=", ">"), ast.Eq: ("==", "!="), ast.NotEq: ("!=", "=="),
    ast.And: ("and", "or"), ast.Or: ("or", "and"), ast.Is: ("is", "is not"), ast.IsNot: ("is not", "is"),
    ast.In: ("in", "not in"), ast.NotIn: ("not in", "in"), ast.FloorDiv: ("//", "/"), ast.Mod: ("%", "*"),
}  # fmt: skip
OTHERS = {"min": "max", "max": "min", "minimum": "maximum", "maximum": "minimum", "floor": "ceil", "ceil": "floor"}
#: imported once, before the package's tests are
LIBRARIES = ["numpy", "scipy.linalg", "scipy.signal", "scipy.optimize", "scipy.integrate", "scipy.interpolate", "scipy.sparse.linalg", "scipy.special", "scipy.spatial", "scipy.stats", "scipy.ndimage", "hypothesis", "pydantic", "yaml", "mido", "matplotlib.pyplot"]
#: operators of C++ as the formatted sources have them: pattern, what stands in its place
TOKENS = [
    (r" \+ ", " - "), (r" - ", " + "), (r" \* ", " / "), (r" / ", " * "), (r" < ", " <= "), (r" <= ", " < "),
    (r" > ", " >= "), (r" >= ", " > "), (r" == ", " != "), (r" != ", " == "), (r" && ", " || "), (r" \|\| ", " && "),
    (r" \+= ", " -= "), (r" -= ", " += "), (r"std::min\b", "std::max"), (r"std::max\b", "std::min"),
    (r"(?<=[=(,] )-(?=\w)", ""), (r"(?<=[( ])!(?=\w)", ""), (r"\b0\.5\b", "1.0"), (r"\b1(?=[;)\]])", "2"),
    (r"(?<=return )-", ""), (r"\b2(?= \*)", "1"), (r"\b2\.0\b", "1.0"),
]  # fmt: skip


@dataclass(frozen=True)
class Edit:
    """One edit: characters `start` to `stop` of a file become `text`."""

    file: Path
    start: int
    stop: int
    text: str
    kind: str

    def made(self, source: str) -> str:
        """Return the text of the file with the edit."""
        return source[: self.start] + self.text + source[self.stop :]

    @property
    def line(self) -> int:
        """Number of its line."""
        return (ROOT / self.file).read_text(encoding="utf-8").count("\n", 0, self.start) + 1

    def __str__(self) -> str:
        source = (ROOT / self.file).read_text(encoding="utf-8")
        first, last = source.rfind("\n", 0, self.start) + 1, source.find("\n", self.stop)
        before, old, after = source[first : self.start], source[self.start : self.stop], source[self.stop : last]
        return f"{self.file}:{self.line}: {before.lstrip()}[{' '.join(old.split())} -> {self.text}]{after}"


class PythonEdits(ast.NodeVisitor):
    """Edits of one Python file."""

    def __init__(self, file: Path):
        self.file, self.source = file, (ROOT / file).read_text(encoding="utf-8")
        self.lines = [0]
        for line in self.source.splitlines(keepends=True):
            self.lines.append(self.lines[-1] + len(line.encode()))
        self.bytes = self.source.encode()
        self.out: list[Edit] = []
        self.visit(ast.parse(self.source))

    def _span(self, node: ast.AST) -> tuple[int, int]:
        """Characters of a node."""
        ends = (
            self.lines[node.lineno - 1] + node.col_offset,  # type: ignore[attr-defined]
            self.lines[node.end_lineno - 1] + node.end_col_offset,  # type: ignore[attr-defined]
        )
        return len(self.bytes[: ends[0]].decode()), len(self.bytes[: ends[1]].decode())

    def _text(self, node: ast.AST) -> str:
        return self.source[slice(*self._span(node))]

    def _add(self, node: ast.AST, text: str, kind: str) -> None:
        self.out.append(Edit(self.file, *self._span(node), text, kind))

    def _between(self, left: ast.AST, right: ast.AST, op: ast.AST) -> None:
        """Another operator between two operands."""
        old, new = SWAPPED.get(type(op), ("", ""))
        start, stop = self._span(left)[1], self._span(right)[0]
        gap = self.source[start:stop]
        if old and gap.count(old) == 1 and "#" not in gap:
            at = start + gap.index(old)
            self.out.append(Edit(self.file, at, at + len(old), new, "operator"))

    def visit(self, node: ast.AST) -> None:
        """Leave texts, types and messages alone."""
        if isinstance(node, ast.Raise | ast.JoinedStr | ast.Import | ast.ImportFrom | ast.Assert):
            return
        if isinstance(node, ast.FunctionDef) and node.name in ("__repr__", "__str__"):
            return
        if isinstance(node, ast.Call) and getattr(node.func, "id", "") in ("quantity", "Field"):  # limits of keys
            return
        if isinstance(node, ast.ClassDef):
            for child in node.body:
                self.visit(child)
            return
        if isinstance(node, ast.AnnAssign):
            if node.value:
                self.visit(node.value)
            return
        if isinstance(node, ast.FunctionDef):
            for child in (*node.args.defaults, *filter(None, node.args.kw_defaults), *node.body):
                self.visit(child)
            return
        super().visit(node)

    def visit_BinOp(self, node: ast.BinOp) -> None:
        """A sign, a factor inverted, a term dropped."""
        numbers = not any(isinstance(n, ast.Constant) and isinstance(n.value, str) for n in ast.walk(node))
        if numbers and not isinstance(node.op, ast.BitOr):
            self._between(node.left, node.right, node.op)
            if isinstance(node.op, ast.Add | ast.Sub | ast.Mult | ast.Div):
                self._add(node, self._text(node.left), "term dropped")
        self.generic_visit(node)

    def visit_Compare(self, node: ast.Compare) -> None:
        """< for <= and the like."""
        for left, op, right in zip([node.left, *node.comparators], node.ops, node.comparators, strict=False):
            self._between(left, right, op)
        self.generic_visit(node)

    def visit_BoolOp(self, node: ast.BoolOp) -> None:
        """`and` for `or`; a condition dropped."""
        for left, right in zip(node.values, node.values[1:], strict=False):
            self._between(left, right, node.op)
        self._add(node, f"({self._text(node.values[0])})", "condition dropped")
        self.generic_visit(node)

    def visit_UnaryOp(self, node: ast.UnaryOp) -> None:
        """A sign or a `not` dropped."""
        self._add(node, f"({self._text(node.operand)})", "sign or not dropped")
        self.generic_visit(node)

    def visit_If(self, node: ast.If) -> None:
        """A condition turned round."""
        if self._text(node.test) != "TYPE_CHECKING":
            self._add(node.test, f"not ({self._text(node.test)})", "not")
        self.generic_visit(node)

    def visit_Constant(self, node: ast.Constant) -> None:
        """Twice a number, or the next integer, or the other truth."""
        if isinstance(node.value, bool):
            self._add(node, str(not node.value), "truth")
        elif isinstance(node.value, float):
            self._add(node, repr(2 * node.value or 1.0), "factor 2")
        elif isinstance(node.value, int):
            self._add(node, str(node.value + 1), "off by one")

    def visit_Return(self, node: ast.Return) -> None:
        """A constant returned."""
        if node.value is not None and not isinstance(node.value, ast.Constant):
            self._add(node.value, "0.0" if isinstance(node.value, ast.BinOp | ast.Call) else "None", "constant")
        self.generic_visit(node)

    def visit_Call(self, node: ast.Call) -> None:
        """Min for max, a conjugate dropped, arguments swapped."""
        name = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
        if name == "conj" and isinstance(node.func, ast.Attribute) and not node.args:
            self._add(node, self._text(node.func.value), "conj dropped")
        if name in OTHERS:
            stop = self._span(node.func)[1]
            self.out.append(Edit(self.file, stop - len(name), stop, OTHERS[name], "min and max"))
        elif len(node.args) > 1 and not any(isinstance(a, ast.Starred | ast.GeneratorExp) for a in node.args[:2]):
            (start, _), (_, stop) = self._span(node.args[0]), self._span(node.args[1])
            text = f"{self._text(node.args[1])}, {self._text(node.args[0])}"
            self.out.append(Edit(self.file, start, stop, text, "arguments swapped"))
        self.generic_visit(node)


def kernel_edits(file: Path) -> Iterator[Edit]:
    """Edits of one C++ file; comments, strings, templates and preprocessor lines are left alone."""
    source = (ROOT / file).read_text(encoding="utf-8")
    blank = re.compile(
        r'//[^\n]*|/\*.*?\*/|"(?:\\.|[^"\\\n])*"|^[ \t]*(?:#|template|static_assert|using)[^\n]*', re.S | re.M
    )
    code = blank.sub(lambda m: re.sub(r"[^\n]", "\0", m.group()), source)
    for pattern, text in TOKENS:
        yield from (Edit(file, m.start(), m.end(), text, "operator") for m in re.finditer(pattern, code))


def candidates(package: str) -> list[Edit]:
    """All edits of a package."""
    if package == "kernel":
        files = [f for f in (ROOT / "src/kernel").rglob("*.hpp") if f.parent.name not in ("lab", "bind")]
        return [e for f in sorted(files) for e in kernel_edits(f.relative_to(ROOT))]
    folder = ROOT / ("plugins" if package == "plugins" else f"src/tonewood/{package}")
    return [e for f in sorted(folder.rglob("*.py")) for e in PythonEdits(f.relative_to(ROOT)).out]


def draw(edits: list[Edit], n: int, rng: random.Random) -> list[Edit]:
    """Draw n edits: a kind first, then one of that kind."""
    kinds: dict[str, list[Edit]] = {}
    for edit in edits:
        kinds.setdefault(edit.kind, []).append(edit)
    for group in kinds.values():
        rng.shuffle(group)
    out: list[Edit] = []
    while len(out) < n and any(kinds.values()):
        group = kinds[rng.choice(sorted(k for k, g in kinds.items() if g))]
        out.append(group.pop())
    return out


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
            spec = importlib.util.find_spec(f"tonewood.{name}")
            assert spec is not None
            assert spec.origin is not None
            shutil.copy2(spec.origin, self.package)
        for name in [name for name in sys.modules if name.partition(".")[0] == "tonewood"]:
            del sys.modules[name]  # imported to find the kernel
        for name in LIBRARIES:
            importlib.import_module(name)
        # the finder of an editable install would come before the path
        hook = "import sys\nsys.meta_path[:] = [f for f in sys.meta_path if 'editable' not in type(f).__module__]\n"
        (folder / "lib" / "sitecustomize.py").write_text(hook)
        self.environment = os.environ | {"PYTHONPATH": str(folder / "lib"), "PYTHONPYCACHEPREFIX": str(folder / "pyc")}

    def put(self, file: Path, text: str) -> None:
        """Write a file; what was compiled of it goes."""
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

    def near(self, file: Path, tests: list[str]) -> list[str]:
        """Test files, those first that import the module of a file."""
        places = [self.folder / t for t in tests]
        files = [f for place in places for f in ([place] if place.suffix else sorted(place.glob("test_*.py")))]
        pattern = re.compile(rf"\b(?:from|import) [\w.]*\b{file.stem}\b")
        first = {f: bool(pattern.search(f.read_text(encoding="utf-8"))) for f in files}
        return [str(f.relative_to(self.folder)) for f in sorted(first, key=lambda f: not first[f])]

    def fault(self, tests: list[str], limit: float) -> str:
        """Run tests until one fails, in a fork that has the libraries already; return its name, or an empty text."""
        said = self.folder / "said"
        if (child := os.fork()) == 0:
            os.setsid()
            os.chdir(self.folder)
            os.environ.update(self.environment)
            sys.pycache_prefix = self.environment["PYTHONPYCACHEPREFIX"]
            sys.meta_path[:] = [f for f in sys.meta_path if "editable" not in type(f).__module__]
            sys.path[:] = [str(self.package.parent), str(self.folder), *(p for p in sys.path if not p.startswith(str(ROOT / "s")))]
            out = os.open(said, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
            os.dup2(out, 1)
            os.dup2(out, 2)
            code = pytest.main(["-q", "-x", "--tb=no", "-p", "no:cacheprovider", *tests])
            sys.stdout.flush()
            os._exit(int(code))
        end = time.monotonic() + limit
        while (ended := os.waitpid(child, os.WNOHANG))[0] == 0:
            time.sleep(0.1)
            if time.monotonic() > end:
                os.killpg(child, signal.SIGKILL)
                os.waitpid(child, 0)
                return f"longer than {limit:.0f} s"
        text = said.read_text(errors="replace")
        lines = re.findall(r"^(?:FAILED|ERROR) (.*)", text, re.M)
        return "" if ended[1] == 0 else lines[0] if lines else " ".join(text.split()[-12:])


def main() -> int:
    """Draw, make and judge edits; return 1 where one was not noticed."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("packages", nargs="+", choices=TESTS, metavar="PACKAGE", help=", ".join(TESTS))
    parser.add_argument("--edits", type=int, default=15)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--limit", type=float, default=300.0, help="s, of the tests of one edit")
    parser.add_argument("--where", default="", help="FILE, FILE:LINE: draw edits there only")
    parser.add_argument("--tests", nargs="+", help="in place of the package's own")
    given = parser.parse_args()
    unnoticed = 0
    with tempfile.TemporaryDirectory() as folder:
        copy = Copy(Path(folder))
        for package in given.packages:
            tests = given.tests or TESTS[package].split()
            built = package != "kernel" or copy.build()
            if not built or (fault := copy.fault(tests, 10 * given.limit)):
                print(f"{package}: its tests fail without any edit: {fault if built else 'no kernel'}")
                return 2
            edits = [e for e in candidates(package) if f"{e.file}:{e.line}:".startswith(given.where)]
            drawn = draw(edits, given.edits, random.Random(f"{package} {given.seed}"))
            survivors = 0
            for edit in drawn:
                source, start = (copy.folder / edit.file).read_text(encoding="utf-8"), time.monotonic()
                copy.put(edit.file, edit.made(source))
                fault = (
                    "does not compile" if package == "kernel" and not copy.build() else copy.fault(copy.near(edit.file, tests), given.limit)
                )
                copy.put(edit.file, source)
                survivors += not fault
                print(
                    f"{'noticed' if fault else 'UNNOTICED'} {edit}\n    {time.monotonic() - start:.0f} s {fault}",
                    flush=True,
                )
            print(f"{package}: {len(drawn)} of {len(edits)} edits, {len(drawn) - survivors} noticed", flush=True)
            unnoticed += survivors
    return min(unnoticed, 1)


if __name__ == "__main__":
    sys.exit(main())
