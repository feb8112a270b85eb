"""The live system: instances of the FMUs, and one table of values that they read from and write to.

Every scalar that somebody reads, writes or records has a place in a table of its kind (real, integer, boolean, string):
first the outputs of the components, in order, then their inputs.
"""

from __future__ import annotations

import contextlib
import itertools
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from .errors import FmuError
from .fmu import Fmu, Variable, unpack
from .instance import Instance, Library
from .member import AT_ONCE, PERIOD_END, TICK_END, Member, MemberFailed, failing
from .plan import Part, Plan

DTYPES = {"real": np.float64, "integer": np.int32, "boolean": np.int32, "string": object}
KINDS = tuple(DTYPES)

_loaded_modules: dict[str, tuple[str, Path]] = {}  # by Python FMUs of this process: digest and FMU


class System:
    """An opened plan.  `members`: in the order of stepping; `tables`: {kind: values}, of which the first `computed` are
    outputs; `recorded`: {kind: places}."""

    def __init__(self, plan: Plan, interrupted: Callable[[], bool] = bool):
        self.plan, self._interrupted = plan, interrupted
        self.members: list[Member] = []
        self.tables: dict[str, Any] = {}
        self.recorded: dict[str, Any] = {}
        self.places: dict[tuple[str, str], int] = {}  # of a component's variable in the table of its kind
        self._names: dict[str, list[str]] = {kind: [] for kind in KINDS}  # by place
        self._folder = tempfile.TemporaryDirectory(prefix="orch-", ignore_cleanup_errors=True)
        try:
            self._instantiate()
            self._wire()
        except BaseException:
            self.close()
            raise

    @classmethod
    @contextlib.contextmanager
    def open(cls, plan: Plan, interrupted: Callable[[], bool] = bool) -> Iterator[System]:
        """Instantiate the FMUs; frees them at the end.

        Raises FmuError where one cannot be instantiated, KeyboardInterrupt where it was `interrupted` meanwhile.
        """
        system = cls(plan, interrupted)
        try:
            yield system
        finally:
            system.close()

    def close(self) -> None:
        for member in self.members:
            member.instance.close()
        sys.path[:] = [p for p in sys.path if not p.startswith(self._folder.name)]
        self._folder.cleanup()

    def initialize(self) -> None:
        """Initialization mode: parameters, start values, and sweeps until the outputs agree with the inputs.

        Raises MemberFailed, or AlgebraicLoop where 100 sweeps do not settle.
        """
        stop_time = self.plan.experiment.master.stop_time
        for member in self.members:
            part = member.part
            fits = self.plan.steps % part.period == 0  # else its last step ends beyond the stop time
            with failing(member):
                member.instance.setup(stop_time if fits else None, {**part.parameters, **part.start})
        for _ in range(100):
            before = [table.copy() for table in self.tables.values()]
            for member in self.members:
                self._exchange(member)
            changed = [
                name
                for kind, old in zip(self.tables, before, strict=True)
                for name, a, b in zip(self._names[kind], old, self.tables[kind], strict=True)
                if a != b and a == a  # a nan is reported below as what it is
            ]
            if not changed:
                break
        else:
            raise AlgebraicLoop(changed)
        for member in self.members:
            with failing(member):
                member.instance.begin()
        for member in self.members:
            self._read(member)
            if member.not_finite():
                raise MemberFailed(member, member.not_finite())

    def calculated(self) -> dict[str, dict[str, Any]]:
        """{component: {parameter: value}} of the parameters that FMUs calculate themselves, once initialized.

        Raises MemberFailed.
        """
        found: dict[str, dict[str, Any]] = {}
        for member in self.members:
            variables = [v for v in member.part.fmu.variables.values() if v.causality == "calculatedParameter"]
            with failing(member):
                values = {v.name: member.instance.get(v) for v in variables if v.kind != "string"}
            if values:
                found[member.part.name] = values
        return found

    def _exchange(self, member: Member) -> None:
        for gather in member.gathers:
            gather()
        with failing(member):
            for set_ in member.sets:
                member.instance.check(set_())
        self._read(member)

    def _read(self, member: Member) -> None:
        with failing(member):
            for get in member.gets:
                member.instance.check(get())
        for publish in itertools.chain(*member.publish):
            publish()

    def _instantiate(self) -> None:
        libraries: dict[Path, Library] = {}
        master = self.plan.experiment.master
        for part in self.plan.parts:
            if self._interrupted():
                raise KeyboardInterrupt
            path = part.fmu.path
            if path not in libraries:
                folder = Path(self._folder.name) / str(len(libraries)) / part.fmu.model_identifier
                unpack(part.fmu, folder)
                _claim_modules(part.fmu)
                libraries[path] = Library(part.fmu, folder)
            instance = Instance(part.name, libraries[path])
            h = self.plan.experiment.grid.time(part.period) if part.period > 1 else master.step
            self.members.append(Member(part, instance, h))
        # pythonfmu puts its folders first on the path, where they would hide modules of ours that are yet to come.
        ours = [p for p in sys.path if p.startswith(self._folder.name)]
        sys.path[:] = [p for p in sys.path if p not in ours] + ours

    def _wire(self) -> None:
        plan = self.plan
        sources = {(k.sink, k.input.name): (k.source, k.output.name) for k in plan.links}
        read = {(k.source, k.output.name): k.output for k in plan.links} | {
            (c, v.name): v for c, v in (*plan.recorded, *plan.watched)
        }
        outputs = _Ports((*key, v) for key, v in read.items() if v.causality != "input")
        # Of each component, the driven inputs first, so that they are one block; then those that are only recorded.
        driven = _Ports((k.sink, k.input.name, k.input) for k in plan.links)
        held = _Ports((*key, v) for key, v in read.items() if v.causality == "input" and key not in sources)
        place = self.places

        def reserve(part: Part, ports: _Ports) -> None:
            for kind in KINDS:
                for variable in ports.of(part.name, kind):
                    place[part.name, variable.name] = len(self._names[kind])
                    self._names[kind].append(f"{part.name}.{variable.name}")

        for part in plan.parts:
            reserve(part, outputs)
        self.computed = {kind: len(names) for kind, names in self._names.items()}
        for part in plan.parts:
            reserve(part, driven)
            reserve(part, held)
        for kind in KINDS:
            start: Any = b"" if kind == "string" else 0
            self.tables[kind] = np.full(len(self._names[kind]), start, dtype=DTYPES[kind])
            places = [place[c, v.name] for c, v in plan.recorded if v.kind == kind]
            self.recorded[kind] = np.array(places, dtype=np.intp)
        for member in self.members:
            for kind in KINDS:
                name = member.part.name
                if variables := driven.of(name, kind):
                    origins = np.array([place[sources[name, v.name]] for v in variables], dtype=np.intp)
                    self._wire_inputs(member, kind, variables, place[name, variables[0].name], origins)
                if variables := outputs.of(name, kind):
                    self._wire_outputs(member, kind, variables, place[name, variables[0].name])
                for variable in held.of(name, kind):
                    value = member.part.start.get(variable.name, variable.initial)
                    self.tables[kind][place[name, variable.name]] = value.encode() if kind == "string" else value

    def _wire_inputs(self, member: Member, kind: str, variables: list[Variable], first: int, sources: Any) -> None:
        table = self.tables[kind]
        member.reads(kind, variables, table[: self.computed[kind]], table[first : first + len(variables)], sources)

    def _wire_outputs(self, member: Member, kind: str, variables: list[Variable], first: int) -> None:
        table, n = self.tables[kind], len(variables)
        jacobi = self.plan.experiment.master.algorithm == "jacobi"
        if member.part.period == 1 and not jacobi:
            buffer = table[first : first + n]
        else:
            buffer = np.zeros(n, dtype=DTYPES[kind])
            at_once = [i for i, v in enumerate(variables) if v.feedthrough or member.part.period == 1]
            later = [i for i in range(n) if i not in at_once]
            for chosen, moment in ((at_once, TICK_END if jacobi else AT_ONCE), (later, PERIOD_END)):
                if chosen:
                    places = np.array(chosen, dtype=np.intp)
                    member.publishes(kind, moment, buffer, places, table, places + first)
        if kind == "real":
            member.reals, member.values, member.places = variables, buffer, range(first, first + n)
        member.gives(kind, variables, buffer)


