"""The BlueROV2's numbers, as FMI parameters: the thesis's Tables 4.1-4.5 and what was fitted to its results.

SNAME derivatives keep their sign: added mass and damping are negative.
"""

from __future__ import annotations

from .modelling.declare import Calculated, Parameter
from .signals import HALF_TURN, NOT_NEGATIVE, NOT_POSITIVE, POSITIVE

G = 9.81  # m/s2; the thesis's Eq. 4.8


class BlueROV2Body:
    """Mass, buoyancy and hydrodynamics; the pitch row is left out, as in the thesis (section 4.1)."""

    m = Parameter(10.5, "kg", "mass (Table 4.1)", limits=POSITIVE)
    I_x = Parameter(0.16, "kg.m2", "moment of inertia about x (Table 4.2)", limits=POSITIVE)
    I_y = Parameter(0.16, "kg.m2", "moment of inertia about y, in C(nu) alone (Table 4.2)", limits=POSITIVE)
    I_z = Parameter(0.16, "kg.m2", "moment of inertia about z (Table 4.2)", limits=POSITIVE)
    z_g = Parameter(0.02, "m", "centre of gravity below centre of buoyancy (Table 4.2)")
    W = Parameter(10.5 * G, "N", "weight (Eq. 4.8)", limits=NOT_NEGATIVE)
    B = Parameter(
        10.7 * G,
        "N",
        "buoyancy: weight and a net buoyancy of 0.2 kg (Table 4.1; Eq. 4.9 adds 0.2 N)",
        limits=NOT_NEGATIVE,
    )
    X_udot = Parameter(-5.0, "kg", "added mass in surge (Table 4.3)", limits=NOT_POSITIVE)
    Y_vdot = Parameter(-12.7, "kg", "added mass in sway (Table 4.3)", limits=NOT_POSITIVE)
    Z_wdot = Parameter(-14.57, "kg", "added mass in heave (Table 4.3)", limits=NOT_POSITIVE)
    K_pdot = Parameter(-0.12, "kg.m2", "added inertia in roll (Table 4.3)", limits=NOT_POSITIVE)
    M_qdot = Parameter(-0.12, "kg.m2", "added inertia in pitch, in C(nu) alone (Table 4.3)", limits=NOT_POSITIVE)
    N_rdot = Parameter(-0.12, "kg.m2", "added inertia in yaw (Table 4.3)", limits=NOT_POSITIVE)
    X_u = Parameter(-4.03, "N.s/m", "linear damping in surge (Table 4.4)", limits=NOT_POSITIVE)
    Y_v = Parameter(-6.22, "N.s/m", "linear damping in sway (Table 4.4)", limits=NOT_POSITIVE)
    Z_w = Parameter(-5.18, "N.s/m", "linear damping in heave (Table 4.4)", limits=NOT_POSITIVE)
    K_p = Parameter(-0.07, "N.m.s/rad", "linear damping in roll (Table 4.4)", limits=NOT_POSITIVE)
    N_r = Parameter(-0.07, "N.m.s/rad", "linear damping in yaw (Table 4.4)", limits=NOT_POSITIVE)
    X_uu = Parameter(-18.18, "N.s2/m2", "quadratic damping in surge (Table 4.4)", limits=NOT_POSITIVE)
    Y_vv = Parameter(-21.66, "N.s2/m2", "quadratic damping in sway (Table 4.4)", limits=NOT_POSITIVE)
    Z_ww = Parameter(-36.99, "N.s2/m2", "quadratic damping in heave (Table 4.4)", limits=NOT_POSITIVE)
    K_pp = Parameter(-1.55, "N.m.s2/rad2", "quadratic damping in roll (Table 4.4)", limits=NOT_POSITIVE)
    N_rr = Parameter(-1.55, "N.m.s2/rad2", "quadratic damping in yaw (Table 4.4)", limits=NOT_POSITIVE)
    C_16 = Parameter(0.0, "kg", "C_A(1,6) per v; fitted to Tables 5.2-5.7, Eq. 4.5 prints Y_vdot")
    C_26 = Parameter(5.0, "kg", "C_A(2,6) per u; fitted to Tables 5.2-5.7, agrees with Eq. 4.5: -X_udot")


class BlueROV2Thrusters:
    """The vectored frame: four horizontal thrusters T1-T4, two vertical ones T5 and T6 (thesis section 4.1.2)."""

    gamma = Parameter(
        0.7853981633974483, "rad", "angle of the horizontal thrusters to the x axis: 45 degrees", limits=HALF_TURN
    )
    d_y = Parameter(0.115, "m", "lever of the vertical thrusters about x (Table 4.5)", limits=POSITIVE)
    d_psi = Parameter(
        0.3536,
        "m",
        "lever of the horizontal thrusters about z; fitted to Tables 5.4 and 5.7, twice what follows from Table 4.5",
    )
    max_thrust = Parameter(
        40.0, "N", "thrust of one thruster at full command (Eq. 4.11: T200 at 16 V)", limits=POSITIVE
    )
    T = Calculated((6, 6), "1", "thruster matrix: tau = max_thrust T u; rows X Y Z K M N, rows K and N in m")
