"""One BLAS thread while the library computes: entries nest, end in any order, and restore the setting."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading

import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from tonewood.support.blas import blas_libraries, one_blas_thread

RENDER = """
import hashlib, json
import tonewood as tw
guitar = tw.load_instrument("classical_guitar")
notes = [tw.Note(0.0, 0.1, string="E2", stop=0, force=2.0), tw.Note(0.1, 0.1, string="E2", stop=3, force=2.0)]
from threadpoolctl import threadpool_info
threads = max(i["num_threads"] for i in threadpool_info() if i["user_api"] == "blas")
sound = tw.render(tw.Score(notes), guitar, max_duration=0.2)
print(json.dumps([threads, hashlib.sha256(sound.samples.tobytes()).hexdigest()]))
"""


blas_libraries()  # loads them all, so that the limits below reach SciPy's too


def threads() -> set[int]:
    return {i["num_threads"] for i in threadpool_info() if i["user_api"] == "blas"}


def test_the_limit_holds_inside_and_is_put_back() -> None:
    with threadpool_limits(2, user_api="blas"):
        before = threads()

        @one_blas_thread
        def inner(fails: bool) -> set[int]:
            if fails:
                raise ValueError("stops here")
            return threads()

        assert one_blas_thread(lambda: (inner(False), threads()))() == ({1}, {1})
        assert threads() == before
        with pytest.raises(ValueError, match="stops here"):
            inner(True)
        assert threads() == before


def test_overlapping_threads_keep_the_limit_until_the_last_ends() -> None:
    first_in, second_in, first_out = threading.Event(), threading.Event(), threading.Event()
    seen: list[set[int]] = []

    @one_blas_thread
    def first() -> None:
        first_in.set()
        assert second_in.wait(30)

    @one_blas_thread
    def second() -> None:
        second_in.set()
        assert first_out.wait(30)
        seen.append(threads())

    with threadpool_limits(2, user_api="blas"):
        before = threads()
        one, two = threading.Thread(target=first), threading.Thread(target=second)
        one.start()
        assert first_in.wait(30)
        two.start()
        one.join(30)
        first_out.set()
        two.join(30)
        assert seen == [{1}]
        assert threads() == before


def test_libraries_are_listed_with_version_and_processor_kernel() -> None:
    libraries = blas_libraries()
    assert libraries
    assert all(len(name.split()) >= 2 for name in libraries)


@pytest.mark.slow
def test_samples_do_not_depend_on_the_number_of_blas_threads() -> None:
    found = []
    for wanted in ("1", "2"):
        environment = os.environ | dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), wanted)
        done = subprocess.run([sys.executable, "-c", RENDER], env=environment, capture_output=True, check=True)
        found.append(json.loads(done.stdout))
    if found[1][0] == 1:
        pytest.skip("BLAS has one thread here, whatever is asked for")
    assert found[0][1] == found[1][1]


LATE = """
from threadpoolctl import threadpool_info
from tonewood.support.blas import one_blas_thread

def threads():
    return {i["num_threads"] for i in threadpool_info() if i["user_api"] == "blas"}

@one_blas_thread
def inside():
    few = len(threadpool_info())
    from tonewood.support.scipy_linalg import sla
    return few, len(threadpool_info()), threads()

few, more, limited = inside()
print(more > few, sorted(limited), max(threads()))
"""


def test_a_library_that_is_loaded_within_the_limit_obeys_it() -> None:
    environment = os.environ | dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "2")
    done = subprocess.run([sys.executable, "-c", LATE], env=environment, capture_output=True, check=True, text=True)
    late, limited, after = done.stdout.split()
    if late == "False" or after == "1":
        pytest.skip("SciPy has no BLAS library of its own here, or BLAS has one thread")
    assert (limited, after) == ("[1]", "2")
