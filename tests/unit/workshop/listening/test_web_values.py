"""Requests and connections of the servers for browsers: limits at their values, replies word by word."""

from __future__ import annotations

import asyncio
import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

pytest.importorskip("uvicorn")

from starlette.requests import ClientDisconnect
from uvicorn.protocols.http.h11_impl import H11Protocol

from tonewood.errors import TonewoodError
from tonewood.workshop.listening import server
from tonewood.workshop.listening.server import ListeningServer
from tonewood.workshop.web.guard import HEADERS, SECONDS, BoundedConnection, Guard
from tonewood.workshop.web.requests import RefusalError, json_body, mistake, refuse


def asked(*parts: bytes, kind: str | None = "application/json", fault: Exception | None = None) -> Any:
    """A request with a body in parts, and the parts that were not read."""
    left = list(parts)

    async def stream() -> Any:
        while left:
            yield left.pop(0)
        if fault is not None:
            raise fault

    return SimpleNamespace(headers={} if kind is None else {"content-type": kind}, stream=stream, left=left)


def read(*parts: bytes, **other: Any) -> dict[str, Any]:
    return asyncio.run(json_body(asked(*parts, **other)))


@pytest.mark.parametrize("kind", [None, "application/json", " Application/JSON ; charset=utf-8"])
def test_bodies_are_read_whole(kind: str | None) -> None:
    assert read(b'{"a": [1, ', b'"\\u0001"]}', kind=kind) == {"a": [1, "\N{REPLACEMENT CHARACTER}"]}
    assert read(kind=kind) == {}


@pytest.mark.parametrize(
    ("body", "reason"), [(b"[]", "no JSON object"), (b"1", "no JSON object"), (b"{", "no JSON"), (b"x", "no JSON")]
)
def test_bodies_that_are_no_objects(body: bytes, reason: str) -> None:
    class OwnError(TonewoodError):
        """Of the caller."""

    with pytest.raises(OwnError) as fault:
        asyncio.run(json_body(asked(body), OwnError))
    assert fault.value.reason == reason


def test_a_body_has_65536_bytes_at_most() -> None:
    text = json.dumps({"a": "x" * (65536 - 9)}).encode()
    assert len(text) == 65536
    assert len(read(text[:9], text[9:])["a"]) == 65536 - 9
    request = asked(text, b" ", b" ")
    with pytest.raises(RefusalError, match="longer than the 65536 bytes") as fault:
        asyncio.run(json_body(request))
    assert fault.value.status == 400
    assert request.left == [b" "]  # the rest is not read


@pytest.mark.parametrize(
    ("other", "status", "reason"),
    [
        ({"kind": "text/plain"}, 415, "application/json is wanted"),
        ({"kind": ""}, 415, "application/json is wanted"),
        ({"fault": TimeoutError()}, 408, "the request took longer than 10 s"),
        ({"fault": ClientDisconnect()}, 400, "the connection broke off"),
    ],
)
def test_requests_that_are_not_read(other: dict[str, Any], status: int, reason: str) -> None:
    assert SECONDS == 10.0
    with pytest.raises(RefusalError) as fault:
        read(b"{}", **other)
    assert (fault.value.status, fault.value.reason) == (status, reason)
    reply = asyncio.run(refuse(SimpleNamespace(), fault.value))  # type: ignore[arg-type]
    assert (reply.status_code, json.loads(bytes(reply.body)), reply.headers["connection"]) == (
        status, {"error": reason}, "close"
    )  # fmt: skip
    fallen = asyncio.run(mistake(SimpleNamespace(), ValueError("secret")))  # type: ignore[arg-type]
    assert (fallen.status_code, json.loads(bytes(fallen.body))) == (500, {"error": "the server made a mistake"})


