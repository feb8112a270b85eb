"""Every shipped FMU by itself, in both packagings, driven by FMPy as any other tool would, and held to the contract of
its role."""

import ctypes
import itertools
import math
import shutil
import sys
from pathlib import Path

import fmpy
import numpy as np
import pytest
from fmpy.fmi2 import FMU2Slave
from fmpy.validation import validate_fmu

from fmu_files import SOURCES, needs_compiler
from orchestrator.fmu import units
from orchestrator.fmu.fmu import read
from orchestrator.models import build, catalogue, stamps

FMUS = sorted(catalogue.shipped())
SMALLEST = 1e-300  # s; a step that no state of order 1 notices

every_fmu = pytest.mark.parametrize("name", FMUS)


def axes_of(name, variables):
    """The names of a scalar, or of a vector's axes."""
    return [v for v in variables if v == name or v.startswith((name + ".", name + "["))]


class Alone:
    """One instance.  `variables`: {name: FMPy's ScalarVariable}."""

    def __init__(self, folder, description, name):
        self.variables = {v.name: v for v in description.modelVariables}
        self.slave = FMU2Slave(
            guid=description.guid,
            unzipDirectory=str(folder),
            modelIdentifier=description.coSimulation.modelIdentifier,
            instanceName=name,
        )
        self.slave.instantiate()
        self.running = False

    def enter(self, values=(), start_time=0.0):
        self.slave.setupExperiment(startTime=start_time)
        self.set(values)
        self.slave.enterInitializationMode()
        return self

    def start(self, values=(), start_time=0.0):
        self.enter(values, start_time)
        self.slave.exitInitializationMode()
        self.running = True
        return self

    def close(self):
        if self.running:
            self.slave.terminate()
        self.slave.freeInstance()

    def set(self, values):
        for name, value in dict(values).items():
            variable = self.variables[name]
            getattr(self.slave, f"set{variable.type}")([variable.valueReference], [value])

    def get(self, names):
        """(n,) of the named variables, or of the one scalar or vector."""
        found = [self.variables[n] for n in (axes_of(names, self.variables) if isinstance(names, str) else names)]
        if all(v.type == "Real" for v in found):
            return np.array(self.slave.getReal([v.valueReference for v in found]))
        return np.array([float(getattr(self.slave, f"get{v.type}")([v.valueReference])[0]) for v in found])

    def all(self):
        return self.get(list(self.variables))

    def step(self, t, h):
        self.slave.doStep(t, h)

    def names(self, *causalities):
        return [n for n, v in self.variables.items() if v.causality in causalities]


@pytest.fixture(scope="session")
def unpacked(tmp_path_factory):
    """(path of an FMU) -> its folder and FMPy's description, read once."""
    found = {}

    def unpack(path):
        if path not in found:
            folder = fmpy.extract(str(path), str(tmp_path_factory.mktemp(path.stem)))
            found[path] = folder, fmpy.read_model_description(folder)
        return found[path]

    yield unpack
    for library in (lib for folder, _ in found.values() for lib in Path(folder).glob("binaries/*/*.so")):
        # pythonfmu 0.7.0 gives its state back twice when the process ends, which may abort it, unless asked before.
        getattr(ctypes.CDLL(str(library)), "finalizePythonInterpreter", lambda: None)()


@pytest.fixture(autouse=True)
def _forget_modules():
    """The FMUs' modules leave with the test: orch refuses an FMU whose modules somebody else has loaded."""
    paths, finders = sys.path.copy(), sys.meta_path.copy()
    yield
    folders = tuple(p for p in sys.path if p not in paths)
    for name, module in list(sys.modules.items()):
        if folders and (getattr(module, "__file__", None) or "").startswith(folders):
            del sys.modules[name]
    sys.path[:], sys.meta_path[:] = paths, finders


@pytest.fixture(scope="session", params=["python", pytest.param("native", marks=needs_compiler)])
def shipped(request):
    """{name: FMU} of all shipped models, in either packaging."""
    return build.build(FMUS, packaging=request.param)


@pytest.fixture
def alone(unpacked):
    """(path of an FMU) -> a new instance; all are freed in the end."""
    opened = []

    def instance(path):
        opened.append(Alone(*unpacked(path), f"{path.stem}{len(opened)}"))
        return opened[-1]

    yield instance
    for each in opened:
        each.close()


