"""Nothing that does not fit gets into the kernel: `load` and `run` refuse every array of a wrong shape, size or type.

A description that passes is run, so that a build with sanitizers would notice memory it should not have touched.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tonewood import _kernel
from tonewood.physics.coupling.potentials.base import Kind
from tonewood.physics.coupling.potentials.phantom import MEMORY

PAD, BLOCK, CHANNELS, CAPACITY = _kernel.PADDING, _kernel.BLOCK_SIZE, 2, 4 * _kernel.PADDING
CONNECTIONS = 2
SHORTCUTS = (
    "fused_pass", "direct_step", "block_culling", "group_bound", "fine_bound", "at_rest", "linear_laws",
)  # fmt: skip
Path = tuple[str | int, ...]


def component(slot: int, *, driven: bool = False) -> dict[str, Any]:
    """One mode at a quarter of the sampling rate behind two ports, two readouts."""
    e = np.zeros((4, PAD))
    e[:, 0] = [0.0, -0.9, 0.9, 0.0]
    ports, n_rows = 2, 2 + (0 if driven else 2)
    rows, w = np.zeros((n_rows, 2, PAD)), np.zeros((ports, 2, PAD))
    rows[:, 0, 0], w[:, 1, 0] = 1.0, 1e-3
    return {
        "key": slot, "offset": slot * PAD, "driven": driven, "e": e, "rows": rows, "w": w,
        "response": np.full((BLOCK, ports, n_rows), 1e-3), "incidence": np.eye(CONNECTIONS),
        "channels": [0, 1], "difference": [0, 1],
    }  # fmt: skip


def linear(m: int = CONNECTIONS) -> dict[str, Any]:
    return {
        "inverse": np.eye(m) * 1e-3,
        "gamma": np.ones(m),
        "constant": np.zeros(m),
        "weights": np.ones((CHANNELS, m)),
    }


def described(k: int = 0) -> dict[str, Any]:
    """Two components, a driven one, and k contacts on a port of the first."""
    m = CONNECTIONS
    return {
        "components": [component(0), component(1), component(2, driven=True)],
        "linear": linear(),
        "nonlinear": {
            "dt": 1 / 48000, "theta": 0.6,
            "terms": np.array([[j, 0, 1, 0] for j in range(k)], dtype=np.int64).reshape(k, 4),
            "factors": np.ones(k), "kinds": np.zeros(k, dtype=np.int64),
            "numbers": np.array([[1e6, 1.5, 0, 0, 0, 0, 0, 0]] * k).reshape(k, 8), "samples": [], "functions": [],
            "weights": np.zeros((CHANNELS, k)), "compliance": np.eye(k) * 1e-6, "from_linear": np.zeros((k, m)),
            "to_linear": np.zeros((m, k)), "residual": np.zeros((k, k)),
        },
        "potentials": [],
        "shortcuts": dict.fromkeys(SHORTCUTS, True),
    }  # fmt: skip


def contact_ports() -> dict[str, Any]:
    """A contact on a port of its own of the first component."""
    made = described(1)
    rows = np.zeros((1, 2, PAD))
    rows[0, 0, 0] = 0.5
    made["components"][0] |= {
        "contact_rows": rows, "contact_w": 1e-3 * rows[:, ::-1].copy(), "from_fixed": np.full((BLOCK, 2, 1), 1e-3),
        "from_contact": np.full((BLOCK, 1, 1), 1e-3), "on_rows": np.full((BLOCK, 1, 4), 1e-3),
    }  # fmt: skip
    made["nonlinear"]["terms"] = np.array([[0, 0, 0, 1]])
    return made


def coordinates(weights: np.ndarray) -> dict[str, Any]:
    """Coordinates of one mode, with weights of a stretch."""
    one = np.zeros(PAD)
    one[0] = 1.0
    kick, velocity = np.stack([1e-3 * one] * 2), np.stack([one] * 3)
    more = {"kick": kick, "velocity": velocity, "middle": 0.5 * velocity[:2]}
    return {"a": weights, "reading": one, "stiffness": one.copy(), **more}


def stretched() -> dict[str, Any]:
    """The first component is a string whose tension rises."""
    made, one = described(), np.zeros(PAD)
    one[0] = 1.0
    made["components"][0] |= coordinates(one)
    made["potentials"] = [{"kind": Kind.TENSION, "at": 0, "slots": [0], "scale": 10.0}]
    return made


def longitudinal() -> dict[str, Any]:
    """The first two components are a string's transverse and longitudinal motion."""
    made = described()
    for slot in (0, 1):
        made["components"][slot] |= coordinates(np.zeros(PAD))
    parts = [{"slopes": np.full((2, 1), 0.1)} for _ in range(2)]
    made["potentials"] = [{"kind": Kind.LONGITUDINAL, "at": 0, "slots": [0, 1], "scale": 1.0, "parts": parts}]
    return made