@pytest.mark.parametrize("kind", [list, dict])
def test_bodies_are_eight_deep(kind: type) -> None:
    def nested(depth: int) -> bytes:
        value: Any = 1
        for _ in range(depth):
            value = [value] if kind is list else {"a": value}
        return json.dumps({"a": value}).encode()

    assert read(nested(7))
    with pytest.raises(TonewoodError, match="nested more than 8 deep"):
        read(nested(8))


def through(guard: Guard, scope: dict[str, Any]) -> list[dict[str, Any]]:
    sent: list[dict[str, Any]] = []

    async def send(message: dict[str, Any]) -> None:
        sent.append(message)

    asyncio.run(guard(scope, None, send))
    return sent


def test_replies_have_the_headers_of_all() -> None:
    async def application(scope: Any, receive: Any, send: Any) -> None:
        await send({"type": "http.response.start", "status": 200, "headers": [(b"x", b"y")]})
        await send({"type": "http.response.body", "body": b"ok"})

    own = [(name.lower().encode(), value.encode()) for name, value in HEADERS.items()]
    start, body = through(Guard(application), {"type": "http", "headers": [(b"host", b"localhost")]})
    assert (start["status"], start["headers"], body["body"]) == (200, [(b"x", b"y"), *own], b"ok")
    assert through(Guard(application), {"type": "websocket", "headers": [(b"host", b"localhost")]}) == []
    start, body = through(Guard(application), {"type": "http", "headers": [(b"host", b"evil.example")]})
    refused = json.loads(body["body"])["error"]
    assert refused.startswith("this address is not the one")
    assert start["status"] == 421
    assert start["headers"] == [
        (b"content-type", b"application/json"), (b"content-length", str(len(body["body"])).encode()), *own
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("host", "asked_for", "origin", "status"),
    [
        ("localhost", b"localhost", None, None),
        ("localhost", b"127.0.0.5", None, None),
        ("localhost", b"192.168.0.1", None, 421),
        ("server.example", b"SERVER.example:80", b"http://server.example", None),
        ("server.example", b"192.168.0.1", None, None),
        ("127.0.0.1", b"localhost:80", b"http://localhost:80", None),
        ("127.0.0.1", b"localhost:443", b"https://localhost:443", None),
        ("127.0.0.1", b"localhost:80", b"https://localhost", 403),
        ("127.0.0.1", b"localhost", b"https://localhost:443", None),
        ("127.0.0.1", b"localhost", b"https://localhost:80", 403),
        ("127.0.0.1", b"localhost:123456", None, 421),
    ],
)
def test_hosts_and_origins(host: str, asked_for: bytes, origin: bytes | None, status: int | None) -> None:
    headers = [(b"Host", asked_for)] + ([] if origin is None else [(b"Origin", origin)])
    found = Guard(None, host).fault(headers)
    assert (found and found[0]) == status


# -- connections ------------------------------------------------------------------------------------------------------


class Other:
    """A connection of another kind, which waits."""

    waits = True


class Loop:
    """A loop that keeps what is to be called, and when."""

    def __init__(self) -> None:
        self.calls: list[tuple[float, Any]] = []
        self.cancelled = 0

    def call_later(self, seconds: float, call: Any) -> Any:
        self.calls.append((seconds, call))
        return SimpleNamespace(cancel=lambda: setattr(self, "cancelled", self.cancelled + 1))


class Transport:
    """A connection that counts how often it is cut off, with bytes that nobody has read."""

    def __init__(self) -> None:
        self.cut, self.unread = 0, 0

    def abort(self) -> None:
        self.cut += 1

    def get_write_buffer_size(self) -> int:
        return self.unread


