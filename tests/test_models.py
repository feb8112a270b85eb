"""The physics of `fmus/uuv` and the equations of the shipped models, against closed forms and conservation laws."""

import importlib.util
import itertools
import math
import sys
from types import SimpleNamespace

import casadi as ca
import numpy as np
import pytest

from orchestrator.models import catalogue

sys.path.insert(0, str(catalogue.models_folder()))

from uuv.bluerov2 import BlueROV2Body, BlueROV2Thrusters
from uuv.dynamics import coriolis, damping, mass, pinv_rows, restoring, rk4
from uuv.kinematics import euler_rates, jacobian, rotation
from uuv.modelling.equations import Model, trace
from uuv.tbg import convergence_gain, time_base
from uuv.thrusters import pinv_thruster_matrix, saturate, thruster_matrix

ROUNDING = 1e-13  # a few hundred roundings of numbers of order 1
RANDOM = np.random.default_rng(2026)
ATTITUDES = [np.r_[RANDOM.uniform(-5, 5, 3), RANDOM.uniform(-1.4, 1.4, 3)] for _ in range(5)]
VELOCITIES = [RANDOM.uniform(-2, 2, 6) for _ in range(5)]
G = 9.81  # m/s2


def number(expression):
    """A CasADi expression without symbols as an array."""
    return np.array(ca.DM(ca.SX(expression))).squeeze()


def defaults(*declarations):
    """The declared start values, as attributes."""
    return SimpleNamespace(
        **{
            name: value.start[0]
            for declaration in declarations
            for name, value in vars(declaration).items()
            if getattr(value, "causality", "") == "parameter"
        }
    )


def model_class(name):
    """The class that a shipped model's file defines."""
    spec = importlib.util.spec_from_file_location(f"shipped_{name}", catalogue.shipped()[name])
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    (found,) = [
        value
        for value in vars(module).values()
        if isinstance(value, type) and issubclass(value, Model) and value.__module__ == module.__name__
    ]
    return found


EQUATIONS = {}


class Stepped:
    """A shipped model's equations, stepped without any FMI.  `values`: {variable: numbers} in place of the defaults."""

    def __init__(self, name, **values):
        if name not in EQUATIONS:
            EQUATIONS[name] = trace(model_class(name))
        self.equations, self.layout = EQUATIONS[name], EQUATIONS[name].layout
        self.memory = np.array(self.layout.start())
        self.set(**values)
        self.memory[self.layout.groups["calculated"]] = self._evaluate("calculate")
        self.memory[self.layout.groups["state"]] = self._evaluate("initial")

    def set(self, **values):
        for variable, value in values.items():
            self.memory[self.layout.places[variable]] = value

    def step(self, t, h):
        self.memory[:2] = t, h
        self.memory[self.layout.groups["state"].start :] = self._evaluate("step")
        return self

    def __getitem__(self, variable):
        values = self.memory[self.layout.places[variable]]
        return values if len(values) > 1 else values[0]

    def _evaluate(self, which):
        function = getattr(self.equations, which)
        return np.array(function(self.memory[: function.numel_in()])).ravel()


BODY = defaults(BlueROV2Body)
THRUSTERS = defaults(BlueROV2Thrusters)


# Kinematics


@pytest.mark.parametrize("eta", ATTITUDES)
def test_the_rotation_is_orthogonal_with_determinant_one(eta):
    R = number(rotation(eta))
    np.testing.assert_allclose(R.T @ R, np.eye(3), atol=ROUNDING)
    assert np.linalg.det(R) == pytest.approx(1, abs=ROUNDING)


@pytest.mark.parametrize("eta", ATTITUDES)
def test_the_rotation_is_yaw_after_pitch_after_roll(eta):
    (c1, c2, c3), (s1, s2, s3) = np.cos(eta[3:]), np.sin(eta[3:])
    roll = np.array([[1, 0, 0], [0, c1, -s1], [0, s1, c1]])
    pitch = np.array([[c2, 0, s2], [0, 1, 0], [-s2, 0, c2]])
    yaw = np.array([[c3, -s3, 0], [s3, c3, 0], [0, 0, 1]])
    np.testing.assert_allclose(number(rotation(eta)), yaw @ pitch @ roll, atol=ROUNDING)


@pytest.mark.parametrize(
    ("angles", "body_axis", "ned"),
    [
        ((math.pi / 2, 0, 0), (0, 1, 0), (0, 0, 1)),  # rolled to starboard: the starboard side looks down
        ((0, math.pi / 2, 0), (1, 0, 0), (0, 0, -1)),  # pitched up: the bow looks up
        ((0, 0, math.pi / 2), (1, 0, 0), (0, 1, 0)),  # turned to starboard: the bow looks east
    ],
)
def test_positive_angles_turn_the_way_of_ned_and_frd(angles, body_axis, ned):
    np.testing.assert_allclose(number(rotation(np.r_[0, 0, 0, angles])) @ body_axis, ned, atol=ROUNDING)


