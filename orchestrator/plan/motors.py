"""The component between the controller and the thrusters of a vehicle that a pilot steers.

A pilot's component gives a reference; that a disarmed vehicle rests, and that sticks drive thrusters, needs a component
of orch's own in the way of the commands.  It stands before the vehicle, so that it adds no delay where components step
one after the other.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

from ..fmu import builtin
from .plan import Component, Connection

PILOT, MOTORS = "mavlink_manual", "mavlink_motors"  # builtins
FROM_PILOT = ("driven", "held", "stick")  # signals


def steered_by(
    pilot: Component, components: Iterable[Component], connections: Iterable[Connection]
) -> Component | None:
    """The vehicle whose `eta` a component takes."""
    sources = {c.source for c in connections if c.sink == pilot.name and c.input.name.startswith("eta.")}
    return next((other for other in components if other.name in sources and other.is_vehicle), None)


def motors_of(pilot: Component, components: Iterable[Component], connections: Iterable[Connection]) -> Component | None:
    """The component that was put before the vehicle which a pilot steers."""
    sinks = {c.sink for c in connections if c.source == pilot.name}
    return next((other for other in components if other.name in sinks and other.fmu_name == MOTORS), None)


def with_motors(
    components: Sequence[Component], connections: Sequence[Connection]
) -> tuple[list[Component], list[Connection]]:
    """Components and connections with motors before each steered vehicle whose thrusters are connected."""
    components, connections = list(components), list(connections)
    for pilot in [c for c in components if c.live and c.fmu_name == PILOT]:
        vehicle = steered_by(pilot, components, connections)
        if vehicle is None or motors_of(pilot, components, connections):
            continue
        fmu = builtin.describe(MOTORS)
        inputs = [v for v in vehicle.fmu.lookup("u").values() if v.causality == "input" and v.kind == "real"]
        into = {c.input.name: c for c in connections if c.sink == vehicle.name}
        names, commands, outputs = {v.name for v in inputs}, fmu.lookup("u_c"), fmu.lookup("u")
        if len(inputs) != len(commands) or not names <= into.keys():
            continue
        name = _free(f"{pilot.name}_motors", {c.name for c in components})
        motors = Component(
            name=name, fmu_name=MOTORS, fmu=fmu, period=vehicle.period, parameters={}, start={}, live=True
        )
        components.insert(components.index(vehicle), motors)
        connections = [c for c in connections if c.sink != vehicle.name or c.input.name not in names]
        for variable, command, output in zip(inputs, commands.values(), outputs.values(), strict=True):
            connections.append(replace(into[variable.name], sink=name, input=command))
            connections.append(Connection(vehicle.name, variable, name, output))
        for signal in FROM_PILOT:
            given = pilot.fmu.lookup(signal)
            for axis, variable in fmu.lookup(signal).items():
                connections.append(Connection(name, variable, pilot.name, given[axis]))
    return components, connections


def _free(name: str, taken: set[str]) -> str:
    while name in taken:
        name += "_"
    return name
