"""The desk's server, for the browsers of one computer; each request but for the page itself carries the desk's token.

    GET  /                  the page; /static/... its scripts and style
    GET  /api/state         the design and all that is said about it
    POST /api/act           one act: {act, ...} -> state
    GET  /api/points, /api/groups, /api/knobs/GROUP
    GET  /api/view/KIND?argument=..&of=start
    GET  /api/moments?since=FRAME
    GET  /api/stream        the sound without end: blocks of a head and of (n, 2) little-endian single precision
    POST /api/heard         the page's report on its buffer

A head is five 32-bit integers: frames, serial of the newest change in them, frame of the phrase, whether it plays, and
place in the stream: a block drops all that was sent before from its place on, so that a change is heard at once.
One page at a time has the stream; another one that asks for it takes it.
"""

from __future__ import annotations

import asyncio
import hmac
import secrets
import struct
import time
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import Any

from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import JSONResponse, Response, StreamingResponse
from starlette.routing import Route

from tonewood.errors import TonewoodError
from tonewood.instrument.bundle.string_sets import string_set
from tonewood.workshop.desk.desk import Desk
from tonewood.workshop.desk.knobs import groups, shown
from tonewood.workshop.desk.session import DeskSession
from tonewood.workshop.web.guard import Guard
from tonewood.workshop.web.requests import RefusalError, asset, json_body, mistake, one_line, refuse

_PACKAGE = "tonewood.workshop.desk"
_STATIC = dict.fromkeys(("desk.js", "sound.js", "ring.js", "views.js"), "text/javascript") | {"desk.css": "text/css"}
#: frames of a block; s that blocks are sent ahead of what is heard, at least and at most
BLOCK = 512
AHEAD = (0.03, 1.0)
#: numbers of a report are smaller: frames of a thousand years
_MOST_FRAMES = 2**51
#: s without a report of the page after which its stream ends
_SILENT = 6.0


class DeskServer:
    """Requests to one desk.

    token : of the address; a new one where left out.
    """

    def __init__(self, desk: Desk, token: str | None = None):
        self.desk, self.token = desk, token or secrets.token_urlsafe(16)
        self._stream = 0
        self._ahead = 0.1
        self.closing = False

    def application(self) -> Guard:
        """The application, for any ASGI server on this computer's own address."""
        routes = [
            Route("/", self._index),
            Route("/static/{name}", self._static),
            Route("/api/state", self._with(lambda request: self.desk.state())),
            Route("/api/act", self._act, methods=["POST"]),
            Route("/api/points", self._with(self._points)),
            Route("/api/groups", self._with(lambda request: groups(self.desk.session.instrument))),
            Route("/api/knobs/{group}", self._with(self._knobs)),
            Route("/api/view/{kind}", self._with(self._view)),
            Route("/api/moments", self._with(self._moments)),
            Route("/api/stream", self._streamed),
            Route("/api/heard", self._report, methods=["POST"]),
        ]
        handlers: Any = {TonewoodError: _fault, RefusalError: refuse, Exception: mistake}
        return Guard(Starlette(routes=routes, exception_handlers=handlers), "127.0.0.1")

    def _check(self, request: Request) -> None:
        token = request.headers.get("x-desk-token", "")
        if not hmac.compare_digest(token.encode("utf-8", "replace"), self.token.encode()):
            raise RefusalError(403, "the address has no token, or an old one: `tonewood desk` prints the right one")

    async def _index(self, request: Request) -> Response:
        return Response(asset(_PACKAGE, "desk.html"), media_type="text/html")

    async def _static(self, request: Request) -> Response:
        name = request.path_params["name"]
        if name not in _STATIC:
            return Response(status_code=404)
        return Response(asset(_PACKAGE, name), media_type=_STATIC[name])

    def _with(self, use: Callable[[Request], Any]) -> Callable[[Request], Any]:
        """A reply of JSON, made in a thread."""

        async def reply(request: Request) -> Response:
            self._check(request)
            return JSONResponse(await run_in_threadpool(use, request))

        return reply

    def _points(self, request: Request) -> list[str]:
        """Points of the body on which a mass can be put."""
        return [name for name, point in self.desk.session.instrument.body.points().items() if point.driven]

    def _knobs(self, request: Request) -> list[dict[str, Any]]:
        design, start = self.desk.session.design, self.desk.session.start
        return shown(design.instrument, start.instrument, design.changes, request.path_params["group"])

    def _view(self, request: Request) -> Any:
        query = request.query_params
        kind = request.path_params["kind"]
        return self.desk.view(kind, query.get("argument", ""), of_start=query.get("of") == "start")

    def _moments(self, request: Request) -> Any:
        since = request.query_params.get("since", "0")
        return self.desk.playback.moments(int(since) if since.isdecimal() and len(since) < 12 else 0)

    async def _act(self, request: Request) -> Response:
        self._check(request)
        body = await json_body(request)
        said = await run_in_threadpool(self._done, body)
        state = await run_in_threadpool(self.desk.state)
        return JSONResponse({**state, "said": said})

    def _done(self, body: dict[str, Any]) -> str:
        """Do one act; returns words on it."""
        name = body.get("act")
        act = _ACTS.get(name) if isinstance(name, str) else None
        if act is None:
            raise TonewoodError(f"is {name!r}; {', '.join(_ACTS)} are allowed", key="act")
        try:
            return act(self.desk, body) or ""
        except (KeyError, TypeError, ValueError, OverflowError) as fault:
            raise TonewoodError(f"a value is missing or of another type ({fault})", key=str(name)) from None

    async def _report(self, request: Request) -> Response:
        self._check(request)
        body = await json_body(request)
        numbers = {k: float(v) for k, v in body.items() if isinstance(v, int | float) and abs(v) < _MOST_FRAMES}
        listener = self.desk.playback.listener
        if numbers.get("stream") == self._stream and listener is not None:
            listener.report(int(numbers.get("heard", 0)))
            self._ahead = min(max(numbers.get("ahead", self._ahead), AHEAD[0]), AHEAD[1])
            self.desk.playback.meter.underruns = int(numbers.get("underruns", 0))
        return JSONResponse({"stream": self._stream})

    async def _streamed(self, request: Request) -> Response:
        self._check(request)
        self._stream += 1
        headers = {"X-Desk-Stream": str(self._stream)}
        return StreamingResponse(self._blocks(self._stream), media_type="application/octet-stream", headers=headers)

    async def _blocks(self, stream: int) -> AsyncIterator[bytes]:
        """Blocks as the page hears them; ends when another page has the stream, or this one is gone."""
        playback = self.desk.playback
        listener = playback.listen(_SILENT)  # a page may need a moment to begin
        while stream == self._stream and not self.closing:
            if time.monotonic() - listener.reported > _SILENT:
                return
            wait = listener.unheard / playback.fs - self._ahead
            if wait > 0:
                await asyncio.sleep(min(max(wait, 0.002), 0.05))
                continue
            block, what = await run_in_threadpool(playback.read, BLOCK)
            numbers = (len(block), what["serial"] & 0xFFFFFFFF, what["frame"], int(what["playing"]), what["place"])
            yield struct.pack("<5I", *numbers) + block.astype("<f4").tobytes()


