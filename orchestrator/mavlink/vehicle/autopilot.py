"""A simulated ArduSub: what it is and which state it is in.  Where it is, its samples say."""

from __future__ import annotations

import time
from collections import deque
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from .frame import ThrusterFrame
from .modes import FlightMode
from .parameters import AutopilotParameters
from .sample import Sample

if TYPE_CHECKING:
    from .control import Control

VERSION = (4, 5, 3)
HASH = "6f726368"  # "orch" in hexadecimal, where ArduPilot has the first digits of its commit
BANNER = (f"ArduSub V{'.'.join(map(str, VERSION))} ({HASH})", "Frame: VECTORED")

MOST_SAMPLES = 256  # that may wait for the bridge's thread; the oldest are dropped


@dataclass(kw_only=True)
class Autopilot:
    """The autopilot of one vehicle.

    system: MAVLink system id.  component: the vehicle's name in the experiment.  origin: latitude and longitude of NED
    (0, 0, 0) [degrees].  frame: None if the vehicle has no thruster matrix.  control: where steering goes, which has
    mode and arming, too; None if no component takes it.  samples: each with the time (monotonic) [s] from which it
    holds.
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

    def __post_init__(self) -> None:
        if self.control:
            self.mode, self.armed = self.control.mode, self.control.armed
            self.control.parameters, self.control.gain = self.parameters, self.parameters["JS_GAIN_DEFAULT"]

    def enter(self, mode: FlightMode) -> None:
        """Change the mode of a vehicle that is steered."""
        self.mode = mode
        if self.control:
            self.control.enter(mode)

    def arm(self, armed: bool) -> None:
        """Arm or disarm a vehicle that is steered."""
        self.armed = armed
        if self.control:
            self.control.armed = armed

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
