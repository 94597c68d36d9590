"""Serve a test with sounds of the fake renderer: FOLDER PORT [drive]; with `drive` the page takes the test itself."""

from __future__ import annotations

import sys
from pathlib import Path

import listening_fakes as fakes
import uvicorn
from starlette.requests import Request
from starlette.responses import Response

from tonewood.listening.definition import load_test
from tonewood.listening.http_guard import BoundedConnection
from tonewood.listening.on_demand import RenderedPairs
from tonewood.listening.server import ListeningServer

DRIVE = (Path(__file__).parent / "drive.js").read_text()


class DrivenServer(ListeningServer):
    async def _static(self, request: Request) -> Response:
        response = await super()._static(request)
        if request.path_params["name"] == "test.js":
            return Response(bytes(response.body) + DRIVE.encode(), media_type="text/javascript")
        return response


def main() -> None:
    folder, port, *drive = sys.argv[1:]
    test = load_test(Path(folder))
    kind = DrivenServer if drive else ListeningServer
    server = kind(test, RenderedPairs(test, fakes.fakes.FakeRenderer()))
    uvicorn.run(
        server.application(), host="127.0.0.1", port=int(port), log_level="warning", lifespan="off",
        http=BoundedConnection,
    )  # fmt: skip


if __name__ == "__main__":
    main()
