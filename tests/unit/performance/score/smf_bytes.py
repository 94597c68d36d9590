"""Standard MIDI Files put together byte by byte, so that each part can be wrong on purpose."""

from __future__ import annotations


def vlq(value: int) -> bytes:
    out = [value & 0x7F]
    while value := value >> 7:
        out.append(value & 0x7F | 0x80)
    return bytes(reversed(out))


def event(delta: int, *message: int) -> bytes:
    return vlq(delta) + bytes(message)


def meta(delta: int, kind: int, payload: bytes = b"", length: int | None = None) -> bytes:
    return vlq(delta) + bytes([0xFF, kind]) + vlq(len(payload) if length is None else length) + payload


def tempo(delta: int, microseconds: int) -> bytes:
    return meta(delta, 0x51, microseconds.to_bytes(3, "big"))


END = meta(0, 0x2F)
ONE_NOTE = event(0, 0x90, 60, 80) + event(480, 0x80, 60, 64)


def chunk(name: bytes, body: bytes, length: int | None = None) -> bytes:
    return name + (len(body) if length is None else length).to_bytes(4, "big") + body


def header(form: int = 0, tracks: int = 1, division: int = 480, extra: bytes = b"") -> bytes:
    numbers = b"".join(n.to_bytes(2, "big") for n in (form, tracks, division))
    return chunk(b"MThd", numbers + extra)


def smf(*bodies: bytes, form: int | None = None, division: int = 480, end: bytes = END) -> bytes:
    form = (0 if len(bodies) == 1 else 1) if form is None else form
    return header(form, len(bodies), division) + b"".join(chunk(b"MTrk", body + end) for body in bodies)
