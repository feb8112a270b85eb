"""tlog: the vehicles of a run as ground stations would have seen them, ArduSub by ArduSub."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import OrchError, StoreError
from ...experiment import reader
from ...experiment.mavlink import MavlinkSpec
from ...fmu.units import scale
from ...mavlink.fleet import spec_of
from ...mavlink.tlog import LoggedVehicle
from ...mavlink.tlog import write as write_log
from ...mavlink.vehicle.autopilot import Autopilot
from ...mavlink.vehicle.frame import DEFAULT_MAX_THRUST, ThrusterFrame, matrix_of
from ...mavlink.vehicle.modes import FlightMode
from ...mavlink.vehicle.parameters import AutopilotParameters
from ...mavlink.vehicle.sample import Sample, gravity_alone
from ...names import ETA_AXES, NU_UNITS, split_axis
from ...plan.motors import PILOT
from ...records.compare.vehicles import Vehicle, vehicles
from ...records.file.run import Run
from .content import Content

if TYPE_CHECKING:
    from ...arrays import Reals
    from ...plan.plan import Plan

FORCE = ("x", "y", "z")


def check(plan: Plan) -> None:
    """Raises ExperimentError where no record of this plan can become a telemetry log."""
    spec_of(plan)


def write(content: Content, target: Path) -> None:
    """Raises StoreError where the record lacks signals that telemetry needs."""
    run = content.run
    recorded = {vehicle.name: vehicle for vehicle in vehicles(run)}
    if not recorded:
        raise StoreError(f"{run.path} records no vehicle: no component with eta.x to eta.psi")
    facts = run.attributes
    spec = reader.parse(
        Path(facts["experiment"]), facts["experiment_toml"], facts["changes"]["set"], facts["changes"]["swap"]
    ).mavlink_spec
    spec = spec.showing(name for name in recorded if _has(run, name, "nu", tuple(NU_UNITS)))
    missing = [name for name in spec.vehicles if name not in recorded or not _has(run, name, "nu", tuple(NU_UNITS))]
    if missing or not spec.vehicles:
        lacking = " and ".join(f"{name}.nu" for name in missing or recorded)
        raise StoreError(f"{run.path} does not record {lacking}, which telemetry needs: record it and run again")
    logged = [_logged(content, recorded[name], system, spec) for name, system in spec.vehicles.items()]
    with target.open("wb") as file:
        write_log(logged, file)


def _logged(content: Content, vehicle: Vehicle, system: int, spec: MavlinkSpec) -> LoggedVehicle:
    run, name, n = content.run, vehicle.name, len(content.time)
    eta = np.column_stack([vehicle.eta[axis] for axis in ETA_AXES])
    nu = np.column_stack([_in(run, f"{name}.nu.{axis}", unit) for axis, unit in NU_UNITS.items()])
    u = np.column_stack(list(vehicle.u.values())) if vehicle.u else np.zeros((n, 0))
    force = None
    if _has(run, name, "specific_force", FORCE):
        force = np.column_stack([_in(run, f"{name}.specific_force.{axis}", "m/s2") for axis in FORCE])
    guided = all(axis in vehicle.eta_d for axis in ETA_AXES)
    eta_d = np.column_stack([vehicle.eta_d[axis] for axis in ETA_AXES]) if guided else np.full((n, 6), np.nan)

    def sample(row: int) -> Sample:
        return Sample(
            t=float(content.time[row]),
            eta=eta[row],
            nu=nu[row],
            u=u[row],
            specific_force=gravity_alone(eta[row]) if force is None else force[row],
            eta_d=eta_d[row],
            origin=spec.origin,
        )

    frame, own = _frame(run, name, spec.pwm_map)
    autopilot = Autopilot(
        system=system,
        component=name,
        parameters=AutopilotParameters(system, spec.rates, own),
        origin=spec.origin,
        frame=frame,
        mode=FlightMode.GUIDED if guided else FlightMode.MANUAL,
    )
    return LoggedVehicle(autopilot=autopilot, times=content.time, sample=sample, states=_states(run, name))


def _states(run: Run, vehicle: str) -> list[tuple[FlightMode, bool]]:
    """Mode and arming in each row of a vehicle that a pilot steers; [] of others, or where they are not recorded."""
    pilots = {c["name"] for c in run.resolved.get("components", ()) if c["fmu"] == PILOT}
    ends = (ends[:2] for ends in run.resolved.get("connections", ()))
    steering = {sink.partition(".")[0] for sink, source in ends if source == f"{vehicle}.eta.x"} & pilots
    for pilot in steering:
        if {f"{pilot}.mode", f"{pilot}.armed"} <= set(run.signals):
            return [
                (FlightMode(int(m)), bool(a)) for m, a in zip(run[f"{pilot}.mode"], run[f"{pilot}.armed"], strict=True)
            ]
    return []


def _frame(run: Run, component: str, pwm_map: str) -> tuple[ThrusterFrame | None, dict[str, float]]:
    calculated: dict[str, Any] = run.facts_of(component).get("calculated", {})
    indices = {split_axis(name): value for name, value in calculated.items()}
    entries = {index: value for (vector, index), value in indices.items() if vector == "T" and "," in index}
    if not entries:
        return None, {}
    thrust = _parameter(run, component, "max_thrust", DEFAULT_MAX_THRUST)
    try:
        return ThrusterFrame(matrix_of(entries), thrust, pwm_map), {"SIM_MAX_THRUST": thrust}
    except OrchError as error:
        raise StoreError(f"{run.path}: {component}: {error}") from None


def _parameter(run: Run, component: str, name: str, default: float) -> float:
    """Its value: as the experiment sets it, else the start value of the FMU."""
    given = run.fact(component, "parameters")
    if name in given:
        return float(given[name])
    description = run.description(component)
    for variable in () if description is None else description.iter():
        if variable.get("name") == name:  # FMI 3.0 has the value here, FMI 2.0 one below
            return next((float(start) for element in variable.iter() if (start := element.get("start"))), default)
    return default


def _in(run: Run, signal: str, unit: str) -> Reals:
    values: Reals = run[signal] * scale(run.units(signal), unit)
    return values


def _has(run: Run, component: str, vector: str, axes: tuple[str, ...]) -> bool:
    return {f"{component}.{vector}.{axis}" for axis in axes} <= set(run.signals)