@pytest.mark.parametrize("eta", ATTITUDES)
def test_j_is_inverted_by_the_transposed_rotation_and_the_inverse_euler_rates(eta):
    phi, theta = eta[3:5]
    J_inv = np.zeros((6, 6))
    J_inv[:3, :3] = number(rotation(eta)).T
    J_inv[3:, 3:] = [  # Fossen 2011, Eq. 2.27
        [1, 0, -math.sin(theta)],
        [0, math.cos(phi), math.cos(theta) * math.sin(phi)],
        [0, -math.sin(phi), math.cos(theta) * math.cos(phi)],
    ]
    np.testing.assert_allclose(number(jacobian(eta)) @ J_inv, np.eye(6), atol=10 * ROUNDING)  # 1/cos(theta) <= 6


@pytest.mark.parametrize("eta", ATTITUDES)
def test_the_rotation_turns_at_the_rate_that_the_euler_rates_give(eta):
    x, omega = ca.SX.sym("x", 6), np.array([0.3, -0.7, 1.1])
    rate = ca.vertcat(ca.SX(3, 1), euler_rates(x) @ omega)
    R_dot = ca.Function("R_dot", [x], [ca.jtimes(ca.vec(rotation(x)), x, rate)])(eta)
    expected = number(rotation(eta)) @ np.cross(np.eye(3), omega)  # R S(omega)
    np.testing.assert_allclose(np.array(R_dot).reshape(3, 3, order="F"), expected, atol=10 * ROUNDING)


# Rigid body and water


def test_the_mass_matrix_is_that_of_the_thesis():
    M = np.diag([15.5, 23.2, 25.07, 0.28, 0, 0.28])
    M[0, 4], M[1, 3], M[3, 1] = 0.21, -0.21, -0.21
    np.testing.assert_allclose(number(mass(BODY)), M, atol=ROUNDING)


def test_the_mass_matrix_has_rank_five_and_is_positive_definite_without_pitch():
    M = number(mass(BODY))
    assert np.linalg.matrix_rank(M) == 5
    rows = [0, 1, 2, 3, 5]
    assert np.linalg.eigvalsh(M[np.ix_(rows, rows)]).min() > 0


def test_pinv_rows_is_the_moore_penrose_inverse_of_the_mass_and_of_the_thruster_matrix():
    for A in (mass(BODY), thruster_matrix(THRUSTERS)):
        np.testing.assert_allclose(number(pinv_rows(A)), np.linalg.pinv(number(A)), atol=ROUNDING * 10)  # entries <= 4


def test_pinv_rows_is_the_moore_penrose_inverse_of_a_matrix_with_empty_rows_and_columns():
    A = np.zeros((5, 7))
    A[np.ix_([0, 2, 3], [0, 1, 3, 6])] = np.random.default_rng(3).normal(size=(3, 4))
    inverse = number(pinv_rows(ca.sparsify(ca.SX(A))))
    np.testing.assert_allclose(inverse, np.linalg.pinv(A), atol=10 * ROUNDING)


def test_pitch_follows_surge_through_the_inverse_of_the_mass_matrix():
    surge = number(pinv_rows(mass(BODY)))[:, 0]
    assert surge[4] / surge[0] == pytest.approx(0.21 / 15.5, rel=ROUNDING)  # q_dot = 0.01355 u_dot
    assert not surge[[1, 2, 3, 5]].any()


def test_coriolis_without_roll_and_pitch_rate_leaves_the_net_coupling_of_the_thesis():
    for u, v, w, _, _, r in VELOCITIES:
        nu = np.array([u, v, w, 0, 0, r])
        expected = [0, 5 * u * r, 0, 1.87 * v * w, 0, 7.7 * u * v]
        np.testing.assert_allclose(number(coriolis(BODY, nu)) @ nu, expected, atol=100 * ROUNDING)  # terms up to 100


def test_coriolis_does_no_work_between_sway_heave_and_roll_nor_between_roll_and_yaw():
    for nu in VELOCITIES:
        C = number(coriolis(BODY, nu))
        for rows in ([1, 2, 3], [3, 5]):
            block = C[np.ix_(rows, rows)]
            assert block.any()
            np.testing.assert_array_equal(block, -block.T)


def test_coriolis_is_linear_in_the_velocity():
    a, b = VELOCITIES[:2]
    C = number(coriolis(BODY, 2 * a - 3 * b))
    np.testing.assert_allclose(
        C,
        2 * number(coriolis(BODY, a)) - 3 * number(coriolis(BODY, b)),
        atol=1000 * ROUNDING,  # entries up to 250
    )


