"""Tables as Parquet files: the rows of a CSV file with the types of their values."""

from __future__ import annotations

import io
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from tonewood.support.whole_files import write_whole


def write_parquet(path: Path, columns: Sequence[str], rows: Sequence[Mapping[str, Any]]) -> None:
    """Write rows as Parquet: a column is of booleans, integers, numbers or texts, with null where a row has none.

    A column with values of several types is one of texts; so is one with an integer of more than 64 bits.

    columns : in their order.
    rows : values are str, bool, int, float, None, or lists and mappings, which stand as JSON.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    table = pa.table({name: _column([row.get(name) for row in rows]) for name in columns})
    stream = io.BytesIO()
    pq.write_table(table, stream)
    write_whole(path, stream.getvalue(), make_folder=True)


def is_storable(value: Any) -> bool:
    """Whether a value is no integer of more than 64 bits."""
    return not isinstance(value, int) or -(2**63) <= value < 2**63


def _column(values: list[Any]) -> Any:
    import pyarrow as pa

    kinds = {type(value) for value in values if value is not None}
    if kinds <= {int, float} and kinds and all(map(is_storable, values)):
        return pa.array([None if v is None else float(v) for v in values] if float in kinds else values)
    if len(kinds) == 1 and kinds <= {str, bool}:
        return pa.array(values)
    return pa.array([v if v is None or isinstance(v, str) else json.dumps(v) for v in values], pa.string())
