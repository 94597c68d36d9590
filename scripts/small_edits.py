"""Small wrong edits of sources, for `mutants.py`: from the syntax of Python, from the operators of C++."""

from __future__ import annotations

import ast
import random
import re
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import cast

ROOT = Path(__file__).parents[1]
SWAPPED = {
    ast.Add: ("+", "-"), ast.Sub: ("-", "+"), ast.Mult: ("*", "/"), ast.Div: ("/", "*"), ast.Lt: ("<", "<="),
    ast.LtE: ("<=", "<"), ast.Gt: (">", ">="), ast.GtE: (">=", ">"), ast.Eq: ("==", "!="), ast.NotEq: ("!=", "=="),
    ast.And: ("and", "or"), ast.Or: ("or", "and"), ast.Is: ("is", "is not"), ast.IsNot: ("is not", "is"),
    ast.In: ("in", "not in"), ast.NotIn: ("not in", "in"), ast.FloorDiv: ("//", "/"), ast.Mod: ("%", "*"),
}  # fmt: skip
OTHERS = {"min": "max", "max": "min", "minimum": "maximum", "maximum": "minimum", "floor": "ceil", "ceil": "floor"}
#: calls, functions and arguments in which an edit changes words, patience or speed alone
SAID = {
    "quantity", "Field", "warn", "warning", "info", "debug", "sleep", "lru_cache", "__repr__", "__str__",
    "__getattr__", "help", "strict", "stacklevel", "timeout", "encoding", "maxsize", "exist_ok", "overwrite_a",
    "check_finite", "optimize", "linthresh", "frozen", "grid", "figure", "lw", "linewidth", "ms", "markersize",
    "alpha", "fontsize", "color", "zorder", "pad", "rotation", "figsize", "set_params", "tight_layout", "savefig",
    "legend", "tick_params", "set_title", "annotate",
}  # fmt: skip
#: functions of which the order of two arguments says nothing
SYMMETRIC = {
    "isclose", "allclose", "array_equal", "hypot", "gcd", "multiply", "add", "union1d", "swapaxes", "isinstance",
}  # fmt: skip
#: C++ as the formatted sources have it: pattern, and its replacement
TOKENS = [
    (r" \+ ", " - "), (r" - ", " + "), (r" \* ", " / "), (r" / ", " * "), (r" < ", " <= "), (r" <= ", " < "),
    (r" > ", " >= "), (r" >= ", " > "), (r" == ", " != "), (r" != ", " == "), (r" && ", " || "), (r" \|\| ", " && "),
    (r" \+= ", " -= "), (r" -= ", " += "), (r"std::min\b", "std::max"), (r"std::max\b", "std::min"),
    (r"(?<=[=(,] )-(?=\w)", ""), (r"(?<=[( ])!(?=\w)", ""), (r"\b0\.5\b", "1.0"), (r"\b1(?=[;)\]])", "2"),
    (r"(?<=return )-", ""), (r"\b2(?= \*)", "1"), (r"\b2\.0\b", "1.0"),
]  # fmt: skip
LEFT_ALONE = re.compile(
    r'//[^\n]*|/\*.*?\*/|"(?:\\.|[^"\\\n])*"|^[ \t]*(?:#|template|static_assert|using)[^\n]*', re.S | re.M
)


