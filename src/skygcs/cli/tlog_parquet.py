"""Tables as Parquet. pyarrow is an extra (`skygcs[parquet]`) and is imported here only, on first use."""

from __future__ import annotations

from typing import IO, Any

from skygcs.errors import SkygcsError
from skygcs.tlog.columns import NUMBER, TEXT, TIME, Kind

CELLS_PER_GROUP = 200_000
"""Of one table, in memory at a time: some 10 MB as Python objects. A row group of 20,000 rows with ten columns."""

_TYPES: dict[Kind, str] = {TEXT: "string", NUMBER: "float64", "float": "float32", "double": "float64", "char": "string"}


def require_pyarrow() -> None:
    """Raises SkygcsError that says how to get it."""
    try:
        import pyarrow.parquet  # noqa: F401
    except ImportError:
        raise SkygcsError(
            "Parquet needs pyarrow: pip install 'skygcs[parquet]', or pip install '.[parquet]' in a checkout"
        ) from None


class ParquetTable:
    """Columns with the types of the message's fields; times are timestamps of UTC in microseconds."""

    def __init__(self, file: IO[bytes], columns: tuple[tuple[str, Kind], ...]) -> None:
        import pyarrow as pa
        import pyarrow.parquet as pq

        self.rows = 0
        self._pa = pa
        self._schema = pa.schema([(name, _arrow_type(pa, kind)) for name, kind in columns])
        self._writer = pq.ParquetWriter(file, self._schema)
        self._most = max(CELLS_PER_GROUP // len(columns), 1)
        self._waiting: list[list[Any]] = []

    def add(self, row: list[Any]) -> None:
        self.rows += 1
        self._waiting.append(row)
        if len(self._waiting) >= self._most:
            self._write()

    def close(self) -> None:
        if self._waiting:
            self._write()
        self._writer.close()

    def _write(self) -> None:
        columns = [
            self._pa.array(values, field.type)
            for field, values in zip(self._schema, zip(*self._waiting, strict=True), strict=True)
        ]
        self._writer.write_table(self._pa.Table.from_arrays(columns, schema=self._schema))
        self._waiting.clear()


def _arrow_type(pa: Any, kind: Kind) -> Any:
    if kind == TIME:
        return pa.timestamp("us", tz="UTC")
    return getattr(pa, _TYPES.get(kind) or kind.removesuffix("_t"))()
