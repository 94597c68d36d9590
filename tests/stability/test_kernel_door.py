"""Nothing that does not fit gets into the kernel: every array with a wrong shape, size or type is refused at its door.

What passes is run, so that a build with sanitizers would notice memory it should not have touched.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tonewood import _kernel

PAD, BLOCK, CHANNELS, CAPACITY = _kernel.PADDING, _kernel.BLOCK_SIZE, 2, 4 * _kernel.PADDING
CONNECTIONS = 2
INCIDENCE = 7  # among the arguments of set_component


def component(slot: int, *, driven: bool = False) -> list[Any]:
    """One mode at a quarter of the sampling rate behind two ports, two readouts."""
    e = np.zeros((4, PAD))
    e[:, 0] = [0.0, -0.9, 0.9, 0.0]
    ports, n_rows = 2, 2 + (0 if driven else 2)
    rows, w = np.zeros((n_rows, 2, PAD)), np.zeros((ports, 2, PAD))
    rows[:, 0, 0], w[:, 1, 0] = 1.0, 1e-3
    history = np.full((BLOCK, ports, n_rows), 1e-3)
    return [slot, slot * PAD, driven, e, rows, w, history, np.eye(CONNECTIONS), [0, 1], [0, 1]]


def solve() -> list[Any]:
    m = CONNECTIONS
    return [np.eye(m) * 1e-3, np.ones(m), np.zeros(m), np.ones((CHANNELS, m))]


def nonlinear() -> list[Any]:
    return [0, [], 1 / 48000, 0.6, True, np.zeros((CHANNELS, 0))]


def gaps() -> list[Any]:
    no = np.zeros((0, CONNECTIONS))
    return [np.zeros((0, 0)), no, no.T.copy(), np.zeros((0, 0))]


def job(n: int = 40) -> list[Any]:
    none = np.zeros(0)
    injection = (0, 3, np.ones((1, 2, PAD)), np.ones((1, 5)))
    return [
        np.zeros((2, CAPACITY)), np.zeros((n, CHANNELS)), np.zeros((n, CONNECTIONS)), [injection], np.zeros((n, 0)), [],
        none, none.copy(), none.copy(), np.zeros((0, 3)),
    ]  # fmt: skip


def calls() -> list[tuple[str, list[Any]]]:
    return [
        ("set_component", component(0)),
        ("set_component", component(1)),
        ("set_component", component(2, driven=True)),
        ("set_solve", solve()),
        ("set_nonlinear", nonlinear()),
        ("set_laws", [[]]),
        ("set_gaps", gaps()),
        ("run", job()),
    ]


NONLINEAR, LAWS, GAPS, RUN = 4, 5, 6, 7  # among these


def make() -> Any:
    return _kernel.Kernel(_kernel.instruction_sets()[0], 3, CAPACITY, CHANNELS)


def through(made: list[tuple[str, list[Any]]]) -> list[Any]:
    kernel = make()
    for name, arguments in made:
        getattr(kernel, name)(*arguments)
    return made[-1][1]


def test_what_fits_runs() -> None:
    out = through(calls())[1]
    assert np.isfinite(out).all()
    assert np.abs(out).max() > 0


def misfits(array: np.ndarray) -> list[Any]:
    """The same array in every wrong form."""
    longer = [np.concatenate([array, array[..., :1]], axis=-1)] if array.ndim and array.shape[-1] else []
    more = [np.concatenate([array, array[:1]])] if array.ndim and len(array) else []
    shorter = [array[:-1].copy()] if array.ndim and len(array) else []
    thinner = [array[..., :-1].copy()] if array.ndim and array.shape[-1] else []
    flat = [array.ravel()] if array.ndim > 1 else [array[:, None], np.zeros((0, 0, 0, 0))]
    return [*longer, *more, *shorter, *thinner, *flat, array[None], np.float64(1.0), None, "array", [1.0], object()]


PLACES = [
    (i, j) for i, (_, arguments) in enumerate(calls()) for j, a in enumerate(arguments) if isinstance(a, np.ndarray)
]


@pytest.mark.parametrize(("call", "argument"), PLACES)
def test_every_array_of_a_wrong_form_is_refused(call: int, argument: int) -> None:
    given = calls()[call][1][argument]
    for wrong in misfits(given):
        if isinstance(wrong, np.ndarray) and (wrong.shape == given.shape or wrong.size == given.size == 0):
            continue
        made = calls()
        made[call][1][argument] = wrong
        if argument == INCIDENCE and np.ndim(wrong) == 2 and len(wrong) < CONNECTIONS:
            continue  # the last connections do not act on this component
        with pytest.raises((TypeError, ValueError, RuntimeError)):
            through(made)


@pytest.mark.parametrize("argument", [0, 1, 2, 4])
@pytest.mark.parametrize("dtype", [np.float32, np.int64, np.complex128])
def test_what_is_written_to_is_never_a_converted_copy(argument: int, dtype: type) -> None:
    """States and outputs of another type, order or without leave to write."""
    made = calls()
    right = made[-1][1][argument]
    wrongs = [right.astype(dtype)]
    if right.size:
        locked = right.copy()
        locked.setflags(write=False)
        wrongs += [np.asfortranarray(np.ones(right.shape)), np.zeros((*right.shape, 2))[..., 0], locked]
    for wrong in wrongs:
        if right.size == 0 and wrong.dtype == right.dtype:
            continue
        made[-1][1][argument] = wrong
        with pytest.raises(TypeError):
            through(made)


@pytest.mark.parametrize(
    ("call", "argument", "wrong"),
    [
        (0, 0, 3), (0, 0, -1), (0, 1, 8), (0, 1, CAPACITY), (0, 1, -PAD), (0, 8, [0, 2]), (0, 8, [0, -1]), (0, 8, [0]),
        (0, 9, [1]), (0, 8, 2**40), (0, 2, "x"), (RUN, 3, [(3, 0, np.ones((1, 2, PAD)), np.ones((1, 5)))]),
        (RUN, 3, [(-1, 0, np.ones((1, 2, PAD)), np.ones((1, 5)))]),
        (RUN, 3, [(0, 0, np.ones((2, 2, PAD)), np.ones((1, 5)))]),
        (RUN, 3, [(0, 0, np.ones((1, 2, 2 * PAD)), np.ones((1, 5)))]),
        (RUN, 3, [(0, 0, np.ones((1, 3, PAD)), np.ones(5))]),
        (RUN, 5, [(0, np.zeros((4, 40)))]), (RUN, 5, [(0, np.zeros((4, 39)))]),
        (NONLINEAR, 1, [(0, 0, 0, False, 1.0)]), (NONLINEAR, 0, -1), (NONLINEAR, 0, 1),
        (LAWS, 0, [(0, (0, [0.0] * 8, [], [], []))]), (LAWS, 0, [(-1, (0, [0.0] * 8, [], [], []))]),
    ],
)  # fmt: skip
def test_numbers_out_of_range_are_refused(call: int, argument: int, wrong: Any) -> None:
    made = calls()
    made[call][1][argument] = wrong
    with pytest.raises((TypeError, ValueError, OverflowError)):
        through(made)


def contact(port: int, slot: int = 0) -> list[tuple[str, list[Any]]]:
    """One contact (kind 0) on a port of the first component."""
    made = calls()
    m = CONNECTIONS
    law = (0, [1e6, 1.5, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0], [], [], [])
    made[NONLINEAR][1][:] = [1, [(0, slot, port, False, 1.0)], 1 / 48000, 0.6, False, np.zeros((CHANNELS, 1))]
    made[LAWS][1][:] = [[(0, law)]]
    made[GAPS][1][:] = [np.eye(1) * 1e-6, np.zeros((1, m)), np.zeros((m, 1)), np.zeros((1, 1))]
    made[RUN][1][4] = np.zeros((40, 1))
    made[RUN][1][6:9] = [np.zeros(1), np.zeros(1), np.zeros(1)]
    return made


def test_arrays_of_a_contact_in_a_wrong_form_are_refused() -> None:
    for call, argument in ((NONLINEAR, 5), (GAPS, 0), (GAPS, 1), (GAPS, 2), (GAPS, 3), (RUN, 4)):
        given = contact(1)[call][1][argument]
        for wrong in misfits(given):
            if isinstance(wrong, np.ndarray) and wrong.shape == given.shape:
                continue
            made = contact(1)
            made[call][1][argument] = wrong
            with pytest.raises((TypeError, ValueError, RuntimeError)):
                through(made)


def test_what_a_contact_gives_way_by_must_be_told_with_it() -> None:
    """Not what was told of connections before, and not of none."""
    untold = contact(1)
    del untold[GAPS]
    other = contact(1)
    other.insert(RUN, other[NONLINEAR])
    for made in (untold, other):
        with pytest.raises(ValueError, match="nonlinear connections"):
            through(made)
    for law in ((9, [0.0] * 8, [], [], []), (0, [0.0] * 7, [], [], []), (2, [0.0] * 8, [0.0, 1.0], [1.0], [])):
        made = contact(1)
        made[LAWS][1][:] = [[(0, law)]]
        with pytest.raises(ValueError, match="law"):
            through(made)


def test_components_put_aside_come_back_or_are_missing() -> None:
    kernel = make()
    for name, arguments in calls()[:-1]:
        getattr(kernel, name)(*arguments)
    expected = job()
    kernel.run(*expected)
    for slot in (-1, 3):
        with pytest.raises((TypeError, ValueError)):
            kernel.set_aside(slot, 1)
        with pytest.raises((TypeError, ValueError)):
            kernel.take_back(slot, 1)
    for number in range(40):
        kernel.set_aside(0, number)
        again = job()
        again[3] = []
        kernel.run(*again)  # nothing stands there: the others are stepped
        assert kernel.take_back(0, number)
    assert not kernel.take_back(0, 7)
    again = job()
    kernel.run(*again)
    np.testing.assert_array_equal(again[1], expected[1])


def test_connections_to_ports_that_are_not_there_are_refused() -> None:
    assert np.isfinite(through(contact(1))[1]).all()
    for port, slot in ((2, 0), (10**6, 0), (0, 3), (-1, 0), (0, -1)):
        with pytest.raises((ValueError, RuntimeError)):
            through(contact(port, slot))


def test_a_solve_that_no_longer_fits_is_refused() -> None:
    """Fewer or more linear connections than the components or the nonlinear ones were told of."""
    for m in (1, 3):
        made = contact(1)
        smaller = [np.eye(m), np.ones(m), np.zeros(m), np.ones((CHANNELS, m))]
        made.insert(RUN, ("set_solve", smaller))
        made[-1][1][2] = np.zeros((40, m))
        with pytest.raises((ValueError, RuntimeError)):
            through(made)


def stretched() -> list[tuple[str, list[Any]]]:
    """The first component is a string whose tension rises."""
    made = calls()
    one = np.zeros(PAD)
    one[0] = 1.0
    m = CONNECTIONS
    kick, e = np.stack([1e-3 * one, 1e-3 * one]), component(0)[3]
    made.insert(RUN, ("set_stretched", [0, one, 1e-3 * one, one, kick, e]))
    made.insert(RUN + 1, ("set_tensions", [[(0, 10.0, [0])], np.eye(m), np.zeros(m)]))
    made[-1][1][9] = np.zeros((1, 3))
    return made


def test_tensions_that_do_not_fit_are_refused() -> None:
    """Strings that were not told how they are stretched, connections of another number, states too small."""
    assert np.isfinite(through(stretched())[1]).all()
    untold = stretched()
    del untold[RUN]
    smaller = stretched()
    smaller.insert(RUN + 2, ("set_solve", [np.eye(1), np.ones(1), np.zeros(1), np.ones((CHANNELS, 1))]))
    smaller[-1][1][2] = np.zeros((40, 1))
    states = []
    for wrong in (np.zeros((0, 3)), np.zeros((1, 2)), np.zeros(3), np.zeros((1, 3), dtype=np.float32)):
        states.append(stretched())
        states[-1][-1][1][9] = wrong
    parts = []
    for name, argument, wrong in (
        ("set_stretched", 0, 3), ("set_stretched", 0, 2), ("set_stretched", 1, np.ones(PAD + 1)),
        ("set_stretched", 4, np.ones((1, PAD))), ("set_stretched", 5, np.ones((2, PAD))),
        ("set_tensions", 0, [(0, 1.0, [3])]),
        ("set_tensions", 0, [(0, 1.0, [-1])]),
        ("set_tensions", 0, [(-1, 1.0, [0])]), ("set_tensions", 1, np.eye(3)), ("set_tensions", 2, np.zeros(3)),
    ):  # fmt: skip
        parts.append(stretched())
        dict(parts[-1])[name][argument] = wrong
    for made in (untold, smaller, *states, *parts):
        with pytest.raises((TypeError, ValueError, RuntimeError)):
            through(made)


@given(st.lists(st.integers(0, 3 * PAD), min_size=2, max_size=2), st.integers(0, 200), st.integers(-300, 300))
def test_any_lengths_that_fit_each_other_run(offsets: list[int], n: int, first: int) -> None:
    """Offsets that overlap or are not padded, injections before, in and after the run: refused, or finite."""
    made = calls()
    made[0][1][1], made[1][1][1] = offsets
    made[-1][1][:] = job(n)
    made[-1][1][3] = [(0, first, np.ones((1, 2, PAD)), np.ones((1, 90)))]
    try:
        out = through(made)[1]
    except ValueError:
        assert any(offset % PAD or offset + PAD > CAPACITY for offset in offsets)
    else:
        assert np.isfinite(out).all()
