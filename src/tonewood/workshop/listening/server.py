"""The server of a listening test: one page at a time, one answer at a time.

A browser gets the step of its session: texts, slots and the answers allowed. It asks for sounds by slot, never by code
or name, and only for those of its step. No other file can be reached: there is no listing, and no path leads from an
address to the disk. Two slots with one sound have replies with the same headers.

    GET  /                              the page; /static/... its script and style
    POST /api/session                   begin: {listener, language} -> {token}
    GET  /api/session/TOKEN             the step
    POST /api/session/TOKEN             the answer: {index, ...} -> {feedback, step}
    GET  /api/session/TOKEN/sound/INDEX/SLOT
    GET  /api/session/TOKEN/data        what the listener gave so far
    DELETE /api/session/TOKEN           withdraw: these answers are deleted
"""

from __future__ import annotations

import sys
import threading
import traceback
from collections import OrderedDict
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route

from tonewood.errors import TonewoodError
from tonewood.workshop.batch.pages import HeadphonesPage, LevelPage, StaircasePage
from tonewood.workshop.listening.answer_file import FOLDER, OpenSession, begin, exported, now, resume, withdraw
from tonewood.workshop.listening.definition import ListeningError, ListeningTest
from tonewood.workshop.listening.headphones import interval
from tonewood.workshop.listening.level_tone import tone
from tonewood.workshop.listening.on_demand import PairSource
from tonewood.workshop.listening.shown import shown
from tonewood.workshop.web.guard import Guard
from tonewood.workshop.web.requests import RefusalError, asset, json_body, mistake, one_line, refuse

#: sessions in memory; others are read from the disk again when they go on
_MOST_OPEN = 200
#: sessions of one test, on the disk
_MOST_SESSIONS = 10_000
_PACKAGE = "tonewood.workshop.listening"
_STATIC = {"test.js": "text/javascript", "players.js": "text/javascript", "test.css": "text/css"}
#: slot of the tone of a level page
TONE = "tone"


@dataclass
class _Entry:
    """A session that is in use, or was: its lock, and how many requests hold it."""

    opened: OpenSession | None = None
    lock: threading.Lock = field(default_factory=threading.Lock)
    users: int = 0
    #: step of which all sounds were read
    read: int = -1


