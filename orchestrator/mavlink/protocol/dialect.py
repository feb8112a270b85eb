"""MAVLink's messages and constants, as pymavlink generates them: ArduPilot's dialect of MAVLink 2.

Importing this module raises OrchError if pymavlink is missing or too old.
"""

from __future__ import annotations

from ...errors import OrchError

__all__ = ["AUTOPILOT", "Message", "mavlink"]

try:
    from pymavlink.dialects.v20 import ardupilotmega as mavlink
    from pymavlink.dialects.v20.ardupilotmega import MAVLink_message as Message

    mavlink.MAV_FTP_OPCODE_ACK  # noqa: B018  # releases before 2.4.50 lack the constants of FTP
except (ImportError, AttributeError):
    remedy = 'pip install --upgrade "orch[mavlink]"'
    raise OrchError(f"MAVLink needs pymavlink 2.4.50 or later, not installed here: {remedy}") from None

AUTOPILOT: int = mavlink.MAV_COMP_ID_AUTOPILOT1  # the only component that ground stations take for a vehicle
