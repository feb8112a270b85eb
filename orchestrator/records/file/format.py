"""What the format of a record is called, and the names in it that several modules need; docs/record.md describes it."""

from __future__ import annotations

FORMAT = "orch-run"
FORMAT_VERSION = 2  # 1: metrics were of the rows, and there was no envelope
ID_LENGTH = 10  # hex digits of the digest that make a run id
ENVELOPE = "_envelope"  # group of the least and the largest values between rows
HEARD = "_heard"  # group of what live components received from outside
# Attributes in JSON.
JSON = (
    "experiment_resolved",
    "versions",
    "metrics",
    "metrics_never",
    "metric_units",
    "warnings",
    "warning_kinds",
    "timing",
    "command",
    "changes",
    "model_descriptions",
    "last_inputs",
)
