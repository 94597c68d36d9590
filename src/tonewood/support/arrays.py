"""Types of arrays, for annotations; views for code of others."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]
Singles = NDArray[np.float32]
Indices = NDArray[np.intp]


def read_only(argument: Any) -> Any:
    """View of an array that cannot be written to, for a method of others; anything else as it is."""
    if not isinstance(argument, np.ndarray):
        return argument
    view = argument.view()
    view.flags.writeable = False
    return view
