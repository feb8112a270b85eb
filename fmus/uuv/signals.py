"""The signals that components exchange: axes, units and meaning, declared once for every model.

A vector signal `eta` becomes the FMI variables `eta.x`, `eta.y`, ...  Frames: NED (x north, y east, z down)
and BODY (x forward, y starboard, z down); symbols after SNAME and Fossen.
"""

from __future__ import annotations

import math

from .modelling.declare import Signal

# What numbers may be; a run warns where they leave it.
POSITIVE = (1e-9, math.inf)  # a divisor
NOT_NEGATIVE = (0.0, math.inf)
NOT_POSITIVE = (-math.inf, 0.0)
HALF_TURN = (-math.pi, math.pi)
TURN_A_SECOND = (-2 * math.pi, 2 * math.pi)  # rad/s; these vehicles turn at a tenth of it, 7 or more are degrees
LARGEST_PITCH = math.radians(85.0)
FASTEST_CURRENT = 10.0  # m/s; the strongest tidal streams run at about 8

POSE = ("x", "y", "z", "phi", "theta", "psi")


def linear_and_angular(linear: str, angular: str) -> tuple[str, ...]:
    """Units of six axes: three along, three about x, y and z."""
    return (linear,) * 3 + (angular,) * 3


# zyx Euler angles are singular at theta = 90 degrees, where 1/cos(theta) enters their rates.
UPRIGHT = {"theta": (-LARGEST_PITCH, LARGEST_PITCH)}

ETA = Signal(POSE, linear_and_angular("m", "rad"), "position in NED and zyx Euler angles", UPRIGHT)
ETA_D = Signal(POSE, ETA.units, "desired position in NED and zyx Euler angles", UPRIGHT | {"phi": HALF_TURN})
ETA_D_DOT = Signal(POSE, linear_and_angular("m/s", "rad/s"), "desired velocity in NED and Euler rates")
ETA_D_DDOT = Signal(POSE, linear_and_angular("m/s2", "rad/s2"), "desired acceleration in NED and of the Euler angles")
NU = Signal(("u", "v", "w", "p", "q", "r"), linear_and_angular("m/s", "rad/s"), "velocity in BODY")
TAU = Signal(("X", "Y", "Z", "K", "M", "N"), linear_and_angular("N", "N.m"), "generalized force in BODY")
U = Signal(("T1", "T2", "T3", "T4", "T5", "T6"), "1", "normalized thruster command, -1 to 1", (-1.0, 1.0))
V_C = Signal(("x", "y", "z"), "m/s", "current velocity in NED", (-FASTEST_CURRENT, FASTEST_CURRENT))
SPECIFIC_FORCE = Signal(("x", "y", "z"), "m/s2", "specific force in BODY: what an accelerometer at its origin reads")

# Units of gains: generalized force per error of pose, per its rate, per its integral.
FORCE_PER_POSE = linear_and_angular("N/m", "N.m/rad")
FORCE_PER_RATE = linear_and_angular("N.s/m", "N.m.s/rad")
FORCE_PER_INTEGRAL = linear_and_angular("N/m/s", "N.m/rad/s")
