from uuv import Output, PythonModel, Signal


class Chatty(PythonModel):
    """Prints at each step."""

    y = Output(Signal((), "m", "time"))

    def do_step(self, t, h):
        print("hello")
        self.y = t + h
