from uuv import ETA, TAU, Input, Model, Output


class Mistaken(Model):
    """Uses an input that it does not declare."""

    eta = Input(ETA)
    tau = Output(TAU)

    def step(self, t, h):
        return {"tau": self.eta + self.nu}
