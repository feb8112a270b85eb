"""Thrusters in ArduSub's numbering: from the columns of the vehicle's matrix, and what PWM means."""

import math

import numpy as np
import pytest

from orchestrator.errors import OrchError
from orchestrator.mavlink.components.manual import MavlinkManual
from orchestrator.mavlink.vehicle.frame import FACTORS, ThrusterFrame
from orchestrator.mavlink.vehicle.sample import rotation, to_earth, to_ned

c = s = math.sqrt(0.5)
SHIPPED = np.array(
    [
        [c, c, -c, -c, 0, 0],
        [s, -s, s, -s, 0, 0],
        [0, 0, 0, 0, -1, -1],
        [0, 0, 0, 0, 0.115, -0.115],
        [0, 0, 0, 0, 0, 0],
        [0.3536, -0.3536, -0.3536, 0.3536, 0, 0],
    ]
)


def test_the_shipped_matrix_is_ardusubs_frame_with_every_thruster_turned_round():
    frame = ThrusterFrame(SHIPPED)
    assert frame.motors == [1, 0, 3, 2, 5, 4]
    assert frame.signs == [-1] * 6
    assert frame.pwm(np.array([1, 0.5, 0, -0.25, -1, 2])) == [1300, 1100, 1600, 1500, 1100, 1900]


@pytest.mark.parametrize("axis", range(6))
@pytest.mark.parametrize("directions", [(1,) * 6, (1, -1, 1, -1, -1, 1)])
def test_forces_through_ardusubs_mixer_are_those_of_the_vehicle(axis, directions):
    """The sum of deflections times ArduSub's factors has the sign of the force, or there is none on that axis."""
    random = np.random.default_rng(axis)
    frame = ThrusterFrame(SHIPPED)
    for u in random.uniform(-1, 1, (20, 6)):
        deflections = (np.array(frame.pwm(u, directions)) - 1500) / 400 * directions
        force = SHIPPED[axis] @ u
        scale = np.abs(SHIPPED[axis]).max()
        # Rounding to microseconds: six of 0.5 / 400 each.
        assert FACTORS[:, axis] @ deflections * scale == pytest.approx(force, abs=0.01)


@pytest.mark.parametrize("pwm_map", ["linear", "t200_16V"])
def test_commands_survive_the_way_to_pwm_and_back(pwm_map):
    frame = ThrusterFrame(SHIPPED, 39.0, pwm_map)
    u = np.array([0.9, -0.9, 0.3, -0.2, 0.0, 1.0])
    assert frame.u(frame.pwm(u)) == pytest.approx(u, abs=0.01)  # a microsecond is up to 0.4 N
    assert frame.u([0] * 6) == pytest.approx(np.zeros(6))


def test_any_order_and_sense_of_thrusters_is_recognized():
    order, turned = [3, 5, 0, 1, 4, 2], np.array([1, -1, 1, 1, -1, -1])
    frame = ThrusterFrame((FACTORS[order] * turned[:, None]).T * np.array([[3], [2], [1], [0.1], [1], [0.5]]))
    assert frame.motors == order
    assert frame.signs == turned.tolist()


@pytest.mark.parametrize(
    ("matrix", "words"),
    [
        (np.vstack([SHIPPED[:5], 0.3 * SHIPPED[1:2]]), "thruster 3"),  # Eq. 4.10: yaw proportional to sway
        (SHIPPED[:, :5], "6 x 5"),
        (np.zeros((6, 6)), "no force"),
        (SHIPPED[:, [0, 0, 2, 3, 4, 5]], "thruster 2"),
    ],
)
def test_a_matrix_that_is_no_vectored_frame_is_refused_with_a_message(matrix, words):
    with pytest.raises(OrchError, match=words):
        ThrusterFrame(matrix)


@pytest.mark.parametrize(
    ("pulse", "thrust"),  # us, N: lines of the manufacturer's table at 16 V
    [
        (1100, -39.91),
        (1300, -14.12),
        (1448, -1.27),
        (1472, 0),
        (1500, 0),
        (1528, 0),
        (1600, 5.88),
        (1756, 26.77),
        (1900, 51.48),
    ],
)
def test_the_t200s_thrust_is_that_of_its_table(pulse, thrust):
    frame = ThrusterFrame(SHIPPED, 60.0, "t200_16V")
    u = frame.u([pulse] * 6)
    assert u * frame.signs * 60.0 == pytest.approx(thrust, abs=0.005)
    if thrust:
        assert frame.pwm(u) == pytest.approx([pulse] * 6, abs=2)  # a line of the table is 4 us


def test_the_t200s_pulses_lie_outside_its_dead_band_and_end_with_its_range():
    frame = ThrusterFrame(SHIPPED, 1.0, "t200_16V")  # every thruster is turned round
    assert frame.pwm(np.array([0.0] * 6)) == [1500] * 6
    least = frame.pwm(np.array([0.01, -0.01, 0, 0, 0, 0]))
    assert min(least) in (1471, 1472)
    assert max(least) in (1528, 1529)
    strong = ThrusterFrame(SHIPPED, 99.0, "t200_16V").pwm(np.array([1.0, -1.0, 0, 0, 0, 0]))
    assert (min(strong), max(strong)) == (1100, 1900)


def test_places_go_to_earth_and_back():
    origin = (44.65, -124.05)
    latitude, longitude = to_earth(origin, 12.5, -7.25)
    assert to_ned(origin, latitude / 1e7, longitude / 1e7) == pytest.approx((12.5, -7.25), abs=0.02)
    assert to_earth((0.0, 179.9999), 0.0, 50.0)[1] < 0  # beyond the date line


def test_the_rotation_turns_body_axes_into_ned():
    assert rotation(0, 0, math.pi / 2) @ [1, 0, 0] == pytest.approx([0, 1, 0])
    assert rotation(0, math.pi / 2, 0) @ [1, 0, 0] == pytest.approx([0, 0, -1])
    assert rotation(math.pi / 2, 0, 0) @ [0, 1, 0] == pytest.approx([0, 0, 1])
    R = rotation(0.3, -0.4, 1.1)
    assert pytest.approx(rotation(0, 0, 1.1) @ rotation(0, -0.4, 0) @ rotation(0.3, 0, 0)) == R
    assert pytest.approx(np.eye(3)) == R.T @ R


def test_the_declared_variables_of_the_components_are_consistent():
    variables = MavlinkManual.variables()
    assert [v.reference for v in variables] == list(range(len(variables)))
    component = MavlinkManual("manual", {}, {})
    outputs = [v for v in variables if v.causality == "output"]
    assert len(component.start(np.arange(6.0))) == len(outputs)
    with pytest.raises(OrchError, match=r"components\.manual\.parameters\.lag"):
        MavlinkManual("manual", {"lag": 0.0}, {})
