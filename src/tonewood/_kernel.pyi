from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

BLOCK_SIZE: int
PADDING: int
COMPILER: str

def instruction_sets() -> list[str]: ...
def fma_peak(isa: str, seconds: float) -> float: ...

class Kernel:
    def __init__(self, isa: str, n_components: int, capacity: int, n_channels: int) -> None: ...
    def load(self, description: dict[str, Any]) -> None: ...
    def cached(self) -> list[int]: ...
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
        potentials: NDArray[np.float64],
        phase: int,
    ) -> tuple[int, int]: ...
    def acted(self) -> list[int]: ...
    def statistics(self) -> list[int]: ...
