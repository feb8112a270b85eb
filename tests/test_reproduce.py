"""`orch reproduce thesis`: published numbers, verdicts, claims, figures, and the command itself."""

import json
import math
import os
import re
import signal
import subprocess
import sys
import time
from collections import Counter
from dataclasses import fields, replace
from pathlib import Path

import h5py
import numpy as np
import pytest

import orchestrator
from orchestrator.errors import OrchError
from orchestrator.studies import processes
from orchestrator.studies.thesis import reproduce
from orchestrator.studies.thesis.cases import signals as thesis_signals
from orchestrator.studies.thesis.cases.chapter5 import CASES
from orchestrator.studies.thesis.cases.extremes import extremes, extremes_of, pair_extremes
from orchestrator.studies.thesis.cases.signals import Track, body_velocity, rotation
from orchestrator.studies.thesis.pages import index as thesis_page
from orchestrator.studies.thesis.pages.drawing import KINDS, canvas
from orchestrator.studies.thesis.pages.figures import FIGURES
from orchestrator.studies.thesis.published import claims_gripping, claims_spiral
from orchestrator.studies.thesis.published import steps as thesis_steps
from orchestrator.studies.thesis.published import tables as thesis_tables
from orchestrator.studies.thesis.published.claims import ABOUT, ANGLE, BAND, FAILS, HOLDS, PARTLY
from orchestrator.studies.thesis.published.outcome import Reproduction
from orchestrator.studies.thesis.published.tables import Verdict, judge, metric_name, published

ROOT = Path(__file__).parent.parent
CELLS = [cell for cell in published() if cell.quantity != "mean"]
MEANS = [cell for cell in published() if cell.quantity == "mean"]
AS_PUBLISHED = {
    case: {metric_name(c.quantity): c.corrected for c in CELLS if c.case == case} for case in {c.case for c in CELLS}
}


def cell(case="thesis_spiral_mfsosmc_3", quantity="RMSE_x"):
    return next(c for c in CELLS if c.case == case and c.quantity == quantity)


def off_by(factor, case, quantity):
    """Numbers as published, but for one cell."""
    of = AS_PUBLISHED[case] | {metric_name(quantity): factor * AS_PUBLISHED[case][metric_name(quantity)]}
    return judge(AS_PUBLISHED | {case: of})


# --- the published numbers


def test_every_cell_of_the_six_tables_occurs_once():
    assert len(CELLS) == 144
    assert len({(c.table, c.case, c.quantity) for c in published()}) == 180
    per_table = Counter(c.table for c in CELLS)
    assert per_table == {"5.2": 18, "5.3": 18, "5.4": 36, "5.5": 18, "5.6": 18, "5.7": 36}
    assert Counter(c.table for c in MEANS) == dict.fromkeys(per_table, 6)
    assert {c.case for c in CELLS} == {name for name, case in CASES.items() if case.task == "spiral"}


def test_bands_are_those_of_the_controllers():
    bands = {"mfsosmc": 0.05, "pid": 0.08, "lyapunov": 0.20, "feedback_linearization": None}
    for c in CELLS:
        psi_in_still_water = (c.case, c.quantity) == ("thesis_spiral_lyapunov", "RMSE_psi")
        assert c.band == (None if psi_in_still_water else bands[CASES[c.case].controller]), c
    assert all(c.band is None for c in MEANS)


def test_a_corrected_number_says_why():
    changed = [c for c in CELLS if c.printed != c.corrected]
    assert [(c.printed, c.corrected) for c in changed] == [(0.2645, 0.2845)]
    assert all(c.note for c in changed)


def test_corrected_cells_have_the_published_means():
    for row in MEANS:
        parts = [c.corrected for c in CELLS if (c.table, c.case) == (row.table, row.case)]
        # Both the cells and their mean are rounded to four decimals.
        assert row.note or sum(parts) / len(parts) == pytest.approx(row.corrected, abs=1.01e-4), row


# --- verdicts