@pytest.mark.parametrize("nu", VELOCITIES)
def test_damping_takes_power_from_any_motion(nu):
    for axis in (0, 1, 2, 3, 5):
        alone = np.zeros(6)
        alone[axis] = nu[axis]
        assert alone @ number(damping(BODY, alone)) @ alone > 0
    assert nu @ number(damping(BODY, nu)) @ nu > 0


def test_damping_in_surge_is_linear_and_quadratic():
    force = number(damping(BODY, np.array([-2.0, 0, 0, 0, 0, 0]))) @ [-2, 0, 0, 0, 0, 0]
    assert force[0] == pytest.approx(-(4.03 * 2 + 18.18 * 4), rel=ROUNDING)
    assert not force[1:].any()


@pytest.mark.parametrize("eta", ATTITUDES)
def test_restoring_is_the_net_weight_seen_in_the_body_and_its_moment_about_the_centre_of_buoyancy(eta):
    g, R = number(restoring(BODY, eta)), number(rotation(eta))
    np.testing.assert_allclose(-g[:3], R.T @ [0, 0, BODY.W - BODY.B], atol=100 * ROUNDING)  # terms up to 100 N
    moment = np.cross([0, 0, BODY.z_g], R.T @ [0, 0, BODY.W])
    assert -g[3] == pytest.approx(moment[0], abs=10 * ROUNDING)
    assert not g[4:].any()  # pitch is left out


def test_the_vehicle_is_buoyant_by_the_weight_of_two_hundred_grams():
    assert pytest.approx(103.005, abs=1e-9) == BODY.W
    assert pytest.approx(0.2 * G, abs=1e-9) == BODY.B - BODY.W
    assert number(restoring(BODY, np.zeros(6)))[2] > 0  # holding it at depth takes a force downward


# Thrusters


POSITIONS = [(0.135, -0.115), (0.135, 0.115), (-0.135, -0.115), (-0.135, 0.115), (0, -0.115), (0, 0.115)]  # Table 4.5
FORCES = [(1, 1, 0), (1, -1, 0), (-1, 1, 0), (-1, -1, 0), (0, 0, -1), (0, 0, -1)]  # X and Y in units of cos 45 degrees


def test_the_signs_of_the_thruster_matrix_are_those_of_forces_at_the_thrusters_positions():
    T = number(thruster_matrix(THRUSTERS))
    for column, (x, y), force in zip(T.T, POSITIONS, FORCES, strict=True):
        X, Y, Z = force
        np.testing.assert_array_equal(np.sign(column), np.sign([X, Y, Z, y * Z, 0, x * Y - y * X]))


def test_the_thruster_matrix_has_the_levers_of_the_thesis_but_twice_the_yaw():
    T = number(thruster_matrix(THRUSTERS))
    half = math.sqrt(0.5)
    np.testing.assert_allclose(np.abs(T[:2, :4]), half, rtol=ROUNDING)
    np.testing.assert_array_equal(np.abs(T[3, 4:]), 0.115)
    printed = (0.135 + 0.115) * half  # d_x sin(gamma) + d_y cos(gamma), 0.1768
    np.testing.assert_allclose(np.abs(T[5, :4]), 2 * printed, rtol=2e-4)  # fitted to four digits
    assert np.linalg.matrix_rank(T) == 5


def test_four_horizontal_commands_beyond_one_are_scaled_together():
    u = number(saturate(ca.DM([0.5, -2.0, 1.5, 0.25, 0.9, -0.4])))
    np.testing.assert_allclose(u, [0.25, -1, 0.75, 0.125, 0.9, -0.4], rtol=ROUNDING)


def test_the_vertical_commands_are_clipped_each_for_itself():
    u = number(saturate(ca.DM([0.5, -1.0, 0.3, 0.25, 3.0, -1.5])))
    np.testing.assert_array_equal(u, [0.5, -1.0, 0.3, 0.25, 1, -1])


@pytest.mark.parametrize("u", [(1.0, -1.0, 0.3, 0.0, 1.0, -1.0), (0.5, -0.8, 0.3, 0.0, 0.2, -0.9)])
def test_saturation_leaves_commands_within_the_limits_alone(u):
    np.testing.assert_array_equal(number(saturate(ca.DM(u))), u)


@pytest.mark.parametrize("tau", [(20, -15, 30, 1.5, 0, -4), (-60, 10, -20, -2, 0, 3), (0, 0, 79, 0, 0, 0)])
def test_allocation_gives_back_a_force_that_the_thrusters_can_give(tau):
    allocation = Stepped("bluerov2_allocation", tau=tau).step(0, 0)
    assert np.abs(allocation["u"]).max() < 1
    T = number(thruster_matrix(THRUSTERS))
    np.testing.assert_allclose(THRUSTERS.max_thrust * T @ allocation["u"], tau, atol=100 * ROUNDING)  # up to 79 N
    np.testing.assert_allclose(number(pinv_thruster_matrix(THRUSTERS)) @ tau / 40, allocation["u"], atol=ROUNDING)


