"""Another master on an SSP, in a process of its own.

    python ssp_masters.py libcosim|ecos SYSTEM.ssp TASK.json ROWS.npy

TASK.json: {"step": s, "stride": steps between rows, "rows": how many, "signals": ["component.variable", ...]}.
ROWS.npy: (rows, signals), the first after `stride` steps.
"""

import json
import sys
from pathlib import Path

import numpy as np


def libcosim(ssp, task):
    """Fixed step, Jacobi: all components step at once, then their outputs are passed on.  Step: the SSP's own."""
    from libcosimpy.CosimExecution import CosimExecution
    from libcosimpy.CosimLogging import CosimLogLevel, log_output_level
    from libcosimpy.CosimObserver import CosimObserver

    log_output_level(CosimLogLevel.WARNING)
    execution = CosimExecution.from_ssp_file(ssp)
    observer = CosimObserver.create_last_value()
    assert execution.add_observer(observer)
    index = {info.name.decode(): info.index for info in execution.slave_infos()}
    references = {
        name: {v.name.decode(): v.reference for v in execution.slave_variables(i)} for name, i in index.items()
    }
    wanted = {}
    for place, signal in enumerate(task["signals"]):
        component, _, variable = signal.partition(".")
        wanted.setdefault(component, []).append((place, references[component][variable]))
    rows = np.empty((task["rows"], len(task["signals"])))
    for row in rows:
        assert execution.step(task["stride"])
        for component, places in wanted.items():
            row[[p for p, _ in places]] = observer.last_real_values(index[component], [r for _, r in places])
    return rows


def ecos(ssp, task):
    """Fixed step, Jacobi likewise.  Step and the parameter set to apply are the user's to name."""
    from ecospy import EcosLib, EcosSimulation

    EcosLib.set_log_level("warn")
    names = [signal.replace(".", "::", 1) for signal in task["signals"]]
    rows = np.empty((task["rows"], len(names)))
    with EcosSimulation(ssp_path=ssp, step_size=task["step"]) as simulation:
        assert simulation.init(parameter_set="initialValues"), EcosLib.get_last_error()
        for row in rows:
            simulation.step(task["stride"])
            row[:] = [simulation.get_real(name) for name in names]
        simulation.terminate()
    return rows


if __name__ == "__main__":
    master, system, job, target = sys.argv[1:]
    np.save(target, {"libcosim": libcosim, "ecos": ecos}[master](system, json.loads(Path(job).read_text())))