@pytest.fixture
def own_folder(tmp_path, monkeypatch):
    """Builds of this test go to a folder of its own."""
    monkeypatch.setenv("ORCH_BUILD", str(tmp_path / "built"))
    return tmp_path


def vary(fmu, random, causalities, size):
    """{name: value} around the start values of the real variables."""
    names = [n for n in fmu.names(*causalities) if fmu.variables[n].type == "Real"]
    return {n: float(fmu.variables[n].start) + size * random.uniform(0.1, 1) for n in names}


# The file


@every_fmu
def test_fmpy_finds_no_fault(shipped, name):
    assert validate_fmu(str(shipped[name])) == []


@every_fmu
def test_it_runs_alone_in_fmpy(shipped, unpacked, alone, name):
    folder, _ = unpacked(shipped[name])
    result = fmpy.simulate_fmu(folder, stop_time=0.1, output_interval=0.01)
    outputs = alone(shipped[name]).names("output")
    assert set(result.dtype.names) == {"time", *outputs}
    np.testing.assert_allclose(result["time"], np.linspace(0, 0.1, 11), atol=1e-12)
    assert all(np.isfinite(result[output]).all() for output in outputs)


@every_fmu
def test_every_real_variable_has_a_unit_that_is_defined(shipped, name):
    description = fmpy.read_model_description(shipped[name])
    defined = {unit.name for unit in description.unitDefinitions}
    for variable in description.modelVariables:
        if variable.type == "Real":
            assert variable.unit in defined, variable.name
        assert variable.description, variable.name
    assert {unit: str(meaning) for unit, meaning in read(shipped[name]).units.items()} == {
        unit: str(units.parse(unit)) for unit in defined
    }


@every_fmu
def test_its_state_can_be_saved_and_every_step_size_is_welcome(shipped, name):
    able = fmpy.read_model_description(shipped[name]).coSimulation
    assert able.canGetAndSetFMUstate
    assert able.canSerializeFMUstate
    assert able.canHandleVariableCommunicationStepSize
    assert not able.canBeInstantiatedOnlyOncePerProcess


# Dependencies.  A dependence may show in some places only (limits, segments, the inside of a boundary layer), so the
# found ones are gathered over several times, near the start values and away from them.

TIMES = (0.0, 0.3, 2.5, 7.4, 10.7, 13.8, 18.2, 22.9, 25.1, 28.6, 33.3)  # s; one in each segment of the gripping


def dependents(read, write, knowns, random):
    """{(i, known)}: entries of read() that change when a known does."""
    found, before = set(), read()
    for name, value in knowns.items():
        for size in (1e-3, 0.3):
            write({name: value + size * random.uniform(0.5, 1)})
            found |= {(i, name) for i in np.flatnonzero(read() != before)}
        write({name: value})
    return found


def declared(unknowns):
    assert all(u.dependencies is not None for u in unknowns)
    return {(u.variable.name, d.name) for u in unknowns for d in u.dependencies}


@every_fmu
def test_outputs_depend_on_the_inputs_that_the_description_names(shipped, alone, name):
    random, found = np.random.default_rng(1), set()
    for size, t in itertools.product((0.003, 0.4, 2.0), (0.3, 2.5, 40.0)):
        fmu = alone(shipped[name])
        fmu.start(vary(fmu, random, ["parameter"], min(size, 0.4)))
        fmu.set(vary(fmu, random, ["input"], size))
        fmu.step(0.0, 0.01)
        state, outputs = fmu.slave.getFMUstate(), fmu.names("output")

        def read(fmu=fmu, t=t, state=state, outputs=outputs):
            inputs = {n: fmu.get([n])[0] for n in fmu.names("input")}
            fmu.slave.setFMUstate(state)
            fmu.set(inputs)
            fmu.step(t, SMALLEST)  # what the outputs are at this instant
            return fmu.get(outputs)

        knowns = {n: fmu.get([n])[0] for n in fmu.names("input")}
        found |= {(outputs[i], known) for i, known in dependents(read, fmu.set, knowns, random)}
        fmu.slave.freeFMUstate(state)
    assert found == declared(fmpy.read_model_description(shipped[name]).outputs)


