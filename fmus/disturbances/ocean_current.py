"""A current that is the same everywhere and always."""

from uuv import V_C, Model, Output, Parameter


class OceanCurrent(Model):
    """Constant velocity of the water; still by default.

    The thesis's current is (0.75, 0.25, 0.3) m/s in NED.
    """

    v_c = Output(V_C)
    velocity = Parameter(0.0, V_C.units, V_C.meaning, V_C.axes, limits=V_C.limits)

    def step(self, t, h):
        return {"v_c": self.velocity}
