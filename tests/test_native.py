"""Native FMUs through the calls of FMI 2.0.  What holds for both packagings is in test_every_fmu.py."""

import ctypes
import dataclasses
import math

import fmpy
import numpy as np
import pytest

from fmu_files import needs_compiler
from orchestrator.errors import FmuError
from orchestrator.fmu.fmu import read
from orchestrator.instances.fmi2 import Fmi2Instance
from orchestrator.instances.instance import CallFailed
from orchestrator.instances.library import Library
from orchestrator.models import build, catalogue

FMUS = sorted(catalogue.shipped())
WITH_INPUTS = [name for name in FMUS if "reference" not in name and "current" not in name]

pytestmark = needs_compiler
every_fmu = pytest.mark.parametrize("name", FMUS)


@pytest.fixture(scope="session")
def native(_build_folder):
    """{name: FMU} of all shipped models."""
    return build.build(FMUS, packaging="native")


@pytest.fixture(scope="session")
def folders(native, tmp_path_factory):
    return {name: fmpy.extract(str(path), str(tmp_path_factory.mktemp(name))) for name, path in native.items()}


class Calls:
    """One instance.  A call that fails raises CallFailed with what the FMU has said."""

    def __init__(self, fmu, folder):
        self.instance, self.variables = Fmi2Instance("one", Library(fmu, folder)), fmu.variables

    def __getattr__(self, call):
        return lambda *arguments: self.instance.call(call.removeprefix("fmi2"), *arguments)

    def names(self, *causalities):
        return [n for n, v in self.variables.items() if v.causality in causalities and v.type == "Real"]

    def references(self, names):
        return (ctypes.c_uint * len(names))(*(self.variables[n].reference for n in names))

    def get(self, names):
        values = (ctypes.c_double * len(names))()
        self.fmi2GetReal(self.references(names), ctypes.c_size_t(len(names)), values)
        return np.array(values)

    def set(self, values):
        numbers = (ctypes.c_double * len(values))(*values.values())
        self.fmi2SetReal(self.references(list(values)), ctypes.c_size_t(len(values)), numbers)

    def enter(self, t=0.0):
        self.fmi2SetupExperiment(0, ctypes.c_double(), ctypes.c_double(t), 0, ctypes.c_double())
        self.fmi2EnterInitializationMode()
        return self

    def start(self):
        self.enter().fmi2ExitInitializationMode()
        return self

    def step(self, t, h):
        self.fmi2DoStep(ctypes.c_double(t), ctypes.c_double(h), 0)

    def reals(self):
        return self.get(self.names("output", "local", "calculatedParameter", "parameter", "input"))

    def save(self):
        state = ctypes.c_void_p()
        self.fmi2GetFMUstate(ctypes.byref(state))
        return state

    def serialized(self):
        size, state = ctypes.c_size_t(), self.save()
        self.fmi2SerializedFMUstateSize(state, ctypes.byref(size))
        data = ctypes.create_string_buffer(size.value)
        self.fmi2SerializeFMUstate(state, data, size)
        return data

    def derivative(self, unknowns, known):
        changes = (ctypes.c_double * len(unknowns))()
        self.fmi2GetDirectionalDerivative(
            self.references(unknowns),
            ctypes.c_size_t(len(unknowns)),
            self.references([known]),
            ctypes.c_size_t(1),
            ctypes.byref(ctypes.c_double(1.0)),
            changes,
        )
        return np.array(changes)


@pytest.fixture
def calls(native, folders):
    """(name of a model) -> a new instance."""
    opened = []

    def instance(name):
        opened.append(Calls(read(native[name]), folders[name]))
        return opened[-1]

    yield instance
    for each in opened:
        each.instance.close()


def around(fmu, names, random, size):
    """{name: value} near the start values, away from the kinks at zero."""
    return {n: fmu.variables[n].initial + size * random.uniform(0.1, 1) for n in names}


def inputs_at(k):
    """(fmu, k) -> inputs that change from step to step."""
    return lambda fmu: around(fmu, fmu.names("input"), np.random.default_rng(k), 0.5)


def drive(fmu, steps, h=0.01):
    for k in range(steps):
        fmu.set(inputs_at(k)(fmu))
        fmu.step(k * h, h)
    return fmu.reals()


# --- States and failures ----------------------------------------------------------------------------------------------


