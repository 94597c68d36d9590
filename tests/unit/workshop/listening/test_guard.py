"""Requests that are refused, replies that tell nothing, and memory that stays bounded."""

from __future__ import annotations

import http.client
import itertools
import json
import os
import socket
import subprocess
import sys
import time
import urllib.request
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import listening_fakes as fakes
import numpy as np
import pytest
import soundfile
from listening_fakes import request

from tonewood.errors import OutputError, TonewoodError
from tonewood.workshop.batch.manifest import ManifestError
from tonewood.workshop.listening import definition
from tonewood.workshop.listening import server as server_module
from tonewood.workshop.listening.answer_file import answers_of
from tonewood.workshop.listening.definition import ListeningError, ListeningTest
from tonewood.workshop.listening.headphones import interval
from tonewood.workshop.listening.level_tone import tone
from tonewood.workshop.listening.on_demand import RenderedPairs
from tonewood.workshop.listening.server import ListeningServer
from tonewood.workshop.web import requests
from tonewood.workshop.web.guard import Guard

PAGES = [{"type": "consent"}, {"type": "mushra", "reference": {"damping": "complex"}, "group_by": ["pluck"]}]


@pytest.fixture(scope="module")
def test(tmp_path_factory: pytest.TempPathFactory) -> ListeningTest:
    return fakes.made(tmp_path_factory.mktemp("guard"), PAGES)


def begun(application: Any, **asked: Any) -> str:
    status, _, raw = request(application, "POST", "/api/session", json.dumps(asked).encode())
    assert status == 201, raw
    return f"/api/session/{json.loads(raw)['token']}"


@pytest.mark.parametrize(
    ("host", "headers", "status"),
    [
        ("127.0.0.1", {"Host": "localhost"}, None),
        ("127.0.0.1", {"Host": "LocalHost.:8000"}, None),
        ("127.0.0.1", {"Host": "127.0.0.1:1"}, None),
        ("127.0.0.1", {"Host": "[::1]:8000"}, None),
        ("::1", {"Host": "[::1]"}, None),
        ("127.0.0.1", {"Host": "evil.example"}, 421),
        ("127.0.0.1", {"Host": "127.0.0.1.evil.example"}, 421),
        ("127.0.0.1", {"Host": "127.0.0.1@evil.example"}, 421),
        ("127.0.0.1", {"Host": "evil.example:8000"}, 421),
        ("127.0.0.1", {"Host": "0.0.0.0:8000"}, 421),
        ("127.0.0.1", {"Host": "192.168.1.2"}, 421),
        ("127.0.0.1", {"Host": ""}, 421),
        ("127.0.0.1", {"Host": "localhost/"}, 421),
        ("0.0.0.0", {"Host": "192.168.1.2:8000"}, None),
        ("0.0.0.0", {"Host": "[fe80::1]:8000"}, None),
        ("0.0.0.0", {"Host": socket.gethostname()}, None),
        ("0.0.0.0", {"Host": "evil.example"}, 421),
        ("0.0.0.0", {"Host": "Test.Example"}, None),
        ("127.0.0.1", {"Host": "localhost:8000", "Origin": "http://localhost:8000"}, None),
        ("127.0.0.1", {"Host": "localhost", "Origin": "http://localhost"}, None),
        ("127.0.0.1", {"Host": "[::1]:8000", "Origin": "http://[::1]:8000"}, None),
        ("127.0.0.1", {"Host": "test.example", "Origin": "https://test.example"}, None),
        ("127.0.0.1", {"Host": "localhost:8000", "Origin": "http://localhost:8001"}, 403),
        ("127.0.0.1", {"Host": "localhost:8000", "Origin": "http://127.0.0.1:8000"}, 403),
        ("127.0.0.1", {"Host": "localhost:8000", "Origin": "http://localhost"}, 403),
        ("127.0.0.1", {"Host": "localhost:8000", "Origin": "null"}, 403),
        ("127.0.0.1", {"Host": "localhost:8000", "Origin": "http://evil.example"}, 403),
        ("127.0.0.1", {"Host": "localhost:8000", "Origin": "file://"}, 403),
    ],
)
def test_host_and_origin_are_those_of_the_server(host: str, headers: dict[str, str], status: int | None) -> None:
    guard = Guard(None, host, ["test.example"])
    found = guard.fault([(k.lower().encode(), v.encode()) for k, v in headers.items() if v])
    assert (found and found[0]) == status