def test_allocation_keeps_the_direction_of_a_horizontal_force_that_is_too_large():
    wanted = np.array([300.0, -100, 0, 0, 0, 10])
    u = Stepped("bluerov2_allocation", tau=wanted).step(0, 0)["u"]
    given = THRUSTERS.max_thrust * number(thruster_matrix(THRUSTERS)) @ u
    assert np.abs(u).max() == pytest.approx(1, rel=ROUNDING)
    np.testing.assert_allclose(given / given[0], wanted / wanted[0], atol=ROUNDING)


def test_what_the_allocation_commands_the_vehicle_does():
    tau = np.array([20.0, -15, 30, 1.5, 0, -4])
    u = Stepped("bluerov2_allocation", tau=tau).step(0, 0)["u"]
    np.testing.assert_allclose(Stepped("bluerov2_thesis", u=u).step(0, 0)["tau"], tau, atol=100 * ROUNDING)


# Integration


def test_a_runge_kutta_step_is_the_taylor_series_to_order_four():
    h = 0.3
    exact = sum((-2 * h) ** k / math.factorial(k) for k in range(5))
    assert float(rk4(lambda x: -2 * x, ca.DM(1), h)) == pytest.approx(exact, rel=ROUNDING)


def test_halving_the_step_divides_the_vehicles_error_by_sixteen():
    def end(steps):
        # A current and a time in which no relative velocity changes its sign: |nu_r| is smooth only away from zero.
        vehicle = Stepped(
            "bluerov2_thesis",
            v_c=(1, -1, 1),
            u=(0.3, 0.1, -0.2, 0.4, 0.5, -0.5),
            eta_0=(0, 0, 0, 0.2, 0.1, 0.3),
            nu_0=(0.1, 0.2, -0.1, 0.3, 0, 0.5),
        )
        for k in range(steps):
            vehicle.step(k * 0.1 / steps, 0.1 / steps)
        return np.r_[vehicle["eta"], vehicle["nu"]]

    exact = end(640)  # its own error is 1/8^4 of the finest below
    errors = [np.linalg.norm(end(n) - exact) for n in (20, 40, 80)]
    for coarse, fine in itertools.pairwise(errors):
        assert coarse / fine == pytest.approx(16, rel=0.07)  # order 5 adds 6 % and 3 % at these steps


# The vehicle


def neutral(**values):
    return Stepped("bluerov2_thesis", B=BODY.W, eta_0=0, **values)


def surge_command(X):
    """Thruster commands of a surge force [N]."""
    return np.array([1, 1, -1, -1, 0, 0]) * X / (4 * math.sqrt(0.5) * THRUSTERS.max_thrust)


def test_a_neutral_vehicle_at_rest_in_still_water_stays_at_rest():
    vehicle = neutral()
    for k in range(100):
        vehicle.step(k * 0.01, 0.01)
    assert not vehicle["eta"].any()
    assert not vehicle["nu"].any()


def test_surge_under_a_constant_force_follows_the_closed_form():
    X, t_end, steps = 30.0, 0.8, 800
    vehicle = neutral(z_g=0.0, u=surge_command(X))  # z_g = 0: no pitch, one equation (m - X_udot) u_dot = X - ...
    for k in range(steps):
        vehicle.step(k * t_end / steps, t_end / steps)
    m, d, dd = 15.5, 4.03, 18.18
    root = math.sqrt(d * d + 4 * dd * X)
    up, down = (-d + root) / (2 * dd), (-d - root) / (2 * dd)
    decay = up / down * math.exp(-root / m * t_end)
    u = (up - down * decay) / (1 - decay)  # Riccati's equation from rest
    assert vehicle["nu"][0] == pytest.approx(u, rel=1e-10)  # h^4 = 1e-12 and 800 roundings
    assert u < 0.95 * up  # still accelerating: the comparison is not of the end state alone


def test_a_buoyant_vehicle_without_damping_rises_with_constant_acceleration():
    vehicle = Stepped("bluerov2_thesis", eta_0=(0, 0, 10, 0, 0, 0), Z_w=0.0, Z_ww=0.0)
    for k in range(200):
        vehicle.step(k * 0.01, 0.01)
    acceleration = -0.2 * G / 25.07
    np.testing.assert_allclose(vehicle["nu"][2], 2 * acceleration, rtol=1e-12)  # 200 roundings of 10 m
    np.testing.assert_allclose(vehicle["eta"][2], 10 + 2 * acceleration, rtol=1e-12)


