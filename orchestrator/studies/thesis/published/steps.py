"""The step study: how MFSOSMC's numbers depend on the communication step, and on how its integral is discretized."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from ..cases.chapter5 import Case, case_name
from .tables import metric_name, published

STEPS = (1e-3, 5e-4, 2e-4, 1e-4, 5e-5, 2e-5, 1e-5)  # s
BASE = Case(name=case_name("spiral", "mfsosmc", t_b=5), task="spiral", controller="mfsosmc", currents=False, t_b=5)
EXPLICIT = {"components.controller.parameters.semi_implicit": False}
STUDY_STEM = "step_study"
CAPTION = (
    "Step study, not in the thesis: every cell of Tables 5.2-5.4 for MFSOSMC with a time base of 5 s over the "
    "communication step, with the integral of sign(s_n) used before (explicit) or after it is advanced "
    "(semi-implicit). "
    "The published values come from a continuous controller. At 1 ms the loop is a saturated limit cycle although the "
    "position errors look right."
)
STUDIED = {
    "rms_T1": "-",
    "rms_T2": "-",
    "rms_T3": "-",
    "rms_T4": "-",
    "rms_T5": "-",
    "rms_T6": "-",
    "rmse_x": "m",
    "rmse_y": "m",
    "rmse_z": "m",
    "rmse_phi": "deg",
    "rmse_theta": "deg",
    "rmse_psi": "deg",
}


def cases() -> list[Case]:
    """The runs of the study: each step with both integrals.  One of them is the case of the tables itself."""
    return [replace(BASE, sets={"master.step": step, **form}) for step in STEPS for form in ({}, EXPLICIT)]


def rows(metrics: Sequence[Mapping[str, float]]) -> list[dict[str, Any]]:
    """One row a run.  metrics: of `cases()`, in their order."""
    theirs = {metric_name(c.quantity): c.corrected for c in published() if c.case == BASE.name and c.quantity != "mean"}
    return [
        {
            "step": case.sets["master.step"],
            "integral": "explicit" if len(case.sets) > 1 else "semi-implicit",
            **{name: of[name] for name in STUDIED},
            "published": theirs,
        }
        for case, of in zip(cases(), metrics, strict=True)
    ]


def csv_text(rows: Sequence[Mapping[str, Any]]) -> str:
    names = ["integral", "step", *STUDIED]
    lines = [",".join(names)]
    lines += [",".join(f"{row[n]:.6g}" if n != "integral" else row[n] for n in names) for row in rows]
    first = rows[0]["published"]
    lines.append(",".join(["published", "", *(f"{first[n]:.4f}" for n in STUDIED)]))
    return "\n".join(lines) + "\n"
