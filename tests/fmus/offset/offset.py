from helper import OFFSET
from uuv import Output, PythonModel, Signal


class Offset(PythonModel):
    """y = t + an offset."""

    y = Output(Signal((), "m", "a number"))

    def do_step(self, t, h):
        from helper import offset_later

        self.y = t + h + OFFSET + offset_later()