UNSEEN = {  # dependences that the structure of the equations has, and the numbers do not show
    "bluerov2_allocation": {("T_inv[5,3]", "d_y"), ("T_inv[6,3]", "d_y")},  # they cancel
    "nstsmc": {("tau.N", "clamp")},  # an error of heading is at most pi, the clamp 6
}


@every_fmu
def test_initial_values_depend_on_the_inputs_and_parameters_that_the_description_names(shipped, alone, name):
    random, found = np.random.default_rng(1), UNSEEN.get(name, set()).copy()
    for size, t in itertools.product((0.003, 0.4, 30.0), TIMES):
        fmu = alone(shipped[name])
        fmu.enter(start_time=t)
        knowns = vary(fmu, random, ["input"], size) | vary(fmu, random, ["parameter"], min(size, 0.4))
        fmu.set(knowns)
        unknowns = fmu.names("output", "calculatedParameter")
        found |= {
            (unknowns[i], known)
            for i, known in dependents(lambda fmu=fmu, u=unknowns: fmu.get(u), fmu.set, knowns, random)
        }
    assert found == declared(fmpy.read_model_description(shipped[name]).initialUnknowns)


# State


def drive(fmu, random, steps, first=0, h=0.003):
    """Steps with inputs that change; returns every variable after each step."""
    rows = []
    for k in range(first, first + steps):
        fmu.set(vary(fmu, random, ["input"], 0.5))
        fmu.step(k * h, h)
        rows.append(fmu.all())
    return np.array(rows)


def assert_its_state_round_trips(alone, fmu):
    """Saved in mid-run; put back by pointer, by bytes, and by bytes into an instance that has never run."""
    first = alone(fmu)
    first.start(vary(first, np.random.default_rng(1), ["parameter"], 0.2))
    drive(first, np.random.default_rng(2), 5)
    state, now = first.slave.getFMUstate(), first.all()
    saved = first.slave.serializeFMUstate(state)
    expected = drive(first, np.random.default_rng(3), 7, first=5)
    assert len(np.unique(expected, axis=0)) > 1 or not first.names("input")  # something happens in these steps

    first.slave.setFMUstate(state)
    np.testing.assert_array_equal(first.all(), now)
    np.testing.assert_array_equal(drive(first, np.random.default_rng(3), 7, first=5), expected)
    first.slave.setFMUstate(state)  # a state can be used twice
    np.testing.assert_array_equal(drive(first, np.random.default_rng(3), 7, first=5), expected)
    first.slave.freeFMUstate(state)

    other = alone(fmu).start()
    for instance in (first, other):
        copied = instance.slave.deSerializeFMUstate(saved)
        instance.slave.setFMUstate(copied)
        np.testing.assert_array_equal(instance.all(), now)
        np.testing.assert_array_equal(drive(instance, np.random.default_rng(3), 7, first=5), expected)
        instance.slave.freeFMUstate(copied)


@every_fmu
def test_a_restored_state_goes_on_bit_for_bit(shipped, alone, name):
    assert_its_state_round_trips(alone, shipped[name])


@pytest.fixture
def hidden(own_folder):
    """The FMU of a plain Python model that keeps its state in attributes of its own."""
    return build.build([str(SOURCES / "hidden_state.py")])["hidden_state"]


def test_a_plain_python_model_goes_on_from_a_restored_state_with_what_it_keeps_on_self(alone, hidden):
    assert_its_state_round_trips(alone, hidden)


def test_attributes_that_a_model_made_after_the_save_are_gone_after_the_restore(alone, hidden):
    fmu = alone(hidden).start()
    state = fmu.slave.getFMUstate()
    expected = drive(fmu, np.random.default_rng(3), 2)
    drive(fmu, np.random.default_rng(3), 2)  # the third step of all makes `late`
    fmu.slave.setFMUstate(state)
    np.testing.assert_array_equal(drive(fmu, np.random.default_rng(3), 2), expected)
    fmu.slave.freeFMUstate(state)


