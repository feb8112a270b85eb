"""MAVLink's messages, as pymavlink generates them: ArduPilot's dialect."""

from __future__ import annotations

from functools import cache
from typing import Any

from ...errors import OrchError

AUTOPILOT = 1  # MAV_COMP_ID_AUTOPILOT1: ground stations make a vehicle of this component only


@cache
def mavlink() -> Any:
    """The dialect's module.  Raises OrchError where pymavlink is not installed."""
    try:
        from pymavlink.dialects.v20 import ardupilotmega
    except ImportError:
        raise OrchError('MAVLink needs pymavlink, not installed here: pip install "orch[mavlink]"') from None
    return ardupilotmega


def message(name: str, *fields: Any) -> Any:
    """A message by its name, such as "HEARTBEAT"."""
    return getattr(mavlink(), f"MAVLink_{name.lower()}_message")(*fields)


@cache
def known_ids() -> frozenset[int]:
    return frozenset(mavlink().mavlink_map)


@cache
def id_of(name: str) -> int:
    return int(getattr(mavlink(), f"MAVLink_{name.lower()}_message").id)
