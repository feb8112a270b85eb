"""Requests of ground stations and their answers: one function for each message.

A message is answered if it is for this vehicle (target system 0 or its own) and its autopilot (component 0 or 1).
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator

from ..vehicle.autopilot import Autopilot
from ..vehicle.parameters import AutopilotParameter, ParameterType, has_effect
from ..vehicle.sample import E7
from . import steering, telemetry
from .commands import (
    ACCEPTED,
    DENIED,
    FAILED,
    HOME_STAYS,
    NO_CUSTOM_MODE,
    WARNING,
    Announce,
    Command,
    carry_out,
    change_mode,
)
from .dialect import AUTOPILOT, Message, mavlink
from .station import VehicleChannel

MISSION_TYPES = (
    mavlink.MAV_MISSION_TYPE_MISSION,
    mavlink.MAV_MISSION_TYPE_FENCE,
    mavlink.MAV_MISSION_TYPE_RALLY,
    mavlink.MAV_MISSION_TYPE_ALL,
)
PARAMETER_TYPES = {
    ParameterType.INT8: mavlink.MAV_PARAM_TYPE_INT8,
    ParameterType.INT16: mavlink.MAV_PARAM_TYPE_INT16,
    ParameterType.INT32: mavlink.MAV_PARAM_TYPE_INT32,
    ParameterType.FLOAT: mavlink.MAV_PARAM_TYPE_REAL32,
}
EVERYBODY = 0  # as target system or component
NO_MISSIONS = "Mission refused: no missions yet"
AGAIN = 5.0  # s, before the same refusal is announced again


class Conversation:
    """Answers the requests of all stations.  echo: sends a message of a vehicle to all stations."""

    def __init__(self, announce: Announce, echo: Callable[[Autopilot, Message], None]):
        self._announce, self._echo = announce, echo
        self._pilots: dict[int, steering.Pilot] = {}
        self._refused: dict[tuple[int, str], float] = {}  # {system id and text: when it was sent last (monotonic) [s]}

    def handle(self, channel: VehicleChannel, request: Message, now: float) -> None:
        """Answer a message if it is for this vehicle.  now: monotonic [s]."""
        if not _is_for(request, channel.autopilot):
            return
        handler = HANDLERS.get(request.get_type())
        if handler:
            handler(self, channel, request, now)

    def _command_long(self, channel: VehicleChannel, request: Message, now: float) -> None:
        parameters = [getattr(request, f"param{n}") for n in range(1, 8)]
        self._command(channel, request, parameters, None, now)

    def _command_int(self, channel: VehicleChannel, request: Message, now: float) -> None:
        first = [getattr(request, f"param{n}") for n in range(1, 5)]
        self._command(channel, request, [*first, request.x / E7, request.y / E7, request.z], request.frame, now)

    def _command(
        self, channel: VehicleChannel, request: Message, parameters: list[float], frame: int | None, now: float
    ) -> None:
        command = Command(parameters=parameters, frame=frame, now=now, wall=time.time(), announce=self._announce)
        result, messages = carry_out(request.command, command, channel)
        self._acknowledge(channel, request, request.command, result)
        channel.send(*messages)

    def _acknowledge(self, channel: VehicleChannel, request: Message, number: int, result: int) -> None:
        channel.send(
            mavlink.MAVLink_command_ack_message(
                command=number, result=result, progress=0, result_param2=0, **_to_sender(request)
            )
        )

    def _set_mode(self, channel: VehicleChannel, request: Message, now: float) -> None:
        """Answered by a COMMAND_ACK although it is no command, as ArduPilot does."""
        result = DENIED
        if request.base_mode & mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED:
            entered = change_mode(channel.autopilot, request.custom_mode, self._announce)
            result = ACCEPTED if entered else FAILED
        else:
            self._announce(channel.autopilot, NO_CUSTOM_MODE, WARNING)
        self._acknowledge(channel, request, mavlink.MAVLINK_MSG_ID_SET_MODE, result)

    def _data_stream(self, channel: VehicleChannel, request: Message, now: float) -> None:
        channel.set_stream(request.req_stream_id, request.req_message_rate if request.start_stop else None, now)

    def _param_list(self, channel: VehicleChannel, request: Message, now: float) -> None:
        if not channel.is_answering("parameters"):
            channel.send(*telemetry.banner())
        channel.answer_slowly("parameters", _parameters(channel.autopilot))

    def _param_read(self, channel: VehicleChannel, request: Message, now: float) -> None:
        parameter = channel.autopilot.parameters.find(request.param_id, request.param_index)
        if parameter:
            channel.send(parameter_value(channel.autopilot, parameter))

    def _param_set(self, channel: VehicleChannel, request: Message, now: float) -> None:
        autopilot = channel.autopilot
        parameter = autopilot.parameters.find(request.param_id)
        if parameter is None:
            return
        name, before = request.param_id, parameter.value
        if not autopilot.parameters.set(name, request.param_value):
            self._refuse(channel, f"{name} cannot be set to this", now)
        elif name == "JS_GAIN_DEFAULT" and autopilot.control:
            autopilot.control.gain = parameter.value
        elif name.startswith("SR0_"):
            for message, (stream, _) in telemetry.STREAMED.items():
                if stream == name.removeprefix("SR0_"):
                    channel.reset(message, now)
        elif parameter.value != before and not has_effect(name):
            self._refuse(channel, f"{name} has no effect here", now)
        self._echo(autopilot, parameter_value(autopilot, parameter))

    def _ftp(self, channel: VehicleChannel, request: Message, now: float) -> None:
        answers = list(channel.file.answers(_sender(request), bytes(request.payload)))
        channel.send(*answers[:1])
        if len(answers) > 1:
            channel.answer_slowly("ftp", answers[1:])

    def _mission_list(self, channel: VehicleChannel, request: Message, now: float) -> None:
        if request.mission_type in MISSION_TYPES:
            channel.send(
                mavlink.MAVLink_mission_count_message(**_to_sender(request), count=0, mission_type=request.mission_type)
            )
        else:
            self._mission(channel, request, mavlink.MAV_MISSION_UNSUPPORTED)

    def _mission_upload(self, channel: VehicleChannel, request: Message, now: float) -> None:
        self._mission(channel, request, mavlink.MAV_MISSION_UNSUPPORTED)
        self._refuse(channel, NO_MISSIONS, now)

    def _mission_current(self, channel: VehicleChannel, request: Message, now: float) -> None:
        self._refuse(channel, NO_MISSIONS, now)

    def _mission_clear(self, channel: VehicleChannel, request: Message, now: float) -> None:
        self._mission(channel, request, mavlink.MAV_MISSION_ACCEPTED)

    def _mission_item(self, channel: VehicleChannel, request: Message, now: float) -> None:
        self._mission(channel, request, mavlink.MAV_MISSION_INVALID_SEQUENCE)

    def _mission(self, channel: VehicleChannel, request: Message, result: int) -> None:
        known = request.mission_type in MISSION_TYPES
        channel.send(
            mavlink.MAVLink_mission_ack_message(
                **_to_sender(request),
                type=result if known else mavlink.MAV_MISSION_UNSUPPORTED,
                mission_type=request.mission_type if known else mavlink.MAV_MISSION_TYPE_MISSION,
            )
        )

    def _timesync(self, channel: VehicleChannel, request: Message, now: float) -> None:
        if request.tc1 == 0:  # else it is an answer
            channel.send(mavlink.MAVLink_timesync_message(tc1=time.monotonic_ns(), ts1=request.ts1))

    def _log_list(self, channel: VehicleChannel, request: Message, now: float) -> None:
        channel.send(mavlink.MAVLink_log_entry_message(id=0, num_logs=0, last_log_num=0, time_utc=0, size=0))

    def _ping(self, channel: VehicleChannel, request: Message, now: float) -> None:
        channel.send(mavlink.MAVLink_ping_message(time_usec=request.time_usec, seq=request.seq, **_to_sender(request)))

    def _manual_control(self, channel: VehicleChannel, request: Message, now: float) -> None:
        if request.target == channel.autopilot.system and self._is_pilot(channel, request, now):
            self._refuse(channel, self._pilot(channel).manual_control(request, now, self._announce), now)

    def _override(self, channel: VehicleChannel, request: Message, now: float) -> None:
        if self._is_pilot(channel, request, now):
            self._refuse(channel, self._pilot(channel).channels(request, now), now)

    def _set_origin(self, channel: VehicleChannel, request: Message, now: float) -> None:
        """Refused; the answer is where the origin is."""
        self._refuse(channel, HOME_STAYS, now)
        if (at := channel.autopilot.latest) is not None:
            channel.send(*telemetry.global_origin(channel.autopilot, at, time.time()))

    def _set_point(self, channel: VehicleChannel, request: Message, now: float) -> None:
        self._refuse(channel, steering.SET_POINTS[request.get_type()](channel.autopilot, request, now), now)

    def _refuse(self, channel: VehicleChannel, text: str, now: float) -> None:
        """Announce why something is not done, unless "".  What is sent many times a second is refused now and then."""
        key = channel.autopilot.system, text
        if text and now - self._refused.get(key, -AGAIN) >= AGAIN:
            self._refused[key] = now
            self._announce(channel.autopilot, text, WARNING)

    def _pilot(self, channel: VehicleChannel) -> steering.Pilot:
        return self._pilots.setdefault(channel.autopilot.system, steering.Pilot(channel.autopilot))

    def _is_pilot(self, channel: VehicleChannel, request: Message, now: float) -> bool:
        """Whether the sticks are those of the station that steers; others are told, unlike by ArduSub."""
        sender, pilot = request.get_srcSystem(), round(channel.autopilot.parameters["SYSID_MYGCS"])
        if sender != pilot:
            self._refuse(channel, f"Sticks of system {sender} ignored: SYSID_MYGCS is {pilot}", now)
        return bool(sender == pilot)


HANDLERS: dict[str, Callable[[Conversation, VehicleChannel, Message, float], None]] = {
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
    "MISSION_ITEM": Conversation._mission_upload,
    "MISSION_ITEM_INT": Conversation._mission_upload,
    "MISSION_WRITE_PARTIAL_LIST": Conversation._mission_upload,
    "MISSION_SET_CURRENT": Conversation._mission_current,
    "MISSION_CLEAR_ALL": Conversation._mission_clear,
    "MISSION_REQUEST_INT": Conversation._mission_item,
    "MISSION_REQUEST": Conversation._mission_item,
    "TIMESYNC": Conversation._timesync,
    "LOG_REQUEST_LIST": Conversation._log_list,
    "PING": Conversation._ping,
    "MANUAL_CONTROL": Conversation._manual_control,
    "RC_CHANNELS_OVERRIDE": Conversation._override,
    "SET_GPS_GLOBAL_ORIGIN": Conversation._set_origin,
    "SET_HOME_POSITION": Conversation._set_origin,
    **dict.fromkeys(steering.SET_POINTS, Conversation._set_point),
}


def parameter_value(autopilot: Autopilot, parameter: AutopilotParameter) -> Message:
    """PARAM_VALUE as ArduPilot sends it: the value as a float, whatever its type ("C-cast")."""
    return mavlink.MAVLink_param_value_message(
        param_id=parameter.name.encode(),
        param_value=float(parameter.value) if math.isfinite(parameter.value) else 0.0,
        param_type=PARAMETER_TYPES[parameter.type],
        param_count=len(autopilot.parameters),
        param_index=parameter.index,
    )


def _parameters(autopilot: Autopilot) -> Iterator[Message]:
    for parameter in autopilot.parameters.all:
        yield parameter_value(autopilot, parameter)


def _is_for(request: Message, autopilot: Autopilot) -> bool:
    """Whether a message is for a vehicle's autopilot."""
    if request.get_type() == "PING":
        return bool(request.target_system == EVERYBODY)  # a PING with a target is an answer to somebody
    system = getattr(request, "target_system", getattr(request, "target", EVERYBODY))
    component = getattr(request, "target_component", EVERYBODY)
    return system in (EVERYBODY, autopilot.system) and component in (EVERYBODY, AUTOPILOT)


def _sender(request: Message) -> tuple[int, int]:
    """System and component."""
    return request.get_srcSystem(), request.get_srcComponent()


def _to_sender(request: Message) -> dict[str, int]:
    system, component = _sender(request)
    return {"target_system": system, "target_component": component}