def drifting(**values):
    """Sway, heave and roll, coupled; surge, yaw and pitch stay zero."""
    return Stepped("bluerov2_thesis", eta_0=(0, 0, 0, 0.6, 0, 0), nu_0=(0, 0.5, -0.3, 0.8, 0, 0), **values)


def energy(vehicle):
    """Kinetic energy with added mass, and the potential of weight and buoyancy [J]."""
    nu, eta = vehicle["nu"], vehicle["eta"]
    potential = -(BODY.W - BODY.B) * eta[2] - BODY.z_g * BODY.W * math.cos(eta[3])
    return nu @ number(mass(BODY)) @ nu / 2 + potential


UNDAMPED = dict.fromkeys(("Y_v", "Y_vv", "Z_w", "Z_ww", "K_p", "K_pp"), 0.0)


def test_sway_heave_and_roll_conserve_energy_without_damping():
    vehicle = drifting(**UNDAMPED)
    start, energies = energy(vehicle), []
    for k in range(2000):
        energies.append(energy(vehicle.step(k * 1e-3, 1e-3)))
    np.testing.assert_allclose(energies, start, rtol=1e-11)  # h^4 = 1e-12 and 2000 roundings
    assert not vehicle["nu"][[0, 4, 5]].any()
    assert abs(vehicle["eta"][3] - 0.6) > 0.1  # it did move


def test_damping_only_takes_energy():
    vehicle = drifting()
    energies = [energy(vehicle)]
    for k in range(1000):
        energies.append(energy(vehicle.step(k * 1e-3, 1e-3)))
    assert np.diff(energies).max() < 0


@pytest.mark.parametrize("v_c", [(0.75, 0.25, 0.3), (-0.5, 0.4, 0.0)])
def test_a_neutral_vehicle_that_drifts_with_the_current_feels_no_force(v_c):
    eta_0 = np.array([0, 0, 0, 0, 0.2, 0.7])  # no roll, no roll moment
    vehicle = Stepped("bluerov2_thesis", B=BODY.W, eta_0=eta_0, v_c=v_c)
    vehicle.set(nu=np.r_[number(rotation(eta_0)).T @ v_c, 0, 0, 0])
    for k in range(100):
        vehicle.step(k * 0.01, 0.01)
    np.testing.assert_allclose(vehicle["eta"], eta_0 + np.r_[v_c, 0, 0, 0], atol=1e-12)  # 100 roundings


# Time base


def test_the_time_base_runs_from_zero_to_one_at_rest_at_both_ends():
    for s, xi in ((0.0, 0.0), (0.5, 0.5), (1.0, 1.0)):
        assert float(time_base(s)[0]) == pytest.approx(xi, abs=ROUNDING)
    for s in (0.0, 1.0):
        assert [float(d) for d in time_base(s)[1:]] == [0, 0]
    assert float(time_base(0.5)[1]) == pytest.approx(1.875, abs=ROUNDING)


def test_the_derivatives_of_the_time_base_are_exact():
    s = ca.SX.sym("s")
    xi, xi_s, xi_ss = time_base(s)
    difference = ca.Function("d", [s], [ca.jacobian(xi, s) - xi_s, ca.jacobian(xi_s, s) - xi_ss])
    for at in np.linspace(0, 1, 11):
        np.testing.assert_allclose([float(d) for d in difference(at)], 0, atol=100 * ROUNDING)  # terms up to 60


def test_the_convergence_gain_shrinks_an_error_to_delta_in_the_time_base():
    t_b, delta, alpha_0 = 3.0, 0.001, 1.01
    t = np.linspace(0, t_b, 100_001)
    symbol = ca.SX.sym("t")
    alpha = ca.Function("alpha", [symbol], [convergence_gain(symbol, t_b, alpha_0, 25.0, delta)]).map(len(t))
    exponent = np.trapezoid(np.array(alpha(t)).ravel(), t)
    # int alpha dt = alpha_0 ln((1 + delta)/delta), so e(t_b) = e(0) (delta/(1 + delta))^alpha_0.
    expected = (delta / (1 + delta)) ** alpha_0
    assert math.exp(-exponent) == pytest.approx(expected, rel=1e-5)  # trapezoids of 30 us


def test_the_convergence_gain_is_constant_after_the_time_base():
    assert float(convergence_gain(ca.DM(0), 3, 1.01, 25, 1e-3)) == 0
    assert float(convergence_gain(ca.DM(3), 3, 1.01, 25, 1e-3)) == 0  # xi_dot(t_b) = 0; from then on alpha_c
    assert float(convergence_gain(ca.DM(3.0001), 3, 1.01, 25, 1e-3)) == 25
    assert float(convergence_gain(ca.DM(1000), 3, 1.01, 25, 1e-3)) == 25


# References


