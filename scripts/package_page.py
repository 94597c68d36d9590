"""Make the links of the front pages absolute: an index of packages and an sdist show them without the repository.

``python scripts/package_page.py [FOLDER]`` rewrites README.md and the pages beside it in the copy of the repository
from which a release is built. The address is that of ``pyproject.toml`` (`project_address.py`).
"""

from __future__ import annotations

import re
import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
_RELATIVE = re.compile(r"(!?\[[^\]]*\]\()(?![a-z]+:|#)([^)\s]+\))")


def absolute(text: str, source: str) -> str:
    """Return a page whose relative links lead to the repository's main branch, those of pictures to their bytes."""
    return _RELATIVE.sub(lambda m: f"{m[1]}{source}/{'raw' if m[1][0] == '!' else 'blob'}/main/{m[2]}", text)


def main() -> None:
    """Rewrite the pages of a folder."""
    root = Path(sys.argv[1]) if len(sys.argv) > 1 else ROOT
    source = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))["project"]["urls"]["Source"]
    for page in root.glob("*.md"):
        page.write_text(absolute(page.read_text(encoding="utf-8"), source), encoding="utf-8")


if __name__ == "__main__":
    main()
