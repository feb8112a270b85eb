"""A sensor of pose and velocity whose noise has mean zero; the same noise at every step where it has an interval."""

import casadi as ca
from uuv import ETA, NU, Input, Model, Output, Parameter, Signal, State

AXES = ETA.axes + NU.axes
NUMBERS = Signal(AXES, "1", "numbers of a generator, the next from the last")
MODULUS, FACTOR = 2147483647.0, 48271.0  # of the minimal standard generator (Park, Miller 1988, revised)


def following(numbers):
    return ca.fmod(FACTOR * numbers, MODULUS)


class NoisySensor(Model):
    """eta_m = eta + sigma_eta n, nu_m = nu + sigma_nu n, n normal, new after each `interval`, or in each step."""

    eta, nu = Input(ETA), Input(NU)
    eta_m, nu_m = Output(ETA), Output(NU)
    radius, angle = State(NUMBERS), State(NUMBERS)
    draws = State(Signal((), "1", "how many intervals have begun"))
    sigma_eta = Parameter(0.0, "1", "standard deviation of eta_m, in m and rad")
    sigma_nu = Parameter(0.0, "1", "standard deviation of nu_m, in m/s and rad/s")
    interval = Parameter(0.0, "s", "how long the noise stays the same; 0: one step")
    seed = Parameter(1, meaning="of the noise, at least 1", type=int)

    def initial(self):
        first = ca.DM(range(1, len(AXES) + 1))
        numbers = ca.fmod(self.seed * 16807.0 + first * 69621.0, MODULUS)
        for _ in range(5):
            numbers = following(numbers)
        return {"radius": numbers, "angle": following(following(numbers))}

    def step(self, t, h):
        begun = ca.if_else(self.interval > 0, ca.floor(t / ca.fmax(self.interval, 1e-12) + 1e-6) + 1, self.draws + 1)
        new = begun > self.draws
        radius = ca.if_else(new, following(self.radius), self.radius)
        angle = ca.if_else(new, following(self.angle), self.angle)
        # Box and Muller (1958)
        normal = ca.sqrt(-2 * ca.log(radius / MODULUS)) * ca.cos(2 * ca.pi * angle / MODULUS)
        eta_m, nu_m = self.eta + self.sigma_eta * normal[:6], self.nu + self.sigma_nu * normal[6:]
        return {"radius": radius, "angle": angle, "draws": begun, "eta_m": eta_m, "nu_m": nu_m}
