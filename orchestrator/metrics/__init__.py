"""Metrics: numbers that summarize a run, taken of every communication step while the run goes on.

`specs` says what an entry of [metrics] may be; `accumulators` has the definitions, `thrusters` what power thrust takes.
"""

from .accumulators import distance, on_circle, overshoot, settling_time
from .specs import METRICS, STATISTICS, Meter, finite, problems, signals_of, smaller_is_better, text, turn_of, unit_of

__all__ = [
    "METRICS",
    "STATISTICS",
    "Meter",
    "distance",
    "finite",
    "on_circle",
    "overshoot",
    "problems",
    "settling_time",
    "signals_of",
    "smaller_is_better",
    "text",
    "turn_of",
    "unit_of",
]
