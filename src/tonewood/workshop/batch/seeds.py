"""Random numbers that depend only on their purpose.

Every random choice of a batch draws from its own generator, made from the manifest's seed and a few labels. So a
choice does not move when others are added, taken away or made in another order.
"""

from __future__ import annotations

import hashlib

import numpy as np

_LETTERS = "bcdfghjkmnpqrstvwxz"  # no vowels: no words; no digits: never read as a number


def generator(seed: int, *labels: object) -> np.random.Generator:
    """Generator for the choice named by `labels`.

    labels : purpose of the choice, e.g. ``("dither", "page_1", "harp.low")``; compared as text.
    """
    return np.random.Generator(np.random.PCG64(int.from_bytes(_digest(seed, labels)[:16], "big")))


def blind_codes(seed: int, names: list[str], *, length: int = 6) -> dict[str, str]:
    """One code of consonants per name, all different; a code tells nothing of name or order.

    names : the names to be hidden, all different.
    """
    codes: dict[str, str] = {}
    taken: set[str] = set()
    for name in names:
        attempt = 0
        while (code := _code(seed, name, attempt, length)) in taken:
            attempt += 1
        taken.add(code)
        codes[name] = code
    return codes


def _code(seed: int, name: str, attempt: int, length: int) -> str:
    number = int.from_bytes(_digest(seed, ("code", name, attempt)), "big")
    letters = []
    for _ in range(length):
        number, index = divmod(number, len(_LETTERS))
        letters.append(_LETTERS[index])
    return "".join(letters)


def _digest(seed: int, labels: tuple[object, ...]) -> bytes:
    return hashlib.sha256("\x1f".join([str(seed), *map(str, labels)]).encode()).digest()