def phantoms() -> dict[str, Any]:
    """The first component drives longitudinal modes whose force acts on the second one."""
    made = described()
    parts = [{"weights": np.full((3, 2), 1.0), "mirrored": np.full((3, 2), 1.0)}]
    string = {"target": 1, "scale": 1e-3, "vector": np.full((2, PAD), 1e-6), "steps": np.full((2, 6), 0.1)}
    made["potentials"] = [{"kind": Kind.PHANTOM, "at": 0, "slots": [0], "parts": parts, **string}]
    return made


def job(k: int = 0, n: int = 40) -> list[Any]:
    injection = (0, 3, np.ones((1, 2, PAD)), np.ones((1, 5)))
    return [
        np.zeros((2, CAPACITY)), np.zeros((n, CHANNELS)), np.zeros((n, CONNECTIONS)), [injection], np.zeros((n, k)), [],
        np.zeros(k), np.zeros(k), np.zeros(k), np.zeros(MEMORY), 0,
    ]  # fmt: skip


def make() -> Any:
    return _kernel.Kernel(_kernel.instruction_sets()[0], 3, CAPACITY, CHANNELS)


def through(description: dict[str, Any], arguments: list[Any] | None = None) -> np.ndarray:
    """Output of a run."""
    kernel = make()
    kernel.load(description)
    arguments = arguments or job(len(description["nonlinear"]["kinds"]))
    kernel.run(*arguments)
    return arguments[1]


MADE = {
    "plain": described,
    "contact": lambda: described(1),
    "ports": contact_ports,
    "tension": stretched,
    "longitudinal": longitudinal,
    "phantoms": phantoms,
}


@pytest.mark.parametrize("which", MADE)
def test_what_fits_runs(which: str) -> None:
    out = through(MADE[which]())
    assert np.isfinite(out).all()
    assert np.abs(out).max() > 0


def misfits(array: np.ndarray) -> list[Any]:
    """The same array in every wrong form."""
    longer = [np.concatenate([array, array[..., :1]], axis=-1)] if array.ndim and array.shape[-1] else []
    more = [np.concatenate([array, array[:1]])] if array.ndim and len(array) else []
    shorter = [array[:-1].copy()] if array.ndim and len(array) else []
    thinner = [array[..., :-1].copy()] if array.ndim and array.shape[-1] else []
    flat = [array.ravel()] if array.ndim > 1 else [array[:, None], np.zeros((0, 0, 0, 0))]
    typed = [array.astype(np.float32), array.astype(complex)]
    return [
        *longer,
        *more,
        *shorter,
        *thinner,
        *flat,
        *typed,
        array[None],
        np.float64(1.0),
        None,
        "array",
        [1.0],
        object(),
    ]


def arrays(value: Any, path: Path = ()) -> list[Path]:
    """Where the arrays of a description are."""
    if isinstance(value, np.ndarray):
        return [path]
    if isinstance(value, dict):
        return [p for key, inner in value.items() for p in arrays(inner, (*path, key))]
    if isinstance(value, list):
        return [p for i, inner in enumerate(value) for p in arrays(inner, (*path, i))]
    return []


def put(description: Any, path: Path, value: Any) -> Any:
    """Replace the value at a path; returns the earlier one."""
    for step in path[:-1]:
        description = description[step]
    before, description[path[-1]] = description[path[-1]], value
    return before


PLACES = [(which, path) for which, made in MADE.items() for path in arrays(made())]


