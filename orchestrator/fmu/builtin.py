"""Components that orch itself brings, described as if each were an FMU.

They are named here and imported when an experiment asks for one: what steers from outside needs pymavlink.
"""

from __future__ import annotations

import hashlib
import importlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from ..errors import FmuError, did_you_mean
from .fmu import Fmu
from .variables import Variable

if TYPE_CHECKING:
    from ..arrays import Reals

KNOWN = {
    "ardupilot_json": "orchestrator.mavlink.components.ardupilot:ArdupilotJson",
    "mavlink_manual": "orchestrator.mavlink.components.manual:MavlinkManual",
    "mavlink_motors": "orchestrator.mavlink.components.motors:MavlinkMotors",
}
DEAF = ("mavlink_motors",)  # what they do depends on their inputs alone


class Builtin(Protocol):
    """A component.  All its variables are reals; vectors below are in the order of `variables`."""

    def __init__(self, name: str, parameters: Mapping[str, Any], context: Mapping[str, Any]) -> None:
        """context: what the run offers: `interrupted`, and what its links to the world give.  Raises OrchError."""

    @classmethod
    def variables(cls) -> Sequence[Variable]:
        """Inputs, outputs and parameters; references count from 0."""

    def start(self, inputs: Reals) -> Reals:
        """Outputs at the start; may be called several times."""

    def listen(self, t: float, inputs: Reals) -> Reals:
        """What comes from outside at t [s], always (m,), or (0,) of a deaf one.  Raises OrchError if nothing comes for
        too long."""

    def step(self, t: float, h: float, inputs: Reals, heard: Reals) -> Reals:
        """Outputs from t [s] on, after the step to t + h."""

    def close(self) -> None: ...


def describe(name: str) -> Fmu:
    """A builtin as an FMU.  Raises FmuError if there is no builtin of that name."""
    builtin = load(name)
    return Fmu(
        path=Path(name),
        sha256=hashlib.sha256(f"builtin:{name}".encode()).hexdigest(),
        fmi_version="2.0",
        model_name=name,
        description=(builtin.__doc__ or "").partition("\n")[0],
        model_identifier=name,
        tool="orch",
        packaging="builtin",
        variables={variable.name: variable for variable in builtin.variables()},
    )


def load(name: str) -> type[Builtin]:
    """The class of a builtin.  Raises FmuError if there is no builtin of that name."""
    if name not in KNOWN:
        raise FmuError(f"no builtin {name!r}{did_you_mean(name, KNOWN)}")
    module, _, attribute = KNOWN[name].partition(":")
    builtin: type[Builtin] = getattr(importlib.import_module(module), attribute)
    return builtin
