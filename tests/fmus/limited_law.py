"""A proportional law with limits, or a relay: stable or not by the step of its loop."""

import math

from uuv import Input, Output, Parameter, PythonModel, Signal

PAIR = Signal(("a", "b"), "m", "a controlled number, and its companion")


class LimitedLaw(PythonModel):
    """u.a = gain (target - y.a) within +-limit, or limit sign(target - y.a) where the gain is 0; u.b is constant."""

    y = Input(PAIR)
    u = Output(PAIR)
    gain = Parameter(1.0, "1", "of the law; 0: a relay")
    target = Parameter(0.0, "m", "of y.a")
    limit = Parameter(1.0, "m", "of u.a; 0: none")
    companion = Parameter(0.0, "m", "u.b")
    only = Parameter(0.0, "s", "the only step that it takes; 0: any")
    end = Parameter(1e9, "s", "when it ends the run")

    def do_step(self, t, h):
        if self.only and h and abs(h - self.only) > 1e-12:
            raise ValueError(f"I step by {self.only:g} s")
        error = self.target - self.y[0]
        wanted = self.gain * error if self.gain else math.copysign(self.limit, error)
        self.u = [min(self.limit, max(-self.limit, wanted)) if self.limit else wanted, self.companion]
        return t < self.end
