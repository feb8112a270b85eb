from lever import LENGTH
from uuv import Output, PythonModel, Signal


class Helped(PythonModel):
    """Gives what its helper holds."""

    y = Output(Signal((), "m", "length"))

    def do_step(self, t, h):
        self.y = 0.0
        if h > 0:
            from arm import twice  # late: in the first step

            self.y = twice(LENGTH)
