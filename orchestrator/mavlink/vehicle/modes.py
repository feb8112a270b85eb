"""ArduSub's flight modes: what the autopilot holds in each, and why some cannot be entered here."""

from __future__ import annotations

from enum import IntEnum


class FlightMode(IntEnum):
    """ArduSub's flight modes, HEARTBEAT's custom_mode (ArduSub/mode.h)."""

    STABILIZE = 0
    ACRO = 1
    ALT_HOLD = 2
    AUTO = 3
    GUIDED = 4
    CIRCLE = 7
    SURFACE = 9
    POSHOLD = 16
    MANUAL = 19
    MOTOR_DETECT = 20
    SURFTRAK = 21


# What a vehicle moves along or about.  Pitch is missing: the vectored frame has no thruster for it.
MOTIONS = ("surge", "sway", "heave", "roll", "yaw")

# {mode: the motions that the controller holds at the reference}; the pilot's sticks drive the thrusters of the others
# (ArduSub/mode_manual.cpp, mode_stabilize.cpp, mode_althold.cpp, mode_surface.cpp, mode_poshold.cpp, mode_guided.cpp).
HELD: dict[FlightMode, tuple[str, ...]] = {
    FlightMode.MANUAL: (),
    FlightMode.STABILIZE: ("roll", "yaw"),
    FlightMode.ALT_HOLD: ("heave", "roll", "yaw"),
    FlightMode.SURFACE: ("heave", "roll", "yaw"),
    FlightMode.POSHOLD: MOTIONS,
    FlightMode.GUIDED: MOTIONS,
}

# {mode: why no vehicle enters it}.  A STATUSTEXT has 50 characters.
REFUSED: dict[FlightMode, str] = {
    FlightMode.ACRO: "no pitch thruster to turn with",
    FlightMode.AUTO: "no missions yet",
    FlightMode.CIRCLE: "not simulated",
    FlightMode.MOTOR_DETECT: "the motors are known",
    FlightMode.SURFTRAK: "no rangefinder",
}