@pytest.mark.parametrize(("which", "path"), PLACES)
def test_every_array_of_a_wrong_form_is_refused_by_its_name(which: str, path: Path) -> None:
    given = put(MADE[which](), path, None)
    for wrong in misfits(given):
        if isinstance(wrong, np.ndarray | np.generic) and wrong.size == given.size == 0:
            continue
        if path[-1] == "incidence" and np.ndim(wrong) == 2 and len(wrong) < CONNECTIONS:
            continue  # the last connections do not act on this component
        if path[-1] == "slopes" and np.ndim(wrong) == 2 and wrong.shape[1] <= PAD and len(wrong):
            continue  # any number of cosines and modes
        if path[-1] == "weights" and len(path) > 2 and np.ndim(wrong) == 2 and len(wrong) == len(given):
            continue  # any number of modes
        if isinstance(wrong, np.ndarray) and wrong.shape == given.shape and wrong.dtype == given.dtype:
            continue
        made = MADE[which]()
        put(made, path, wrong)
        with pytest.raises((TypeError, ValueError), match=f"kernel: .*{path[0]}"):
            through(made)


@pytest.mark.parametrize("argument", [0, 1, 2, 4, 6, 7, 8])
def test_every_array_of_a_run_in_a_wrong_form_is_refused(argument: int) -> None:
    for wrong in misfits(job(1)[argument]):
        arguments = job(1)
        arguments[argument] = wrong
        with pytest.raises((TypeError, ValueError)):
            through(described(1), arguments)


@pytest.mark.parametrize("argument", [0, 1, 2, 4])
@pytest.mark.parametrize("dtype", [np.float32, np.int64, np.complex128])
def test_what_is_written_to_is_never_a_converted_copy(argument: int, dtype: type) -> None:
    """States and outputs of another type, order or without leave to write."""
    right = job(1)[argument]
    locked = right.copy()
    locked.setflags(write=False)
    for wrong in (right.astype(dtype), np.zeros((*right.shape, 2))[..., 0], locked):
        arguments = job(1)
        arguments[argument] = wrong
        with pytest.raises(TypeError):
            through(described(1), arguments)


@pytest.mark.parametrize(
    ("path", "wrong"),
    [
        (("components", 0, "offset"), 8), (("components", 0, "offset"), CAPACITY), (("components", 0, "offset"), -PAD),
        (("components", 0, "channels"), [0, 2]), (("components", 0, "channels"), [0, -1]),
        (("components", 0, "channels"), [0]), (("components", 0, "difference"), [1]),
        (("components", 0, "channels"), 2**40), (("components", 0, "driven"), "x"), (("components", 0, "key"), None),
        (("components",), []), (("components",), [component(0)]), (("components", 1), {"key": 77}),
        (("components", 1), {"key": -1}), (("components", 1), None), (("linear",), {}), (("shortcuts",), {}),
        (("nonlinear", "kinds"), np.array([9])), (("nonlinear", "kinds"), np.array([2])),
        (("nonlinear", "kinds"), np.array([3])), (("nonlinear", "kinds"), np.array([-1])),
        (("nonlinear", "samples"), [(0, [1.0, 0.0], [1.0] * 4)]),
        (("nonlinear", "samples"), [(0, [0.0, np.nan], [1.0] * 4)]),
        (("nonlinear", "samples"), [(0, [0.0, np.inf], [1.0] * 4)]), (("nonlinear", "samples"), [(0, [0.0], [])]),
        (("nonlinear", "samples"), [(0, [0.0, 1.0], [1.0])]), (("nonlinear", "samples"), [(1, [0.0, 1.0], [1.0] * 4)]),
        (("nonlinear", "functions"), [(0, [(1, 0, False)])]), (("nonlinear", "dt"), "fast"),
        (("nonlinear", "terms"), np.array([[0, 0, 2, 0]])), (("nonlinear", "terms"), np.array([[0, 0, 10**6, 0]])),
        (("nonlinear", "terms"), np.array([[0, 3, 0, 0]])), (("nonlinear", "terms"), np.array([[0, 0, -1, 0]])),
        (("nonlinear", "terms"), np.array([[0, -1, 0, 0]])), (("nonlinear", "terms"), np.array([[1, 0, 0, 0]])),
        (("nonlinear", "terms"), np.array([[0, 0, 0, 1]])), (("nonlinear", "terms"), np.array([[2**40, 0, 0, 0]])),
        (("potentials",), [{"kind": 0, "at": 0, "slots": [3], "scale": 1.0}]),
        (("potentials",), [{"kind": 0, "at": 0, "slots": [-1], "scale": 1.0}]),
        (("potentials",), [{"kind": 0, "at": -1, "slots": [0], "scale": 1.0}]),
        (("potentials",), [{"kind": 0, "at": 0, "slots": [0], "scale": 1.0}]),
        (("potentials",), [{"kind": 9, "at": 0, "slots": [0], "scale": 1.0}]),
    ],
)  # fmt: skip
def test_numbers_out_of_range_are_refused(path: Path, wrong: Any) -> None:
    made = described(1)
    put(made, path, wrong)
    with pytest.raises((TypeError, ValueError, KeyError, OverflowError)):
        through(made)


