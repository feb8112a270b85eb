"""A simulated ArduSub: what it is and in which state, apart from where it is."""

from __future__ import annotations

import time
from collections import deque
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from .frame import Frame
from .parameters import Parameters
from .sample import Sample

if TYPE_CHECKING:
    from .control import Control

VERSION = (4, 5, 3)
HASH = "6f726368"  # "orch" in hexadecimal, where ArduPilot has the first digits of its commit
BANNER = (f"ArduSub V{'.'.join(map(str, VERSION))} ({HASH})", "Frame: VECTORED")

# custom_mode of ArduSub
MODES = {
    "STABILIZE": 0,
    "ACRO": 1,
    "ALT_HOLD": 2,
    "AUTO": 3,
    "GUIDED": 4,
    "CIRCLE": 7,
    "SURFACE": 9,
    "POSHOLD": 16,
    "MANUAL": 19,
    "MOTOR_DETECT": 20,
    "SURFTRAK": 21,
}
MODE_NAMES = {number: name for name, number in MODES.items()}
GUIDING = (MODES["AUTO"], MODES["GUIDED"], MODES["CIRCLE"], MODES["POSHOLD"])  # ArduSub's base_mode()

MOST_SAMPLES = 256  # that the bridge's thread may leave unseen

CUSTOM, STABILIZE, MANUAL_INPUT, GUIDED, ARMED = 1, 16, 64, 8, 128  # MAV_MODE_FLAG
STANDBY, ACTIVE = 3, 4  # MAV_STATE


@dataclass
class Autopilot:
    """component: the vehicle's name in the experiment; frame: None where it has no thruster matrix; control: where
    steering goes, None where nobody listens; samples: each with the time (monotonic) [s] from which it holds."""

    system: int
    component: str
    parameters: Parameters
    origin: tuple[float, float]
    frame: Frame | None = None
    control: Control | None = None
    mode: int = MODES["GUIDED"]
    armed: bool = True
    samples: deque[tuple[float, Sample]] = field(default_factory=lambda: deque(maxlen=MOST_SAMPLES))

    def show(self, sample: Sample, due: float = 0.0) -> None:
        """The run calls this, and the bridge's thread `latest`: neither waits for the other."""
        self.samples.append((due, sample))

    @property
    def latest(self) -> Sample | None:
        """What holds now; None before the first sample."""
        now = time.monotonic()
        while len(self.samples) > 1 and self.samples[1][0] <= now:
            self.samples.popleft()
        return self.samples[0][1] if self.samples else None

    @property
    def base_mode(self) -> int:
        return CUSTOM | STABILIZE | MANUAL_INPUT | ARMED * self.armed | GUIDED * (self.mode in GUIDING)

    @property
    def status(self) -> int:
        return ACTIVE if self.armed else STANDBY

    def directions(self) -> list[float]:
        """MOT_n_DIRECTION of motors 1 to 6: 1 or -1."""
        return [-1.0 if self.parameters[f"MOT_{n}_DIRECTION"] < 0 else 1.0 for n in range(1, 7)]