def test_the_step_that_gives_a_python_models_first_outputs_leaves_no_trace(alone, hidden):
    fmu = alone(hidden).enter()
    first = np.random.default_rng(7).normal()
    for x in (3.0, 5.0):  # initialized again for each, from the same place
        fmu.set({"x": x})
        assert fmu.get(["y"])[0] == x + 1100 + first
    fmu.slave.exitInitializationMode()
    fmu.set({"x": 7.0})
    fmu.step(0.0, 0.1)
    assert fmu.get(["y"])[0] == 7.0 + 1100 + first  # one input, one step


def assert_instances_are_apart(alone, fmu):
    one = alone(fmu)
    values = vary(one, np.random.default_rng(1), ["parameter"], 0.2)
    expected = drive(one.start(values), np.random.default_rng(2), 6)
    first, second = alone(fmu), alone(fmu)
    second.start(vary(second, np.random.default_rng(8), ["parameter"], 0.1))
    first.start(values)
    random, other = np.random.default_rng(2), np.random.default_rng(9)
    rows, others = [], []
    for k in range(6):
        others.append(drive(second, other, 1, first=k))
        rows.append(drive(first, random, 1, first=k))
    np.testing.assert_array_equal(np.concatenate(rows), expected)
    assert (np.concatenate(others) != expected).any()


@every_fmu
def test_two_instances_in_a_process_do_not_touch_each_other(shipped, alone, name):
    assert_instances_are_apart(alone, shipped[name])


def test_two_instances_of_a_plain_python_model_do_not_touch_each_other(alone, hidden):
    assert_instances_are_apart(alone, hidden)


def write_helped(folder, name, length):
    """A model of two helpers, one of which has a helper itself; y = 2 length + 0.1."""
    shutil.copytree(SOURCES / "helped", folder, dirs_exist_ok=True, ignore=shutil.ignore_patterns("__pycache__"))
    (folder / "lever.py").write_text(f"LENGTH = {length}\n")
    return str((folder / "helped.py").rename(folder / f"{name}.py"))


def test_two_models_with_helpers_of_one_name_compute_each_with_its_own(alone, own_folder):
    sources = [write_helped(own_folder / name, name, length) for name, length in (("short", 1.0), ("long", 10.0))]
    fmus = [alone(path).start() for path in build.build(sources).values()]
    for fmu in fmus:
        fmu.step(0.0, 0.1)
    assert [fmu.get(["y"])[0] for fmu in fmus] == [2.1, 20.1]


def test_a_module_that_is_imported_late_is_found_although_the_unpacked_folder_is_gone(alone, unpacked, own_folder):
    path = build.build([write_helped(own_folder, "late", 3.0)])["late"]
    fmu = alone(path).start()
    shutil.rmtree(Path(unpacked(path)[0]) / "resources")
    fmu.step(0.0, 0.1)
    assert fmu.get(["y"])[0] == 6.1


# Building


def test_the_same_sources_give_the_same_bytes_in_any_folder_and_order(shipped, tmp_path, monkeypatch):
    packaging = shipped["pid"].parent.name
    monkeypatch.setenv("ORCH_BUILD", str(tmp_path))
    monkeypatch.setenv("PYTHONHASHSEED", "1")
    built = build.build(FMUS[::-1], packaging=packaging)
    for name in FMUS:
        assert built[name].is_relative_to(tmp_path)
        assert built[name].read_bytes() == shipped[name].read_bytes(), name


def test_an_fmu_does_not_know_where_it_was_built(own_folder, monkeypatch):
    contents = []
    for place in ("here", "there"):
        monkeypatch.setenv("ORCH_BUILD", str(own_folder / place / "built"))
        (own_folder / place).mkdir()
        source = own_folder / place / "wanderer.py"
        shutil.copy(SOURCES / "hidden_state.py", source)
        contents.append(build.build([str(source)])["wanderer"].read_bytes())
    assert contents[0] == contents[1]


def test_a_model_is_built_again_when_its_sources_have_changed_and_only_then(own_folder):
    source, messages = write_helped(own_folder, "stale_or_not", 1.0), []

    def built():
        messages.clear()
        content = build.build([source], messages.append)["stale_or_not"].read_bytes()
        return content, messages.copy()

    first, names = built()
    assert names == ["building stale_or_not"]
    assert built() == (first, [])
    for helper in ("lever", "arm", "elbow"):  # an import, one inside a function, and one of a helper
        file = own_folder / f"{helper}.py"
        text = file.read_text()
        file.write_text(text)  # a new time stamp, the same content
        assert built() == (first, [])
        file.write_text(text.replace("0", "7").replace("2", "3"))
        other, names = built()
        assert names == ["building stale_or_not"]
        assert other != first
        file.write_text(text)
        assert built() == (first, ["building stale_or_not"])
    catalogue.target("stale_or_not", "python").unlink()
    assert built() == (first, ["building stale_or_not"])