@pytest.mark.parametrize(
    ("argument", "wrong"),
    [
        (3, [(3, 0, np.ones((1, 2, PAD)), np.ones((1, 5)))]), (3, [(-1, 0, np.ones((1, 2, PAD)), np.ones((1, 5)))]),
        (3, [(0, 0, np.ones((2, 2, PAD)), np.ones((1, 5)))]), (3, [(0, 0, np.ones((1, 2, 2 * PAD)), np.ones((1, 5)))]),
        (3, [(0, 0, np.ones((1, 3, PAD)), np.ones(5))]), (5, [(1, np.zeros((4, 40)))]), (5, [(-1, np.zeros((4, 40)))]),
        (5, [(0, np.zeros((4, 39)))]), (5, [(0, np.zeros((3, 40)))]),
    ],
)  # fmt: skip
def test_injections_and_controls_that_do_not_fit_are_refused(argument: int, wrong: Any) -> None:
    arguments = job(1)
    arguments[argument] = wrong
    with pytest.raises((TypeError, ValueError)):
        through(described(1), arguments)


def test_a_state_of_the_potentials_that_is_too_small_is_refused() -> None:
    for wrong in (np.zeros(0), np.zeros(2), np.zeros((1, 3)), np.zeros(3, dtype=np.float32)):
        arguments = job()
        arguments[9] = wrong
        with pytest.raises((TypeError, ValueError)):
            through(stretched(), arguments)


@pytest.mark.parametrize(
    "places",  # of each tension: its numbers in the state, its components
    [[(2**31 - 1, [0])], [(0, [])], [(0, [0, 0])], [(0, [0]), (3, [0])]],
)
def test_strings_with_rising_tension_that_do_not_fit_are_refused(places: list[Any]) -> None:
    made = stretched()
    made["potentials"] = [{"kind": Kind.TENSION, "at": at, "slots": slots, "scale": 10.0} for at, slots in places]
    with pytest.raises(ValueError, match="potentials"):
        through(made)


def test_a_component_without_modes_and_a_part_without_modes_are_refused() -> None:
    made = described()
    for name in ("e", "rows", "w"):
        made["components"][0][name] = np.ascontiguousarray(made["components"][0][name][..., :0])
    with pytest.raises(ValueError, match="offset: the modes do not fit"):
        through(made)
    made = longitudinal()
    made["potentials"][0]["parts"][-1]["slopes"] = np.zeros((2, 0))
    with pytest.raises(ValueError, match="slopes: they do not fit"):
        through(made)


@pytest.mark.parametrize(
    ("path", "wrong"),
    [
        (("target",), 3), (("target",), 2), (("target",), -1), (("slots", 0), 2), (("slots", 0), 3), (("slots",), []),
        (("at",), 2**31 - 1), (("parts", 0, "weights"), np.zeros((3, PAD + 1))), (("parts", 0, "weights"), np.zeros(3)),
        (("steps",), np.zeros((33, 6))), (("steps",), np.zeros((0, 6))),
        (("vector",), np.full((2, PAD), np.nan)), (("vector",), np.r_[[np.ones(PAD)], [[*np.ones(PAD - 1), np.inf]]]),
    ],
)  # fmt: skip
def test_longitudinal_forces_that_do_not_fit_are_refused(path: Path, wrong: Any) -> None:
    made = phantoms()
    put(made["potentials"][0], path, wrong)
    with pytest.raises(ValueError, match="potentials"):
        through(made)


