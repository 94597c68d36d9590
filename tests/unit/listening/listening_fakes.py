"""Small tests whose sounds need no engine."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from tonewood.batch.runner import run_batch
from tonewood.listening.definition import ListeningTest, load_test

sys.path.append(str(Path(__file__).parents[1] / "batch"))
import batch_fakes as fakes

PLUCK = {"near": 1.0, "middle": 1.005, "far": 1.01}
BASE: dict[str, Any] = {
    "scores": {"low": {"phrase": [{"time": 0.0, "freq": 220.0, "force": 1.0}]}},
    "factors": {
        "damping": {"path": "body.t60", "levels": {"complex": 0.10, "proportional": 0.12, "block": 0.14}},
        "pluck": {"path": "body.detune", "levels": PLUCK},
    },
    "stimuli": {"loudness": {"method": "loudest"}},
    "output": {"formats": ["test", "json"]},
}
STAIRS = {
    "type": "staircase", "path": "body.detune", "of": {"damping": "complex", "pluck": "near"}, "scale": "percent",
    "start": 8.0, "lowest": 0.01, "highest": 10.0, "ratio": True, "steps": [2.0, 1.4, 1.2], "unit": "%",
    "reversals": 10, "discard": 2, "longest": 80,
}  # fmt: skip
#: every kind of page
ALL = [
    {"type": "consent", "content": "<b>Read</b> & agree"},
    {"type": "instructions", "name": {"en": "Hello", "de": "Guten Tag"}},
    {"type": "level", "spl_db": 65.0, "measured": True},
    {"type": "training", "page": 7, "trials": 1},
    {"type": "mushra", "group_by": ["pluck"], "reference": {"damping": "complex"}, "anchors": [3500, 7000]},
    {"type": "bs1116", "reference": {"damping": "complex", "pluck": "near"}},
    {"type": "abx", "pairs": {"damping": ["complex", "block"]}, "unforced": True, "feedback": True},
    {"type": "ab", "pairs": {"damping": ["complex", "block"]}},
    {"type": "paired_comparison", "pairs": {"pluck": "all"}, "question": "Which is brighter?", "tie": True},
    {"type": "afc", "pairs": {"pluck": ["near", "far"]}},
    {"type": "afc", "pairs": {"pluck": ["near", "far"]}, "intervals": 2, "question": "Which is higher?"},
    {"type": "rating", "scales": [{"name": "bright", "label": "Brightness"}]},
    STAIRS | {"reversals": 4, "longest": 8},
    {
        "type": "questionnaire",
        "questions": [
            {"name": "age", "label": "Age", "kind": "number", "optional": True},
            {
                "name": "plays",
                "label": "Do you play?",
                "kind": "choice",
                "choices": {"much": "much", "little": "little"},
            },
        ],
    },
]


def made(folder: Path, pages: list[dict[str, Any]], **changes: Any) -> ListeningTest:
    """A test with these pages, its sounds written."""
    path = fakes.write(folder / "in", fakes.manifest(**BASE | {"pages": pages} | changes))
    report = run_batch(path, folder / "out", fakes.FakeRenderer())
    assert report.ok, report.faults
    return load_test(folder / "out")
