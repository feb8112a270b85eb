"""The component `mavlink_motors`: what stands between the controller and the thrusters of a vehicle that is steered.

It is put there for each `mavlink_manual` (`plan.motors`): disarmed, the thrusters rest, and along the motions that the
flight mode does not hold, the pilot's sticks drive them in place of the controller, by the factors of ArduSub's frame.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ...fmu.variables import Variable
from ..vehicle.frame import FACTORS, ThrusterFrame
from ..vehicle.modes import MOTIONS
from .declare import numbered, scalar, vector

if TYPE_CHECKING:
    from ...arrays import Reals

THRUSTERS = 6
COLUMNS = [0, 1, 2, 3, 5]  # of FACTORS: MOTIONS
PASSED = np.ones(1 + len(MOTIONS)).tobytes()  # driven, every motion held: nothing to do, in each of many steps
NOTHING = np.zeros(0)


class MavlinkMotors:
    """Passes thruster commands on, exactly, where the controller holds every motion of an armed vehicle."""

    def __init__(self, name: str, parameters: Mapping[str, Any], context: Mapping[str, Any]) -> None:
        """context: {"frame": the vehicle's ThrusterFrame}; without one the sticks reach no thruster."""
        frame: ThrusterFrame | None = context.get("frame")
        self._factors = None  # (6, 5) commands of full sticks
        if frame is not None:
            self._factors = FACTORS[frame.motors][:, COLUMNS] * np.array(frame.signs)[:, None]
            self._inverse = np.linalg.pinv(self._factors)

    @classmethod
    def variables(cls) -> Sequence[Variable]:
        thrusters = {f"T{n}": "1" for n in range(1, THRUSTERS + 1)}
        motions = dict.fromkeys(MOTIONS, "1")
        return numbered(
            [
                *vector("u_c", "input", thrusters, "normalized thruster command of the controller"),
                scalar("driven", "input", "1", "1: the thrusters are driven; 0: they rest"),
                *vector("held", "input", motions, "1: the controller holds this motion"),
                *vector("stick", "input", motions, "demand of the pilot's stick, -1 to 1"),
                *vector("u", "output", thrusters, "normalized thruster command", depends=None),
            ]
        )

    def start(self, inputs: Reals) -> Reals:
        """Commands (6,).  inputs: (17,) u_c, driven, held, stick."""
        commands, driven, held, stick = inputs[:6], inputs[6], inputs[7:12], inputs[12:17]
        if inputs[6:12].tobytes() == PASSED:
            return commands
        if not driven:
            return np.zeros(THRUSTERS)
        if self._factors is None:
            return commands
        u: Reals = np.clip(self._factors @ np.where(held, self._inverse @ commands, stick), -1.0, 1.0)
        return u

    def listen(self, t: float, inputs: Reals) -> Reals:
        """Nothing: the pilot's component hears."""
        return NOTHING

    def step(self, t: float, h: float, inputs: Reals, heard: Reals) -> Reals:
        return self.start(inputs)

    def close(self) -> None:
        """Nothing is open."""
