"""The server of a listening test: one page at a time, one answer at a time.

A browser gets the step of its session: texts, slots and the answers allowed. It asks for sounds by slot, never by code
or name, and only for those of its step. No other file can be reached: there is no listing, and no path leads from an
address to the disk.

    GET  /                              the page; /static/... its script and style
    POST /api/session                   begin: {listener, language} -> {token}
    GET  /api/session/TOKEN             the step
    POST /api/session/TOKEN             the answer: {index, ...} -> {feedback, step}
    GET  /api/session/TOKEN/sound/INDEX/SLOT
"""

from __future__ import annotations

import datetime
import io
import json
import threading
from collections.abc import Callable
from importlib.resources import files
from typing import Any

import numpy as np
from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.middleware import Middleware
from starlette.middleware.base import BaseHTTPMiddleware
from starlette.requests import Request
from starlette.responses import FileResponse, JSONResponse, Response
from starlette.routing import Route

from tonewood.batch.pages import LevelPage, StaircasePage
from tonewood.batch.production import encoded_wav
from tonewood.batch.stimuli import quantised
from tonewood.errors import TonewoodError
from tonewood.listening.answer_file import OpenSession, begin, resume
from tonewood.listening.definition import ListeningError, ListeningTest
from tonewood.listening.on_demand import PairSource
from tonewood.listening.session import Step
from tonewood.listening.shown import shown

#: bytes of a request's body
_MOST = 65536
_STATIC = {"test.js": "text/javascript", "players.js": "text/javascript", "test.css": "text/css"}
_HEADERS = {
    "Content-Security-Policy": "default-src 'self'; frame-ancestors 'none'; base-uri 'none'; form-action 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-store",
}
#: slot of the tone of a level page
TONE = "tone"
#: loudness of a sine of 997 Hz at full scale in one channel, LUFS (BS.1770-4 annex 1)
_FULL_SCALE_LUFS = -3.01


class ListeningServer:
    """Requests of listeners to one test.

    Parameters
    ----------
    test : the definition.
    pairs : sounds of its staircases; None if it has none.
    """

    def __init__(self, test: ListeningTest, pairs: PairSource | None = None):
        self.test, self.pairs = test, pairs
        self._sessions: dict[str, OpenSession] = {}
        self._locks: dict[str, threading.Lock] = {}
        self._lock = threading.Lock()

    def application(self) -> Starlette:
        """The application, for any ASGI server."""
        return Starlette(
            routes=[
                Route("/", self._index),
                Route("/static/{name}", self._static),
                Route("/api/test", self._about),
                Route("/api/session", self._begin, methods=["POST"]),
                Route("/api/session/{token}", self._step, methods=["GET"]),
                Route("/api/session/{token}", self._answer, methods=["POST"]),
                Route("/api/session/{token}/sound/{index:int}/{slot}", self._sound),
            ],
            middleware=[Middleware(BaseHTTPMiddleware, dispatch=_with_headers)],
            exception_handlers={TonewoodError: _fault},
        )

    async def _index(self, request: Request) -> Response:
        return Response(_asset("test.html"), media_type="text/html")

    async def _static(self, request: Request) -> Response:
        name = request.path_params["name"]
        if name not in _STATIC:
            return Response(status_code=404)
        return Response(_asset(name), media_type=_STATIC[name])

    async def _about(self, request: Request) -> Response:
        language = self._language(request.query_params.get("language", ""))
        return JSONResponse(
            {"title": self.test.title(language), "language": language, "texts": self.test.texts(language)}
        )

    async def _begin(self, request: Request) -> Response:
        asked = await _body(request)
        language = self._language(str(asked.get("language", "")))
        listener = str(asked.get("listener", ""))[:60]

        def make() -> str:
            opened = begin(self.test, language=language, listener=listener, started=_now())
            token = str(opened.header["token"])
            with self._lock:
                self._sessions[token] = opened
            return token

        return JSONResponse({"token": await run_in_threadpool(make)}, status_code=201)

    async def _step(self, request: Request) -> Response:
        return await self._with_session(request, lambda opened: JSONResponse(self._shown(opened)))

    async def _answer(self, request: Request) -> Response:
        given = await _body(request)

        def take(opened: OpenSession) -> Response:
            step = opened.session.step
            # an answer sent again, as the reply to it was lost: it is on the disk, the page goes on
            if step is None or given.get("index") != step.index:
                return JSONResponse({"feedback": None, "step": self._shown(opened)})
            page = opened.session.page
            record = opened.answer(given, now=_now())
            tells = step.training or bool(getattr(page, "feedback", False))
            feedback = {"right": record["right"], "correct": record["correct"]} if tells and "right" in record else None
            return JSONResponse({"feedback": feedback, "step": self._shown(opened)})

        return await self._with_session(request, take)

    async def _sound(self, request: Request) -> Response:
        index, slot = request.path_params["index"], request.path_params["slot"]

        def sound(opened: OpenSession) -> Response:
            step = opened.session.step
            if step is None or step.index != index:
                return Response(status_code=404)
            page = opened.session.page
            if isinstance(page, LevelPage) and slot == TONE:
                return Response(tone(self.test, page), media_type="audio/wav")
            if slot not in step.slots:
                return Response(status_code=404)
            if step.level is not None and self.pairs is not None:
                number = opened.session.page_index or 0
                made = self.pairs.pair(number, step.level)
                self._expect(opened, number, step)
                return Response(made[step.slots[slot]], media_type="audio/wav")
            return FileResponse(self.test.sound(step.slots[slot]), media_type="audio/wav")

        return await self._with_session(request, sound)

    def _expect(self, opened: OpenSession, page: int, step: Step) -> None:
        """Have the levels after either answer made."""
        tracks = opened.session.tracks.get(page)
        if self.pairs is not None and tracks and not step.training:
            for right in (True, False):
                self.pairs.expect(page, tracks[step.track or 0].step_after(right))

    def _shown(self, opened: OpenSession) -> dict[str, Any]:
        return shown(self.test, opened.session, opened.language)

    async def _with_session(self, request: Request, use: Callable[[OpenSession], Response]) -> Response:
        token = request.path_params["token"]

        def work() -> Response:
            with self._lock:
                lock = self._locks.setdefault(token, threading.Lock())
            with lock:
                opened = self._sessions.get(token) or resume(self.test, token)
                if opened is None:
                    return JSONResponse({"error": "there is no such session"}, status_code=404)
                self._sessions[token] = opened
                return use(opened)

        return await run_in_threadpool(work)

    def _language(self, asked: str) -> str:
        """The first language asked for (with commas between) that the test has, or its own."""
        for wish in asked.split(","):
            for name in (wish.strip(), wish.strip().partition("-")[0]):
                if name in self.test.languages:
                    return name
        return self.test.manifest.language


