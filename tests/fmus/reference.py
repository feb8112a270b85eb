from uuv import Model, Output, Signal

NUMBER = Signal((), "1", "a number")


class Reference(Model):
    """t^2 at the end of the step."""

    r = Output(NUMBER)

    def step(self, t, h):
        return {"r": (t + h) ** 2}