@dataclass(frozen=True)
class Edit:
    """One edit: characters `start` to `stop` of a file, whose text is `source`, become `text`."""

    file: Path
    source: str
    start: int
    stop: int
    text: str
    kind: str = "operator"

    @property
    def made(self) -> str:
        """Text of the file with the edit."""
        return self.source[: self.start] + self.text + self.source[self.stop :]

    @property
    def place(self) -> str:
        """File and line."""
        return f"{self.file}:{self.source.count(chr(10), 0, self.start) + 1}"

    @property
    def lines(self) -> range:
        """Lines of the innermost statement that it is in, without the statements in that; none outside functions."""
        line, inside, found = self.source.count("\n", 0, self.start) + 1, False, range(0)
        for node in ast.walk(ast.parse(self.source)):
            if isinstance(node, ast.stmt) and node.lineno <= line <= (last := node.end_lineno or 0):
                body = getattr(node, "body", [])
                header = body and line < body[0].lineno
                if isinstance(node, ast.FunctionDef):  # a default counts for the whole function
                    inside, found = True, range(body[0].lineno, last + 1) if header else found
                elif inside and (header or not body):
                    found = range(node.lineno, (body[0].lineno if header else last + 1))
        return found

    @property
    def in_signature(self) -> bool:
        """Whether it is a default of a function."""
        line = self.source.count("\n", 0, self.start) + 1
        functions = (n for n in ast.walk(ast.parse(self.source)) if isinstance(n, ast.FunctionDef))
        return any(node.lineno <= line < node.body[0].lineno for node in functions)

    def __str__(self) -> str:
        first, last = self.source.rfind("\n", 0, self.start) + 1, self.source.find("\n", self.stop)
        old = " ".join(self.source[self.start : self.stop].split())
        before, after = self.source[first : self.start].lstrip(), self.source[self.stop : last]
        return f"{self.place}: {before}[{old} -> {self.text}]{after}"


def called(func: ast.AST) -> str:
    """Last name of what is called."""
    return func.attr if isinstance(func, ast.Attribute) else getattr(func, "id", "")


def names(node: ast.AST) -> str:
    """Name of a function or an argument."""
    return str(getattr(node, "name", "") or getattr(node, "arg", ""))


