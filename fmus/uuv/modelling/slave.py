"""A model as the Python slave that pythonfmu's library drives: the FMI 2.0 calls, by value reference.

The library finds a class in the FMU's main script and calls its methods; this is pythonfmu's `Fmi2Slave` with getters
and setters over one flat memory, at a tenth of the cost of one Python call per variable.
"""

from __future__ import annotations

import copy
import math
import pathlib
import pickle
from dataclasses import dataclass
from typing import Any

import numpy as np

from .assigned import Watch
from .declare import GROUPS, PACKED, Declared, Layout, assign, made
from .equations import Equations, Model, trace
from .failure import ModelFailed
from .python_model import PythonModel

ERROR = 3  # fmi2Error


@dataclass
class LogMessage:
    """A message for the FMI logger, as pythonfmu's library expects it."""

    status: int
    category: str
    msg: str
    debug: bool = False


class Fmi2Slave:  # pythonfmu's library looks for a base class of this name
    """One instance.  `model_class`: the model; the keywords are those pythonfmu's library gives."""

    def __init__(self, model_class: type[Declared], instance_name: str = "", resources: str = "", **_: Any):
        self.instance_name = instance_name
        self.layout = model_class.layout()
        self.memory = np.array(self.layout.start())
        self._known: dict[tuple[int, ...], Any] = {}

        self._log: list[LogMessage] = []
        self._initializing = True
        self._stale = True
        packed = pathlib.Path(resources) / "files"
        self._core = (
            _EquationsCore(model_class, self.memory, packed)
            if issubclass(model_class, Model)
            else _PythonCore(model_class, self.memory, packed)
        )

    def setup_experiment(self, start_time: float, *_: Any) -> None:
        self.memory[0] = start_time

    def enter_initialization_mode(self) -> None:
        self._stale = True

    def exit_initialization_mode(self) -> None:
        self._refresh()
        self._initializing = False

    def do_step(self, current_time: float, step_size: float) -> bool:
        try:
            goes_on = self._core.step(current_time, step_size)
        except Exception as error:
            raise ModelFailed(error) from error
        # The sum of squares is quick and without a warning of numpy's; it may overflow where every value is finite.
        if not math.isfinite(self.memory.dot(self.memory)) and not np.isfinite(self.memory).all():
            raise ValueError(self._not_finite())
        return goes_on

    def terminate(self) -> None:
        pass

    def get_real(self, references: list[int]) -> list[float]:
        if self._initializing and self._stale:
            self._refresh()
        values: list[float] = self.memory[self._places(references)].tolist()
        return values

    def set_real(self, references: list[int], values: list[float]) -> None:
        self._stale = True
        self.memory[self._places(references)] = values

    def _places(self, references: list[int]) -> Any:
        """An index of the memory; a master asks for the same few sets of variables throughout a run."""
        key = tuple(references)
        places = self._known.get(key)
        if places is None:
            block = slice(references[0], references[0] + len(references)) if references else slice(0)
            is_block = key == tuple(range(block.start or 0, block.stop))
            places = self._known[key] = block if is_block else np.array(references)
        return places

    set_integer = set_boolean = set_real

    def get_integer(self, references: list[int]) -> list[int]:
        return [int(value) for value in self.get_real(references)]

    def get_boolean(self, references: list[int]) -> list[bool]:
        return [value != 0.0 for value in self.get_real(references)]

    def get_string(self, references: list[int]) -> list[str]:
        raise TypeError("the model has no variables of type String")

    set_string = get_string

    def _refresh(self) -> None:
        try:
            self._core.initialize()
        except Exception as error:
            raise ModelFailed(error) from error
        self._stale = False

    def _not_finite(self) -> str:
        """Names the first variable that is not finite; inputs come before the variables that they affect."""
        for kind in ("parameter", "input", "state", "output"):
            for scalar in self.layout.scalars:
                places = self.layout.groups[kind]
                if places.start <= scalar.place < places.stop and not math.isfinite(self.memory[scalar.place]):
                    return f"{kind} {scalar.name} is not finite: {self.memory[scalar.place]}"
        return "a calculated parameter is not finite"

    def _get_log_queue(self) -> list[LogMessage]:
        return self._log

    def _get_fmu_state(self) -> dict[str, Any]:
        return {
            "memory": self.memory.tobytes(),
            "own": self._core.own_state(),
            "initializing": self._initializing,
            "stale": self._stale,
        }

    def _set_fmu_state(self, state: dict[str, Any]) -> None:
        self.memory[:] = np.frombuffer(state["memory"])
        self._core.restore(state["own"])
        self._initializing, self._stale = state["initializing"], state["stale"]

    @staticmethod
    def _fmu_state_to_bytes(state: dict[str, Any]) -> bytes:
        return pickle.dumps(state)

    @staticmethod
    def _fmu_state_from_bytes(state: bytes) -> dict[str, Any]:
        return pickle.loads(state)


