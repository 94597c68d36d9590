"""Models of the design on view, made beside the sound: of some bodies a preview first, then the exact one."""

from __future__ import annotations

import threading
from collections.abc import Callable

from tonewood.instrument.model.assembly import Model
from tonewood.sound.render.options import RenderOptions
from tonewood.workshop.desk.ahead import Ahead
from tonewood.workshop.desk.models import KeptModels, ModelMaker, Wanted, previewed
from tonewood.workshop.desk.session import Design, DeskSession

#: s without a change after which the exact model is begun
_REST = 0.7


class DesignModels:
    """The newest design's model, as far as it is made.

    ready : called with a model, a preview or exact, in a thread.
    failed : called with a design that has no model, and words on why.
    exact : the last exact model; None until the first is made.
    """

    def __init__(
        self,
        session: DeskSession,
        options: RenderOptions,
        kept: KeptModels,
        ready: Callable[[Model, Wanted], None],
        failed: Callable[[Wanted, str], None],
    ) -> None:
        self.exact: Model | None = None
        self._ready, self._failed, self._lock = ready, failed, threading.RLock()
        self._exact = ModelMaker(options, failed, kept)
        self._quick = ModelMaker(options, self._no_preview, kept)
        self._ahead = Ahead(session.source, options.fs, allow_code=session.allow_code)
        #: exact model that follows a preview
        self._then: Wanted | None = None

    def close(self) -> None:
        """End the threads and the process."""
        self._ahead.stop()
        self._exact.close()
        self._quick.close()

    @property
    def busy(self) -> Wanted | None:
        """The model that is made or waits, the newest."""
        return self._then or self._quick.busy or self._exact.busy

    def forget(self) -> None:
        """Make nothing that has not been begun."""
        with self._lock:
            self._then = None
            self._ahead.stop()
            self._quick.forget()
            self._exact.forget()

    def want(self, design: Design, serial: int) -> None:
        """Make the model of a design, in place of any other."""
        reference = None if self.exact is None else self.exact.instrument
        coarse = previewed(design.instrument, reference)
        with self._lock:
            self._quick.forget()
            self._exact.forget()
            self._ahead.turn_to(design)
            request = Wanted(design.instrument, design.changes, serial, self._ready)
            self._then = None if coarse is None else request
            if coarse is None:
                self._exact.want(request)
                return
            self._quick.want(Wanted(coarse[0], design.changes, serial, self._preview, coarse[1]))

    def _preview(self, model: Model, request: Wanted) -> None:
        try:
            self._ready(model, request)
        finally:
            self._rest(request.serial)

    def _no_preview(self, request: Wanted, reason: str) -> None:
        self._failed(request, reason)
        self._rest(request.serial)

    def _rest(self, serial: int) -> None:
        """Make the exact model once the hand has rested."""
        timer = threading.Timer(_REST, self._begin_exact, (serial,))
        timer.daemon = True
        timer.start()

    def _begin_exact(self, serial: int) -> None:
        with self._lock:
            if (then := self._then) is not None and then.serial == serial:
                self._ahead.make(Design(then.changes, then.instrument), lambda: self._follow(serial))

    def _follow(self, serial: int) -> None:
        with self._lock:
            if (then := self._then) is not None and then.serial == serial:
                self._exact.want(then)
                self._then = None
