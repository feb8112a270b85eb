from helper import WORD
from pythonfmu import Boolean, Fmi2Causality, Fmi2Slave, Integer, Real, String


class South(Fmi2Slave):
    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.y, self.n, self.b, self.s = 0.0, 0, False, WORD
        for kind, name in ((Real, "y"), (Integer, "n"), (Boolean, "b"), (String, "s")):
            self.register_variable(kind(name, causality=Fmi2Causality.output))

    def do_step(self, t, h):
        self.y, self.n, self.b, self.s = t + h, self.n + 1, not self.b, f"{WORD} {self.n}"
        return True
