import numpy as np
from uuv import Input, Output, PythonModel, Signal


class Notes:
    """An object of the user's own class."""

    def __init__(self):
        self.lines = []


class Hidden(PythonModel):
    """Remembers its inputs where no declaration shows it."""

    x = Input(Signal((), "1", "what it hears"))
    y = Output(Signal((), "1", "what it makes of it"))

    def __init__(self):
        self.notes, self.random, self.count = Notes(), np.random.default_rng(7), {"steps": [0]}

    def initialize(self):
        self.count["steps"][0] += 10

    def do_step(self, t, h):
        self.notes.lines.append(float(self.x))
        self.count["steps"][0] += 1
        self.y = sum(self.notes.lines) + 100 * self.count["steps"][0] + self.random.normal()
        if self.count["steps"][0] == 13:
            self.late = 1000.0
        self.y += getattr(self, "late", 0)
