from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

BLOCK_SIZE: int
PADDING: int

def instruction_sets() -> list[str]: ...
def fma_peak(isa: str, seconds: float) -> float: ...

class _Kernel:
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
    def run(
        self,
        modes: NDArray[np.floating],
        out: NDArray[np.float64],
        forces: NDArray[np.float64],
        injections: Sequence[tuple[int, int, NDArray[np.floating], NDArray[np.float64]]],
    ) -> tuple[int, int]: ...

class KernelF64(_Kernel): ...
class KernelF32(_Kernel): ...