Act = dict[str, Any]


def _changes(use: Callable[[DeskSession, Act], None]) -> Callable[[Desk, Act], str | None]:
    """An act on the session that may change the design."""

    def act(desk: Desk, body: Act) -> None:
        desk.change(lambda session: use(session, body))

    return act


def _set(session: DeskSession, body: Act) -> None:
    session.set(str(body["path"]), body["value"], dragging=bool(body.get("dragging")))


def _strings(session: DeskSession, body: Act) -> None:
    name = str(body["name"])
    string_set(name)  # raises where there is none
    session.set("strings_from", name)


def _save(desk: Desk, body: Act) -> str:
    try:
        folder = Path(str(body["folder"])).expanduser()
        desk.session.save(folder)
    except RuntimeError as fault:  # the home of a user who is not there
        raise TonewoodError(f"cannot be made: {fault}", key="folder") from None
    return f"saved in {folder.resolve()}: tonewood render {desk.phrase.file} -i {folder}"


def _play(desk: Desk, body: Act) -> None:
    desk.playback.loop = bool(body.get("loop", desk.playback.loop))
    if body.get("on", True):
        desk.playback.start()
    else:
        desk.playback.stop()


def _loop(desk: Desk, body: Act) -> None:
    desk.playback.loop = bool(body["on"])


def _phrase(desk: Desk, body: Act) -> None:
    desk.set_phrase(str(body["kind"]), str(body.get("notes", "")), float(body.get("velocity", 80)))


def _key(desk: Desk, body: Act) -> None:
    desk.key(body["note"], float(body.get("velocity", 80)), on=bool(body["on"]))


def _advise(desk: Desk, body: Act) -> None:
    session = desk.session
    desk.adviser.ask(session.instrument, session.options(), session.source, str(body["targets"]), str(body["free"]))


def _take_advice(desk: Desk, body: Act) -> str:
    values = dict(desk.adviser.overrides)
    if not values:
        raise TonewoodError("there is no design yet: look for one first", key="take")
    desk.change(lambda session: session.set_all(values))
    return "The design that was found is on view; Undo takes it back."


def _compare(desk: Desk, body: Act) -> None:
    name = body.get("name")
    desk.compare(None if name is None else str(name), blind=bool(body.get("blind")))


#: what a page may ask for -> how it is done
_ACTS: dict[str, Callable[[Desk, Act], str | None]] = {
    "set": _changes(_set),
    "reset": _changes(lambda session, body: session.reset(str(body["path"]))),
    "strings": _changes(_strings),
    "undo": _changes(lambda session, body: session.undo()),
    "redo": _changes(lambda session, body: session.redo()),
    "recall": _changes(lambda session, body: session.recall(str(body["name"]))),
    "keep": _changes(lambda session, body: session.keep(str(body["name"]))),
    "forget": _changes(lambda session, body: session.forget(str(body["name"]))),
    "save": _save,
    "play": _play,
    "loop": _loop,
    "phrase": _phrase,
    "key": _key,
    "compare": _compare,
    "advise": _advise,
    "advise_stop": lambda desk, body: desk.adviser.stop(),
    "advise_take": _take_advice,
    "pick": lambda desk, body: desk.playback.pick(int(body["which"])),
    "reveal": lambda desk, body: desk.playback.reveal(),
}


async def _fault(request: Request, fault: Exception) -> Response:
    assert isinstance(fault, TonewoodError)
    return one_line(fault)
