"""The power that thrust takes, by the tables of thrusters' vendors."""

from __future__ import annotations

import functools
from importlib.resources import files
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from ..arrays import Reals, Truths

GRAVITY = 9.80665  # m/s2, of a kgf
TABLES = {"t200": "t200.csv"}  # {thruster: its table}, which names its source
ROUNDING = 0.01  # of the largest thrust: beyond the table by so little is its last line


class PowerCurve:
    """Thrust and power of a thruster at a voltage, in still water, as arrays over pulse widths.

    Between the voltages of the table, both are interpolated at each pulse width.  voltage: V, within the table.
    """

    def __init__(self, thruster: str, voltage: float):
        self.thruster, self.voltage = thruster, voltage
        voltages, thrust, power = _table(thruster)
        thrust = np.array([np.interp(voltage, voltages, row) for row in thrust]) * GRAVITY
        power = np.array([np.interp(voltage, voltages, row) for row in power])
        # One power for each thrust: the mean of the lines that share it.
        self._thrust, place = np.unique(thrust, return_inverse=True)
        self._power = np.bincount(place, power) / np.bincount(place)
        self.reverse, self.forward = float(self._thrust[0]), float(self._thrust[-1])  # N

    def power(self, thrust: Reals) -> Reals:
        """Of a thrust [N], forward positive, in W; of one beyond the table that at its end."""
        power: Reals = np.interp(thrust, self._thrust, self._power)
        return power

    def gives(self, thrust: Reals) -> Truths:
        """Whether the thruster gives a thrust [N]."""
        within: Truths = (thrust >= self.reverse * (1 + ROUNDING)) & (thrust <= self.forward * (1 + ROUNDING))
        return within

    def __str__(self) -> str:
        return (
            f"a {self.thruster} at {self.voltage:g} V gives at most {self.forward:.3g} N forward and "
            f"{-self.reverse:.3g} N in reverse"
        )


def voltages(thruster: str) -> tuple[float, float]:
    """The least and the largest of its table [V]."""
    known = _table(thruster)[0]
    return float(known[0]), float(known[-1])


@functools.cache
def _table(thruster: str) -> tuple[Reals, Reals, Reals]:
    """Voltages [V] (m,), and over pulse widths and voltages thrust [kgf] and power [W], (n, m) each."""
    text = files(__package__).joinpath(TABLES[thruster]).read_text(encoding="utf-8")
    lines = [line for line in text.splitlines() if not line.startswith("#")]
    known = np.array([float(head.split()[1]) for head in lines[0].split(",")[1::2]])
    values = np.array([[float(v) for v in line.split(",")] for line in lines[1:]])
    return known, values[:, 1::2], values[:, 2::2]