def reference_at(name, **values):
    """(t) -> eta_d, eta_d_dot, eta_d_ddot of a shipped reference, each (6,)."""
    reference = Stepped(name, **values)

    def at(t):
        reference.step(t, 0.0)
        return [reference[v].copy() for v in ("eta_d", "eta_d_dot", "eta_d_ddot")]

    return at


GRIPPING = {
    1: {"side": 1.0, "final": (0, 0, 0)},
    2: {"side": -1.0, "final": (6, 6, 0)},
}
WAY_POINTS = {  # y without the vehicles' distance from the object, which follows: half of 0.5 m, and 0.1 m more
    0.0: (1.5, 3.5, 2, 0.35),
    6.0: (1.5, 3.5, 2, 0.35),
    9.0: (1.5, 3.5, 3, 0.35),
    12.0: (1.5, 3.5, 3, 0.25),
    15.0: (1.5, 3.5, 2, 0.25),
    21.0: (4.5, 1.5, 2, 0.25),
    24.0: (4.5, 1.5, 3, 0.25),
    27.0: (4.5, 1.5, 3, 0.35),
    30.0: (4.5, 1.5, 2, 0.35),
}


@pytest.mark.parametrize("vehicle", [1, 2])
def test_the_gripping_reference_rests_at_its_way_points(vehicle):
    parameters = GRIPPING[vehicle]
    side, at = parameters["side"], reference_at("gripping_reference", **parameters)
    points = {t: (x, y + side * gap, z) for t, (x, y, z, gap) in WAY_POINTS.items()}
    for t, point in {**points, 40.0: parameters["final"], 50.0: parameters["final"]}.items():
        eta_d, eta_d_dot, eta_d_ddot = at(t)
        np.testing.assert_allclose(eta_d, [*point, 0, 0, -side * math.pi / 2], atol=100 * ROUNDING)
        np.testing.assert_allclose([eta_d_dot, eta_d_ddot], 0, atol=ROUNDING)


def test_the_gripping_vehicles_start_with_a_constant_set_point():
    at = reference_at("gripping_reference", **GRIPPING[1])
    for t in (1.0, 3.3, 5.999):
        np.testing.assert_array_equal(at(t)[0], at(0.0)[0])


def test_the_gripping_references_keep_their_distance_and_face_each_other_while_they_hold():
    one, two = (reference_at("gripping_reference", **GRIPPING[i]) for i in (1, 2))
    for t in np.linspace(12, 24, 49):
        a, b = one(t)[0], two(t)[0]
        assert np.linalg.norm(a[:3] - b[:3]) == pytest.approx(0.5, abs=100 * ROUNDING)
        assert np.degrees(b[5] - a[5]) == pytest.approx(180, abs=100 * ROUNDING)
        bow = number(rotation(a))[:, 0]
        np.testing.assert_allclose(bow, (b - a)[:3] / 0.5, atol=100 * ROUNDING)  # the bow points at the other one


@pytest.mark.parametrize(
    ("name", "times"),
    [
        ("gripping_reference", [3.1, 6.4, 7.5, 10.3, 13.9, 18.2, 22.7, 25.5, 28.4, 31.0, 35.0, 39.5, 44.0]),
        ("spiral_reference", [0.0, 1.7, 9.4, 30.0]),
    ],
)
def test_the_derivatives_of_the_reference_are_exact(name, times):
    at, h = reference_at(name), 1e-4
    for t in times:
        before, now, after = at(t - h), at(t), at(t + h)
        for order in (0, 1):
            slope = (after[order] - before[order]) / (2 * h)
            # central differences: h^2/6 = 2e-9 of the third derivative (at most 5), rounding 1e-15/h = 1e-11
            np.testing.assert_allclose(now[order + 1], slope, atol=1e-8)


def test_the_spiral_turns_once_in_twelve_seconds_while_it_sinks_four_metres():
    at = reference_at("spiral_reference")
    np.testing.assert_allclose(at(0.0)[0], [1, 0, 0, 0, 0, 0], atol=ROUNDING)
    np.testing.assert_allclose(at(3.0)[0], [0, 1, 1, 0, 0, math.pi / 2], atol=ROUNDING)
    np.testing.assert_allclose(at(12.0)[0], [1, 0, 4, 0, 0, 2 * math.pi], atol=100 * ROUNDING)
    assert at(1.0)[1][5] == pytest.approx(math.pi / 6, rel=ROUNDING)


def test_a_reference_gives_the_values_of_the_end_of_the_step():
    for name in ("spiral_reference", "gripping_reference"):
        stepped, there = Stepped(name).step(7.0, 0.5), Stepped(name).step(7.5, 0.0)
        np.testing.assert_array_equal(stepped.memory[2:], there.memory[2:])


# Controllers


