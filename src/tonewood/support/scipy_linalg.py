"""`scipy.linalg`, imported where NumPy does not have a function: its import takes 0.1 s, a fifth of a start.

Its BLAS library obeys the limit of threads that is in force while it is imported (`blas`).
"""

import scipy.linalg as sla

from tonewood.support.blas import limit_libraries

limit_libraries()

__all__ = ["sla"]