def test_a_change_in_the_shared_physics_makes_every_shipped_model_stale(own_folder, monkeypatch, request):
    folder = own_folder / "clone"
    shutil.copytree(catalogue.models_folder(), folder / "fmus", ignore=shutil.ignore_patterns("build", "__pycache__"))
    monkeypatch.setattr(catalogue, "PACKAGE", folder / "orchestrator")
    for cached in (catalogue.shipped, stamps.tools):
        cached.cache_clear()
        request.addfinalizer(cached.cache_clear)
    messages = []
    build.build(FMUS, messages.append, packaging="python")
    physics = folder / "fmus" / "uuv" / "dynamics.py"
    physics.write_text(physics.read_text() + "\n# a word more\n")
    messages.clear()
    build.build(FMUS, messages.append, packaging="python")
    assert sorted(messages) == [f"building {name}" for name in FMUS]
    messages.clear()
    build.build(FMUS, messages.append, packaging="python")
    assert messages == []


# The contract

METRES, SPEEDS = ("m",) * 3 + ("rad",) * 3, ("m/s",) * 3 + ("rad/s",) * 3
POSE = ("x", "y", "z", "phi", "theta", "psi")
SIGNALS = {
    "eta": (POSE, METRES),
    "eta_d": (POSE, METRES),
    "eta_d_dot": (POSE, SPEEDS),
    "eta_d_ddot": (POSE, ("m/s2",) * 3 + ("rad/s2",) * 3),
    "nu": (("u", "v", "w", "p", "q", "r"), SPEEDS),
    "v_c": (("x", "y", "z"), ("m/s",) * 3),
    "tau": (("X", "Y", "Z", "K", "M", "N"), ("N",) * 3 + ("N.m",) * 3),
    "u": (("T1", "T2", "T3", "T4", "T5", "T6"), ("1",) * 6),
    "specific_force": (("x", "y", "z"), ("m/s2",) * 3),
}
SOCKETS = {  # by the folder of the model's source
    "vehicles": (["u", "v_c"], ["eta", "nu", "tau", "specific_force"]),
    "allocations": (["tau"], ["u"]),
    "controllers": (["eta", "nu", "eta_d", "eta_d_dot", "eta_d_ddot"], ["tau"]),
    "references": ([], ["eta_d", "eta_d_dot", "eta_d_ddot"]),
    "disturbances": ([], ["v_c"]),
}
SHIPPED = {
    "bluerov2_thesis",
    "bluerov2_allocation",
    "pid",
    "mfsosmc",
    "feedback_linearization",
    "lyapunov",
    "nstsmc",
    "ftsosmc",
    "spiral_reference",
    "gripping_reference",
    "ocean_current",
}


def axes(signal):
    names, units = SIGNALS[signal]
    return {f"{signal}.{axis}": unit for axis, unit in zip(names, units, strict=True)}


def test_the_models_of_the_contract_are_shipped():
    assert set(FMUS) >= SHIPPED


@every_fmu
def test_it_has_the_socket_of_its_role(shipped, name):
    inputs, outputs = SOCKETS[catalogue.shipped()[name].parent.name]
    variables = fmpy.read_model_description(shipped[name]).modelVariables
    has = {kind: {v.name: v.unit for v in variables if v.causality == kind} for kind in ("input", "output")}
    # One more input would be an error in every experiment that swaps the model in; one more output does no harm.
    assert has["input"] == {axis: unit for signal in inputs for axis, unit in axes(signal).items()}
    needed = {axis: unit for signal in outputs for axis, unit in axes(signal).items()}
    assert needed.items() <= has["output"].items()


def six(gain):
    """A gain in every axis but pitch."""
    return [gain, gain, gain, gain, 0, gain]


