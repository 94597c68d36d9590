"""Views of models, kept while their model is the design's or the start's."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from dataclasses import asdict
from functools import partial
from typing import Any

from tonewood.errors import TonewoodError
from tonewood.instrument.bundle.loading import Instrument
from tonewood.instrument.inspection.wolf import WolfNote, wolf_notes
from tonewood.instrument.model.assembly import Model
from tonewood.sound.render.options import RenderOptions
from tonewood.support.units import number_in
from tonewood.workshop.desk import views
from tonewood.workshop.desk.differences import differences, wolf_words
from tonewood.workshop.desk.models import KeptModels

#: views that are kept
_MOST = 24


class KeptViews:
    """Computes one view at a time, and keeps it as long as its model."""

    def __init__(self, start: Instrument, options: RenderOptions, models: KeptModels):
        self._instrument, self._options, self._models = start, options, models
        self._start: Model | None = None
        self._start_wolves: list[WolfNote] | None = None
        self._views: dict[tuple[str, str, bool], tuple[Model, Any]] = {}
        self._lock = threading.Lock()

    def view(self, design: Model, kind: str, argument: str, *, of_start: bool, exact: bool) -> Any:
        """Return a view as plain data.

        design : the model that is seen.
        kind, argument, of_start : as for `Desk.view`.
        exact : whether an exact model is known; of a body that is drawn the start's takes long, and until it is known
            the first preview stands for it.
        Raises TonewoodError : there is no such view.
        """
        with self._lock:
            model = self._start_model(design, exact) if of_start else design
            key = (kind, argument, of_start)
            of_model, view = self._views.get(key, (None, None))
            if of_model is model:
                return view
            view = self._computed(model, kind, argument, exact)
            self._views[key] = (model, view)
            for old in [k for k, (of, _) in self._views.items() if of is not design and of is not self._start]:
                del self._views[old]
            while len(self._views) > _MOST:
                del self._views[next(iter(self._views))]
            return view

    def _start_model(self, design: Model, exact: bool) -> Model:
        """The exact model of the start, kept; the design where no exact model is known yet."""
        if self._start is None and exact:
            self._start = self._models.model(self._instrument, self._options)
        return self._start or design

    def _wolves(self, model: Model) -> list[WolfNote]:
        """Wolf notes of a model, those of the start kept."""
        if model is not self._start:
            return wolf_notes(model)
        if self._start_wolves is None:
            self._start_wolves = wolf_notes(model)
        return self._start_wolves

    def _computed(self, model: Model, kind: str, argument: str, exact: bool) -> Any:
        start = partial(self._start_model, model, exact)
        kinds: dict[str, Callable[[], Any]] = {
            "mobility": lambda: views.mobility(model),
            "shape": lambda: views.shape(model, _number(argument)),
            "strings": lambda: views.strings(model),
            "wolves": lambda: self._wolf_view(model, start()),
            "force": lambda: views.force(model.instrument, argument or next(iter(model.groups)), self._options),
            "differences": lambda: differences(model, start()),
        }
        if kind not in kinds:
            allowed = "mobility, shape, strings, wolves, force, drawing, differences"
            raise TonewoodError(f"is {kind!r}; {allowed} are allowed", key="view")
        return kinds[kind]()

    def _wolf_view(self, model: Model, start: Model) -> dict[str, Any]:
        wolves, before = self._wolves(model), self._wolves(start)
        shown = {"wolves": [asdict(w) for w in wolves], "start": [asdict(w) for w in before]}
        return {**shown, "neck": views.neck(model), "words": wolf_words(before, wolves)}


def _number(text: str) -> float:
    if math.isnan(value := number_in(text)):
        raise TonewoodError(f"is {text!r}; a frequency in Hz is allowed", key="shape")
    return value