@pytest.mark.parametrize(
    ("case", "quantity", "factor", "met"),
    [
        ("thesis_spiral_mfsosmc_3", "RMSE_x", 1.049, True),
        ("thesis_spiral_mfsosmc_3", "RMSE_x", 0.949, False),
        ("thesis_spiral_pid", "RMS_T5", 0.925, True),
        ("thesis_spiral_pid", "RMS_T5", 1.081, False),
        ("thesis_spiral_lyapunov", "RMSE_z", 1.19, True),
        ("thesis_spiral_lyapunov", "RMSE_z", 1.21, False),
        ("thesis_spiral_lyapunov", "RMSE_psi", 2.0, None),
        ("thesis_spiral_feedback_linearization", "RMSE_x", 2.0, None),
    ],
)
def test_a_cell_is_met_within_its_band(case, quantity, factor, met):
    c = cell(case, quantity)
    assert Verdict(c, factor * c.corrected).met is met


@pytest.mark.parametrize(("ours", "met"), [(0.0, True), (0.0049, True), (0.0051, False), (math.nan, False)])
def test_a_published_zero_is_met_below_five_thousandths_of_a_degree(ours, met):
    verdict = Verdict(cell(quantity="RMSE_phi"), ours)
    assert verdict.met is met
    assert math.isinf(verdict.error) is not met


def test_a_number_that_is_none_is_outside():
    assert Verdict(cell(), math.nan).met is False


def test_numbers_as_published_are_all_met_and_means_are_computed_from_them():
    verdicts = judge(AS_PUBLISHED)
    assert len(verdicts) == 180
    assert all(v.met in (True, None) for v in verdicts)
    assert thesis_tables.counts(verdicts)["MFSOSMC"] == {
        "cells": 72,
        "within 1%": 72,
        "within 5%": 72,
        "within 20%": 72,
        "gated": 72,
        "outside": 0,
    }
    mean = next(v for v in verdicts if v.cell.quantity == "mean" and v.cell.case == "thesis_spiral_pid")
    assert mean.ours == pytest.approx((0.1788 + 0.2482 + 0.1628) / 3)


def test_one_number_outside_its_band_is_named():
    outside = [v for v in off_by(1.06, "thesis_spiral_mfsosmc_5", "RMS_T3") if v.met is False]
    assert [v.sentence() for v in outside] == [
        "Table 5.4, thesis_spiral_mfsosmc_5, RMS_T3: published 0.1015, ours 0.1076 (+6.00 %), OUTSIDE 5%"
    ]


def test_only_cells_of_cases_that_ran_are_judged():
    verdicts = judge({"thesis_spiral_pid": AS_PUBLISHED["thesis_spiral_pid"]})
    assert {v.cell.case for v in verdicts} == {"thesis_spiral_pid"}


# --- tables as files


def test_the_best_of_a_column_is_bold_in_markdown():
    text = thesis_tables.markdown("5.2", off_by(0.5, "thesis_spiral_pid", "RMSE_x"))
    assert "| RMSE_x | PID | 0.1788 | **0.0894** | -50.00 % | OUTSIDE 8% |" in text
    assert "| RMSE_x | Feedback linearization | **0.1695** | 0.1695 | +0.00 % | reported |" in text


def test_the_slips_of_the_thesis_are_marked():
    assert "[1] printed 0.2645" in thesis_tables.markdown("5.2", judge(AS_PUBLISHED))


@pytest.mark.parametrize("table", thesis_tables.CAPTIONS)
def test_latex_tables_are_well_formed(table):
    text = thesis_tables.latex(table, judge(AS_PUBLISHED))
    assert text.count("{") == text.count("}")
    environments = re.findall(r"\\(begin|end)\{(\w+)\}", text)
    assert environments == [("begin", "table"), ("begin", "tabular"), ("end", "tabular"), ("end", "table")]
    rows = [line for line in text.splitlines() if line.endswith(r"\\")]
    cells = 18 if table not in ("5.4", "5.7") else 36
    assert len(rows) == 1 + cells + 6
    assert all(row.count("&") == 5 for row in rows)
    assert not re.search(r"(?<!\\)%", text.partition("\n")[2]), "an unescaped % hides the rest of a line"
    numbers = [row.split("&")[2].replace(r"\bfseries", "").strip() for row in rows[1:]]
    assert all(re.fullmatch(r"\d+\.\d{4}", number) for number in numbers)
    assert text.count(r"\bfseries") >= 2 * len({c.quantity for c in published() if c.table == table})


