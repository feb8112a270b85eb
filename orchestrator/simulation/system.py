"""The system that runs: instances of the FMUs, and the tables of values that they read from and write to.

Every scalar that is connected, recorded or watched has a place in the table of its kind (real, integer, ...): first the
outputs of the components, in order, then their inputs.
"""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from ..arrays import Places, Tables, aligned
from ..errors import FmuError
from ..fmu.fmu import Fmu, unpack
from ..fmu.variables import DTYPES, KINDS, NUMBERS, OBJECTS, Variable
from ..instances import instantiate
from ..instances.instance import Instance
from ..instances.library import Library
from ..instances.live import LiveInstance
from ..instances.opened import Opened
from ..instances.scratch import Scratch
from ..plan.plan import Component, Connection, Plan
from ..warning import Kind, Warned
from ..watch import at_halt, doing
from .observer import SystemView
from .stepper import AT_ONCE, PERIOD_END, TICK_END, Conversion, Getter, Publication, Setter, Stepper, failing

Context = Mapping[str, Mapping[str, Any]]

_loaded_modules: dict[str, str] = {}  # by Python FMUs of this process: their digests


class FmuSource:
    """Where unpacked and loaded FMUs come from: here from their files, every time."""

    def unpack(self, fmu: Fmu, folder: Path) -> None:
        """Put the FMU's files into the folder.  Raises FmuError."""
        unpack(fmu, folder)

    def library(self, fmu: Fmu, folder: Path) -> Library:
        """Its library, from the folder.  Raises FmuError."""
        return Library(fmu, folder)