def test_an_address_in_the_network_is_the_server_s_where_it_listens_there() -> None:
    host = [(b"host", b"192.168.1.5:8000")]
    assert Guard(None, "0.0.0.0").fault(host) is None
    assert Guard(None, "127.0.0.1").fault(host)[0] == 421
    assert Guard(None, "127.0.0.1").fault([(b"host", b"127.0.0.9:8000")]) is None
    assert Guard(None, "127.0.0.1").fault([])[0] == 421
    ports = [(b"host", b"localhost:443"), (b"origin", b"https://localhost")]
    assert Guard(None, "127.0.0.1").fault(ports) is None
    assert Guard(None, "127.0.0.1").fault([(b"host", b"localhost:443"), (b"origin", b"http://localhost")])[0] == 403


def test_texts_that_were_sent_are_plain() -> None:
    """Lines end in one way, keys are texts like values, and eight levels are deep enough."""
    found = requests._plain({"a\r\nb": ["c\rd\n", "\ud800", 1.5, True, None]}, TonewoodError)
    assert found == {"a\nb": ["c\nd\n", "\N{REPLACEMENT CHARACTER}", 1.5, True, None]}
    for kind in (lambda x: [x], lambda x: {"a": x}):
        value = 1
        for _ in range(8):
            value = kind(value)
        assert requests._plain(value, TonewoodError) == value
        with pytest.raises(TonewoodError, match="nested more than 8 deep"):
            requests._plain(kind(value), TonewoodError)


def test_two_hosts_are_one_too_many(test: ListeningTest) -> None:
    guard = Guard(None)
    assert guard.fault([(b"host", b"localhost"), (b"host", b"localhost")])[0] == 421
    assert guard.fault([(b"host", b"localhost"), (b"origin", b"http://localhost"), (b"origin", b"null")])[0] == 403
    status, headers, _ = request(ListeningServer(test).application(), "GET", "/", headers={"Host": "evil.example"})
    assert status == 421
    assert headers["x-content-type-options"] == "nosniff"


def test_json_alone_is_read(test: ListeningTest) -> None:
    application = ListeningServer(test).application()
    base = begun(application)
    body = json.dumps({"index": 0, "agreed": True}).encode()
    for kind in ("text/plain", "application/x-www-form-urlencoded", "multipart/form-data", "application/jsonp"):
        assert request(application, "POST", base, body, {"Content-Type": kind})[0] == 415
    assert request(application, "POST", base, body[:-1] + b', "index": 1}')[0] == 400  # two values of one key
    assert json.loads(request(application, "GET", base)[2])["index"] == 0
    assert request(application, "POST", base, body, {"Content-Type": "Application/JSON; charset=utf-8"})[0] == 200


NESTED = b'{"index": 1, "ratings": ' + b'{"A": ' * 30 + b"1" + b"}" * 31


@pytest.mark.parametrize(
    "body",
    [
        b"\xff", b"{", b"null", b"[]", b'"x"', b"{}", b'{"index": true}', b'{"index": 1.0}', b'{"index": -1}',
        b'{"index": 2}', b'{"index": "1"}', b'{"index": 1}', b'{"index": 1, "ratings": {"A": NaN}}', NESTED,
        b'{"index": 1, "seconds": 1e999}', b'{"index": 1, "seconds": ' + b"9" * 400 + b"}",
        b'{"index": 1, "seconds": ' + b"9" * 5000 + b"}", b'{"index": 1, "plays": {"A": ' + b"9" * 400 + b"}}",
        b'{"index": 1, "comment": ["\\ud800"]}', b'{"index": 1, "\\ud800": 1, "ratings": "\\ud800"}',
        b'{"index": 1, "ratings": {"A": "\\udfff"}}', b"[" * 60_000, b" " * 70_000,
    ],
)  # fmt: skip
def test_bodies_that_fit_nothing_are_one_line_and_move_nothing(test: ListeningTest, body: bytes) -> None:
    application = ListeningServer(test).application()
    base = begun(application)
    assert request(application, "POST", base, b'{"index": 0, "agreed": true}')[0] == 200
    status, _, raw = request(application, "POST", base, body)
    assert status == 400
    assert len(json.loads(raw)["error"]) < 1000
    assert json.loads(request(application, "GET", base)[2])["index"] == 1


