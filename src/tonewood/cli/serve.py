"""``tonewood serve``: a listening test in browsers."""

from __future__ import annotations

import ipaddress
import re
import socket
import sys
from contextlib import suppress
from pathlib import Path
from typing import Annotated

import typer

from tonewood.cli.common import AllowCode, allow, need
from tonewood.errors import TonewoodError


def serve(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="output folder of `tonewood batch`")],
    host: Annotated[
        str, typer.Option(help="address to listen at; 0.0.0.0 lets all computers of the network take part")
    ] = "127.0.0.1",
    port: Annotated[int, typer.Option(help="0 for any that is free")] = 8000,
    name: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME", help="another name by which browsers reach this computer; repeatable"),
    ] = None,
    allow_code: AllowCode = False,
) -> None:
    """Serve the test of DIR to listeners, until Ctrl-C; answers go to DIR/answers, one file a listener.

    Every answer is on the disk before its page goes on. After a crash run the same command again: listeners go on
    where they were. One server at a time serves a folder.
    """
    need("serve", "starlette", "uvicorn", "soundfile")
    import uvicorn

    from tonewood.support.folder_lock import locked
    from tonewood.workshop.batch.rendering import EngineRenderer
    from tonewood.workshop.listening.answer_file import clear_parts
    from tonewood.workshop.listening.definition import load_test
    from tonewood.workshop.listening.on_demand import RenderedPairs
    from tonewood.workshop.listening.server import ListeningServer, has_staircase
    from tonewood.workshop.web.guard import BoundedConnection

    allow("--port", port, 0, 65535, "")
    if not host.strip():  # would be all interfaces
        raise TonewoodError("is empty; an address or a name is allowed", key="--host")
    for one in name or ():
        if not _is_name(one):
            raise TonewoodError(
                f"is {one!r}; a name or an address alone is allowed, no https:// and no port", key="--name"
            )
    load_test(folder)  # its fault comes first
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    with locked(folder, "tonewood serve"), socket.socket(family, socket.SOCK_STREAM) as listening:
        test = load_test(folder)
        clear_parts(test)
        pairs = RenderedPairs(test, EngineRenderer(allow_code)) if has_staircase(test) else None
        for change in pairs.changes() if pairs else ():
            print(f"tonewood: {change}", file=sys.stderr, flush=True)
        application = ListeningServer(test, pairs).application(host, name or ())
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            listening.bind((host, port))
            listening.listen(128)  # who comes before the server is ready waits
        except OSError as fault:
            raise TonewoodError(f"{host}:{port} cannot be used: {fault.strerror}", key="--host, --port") from None
        for address in _names(host):
            print(f"http://{address}:{listening.getsockname()[1]}/", flush=True)
        config = uvicorn.Config(
            application, log_level="warning", lifespan="off", ws="none", http=BoundedConnection,
            server_header=False, timeout_graceful_shutdown=2,
        )  # fmt: skip
        try:
            with suppress(KeyboardInterrupt):  # the way to end a server, which may not pass it on
                uvicorn.Server(config).run(sockets=[listening])
            print(f"tonewood: the server has ended; answers are in {folder / 'answers'}", file=sys.stderr)
        finally:
            if pairs is not None:
                pairs.close()


def _is_name(text: str) -> bool:
    """Whether a text can be the name in an address; one that cannot would be refused at each request."""
    try:
        ipaddress.ip_address(text.strip("[]"))
    except ValueError:
        return re.fullmatch(r"[A-Za-z0-9_.-]+", text) is not None
    return True


def _names(host: str) -> list[str]:
    """Addresses to open: of all interfaces, this computer's own and that in its network."""
    if host not in ("0.0.0.0", "::"):
        return [f"[{host}]" if ":" in host else host]
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(("192.0.2.1", 9))  # sends nothing: asks which interface would be taken
            return ["127.0.0.1", str(probe.getsockname()[0])]
        except OSError:
            return ["127.0.0.1", socket.gethostname()]
