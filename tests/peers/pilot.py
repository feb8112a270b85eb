"""A script at a ground station and a run in lock-step: the run waits while the script talks to it over a socket."""

import h5py
from pymavlink import mavutil
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from orchestrator.mavlink import steered
from orchestrator.mavlink.bridge import Bridge
from orchestrator.mavlink.protocol.links import Endpoint
from orchestrator.runs.runner import execute
from orchestrator.simulation.observer import Observer

from .station import Station, free_port


class LockStep(Observer):
    """script: a generator that talks, and yields the simulated time [s] that is to pass before it talks again.

    settle: returns when the bridge has heard all that was sent.
    """

    def __init__(self, plan, script, settle):
        self._step, self._script, self._settle, self._due = plan.experiment.master.step, script, settle, 0

    def opened(self, view):
        self._talk(0)

    def limit(self, tick, last):
        return last if self._due is None else min(last, self._due)

    def progress(self, tick):
        if self._due is not None and tick >= self._due:
            self._talk(tick)

    def _talk(self, tick):
        wait = next(self._script, None)
        self._settle()
        self._due = None if wait is None else tick + round(wait / self._step)

    def has_ended(self):
        return self._due is None


def fly(plan, script, output):
    """Run a plan with a bridge, and script(station) at a Station; returns what the record holds."""
    bridge, context = _bridge(plan, f"udpin:127.0.0.1:{(port := free_port())}")
    station = Station.udpout(port)

    def settle():
        station.ask(mavlink.MAVLink_timesync_message(tc1=0, ts1=1), "TIMESYNC", seconds=10)

    return _run(plan, bridge, context, LockStep(plan, script(station), settle), station, output)


def fly_with_pymavlink(plan, script, output):
    """As `fly`, with the connection of pymavlink that scripts of the vendor use: script(master)."""
    master = mavutil.mavlink_connection(f"udpin:127.0.0.1:{(port := free_port())}")
    bridge, context = _bridge(plan, f"udpout:127.0.0.1:{port}")

    def settle():
        master.mav.timesync_send(0, 1)
        assert master.recv_match(type="TIMESYNC", blocking=True, timeout=10)

    return _run(plan, bridge, context, LockStep(plan, script(master), settle), master, output)


def _bridge(plan, endpoint):
    context = steered.context_of(plan)
    return Bridge(plan, [Endpoint.parse(endpoint)], controls=steered.controls_of(plan, context)), context


def _run(plan, bridge, context, lockstep, station, output):
    try:
        result = execute(bridge.watched(plan), output=output, observers=[bridge, lockstep], context=context)
    finally:
        bridge.close()
        station.close()
    assert result.status == "completed", result.error
    assert lockstep.has_ended(), "the run ended before the script"
    with h5py.File(output) as file:
        return Flight({name: file[name][:] for name in _signals(file)})


def _signals(file):
    names = []
    file.visititems(lambda name, item: names.append(name) if isinstance(item, h5py.Dataset) else None)
    return [name for name in names if not name.startswith("_")]


class Flight(dict):
    """{signal: values}."""

    def at(self, t, signal):
        """The value of a signal at a time [s], or the values of its axes: "vehicle/eta.xyz" has three."""
        row = int(abs(self["time"] - t).argmin())
        if signal in self:
            return self[signal][row]
        name, _, axes = signal.rpartition(".")
        return [self[f"{name}.{axis}"][row] for axis in axes]

    def thrusters(self, t):
        return [self.at(t, f"pilot_motors/u.T{n}") for n in range(1, 7)]