def rated(application: Any, base: str, **more: Any) -> dict[str, Any]:
    step = json.loads(request(application, "GET", base)[2])
    slots = [slot for slot in step["slots"] if slot != step["open"]]
    return {"index": step["index"], "ratings": dict.fromkeys(slots, 50), **more}


def test_half_a_surrogate_pair_is_replaced_and_the_answer_is_on_the_disk(test: ListeningTest) -> None:
    """Half a pair in a name or a comment: the answer is confirmed once, written once, and read by the analysis."""
    application = ListeningServer(test).application()
    base = begun(application, listener="a\ud800b\x00\x1b[1m", language="\udfff")
    assert request(application, "POST", base, b'{"index": 0, "agreed": true}')[0] == 200
    text = json.dumps(rated(application, base, comment="x\ud83dy\x00\U0001f600")).encode()
    for _ in range(2):  # and again, as the page does when it gets no reply
        assert request(application, "POST", base, text)[0] == 200
    (one,) = [a for a in answers_of(test).listeners if a.header["token"] in base]
    assert [r["index"] for r in one.records] == [0, 1]
    assert one.records[1]["answer"]["comment"] == "x\ufffdy\ufffd\U0001f600"
    assert one.listener == "a\ufffdb\ufffd\ufffd[1m"
    assert answers_of(test).left_out == ()


def test_another_answer_to_an_earlier_page_is_refused_in_words(test: ListeningTest) -> None:
    """Two windows show one page: the second answer is not confirmed, because it is not on the disk."""
    application = ListeningServer(test).application()
    base = begun(application)
    request(application, "POST", base, b'{"index": 0, "agreed": true}')
    first, second = (rated(application, base, seconds=s) for s in (1.0, 2.0))
    assert request(application, "POST", base, json.dumps(first).encode())[0] == 200
    status, _, raw = request(application, "POST", base, json.dumps(second).encode())
    assert (status, json.loads(raw)["step"]["index"]) == (409, 2)
    assert request(application, "POST", base, json.dumps(first).encode())[0] == 200
    (one,) = [a for a in answers_of(test).listeners if a.header["token"] in base]
    assert [r["answer"].get("seconds") for r in one.records] == [0.0, 1.0]


