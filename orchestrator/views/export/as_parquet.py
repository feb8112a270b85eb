"""Parquet: a column for each signal, its unit in the metadata of its field, the facts in that of the schema."""

from __future__ import annotations

from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from .content import Content


def write(content: Content, target: Path) -> None:
    fields = [pa.field("time", pa.float64(), metadata={"units": "s", "long_name": "simulated time"})]
    columns = [pa.array(content.time)]
    for signal in content.signals:
        for place, values in signal.columns():
            columns.append(pa.array(values, pa.string() if signal.kind == "string" else None))
            fields.append(pa.field(signal.name + place, columns[-1].type, metadata=signal.about))
    facts = {name: str(value) for name, value in content.facts.items()}
    pq.write_table(pa.Table.from_arrays(columns, schema=pa.schema(fields, metadata=facts)), target)