def test_csv_tables_read_back():
    import csv

    rows = list(csv.DictReader(thesis_tables.csv_text("5.6", judge(AS_PUBLISHED)).splitlines()))
    assert len(rows) == 24
    assert all(float(row["relative_error"]) == 0 for row in rows if row["quantity"] != "mean")


# --- cases and figures


@pytest.mark.parametrize("case", CASES.values(), ids=CASES)
def test_every_case_has_an_experiment_without_problems(case):
    plan = case.plan()  # what `orch check` does; it raises with every problem
    assert case.path.read_text(encoding="utf-8").startswith("# ")
    assert plan.experiment.record.every == 0.01
    steps = {"spiral": 2e-5, "gripping": 1e-4}
    assert plan.experiment.master.step == (steps[case.task] if case.controller == "mfsosmc" else 1e-3)
    controller = next(component for component in plan.components if component.name.startswith("controller"))
    assert controller.fmu_name == case.controller
    assert controller.parameters.get("t_b") == (case.t_b if case.task == "spiral" else controller.parameters.get("t_b"))
    current = next(component for component in plan.components if component.name == "current")
    assert any(current.parameters.values()) is case.currents


def test_quick_changes_the_step_of_mfsosmc_spirals_alone():
    changed = {name for name, case in CASES.items() if case.quick().sets}
    assert changed == {name for name in CASES if "spiral_mfsosmc" in name}


def test_figures_are_numbered_from_1_to_80_and_show_cases_that_exist():
    assert list(FIGURES) == [f"5.{n}" for n in range(1, 81)]
    for figure in FIGURES.values():
        assert figure.kind in KINDS
        assert figure.cases
        assert set(figure.cases) <= set(CASES)
        assert figure.title
    assert FIGURES["5.7"].stem == "fig_5_07"
    assert len({figure.stem for figure in FIGURES.values()}) == 80


@pytest.mark.parametrize(
    ("number", "kind", "option", "cases"),
    [
        ("5.1", "states", "position", ["thesis_spiral_pid"]),
        ("5.14", "commands", None, ["thesis_spiral_feedback_linearization"]),
        ("5.26", "path", "isometric", ["thesis_spiral_mfsosmc_3"]),
        ("5.41", "forces", None, ["thesis_spiral_mfsosmc_7"]),
        ("5.49", "errors", "psi", [n for n in CASES if "spiral" in n and n[-8:] != "currents" and "feedback" not in n]),
        ("5.53", "errors", "phi", [n for n in CASES if "spiral" in n and n[-8:] == "currents"]),
        ("5.66", "path", "above", ["thesis_gripping_mfsosmc"]),
        ("5.72", "distance", None, ["thesis_gripping_mfsosmc", "thesis_gripping_nstsmc", "thesis_gripping_ftsosmc"]),
        ("5.80", "heading", None, [f"thesis_gripping_{c}_currents" for c in ("mfsosmc", "nstsmc", "ftsosmc")]),
    ],
)
def test_figures_show_what_the_thesis_shows_under_that_number(number, kind, option, cases):
    figure = FIGURES[number]
    assert (figure.kind, list(figure.cases)) == (kind, cases)
    assert option is None or option in figure.options.values()


def still(offset=(0.0,) * 6, psi_d=0.0, start=(1.0, 1.0, 1.0, 0.0, 0.0, 1.0)):
    """A vehicle that converges within 2 s to its set point, and stays there but for an offset."""
    time = np.arange(0.0, 40.005, 0.01)
    left = np.maximum(0.0, 1 - time / 2)[:, None]
    eta_d = np.zeros((len(time), 6))
    eta_d[:, 5] = psi_d
    zero = np.zeros((len(time), 6))
    return Track(
        time=time,
        eta=eta_d + left * np.array(start) + (1 - left) * np.array(offset),
        eta_d=eta_d,
        nu=left * np.ones(6),
        nu_d=zero,
        tau=zero,
        u=zero,
    )