@every_fmu
def test_reset_gives_the_start_again_bit_for_bit(calls, name):
    fmu = calls(name).start()
    first = drive(fmu, 5)
    fmu.fmi2Reset()
    random = np.random.default_rng(1)
    fmu.set(around(fmu, fmu.names("parameter"), random, 0.2))
    other = drive(fmu.start(), 5)
    fmu.fmi2Reset()
    again = drive(fmu.start(), 5)
    assert again.tobytes() == first.tobytes()
    assert other.tobytes() != first.tobytes()


@pytest.mark.parametrize("name", WITH_INPUTS)
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_an_input_that_is_not_finite_is_named_and_leaves_the_states_as_they_were(calls, name, value):
    expected = drive(calls(name).start(), 5)
    fmu = calls(name).start()
    drive(fmu, 4)
    before, bad = fmu.reals(), fmu.names("input")[0]
    good = dict(zip([bad], fmu.get([bad]), strict=True))
    fmu.set({bad: value})
    with pytest.raises(CallFailed) as caught:
        fmu.step(0.04, 0.01)
    assert str(caught.value) == f'fmi2Error: "input {bad} is not finite: {value}"'
    fmu.set(good)
    assert fmu.reals().tobytes() == before.tobytes()
    fmu.set(inputs_at(4)(fmu))
    fmu.step(0.04, 0.01)
    assert fmu.reals().tobytes() == expected.tobytes()


def test_a_parameter_that_is_not_finite_is_named_by_the_first_step(calls):
    fmu = calls("bluerov2_thesis")
    fmu.set({"X_udot": math.nan})
    fmu.start()
    with pytest.raises(CallFailed, match="parameter X_udot is not finite: nan"):
        fmu.step(0.0, 0.01)


def test_the_time_of_the_last_successful_step_is_known(calls):
    fmu, time = calls("pid").start(), ctypes.c_double()
    for t, h, x in ((0.0, 0.5, 1.0), (0.5, 0.25, math.nan)):
        fmu.set({"eta.x": x})
        if math.isnan(x):
            with pytest.raises(CallFailed):
                fmu.step(t, h)
        else:
            fmu.step(t, h)
        fmu.fmi2GetRealStatus(2, ctypes.byref(time))
        assert time.value == 0.5


@every_fmu
def test_the_bytes_of_another_models_state_are_refused(calls, name):
    other = FMUS[FMUS.index(name) - 1]
    data, state = calls(other).start().serialized(), ctypes.c_void_p()
    with pytest.raises(CallFailed, match="the bytes are not of a state of this model"):
        calls(name).fmi2DeSerializeFMUstate(data, ctypes.c_size_t(len(data)), ctypes.byref(state))
    assert not state


def test_cut_bytes_of_a_state_are_refused(calls):
    fmu, state = calls("pid").start(), ctypes.c_void_p()
    data = fmu.serialized()
    with pytest.raises(CallFailed, match="the bytes are not of a state of this model"):
        fmu.fmi2DeSerializeFMUstate(data, ctypes.c_size_t(len(data) - 1), ctypes.byref(state))


# --- Misuse -----------------------------------------------------------------------------------------------------------


def reference(value):
    return ctypes.byref(ctypes.c_uint(value)), ctypes.c_size_t(1), ctypes.byref(ctypes.c_double())