class _Ports:
    """Variables by component and kind, in the order of the FMU."""

    def __init__(self, ports: Iterable[tuple[str, str, Variable]]):
        self._found: dict[tuple[str, str], dict[str, Variable]] = {}
        for component, name, variable in ports:
            self._found.setdefault((component, variable.kind), {})[name] = variable

    def of(self, component: str, kind: str) -> list[Variable]:
        return sorted(self._found.get((component, kind), {}).values(), key=lambda v: v.reference)


class AlgebraicLoop(Exception):
    """The initial values do not settle.  `.signals`: those that still changed."""

    def __init__(self, signals: list[str]):
        shown = ", ".join(signals[:12]) + (", ..." if len(signals) > 12 else "")
        super().__init__(f"the initial values do not settle in 100 sweeps, an algebraic loop through {shown}; "
                         "break it with a component whose output does not depend on its input at once")  # fmt: skip


def _claim_modules(fmu: Fmu) -> None:
    """Refuse a Python FMU whose modules this process already knows as something else: it would compute with those."""
    for module, digest in fmu.python_modules.items():
        if module.startswith(f"{fmu.model_identifier}_{fmu.guid[:12]}"):
            continue  # packaged by us: the name holds the digest of the content
        if module not in _loaded_modules:
            if module in sys.modules:
                where = getattr(sys.modules[module], "__file__", None) or "Python itself"
                raise FmuError(f"{fmu.path} brings a Python module {module!r}, which this process has already loaded "
                               f"from {where}; rename the module in the FMU")  # fmt: skip
            _loaded_modules[module] = (digest, fmu.path)
        its_digest, other = _loaded_modules[module]
        if its_digest != digest:
            raise FmuError(f"{fmu.path} brings another Python module {module!r} than {other}, which this process has "
                           "already loaded; run it in a new process")  # fmt: skip