@pytest.mark.parametrize("number", ["5.1", "5.6", "5.7", "5.19", "5.45", "5.66", "5.69", "5.72", "5.73"])
def test_figures_have_axes_with_units_and_z_points_down(number):
    figure = FIGURES[number]
    tracks = {name: [still()] if "spiral" in name else [still(), still(psi_d=180.0)] for name in figure.cases}
    drawn = canvas(figure, tracks)
    labels = [ax.get_ylabel() for ax in drawn.axes]
    assert all(re.search(r"\[(m|deg|N|N m|-|mm)\]", label) for label in labels), labels
    for ax in drawn.axes:
        depth = ax if re.match(r"\$?z", ax.get_ylabel().replace("{", "")) else None
        assert depth is None or depth.yaxis_inverted()
        assert not hasattr(ax, "zaxis") or ax.zaxis_inverted()
    drawn.draw_without_rendering()


def test_the_body_velocity_is_the_inverse_of_the_jacobian():
    eta = np.array([[0.3, -0.2, 1.0, 0.4, -0.7, 2.1], [0, 0, 0, -0.2, 0.5, -1.0]])
    eta_dot = np.array([[0.1, 0.2, -0.3, 0.4, 0.5, -0.6], [1.0, 0, 0, 0, 0, 1.0]])
    nu, R = body_velocity(eta, eta_dot), rotation(eta)
    for k, (phi, theta) in enumerate(eta[:, 3:5]):
        assert R[k] @ R[k].T == pytest.approx(np.eye(3), abs=1e-15)
        T = [
            [1, np.sin(phi) * np.tan(theta), np.cos(phi) * np.tan(theta)],
            [0, np.cos(phi), -np.sin(phi)],
            [0, np.sin(phi) / np.cos(theta), np.cos(phi) / np.cos(theta)],
        ]
        back = np.concatenate([R[k] @ nu[k, :3], T @ nu[k, 3:]])
        assert back == pytest.approx(eta_dot[k], abs=1e-14)  # a few roundings
    assert body_velocity(np.zeros((1, 6)), eta_dot[:1]) == pytest.approx(eta_dot[:1])


# --- claims


def beside(offset=(0.0,) * 6):
    """Vehicle 2, whose set point is 0.5 m away."""
    track, shift = still(np.array(offset), psi_d=180.0), np.array((0, 0.5, 0, 0, 0, 0))
    return replace(track, eta=track.eta + shift, eta_d=track.eta_d + shift)


def pairs(**changed):
    """Two vehicles 0.5 m and 180 degrees apart in every gripping case.  changed: {controller: offset of vehicle 2}."""
    return {
        name: pair_extremes(still(), beside(changed.get(case.controller, (0.0,) * 6)), 10)
        for name, case in CASES.items()
        if case.task == "gripping"
    }


@pytest.mark.parametrize(
    ("offset", "text"),
    [((0, 0.003, 0, 0, 0, 0), "0.5 m apart"), ((0, 0, 0, 0, 0, 0.6), "headings 180 deg apart")],
    ids=["3 mm", "0.6 deg"],
)
def test_a_pair_that_does_not_hold_its_object_fails_the_gate(offset, text):
    claims = claims_gripping.claims(pairs(nstsmc=offset))
    failing = [claim for claim in claims if claim.fails and "NSTSMC" in claim.text]
    assert [claim.section for claim in failing] == ["5.3", "5.4"]
    assert all(text in claim.text and claim.verdict == FAILS for claim in failing)
    good = [claim for claim in claims if text in claim.text and "NSTSMC" not in claim.text]
    assert [claim.verdict for claim in good] == [HOLDS] * 4


def spirals(**changed):
    """A vehicle that converges in every spiral case.  changed: {case: its track}."""
    return {name: extremes(changed.get(name, still()), 10) for name, case in CASES.items() if case.task == "spiral"}


def claim(claims, text, section=None):
    (one,) = (c for c in claims if text in c.text and section in (None, c.section))
    return one


def test_claims_point_to_figures_that_exist():
    for claim in [*claims_gripping.claims(pairs()), *claims_spiral.claims(spirals(), judge(AS_PUBLISHED))]:
        assert claim.figures
        assert {figure for figure in claim.figures if not figure.startswith("Table")} <= set(FIGURES)


