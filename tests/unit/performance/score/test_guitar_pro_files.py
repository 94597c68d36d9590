"""Guitar Pro files of others, read here and by alphaTab: the same pitches as often, the last of them at the same time.

The files are not ours to ship: ``TONEWOOD_GUITAR_PRO`` names a folder as `scripts/guitar_pro_comparison.py` reads it.
"""

from __future__ import annotations

import importlib.util
import os
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[4]
FOLDER = Path(os.environ.get("TONEWOOD_GUITAR_PRO", ROOT.parent / "shared/scores_of_others/guitar_pro"))


@pytest.mark.validate
@pytest.mark.skipif(not FOLDER.is_dir(), reason="the files are not here")
def test_files_of_others_are_played_as_by_alphatab() -> None:
    pytest.importorskip("guitarpro")
    script = ROOT / "scripts/guitar_pro_comparison.py"
    spec = importlib.util.spec_from_file_location("guitar_pro_comparison", script)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    rows = list(module.rows(FOLDER))
    assert len(rows) > 100
    assert {r.name for r in rows if not r.same} <= set(module.OTHERWISE)
