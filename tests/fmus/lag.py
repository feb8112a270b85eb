"""A lag of first order, or an integrator, with a sensor that alternates around what it measures."""

import numpy as np
from uuv import Input, Output, Parameter, PythonModel, Signal, State

PAIR = Signal(("a", "b"), "m", "a controlled number, and its companion")


class Lag(PythonModel):
    """T y.a_dot = u.a - decay y.a, by Euler's method; y.b = u.b; y_m.a = y.a + noise, - noise, + noise, ..."""

    u = Input(PAIR)
    y = State(PAIR, start=0.9, output=True)
    n = State(Signal((), "1", "steps done"))
    y_m = Output(PAIR)
    T = Parameter(1e-3, "s", "time constant; 0: y.a = u.a")
    decay = Parameter(1.0, "1", "1: a lag, 0: an integrator")
    noise = Parameter(0.0, "m", "amplitude of what alternates in y_m.a")

    def do_step(self, t, h):
        new = self.y[0] + h / self.T * (self.u[0] - self.decay * self.y[0]) if self.T else self.u[0]
        self.y = np.array([new, self.u[1]])
        self.n = self.n + (h > 0)
        self.y_m = [self.y[0] + self.noise * (-1) ** self.n, self.y[1]]
