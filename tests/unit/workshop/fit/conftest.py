"""A body whose modes are known, for tests of fits."""

from __future__ import annotations

import numpy as np
import pytest
from fit_scenes import Truth


@pytest.fixture(scope="module")
def truth() -> Truth:
    return Truth(
        np.array([150.0, 320.0, 560.0]), np.array([30.0, 50.0, 60.0]), np.array([[1.0, 2.0, 4.0], [-0.5, 1.0, 2.0]])
    )
