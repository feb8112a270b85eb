"""Angles are on the circle: what controllers do about them."""

import tomllib

import numpy as np
import pytest

import orchestrator as orch
from experiments import EXPERIMENTS, merged
from fmu_files import SOURCES
from orchestrator.models import build

CONTROLLERS = ("pid", "feedback_linearization", "lyapunov", "mfsosmc", "nstsmc", "ftsosmc")


@pytest.fixture(scope="module")
def turning(_build_folder):
    """The FMU of fmus/turning.py, as the controllers' reference."""
    return build.build([str(SOURCES / "turning.py")])["turning"]


@pytest.fixture
def heading(turning, write, tmp_path):
    """heading(controller, vehicle's start, reference's start, rate, ...) -> time [s], psi and psi_d [deg] of a run."""
    table = tomllib.loads((EXPERIMENTS / "spiral_pid.toml").read_text())

    def run(controller, start, psi_0, rate=0.0, wraps=True, packaging="auto", stop_time=4.0):
        changes = {
            "master.stop_time": stop_time,
            "master.step": 2e-4 if controller == "mfsosmc" else 2e-3,
            "components.controller.fmu": controller,
            "components.vehicle.parameters": {
                "eta_0": [0, 0, 2, 0, 0, np.radians(start)],
                "nu_0": [0, 0, 0, 0, 0, np.radians(rate)],
            },
            "components.reference": {
                "fmu": str(turning),
                "parameters": {"psi_0": np.radians(psi_0), "rate": np.radians(rate), "wraps": wraps},
            },
            "metrics": {},
        }
        path = write(merged(table, changes))
        with orch.run(path, packaging=packaging, results=tmp_path / "results") as record:
            psi, psi_d = (np.degrees(record[name]) for name in ("vehicle.eta.psi", "reference.eta_d.psi"))
            return record.time, psi, psi_d

    return run


@pytest.mark.parametrize("packaging", ["native", "python"])
@pytest.mark.parametrize("controller", CONTROLLERS)
def test_a_controller_turns_the_short_way_round(heading, controller, packaging):
    """From -170 to +170 degrees it is 20 degrees to port, and 340 to starboard."""
    _, psi, _ = heading(controller, -170.0, 170.0, packaging=packaging)
    assert psi.max() <= -170.0 + 1.0  # never to starboard
    assert psi.min() > -190.0 - 10.0  # half the way of overshoot
    assert psi[-1] == pytest.approx(-190.0, abs=3.0)


@pytest.mark.parametrize("packaging", ["native", "python"])
@pytest.mark.parametrize("controller", CONTROLLERS)
def test_a_reference_that_wraps_is_followed_as_one_that_does_not(heading, controller, packaging):
    """The reference passes +180 degrees after 0.5 s; the run is that of the continuous one."""
    given = {"start": 170.0, "psi_0": 170.0, "rate": 20.0, "stop_time": 1.0, "packaging": packaging}
    time, psi, psi_d = heading(controller, wraps=True, **given)
    assert psi_d.min() < -169.0  # it did jump
    np.testing.assert_allclose(psi, 170.0 + 20.0 * time, atol=3.0)
    _, continuous, _ = heading(controller, wraps=False, **given)
    np.testing.assert_allclose(psi, continuous, atol=0.02)  # degrees; relays amplify the rounding of the remainder