def test_one_saturated_step_between_two_rows_is_seen():
    def judged(u):
        track = still()
        track.u[7, 2] = u  # not the tenth, which a row would keep
        return claim(
            claims_spiral.claims(spirals(thesis_spiral_mfsosmc_5=track), judge(AS_PUBLISHED)), "out of saturation"
        )

    assert judged(0.99).verdict == HOLDS
    assert judged(-1.0).verdict == FAILS
    assert "5 s: saturated in 1 steps, last at 0.10 s" in judged(-1.0).ours


@pytest.mark.parametrize("controller", ["mfsosmc", "nstsmc", "ftsosmc"])
@pytest.mark.parametrize(("part", "holds"), [(0.009, True), (0.011, False)])
def test_every_controller_has_converged_within_one_percent_and_no_other_band(controller, part, holds):
    of = pairs()
    one = still(part * np.array((1.0, 1.0, 1.0, 0.0, 0.0, 0.0)))
    of[f"thesis_gripping_{controller}"] = pair_extremes(one, beside(), 10)
    claims = claims_gripping.claims(of)
    name = {"mfsosmc": "MFSOSMC", "nstsmc": "NSTSMC", "ftsosmc": "FTSOSMC"}[controller]
    converges = claim([c for c in claims if c.section == "5.3"], f"{name} converges")
    assert converges.verdict == (HOLDS if holds else PARTLY)
    assert (claim(claims, "All three controllers", "5.3").verdict == HOLDS) is holds


def test_near_zero_begins_when_the_thesis_says_and_phi_counts():
    late, rolled = still(), still()
    late.eta[800:900, 0] += 0.02  # from 8 s to 9 s, before the object is gripped
    rolled.eta[3500, 3] += 0.3  # on the way home
    for track, figures in ((late, ("x1", "2 %")), (rolled, ("phi1", "0.3 deg"))):
        of = pairs()
        of["thesis_gripping_ftsosmc"] = pair_extremes(track, beside(), 10)
        kept = claim(claims_gripping.claims(of), "All three controllers", "5.3")
        assert kept.verdict == PARTLY
        assert all(figure in kept.ours for figure in figures), kept.ours
    of["thesis_gripping_ftsosmc_currents"] = pair_extremes(rolled, beside(), 10)
    assert claim(claims_gripping.claims(of), "keep phi and psi at 0").verdict == PARTLY


def test_theta_is_judged_over_the_whole_task():
    track = still()
    track.eta[3990, 4] = 1.5  # at 39.9 s
    of = pairs() | {"thesis_gripping_mfsosmc": pair_extremes(track, beside(), 10)}
    theta = claim(claims_gripping.claims(of), "theta stays within 1 deg")
    assert (theta.verdict, theta.gated) == (PARTLY, False)
    assert "1.50 and 0.00 deg over the whole task" in theta.ours


def test_docs_and_claims_have_the_same_yardstick():
    text = " ".join((ROOT / "docs" / "thesis.md").read_text(encoding="utf-8").split())
    assert f"at most {BAND:.0%}".replace("%", " %") in text
    assert f"at most {ANGLE:g} degrees" in text
    assert f"within {ABOUT:.0%}".replace("%", " %") in text


@pytest.mark.slow
def test_extremes_taken_while_a_case_runs_are_those_of_all_its_steps(tmp_path):
    case = CASES["thesis_spiral_pid"]
    found = extremes_of([case], tmp_path / "of", lambda message: None)[case.name]
    with orchestrator.run(case.path, {"record.every": 1e-3}, results=tmp_path) as run:
        expected = extremes(thesis_signals.track(run), 10)
    for field in fields(expected):
        assert np.array_equal(getattr(found, field.name), getattr(expected, field.name)), field.name


# --- what to do


def test_a_bare_number_is_the_table_and_fig_the_figure():
    assert reproduce.select(["5.2"]).tables == ("5.2",)
    assert reproduce.select(["fig5.2"]).figures == ("5.2",)
    assert reproduce.select(["Figure 5.57", "5_80", "fig_5_07"]).figures == ("5.57", "5.80", "5.7")
    everything = reproduce.select([])
    assert (len(everything.tables), len(everything.figures), everything.claims, everything.study) == (6, 80, True, True)
    assert not reproduce.select([], quick=True).study