def test_a_state_of_the_longitudinal_forces_that_is_too_small_is_refused() -> None:
    for wrong in (np.zeros(0), np.zeros(MEMORY - 1), np.zeros((1, MEMORY))):
        arguments = job()
        arguments[9] = wrong
        with pytest.raises((TypeError, ValueError)):
            through(phantoms(), arguments)


@pytest.mark.parametrize(("phase", "n"), [(-1, 4), (1, 64), (60, 5)])
def test_a_run_over_the_end_of_a_window_that_it_did_not_begin_is_refused(phase: int, n: int) -> None:
    arguments = job(n=n)
    arguments[10] = phase
    with pytest.raises(ValueError, match="phase"):
        through(stretched(), arguments)


def test_nothing_is_run_before_a_load_and_after_a_load_that_failed() -> None:
    kernel = make()
    with pytest.raises(ValueError, match="nothing is loaded"):
        kernel.run(*job())
    kernel.load(described())
    wrong = described()
    wrong["components"][1] = component(1) | {"key": 5}
    wrong["linear"]["gamma"] = np.ones(1)
    with pytest.raises(ValueError, match="linear"):
        kernel.load(wrong)
    with pytest.raises(ValueError, match="nothing is loaded"):
        kernel.run(*job())
    kernel.load(described())
    arguments = job()
    kernel.run(*arguments)
    np.testing.assert_array_equal(arguments[1], through(described()))


def test_other_numbers_of_connections_than_the_components_have_are_refused() -> None:
    for m, message in ((1, "incidence"), (3, "from_linear")):
        made = described(1)
        made["linear"] = linear(m)
        with pytest.raises(ValueError, match=message):
            through(made)
        kernel = make()
        kernel.load(described())
        made["components"] = [{"key": slot} for slot in range(3)]
        with pytest.raises(ValueError, match="kernel: "):
            kernel.load(made)


def test_components_come_back_by_their_keys_or_are_missing() -> None:
    kernel = make()
    expected = through(described())
    kernel.load(described())
    cached = {"components": [{"key": slot} for slot in range(3)]}
    for number in range(40):
        other = described()
        other["components"][0] = component(0) | {"key": 100 + number, "w": 2.0 * component(0)["w"]}
        kernel.load(other)
        arguments = job()
        kernel.run(*arguments)
        assert np.abs(arguments[1] - expected).max() > 0
        if 0 in kernel.cached():
            kernel.load(described() | cached)
            arguments = job()
            kernel.run(*arguments)
            np.testing.assert_array_equal(arguments[1], expected)
    assert len(kernel.cached()) <= 5 * 3
    with pytest.raises(ValueError, match="key 100 "):
        kernel.load(described() | {"components": [{"key": 100}, {"key": 1}, {"key": 2}]})


@given(st.lists(st.integers(0, 3 * PAD), min_size=2, max_size=2), st.integers(0, 200), st.integers(-300, 300))
def test_any_lengths_that_fit_each_other_run(offsets: list[int], n: int, first: int) -> None:
    """Offsets that overlap or are not padded, injections before, in and after the run: refused, or finite."""
    made = described()
    for slot in (0, 1):
        made["components"][slot]["offset"] = offsets[slot]
    arguments = job(n=n)
    arguments[3] = [(0, first, np.ones((1, 2, PAD)), np.ones((1, 90)))]
    try:
        out = through(made, arguments)
    except ValueError:
        assert any(offset % PAD or offset + PAD > CAPACITY for offset in offsets)
    else:
        assert np.isfinite(out).all()


def test_a_slot_takes_back_what_an_earlier_one_would_displace() -> None:
    """The store is full, and the oldest component in it is wanted by the last slot of the same load."""
    kernel = make()
    kernel.load(described())

    def fresh(slot: int, key: int) -> dict[str, Any]:
        return component(slot) | {"key": key}

    kernel.load(described() | {"components": [fresh(0, 0), fresh(1, 1), fresh(2, 50)]})  # 2 is stored first
    for number in range(11):
        kernel.load(described() | {"components": [fresh(0, 100 + number), fresh(1, 1), fresh(2, 50)]})
    assert 2 in kernel.cached()
    kernel.load(described() | {"components": [fresh(0, 200), fresh(1, 1), {"key": 2}]})
    assert 2 in kernel.cached()
    assert len(kernel.cached()) <= 5 * 3
