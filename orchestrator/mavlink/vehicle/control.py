"""Steering from outside: what a ground station last asked of a vehicle, kept for the component that follows it.

The bridge's thread writes, the loop reads; each value is replaced as a whole, so neither waits for the other.
"""

from __future__ import annotations

import time
from dataclasses import dataclass


@dataclass(frozen=True)
class Stick:
    """Demands of a joystick, each in -1..1: surge, sway, heave (down) and yaw, and when they came (monotonic) [s]."""

    surge: float
    sway: float
    heave: float
    yaw: float
    at: float


@dataclass(frozen=True)
class SetPoint:
    """Where to go (GUIDED), all in NED: position [m], velocity [m/s], yaw [rad], yaw rate [rad/s]; None: not asked."""

    position: tuple[float | None, float | None, float | None] = (None, None, None)
    velocity: tuple[float, float, float] | None = None
    yaw: float | None = None
    yaw_rate: float | None = None
    at: float = 0.0


NEUTRAL = Stick(0.0, 0.0, 0.0, 0.0, 0.0)


class Control:
    """The steering of one vehicle."""

    def __init__(self) -> None:
        self.stick = NEUTRAL
        self.set_point: SetPoint | None = None
        self.armed = True
        self.guided = False  # mode GUIDED: set points count, the stick does not
        self.timeout = 3.0  # s; FS_PILOT_TIMEOUT

    def demands(self, now: float | None = None) -> tuple[float, float, float, float]:
        """Surge, sway, heave and yaw in -1..1; neutral when disarmed, guided, or without input for `timeout`."""
        stick = self.stick
        silent = (time.monotonic() if now is None else now) - stick.at > self.timeout
        if silent or self.guided or not self.armed:
            return 0.0, 0.0, 0.0, 0.0
        return stick.surge, stick.sway, stick.heave, stick.yaw

    def target(self) -> SetPoint | None:
        return self.set_point if self.guided and self.armed else None

    def channels(self) -> list[int]:
        """What ArduSub's input channels 1 to 8 would read [us]: pitch, roll, throttle, yaw, forward, lateral."""
        surge, sway, heave, yaw = self.demands()
        return [1500, 1500, *(round(1500 + 400 * demand) for demand in (-heave, yaw, surge, sway)), 1500, 1500]
