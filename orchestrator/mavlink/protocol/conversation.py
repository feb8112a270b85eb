"""What ground stations ask, and the answers: one function a message.

A message counts when it is for this vehicle (target system 0 or its own) and its autopilot (component 0 or 1).
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from typing import Any

from ..vehicle.autopilot import Autopilot
from ..vehicle.parameters import Parameter
from . import steering, telemetry
from .commands import Command, carry_out, change_mode
from .dialect import AUTOPILOT, message
from .station import Channel

MISSION_TYPES = (0, 1, 2, 255)  # MAV_MISSION_TYPE
MISSION_ACCEPTED, MISSION_UNSUPPORTED, MISSION_INVALID_SEQUENCE = 0, 3, 13  # MAV_MISSION_RESULT
GROUND_STATION = 6  # MAV_TYPE
CUSTOM_MODE = 1

Tell = Callable[[Autopilot, str], None]


class Conversation:
    """tell: sends a text to all stations; echo: a parameter, likewise."""

    def __init__(self, tell: Tell, echo: Callable[[Autopilot, Any], None]):
        self._tell, self._echo = tell, echo
        self._pilots: dict[int, steering.Pilot] = {}

    def handle(self, channel: Channel, asked: Any, now: float) -> None:
        """Answer a message, if it is for this vehicle."""
        system = getattr(asked, "target_system", getattr(asked, "target", 0))
        component = getattr(asked, "target_component", 0)
        if asked.get_type() == "PING":
            system = component = 0 if not asked.target_system else -1  # addressed: an answer to somebody
        if system not in (0, channel.autopilot.system) or component not in (0, AUTOPILOT):
            return
        handler = HANDLERS.get(asked.get_type())
        if handler:
            handler(self, channel, asked, now)

    def _command_long(self, channel: Channel, asked: Any, now: float) -> None:
        parameters = [getattr(asked, f"param{n}") for n in range(1, 8)]
        self._command(channel, asked, parameters, now)

    def _command_int(self, channel: Channel, asked: Any, now: float) -> None:
        parameters = [asked.param1, asked.param2, asked.param3, asked.param4, asked.x / 1e7, asked.y / 1e7, asked.z]
        self._command(channel, asked, parameters, now)

    def _command(self, channel: Channel, asked: Any, parameters: list[float], now: float) -> None:
        result, messages = carry_out(asked.command, Command(parameters, now, time.time(), self._tell), channel)
        channel.send(message("COMMAND_ACK", asked.command, result, 0, 0, *_station(asked)), *messages)

    def _set_mode(self, channel: Channel, asked: Any, now: float) -> None:
        if asked.base_mode & CUSTOM_MODE:
            change_mode(channel.autopilot, asked.custom_mode, self._tell)

    def _data_stream(self, channel: Channel, asked: Any, now: float) -> None:
        channel.set_stream(asked.req_stream_id, asked.req_message_rate if asked.start_stop else None, now)

    def _param_list(self, channel: Channel, asked: Any, now: float) -> None:
        if not channel.busy("parameters"):
            channel.send(*telemetry.banner())
        channel.job("parameters", _parameters(channel.autopilot))

    def _param_read(self, channel: Channel, asked: Any, now: float) -> None:
        parameter = channel.autopilot.parameters.find(asked.param_id, asked.param_index)
        if parameter:
            channel.send(parameter_value(channel.autopilot, parameter))

    def _param_set(self, channel: Channel, asked: Any, now: float) -> None:
        autopilot = channel.autopilot
        parameter = autopilot.parameters.find(asked.param_id)
        if parameter is None:
            return
        if autopilot.parameters.set(asked.param_id, asked.param_value) and asked.param_id.startswith("SR0_"):
            for name in telemetry.STREAMED:
                if telemetry.STREAMED[name][0] == asked.param_id.removeprefix("SR0_"):
                    channel.reset(name, now)
        self._echo(autopilot, parameter_value(autopilot, parameter))

    def _ftp(self, channel: Channel, asked: Any, now: float) -> None:
        answers = list(channel.files.answers(_station(asked), bytes(asked.payload)))
        channel.send(*answers[:1])
        if len(answers) > 1:
            channel.job("ftp", answers[1:])

    def _mission_list(self, channel: Channel, asked: Any, now: float) -> None:
        if asked.mission_type in MISSION_TYPES:
            channel.send(message("MISSION_COUNT", *_station(asked), 0, asked.mission_type))
        else:
            self._mission(channel, asked, MISSION_UNSUPPORTED)

    def _mission_upload(self, channel: Channel, asked: Any, now: float) -> None:
        self._mission(channel, asked, MISSION_UNSUPPORTED)

    def _mission_clear(self, channel: Channel, asked: Any, now: float) -> None:
        self._mission(channel, asked, MISSION_ACCEPTED)

    def _mission_item(self, channel: Channel, asked: Any, now: float) -> None:
        self._mission(channel, asked, MISSION_INVALID_SEQUENCE)

    def _mission(self, channel: Channel, asked: Any, result: int) -> None:
        known = asked.mission_type in MISSION_TYPES
        channel.send(
            message(
                "MISSION_ACK",
                *_station(asked),
                result if known else MISSION_UNSUPPORTED,
                asked.mission_type if known else 0,
            )
        )

    def _timesync(self, channel: Channel, asked: Any, now: float) -> None:
        if asked.tc1 == 0:
            channel.send(message("TIMESYNC", time.monotonic_ns(), asked.ts1))

    def _log_list(self, channel: Channel, asked: Any, now: float) -> None:
        channel.send(message("LOG_ENTRY", 0, 0, 0, 0, 0))

    def _ping(self, channel: Channel, asked: Any, now: float) -> None:
        channel.send(message("PING", asked.time_usec, asked.seq, *_station(asked)))

    def _manual_control(self, channel: Channel, asked: Any, now: float) -> None:
        if self._is_pilot(channel, asked) and asked.target == channel.autopilot.system:
            self._pilot(channel).manual_control(asked, now, self._tell)

    def _override(self, channel: Channel, asked: Any, now: float) -> None:
        if self._is_pilot(channel, asked):
            self._pilot(channel).channels(asked, now)

    def _set_point(self, channel: Channel, asked: Any, now: float) -> None:
        steering.set_point(channel.autopilot, asked, now)

    def _pilot(self, channel: Channel) -> steering.Pilot:
        return self._pilots.setdefault(channel.autopilot.system, steering.Pilot(channel.autopilot))

    def _is_pilot(self, channel: Channel, asked: Any) -> bool:
        return bool(asked.get_srcSystem() == channel.autopilot.parameters["SYSID_MYGCS"])


HANDLERS: dict[str, Callable[[Conversation, Channel, Any, float], None]] = {
    "COMMAND_LONG": Conversation._command_long,
    "COMMAND_INT": Conversation._command_int,
    "SET_MODE": Conversation._set_mode,
    "REQUEST_DATA_STREAM": Conversation._data_stream,
    "PARAM_REQUEST_LIST": Conversation._param_list,
    "PARAM_REQUEST_READ": Conversation._param_read,
    "PARAM_SET": Conversation._param_set,
    "FILE_TRANSFER_PROTOCOL": Conversation._ftp,
    "MISSION_REQUEST_LIST": Conversation._mission_list,
    "MISSION_COUNT": Conversation._mission_upload,
    "MISSION_CLEAR_ALL": Conversation._mission_clear,
    "MISSION_REQUEST_INT": Conversation._mission_item,
    "MISSION_REQUEST": Conversation._mission_item,
    "TIMESYNC": Conversation._timesync,
    "LOG_REQUEST_LIST": Conversation._log_list,
    "PING": Conversation._ping,
    "MANUAL_CONTROL": Conversation._manual_control,
    "RC_CHANNELS_OVERRIDE": Conversation._override,
    "SET_POSITION_TARGET_LOCAL_NED": Conversation._set_point,
}


def parameter_value(autopilot: Autopilot, parameter: Parameter) -> Any:
    """As ArduPilot does: a float of the value, whatever the type."""
    value = parameter.value if math.isfinite(parameter.value) else 0.0
    return message(
        "PARAM_VALUE", parameter.name.encode(), float(value), parameter.type, len(autopilot.parameters), parameter.index
    )


def _parameters(autopilot: Autopilot) -> Iterator[Any]:
    for parameter in autopilot.parameters.all:
        yield parameter_value(autopilot, parameter)


def _station(asked: Any) -> tuple[int, int]:
    return asked.get_srcSystem(), asked.get_srcComponent()
