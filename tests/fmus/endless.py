import contextlib
import itertools

from uuv import Output, Parameter, PythonModel, Signal


class Endless(PythonModel):
    """y = t + h, until a step that never ends."""

    y = Output(Signal((), "m", "time"))
    at = Parameter(0.02, "s", "when a step never ends")
    kind = Parameter(
        1, meaning="1 loop, 2 loop that ignores exceptions, 3 loop that holds the lock, 4 initialize", type=int
    )

    def initialize(self):
        if self.kind == 4:
            self.loop()

    def do_step(self, t, h):
        self.y = t + h
        if h and t > self.at - 1e-9:
            if self.kind == 1:
                self.loop()
            if self.kind == 2:
                self.stubborn()
            if self.kind == 3:
                sum(itertools.repeat(0))

    def loop(self):
        while True:
            pass

    def stubborn(self):
        while True:
            with contextlib.suppress(BaseException):
                self.loop()