MISUSE = {
    "fmi2SetReal: output tau.X cannot be set": lambda fmu: fmu.start().set({"tau.X": 1.0}),
    "fmi2SetReal: parameter K_p.x cannot be set after initialization mode": (
        lambda fmu: fmu.start().set({"K_p.x": 1.0})
    ),
    "fmi2GetReal: no variable of that type has value reference 1": lambda fmu: fmu.fmi2GetReal(*reference(1)),
    "fmi2GetReal: no variable of that type has value reference 4000000000": (
        lambda fmu: fmu.fmi2GetReal(*reference(4_000_000_000))
    ),
    "fmi2SetReal: no variable of that type has value reference 9999": lambda fmu: fmu.fmi2SetReal(*reference(9999)),
    "fmi2GetBoolean: no variable of that type has value reference 2": lambda fmu: fmu.fmi2GetBoolean(*reference(2)),
    "fmi2GetString: no variable of that type has value reference 2": lambda fmu: fmu.fmi2GetString(*reference(2)),
    "fmi2DoStep must not be called before initialization mode": lambda fmu: fmu.step(0.0, 0.1),
    "fmi2DoStep must not be called in initialization mode": lambda fmu: fmu.enter().step(0.0, 0.1),
    "fmi2EnterInitializationMode must not be called in initialization mode": (
        lambda fmu: fmu.enter().fmi2EnterInitializationMode()
    ),
    "fmi2SetupExperiment must not be called after initialization mode": lambda fmu: fmu.start().enter(),
    "fmi2Terminate must not be called in initialization mode": lambda fmu: fmu.enter().fmi2Terminate(),
    "fmi2DoStep must not be called after fmi2Terminate": lambda fmu: (fmu.start().fmi2Terminate(), fmu.step(0.0, 0.1)),
    "a step from 0 over -0.1 s cannot be taken": lambda fmu: fmu.start().step(0.0, -0.1),
    "a step from nan over 0.1 s cannot be taken": lambda fmu: fmu.start().step(math.nan, 0.1),
    "fmi2GetDirectionalDerivative must not be called before initialization mode": (
        lambda fmu: fmu.derivative(["tau.X"], "eta.x")
    ),
    "fmi2GetDirectionalDerivative: output tau.X cannot be set": lambda fmu: fmu.start().derivative(["tau.X"], "tau.X"),
    "fmi2GetDirectionalDerivative: input eta.x is not an unknown": (
        lambda fmu: fmu.start().derivative(["eta.x"], "eta.x")
    ),
    "fmi2SetFMUstate: no state": lambda fmu: fmu.fmi2SetFMUstate(None),
    "inputs are held over a step; their derivatives cannot be set": lambda fmu: fmu.fmi2SetRealInputDerivatives(
        None, ctypes.c_size_t(0), None, None
    ),
}


@pytest.mark.parametrize("words", MISUSE)
def test_a_call_that_cannot_be_answered_says_why(calls, words):
    with pytest.raises(CallFailed) as caught:
        MISUSE[words](calls("pid"))
    assert str(caught.value) == f'fmi2Error: "{words}"'


def test_another_guid_is_refused_with_both(native, folders):
    fmu = read(native["pid"])
    with pytest.raises(FmuError, match=rf"the GUID old is of another build of the model; this one's is {fmu.guid}"):
        Fmi2Instance("one", Library(dataclasses.replace(fmu, guid="old"), folders["pid"]))


# --- Derivatives ------------------------------------------------------------------------------------------------------


def assert_derivatives(fmu, unknowns, knowns, values):
    """values({known: number}) -> unknowns.

    Central differences err by the square of their step times a third derivative, and by rounding over the step.
    """
    for known, at in knowns.items():
        width = 1e-6 * (abs(at) or 1.0)
        up, down = (values({known: at + side * width}) for side in (1, -1))
        values({known: at})
        expected, found = (up - down) / (2 * width), fmu.derivative(unknowns, known)
        np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-5 * (1 + np.abs(up).max()), err_msg=known)


@pytest.mark.parametrize("name", WITH_INPUTS)
def test_the_derivatives_of_outputs_by_inputs_are_those_of_finite_differences(calls, name):
    random, fmu = np.random.default_rng(3), calls(name).start()
    inputs, outputs = fmu.names("input"), fmu.names("output")
    for t, size in ((0.4, 0.02), (2.5, 0.3), (9.0, 0.1)):
        fmu.set(around(fmu, inputs, random, size))
        fmu.step(t, 0.05)
        knowns, state = around(fmu, inputs, random, size), fmu.save()
        fmu.set(knowns)

        def values(changed, t=t, state=state, knowns=knowns):
            fmu.fmi2SetFMUstate(state)
            fmu.set(knowns | changed)
            there = fmu.save()
            fmu.step(t + 0.05, 0.0)  # the outputs at this instant
            found = fmu.get(outputs)
            fmu.fmi2SetFMUstate(there)
            return found

        assert_derivatives(fmu, outputs, knowns, values)


@every_fmu
def test_the_derivatives_at_the_start_are_those_of_finite_differences(calls, name):
    random = np.random.default_rng(4)
    for t in (0.0, 2.5, 13.8):
        fmu = calls(name).enter(t)
        knowns = around(fmu, fmu.names("parameter", "input"), random, 0.1)
        fmu.set(knowns)
        unknowns = fmu.names("output", "calculatedParameter")

        def values(changed, fmu=fmu, unknowns=unknowns):
            fmu.set(changed)
            return fmu.get(unknowns)

        assert_derivatives(fmu, unknowns, knowns, values)