def test_pid_pulls_against_the_error_the_rate_and_the_integral():
    e, e_dot = np.array([0.1, -0.2, 0.3, 0.01, 0.5, -0.04]), np.array([0.2, 0.1, -0.3, 0.02, 0.7, 0.05])
    pid = Stepped("pid", eta_d=-e, eta_d_dot=-e_dot)  # level at the origin: J = I
    controlled = np.array([1, 1, 1, 1, 0, 1])
    for k in range(4):
        pid.step(k * 0.25, 0.25)  # the integral of the step before acts: 0, e/4, e/2, 3e/4
        expected = -controlled * (140 * e + 180 * (k / 4) * e + 120 * e_dot)
        np.testing.assert_allclose(pid["tau"], expected, atol=1000 * ROUNDING)  # terms up to 100 N


def test_pids_anti_windup_limits_the_integrals_share_of_the_force():
    pid = Stepped("pid", eta_d=(-1, 0, 0, 0, 0, 0), anti_windup=1.0)
    for k in range(50):
        pid.step(k * 0.1, 0.1)
    assert pid["tau"][0] == pytest.approx(-(140 + 40), rel=ROUNDING)  # K_p e and integral_limit


def test_mfsosmc_begins_on_its_sliding_surface():
    start = {"eta": (2, -1, 1, 0, 0, 0.3), "nu": (0.1, 0.2, 0, 0, 0, 0.4), "eta_d_dot": (0, 0.5, 0.3, 0, 0, 0.5)}
    controller = Stepped("mfsosmc", **start)
    np.testing.assert_array_equal(controller.step(0.0, 0.0)["tau"], 0)
    assert controller["s_0"].any()


def test_mfsosmc_uses_the_integral_that_it_has_just_advanced():
    h, e_dot = 1e-3, np.array([0.1, 0, 0, 0, 0, 0])
    for semi_implicit, integral in ((1.0, h), (0.0, 0.0)):
        controller = Stepped("mfsosmc", semi_implicit=semi_implicit)  # s_0 = 0
        controller.set(nu=e_dot)
        controller.step(0.0, h)
        # alpha(0) = 0: s_n = e_dot, tau = -K_d (e_dot + K_i int sign s_n)
        assert controller["tau"][0] == pytest.approx(-800 * (0.1 + 5 * integral), rel=ROUNDING)
        assert controller["integral"][0] == h


# Controllers that know the vehicle.  Without M(1,5) pitch stays apart, and what they command is what the vehicle does.

BODY_WITHOUT_PITCH = SimpleNamespace(**{**vars(BODY), "z_g": 0.0})
CONTROLLED = [0, 1, 2, 3, 5]
MOVING = {
    "eta": np.array([0.3, -0.5, 1.0, 0.0, 0.0, 0.6]),
    "nu": np.array([0.4, -0.3, 0.2, 0.1, 0.2, -0.5]),
    "eta_d": np.array([0.1, 0.2, 0.6, 0.0, 0.0, 0.3]),
    "eta_d_dot": np.array([0.5, 0.1, 0.3, 0.0, 0.0, 0.5]),
    "eta_d_ddot": np.array([0.2, -0.2, 0.1, 0.0, 0.0, 0.1]),
}
E_1 = MOVING["eta"] - MOVING["eta_d"]
E_2 = number(jacobian(MOVING["eta"])) @ MOVING["nu"] - MOVING["eta_d_dot"]


def acceleration_under(tau, eta, nu):
    """J nu_dot and J_dot nu of the free vehicle; their sum is eta_ddot."""
    body, x = BODY_WITHOUT_PITCH, ca.SX.sym("x", 6)
    resistance = (number(coriolis(body, nu)) + number(damping(body, nu))) @ nu + number(restoring(body, eta))
    nu_dot = np.linalg.pinv(number(mass(body))) @ (tau - resistance)
    rate = jacobian(x) @ nu
    turning = ca.Function("J_dot_nu", [x], [ca.jtimes(rate, x, rate)])(eta)
    return number(jacobian(eta)) @ nu_dot, np.array(turning).ravel()


def commanded_by(name):
    controller = Stepped(name, **MOVING, **{"model.z_g": 0.0})
    return acceleration_under(controller.step(0.0, 0.0)["tau"], MOVING["eta"], MOVING["nu"])


@pytest.mark.parametrize("name", ["feedback_linearization", "lyapunov", "nstsmc", "ftsosmc"])
def test_a_controller_that_knows_the_vehicle_holds_it_against_its_buoyancy(name):
    eta = np.array([1.0, 2, 3, 0.3, 0.1, -0.8])
    controller = Stepped(name, eta=eta, eta_d=eta).step(0.0, 0.0)
    np.testing.assert_allclose(controller["tau"], number(restoring(BODY, eta)), atol=ROUNDING)


