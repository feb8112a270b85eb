import numpy as np
from uuv import Output, Parameter, PythonModel, Signal

ETA = Signal(("x", "y", "z", "phi", "theta", "psi"), ("m",) * 3 + ("rad",) * 3, "a place that wanders")


class Erratic(PythonModel):
    """Random walks and random commands, which a seed decides."""

    one, other = Output(ETA), Output(ETA)
    u = Output(Signal(("T1", "T2", "T3"), "1", "commands in [-1, 1]"))
    seed = Parameter(0, meaning="of the numbers", type=int)

    def do_step(self, t, h):
        step = round(t / h) + 1 if h else 0
        random = np.random.default_rng([self.seed, step])
        self.one = self.one + random.normal(size=6) * 0.3
        self.other = np.remainder(self.other + random.normal(size=6) * 0.3 + np.pi, 2 * np.pi) - np.pi
        self.u = random.uniform(-1.0, 1.0, 3)
