"""Views of models, kept while their model is the design's or the start's."""

from __future__ import annotations

import threading
from dataclasses import asdict
from typing import Any

from tonewood.errors import TonewoodError
from tonewood.instrument.bundle.loading import Instrument
from tonewood.instrument.inspection.wolf import WolfNote, wolf_notes
from tonewood.instrument.model.assembly import Model
from tonewood.sound.render.options import RenderOptions
from tonewood.workshop.desk import views
from tonewood.workshop.desk.differences import differences, wolf_words
from tonewood.workshop.desk.models import KeptModels

#: views that are kept
_MOST = 24


class KeptViews:
    """Computes one view at a time, and keeps it as long as its model.

    Parameters
    ----------
    start : instrument to which designs are compared.
    options : of renders, which decide on the modes.
    models : that are kept.
    """

    def __init__(self, start: Instrument, options: RenderOptions, models: KeptModels):
        self._instrument, self._options, self._models = start, options, models
        self._start: Model | None = None
        self._start_wolves: list[WolfNote] | None = None
        self._views: dict[tuple[str, str, bool], tuple[Model, Any]] = {}
        self._lock = threading.Lock()

    def view(self, design: Model, kind: str, argument: str, *, of_start: bool, exact: bool) -> Any:
        """Return a view as plain data.

        Parameters
        ----------
        design : the model that is seen.
        kind, argument, of_start : as for `Desk.view`.
        exact : whether an exact model is known; of a body that is drawn the start's takes long, and until it is known
            the first preview stands for it.

        Raises
        ------
        TonewoodError : there is no such view.
        """
        with self._lock:
            model = self._start_model(design, exact) if of_start else design
            key = (kind, argument, of_start)
            found = self._views.get(key)
            if found is not None and found[0] is model:
                return found[1]
            made = self._made(model, kind, argument, exact)
            self._views[key] = (model, made)
            for old in [k for k, (of, _) in self._views.items() if of is not design and of is not self._start]:
                del self._views[old]
            while len(self._views) > _MOST:
                del self._views[next(iter(self._views))]
            return made

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

    def _made(self, model: Model, kind: str, argument: str, exact: bool) -> Any:
        if kind == "mobility":
            return views.mobility(model)
        if kind == "shape":
            return views.shape(model, _number(argument))
        if kind == "strings":
            return views.strings(model)
        if kind == "wolves":
            found, start = self._wolves(model), self._wolves(self._start_model(model, exact))
            shown = {"wolves": [asdict(w) for w in found], "start": [asdict(w) for w in start]}
            return {**shown, "neck": views.neck(model), "words": wolf_words(start, found)}
        if kind == "force":
            return views.force(model.instrument, argument or next(iter(model.groups)), self._options)
        if kind == "differences":
            return differences(model, self._start_model(model, exact))
        known = "mobility, shape, strings, wolves, force, drawing, differences"
        raise TonewoodError(f"is {kind!r}; {known} are allowed", key="view")


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise TonewoodError(f"is {text!r}; a frequency in Hz is allowed", key="shape") from None
