"""Serve a test with sounds of the fake renderer: FOLDER PORT [SCRIPT].

With a script (drive, listeners, blocked, stopped) the page runs it; its requests for /static/said-WORDS are kept in
``said``. With `stopped` no sound of a staircase can be made.
"""

from __future__ import annotations

import os
import socket
import sys
from pathlib import Path
from typing import Any

import listening_fakes as fakes
import uvicorn
from starlette.requests import Request
from starlette.responses import Response

from tonewood.errors import TonewoodError
from tonewood.workshop.batch.conditions import Condition
from tonewood.workshop.listening import server as server_module
from tonewood.workshop.listening.definition import load_test
from tonewood.workshop.listening.on_demand import RenderedPairs
from tonewood.workshop.listening.server import ListeningServer
from tonewood.workshop.web.guard import BoundedConnection


class DrivenServer(ListeningServer):
    script = ""

    async def _static(self, request: Request) -> Response:
        name = request.path_params["name"]
        if name.startswith("said-"):
            with (self.test.folder / "said").open("a") as stream:
                stream.write(name[5:] + "\n")
        response = await super()._static(request)
        if name == "test.js":
            return Response(bytes(response.body) + self.script.encode(), media_type="text/javascript")
        return response


class Failing(fakes.fakes.FakeRenderer):
    def identity(self, condition: Condition) -> dict[str, Any]:
        raise TonewoodError("this level cannot be made")


class Connection(BoundedConnection):
    seconds = float(os.environ.get("SECONDS", BoundedConnection.seconds))
    most = int(os.environ.get("CONNECTIONS", BoundedConnection.most))


def main() -> None:
    folder, port, *drive = sys.argv[1:]
    server_module.SECONDS = Connection.seconds
    test = load_test(Path(folder))
    kind = DrivenServer if drive else ListeningServer
    DrivenServer.script = (Path(__file__).parent / f"{drive[0]}.js").read_text() if drive else ""
    renderer = Failing() if drive == ["stopped"] else fakes.fakes.FakeRenderer()
    server = kind(test, RenderedPairs(test, renderer))
    with socket.socket() as listening:
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listening.bind(("127.0.0.1", int(port)))
        listening.listen(128)
        print(listening.getsockname()[1], flush=True)
        config = uvicorn.Config(server.application(), log_level="warning", lifespan="off", http=Connection)
        uvicorn.Server(config).run(sockets=[listening])


if __name__ == "__main__":
    main()
