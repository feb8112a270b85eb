"""Pulse width, thrust and power, by the tables of thrusters' vendors."""

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

    Power is linear in thrust between the lines of the table, each of which the others meet within 11 W.  Between its
    voltages both are interpolated at each pulse width.  voltage: V, within the table.
    """

    def __init__(self, thruster: str, voltage: float):
        self.thruster, self.voltage = thruster, voltage
        self._pulses, voltages, thrust, power = _table(thruster)
        thrust = np.array([np.interp(voltage, voltages, row) for row in thrust]) * GRAVITY
        power = np.array([np.interp(voltage, voltages, row) for row in power])
        self._of_pulses = np.maximum.accumulate(thrust)  # without the scatter of what was measured
        # One power for each thrust: the mean of the lines that share it.
        self._thrust, place = np.unique(thrust, return_inverse=True)
        self._power = np.bincount(place, power) / np.bincount(place)
        self.reverse, self.forward = float(self._thrust[0]), float(self._thrust[-1])  # N

    def power(self, thrust: Reals) -> Reals:
        """Of a thrust [N], forward positive, in W; of one beyond the table that at its end."""
        power: Reals = np.interp(thrust, self._thrust, self._power)
        return power

    def thrust(self, pulse: float) -> float:
        """Of a pulse width [us], in N; of one beyond the table that at its end."""
        return float(np.interp(pulse, self._pulses, self._of_pulses))

    def pulse(self, thrust: float) -> float:
        """The pulse width [us] of a thrust [N]; of none, the middle of the dead band; beyond the table, its end."""
        if thrust == 0.0:
            return float(self._pulses[self._of_pulses == 0.0].mean())
        return float(np.interp(thrust, self._of_pulses, self._pulses))

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
    known = _table(thruster)[1]
    return float(known[0]), float(known[-1])


@functools.cache
def _table(thruster: str) -> tuple[Reals, Reals, Reals, Reals]:
    """Pulse widths [us] (n,), voltages [V] (m,), and over both thrust [kgf] and power [W], (n, m) each."""
    text = files(__package__).joinpath(TABLES[thruster]).read_text(encoding="utf-8")
    lines = [line for line in text.splitlines() if not line.startswith("#")]
    known = np.array([float(head.split()[1]) for head in lines[0].split(",")[1::2]])
    values = np.array([[float(v) for v in line.split(",")] for line in lines[1:]])
    return values[:, 0], known, values[:, 1::2], values[:, 2::2]
