"""Names of signals: vehicle1.eta is a vector, vehicle1.eta.x one of its axes."""

from __future__ import annotations

import fnmatch

ETA_AXES = ("x", "y", "z", "phi", "theta", "psi")  # position in NED and zyx Euler angles
ANGLE_AXES = ETA_AXES[3:]
NU_AXES = ("u", "v", "w", "p", "q", "r")  # velocity in BODY
ETA_UNITS = dict(zip(ETA_AXES, ("m", "m", "m", "rad", "rad", "rad"), strict=True))  # {axis: unit}
NU_UNITS = dict(zip(NU_AXES, ("m/s", "m/s", "m/s", "rad/s", "rad/s", "rad/s"), strict=True))


def split_axis(name: str) -> tuple[str, str]:
    """("eta", "x") of "eta.x", ("K", "1,2") of "K[1,2]", (name, "") of a scalar."""
    if name.endswith("]"):
        head, _, axis = name[:-1].rpartition("[")
    else:
        head, _, axis = name.rpartition(".")
    return (head, axis) if head and axis else (name, "")


def matches(name: str, pattern: str) -> bool:
    """Whether a signal, or the vector that it belongs to, fits a glob."""
    vector = name.rpartition(".")[0] if not name.endswith("]") else name.rpartition("[")[0]
    return name == pattern or fnmatch.fnmatchcase(name, pattern) or fnmatch.fnmatchcase(vector, pattern)