THRUSTERS = {"gamma": math.pi / 4, "d_y": 0.115, "d_psi": 0.3536, "max_thrust": 40}
DEFAULTS = {
    "bluerov2_thesis": {
        "m": 10.5,
        "I_x": 0.16,
        "I_z": 0.16,
        "z_g": 0.02,
        "W": 103.005,
        "B": 104.967,
        "X_udot": -5,
        "Y_vdot": -12.7,
        "Z_wdot": -14.57,
        "K_pdot": -0.12,
        "N_rdot": -0.12,
        "X_u": -4.03,
        "Y_v": -6.22,
        "Z_w": -5.18,
        "K_p": -0.07,
        "N_r": -0.07,
        "X_uu": -18.18,
        "Y_vv": -21.66,
        "Z_ww": -36.99,
        "K_pp": -1.55,
        "N_rr": -1.55,
        "C_16": 0,
        "C_26": 5,
        "eta_0": [2, -1, 1, 0, 0, 0],
        "nu_0": [0] * 6,
        **THRUSTERS,
    },
    "bluerov2_allocation": THRUSTERS,
    "pid": {"K_p": six(140), "K_i": six(180), "K_d": six(120)},
    "feedback_linearization": {"K_p": six(140), "K_i": six(180), "K_d": six(120)},
    "mfsosmc": {
        "K_d": six(800),
        "K_i": six(5),
        "kappa": 5,
        "alpha_0": 1.01,
        "alpha_c": 25,
        "delta": 0.001,
        "t_b": 5,
    },
    "ocean_current": {"velocity": [0, 0, 0]},
}


@pytest.mark.parametrize("name", sorted(DEFAULTS))
def test_its_parameters_have_the_names_and_defaults_of_the_contract(shipped, name):
    variables = {v.name: v for v in fmpy.read_model_description(shipped[name]).modelVariables}
    for parameter, default in DEFAULTS[name].items():
        found = [variables[n] for n in axes_of(parameter, variables)]
        assert all(v.causality == "parameter" for v in found)
        values = [float(v.start) for v in found]
        np.testing.assert_allclose(values, np.atleast_1d(default), rtol=1e-12, err_msg=parameter)  # written in decimals


@pytest.mark.parametrize("name", ["bluerov2_thesis", "bluerov2_allocation"])
def test_the_thruster_matrix_is_calculated_from_the_parameters(shipped, alone, name):
    fmu = alone(shipped[name]).enter({"gamma": 0.5, "d_y": 0.2, "d_psi": 0.3})
    c, s = math.cos(0.5), math.sin(0.5)
    T = [
        [c, c, -c, -c, 0, 0],
        [s, -s, s, -s, 0, 0],
        [0, 0, 0, 0, -1, -1],
        [0, 0, 0, 0, 0.2, -0.2],
        [0] * 6,
        [0.3, -0.3, -0.3, 0.3, 0, 0],
    ]
    names = [f"T[{i},{j}]" for i in range(1, 7) for j in range(1, 7)]
    assert {fmu.variables[n].causality for n in names} == {"calculatedParameter"}
    np.testing.assert_allclose(fmu.get(names).reshape(6, 6), T, rtol=1e-15)


# The vehicle, alone

W = 10.5 * 9.81  # N
LEVEL = {"B": W, "W": W, "eta_0.x": 0.0, "eta_0.y": 0.0, "eta_0.z": 0.0}


def test_the_vehicle_at_rest_and_level_reads_minus_g_in_heave(shipped, alone):
    vehicle = alone(shipped["bluerov2_thesis"]).start(LEVEL)
    np.testing.assert_allclose(vehicle.get("specific_force"), [0, 0, -9.81], atol=1e-14)
    vehicle.step(0.0, 0.01)
    np.testing.assert_allclose(vehicle.get("specific_force"), [0, 0, -9.81], atol=1e-14)


def test_a_neutral_vehicle_at_rest_in_still_water_stays_at_rest(shipped, alone):
    vehicle = alone(shipped["bluerov2_thesis"]).start(LEVEL)
    for k in range(1000):
        vehicle.step(k * 0.01, 0.01)
    assert not vehicle.get("eta").any()
    assert not vehicle.get("nu").any()


