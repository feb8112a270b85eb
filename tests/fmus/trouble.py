from uuv import Input, Output, Parameter, PythonModel, Signal

NUMBER = Signal((), "m", "a number")


class Trouble(PythonModel):
    """y = t + h, until the trouble."""

    u = Input(NUMBER)
    y = Output(NUMBER)
    at = Parameter(0.02, "s", "when the trouble comes")
    kind = Parameter(0, meaning="1 raise, 2 nan, 3 inf, 4 end, 5 wrong shape, 6 raise in initialize", type=int)

    def initialize(self):
        if self.kind == 6:
            raise ValueError("no calm sea: déjà vu")

    def do_step(self, t, h):
        self.y = t + h
        if h == 0.0 or t < self.at - 1e-9:
            return True
        if self.kind == 1:
            raise RuntimeError(f"the thruster is gone at {t:g}, 100 %s sure %n")
        if self.kind in (2, 3):
            self.y = float("nan" if self.kind == 2 else "inf")
        if self.kind == 5:
            self.y = [1.0, 2.0]
        return self.kind != 4