def tone(test: ListeningTest, page: LevelPage) -> bytes:
    """Two seconds of a sine as loud as the stimuli, as WAV; it can be looped without a click.

    A sine of amplitude a has the loudness -3.01 + 20 log10(a) LUFS at 1 kHz in one channel, 3.01 more in two.
    """
    settings = test.manifest.stimuli
    level = settings.loudness.target_lufs - _FULL_SCALE_LUFS - 10.0 * np.log10(settings.channels)
    cycles = round(2.0 * page.freq)  # whole periods: the end meets the beginning
    t = np.arange(2 * settings.fs) / settings.fs
    sound = 10.0 ** (level / 20.0) * np.sin(2 * np.pi * cycles / 2.0 * t)
    samples = quantised(np.repeat(sound[:, None], settings.channels, axis=1), "PCM_24", np.random.default_rng(0))
    stream = io.BytesIO()
    encoded_wav(stream, samples, settings.fs, "PCM_24")
    return stream.getvalue()


def _asset(name: str) -> bytes:
    return (files("tonewood.listening") / "static" / name).read_bytes()


async def _body(request: Request) -> dict[str, Any]:
    """The body of a request as a mapping.

    Raises
    ------
    ListeningError : it is too long, or no JSON object.
    """
    raw = b""
    async for part in request.stream():
        raw += part
        if len(raw) > _MOST:
            raise ListeningError(f"longer than the {_MOST} bytes allowed")
    try:
        data = json.loads(raw or b"{}")
    except (ValueError, RecursionError):
        raise ListeningError("no JSON") from None
    if not isinstance(data, dict):
        raise ListeningError("no JSON object")
    return data


async def _with_headers(request: Request, call_next: Any) -> Response:
    response: Response = await call_next(request)
    response.headers.update(_HEADERS)
    return response


async def _fault(request: Request, fault: Exception) -> Response:
    """One line, without the paths of the server's disk."""
    status = 400 if isinstance(fault, ListeningError) else 500
    reason = getattr(fault, "reason", str(fault))
    key = getattr(fault, "key", None)
    return JSONResponse({"error": f"{key}: {reason}" if key else reason}, status_code=status)


def _now() -> str:
    return datetime.datetime.now(datetime.UTC).isoformat(timespec="milliseconds")


def has_staircase(test: ListeningTest) -> bool:
    """Whether sounds are rendered on demand."""
    return any(isinstance(page, StaircasePage) for page in test.pages)