def test_feedback_linearization_commands_the_acceleration_of_a_pid():
    straight, _ = commanded_by("feedback_linearization")
    expected = MOVING["eta_d_ddot"] - 140 * E_1 - 120 * E_2
    np.testing.assert_allclose(straight[CONTROLLED], expected[CONTROLLED], atol=1000 * ROUNDING)  # terms up to 100


def test_lyapunovs_function_falls_at_the_rate_of_the_gain_and_the_damping():
    eta, nu, alpha = MOVING["eta"], MOVING["nu"], 0.8 * np.array([1, 1, 1, 1, 0, 1])
    t, x = ca.SX.sym("t"), ca.SX.sym("x", 6)
    eta_d = MOVING["eta_d"] + t * MOVING["eta_d_dot"] + t**2 / 2 * MOVING["eta_d_ddot"]
    nu_r = ca.inv(jacobian(x)) @ (ca.jacobian(eta_d, t) - alpha * (x - eta_d))
    rate = ca.jacobian(nu_r, t) + ca.jtimes(nu_r, x, jacobian(x) @ nu)
    nu_r, nu_r_dot = (np.array(v).ravel() for v in ca.Function("nu_r", [t, x], [nu_r, rate])(0, eta))
    straight, _ = commanded_by("lyapunov")
    nu_dot, S = np.linalg.solve(number(jacobian(eta)), straight), nu - nu_r
    M, C, D = (number(A) for A in (mass(BODY_WITHOUT_PITCH), coriolis(BODY, nu), damping(BODY, nu)))
    # M S_dot = -(C + D + K_d) S: V = S^T M S / 2 falls by S^T (D + K_d) S, and by S^T C S where C is not skew.
    expected = -(C + D + np.diag([60, 60, 60, 60, 0, 60])) @ S
    np.testing.assert_allclose((M @ (nu_dot - nu_r_dot))[CONTROLLED], expected[CONTROLLED], atol=1000 * ROUNDING)


def test_ftsosmc_commands_its_reaching_law():
    straight, turning = commanded_by("ftsosmc")
    s = E_2 + 0.8 * E_1
    expected = MOVING["eta_d_ddot"] - 0.8 * E_2 - 30 * np.abs(s) ** 0.7 * np.sign(s)  # w(0) = 0
    np.testing.assert_allclose((straight + turning)[CONTROLLED], expected[CONTROLLED], atol=1000 * ROUNDING)


def test_nstsmc_commands_its_reaching_law():
    straight, turning = commanded_by("nstsmc")
    A = np.sqrt(np.tanh(np.abs(E_1) / 2))
    with np.errstate(divide="ignore"):  # of the angles that have no error
        F, slope = A * 4 * np.cosh(E_1 / 2) ** 2 * np.sign(E_1), 1 / A + 2 * A * np.sinh(np.abs(E_1))
    eps, roll = 0.01, 3  # roll has no error: inside the boundary layer, F(0) = 0 and F'(0) of the inner branch
    A_eps = math.sqrt(math.tanh(eps / 2))
    F_eps, slope_eps = A_eps * 4 * math.cosh(eps / 2) ** 2, 1 / A_eps + 2 * A_eps * math.sinh(eps)
    slope[roll] = math.pi / (2 * eps) * F_eps + slope_eps
    S = E_2 + 0.5 * F
    S[4] = slope[4] = 0  # pitch is not controlled
    speed = np.linalg.norm(E_2 + MOVING["eta_d_dot"])
    adaptive = np.dot([2.5, 0.5, 0.5], [1, speed, speed**2]) / 4
    alpha = np.array([5, 5, 5, 30, 0, 30])
    reaching = alpha * S + alpha * np.abs(S) ** (2 / 3) * np.sign(S) + adaptive * S
    expected = MOVING["eta_d_ddot"] - 0.5 * slope * E_2 - reaching
    np.testing.assert_allclose((straight + turning)[CONTROLLED], expected[CONTROLLED], atol=1e4 * ROUNDING)  # of 1000


def test_the_terminal_surface_is_smooth_where_its_branches_meet():
    terminal = model_class("nstsmc").step.__globals__["terminal"]
    e, eps = ca.SX.sym("e"), 0.01
    F, F_prime = terminal(e, eps)
    at = ca.Function("F", [e], [F, F_prime, ca.jacobian(F, e)])
    for inside, outside in ((eps * (1 - 1e-9), eps * (1 + 1e-9)), (-eps * (1 - 1e-9), -eps * (1 + 1e-9))):
        np.testing.assert_allclose(np.ravel(at(inside)), np.ravel(at(outside)), rtol=1e-6)  # 1e-9 of a curvature of 1e3
    for where in (-2.0, -0.3, -0.004, 0.0, 0.006, 0.5, 5.0):
        _, slope, exact = (float(v) for v in at(where))
        assert slope == pytest.approx(exact, rel=1e-12)
        assert slope > 0
