"""Write the project's public address into every file that names it.

``python scripts/project_address.py https://HOST/OWNER/tonewood [--docs https://...]`` replaces the present addresses:
the placeholder at example.org, or those of an earlier run. Without an argument it prints them.
"""

from __future__ import annotations

import argparse
import re
import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
#: files that name the address; `tests/test_packaging.py` finds others
FILES = ("pyproject.toml", "CITATION.cff", "mkdocs.yml", "SUPPORT.md", "SECURITY.md", "CODE_OF_CONDUCT.md", "paper.md")
_ADDRESS = re.compile(r"https://[\w.-]+(:\d+)?(/[\w.-]+)*")


def addresses(root: Path = ROOT) -> tuple[str, str]:
    """Return the addresses of the source and of the documentation."""
    urls = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))["project"]["urls"]
    return urls["Source"], urls["Documentation"]


def write(source: str, docs: str, root: Path = ROOT) -> list[str]:
    """Replace the addresses in all files; return the names of those that changed."""
    before_source, before_docs = addresses(root)
    changed = []
    for name in FILES:
        path = root / name
        text = path.read_text(encoding="utf-8")
        # the documentation first: its placeholder begins with that of the source
        new = text.replace(before_docs, "\0docs").replace(before_source, source).replace("\0docs", docs)
        if new != text:
            path.write_text(new, encoding="utf-8")
            changed.append(name)
    return changed


def main() -> int:
    """Parse the command line; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("source", nargs="?", help="address of the repository")
    parser.add_argument("--docs", help="address of the documentation; default: SOURCE/docs")
    options = parser.parse_args()
    if options.source is None:
        print(*addresses(), sep="\n")
        return 0
    source = options.source.rstrip("/")
    docs = (options.docs or f"{source}/docs").rstrip("/")
    for address in (source, docs):
        if not _ADDRESS.fullmatch(address):
            print(f"{address!r} is no address; one like https://host/owner/tonewood is allowed", file=sys.stderr)
            return 2
    print(*write(source, docs), sep="\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
