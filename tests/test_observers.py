"""Observers of a run: in which order they are called, and that what they are given cannot be written to."""

import re

import numpy as np
import pytest

import orchestrator
from experiments import merged
from orchestrator.runs.runner import execute
from orchestrator.simulation.observer import Observer

pytestmark = pytest.mark.parametrize("loop", ["compiled", "python"])


@pytest.fixture
def observed(resolve, spiral, tmp_path, monkeypatch):
    """observed(observer, loop) runs a short spiral with the observer, returns the record."""

    def run(observer, loop, name="run.h5"):
        monkeypatch.setenv("ORCH_LOOP", loop)
        plan = resolve(merged(spiral, {"master.stop_time": 0.2, "record.every": 0.002, "metrics": {}}))
        result = execute(plan, output=tmp_path / name, observers=[observer])
        assert result.status == "completed", result.error
        return orchestrator.open_run(result.file)

    return run


class Writer(Observer):
    """Tries to write wherever it is given something, and keeps how often it was refused."""

    def __init__(self):
        self.refused = 0

    def attempt(self, array):
        with pytest.raises(ValueError, match="read-only"):
            array[...] = 0
        self.refused += 1

    def opened(self, view):
        self.view = view
        self.attempt(view.tables["real"])
        with pytest.raises(TypeError):
            view.tables["real"] = np.zeros(1)
        with pytest.raises(TypeError):
            view.places["vehicle", "eta.x"] = 0
        with pytest.raises(AttributeError):
            view.tables = {}

    def rows(self, block):
        for values in block.values.values():
            self.attempt(values)
        with pytest.raises(TypeError):
            block.ticks[0] = 1

    def progress(self, tick):
        self.attempt(self.view.tables["real"])


class Watcher(Observer):
    """Keeps the order of calls, and what it sees of one signal."""

    def __init__(self):
        self.calls, self.seen, self.rows_seen = [], {}, []

    def opened(self, view):
        self.calls.append("opened")
        self.table, self.place = view.tables["real"], view.places["vehicle", "eta.x"]
        self.seen[0] = self.table[self.place]

    def rows(self, block):
        self.calls.append("rows")
        self.rows_seen += block.ticks

    def limit(self, tick, last):
        self.calls.append("limit")
        return min(last, tick - tick % 50 + 50)

    def progress(self, tick):
        self.calls.append("progress")
        self.seen[tick] = self.table[self.place]

    def facts(self):
        self.calls.append("facts")
        return {"watcher": len(self.seen)}


def test_observers_cannot_write(observed, loop):
    writer = Writer()
    with observed(Observer(), loop, "quiet.h5") as quiet, observed(writer, loop) as run:
        assert writer.refused > 3
        for name in quiet.signals:
            assert run[name].tobytes() == quiet[name].tobytes()


def test_hooks_are_called_in_order_and_see_the_values_of_their_time(observed, loop):
    watcher = Watcher()
    with observed(watcher, loop) as run:
        order = " ".join(watcher.calls)
        assert re.fullmatch(r"opened rows (limit (rows )?progress )+facts", order), order
        assert watcher.calls.count("limit") >= 200 / 50
        assert watcher.rows_seen == list(range(0, 201, 2))
        true = dict(zip(watcher.rows_seen, run["vehicle.eta.x"], strict=True))
        both = [tick for tick in watcher.seen if tick in true]
        assert {0, 50, 100, 150, 200} <= set(both)
        assert [watcher.seen[tick] for tick in both] == [true[tick] for tick in both]
        assert run.attributes["timing"]["watcher"] == len(watcher.seen)
