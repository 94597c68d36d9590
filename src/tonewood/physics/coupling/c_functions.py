"""C functions by their addresses: what SciPy's `LowLevelCallable` takes."""

from __future__ import annotations

import ctypes
from typing import Any


class CFunction:
    """A C function of one of some signatures, by its address; it is kept alive.

    Takes the arguments of SciPy's `LowLevelCallable`: one of these, a ctypes or cffi function pointer, a numba
    ``cfunc``'s ``ctypes``, a PyCapsule.

    Parameters
    ----------
    function : as above; a `LowLevelCallable` may carry a pointer to data.
    signatures : allowed ones, without spaces and ``const``.

    Attributes
    ----------
    address, data : of the function, and of its data; 0 without any.
    signature : without spaces and ``const``.

    Raises
    ------
    ValueError : another signature.
    """

    def __init__(self, function: Any, signatures: tuple[str, ...]):
        from scipy import LowLevelCallable

        callable_ = function if isinstance(function, LowLevelCallable) else LowLevelCallable(function)
        self.signature = "".join(str(callable_.signature).replace("const ", "").split())
        if self.signature not in signatures:
            raise ValueError(f"a C function is {' or '.join(signatures)}, not {callable_.signature}")
        self._alive = callable_
        capsule = tuple.__getitem__(callable_, 0)  # the class hides its items behind properties
        api = ctypes.pythonapi
        api.PyCapsule_GetName.restype, api.PyCapsule_GetName.argtypes = ctypes.c_char_p, [ctypes.py_object]
        api.PyCapsule_GetPointer.restype = api.PyCapsule_GetContext.restype = ctypes.c_void_p
        api.PyCapsule_GetPointer.argtypes = [ctypes.py_object, ctypes.c_char_p]
        api.PyCapsule_GetContext.argtypes = [ctypes.py_object]
        self.address = int(api.PyCapsule_GetPointer(capsule, api.PyCapsule_GetName(capsule)) or 0)
        self.data = int(api.PyCapsule_GetContext(capsule) or 0)
