"""Pages, rows, simulated listeners and results of tests whose figures are worked out by hand."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import listening_fakes as fakes
import numpy as np

from tonewood.workshop.batch.pages import StaircasePage
from tonewood.workshop.listening.detection import Detection
from tonewood.workshop.listening.panel import SimulatedPanel, _Listener
from tonewood.workshop.listening.results import (
    PageResults,
    PanelResults,
)
from tonewood.workshop.listening.thresholds import (
    ListenerThreshold,
    Thresholds,
)

LEVITT = StaircasePage.model_validate(fakes.STAIRS)


LINEAR = StaircasePage.model_validate(
    {"type": "staircase", "path": "body.t60", "scale": "add", "start": 4.0, "lowest": 0.0, "highest": 10.0,
     "steps": [2.0, 1.0], "reversals": 4, "discard": 1, "longest": 30, "down": 2, "intervals": 2}
)  # fmt: skip


def row(listener: str, value: float | None, **other: Any) -> dict[str, Any]:
    return {"listener": listener, "value": value, "role": "sound", "trial": "1", "repetition": 1, **other}


def simulated(**changes: Any) -> Any:
    """A listener without any spread of sounds r (the reference), s, an anchor."""
    given = {"schema": "tonewood-panel/1", "listener_sd": 0.0, "residual_sd": 0.0, **changes}
    levels = {"r": {"d": "a", "p": "x"}, "s": {"d": "b", "p": "y"}, "k": {"d": "a", "p": "x"}}
    sounds = {c: SimpleNamespace(levels=v, role="anchor35" if c == "k" else "sound") for c, v in levels.items()}
    trials = [SimpleNamespace(id="t", reference="r", stimuli=("s",))]
    test = SimpleNamespace(trials=trials)
    panel = SimulatedPanel.model_validate(given)
    return _Listener(panel, SimpleNamespace(stimuli=sounds), test, np.random.default_rng(1))  # type: ignore[arg-type]


def listener(name: str, threshold: float) -> ListenerThreshold:
    return ListenerThreshold(name, 20, 1, None, threshold, 0.1, 5.0, threshold, 0.1, None, 3.0)


def found(page: StaircasePage, mean: float, *bounds: float | None, count: int = 2) -> tuple[Any, PageResults]:
    """Results of a staircase."""
    people = tuple(listener(f"l{i}", mean) for i in range(count))
    fit = Thresholds("%", 0.70711, people, mean, bounds[0], bounds[1], mean, 1.25, 3.0)
    rows = tuple(
        {"listener": "l0", "track": 0, "index": i, "level": level, "right": right, "value": float(right)}
        for i, (level, right) in enumerate(((4.0, True), (4.0, False), (2.0, True), (8.0, True)))
    )
    own = PageResults(1, "staircase", "Stairs", count, (), rows, thresholds=fit)
    factor = SimpleNamespace(path=page.path, levels={"near": 1.0, "far": 1.02, "odd": "word"})
    settings = SimpleNamespace(factors={"pluck": factor}, name="t")
    test = SimpleNamespace(pages=[page], manifest=settings)
    panel = PanelResults(test, 0.95, SimpleNamespace(rows=rows), count, 0, (), (), (own,))  # type: ignore[arg-type]
    return panel, own


def detected(**changes: Any) -> Detection:
    values: dict[str, Any] = {
        "cell": {"pluck": "near|far"}, "listeners": 4, "right": 30, "answers": 40, "undecided": 0, "share": 0.75,
        "low": 0.6, "high": 0.9, "p_value": 0.01, "d_prime": 2.0, "d_low": 1.0, "d_high": 3.0, "listener_mean": 0.75,
        "listener_low": 0.6, "listener_high": 0.9, "p_holm": 0.02,
    }  # fmt: skip
    return Detection(**values | changes)