class ListeningServer:
    """Requests of listeners to one test.

    pairs : sounds of its staircases; None if it has none.
    """

    def __init__(self, test: ListeningTest, pairs: PairSource | None = None):
        self.test, self.pairs = test, pairs
        self._entries: OrderedDict[str, _Entry] = OrderedDict()
        self._lock = threading.Lock()
        self._beginning = threading.Lock()
        self._begun = len(list((test.folder / FOLDER).glob("*.jsonl")))
        self._printed: set[str] = set()

    def application(self, host: str = "127.0.0.1", names: Collection[str] = ()) -> Guard:
        """The application, for any ASGI server.

        host, names : address that the server listens at, and other names by which browsers reach it.
        """
        routes = [
            Route("/", self._index),
            Route("/static/{name}", self._static),
            Route("/api/test", self._about),
            Route("/api/session", self._begin, methods=["POST"]),
            Route("/api/session/{token}", self._step, methods=["GET"]),
            Route("/api/session/{token}", self._answer, methods=["POST"]),
            Route("/api/session/{token}", self._withdraw, methods=["DELETE"]),
            Route("/api/session/{token}/data", self._data),
            Route("/api/session/{token}/sound/{index}/{slot}", self._sound),
        ]
        handlers: Any = {TonewoodError: self._fault, RefusalError: refuse, Exception: mistake}
        return Guard(Starlette(routes=routes, exception_handlers=handlers), host, names)

    async def _index(self, request: Request) -> Response:
        return Response(asset(_PACKAGE, "test.html"), media_type="text/html")

    async def _static(self, request: Request) -> Response:
        name = request.path_params["name"]
        if name not in _STATIC:
            return Response(status_code=404)
        return Response(asset(_PACKAGE, name), media_type=_STATIC[name])

    async def _about(self, request: Request) -> Response:
        language = self._language(request.query_params.get("language", ""))
        return JSONResponse(
            {
                "test": self.test.sha256[:16],
                "title": self.test.title(language),
                "language": language,
                "texts": self.test.texts(language),
            }
        )

    async def _begin(self, request: Request) -> Response:
        message = await json_body(request, ListeningError)
        language = self._language(str(message.get("language", "")))
        listener = message.get("listener") or ""
        if not isinstance(listener, str):
            raise ListeningError("is no text", key="listener")

        def make() -> str:
            with self._lock:
                if self._begun >= _MOST_SESSIONS:
                    raise RefusalError(429, f"{_MOST_SESSIONS} sessions of this test were begun, no more are allowed")
                self._begun += 1
            try:
                with self._beginning:
                    opened = begin(self.test, language=language, listener=listener, started=now())
            except BaseException:
                with self._lock:
                    self._begun -= 1
                raise
            token = str(opened.header["token"])
            with self._entry(token) as entry:
                entry.opened = opened
            return token

        return JSONResponse({"token": await run_in_threadpool(make)}, status_code=201)

    async def _step(self, request: Request) -> Response:
        return await self._with_session(request, lambda opened, _: JSONResponse(self._shown(opened)))

    async def _answer(self, request: Request) -> Response:
        body = await json_body(request, ListeningError)

        def take(opened: OpenSession, entry: _Entry) -> Response:
            session = opened.session
            index = body.get("index")
            if type(index) is not int or not 0 <= index <= len(session.answers):
                raise ListeningError("is not the number of a step", key="index")
            step = session.step
            if step is None or index != step.index:
                # sent again, as the reply to it was lost: it is on the disk, the page goes on
                if session.has_taken(body):
                    return JSONResponse({"feedback": None, "step": self._shown(opened)})
                error = "this page was answered before, otherwise; that answer counts"
                return JSONResponse({"error": error, "step": self._shown(opened)}, status_code=409)
            page = opened.session.page
            record = opened.answer(body, now=now())
            tells = step.training or bool(getattr(page, "feedback", False))
            feedback = {"right": record["right"], "correct": record["correct"]} if tells and "right" in record else None
            return JSONResponse({"feedback": feedback, "step": self._shown(opened)})

        return await self._with_session(request, take)

    async def _data(self, request: Request) -> Response:
        def give(opened: OpenSession, _: _Entry) -> Response:
            headers = {"Content-Disposition": 'attachment; filename="answers.json"'}
            return JSONResponse(exported(opened), headers=headers)

        return await self._with_session(request, give)

    async def _withdraw(self, request: Request) -> Response:
        token = request.path_params["token"]

        def work() -> Response:
            with self._entry(token) as entry, entry.lock:
                entry.opened = None
                if not withdraw(self.test, token, now=now()):
                    return JSONResponse({"error": "there is no such session"}, status_code=404)
                with self._lock:
                    self._begun -= 1
                return JSONResponse({"withdrawn": True})

        return await run_in_threadpool(work)

    async def _sound(self, request: Request) -> Response:
        index, slot = request.path_params["index"], request.path_params["slot"]

        def sound(opened: OpenSession, entry: _Entry) -> Response:
            step = opened.session.step
            page = opened.session.page
            tone_asked = isinstance(page, LevelPage) and slot == TONE
            if step is None or str(step.index) != index or not (slot in step.slots or tone_asked):
                return JSONResponse({"error": "the session is not at this sound"}, status_code=404)
            try:
                if isinstance(page, HeadphonesPage):
                    return Response(interval(self.test, page, opened.session, slot), media_type="audio/wav")
                if isinstance(page, LevelPage):
                    return Response(tone(self.test, page), media_type="audio/wav")
                if step.level is not None and self.pairs is not None:
                    number = opened.session.page_index or 0
                    pair = self.pairs.pair(number, step.level)
                    if not step.training:  # the levels after either answer are made ahead
                        track = opened.session.tracks[number][step.track or 0]
                        for right in (True, False):
                            self.pairs.expect(number, track.step_after(right))
                    return Response(pair[step.slots[slot]], media_type="audio/wav")
                if entry.read != step.index:  # the first sound costs as much whichever it is, the others are cached
                    for code in set(step.slots.values()):
                        self.test.sound(code).read_bytes()
                    entry.read = step.index
                return Response(self.test.sound(step.slots[slot]).read_bytes(), media_type="audio/wav")
            except Exception as fault:
                self._say(f"page {step.page + 1}, sound of listener {opened.listener!r}", fault)
                # not a fault of the connection: the page must not ask for ever
                return JSONResponse({"error": "a sound of this page cannot be made"}, status_code=422)

        return await self._with_session(request, sound)

    def _shown(self, opened: OpenSession) -> dict[str, Any]:
        name, code = str(opened.header["listener"]), str(opened.header["token"])[:8]
        return shown(self.test, opened.session, opened.language, name or code, code)

    async def _with_session(self, request: Request, use: Callable[[OpenSession, _Entry], Response]) -> Response:
        token = request.path_params["token"]

        def work() -> Response:
            with self._entry(token) as entry, entry.lock:
                if entry.opened is None:
                    try:
                        entry.opened = resume(self.test, token)
                    except ListeningError as fault:
                        self._say("a session cannot be continued", fault)
                        return JSONResponse({"error": "this session cannot be continued"}, status_code=410)
                if entry.opened is None:
                    return JSONResponse({"error": "there is no such session"}, status_code=404)
                try:
                    return use(entry.opened, entry)
                except ListeningError:
                    raise
                except BaseException:
                    entry.opened = None  # the disk counts: it is read again
                    raise

        return await run_in_threadpool(work)

    @contextmanager
    def _entry(self, token: str) -> Iterator[_Entry]:
        """The entry of a token while a request uses it; one without a session is not kept."""
        with self._lock:
            entry = self._entries.setdefault(token, _Entry())
            self._entries.move_to_end(token)
            entry.users += 1
        try:
            yield entry
        finally:
            with self._lock:
                entry.users -= 1
                if entry.users == 0 and entry.opened is None:
                    del self._entries[token]
                if len(self._entries) > _MOST_OPEN:
                    oldest = next((t for t, e in self._entries.items() if not e.users), None)
                    if oldest is not None:
                        del self._entries[oldest]

    async def _fault(self, request: Request, fault: Exception) -> Response:
        """One line, without the paths of the server's disk."""
        assert isinstance(fault, TonewoodError)
        if not isinstance(fault, ListeningError):
            self._say("an answer is not confirmed", fault)
        return one_line(fault, 400 if isinstance(fault, ListeningError) else 500)

    def _say(self, origin: str, fault: Exception) -> None:
        """Print a fault for the experimenter, each once."""
        expected = isinstance(fault, (TonewoodError, OSError))
        text = str(fault) if expected else "".join(traceback.format_exception(fault)).rstrip()
        with self._lock:
            if (key := f"{type(fault)}{fault}") in self._printed:
                return
            if len(self._printed) < 1000:
                self._printed.add(key)
        print(f"tonewood: {origin}: {text}", file=sys.stderr)

    def _language(self, wishes: str) -> str:
        """The first language asked for (with commas between) that the test has, or its own."""
        for wish in wishes.split(","):
            for name in (wish.strip(), wish.strip().partition("-")[0]):
                if name in self.test.languages:
                    return name
        return self.test.manifest.language


def has_staircase(test: ListeningTest) -> bool:
    """Whether sounds are rendered on demand."""
    return any(isinstance(page, StaircasePage) for page in test.pages)
