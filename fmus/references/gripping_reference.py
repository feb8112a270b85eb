"""The thesis's task of two vehicles and an object."""

import casadi as ca
from uuv import ETA_D, ETA_D_DDOT, ETA_D_DOT, V_C, Model, Output, Parameter
from uuv.tbg import time_base


class GrippingReference(Model):
    """One vehicle's part in gripping, carrying and releasing an object.

    Quintic segments, at rest at each knot, between the points of thesis section 4.2.3; a constant set point before the
    first knot.  The vehicles face each other across the object: side +1 lies at its y + distance/2 with a heading of
    -90 degrees, side -1 opposite.  Resolved from the thesis's misprints: both grip at the object's x.
    """

    eta_d, eta_d_dot, eta_d_ddot = Output(ETA_D), Output(ETA_D_DOT), Output(ETA_D_DDOT)
    side = Parameter(1.0, "1", "+1: the vehicle on the object's +y side, -1: the one opposite", limits=(-1.0, 1.0))
    grip = Parameter((1.5, 3.5, 3.0), "m", "where the object lies", V_C.axes)
    release = Parameter((4.5, 1.5, 3.0), "m", "where it is released", V_C.axes)
    final = Parameter((0.0, 0.0, 0.0), "m", "where the vehicle ends; (6, 6, 0) for the one opposite", V_C.axes)
    distance = Parameter(0.5, "m", "distance of the vehicles while they hold the object")
    approach = Parameter(0.1, "m", "further distance of each before gripping and after releasing; our choice")
    rise = Parameter(1.0, "m", "how far above the object they approach and carry")
    knots = Parameter((6.0, 9.0, 12.0, 15.0, 21.0, 24.0, 27.0, 30.0, 40.0), "s", "begin and ends of the segments")

    def step(self, t, h):
        def held(point, gap, above):
            return ca.vertcat(point[0], point[1] + self.side * (self.distance / 2 + gap), point[2] - above)

        points = [
            held(self.grip, self.approach, self.rise),
            held(self.grip, self.approach, 0),
            held(self.grip, 0, 0),
            held(self.grip, 0, self.rise),
            held(self.release, 0, self.rise),
            held(self.release, 0, 0),
            held(self.release, self.approach, 0),
            held(self.release, self.approach, self.rise),
            self.final,
        ]
        position, velocity, acceleration = points[0], ca.SX(3, 1), ca.SX(3, 1)
        for i in range(len(points) - 1):
            duration = self.knots[i + 1] - self.knots[i]
            way = points[i + 1] - points[i]
            xi, xi_s, xi_ss = time_base(ca.fmin(1, ca.fmax(0, (t + h - self.knots[i]) / duration)))
            position += xi * way
            velocity += xi_s / duration * way
            acceleration += xi_ss / duration**2 * way
        psi = -self.side * ca.pi / 2
        return {
            "eta_d": ca.vertcat(position, 0, 0, psi),
            "eta_d_dot": ca.vertcat(velocity, 0, 0, 0),
            "eta_d_ddot": ca.vertcat(acceleration, 0, 0, 0),
        }
