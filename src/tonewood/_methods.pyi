from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

PADDING: int

class Method:
    def __init__(
        self,
        rule: str,
        isa: str,
        capacity: int,
        n_connections: int,
        n_channels: int,
        phases: int,
        lags: int,
        constants: Sequence[float],
    ) -> None: ...
    def add_part(
        self,
        offset: int,
        coef: NDArray[np.float64],
        excite: NDArray[np.float64],
        reads: NDArray[np.float64],
        outs: NDArray[np.float64],
        links: Sequence[int],
        channels: Sequence[int],
    ) -> None: ...
    def set_solve(
        self, g: NDArray[np.float64], memory: NDArray[np.float64], out_memory: NDArray[np.float64]
    ) -> None: ...
    def run(
        self, state: NDArray[np.float64], forces: NDArray[np.float64], n: int, every: int, out: NDArray[np.float64]
    ) -> int: ...

class Explicit:
    def __init__(
        self, isa: str, capacity: int, h: float, n_rigid: int, n_channels: int, stiffness: Sequence[float]
    ) -> None: ...
    def add_law(self, one_sided: bool, a: Sequence[float], offset: float) -> None: ...
    def add_part(
        self,
        offset: int,
        tension: int,
        coef: NDArray[np.float64],
        rigid: NDArray[np.float64],
        law: NDArray[np.float64],
        outs: NDArray[np.float64],
        rigid_links: Sequence[int],
        law_links: Sequence[int],
        channels: Sequence[int],
    ) -> None: ...
    def set_solve(self, g: NDArray[np.float64], exchange: NDArray[np.float64]) -> None: ...
    def run(self, state: NDArray[np.float64], n: int, every: int, out: NDArray[np.float64]) -> int: ...
