"""What `orch new` writes: a controller and an experiment that run as they are, with comments on what to change."""

from __future__ import annotations

from pathlib import Path

from ..errors import OrchError
from ..experiment.schema.reference import SCHEMA
from .catalogue import shipped

CONTROLLER = '''"""{name}: describe your controller here; the first paragraph becomes the FMU's description."""

import numpy as np
from uuv import ETA, ETA_D, ETA_D_DOT, NU, TAU, Input, Output, Parameter, PythonModel


class {classname}(PythonModel):
    """A PD law for position, roll and heading: replace it by your own."""

    # The socket of a controller: any of these inputs, and tau.  `orch fmus pid` shows the signals with their axes.
    eta, nu = Input(ETA), Input(NU)  # pose in NED (x y z phi theta psi) [m, rad], velocity in BODY [m/s, rad/s]
    eta_d, eta_d_dot = Input(ETA_D), Input(ETA_D_DOT)  # what is desired, and its derivative
    tau = Output(TAU)  # generalized force in BODY (X Y Z K M N) [N, N.m]
    # Parameters can be set from an experiment: --set components.controller.parameters.K_p=90
    K_p = Parameter(140.0, "N/m", "position gain")
    K_d = Parameter(120.0, "N.s/m", "velocity gain")
    K_a = Parameter(40.0, "N.m/rad", "gain of roll and heading")
    K_r = Parameter(8.0, "N.m.s/rad", "gain of their rates")

    def do_step(self, t, h):
        """One step from t to t + h [s]: read the inputs, set the outputs.  Keep what you need on self."""
        e = self.eta_d - self.eta
        e[3:] -= 2 * np.pi * np.round(e[3:] / (2 * np.pi))  # angles: the shortest way round
        c, s = np.cos(self.eta[5]), np.sin(self.eta[5])
        R = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])  # BODY to NED, for a nearly level vehicle
        force = R.T @ (self.K_p * e[:3] + self.K_d * self.eta_d_dot[:3]) - self.K_d * self.nu[:3]
        moment = self.K_a * e[3:] + self.K_r * (self.eta_d_dot[3:] - self.nu[3:])
        self.tau = np.array([*force, moment[0], 0, moment[2]])
'''

EXPERIMENT = """#:schema {schema}
# {name}: describe here what this experiment shows; the line above lets editors complete and check it.
title = "A BlueROV2 follows a spiral"

[master]
stop_time = 30.0            # s
step = 1e-3                 # s, communication step; a sliding-mode controller may need 1e-4 or less
algorithm = "gauss-seidel"  # components step in the order below, each fed with the newest outputs; or "jacobi"

# Controllers come before what they drive, references and currents after those that read them.
[components.controller]
fmu = "pid"                 # a model's name (see: orch fmus), or the path of any .fmu
parameters = {{ K_p = {{ z = 120.0 }} }}  # the others keep their defaults (see: orch fmus pid)

[components.allocation]
fmu = "bluerov2_allocation"

[components.vehicle]
fmu = "bluerov2_thesis"
parameters = {{ eta_0 = [2, -1, 1, 0, 0, 0] }}  # x y z [m], phi theta psi [rad]

[components.reference]
fmu = "spiral_reference"

[components.current]
fmu = "ocean_current"
parameters = {{ velocity = [0.2, 0.0, 0.0] }}   # m/s, north east down

[connections]               # "input" = "output"; a vector connects axis by axis
"controller.eta" = "vehicle.eta"
"controller.nu" = "vehicle.nu"
"controller.eta_d" = "reference.eta_d"
"controller.eta_d_dot" = "reference.eta_d_dot"
"controller.eta_d_ddot" = "reference.eta_d_ddot"
"allocation.tau" = "controller.tau"
"vehicle.u" = "allocation.u"
"vehicle.v_c" = "current.v_c"

[record]
every = 0.01                # s
signals = ["*", "!*.eta_d_ddot"]  # globs; "!" leaves out

[metrics]
rmse_x = {{ of = "rmse", signal = "vehicle.eta.x", reference = "reference.eta_d.x", after = 5.0 }}
rmse_z = {{ of = "rmse", signal = "vehicle.eta.z", reference = "reference.eta_d.z", after = 5.0 }}
rms_T1 = {{ of = "rms", signal = "allocation.u.T1" }}
"""


def write(kind: str, name: str) -> tuple[Path, str]:
    """Write the template of a controller or an experiment here; returns the file and what to do next.

    Raises OrchError for a name that cannot be used or a file that exists.
    """
    stem = name.removesuffix(".py" if kind == "controller" else ".toml")
    if not stem.isidentifier():
        raise OrchError(f"{stem!r} cannot be the name; use letters, digits and _, and do not begin with a digit")
    if kind == "controller" and stem in shipped():
        raise OrchError(f"{stem!r} is the name of a model that comes with orch; choose another")
    path = Path(f"{stem}.py" if kind == "controller" else f"{stem}.toml")
    text = (CONTROLLER if kind == "controller" else EXPERIMENT).format(
        name=stem, classname="".join(word.capitalize() for word in stem.split("_")), schema=SCHEMA.as_uri()
    )
    try:
        with path.open("x", encoding="utf-8") as file:
            file.write(text)
    except FileExistsError:
        raise OrchError(f"{path} already exists; choose another name, or move it away") from None
    except OSError as error:
        raise OrchError(f"{path} cannot be written: {error.strerror}") from None
    if kind == "experiment":
        return path, f"run it:       orch run {path}"
    return path, (
        f"build it:     orch build {path}\n"
        f"run it:       orch new experiment try_{stem} && orch run try_{stem}.toml --swap controller={stem}"
    )