@pytest.mark.parametrize("name", ["5.81", "table5.8", "tables", "4.3", "fig5.0"])
def test_an_unknown_name_says_which_there_are(name):
    with pytest.raises(OrchError, match=r"tables 5\.2 to 5\.7"):
        reproduce.select([name])


def test_only_needs_only_the_runs_of_what_it_shows():
    def needed(*only):
        return [case.name for case in reproduce.select(only).cases(quick=False)]

    assert needed("fig5.1") == ["thesis_spiral_pid"]
    assert needed("5.58") == ["thesis_gripping_mfsosmc"]
    assert needed("5.5") == [n for n, c in CASES.items() if c.task == "spiral" and c.currents]
    assert needed("claims") == list(CASES)
    assert set(needed("steps")) == {"thesis_spiral_mfsosmc_5"}


def test_the_step_study_has_each_step_with_both_integrals():
    assert len(thesis_steps.cases()) == 2 * len(thesis_steps.STEPS)
    rows = thesis_steps.rows([AS_PUBLISHED["thesis_spiral_mfsosmc_5"]] * len(thesis_steps.cases()))
    assert Counter(row["integral"] for row in rows) == {"explicit": 7, "semi-implicit": 7}
    assert rows[0]["published"]["rms_T5"] == 0.0801


def test_the_index_links_every_figure_relatively():
    reproduction = Reproduction(
        folder=Path("x"),
        records=(),
        verdicts=tuple(judge(AS_PUBLISHED)),
        claims=tuple(claims_gripping.claims(pairs())),
        figures=tuple(FIGURES),
        drawn=0,
        outside=("this <b>",),
        study=(),
        quick=False,
    )
    page = thesis_page.page(reproduction)
    sources = re.findall(r'src="([^"]+)"', page)
    assert sources == [f"figures/{figure.stem}.png" for figure in FIGURES.values()]
    assert "prefers-color-scheme: dark" in page
    assert 'name="viewport"' in page
    assert "this &lt;b&gt;" in page
    targets = set(re.findall(r'href="#([^"]+)"', page))
    assert targets <= set(re.findall(r'id="([^"]+)"', page))
    assert "1 outside" in page
    assert "every gated cell lies within its band" in thesis_page.page(replace(reproduction, outside=()))


# --- processes


def command(name, code, cost=1.0):
    return processes.ChildCommand(name=name, arguments=("-c", code), cost=cost)


def test_commands_start_with_the_longest_and_a_crash_ends_no_other():
    watched = []
    crash = "import os, signal, sys; print('well', file=sys.stderr, flush=True); os.kill(os.getpid(), signal.SIGKILL)"
    commands = [
        command("short", "print('out')", 1),
        command("crash", crash, 5),
        command("long", "import sys; sys.exit('why')", 9),
    ]
    results = processes.run_all(commands, lambda running, result: watched.append((list(running), result)), at_once=1)
    assert [(r.command.name, r.code) for r in results] == [("long", 1), ("crash", -signal.SIGKILL), ("short", 0)]
    assert [r.reason for r in results[:2]] == ["why", "the process ended with exit code -9; it last printed: well"]
    assert results[2].stdout.strip() == "out"
    assert watched[0][0] == ["long"]


def test_an_interrupt_ends_every_child(tmp_path):
    child = f"import os, time, pathlib; pathlib.Path({str(tmp_path)!r}, str(os.getpid())).touch(); time.sleep(60)"
    parent = (
        "from orchestrator.studies import processes\n"
        f"commands = [processes.ChildCommand(name=str(k), arguments=('-c', {child!r})) for k in range(3)]\n"
        "processes.run_all(commands, lambda *_: None, at_once=2)"
    )
    for number in (signal.SIGINT, signal.SIGTERM):
        process = subprocess.Popen([sys.executable, "-c", parent], stderr=subprocess.DEVNULL)
        await_(lambda: len(list(tmp_path.iterdir())) == 2)
        process.send_signal(number)
        assert process.wait(20) != 0
        for file in tmp_path.iterdir():
            assert not alive(int(file.name))
            file.unlink()