class PythonEdits:
    """Edits of one Python file."""

    def __init__(self, file: Path):
        self.file, self.source = file, (ROOT / file).read_text(encoding="utf-8")
        lines = self.source.splitlines(keepends=True)
        self.bytes, self.lines = self.source.encode(), [0]
        for line in lines:
            self.lines.append(self.lines[-1] + len(line.encode()))
        self.out = list(self.below(ast.parse(self.source)))

    def span(self, node: ast.AST) -> tuple[int, int]:
        """First and last character of a node."""
        at = cast("ast.expr", node)
        start = self.lines[at.lineno - 1] + at.col_offset
        stop = self.lines[(at.end_lineno or 0) - 1] + (at.end_col_offset or 0)
        return len(self.bytes[:start].decode()), len(self.bytes[:stop].decode())

    def text(self, node: ast.AST) -> str:
        """Text of a node."""
        return self.source[slice(*self.span(node))]

    def put(self, node: ast.AST, text: str, kind: str) -> Edit:
        """Edit a whole node."""
        return Edit(self.file, self.source, *self.span(node), text, kind)

    def between(self, left: ast.AST, right: ast.AST, op: ast.AST) -> Iterator[Edit]:
        """Put another operator between two operands."""
        (old, new), start, stop = SWAPPED.get(type(op), ("", "")), self.span(left)[1], self.span(right)[0]
        gap = self.source[start:stop]
        if old and gap.count(old) == 1 and "#" not in gap:
            at = start + gap.index(old)
            yield Edit(self.file, self.source, at, at + len(old), new)

    def below(self, node: ast.AST) -> Iterator[Edit]:
        """Edits of a node and of all nodes in it."""
        children = list(ast.iter_child_nodes(node))
        match node:
            case ast.Raise() | ast.JoinedStr() | ast.Import() | ast.ImportFrom() | ast.Assert():
                return
            case ast.Call(func=func) if called(func) in SAID:
                return
            case ast.FunctionDef(name="__repr__" | "__str__") | ast.keyword(arg=str()) if names(node) in SAID:
                return
            case ast.Assign(targets=[ast.Name(id=name)]) if re.search("TIMEOUT|PATIENCE|WAIT|SECONDS", name):
                return
            case ast.BinOp() if re.search("perf_counter|thread_time", self.text(node)):
                return
            case ast.ClassDef():
                children = list(node.body)
            case ast.FunctionDef():
                children = [*node.args.defaults, *(d for d in node.args.kw_defaults if d), *node.body]
            case ast.AnnAssign():
                children = [node.value] if node.value else []
            case _:
                yield from self.here(node)
        for child in children:
            yield from self.below(child)

    def here(self, node: ast.AST) -> Iterator[Edit]:
        """Edits of a node itself."""
        match node:
            case ast.BinOp(left, op, right) if not isinstance(op, ast.BitOr):
                if any(isinstance(n, ast.Constant) and isinstance(n.value, str) for n in ast.walk(node)):
                    return
                yield from self.between(left, right, op)
                if isinstance(op, ast.Add | ast.Sub | ast.Mult | ast.Div):
                    yield self.put(node, self.text(left), "term dropped")
            case ast.Compare(left, ops, others):
                for (a, b), compared in zip(pairwise([left, *others]), ops, strict=True):
                    yield from self.between(a, b, compared)
            case ast.BoolOp(op, values):
                for a, b in pairwise(values):
                    yield from self.between(a, b, op)
                yield self.put(node, f"({self.text(values[0])})", "condition dropped")
            case ast.UnaryOp(_, operand):
                yield self.put(node, f"({self.text(operand)})", "sign or not dropped")
            case ast.If(test) if self.text(test) != "TYPE_CHECKING":
                yield self.put(test, f"not ({self.text(test)})", "not")
            case ast.Constant(value=bool(value)):
                yield self.put(node, str(not value), "truth")
            case ast.Constant(value=float(value)) if not 0.0 < abs(value) <= 1e-6:  # no tolerances
                yield self.put(node, repr(2 * value or 1.0), "factor 2")
            case ast.Constant(value=int(value)):
                yield self.put(node, str(value + 1), "off by one")
            case ast.Return(value) if value is not None and not isinstance(value, ast.Constant):
                yield self.put(value, "0.0" if isinstance(value, ast.BinOp | ast.Call) else "None", "constant")
            case ast.Call(func, args):
                name = called(func)
                if name == "conj" and isinstance(func, ast.Attribute) and not args:
                    yield self.put(node, self.text(func.value), "conj dropped")
                if name in OTHERS:
                    stop = self.span(func)[1]
                    yield Edit(self.file, self.source, stop - len(name), stop, OTHERS[name], "min and max")
                elif len(args) > 1 and name not in SYMMETRIC and not any(isinstance(a, ast.Starred) for a in args[:2]):
                    first, second = args[:2]
                    text = f"{self.text(second)}, {self.text(first)}"
                    if self.text(first) != self.text(second):
                        yield Edit(self.file, self.source, self.span(first)[0], self.span(second)[1], text, "swapped")


def candidates(package: str) -> list[Edit]:
    """All edits of a package."""
    if package != "kernel":
        sources = ROOT / "src/tonewood"
        folder = ROOT / package if package == "plugins" else next(p for p in sources.rglob(package) if p.is_dir())
        return [e for f in sorted(folder.rglob("*.py")) for e in PythonEdits(f.relative_to(ROOT)).out]
    out = []
    for file in sorted(f for f in (ROOT / "src/kernel").rglob("*.hpp") if f.parent.name not in ("lab", "bind")):
        source = file.read_text(encoding="utf-8")
        code = LEFT_ALONE.sub(lambda m: re.sub(r"[^\n]", "\0", m.group()), source)
        for pattern, text in TOKENS:
            found = re.finditer(pattern, code)
            out += [Edit(file.relative_to(ROOT), source, *m.span(), text) for m in found]
    return out


def draw(edits: list[Edit], n: int, rng: random.Random) -> Iterator[Edit]:
    """Draw n edits: a kind first, then one of that kind."""
    for _ in range(min(n, len(edits))):
        kind = rng.choice(sorted({e.kind for e in edits}))
        edit = rng.choice([e for e in edits if e.kind == kind])
        edits.remove(edit)
        yield edit
