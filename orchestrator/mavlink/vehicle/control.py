"""Steering from outside: what ground stations last asked of a vehicle, kept for the component that follows it.

The bridge's thread writes, the loop reads; each value is replaced as a whole, so that neither waits for the other.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from .frame import REST, SPAN
from .modes import HELD, MOTIONS, REFUSED, FlightMode

if TYPE_CHECKING:
    from .parameters import AutopilotParameters

PITCH, ROLL, THROTTLE, YAW, FORWARD, LATERAL = range(1, 7)  # input channels (RCMAP_*)
CHANNELS = 18
ALWAYS_SHOWN = 8  # of them
VELOCITY_TIMEOUT = 3.0  # s; GUIDED_POSVEL_TIMEOUT_MS (ArduSub/mode_guided.cpp)
DEFAULT_TIMEOUT = 3.0  # s; RC_OVERRIDE_TIME and FS_PILOT_TIMEOUT of a vehicle that nobody shows
DEFAULT_SURFACE = -10.0  # cm; SURFACE_DEPTH likewise


@dataclass(frozen=True, kw_only=True)
class Override:
    """What an input channel is overridden with.

    pulse: us.  at: when it came (monotonic) [s].  joystick: it came by MANUAL_CONTROL.
    """

    pulse: float
    at: float
    joystick: bool = False


@dataclass(frozen=True, kw_only=True)
class SetPoint:
    """Where to go, in NED: position [m], velocity [m/s], roll and yaw [rad], yaw rate [rad/s]; None: as it is.

    turn: how fast to turn to the yaw [rad/s].  at: when it came (monotonic) [s]; velocity and yaw rate count for
    VELOCITY_TIMEOUT from then on.
    """

    position: tuple[float | None, float | None, float | None] = (None, None, None)
    velocity: tuple[float, float, float] | None = None
    roll: float | None = None
    yaw: float | None = None
    yaw_rate: float | None = None
    turn: float | None = None
    at: float = 0.0


class Control:
    """The steering of one vehicle.

    stops: whether its thrusters can be stopped, for their commands come through orch's own component; mixes: whether
    that component also knows its frame, and so can drive them by the sticks.  fastest, quickest: the largest horizontal
    speed [m/s] and yaw rate [rad/s] of the reference.
    """

    def __init__(
        self,
        *,
        armed: bool = True,
        mode: FlightMode = FlightMode.POSHOLD,
        holds_disarmed: bool = False,
        stops: bool = False,
        mixes: bool = False,
        fastest: float = math.inf,
        quickest: float = math.inf,
    ) -> None:
        self.armed, self.mode = armed, mode
        self.holds_disarmed, self.stops, self.mixes = holds_disarmed, stops, mixes
        self.fastest, self.quickest = fastest, quickest
        self.parameters: AutopilotParameters | None = None  # of the autopilot that shows the vehicle
        self.overrides: Mapping[int, Override] = {}  # by input channel, from 1
        self.set_point: SetPoint | None = None
        self.speed: float | None = None  # m/s, horizontal, on the way to set points; None: as the component has it
        self.gain = 0.5  # of the joystick

    def refusal(self, mode: FlightMode) -> str:
        """Why the vehicle cannot enter a mode; "" if it can."""
        if mode in REFUSED:
            return REFUSED[mode]
        held_by_reference = mode in (FlightMode.POSHOLD, FlightMode.GUIDED, FlightMode.SURFACE)
        return "" if self.mixes or held_by_reference else "no access to its thrusters"

    def enter(self, mode: FlightMode) -> None:
        self.mode, self.set_point = mode, None

    def held(self) -> tuple[str, ...]:
        """The motions that the controller holds; all where the sticks have no way to the thrusters."""
        return HELD[self.mode] if self.mixes else MOTIONS

    def sticks(self) -> tuple[float, float, float, float, float]:
        """Where the sticks are, in -1..1: surge, sway, heave (down), roll, yaw."""
        surge, sway, up, roll, yaw = map(self._demand, (FORWARD, LATERAL, THROTTLE, ROLL, YAW))
        return surge, sway, -up, roll, yaw

    def demands(self) -> tuple[float, float, float, float, float]:
        """The sticks as far as they count: neutral if disarmed or in mode GUIDED, and up and down in mode SURFACE."""
        if not self.armed or self.mode == FlightMode.GUIDED:
            return 0.0, 0.0, 0.0, 0.0, 0.0
        surge, sway, heave, roll, yaw = self.sticks()
        return surge, sway, 0.0 if self.mode == FlightMode.SURFACE else heave, roll, yaw

    def target(self) -> SetPoint | None:
        """The set point, as far as it counts now."""
        target = self.set_point
        if not self.armed or self.mode == FlightMode.MANUAL:
            return None
        if target is not None and time.monotonic() - target.at > VELOCITY_TIMEOUT:
            target = replace(target, velocity=None, yaw_rate=None)
        if self.mode == FlightMode.SURFACE:
            return replace(target or SetPoint(), position=(None, None, self._surface()), velocity=None)
        return target

    def channels(self) -> dict[int, int]:
        """Input channels as ArduSub would read them [us]: 1 to 8, and those above that are overridden."""
        shown = {n: self._pulse(n) for n in range(1, CHANNELS + 1)}
        return {
            n: REST if pulse is None else round(pulse)
            for n, pulse in shown.items()
            if n <= ALWAYS_SHOWN or pulse is not None
        }

    def _demand(self, channel: int) -> float:
        pulse = self._pulse(channel)
        return 0.0 if pulse is None else max(-1.0, min(1.0, (pulse - REST) / SPAN))

    def _pulse(self, channel: int) -> float | None:
        """What a channel is overridden with [us]; None: it is released, or timed out."""
        override = self.overrides.get(channel)
        if override is None:
            return None
        age, limit = time.monotonic() - override.at, self._parameter("RC_OVERRIDE_TIME", DEFAULT_TIMEOUT)
        if limit >= 0 and age >= limit:  # 0: overrides are off; negative: they last
            return None
        if override.joystick and age > self._parameter("FS_PILOT_TIMEOUT", DEFAULT_TIMEOUT):
            return None
        return override.pulse

    def _surface(self) -> float:
        """Depth of a vehicle at the surface [m]."""
        return -self._parameter("SURFACE_DEPTH", DEFAULT_SURFACE) / 100

    def _parameter(self, name: str, default: float) -> float:
        return default if self.parameters is None else self.parameters[name]