def await_(condition, seconds=60):
    until = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < until
        time.sleep(0.02)


def alive(pid):
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True


# --- the command


def orch_reproduce(*arguments, cwd, **options):
    command = [sys.executable, "-m", "orchestrator.cli", "reproduce", "thesis", *arguments]
    return subprocess.Popen(command, cwd=cwd, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, **options)


def test_an_unknown_figure_exits_2_and_starts_nothing(tmp_path):
    process = orch_reproduce("--only", "5.99", cwd=tmp_path)
    out, err = process.communicate(timeout=60)
    assert (process.returncode, out) == (2, "")
    assert "5.80" in err
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_one_figure_runs_its_case_once_and_is_drawn_once(tmp_path):
    for expected in ("figures: 1, redrawn: 1", "figures: 1, redrawn: 0"):
        process = orch_reproduce("--only", "fig5.1", cwd=tmp_path)
        out, err = process.communicate(timeout=120)
        assert process.returncode == 0, err
        assert expected in out
    assert "all 1 runs are in the store" in err
    figures = tmp_path / "results" / "_thesis" / "figures"
    assert sorted(p.name for p in figures.iterdir()) == ["fig_5_01.pdf", "fig_5_01.png", "stamps.json"]
    (record,) = (tmp_path / "results").glob("thesis_spiral_pid/*.h5")
    with h5py.File(record, "r+") as file:  # as an orch made it whose metrics were of rows
        del file.attrs["metrics_of"]
    process = orch_reproduce("--only", "fig5.1", cwd=tmp_path)
    _, err = process.communicate(timeout=120)
    assert process.returncode == 0, err
    assert "1 of 1 runs to do" in err
    with h5py.File(record) as file:
        assert file.attrs["metrics_of"] == "steps"


@pytest.mark.slow
def test_ctrl_c_exits_130_and_leaves_no_process(tmp_path):
    process = orch_reproduce("--only", "5.2", cwd=tmp_path)
    await_(lambda: list(tmp_path.glob("results/thesis_spiral_mfsosmc_*/*.h5")))
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 130, err
    assert "Traceback" not in err
    running = [p.read_text() for p in Path("/proc").glob("[0-9]*/cmdline") if readable(p)] if os.name == "posix" else []
    assert not [line for line in running if str(tmp_path) in line]


def readable(path):
    try:
        return bool(path.read_text())
    except OSError:
        return False


@pytest.mark.slow
def test_the_whole_quick_reproduction_is_in_band_and_fast_the_second_time(tmp_path):
    """About 3 minutes on two cores."""
    process = orch_reproduce("--quick", cwd=tmp_path)
    out, err = process.communicate(timeout=1200)
    assert process.returncode == 0, out + err
    folder = tmp_path / "results" / "_thesis"
    summary = json.loads((folder / "summary.json").read_text())
    assert summary["passed"]
    assert summary["quick"]
    counts = summary["counts"]
    assert counts["MFSOSMC"]["within 5%"] == 72
    # What the reference simulation reaches with a continuous controller; docs/thesis.md.
    assert counts["MFSOSMC"]["within 1%"] >= 63
    assert (counts["PID"]["within 5%"], counts["PID"]["outside"]) == (22, 0)
    assert (counts["Lyapunov-based"]["within 5%"], counts["Lyapunov-based"]["within 20%"]) == (19, 23)
    assert counts["Feedback linearization"]["within 20%"] == 13
    assert len(summary["cases"]) == 18
    for suffix in ("md", "csv", "tex"):
        assert len(list(folder.glob(f"table_5_[2-7].{suffix}"))) == 6
    for suffix in ("png", "pdf"):
        assert len(list((folder / "figures").glob(f"fig_5_*.{suffix}"))) == 80
    assert (folder / "claims.md").read_text().count("* **") == len(summary["claims"])
    assert str(tmp_path) not in (folder / "index.html").read_text()
    began = time.monotonic()
    again = orch_reproduce("--quick", cwd=tmp_path)
    out, err = again.communicate(timeout=120)
    assert again.returncode == 0
    assert "figures: 80, redrawn: 0" in out
    assert time.monotonic() - began < 20
