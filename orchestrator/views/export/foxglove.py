"""Messages that Foxglove's 3D panel draws, and their JSON schemas: poses, tracks and frames of vehicles.

Foxglove, as ROS, has x east, y north, z up (ENU), and of a body x forward, y left, z up (FLU); a record has NED and
FRD.  Positions become (y, x, -z).  World and body are both turned by half a turn about x, the world by a quarter turn
about z besides; so the zyx Euler angles (phi, theta, psi) become (phi, -theta, pi/2 - psi).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from ...arrays import Reals


WORLD = "world"  # the frame of the record's NED origin, turned to ENU
NANOSECONDS = 1_000_000_000


def _object(title: str = "", /, **properties: Any) -> dict[str, Any]:
    named = {"title": title} if title else {}
    return {**named, "type": "object", "properties": properties, "required": list(properties)}


_NUMBER, _TEXT = {"type": "number"}, {"type": "string"}
_TIME = _object(
    "time", sec={"type": "integer", "minimum": 0}, nsec={"type": "integer", "minimum": 0, "maximum": NANOSECONDS - 1}
)
_VECTOR = _object("foxglove.Vector3", x=_NUMBER, y=_NUMBER, z=_NUMBER)
_QUATERNION = _object("foxglove.Quaternion", x=_NUMBER, y=_NUMBER, z=_NUMBER, w=_NUMBER)
_POSE = _object("foxglove.Pose", position=_VECTOR, orientation=_QUATERNION)
POSE = _object("foxglove.PoseInFrame", timestamp=_TIME, frame_id=_TEXT, pose=_POSE)
TRACK = _object("foxglove.PosesInFrame", timestamp=_TIME, frame_id=_TEXT, poses={"type": "array", "items": _POSE})
FRAME = _object(
    "foxglove.FrameTransform",
    timestamp=_TIME,
    parent_frame_id=_TEXT,
    child_frame_id=_TEXT,
    translation=_VECTOR,
    rotation=_QUATERNION,
)


def poses(eta: Mapping[str, Reals]) -> list[dict[str, Any]]:
    """eta: {axis: (N,)}, position in NED and zyx Euler angles [m, rad].  Returns N poses in ENU and FLU."""
    position = np.column_stack([eta["y"], eta["x"], -eta["z"]])
    orientation = quaternion(eta["phi"], -eta["theta"], np.pi / 2 - eta["psi"])
    return [
        {"position": dict(zip("xyz", place, strict=True)), "orientation": dict(zip("xyzw", turn, strict=True))}
        for place, turn in zip(position.tolist(), orientation.tolist(), strict=True)
    ]


def quaternion(phi: Reals, theta: Reals, psi: Reals) -> Reals:
    """Of zyx Euler angles [rad], each (N,).  Returns (N, 4): x, y, z, w."""
    (c1, c2, c3), (s1, s2, s3) = (turn(np.array([phi, theta, psi]) / 2) for turn in (np.cos, np.sin))
    x, y = s1 * c2 * c3 - c1 * s2 * s3, c1 * s2 * c3 + s1 * c2 * s3
    z, w = c1 * c2 * s3 - s1 * s2 * c3, c1 * c2 * c3 + s1 * s2 * s3
    return np.column_stack([x, y, z, w])


def stamp(nanoseconds: int) -> dict[str, int]:
    return {"sec": nanoseconds // NANOSECONDS, "nsec": nanoseconds % NANOSECONDS}


def pose(nanoseconds: int, pose: Mapping[str, Any]) -> dict[str, Any]:
    return {"timestamp": stamp(nanoseconds), "frame_id": WORLD, "pose": pose}


def track(nanoseconds: int, poses: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    return {"timestamp": stamp(nanoseconds), "frame_id": WORLD, "poses": poses}


def frame(nanoseconds: int, name: str, pose: Mapping[str, Any]) -> dict[str, Any]:
    """The body of a vehicle in the world."""
    return {
        "timestamp": stamp(nanoseconds),
        "parent_frame_id": WORLD,
        "child_frame_id": name,
        "translation": pose["position"],
        "rotation": pose["orientation"],
    }