def test_a_failure_of_the_disk_is_printed_and_the_page_sends_again(
    test: ListeningTest, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    application = ListeningServer(test).application()
    base = begun(application)
    fsync = os.fsync

    def broken(handle: int) -> None:
        raise OSError(5, "Input/output error")

    monkeypatch.setattr(os, "fsync", broken)
    monkeypatch.setattr(os, "ftruncate", lambda handle, length: broken(handle))
    answer = b'{"index": 0, "agreed": true}'
    for _ in range(3):  # the line is in the file, but not confirmed by the disk
        assert request(application, "POST", base, answer)[0] == 500
    assert "Input/output error" in capsys.readouterr().err
    monkeypatch.undo()
    assert os.fsync is fsync
    status, _, raw = request(application, "POST", base, answer)
    assert (status, json.loads(raw)["step"]["index"]) == (200, 1)
    (one,) = [a for a in answers_of(test).listeners if a.header["token"] in base]
    assert [r["index"] for r in one.records] == [0]


def test_replies_do_not_tell_that_two_slots_have_one_sound(test: ListeningTest) -> None:
    application = ListeningServer(test).application()
    base = begun(application)
    request(application, "POST", base, b'{"index": 0, "agreed": true}')
    step = json.loads(request(application, "GET", base)[2])
    asked = {"Range": "bytes=0-9", "If-None-Match": "*", "If-Modified-Since": "Thu, 01 Jan 2099 00:00:00 GMT"}
    for more in ({}, asked):
        replies = [request(application, "GET", f"{base}/sound/1/{s}", headers=more) for s in step["slots"]]
        assert {status for status, _, _ in replies} == {200}
        assert len({tuple(sorted(headers.items())) for _, headers, _ in replies}) == 1
        assert not {"etag", "last-modified", "accept-ranges", "expires"} & set(replies[0][1])
        assert {len(sound) for _, _, sound in replies} == {int(replies[0][1]["content-length"])}


def test_sessions_and_unknown_tokens_are_bounded(test: ListeningTest, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(server_module, "_MOST_OPEN", 5)
    server = ListeningServer(test)
    application = server.application()
    for k in range(50):
        assert request(application, "GET", f"/api/session/{k:032x}")[0] == 404
        assert request(application, "POST", f"/api/session/{'x' * k}", b'{"index": 0}')[0] in (404, 405, 307)
    assert not server._entries
    places = [begun(application) for _ in range(12)]
    assert len(server._entries) == 5
    for base in places:  # those that are no longer in memory go on from the disk
        assert request(application, "POST", base, b'{"index": 0, "agreed": true}')[0] == 200
        assert len(server._entries) <= 5
    monkeypatch.setattr(server_module, "_MOST_SESSIONS", server._begun + 1)
    begun(application)
    status, _, raw = request(application, "POST", "/api/session", b"{}")
    assert (status, b"no more are allowed" in raw) == (429, True)
    assert ListeningServer(test)._begun == server._begun  # a restart begins no new count


def test_a_sound_that_cannot_be_made_is_printed_and_asked_for_once(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    test = fakes.made(tmp_path, [fakes.STAIRS])
    for fault in (TonewoodError("this level cannot be made"), ZeroDivisionError("of a plugin")):

        class Failing(fakes.fakes.FakeRenderer):
            def render(self, condition: Any, fault: Exception = fault) -> Any:
                raise fault

        for old in (test.folder / "work").glob("*.npz"):
            old.unlink()
        application = ListeningServer(test, RenderedPairs(test, Failing())).application()
        base = begun(application)
        for _ in range(2):
            status, _, raw = request(application, "GET", f"{base}/sound/0/1")
            assert (status, json.loads(raw)["error"]) == (422, "a sound of this page cannot be made")
        assert capsys.readouterr().err.count(str(fault)) == 1


def test_a_full_disk_does_not_stop_a_staircase(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    test = fakes.made(tmp_path, [fakes.STAIRS])
    for old in (test.folder / "work").glob("*.npz"):
        old.unlink()
    pairs = RenderedPairs(test, fakes.fakes.FakeRenderer())
    whole = pairs.pair(0, 4.0)

    def full(*args: object) -> None:
        raise OutputError("cannot be written: No space left on device")

    for old in (test.folder / "work").glob("*.npz"):
        old.unlink()
    other = RenderedPairs(test, fakes.fakes.FakeRenderer())
    monkeypatch.setattr(other._store, "save", full)
    assert other.pair(0, 4.0) == whole


def test_damage_is_said_to_the_listener_and_to_the_experimenter(
    test: ListeningTest, capsys: pytest.CaptureFixture[str]
) -> None:
    application = ListeningServer(test).application()
    base = begun(application)
    request(application, "POST", base, b'{"index": 0, "agreed": true}')
    path = test.folder / "answers" / f"{base.rpartition('/')[2]}.jsonl"
    path.write_bytes(path.read_bytes() + b"garbage\n")
    application = ListeningServer(test).application()
    assert request(application, "GET", base)[0] == 410
    assert f"{path}: line 3: not JSON" in capsys.readouterr().err
    path.unlink()
    assert request(application, "GET", base)[0] == 404


@pytest.mark.slow
def test_two_servers_do_not_share_a_folder(test: ListeningTest, tmp_path: Path) -> None:
    (tmp_path / "link").symlink_to(test.folder)
    command = [sys.executable, "-m", "tonewood", "serve", "--port", "0"]
    first = subprocess.Popen([*command, str(test.folder)], stdout=subprocess.PIPE, text=True)
    try:
        assert first.stdout is not None
        assert first.stdout.readline().startswith("http://127.0.0.1:")
        second = subprocess.run([*command, str(tmp_path / "link")], capture_output=True, text=True, timeout=60)
        assert second.returncode == 2
        assert f"is in use by tonewood serve, process {first.pid}: stop it first" in second.stderr
        assert second.stderr.count("\n") == 1
    finally:
        first.kill()
        first.wait()
    third = subprocess.Popen([*command, str(test.folder)], stdout=subprocess.PIPE, text=True)
    try:
        assert third.stdout is not None
        assert third.stdout.readline().startswith("http://127.0.0.1:")
    finally:
        third.kill()
        third.wait()


@pytest.mark.slow
def test_connections_that_wait_for_ever_are_closed(test: ListeningTest) -> None:
    host = b"Host: localhost\r\n"
    kinds = [
        b"", b"POST /api/session HTTP/1.1\r\n" + host,
        b"POST /api/session HTTP/1.1\r\n" + host + b"Content-Length: 60000\r\n\r\n{",
        b"POST /api/session HTTP/1.1\r\nHost: x\r\nContent-Length: 60000\r\n\r\n{",
        b"GET /api/test HTTP/1.1\r\n" + host + b"\r\nGET /api/",
    ]  # fmt: skip
    command = [sys.executable, str(Path(__file__).parent / "serve_in_process.py"), str(test.folder), "0"]
    environment = os.environ | {
        "PYTHONPATH": os.pathsep.join([str(Path(__file__).parent), *sys.path]), "SECONDS": "0.5", "CONNECTIONS": "20"
    }  # fmt: skip
    process = subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        port = int(process.stdout.readline())
        sockets = []
        for kind in kinds:
            sockets.append(socket.create_connection(("127.0.0.1", port), timeout=60))
            sockets[-1].sendall(kind)
        for one in sockets:
            try:
                while one.recv(65536):
                    pass
            except ConnectionResetError:
                pass
        # more at a time than are allowed: the oldest make room for the next
        many = [socket.create_connection(("127.0.0.1", port), timeout=60) for _ in range(100)]
        with socket.create_connection(("127.0.0.1", port), timeout=60) as one:
            one.sendall(b"GET /api/test HTTP/1.1\r\n" + host + b"Connection: close\r\n\r\n")
            assert one.recv(15) == b"HTTP/1.1 200 OK"
        for one in (*many, *sockets):
            one.close()
    finally:
        process.kill()
        process.wait()


@pytest.mark.slow
def test_bytes_that_are_no_http_end_their_connection_only(test: ListeningTest) -> None:
    """Also after a request whose reply has no body, or is not sent yet."""
    tails = [
        b"Transfer-Encoding: chunked\r\n\r\n" + b"[" * 40000, b"Transfer-Encoding: chunked\r\n\r\nzz\r\n",
        b"Content-Length: 2\r\n\r\n{}\0garbage\r\n\r\n",
    ]  # fmt: skip
    command = [sys.executable, str(Path(__file__).parent / "serve_in_process.py"), str(test.folder), "0"]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(Path(__file__).parent), *sys.path])}
    pipes: Any = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    process = subprocess.Popen(command, env=environment, **pipes)
    try:
        assert process.stdout is not None
        port = int(process.stdout.readline())
        for method, host, tail in itertools.product((b"HEAD", b"POST"), (b"localhost", b"other.example"), tails):
            with socket.create_connection(("127.0.0.1", port), timeout=60) as one, suppress(ConnectionResetError):
                one.sendall(method + b" /api/session HTTP/1.1\r\nHost: " + host + b"\r\n" + tail)
                while one.recv(65536):
                    pass
        with urllib.request.urlopen(f"http://127.0.0.1:{port}/api/test", timeout=60) as reply:
            assert reply.status == 200
    finally:
        process.kill()
        errors = process.communicate()[1]
    assert set(errors.splitlines()) == {"WARNING:  Invalid HTTP request received."}


@pytest.mark.slow
def test_a_connection_that_is_used_is_not_closed(test: ListeningTest) -> None:
    """Requests with pauses shorter than the limit, for longer than the limit."""
    command = [sys.executable, str(Path(__file__).parent / "serve_in_process.py"), str(test.folder), "0"]
    environment = os.environ | {
        "PYTHONPATH": os.pathsep.join([str(Path(__file__).parent), *sys.path]), "SECONDS": "2", "CONNECTIONS": "20"
    }  # fmt: skip
    process = subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        connection = http.client.HTTPConnection("127.0.0.1", int(process.stdout.readline()), timeout=60)
        connection.connect()
        used = connection.sock
        for _ in range(12):
            connection.request("GET", "/static/test.css")
            assert connection.getresponse().read()
            time.sleep(0.3)
        assert connection.sock is used
        connection.close()
    finally:
        process.kill()
        process.wait()


def test_the_number_of_a_step_has_any_number_of_digits(test: ListeningTest) -> None:
    application = ListeningServer(test).application()
    session = begun(application)
    for index in ("9" * 5000, "00", "-0", "x", "\u0660"):
        assert request(application, "GET", f"{session}/sound/{index}/A")[0] == 404


def test_levels_that_differ_in_their_thirteenth_decimal_have_sounds_of_their_own(tmp_path: Path) -> None:
    stairs = fakes.STAIRS | {"start": 4e-13, "lowest": 1e-13, "highest": 1e-12}
    pairs = RenderedPairs(fakes.made(tmp_path, [stairs]), fakes.fakes.FakeRenderer())
    try:
        first, second, third = (pairs.pair(0, level) for level in (4e-13, 3e-13, 4e-13))
        assert first is third
        assert first is not second
    finally:
        pairs.close()


def test_a_staircase_is_not_served_with_other_sounds_than_its_batch(tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    room = tmp_path / "in" / "room.wav"
    soundfile.write(room, np.array([1.0, 0.5]), 48000)
    test = fakes.made(tmp_path, [fakes.STAIRS], stimuli={"room": "room.wav"})
    pairs = RenderedPairs(test, fakes.fakes.FakeRenderer())
    assert pairs.changes() == []
    pairs.close()
    pairs = RenderedPairs(test, fakes.fakes.FakeRenderer(version="2"))
    (line,) = pairs.changes()
    assert line.startswith("page 1: its sound of the batch is not in ")
    pairs.close()
    soundfile.write(room, np.array([1.0, -0.5]), 48000)
    with pytest.raises(ListeningError, match=r"room\.wav: was changed after `tonewood batch`"):
        RenderedPairs(test, fakes.fakes.FakeRenderer())
    room.unlink()
    with pytest.raises(ManifestError, match=r"room\.wav: stimuli\.room: cannot be read"):
        RenderedPairs(test, fakes.fakes.FakeRenderer())


def test_languages_are_not_read_once_for_each_wish(test: ListeningTest, monkeypatch: pytest.MonkeyPatch) -> None:
    """A body of 60 000 bytes can hold 30 000 wishes; while they are read nobody else is served."""
    calls = 0
    read = definition.built_in_texts

    def counted() -> dict[str, dict[str, str]]:
        nonlocal calls
        calls += 1
        return read()

    monkeypatch.setattr(definition, "built_in_texts", counted)
    application = ListeningServer(replace(test)).application()
    session = begun(application, language="x," * 2000 + "de")
    assert json.loads(request(application, "GET", session)[2])["type"] == "consent"
    assert calls < 10


class Noted:
    """Sounds that are named after their page and level; notes what is wanted."""

    def __init__(self) -> None:
        self.wanted: list[Any] = []

    def pair(self, page: int, level: float) -> dict[str, bytes]:
        self.wanted.append((page, level))
        return {"standard": b"standard", "changed": f"page {page} at {level}".encode()}

    def expect(self, page: int, level: float) -> None:
        self.wanted.append(("ahead", page, level))


def test_levels_after_either_answer_are_made_ahead_but_not_in_training(tmp_path: Path) -> None:
    """From 4, a right answer halves the level and a wrong one doubles it; the training stays at 4."""
    stairs = fakes.STAIRS | {"start": 4.0, "down": 1, "steps": [2.0], "highest": 40.0, "feedback": False}
    pairs = Noted()
    server = ListeningServer(fakes.made(tmp_path, [{"type": "training", "page": 2, "trials": 2}, stairs]), pairs)
    application = server.application()
    base = begun(application)
    for index, (level, right) in enumerate([(4.0, True), (4.0, False), (4.0, True), (2.0, False), (4.0, True)]):
        pairs.wanted.clear()
        sounds = {slot: request(application, "GET", f"{base}/sound/{index}/{slot}") for slot in "123"}
        ((odd, (status, headers, raw)),) = [(s, x) for s, x in sounds.items() if x[2] != b"standard"]
        assert (status, headers["content-type"], raw) == (200, "audio/wav", f"page 1 at {level}".encode())
        ahead = [("ahead", 1, level / 2), ("ahead", 1, 2 * level)] if index > 1 else []
        assert pairs.wanted == [(1, level), *ahead] * 3
        choice = odd if right else next(s for s in "123" if s != odd)
        body = json.dumps({"index": index, "choice": choice}).encode()
        reply = json.loads(request(application, "POST", base, body)[2])
        assert reply["feedback"] == ({"right": right, "correct": odd} if index < 2 else None)
        assert reply["step"]["index"] == index + 1


def test_a_session_has_the_language_and_the_name_that_were_asked_for(test: ListeningTest) -> None:
    application = ListeningServer(test).application()
    base = begun(application, listener="N", language="xx,de-CH")
    (one,) = [a for a in answers_of(test).listeners if a.header["token"] in base]
    assert (one.header["listener"], one.header["language"]) == ("N", "de")
    assert json.loads(request(application, "GET", base)[2])["title"] == "Einwilligung"
    about = json.loads(request(application, "GET", "/api/test")[2])
    assert (about["test"], about["title"], about["language"]) == (test.sha256[:16], test.title("en"), "en")
    assert about["texts"] == test.texts("en")
    given = json.loads(request(application, "GET", f"{base}/data")[2])
    assert given["listener"] == "N"
    status, _, raw = request(application, "POST", "/api/session", b'{"listener": 7}')
    assert (status, json.loads(raw)["error"]) == (400, "listener: is no text")


def test_a_session_that_could_not_begin_does_not_count(test: ListeningTest, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*given: Any, **named: Any) -> None:
        raise OutputError("cannot be written")

    server = ListeningServer(test)
    application, before = server.application(), server._begun
    base = begun(application)
    assert server._begun == before + 1
    assert request(application, "DELETE", base)[0] == 200
    assert request(application, "DELETE", base)[0] == 404
    assert server._begun == before
    monkeypatch.setattr(server_module, "begin", full)
    assert request(application, "POST", "/api/session", b"{}")[0] == 500
    assert server._begun == before


def test_sounds_of_checks_and_levels_are_made_here(tmp_path: Path) -> None:
    test = fakes.made(tmp_path, [{"type": "level"}, {"type": "headphones"}, PAGES[1]])
    server = ListeningServer(test)
    application = server.application()
    base = begun(application)
    tones = request(application, "GET", f"{base}/sound/0/tone")
    assert (tones[0], tones[2]) == (200, tone(test, test.pages[0]))
    assert request(application, "GET", f"{base}/sound/0/1")[0] == 404
    assert request(application, "POST", base, b'{"index": 0}')[0] == 200
    session = server._entries[base.rpartition("/")[2]].opened.session
    noises = [request(application, "GET", f"{base}/sound/1/{slot}")[2] for slot in "123"]
    assert noises == [interval(test, test.pages[1], session, slot) for slot in "123"]
    answer = {"index": 1, "choice": "1", "plays": dict.fromkeys("123", 1)}
    reply = json.loads(request(application, "POST", base, json.dumps(answer).encode())[2])
    assert (reply["feedback"], reply["step"]["index"]) == (None, 2)  # a check does not say which answer is right
    assert len(set(noises)) > 1
    assert request(application, "GET", f"{base}/sound/1/tone")[0] == 404


def test_who_gave_no_name_goes_back_with_the_beginning_of_the_token(tmp_path: Path) -> None:
    back = {"code": "C-{id}", "address": "https://crowd.example/?c={code}&p={listener}"}
    server = ListeningServer(fakes.made(tmp_path, [*PAGES, {"type": "finish", "back": back}]))
    application = server.application()
    for name in ("", "N O"):
        base = begun(application, listener=name)
        token = base.rpartition("/")[2]
        session = server._entries[token].opened.session
        while session.step is not None:
            session.pass_over()
        view = json.loads(request(application, "GET", base)[2])
        listener = "N%20O" if name else token[:8]
        assert (view["code"], view["address"]) == (
            f"C-{token[:8]}", f"https://crowd.example/?c=C-{token[:8]}&p={listener}"
        )  # fmt: skip