def test_a_vehicle_that_falls_freely_reads_nothing(shipped, alone):
    vehicle = alone(shipped["bluerov2_thesis"])
    air = {n: 0.0 for n in vehicle.names("parameter") if n[:2] in ("X_", "Y_", "Z_", "K_", "N_")}
    vehicle.start({**LEVEL, **air, "B": 0.0})
    for k in range(100):
        vehicle.step(k * 0.01, 0.01)
    assert vehicle.get(["nu.w"])[0] == pytest.approx(9.81, rel=1e-12)  # 100 roundings
    np.testing.assert_allclose(vehicle.get("specific_force"), 0, atol=1e-12)


def test_the_specific_force_is_the_second_derivative_of_the_position_less_gravity(shipped, alone):
    start = {"eta_0.phi": 0.4, "eta_0.psi": 1.0, "nu_0.u": 0.5, "nu_0.v": -0.4, "nu_0.p": 0.3, "nu_0.r": 1.2}
    vehicle, h = alone(shipped["bluerov2_thesis"]), 1e-3
    vehicle.start(start)
    vehicle.set({"v_c.x": 0.75, "v_c.y": 0.25, "v_c.z": 0.3, "u.T1": 0.4, "u.T2": -0.2, "u.T5": -0.6, "u.T6": 0.1})
    poses, readings = [], []
    for k in range(60):
        vehicle.step(k * h, h)
        poses.append(vehicle.get("eta"))
        readings.append(vehicle.get("specific_force"))
    eta, poses = poses[-2], np.array(poses)
    acceleration = (poses[-1] - 2 * poses[-2] + poses[-3])[:3] / h**2
    (c1, c2, c3), (s1, s2, s3) = np.cos(eta[3:]), np.sin(eta[3:])
    roll = np.array([[1, 0, 0], [0, c1, -s1], [0, s1, c1]])
    pitch = np.array([[c2, 0, s2], [0, 1, 0], [-s2, 0, c2]])
    yaw = np.array([[c3, -s3, 0], [s3, c3, 0], [0, 0, 1]])
    expected = (yaw @ pitch @ roll).T @ (acceleration - [0, 0, 9.81])
    assert np.abs(expected - [0, 0, -9.81]).min() > 0.1  # it accelerates in every axis
    # h^2/12 of the fourth derivative of the position, of order 1000 m/s4 with the roll's damping: 1e-4
    np.testing.assert_allclose(readings[-2], expected, atol=1e-3)


@pytest.mark.parametrize("X", [5.0, 30.0, -20.0])
def test_surge_settles_at_the_root_of_the_drag_polynomial(shipped, alone, X):
    vehicle = alone(shipped["bluerov2_thesis"]).start(LEVEL)
    T = X / (4 * math.sqrt(0.5) * 40)
    vehicle.set({"u.T1": T, "u.T2": T, "u.T3": -T, "u.T4": -T})
    for k in range(10_000):
        vehicle.step(k * 1e-3, 1e-3)
    u = math.copysign((-4.03 + math.sqrt(4.03**2 + 4 * 18.18 * abs(X))) / (2 * 18.18), X)
    assert vehicle.get(["tau.X"])[0] == pytest.approx(X, rel=1e-14)
    # pitch follows surge and turns a little of it into heave: 0.1 % of the speed at 30 N
    assert vehicle.get(["nu.u"])[0] == pytest.approx(u, rel=0.005)


def test_a_parameter_set_before_the_start_is_what_the_run_begins_with(shipped, alone):
    vehicle = alone(shipped["bluerov2_thesis"]).start({"eta_0.z": 4.5, "nu_0.r": 0.25})
    np.testing.assert_array_equal(vehicle.get("eta"), [2, -1, 4.5, 0, 0, 0])
    np.testing.assert_array_equal(vehicle.get("nu"), [0, 0, 0, 0, 0, 0.25])


def test_the_current_is_its_parameter(shipped, alone):
    current = alone(shipped["ocean_current"]).start({"velocity.x": 0.75, "velocity.y": 0.25, "velocity.z": 0.3})
    np.testing.assert_array_equal(current.get("v_c"), [0.75, 0.25, 0.3])
    current.step(0.0, 0.5)
    np.testing.assert_array_equal(current.get("v_c"), [0.75, 0.25, 0.3])
