import os
import time

from uuv import Output, Parameter, PythonModel, Signal


class Moody(PythonModel):
    """y = t + h; takes its time, and fails where the environment says so: the same FMU, another end."""

    y = Output(Signal((), "m", "time"))
    pause = Parameter(0.0, "s", "how long a step takes")

    def do_step(self, t, h):
        self.y = t + h
        if h and self.pause:
            time.sleep(self.pause)
        if t > 0.02 and os.environ.get("MOOD") == "bad":
            raise RuntimeError("in a bad mood")
