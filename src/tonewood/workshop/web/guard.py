"""Checks of a request before anything else reads it, and limits of the time that a connection may take.

A page of another site, opened in a listener's browser, must not send answers or read steps: names that lead to this
computer by another's DNS are refused (`Host`), and so are requests that another page makes (`Origin`).
"""

from __future__ import annotations

import ipaddress
import re
import socket
import time
from collections.abc import Collection, MutableMapping
from typing import Any

from h11 import LocalProtocolError
from uvicorn.protocols.http.h11_impl import H11Protocol

HEADERS = {
    "Content-Security-Policy": "default-src 'self'; frame-ancestors 'none'; base-uri 'none'; form-action 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-store",
    "Cross-Origin-Resource-Policy": "same-origin",
}
#: s until a request must have arrived as a whole, and an answer must be read on
SECONDS = 10.0
#: connections at one time; beyond that, those that have waited longest for a request are closed
_MOST = 1000
_HOST = re.compile(r"(\[[0-9a-f:.]+\]|[a-z0-9_.-]+)(?::([0-9]{1,5}))?")


class Guard:
    """An ASGI application before which `Host` and `Origin` are checked; adds the headers of every reply.

    names : other names by which browsers reach it.
    """

    def __init__(self, application: Any, host: str = "127.0.0.1", names: Collection[str] = ()):
        self.application = application
        self.names = {name.lower().strip("[]") for name in (*names, "localhost")}
        try:
            self.local_only = ipaddress.ip_address(host).is_loopback
        except ValueError:  # a name
            self.names.add(host.lower())
            self.local_only = host.lower() == "localhost"
        if not self.local_only:
            hostname = socket.gethostname().lower()
            self.names |= {hostname, f"{hostname}.local"}

    async def __call__(self, scope: MutableMapping[str, Any], receive: Any, send: Any) -> None:
        """Refuse a request, or pass it on."""
        if scope["type"] != "http":
            return
        if (fault := self.fault(scope["headers"])) is not None:
            status, reason = fault
            body = b'{"error": "' + reason.encode() + b'"}'
            length = (b"content-length", str(len(body)).encode())
            kind = (b"content-type", b"application/json")
            await send({"type": "http.response.start", "status": status, "headers": [kind, length, *_RAW]})
            await send({"type": "http.response.body", "body": body})
            return

        async def with_headers(message: MutableMapping[str, Any]) -> None:
            if message["type"] == "http.response.start":
                message["headers"] = [*message.get("headers", []), *_RAW]
            await send(message)

        await self.application(scope, receive, with_headers)

    def fault(self, headers: Collection[tuple[bytes, bytes]]) -> tuple[int, str] | None:
        """Status and reason for which a request with these headers is refused; None if it is not."""
        reasons: dict[str, list[str]] = {"host": [], "origin": []}
        for name, value in headers:
            if (key := name.decode("latin-1").lower()) in reasons:
                reasons[key].append(value.decode("latin-1").strip().lower())
        hosts, origins = reasons["host"], reasons["origin"]
        match = _HOST.fullmatch(hosts[0]) if len(hosts) == 1 else None
        if match is None or not self._is_ours(match[1].strip("[]").rstrip(".")):
            return 421, "this address is not the one that the server printed; `tonewood serve --name` allows others"
        port = match[2] or ""
        same = {f"http://{match[1]}:{port or 80}", f"https://{match[1]}:{port or 443}"}
        same |= {f"http://{match[1]}"} if port in ("", "80") else set()
        same |= {f"https://{match[1]}"} if port in ("", "443") else set()
        if origins and (len(origins) > 1 or origins[0] not in same):
            return 403, "the request comes from another page"
        return None

    def _is_ours(self, name: str) -> bool:
        """Whether a host's name may be this computer; an address can be, because no DNS leads from it to another."""
        if name in self.names:
            return True
        try:
            address = ipaddress.ip_address(name)
        except ValueError:
            return False
        return address.is_loopback or not self.local_only


_RAW = [(name.lower().encode(), value.encode()) for name, value in HEADERS.items()]


class BoundedConnection(H11Protocol):
    """A connection that ends when a request does not arrive, or its reply is not read, in time."""

    seconds = SECONDS
    most = _MOST

    def connection_made(self, transport: Any) -> None:
        """Begin to watch; beyond `most` the connection that is waited for longest makes room."""
        super().connection_made(transport)
        self._unread = 0
        self._since = time.monotonic()
        if len(self.connections) > self.most:
            others = [c for c in self.connections if isinstance(c, BoundedConnection) and c.waits and c is not self]
            if others:
                min(others, key=lambda c: c._since).transport.abort()
        self._watch = self.loop.call_later(self.seconds / 4, self._look)

    def send_400_response(self, msg: str) -> None:
        """Reply to bytes that are no HTTP and close; a request on which they follow gets no other reply."""
        if self.cycle is not None:
            self.cycle.disconnected = True
            self.cycle.message_event.set()
        try:
            super().send_400_response(msg)
        except LocalProtocolError:  # a reply has begun, or may have no body
            self.transport.close()

    def on_response_complete(self) -> None:
        """Wait for the next request from now on."""
        self._since = time.monotonic()
        super().on_response_complete()

    def connection_lost(self, exc: Exception | None) -> None:
        """End watching."""
        self._watch.cancel()
        super().connection_lost(exc)

    @property
    def waits(self) -> bool:
        """Whether the other side is to go on: with a request, or with reading the reply."""
        return self.cycle is None or self.cycle.response_complete or self.cycle.more_body

    def _look(self) -> None:
        unread, now = self.transport.get_write_buffer_size(), time.monotonic()
        if not self.waits or unread < self._unread:  # at work here, or there
            self._since = now
        self._unread = unread
        if now - self._since > self.seconds:
            self.transport.abort()
        else:
            self._watch = self.loop.call_later(self.seconds / 4, self._look)
