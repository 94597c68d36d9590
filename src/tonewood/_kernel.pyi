from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

BLOCK_SIZE: int
PADDING: int
COMPILER: str

def instruction_sets() -> list[str]: ...
def fma_peak(isa: str, seconds: float) -> float: ...

class Kernel:
    def __init__(self, isa: str, n_components: int, capacity: int, n_channels: int) -> None: ...
    def set_component(
        self,
        slot: int,
        offset: int,
        driven: bool,
        e: NDArray[np.float64],
        rows: NDArray[np.float64],
        w: NDArray[np.float64],
        history: NDArray[np.float64],
        incidence: NDArray[np.float64],
        channels: Sequence[int],
        difference: Sequence[int],
    ) -> None: ...
    def set_solve(
        self,
        g: NDArray[np.float64],
        gamma: NDArray[np.float64],
        constant: NDArray[np.float64],
        weights: NDArray[np.float64],
    ) -> None: ...
    def set_guarded(
        self,
        slot: int,
        e: NDArray[np.float64],
        rows: NDArray[np.float64],
        w: NDArray[np.float64],
        from_fixed: NDArray[np.float64],
        from_guarded: NDArray[np.float64],
        on_rows: NDArray[np.float64],
    ) -> None: ...
    def set_stretched(
        self,
        slot: int,
        a: NDArray[np.float64],
        half: NDArray[np.float64],
        reading: NDArray[np.float64],
        kick: NDArray[np.float64],
        e: NDArray[np.float64],
    ) -> None: ...
    def set_tensions(
        self,
        strings: Sequence[tuple[int, float, list[int]]],
        matrix: NDArray[np.float64],
        offset: NDArray[np.float64],
    ) -> None: ...
    def set_geometric(
        self,
        strings: Sequence[tuple[float, bool, Sequence[tuple[int, *tuple[NDArray[np.float64], ...]]]]],
    ) -> None: ...
    def set_nonlinear(
        self,
        k: int,
        terms: Sequence[tuple[int, int, int, bool, float]],
        dt: float,
        theta: float,
        guarded: bool,
        weights: NDArray[np.float64],
    ) -> None: ...
    def set_laws(
        self,
        laws: Sequence[tuple[int, tuple[int, list[float], list[float], list[float], list[tuple[int, int, bool]]]]],
    ) -> None: ...
    def set_gaps(
        self,
        compliance: NDArray[np.float64],
        from_linear: NDArray[np.float64],
        to_linear: NDArray[np.float64],
        residual: NDArray[np.float64],
    ) -> None: ...
    def set_aside(self, slot: int, number: int) -> None: ...
    def take_back(self, slot: int, number: int) -> bool: ...
    def run(
        self,
        modes: NDArray[np.float64],
        out: NDArray[np.float64],
        forces: NDArray[np.float64],
        injections: Sequence[tuple[int, int, NDArray[np.float64], NDArray[np.float64]]],
        law_forces: NDArray[np.float64],
        controls: Sequence[tuple[int, NDArray[np.float64]]],
        series: NDArray[np.float64],
        slip: NDArray[np.float64],
        last_force: NDArray[np.float64],
        tension: NDArray[np.float64],
    ) -> tuple[int, int]: ...
    def active(self) -> list[int]: ...
    def acted(self) -> list[int]: ...
    def statistics(self) -> list[int]: ...