@pytest.fixture
def now(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """The time; the protocol below does nothing of its own."""
    time = [100.0]
    monkeypatch.setattr("tonewood.workshop.web.guard.time.monotonic", lambda: time[0])

    def made(self: Any, transport: Any) -> None:
        self.transport = transport
        self.connections.add(self)

    monkeypatch.setattr(H11Protocol, "connection_made", made)
    monkeypatch.setattr(H11Protocol, "connection_lost", lambda self, exc: self.connections.discard(self))
    monkeypatch.setattr(H11Protocol, "on_response_complete", lambda self: None)
    return time


def connected(connections: set[Any], cycle: Any = None, most: int = 1000) -> Any:
    one = BoundedConnection.__new__(BoundedConnection)
    one.connections, one.loop, one.cycle, one.most = connections, Loop(), cycle, most  # type: ignore[assignment, misc]
    one.connection_made(Transport())
    return one


def cycle(*, complete: bool = False, more: bool = False) -> Any:
    return SimpleNamespace(response_complete=complete, more_body=more)


@pytest.mark.parametrize(
    ("of", "waits"),
    [(None, True), (cycle(), False), (cycle(complete=True), True), (cycle(more=True), True)],
)
def test_a_connection_waits_for_a_request_or_a_reader(now: list[float], of: Any, waits: bool) -> None:
    assert bool(connected(set(), of).waits) is waits


def test_a_connection_that_is_waited_for_is_cut_off_after_ten_seconds(now: list[float]) -> None:
    one = connected(set())
    assert [seconds for seconds, _ in one.loop.calls] == [2.5]
    for time, cut, calls in ((102.5, 0, 2), (110.0, 0, 3), (110.1, 1, 3)):
        now[0] = time
        one._look()
        assert (one.transport.cut, len(one.loop.calls)) == (cut, calls)
    assert [seconds for seconds, _ in one.loop.calls] == [2.5] * 3
    one.connection_lost(None)
    assert one.loop.cancelled == 1


def test_work_here_and_reading_there_are_no_waiting(now: list[float]) -> None:
    busy = connected(set(), cycle())
    now[0] = 200.0
    busy._look()
    assert busy.transport.cut == 0
    busy.cycle = cycle(complete=True)
    now[0] = 210.0
    busy._look()  # since 200
    assert busy.transport.cut == 0
    reading = connected(set(), cycle(complete=True))  # since 210
    for time, unread, cut in ((215.0, 500, 0), (219.0, 400, 0), (229.0, 400, 0), (229.5, 400, 1)):
        now[0], reading.transport.unread = time, unread
        reading._look()
        assert reading.transport.cut == cut
    done = connected(set(), cycle(complete=True))
    now[0] = 235.0
    done.on_response_complete()
    now[0] = 244.0
    done._look()
    assert done.transport.cut == 0


def test_beyond_the_most_the_one_that_waits_longest_makes_room(now: list[float]) -> None:
    every: set[Any] = {Other()}  # another kind of connection stays
    busy = connected(every, cycle(), most=4)
    now[0] = 101.0
    old = connected(every, most=4)
    now[0] = 102.0
    new = connected(every, most=4)
    assert [c.transport.cut for c in (busy, old, new)] == [0, 0, 0]
    now[0] = 90.0
    last = connected(every, most=4)  # the fifth: it does not cut itself off
    assert [c.transport.cut for c in (busy, old, new, last)] == [0, 1, 0, 0]
    alone = connected({Other()}, most=1)
    assert alone.transport.cut == 0
    assert BoundedConnection.most == 1000


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        ("test.js", "text/javascript"),
        ("players.js", "text/javascript"),
        ("test.css", "text/css"),
        ("report.css", None),
        ("test.html", None),
        ("../server.py", None),
    ],
)
def test_files_of_the_page_are_sent_and_no_others(name: str, kind: str | None) -> None:
    request: Any = SimpleNamespace(path_params={"name": name})
    response = asyncio.run(ListeningServer._static(None, request))  # type: ignore[arg-type]  # it reads nothing of the server
    if kind is None:
        assert (response.status_code, response.body) == (404, b"")
    else:
        assert (response.status_code, response.media_type) == (200, kind)
        assert response.body == (Path(server.__file__).parent / "static" / name).read_bytes()
