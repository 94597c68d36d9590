"""A body's modes as a table that the plugin `modal_table` reads, with the keys that a bundle needs for it."""

from __future__ import annotations

from typing import Any

import numpy as np

from tonewood.errors import TonewoodError
from tonewood.instrument.contract.base import Body


def modal_table_text(body: Body[Any], name: str, freq_upper: float) -> str:
    """Text of a CSV table of a body's real modes below `freq_upper` (Hz); its first lines are notes with the keys.

    name : of the file, as the bundle will call it.
    Raises TonewoodError : the body has complex modes, or rigid-body modes, which such a table cannot say.
    """
    basis, points = body.basis(freq_upper), body.points()
    if not basis.is_real or np.any(basis.stiffness <= 0) or np.any(basis.damping_rate <= 0):
        raise TonewoodError("only real modes with stiffness and loss can be written as a table", key="--table")
    residual = ", ".join(f"[{', '.join(f'{x:.9g}' for x in row)}]" for row in basis.residual)
    lines = [
        "body:",
        "  plugin: modal_table",
        f"  table: {name}",
        "  shapes: points",
        f"  truncation: {{residual_compliance: [{residual}]}}",
        "  points:",
    ]
    for point in basis.points:
        direction = ", ".join(f"{x:.9g}" for x in points[point].direction)
        driven = "" if points[point].driven else ", driven: false"
        lines.append(f"    {point}: {{direction: [{direction}]{driven}}}")
    order = np.argsort(basis.natural_freq)
    q = 0.5 / basis.damping_ratio
    rows = [",".join(["f_Hz", "Q", *basis.points])]
    rows += [",".join(f"{x:.12g}" for x in (basis.natural_freq[k], q[k], *basis.right[:, k].real)) for k in order]
    return "\n".join([*(f"# {line}" for line in lines), *rows]) + "\n"
