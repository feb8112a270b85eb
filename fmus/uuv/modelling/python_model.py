"""Models in plain Python: the declarations of `declare`, and `do_step` with numpy instead of equations."""

from __future__ import annotations

from abc import abstractmethod

from .declare import Declared


class PythonModel(Declared):
    """A model that computes with numpy; in its methods the declared names are arrays (scalars are floats).

    Other attributes of an instance are saved and restored with the state of the FMU.
    """

    def initialize(self) -> None:
        """Called at the start of a run, when parameters and inputs are known."""

    @abstractmethod
    def do_step(self, t: float, h: float) -> bool | None:
        """Step from t to t + h [s]: set outputs and states.  Return False to end the simulation.

        The outputs at the start of a run are those of a step with h = 0, after which everything else is restored.
        """
