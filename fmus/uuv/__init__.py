"""What a model of an underwater vehicle, or of its controller, is written with.

from uuv import ETA, NU, TAU, Input, Model, Output, Parameter, State    # equations in CasADi
from uuv import PythonModel                                             # plain Python and numpy
"""

from .modelling.declare import Calculated, File, Group, Input, Output, Parameter, Signal, State
from .modelling.equations import Model
from .modelling.python_model import PythonModel
from .signals import ETA, ETA_D, ETA_D_DDOT, ETA_D_DOT, NU, SPECIFIC_FORCE, TAU, V_C, U

__all__ = [
    "ETA",
    "ETA_D",
    "ETA_D_DDOT",
    "ETA_D_DOT",
    "NU",
    "SPECIFIC_FORCE",
    "TAU",
    "V_C",
    "Calculated",
    "File",
    "Group",
    "Input",
    "Model",
    "Output",
    "Parameter",
    "PythonModel",
    "Signal",
    "State",
    "U",
]
