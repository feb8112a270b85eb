"""Steering from outside: the last request of a ground station to a vehicle, kept for the component that follows it.

The bridge's thread writes, the loop reads; each value is replaced as a whole, so that neither waits for the other.
"""

from __future__ import annotations

import time
from dataclasses import dataclass

from .frame import REST, SPAN


@dataclass(frozen=True, kw_only=True)
class Stick:
    """Demands of a joystick, each in -1..1: surge, sway, heave (down) and yaw; at: when they came (monotonic) [s]."""

    surge: float = 0.0
    sway: float = 0.0
    heave: float = 0.0
    yaw: float = 0.0
    at: float = 0.0


@dataclass(frozen=True, kw_only=True)
class SetPoint:
    """Where to go in mode GUIDED, in NED: position [m], velocity [m/s], yaw [rad], yaw rate [rad/s]; None: as it is."""

    position: tuple[float | None, float | None, float | None] = (None, None, None)
    velocity: tuple[float, float, float] | None = None
    yaw: float | None = None
    yaw_rate: float | None = None


class Control:
    """The steering of one vehicle."""

    def __init__(self) -> None:
        self.stick = Stick()
        self.set_point: SetPoint | None = None
        self.armed = True
        self.guided = False  # mode GUIDED: set points count, the stick does not
        self.timeout = 3.0  # s; FS_PILOT_TIMEOUT

    def demands(self) -> tuple[float, float, float, float]:
        """Surge, sway, heave and yaw in -1..1; neutral if disarmed, in mode GUIDED, or without input for `timeout`."""
        stick = self.stick
        silent = time.monotonic() - stick.at > self.timeout
        if silent or self.guided or not self.armed:
            return 0.0, 0.0, 0.0, 0.0
        return stick.surge, stick.sway, stick.heave, stick.yaw

    def target(self) -> SetPoint | None:
        """The set point, if it counts."""
        return self.set_point if self.guided and self.armed else None

    def channels(self) -> list[int]:
        """Input channels 1 to 8 as ArduSub would read them [us]: pitch, roll, throttle, yaw, forward, lateral, 7, 8."""
        surge, sway, heave, yaw = self.demands()
        return [REST, REST, *(round(REST + SPAN * demand) for demand in (-heave, yaw, surge, sway)), REST, REST]
