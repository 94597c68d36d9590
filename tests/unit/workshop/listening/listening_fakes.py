"""Small tests whose sounds need no engine."""

from __future__ import annotations

import asyncio
import sys
from pathlib import Path
from typing import Any

from tonewood.workshop.batch.runner import run_batch
from tonewood.workshop.listening.definition import ListeningTest, load_test

sys.path.append(str(Path(__file__).parents[1] / "batch"))
sys.path.append(str(Path(__file__).parents[4] / "scripts"))
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


def request(
    application: Any, method: str, path: str, body: bytes = b"", headers: dict[str, str] | None = None
) -> tuple[int, dict[str, str], bytes]:
    """Status, headers and body of the reply to one request, without sockets."""
    sent: list[dict[str, Any]] = []
    arriving = [{"type": "http.request", "body": body, "more_body": False}]

    async def receive() -> dict[str, Any]:
        return arriving.pop() if arriving else {"type": "http.disconnect"}

    async def send(message: dict[str, Any]) -> None:
        sent.append(message)

    given = {"Host": "localhost", "Content-Type": "application/json"} | (headers or {})
    scope = {
        "type": "http", "method": method, "path": path, "raw_path": path.encode(), "query_string": b"",
        "root_path": "", "scheme": "http", "http_version": "1.1", "server": ("127.0.0.1", 80), "client": None,
        "headers": [(k.lower().encode(), v.encode("latin-1")) for k, v in given.items() if v],
    }  # fmt: skip
    asyncio.run(application(scope, receive, send))
    found = {k.decode(): v.decode() for k, v in sent[0]["headers"]}
    return sent[0]["status"], found, b"".join(m.get("body", b"") for m in sent[1:])
