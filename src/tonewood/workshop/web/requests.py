"""Bodies of requests: JSON of a limited length and depth, and replies to those that are refused."""

from __future__ import annotations

import asyncio
import re
from importlib.resources import files
from typing import Any

from starlette.requests import ClientDisconnect, Request
from starlette.responses import JSONResponse, Response

from tonewood.errors import TonewoodError
from tonewood.support.text_files import json_value
from tonewood.workshop.web.guard import SECONDS

#: bytes of a request's body, and depth of its JSON
_MOST, _DEEPEST = 65536, 8
#: characters that no text needs: controls but for tab and line feed, halves of surrogate pairs
_NO_TEXT = re.compile("[\\x00-\\x08\\x0b-\\x1f\\x7f-\\x9f\\ud800-\\udfff]")


class RefusalError(Exception):
    """A request that is not read: status and reason."""

    def __init__(self, status: int, reason: str):
        super().__init__(reason)
        self.status, self.reason = status, reason


async def refuse(request: Request, fault: Exception) -> Response:
    """Reply to a request that is not read."""
    assert isinstance(fault, RefusalError)
    headers = {"Connection": "close"}  # of a body that was not read the rest would be taken for a request
    return JSONResponse({"error": fault.reason}, status_code=fault.status, headers=headers)


def one_line(fault: TonewoodError, status: int = 400) -> Response:
    """Reply with an error in one line, for the page to show; without paths of the server's disk."""
    return JSONResponse({"error": f"{fault.key}: {fault.reason}" if fault.key else fault.reason}, status)


def asset(package: str, name: str) -> bytes:
    """Return a file of a package's folder ``static``."""
    return (files(package) / "static" / name).read_bytes()


async def mistake(request: Request, fault: Exception) -> Response:
    """Reply to a request that a mistake of the program ended; the server prints the traceback."""
    return JSONResponse({"error": "the server made a mistake"}, status_code=500)


async def json_body(request: Request, error: type[TonewoodError] = TonewoodError) -> dict[str, Any]:
    """Return the body of a request as a mapping; characters that are no text are replaced.

    error : class of the error where it is no JSON object.
    Raises TonewoodError : it is no JSON object, or nested too deeply.
    Raises RefusalError : it is too long, too slow, or of another type.
    """
    kind = request.headers.get("content-type")
    if kind is not None and kind.partition(";")[0].strip().lower() != "application/json":
        raise RefusalError(415, "application/json is wanted")
    raw = bytearray()
    try:
        await asyncio.wait_for(_read(request, raw), SECONDS)
    except TimeoutError:
        raise RefusalError(408, f"the request took longer than {SECONDS:g} s") from None
    except ClientDisconnect:
        raise RefusalError(400, "the connection broke off") from None
    try:
        data = json_value(bytes(raw) or b"{}")
    except (ValueError, RecursionError):
        raise error("no JSON") from None
    if not isinstance(data, dict):
        raise error("no JSON object")
    return {str(key): value for key, value in _plain(data, error).items()}


async def _read(request: Request, raw: bytearray) -> None:
    async for part in request.stream():
        raw += part
        if len(raw) > _MOST:
            raise RefusalError(400, f"longer than the {_MOST} bytes allowed")


def _plain(value: Any, error: type[TonewoodError], depth: int = 0) -> Any:
    """The same values with texts that can be written as UTF-8 and shown."""
    if depth > _DEEPEST:
        raise error(f"nested more than {_DEEPEST} deep")
    if isinstance(value, str):
        return _NO_TEXT.sub("\N{REPLACEMENT CHARACTER}", value.replace("\r\n", "\n").replace("\r", "\n"))
    if isinstance(value, dict):
        return {_plain(key, error): _plain(item, error, depth + 1) for key, item in value.items()}
    if isinstance(value, list):
        return [_plain(item, error, depth + 1) for item in value]
    return value