_traced: dict[type[Model], Equations] = {}


class _EquationsCore:
    """Steps a model given as equations, through CasADi's virtual machine."""

    def __init__(self, model_class: type[Model], memory: Any, packed: pathlib.Path):
        equations = _traced.get(model_class) or _traced.setdefault(model_class, trace(model_class, packed))
        groups = equations.layout.groups
        self._memory = memory
        self._head = memoryview(memory)  # writes single numbers faster than an array
        self._calculate = _buffered(equations.calculate, memory, memory[groups["calculated"]])
        self._initial = _buffered(equations.initial, memory, memory[groups["state"]])
        self._tail = memory[groups["state"].start :]
        self._result = np.zeros(self._tail.size)
        self._step = _buffered(equations.step, memory, self._result)
        self._outputs = slice(groups["state"].stop - groups["state"].start, None)

    def initialize(self) -> None:
        self._memory[1] = 0.0
        self._calculate()
        self._initial()
        self._step()
        self._tail[self._outputs] = self._result[self._outputs]

    def step(self, t: float, h: float) -> bool:
        self._head[0], self._head[1] = t, h
        self._step()
        self._tail[:] = self._result
        return True

    def own_state(self) -> None:
        """None: the memory holds every state."""

    def restore(self, own: None) -> None:
        pass


class _PythonCore:
    """Steps a model given as `do_step`."""

    def __init__(self, model_class: type[PythonModel], memory: Any, packed: pathlib.Path):
        self._memory, self._layout = memory, model_class.layout()
        self._model = made(model_class, packed)
        self._declared = {v.name.partition(".")[0] for v in self._layout.variables} | {PACKED}
        self._outputs = {v.name for v in self._layout.of("output")}
        self.step = self._first_step
        self._start = memory.copy()
        self._new = self.own_state()

    def initialize(self) -> None:
        # In initialization mode this runs again whenever inputs change, each time from the same state.
        self.restore(self._new)
        states = self._layout.groups["state"]
        self._memory[states] = self._start[states]
        _show(self._model, self._memory, self._layout, GROUPS)
        self._model.initialize()
        _store(self._model, self._memory, self._layout, ("calculated", "state"))
        _show(self._model, self._memory, self._layout, ("calculated", "state"))
        kept, own = self._memory[states].copy(), self.own_state()
        self._watch = Watch(self._model, [v.name for group in ("state", "output") for v in self._layout.of(group)])
        self._model.do_step(self._memory[0], 0.0)
        _store(self._model, self._memory, self._layout, ("output",))
        self._memory[states] = kept
        self.restore(own)

    def _first_step(self, t: float, h: float) -> bool:
        goes_on = self._later_step(t, h)
        self._watch.check(self._model, self._outputs, self._declared)
        self.step = self._later_step
        return goes_on

    def _later_step(self, t: float, h: float) -> bool:
        _show(self._model, self._memory, self._layout, ("input", "state"))
        goes_on = self._model.do_step(t, h)
        _store(self._model, self._memory, self._layout, ("state", "output"))
        return goes_on is not False

    def own_state(self) -> dict[str, Any]:
        return copy.deepcopy({k: v for k, v in vars(self._model).items() if k not in self._declared})

    def restore(self, own: dict[str, Any]) -> None:
        for name in vars(self._model).keys() - self._declared:
            delattr(self._model, name)
        vars(self._model).update(copy.deepcopy(own))


def _buffered(function: Any, memory: Any, result: Any) -> Any:
    """A call without arguments that evaluates `function` on the head of `memory` into `result`."""
    buffer, evaluate = function.buffer()
    head = memory[: function.numel_in()]
    buffer.set_arg(0, memoryview(head))
    buffer.set_res(0, memoryview(result))
    evaluate.buffer = buffer  # keeps it alive as long as the call
    return evaluate


def _show(model: Any, memory: Any, layout: Layout, groups: tuple[str, ...]) -> None:
    for group in groups:
        for v in layout.of(group):
            values = memory[layout.places[v.name]]
            assign(model, v.name, values.reshape(v.shape, order="F") if v.shape else v.type(values[0]))


def _store(model: Any, memory: Any, layout: Layout, groups: tuple[str, ...]) -> None:
    for group in groups:
        for v in layout.of(group):
            values = np.asarray(getattr(model, v.name), dtype=float)
            if values.shape not in (v.shape, ()):
                raise ValueError(f"{v.name} has shape {v.shape}, do_step made it {values.shape}")
            memory[layout.places[v.name]] = values.ravel(order="F") if values.shape else float(values)
