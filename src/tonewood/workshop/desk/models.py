"""Models made beside the sound: of each kind the newest design is made next, those before it are passed over."""

from __future__ import annotations

import json
import threading
import time
from collections import OrderedDict
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from tonewood.errors import TonewoodError
from tonewood.instrument.bundle.loading import Instrument
from tonewood.instrument.model.assembly import Model
from tonewood.sound.render.options import RenderOptions
from tonewood.sound.render.renderer import assembled

#: models that are kept for going back to them
_KEPT = 3
#: s that `ModelMaker.close` waits for a model that is being made
_PATIENCE = 5.0


@dataclass(frozen=True)
class Wanted:
    """A model that is asked for.

    preview : words on the coarse basis in place of the design's; empty for the design itself.
    """

    instrument: Instrument
    changes: Mapping[str, Any]
    serial: int
    use: Callable[[Model, Wanted], None]
    preview: str = ""
    since: float = field(default_factory=time.monotonic)


class ModelMaker:
    """A thread that makes models, the newest wanted one next.

    fault : called with what was wanted and words on why it could not be made.
    """

    def __init__(self, options: RenderOptions, fault: Callable[[Wanted, str], None], kept: KeptModels):
        self._options, self._fault, self._kept = options, fault, kept
        self._next: Wanted | None = None
        self._closed = False
        self._changed = threading.Condition()
        #: that is made now
        self.making: Wanted | None = None
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def want(self, request: Wanted) -> None:
        """Make this one next, in place of any that has not been begun."""
        with self._changed:
            self._next = request
            self._changed.notify()

    def forget(self) -> None:
        """Make nothing that has not been begun."""
        with self._changed:
            self._next = None

    def close(self) -> None:
        """End the thread when it has finished what it makes; at the end of Python none may be in the kernel."""
        with self._changed:
            self._closed, self._next = True, None
            self._changed.notify()
        self._thread.join(_PATIENCE)

    @property
    def busy(self) -> Wanted | None:
        """What is made or waits, the newest."""
        return self._next or self.making

    def _run(self) -> None:
        while True:
            with self._changed:
                self.making = None
                while self._next is None and not self._closed:
                    self._changed.wait()
                if self._closed:
                    return
                request, self._next = self._next, None
                self.making = request
            assert request is not None
            try:
                request.use(self._kept.model(request.instrument, self._options), request)
            except TonewoodError as fault:
                self._fault(request, str(fault))
            except (MemoryError, ValueError, ArithmeticError) as fault:
                self._fault(request, f"{type(fault).__name__}: {fault}")


class KeptModels:
    """The last models, by the values that they were made of."""

    def __init__(self) -> None:
        self._models: OrderedDict[str, Model] = OrderedDict()
        self._lock = threading.Lock()

    def model(self, instrument: Instrument, options: RenderOptions) -> Model:
        """Return the model of an instrument, made if it is not kept."""
        key = json.dumps(instrument.resolved, sort_keys=True)
        with self._lock:
            if (model := self._models.get(key)) is not None:
                self._models.move_to_end(key)
                return model
        model = assembled(instrument, options)
        with self._lock:
            self._models[key] = model
            while len(self._models) > _KEPT:
                self._models.popitem(last=False)
        return model


def previewed(instrument: Instrument, before: Instrument | None) -> tuple[Instrument, str] | None:
    """Return the instrument with a coarse basis of its body, and words on it; None where the body needs none.

    The body's plugin declares the values of a coarse basis (`Body.preview`). Nothing is previewed where the body is
    that of the model before: its modes are known.

    before : whose body is known; None where none is.
    """
    coarse = {k: v for k, v in type(instrument.body).preview.items() if instrument.resolved["body"].get(k) != v}
    if not coarse or (before is not None and instrument.resolved["body"] == before.resolved["body"]):
        return None
    words = ", ".join(f"{key} {value:g}" for key, value in coarse.items())
    return instrument.replace({f"body.{k}": v for k, v in coarse.items()}), f"preview: body with {words}"
