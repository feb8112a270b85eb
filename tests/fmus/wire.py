from uuv import Input, Model, Output, Signal

NUMBER = Signal((), "1", "a number")


class Wire(Model):
    """Hands its input on at once."""

    a, b = Input(NUMBER), Output(NUMBER)

    def step(self, t, h):
        return {"b": self.a}
