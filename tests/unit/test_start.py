"""A start: modules that are not imported up to the first block, and tunings that are kept between runs."""

from __future__ import annotations

import gc
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import scipy.linalg as sla

import tonewood as tw
from tonewood.errors import DamagedCacheWarning
from tonewood.instrument.model.assembly import assemble
from tonewood.physics.coupling.compiled import _pivots
from tonewood.support.cache_folder import keep
from tonewood.support.garbage import without_collecting

FIRST_BLOCK = """
import gc, hashlib, json, sys
import tonewood as tw
guitar = tw.load_instrument("classical_guitar")
score = tw.Score([tw.Note(0.0, 0.1, string="E2", force=1.0), tw.Note(0.05, 0.1, string="A2", stop=3, force=1.0)])
block = next(iter(tw.Renderer(score, guitar, 48000).blocks(4096)))
late = [name for name in ("scipy.linalg", "ruamel.yaml", "soundfile", "matplotlib") if name in sys.modules]
print(json.dumps([late, gc.isenabled(), hashlib.sha256(block.tobytes()).hexdigest()]))
"""


def first_block(cache: str) -> list[object]:
    environment = os.environ | {"TONEWOOD_CACHE": cache}
    done = subprocess.run([sys.executable, "-c", FIRST_BLOCK], env=environment, capture_output=True, check=True)
    found: list[object] = json.loads(done.stdout)
    return found


@pytest.mark.slow
def test_a_second_start_imports_no_more_than_it_needs_and_has_the_same_samples(tmp_path: Path) -> None:
    without, first, second = (first_block(cache) for cache in ("off", str(tmp_path), str(tmp_path)))
    assert list(tmp_path.glob("*.tunings"))
    assert second[:2] == [[], True]
    assert without[2] == first[2] == second[2]


def test_kept_tunings_are_read_and_follow_the_bundle(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TONEWOOD_CACHE", str(tmp_path))
    plain = tw.load_instrument("monochord")

    def tension(instrument: tw.Instrument) -> float:
        (string,) = assemble(instrument, 16000).strings.values()
        return string.tension(0)

    found = tension(plain)
    (file,) = tmp_path.glob("*.tunings")
    kept = file.read_bytes()
    key = kept.split()[2].decode()
    assert tension(plain) == found
    ((name, entry),) = json.loads(kept.partition(b"\n")[2]).items()
    assert entry["tension"] == found
    keep("tunings", key, json.dumps({name: entry | {"tension": 1.01 * found}}).encode())
    assert tension(plain) == 1.01 * found  # it is read
    heavier = plain.replace({"strings.*.linear_density": 1.2 * plain.resolved["strings"][name]["linear_density"]})
    assert tension(heavier) == pytest.approx(1.2 * found, rel=1e-3)  # f = sqrt(T / mu) / 2 L
    assert len(list(tmp_path.glob("*.tunings"))) == 2
    for damaged in ("{", "[]", "{}x", json.dumps({name: entry | {"modes": []}}), json.dumps({name: {"guess": 1.0}})):
        keep("tunings", key, damaged.encode())
        with pytest.warns(DamagedCacheWarning, match=file.name):
            assert tension(plain) == found
    assert file.read_bytes() == kept


def test_the_rows_chosen_are_those_of_a_pivoted_qr() -> None:
    rng = np.random.default_rng(5)
    for n, rank in ((6, 2), (9, 4), (5, 5)):
        rows = rng.standard_normal((n, rank)) @ rng.standard_normal((rank, 40))
        _, R, order = sla.qr(rows.T, mode="economic", pivoting=True)
        assert np.count_nonzero(abs(np.diag(R)) > 1e-13 * abs(R[0, 0])) == rank
        assert _pivots(rows, 1e-13).tolist() == sorted(order[:rank].tolist())


def test_collecting_is_put_back_even_after_an_error() -> None:
    def fails() -> None:
        assert not gc.isenabled()
        raise ValueError("stops here")

    assert gc.isenabled()
    with pytest.raises(ValueError, match="stops here"):
        without_collecting(fails)()
    assert gc.isenabled()
    gc.disable()
    try:
        without_collecting(lambda: None)()
        assert not gc.isenabled()
    finally:
        gc.enable()
