"""Other masters on the same FMUs, each as its users would drive it.

    python benchmarks/peers.py fmpy|libcosim|ecos TASK.json

Runs a task of task.py and prints JSON: `stepping`, seconds of the loop with the recording, and `final`, {signal: value}
at the end.  Rows of the record are kept in memory.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from task import Task

Measured = tuple[float, list[float]]  # s of stepping, last row

# What ecospy's functions call FMI's kinds.
ECOS_KINDS = {"real": "real", "integer": "int", "boolean": "bool"}


def fmpy(task: Task) -> Measured:
    """A loop over FMPy's slaves, after FMPy's examples: components in order, each fed with the newest outputs."""
    import shutil

    from fmpy import extract, read_model_description
    from fmpy.fmi2 import FMU2Slave

    folders = {fmu: extract(fmu) for fmu in {c.fmu for c in task.components}}
    sources = dict(task.connections)
    outputs = sorted({*task.recorded, *sources.values()}, key=lambda v: (v.component, v.reference))
    place = {output: i for i, output in enumerate(outputs)}
    values = [0.0] * len(outputs)
    steppers = []
    for component in task.components:
        description = read_model_description(folders[component.fmu], validate=False)
        slave = FMU2Slave(
            guid=description.guid,
            unzipDirectory=folders[component.fmu],
            modelIdentifier=description.coSimulation.modelIdentifier,
            instanceName=component.name,
        )
        slave.instantiate()
        slave.setupExperiment(startTime=0.0)
        for variable, value in component.values:
            setter = {"real": slave.setReal, "integer": slave.setInteger, "boolean": slave.setBoolean}[variable.kind]
            setter([variable.reference], [value])
        slave.enterInitializationMode()
        inputs = task.of_component(list(sources), component.name)
        own = task.of_component(outputs, component.name)
        steppers.append(
            (
                slave,
                [v.reference for v in inputs],
                [place[sources[v]] for v in inputs],
                [v.reference for v in own],
                slice(place[own[0]], place[own[-1]] + 1) if own else slice(0, 0),
            )
        )

    for _ in steppers:  # as many sweeps as a chain of all of them needs
        for slave, inputs, drivers, references, own in steppers:
            slave.setReal(inputs, [values[i] for i in drivers])
            values[own] = slave.getReal(references)
    for slave, *_ in steppers:
        slave.exitInitializationMode()

    recorded = [place[v] for v in task.recorded]
    rows = [[values[i] for i in recorded]]
    h, stride = task.h, task.stride
    began = time.perf_counter()
    for k in range(task.steps):
        t = task.time(k)
        for slave, inputs, drivers, references, own in steppers:
            if inputs:
                slave.setReal(inputs, [values[i] for i in drivers])
            slave.doStep(currentCommunicationPoint=t, communicationStepSize=h)
            values[own] = slave.getReal(references)
        if (k + 1) % stride == 0:
            rows.append([values[i] for i in recorded])
    stepping = time.perf_counter() - began
    for slave, *_ in steppers:
        slave.terminate()
        slave.freeInstance()
    for folder in folders.values():
        shutil.rmtree(folder, ignore_errors=True)
    return stepping, rows[-1]


def libcosim(task: Task) -> Measured:
    """libcosim's fixed-step algorithm.  Its observer is read every `stride` steps: its files would hold every step."""
    from libcosimpy.CosimExecution import CosimExecution
    from libcosimpy.CosimLogging import CosimLogLevel, log_output_level
    from libcosimpy.CosimObserver import CosimObserver
    from libcosimpy.CosimSlave import CosimLocalSlave

    log_output_level(CosimLogLevel.WARNING)
    execution = CosimExecution.from_step_size(task.step[0] * 1_000_000_000 // task.step[1])  # ns
    index = {c.name: execution.add_local_slave(CosimLocalSlave(c.fmu, c.name)) for c in task.components}
    for component in task.components:
        for variable, value in component.values:
            set_ = getattr(execution, f"{variable.kind}_initial_value")
            _demand(set_(index[component.name], variable.reference, value), f"initial value of {variable.signal}")
    for sink, source in task.connections:
        connect = getattr(execution, f"connect_{sink.kind}_variables")
        failed = connect(index[source.component], source.reference, index[sink.component], sink.reference)
        _demand(failed == 0, f"connection to {sink.signal}")
    observer = CosimObserver.create_last_value()
    _demand(execution.add_observer(observer), "observer")
    wanted = [(index[c.name], [v.reference for v in task.of_component(task.recorded, c.name)]) for c in task.components]

    def row() -> list[float]:
        return [value for slave, references in wanted for value in observer.last_real_values(slave, references)]

    _demand(execution.step(0), "initialization")
    rows = [row()]
    began = time.perf_counter()
    for _ in range(task.steps // task.stride):
        _demand(execution.step(task.stride), "step")
        rows.append(row())
    return time.perf_counter() - began, rows[-1]


def ecos(task: Task) -> Measured:
    """Ecos' fixed-step algorithm.  Its CSV writer records; the last row is read from the simulation, not rounded."""
    import tempfile

    from ecospy import EcosLib, EcosSimulation, EcosSimulationStructure

    EcosLib.set_log_level("warn")
    with tempfile.TemporaryDirectory() as folder, EcosSimulationStructure() as structure:
        for component in task.components:
            structure.add_model(component.name, component.fmu)
        for sink, source in task.connections:
            connect = getattr(structure, f"make_{ECOS_KINDS[sink.kind]}_connection")
            connect(f"{source.component}::{source.name}", f"{sink.component}::{sink.name}")
        convert: dict[str, Callable[[Any], Any]] = {"real": float, "integer": int, "boolean": bool}
        structure.add_parameter_set(
            "start",
            {f"{c.name}::{v.name}": convert[v.kind](value) for c in task.components for v, value in c.values},
        )
        signals = [f"{v.component}::{v.name}" for v in task.recorded]
        with EcosSimulation(structure=structure, step_size=task.h) as simulation:
            rows = str(Path(folder) / "rows.csv")
            simulation.add_csv_writer(rows, identifiers=signals, decimation_factor=task.stride)
            _demand(simulation.init(parameter_set="start"), EcosLib.get_last_error())
            began = time.perf_counter()
            simulation.step(task.steps)
            stepping = time.perf_counter() - began
            final = [simulation.get_real(signal) for signal in signals]
            simulation.terminate()
    return stepping, final


def _demand(succeeded: bool, what: str) -> None:
    if not succeeded:
        raise RuntimeError(f"failed: {what}")


MASTERS = {"fmpy": fmpy, "libcosim": libcosim, "ecos": ecos}


def main() -> None:
    if len(sys.argv) != 3 or sys.argv[1] not in MASTERS:
        raise SystemExit(__doc__)
    task = Task.load(Path(sys.argv[2]))
    stepping, final = MASTERS[sys.argv[1]](task)
    names = [v.signal for v in task.recorded]
    print(json.dumps({"stepping": stepping, "final": dict(zip(names, final, strict=True))}))


if __name__ == "__main__":
    main()
