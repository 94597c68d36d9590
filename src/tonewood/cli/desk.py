"""``tonewood desk``: an instrument in a browser, turned and heard."""

from __future__ import annotations

import socket
from pathlib import Path
from types import FrameType
from typing import Annotated

import typer

from tonewood.cli.common import AllowCode, BundleName, Overrides, StringSetName, allow, need
from tonewood.errors import TonewoodError


def desk(
    instrument: BundleName,
    phrase: Annotated[
        Path | None, typer.Option(help="score that is played: MIDI, MusicXML or Guitar Pro, its first minute")
    ] = None,
    port: Annotated[int, typer.Option(help="0 for any that is free")] = 8137,
    fs: Annotated[int, typer.Option(help="sampling rate, Hz")] = 48000,
    folder: Annotated[
        Path | None, typer.Option(help="for the phrase's MIDI file that `copy command` names; else a temporary folder")
    ] = None,
    strings: StringSetName = None,
    settings: Overrides = None,
    allow_code: AllowCode = False,
) -> None:
    """Open INSTRUMENT on a page of this computer: turn its parameters, hear and see them, until Ctrl-C.

    The page is reached from this computer alone, at an address with a token. Everything that it changes can be saved
    as a bundle, or copied as a command.
    """
    need("serve", "starlette", "uvicorn")
    import uvicorn

    from tonewood.instrument.bundle.overrides import parse_assignment
    from tonewood.workshop.desk.desk import Desk
    from tonewood.workshop.desk.server import DeskServer
    from tonewood.workshop.desk.session import DeskSession
    from tonewood.workshop.web.guard import BoundedConnection

    allow("--port", port, 0, 65535, "")
    allow("--fs", fs, 8000, 192000, "Hz")
    if folder is not None and not folder.is_dir():
        raise TonewoodError(f"there is no folder {folder}", key="--folder")
    changes = {} if strings is None else {"strings_from": strings}
    session = DeskSession(instrument, changes | dict(map(parse_assignment, settings or [])), allow_code=allow_code)
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as listening:
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            listening.bind(("127.0.0.1", port))
            listening.listen(128)
        except OSError as fault:
            raise TonewoodError(f"port {port} cannot be used: {fault.strerror}", key="--port") from None
        opened = Desk(session, score=phrase, fs=fs, folder=folder)
        served = DeskServer(opened)
        print(f"http://127.0.0.1:{listening.getsockname()[1]}/#{served.token}", flush=True)
        config = uvicorn.Config(
            served.application(), log_level="warning", lifespan="off", ws="none", http=BoundedConnection,
            server_header=False, timeout_graceful_shutdown=1,
        )  # fmt: skip

        class Ending(uvicorn.Server):
            """A server that ends its stream first, when a signal asks it to end."""

            def handle_exit(self, sig: int, frame: FrameType | None) -> None:
                served.closing = True
                super().handle_exit(sig, frame)

        try:
            Ending(config).run(sockets=[listening])
        finally:
            served.closing = True
            opened.close()