class System:
    """An opened plan.

    `steppers`: its components, in the order of stepping; `tables`: {kind: values}, of which the first `computed` are
    outputs; `recorded`: {kind: places}; `places`: {(component, variable): place in the table of its kind}.
    """

    def __init__(
        self, plan: Plan, interrupted: Callable[[], bool], context: Context, source: FmuSource, folder: Scratch
    ):
        self.plan, self._interrupted, self._context, self._source = plan, interrupted, context, source
        modules = dict.fromkeys(m for c in plan.components if not c.isolated for m in c.fmu.python_modules)
        self._opened = Opened(modules, folder.path)
        self.steppers: list[Stepper] = []
        self.tables: Tables = {}
        self.recorded: dict[str, Places] = {}
        self.names: dict[str, list[str]] = {kind: [] for kind in KINDS}  # by place
        self.places: dict[tuple[str, str], int] = {}  # of a component's variable in the table of its kind
        self._folder = folder
        try:
            try:
                self._instantiate()
            except FmuError:
                if self._interrupted():  # that may be why
                    raise KeyboardInterrupt from None
                raise
            self._wire()
        except BaseException:
            self.close()
            raise

    @classmethod
    @contextlib.contextmanager
    def open(
        cls,
        plan: Plan,
        interrupted: Callable[[], bool] = bool,
        context: Context | None = None,
        source: FmuSource | None = None,
    ) -> Iterator[System]:
        """Instantiate the FMUs; free them at the end.

        context: {component: what a builtin may need}.  Raises FmuError where an FMU cannot be instantiated,
        KeyboardInterrupt where the user has `interrupted` meanwhile.
        """
        with contextlib.ExitStack() as stack:
            folder = Scratch()
            stack.callback(folder.close)
            stack.enter_context(at_halt(folder.close))
            system = cls(plan, interrupted, context or {}, source or FmuSource(), folder)
            stack.callback(system.close)
            yield system

    def opened_files(self) -> list[Warned]:
        """Warnings of files that Python FMUs have opened until now, and that are not among what they bring."""
        warnings: dict[str, None] = {}
        for component in self.plan.components:
            for module in () if component.isolated else component.fmu.python_modules:
                for path in self._opened.files(module):
                    warnings[
                        f"{component.fmu.model_name} reads {path}, which no digest covers: the run id is the same "
                        f'after a change of it; a model declares it, File("{Path(path).name}")'
                    ] = None
        return [Warned(text, Kind.FILES) for text in warnings]

    def close(self) -> None:
        self._opened.stop()
        for stepper in self.steppers:
            stepper.doing("is freed")
            stepper.instance.close()
        doing("")
        sys.path[:] = [p for p in sys.path if not p.startswith(str(self._folder.path))]

    @cached_property
    def view(self) -> SystemView:
        """What observers see of it."""
        tables = {kind: table.view() for kind, table in self.tables.items()}
        for table in tables.values():
            table.flags.writeable = False
        return SystemView(MappingProxyType(tables), MappingProxyType(self.places))

    def calculated(self) -> dict[str, dict[str, Any]]:
        """{component: {parameter: value}} of the parameters that FMUs calculate themselves, once initialized.

        Raises ComponentFailed.
        """
        parameters: dict[str, dict[str, Any]] = {}
        for stepper in self.steppers:
            chosen = [v for v in stepper.component.fmu.variables.values() if v.causality == "calculatedParameter"]
            for kind in NUMBERS:
                with failing(stepper):
                    values = stepper.instance.values([v for v in chosen if v.kind == kind and not v.element])
                if values:
                    parameters.setdefault(stepper.component.name, {}).update(values)
        return parameters

    def _instantiate(self) -> None:
        libraries: dict[Path, Library] = {}
        folders: dict[Path, Path] = {}
        for component in self.plan.components:
            if self._interrupted():
                raise KeyboardInterrupt
            doing(f"{component.name!r} is loaded")
            path = component.fmu.path
            if path not in folders and not component.live:
                folders[path] = self._folder.path / str(len(folders)) / component.fmu.model_identifier
                self._source.unpack(component.fmu, folders[path])
            if component.live:
                context = {"interrupted": self._interrupted, **self._context.get(component.name, {})}
                instance: Instance = LiveInstance(component.name, component.fmu, context, context.get("replay"))
            else:
                instance = self._instance(component, folders[path], libraries)
            self.steppers.append(Stepper(component, instance, self._step_of(component)))
        # pythonfmu puts its folders first on the path, where they would hide modules that are imported later.
        ours = [p for p in sys.path if p.startswith(str(self._folder.path))]
        sys.path[:] = [p for p in sys.path if p not in ours] + ours

    def _instance(self, component: Component, folder: Path, libraries: dict[Path, Library]) -> Instance:
        path = component.fmu.path
        if component.isolated or _clash(component.fmu):
            from ..instances.isolated import IsolatedInstance  # most runs need no process

            isolated = sum(isinstance(stepper.instance, IsolatedInstance) for stepper in self.steppers) + 1
            spin = isolated < len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else False
            return IsolatedInstance(component.name, component.fmu, folder, component.timeout, spin, self._interrupted)
        if path not in libraries:
            _loaded_modules.update(component.fmu.python_modules)
            libraries[path] = self._source.library(component.fmu, folder)
        return instantiate(component.name, libraries[path])

    def _step_of(self, component: Component) -> float:
        """The component's step [s]."""
        return (
            self.plan.experiment.grid.time(component.period)
            if component.period > 1
            else self.plan.experiment.master.step
        )

    def _wire(self) -> None:
        plan = self.plan
        connections = {(k.sink, k.input.name): k for k in plan.connections}
        read = {(k.source, k.output.name): k.output for k in plan.connections} | {
            (c, v.name): v for c, v in (*plan.recorded, *plan.watched, *plan.measured)
        }
        fmus = {component.name: component.fmu for component in plan.components}
        outputs = _Ports(fmus, ((c, v) for (c, _), v in read.items() if v.causality != "input"))
        # Of each component, the driven inputs first, so that they are one block; then those that are only recorded.
        driven = _Ports(fmus, ((k.sink, k.input) for k in plan.connections))
        held = _Ports(fmus, ((c, v) for (c, _), v in read.items() if v.causality == "input"), besides=driven)
        place = self.places

        def reserve(component: Component, ports: _Ports) -> None:
            for kind in KINDS:
                for variable in ports.of(component.name, kind):
                    place[component.name, variable.name] = len(self.names[kind])
                    self.names[kind].append(f"{component.name}.{variable.name}")

        for component in plan.components:
            reserve(component, outputs)
        self.computed = {kind: len(names) for kind, names in self.names.items()}
        for component in plan.components:
            reserve(component, driven)
            reserve(component, held)
        for kind in KINDS:
            start: Any = b"" if kind in OBJECTS else 0
            n = len(self.names[kind])
            self.tables[kind] = aligned(n) if kind == "real" else np.full(n, start, dtype=DTYPES[kind])
            places = [place[c, v.name] for c, v in plan.recorded if v.kind == kind]
            self.recorded[kind] = np.array(places, dtype=np.intp)
        for stepper in self.steppers:
            name = stepper.component.name
            for kind in KINDS:
                for variable in [*driven.of(name, kind), *held.of(name, kind)]:
                    value = stepper.component.start.get(variable.name, variable.initial)
                    self.tables[kind][place[name, variable.name]] = value.encode() if kind == "string" else value
                if variables := driven.of(name, kind):
                    self._wire_inputs(
                        stepper, kind, variables, place, [connections.get((name, v.name)) for v in variables]
                    )
                if variables := outputs.of(name, kind):
                    self._wire_outputs(stepper, kind, variables, place[name, variables[0].name])

    def _wire_inputs(
        self,
        stepper: Stepper,
        kind: str,
        variables: list[Variable],
        place: Mapping[tuple[str, str], int],
        connections: list[Connection | None],
    ) -> None:
        first, n = place[stepper.component.name, variables[0].name], len(variables)
        buffer = self.tables[kind][first : first + n]
        if stepper.instance.batched:
            buffer = stepper.instance.room(kind, n)
            buffer[:] = self.tables[kind][first : first + n]
        sources, targets, conversions = [], [], []
        for target, connection in enumerate(connections):
            if connection is None:  # an element of an array of which others are connected
                continue
            source = place[connection.source, connection.output.name]
            if connection.direct:
                sources.append(source)
                targets.append(target)
            else:
                conversions.append(
                    Conversion(
                        kind=connection.output.kind,
                        source=source,
                        target=target,
                        factor=connection.factor,
                        offset=connection.offset,
                    )
                )
        computed = {kind: table[: self.computed[kind]] for kind, table in self.tables.items()}
        stepper.add_setter(
            Setter(
                kind=kind,
                variables=variables,
                buffer=buffer,
                sources=np.array(sources, dtype=np.intp),
                targets=np.array(targets, dtype=np.intp),
                conversions=conversions,
            ),
            computed,
        )
        if stepper.instance.batched and self.plan.reads_inputs:
            every = np.arange(n, dtype=np.intp)
            publication = Publication(kind=kind, moment=AT_ONCE, buffer=buffer, chosen=every, targets=every + first)
            stepper.add_publication(publication, self.tables[kind])

    def _wire_outputs(self, stepper: Stepper, kind: str, variables: list[Variable], first: int) -> None:
        table, n = self.tables[kind], len(variables)
        jacobi = self.plan.experiment.master.algorithm == "jacobi"
        if stepper.component.period == 1 and not jacobi and not stepper.instance.batched:
            buffer = table[first : first + n]
        else:
            buffer = stepper.instance.room(kind, n) if stepper.instance.batched else np.zeros(n, dtype=DTYPES[kind])
            at_once = [i for i, v in enumerate(variables) if v.feedthrough or stepper.component.period == 1]
            later = [i for i in range(n) if i not in at_once]
            for chosen, moment in ((at_once, TICK_END if jacobi else AT_ONCE), (later, PERIOD_END)):
                if chosen:
                    places = np.array(chosen, dtype=np.intp)
                    stepper.add_publication(
                        Publication(kind=kind, moment=moment, buffer=buffer, chosen=places, targets=places + first),
                        table,
                    )
        if kind == "real":
            stepper.reals, stepper.places = variables, range(first, first + n)
        stepper.add_getter(Getter(kind=kind, variables=variables, buffer=buffer))


class _Ports:
    """Variables by component and kind, in the order of the FMU; of an array all elements, but for those `besides`."""

    def __init__(self, fmus: Mapping[str, Fmu], ports: Iterable[tuple[str, Variable]], besides: _Ports | None = None):
        self._variables: dict[tuple[str, str], dict[str, Variable]] = {}
        for component, port in ports:
            for variable in fmus[component].elements(port):
                if besides is None or variable.name not in besides._variables.get((component, variable.kind), {}):
                    self._variables.setdefault((component, variable.kind), {})[variable.name] = variable

    def of(self, component: str, kind: str) -> list[Variable]:
        return sorted(self._variables.get((component, kind), {}).values(), key=lambda v: (v.reference, v.element))


def _clash(fmu: Fmu) -> bool:
    """Whether a Python FMU brings a module of which this process has loaded another version, which it would use."""
    for module, digest in fmu.python_modules.items():
        if module.startswith(f"{fmu.model_identifier}_{fmu.guid[:12]}"):
            continue  # packaged by us: the name holds the digest of the content
        if _loaded_modules.get(module, digest) != digest or (module not in _loaded_modules and module in sys.modules):
            return True
    return False
