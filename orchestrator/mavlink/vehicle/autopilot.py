"""A simulated ArduSub: what it is and which state it is in.  Where it is, its samples say."""

from __future__ import annotations

import time
from collections import deque
from dataclasses import dataclass, field
from enum import IntEnum
from typing import TYPE_CHECKING

from .frame import ThrusterFrame
from .parameters import AutopilotParameters
from .sample import Sample

if TYPE_CHECKING:
    from .control import Control

VERSION = (4, 5, 3)
HASH = "6f726368"  # "orch" in hexadecimal, where ArduPilot has the first digits of its commit
BANNER = (f"ArduSub V{'.'.join(map(str, VERSION))} ({HASH})", "Frame: VECTORED")

MOST_SAMPLES = 256  # that may wait for the bridge's thread; the oldest are dropped


class FlightMode(IntEnum):
    """ArduSub's flight modes, HEARTBEAT's custom_mode (ArduSub/mode.h)."""

    STABILIZE = 0
    ACRO = 1
    ALT_HOLD = 2
    AUTO = 3
    GUIDED = 4
    CIRCLE = 7
    SURFACE = 9
    POSHOLD = 16
    MANUAL = 19
    MOTOR_DETECT = 20
    SURFTRAK = 21


@dataclass(kw_only=True)
class Autopilot:
    """The autopilot of one vehicle.

    system: MAVLink system id.  component: the vehicle's name in the experiment.  origin: latitude and longitude of NED
    (0, 0, 0) [degrees].  frame: None if the vehicle has no thruster matrix.  control: where steering goes, None if no
    component takes it.  samples: each with the time (monotonic) [s] from which it holds.
    """

    system: int
    component: str
    parameters: AutopilotParameters
    origin: tuple[float, float]
    frame: ThrusterFrame | None = None
    control: Control | None = None
    mode: FlightMode = FlightMode.GUIDED
    armed: bool = True
    samples: deque[tuple[float, Sample]] = field(default_factory=lambda: deque(maxlen=MOST_SAMPLES))

    def show(self, sample: Sample, due: float = 0.0) -> None:
        """Add a sample that holds from `due` on.  The run calls this, the bridge's thread `latest`: neither waits."""
        self.samples.append((due, sample))

    @property
    def latest(self) -> Sample | None:
        """The sample that holds now; None before the first one."""
        now = time.monotonic()
        while len(self.samples) > 1 and self.samples[1][0] <= now:
            self.samples.popleft()
        return self.samples[0][1] if self.samples else None

    def directions(self) -> list[float]:
        """MOT_n_DIRECTION of motors 1 to 6: 1 or -1."""
        return [-1.0 if self.parameters[f"MOT_{n}_DIRECTION"] < 0 else 1.0 for n in range(1, 7)]
