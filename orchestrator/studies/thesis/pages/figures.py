"""Figures 5.1-5.80 of the thesis: number, title, which runs they show, and how they are drawn."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from ..cases.chapter5 import CASES, TIME_BASES, case_name

TITLES = {  # of the six controllers on the spiral, as the thesis's list of figures names them
    case_name("spiral", "pid"): "the PID controller",
    case_name("spiral", "feedback_linearization"): "the feedback linearization controller",
    case_name("spiral", "lyapunov"): "the Lyapunov-function based controller",
    **{case_name("spiral", "mfsosmc", t_b=t): f"the second-order SMC with t_b = {t} s" for t in TIME_BASES},
}
PER_CONTROLLER = (  # kind, option, title; {} is the controller
    ("states", "position", "Resulting linear positions with {}"),
    ("states", "attitude", "Resulting angular positions with {}"),
    ("states", "velocity", "Resulting linear velocities with {}"),
    ("states", "angular_velocity", "Resulting angular velocities with {}"),
    ("path", "isometric", "Comparison of trajectories with {}"),
    ("forces", "", "Torques per DOF with {}"),
    ("commands", "", "Control signals of each thruster with {}"),
)
SPIRAL_ERRORS = (("x", False), ("y", False), ("z", False), ("phi", False), ("phi", True), ("psi", False), ("psi", True))
GRIPPING_STATES = (
    ("position", "Desired and real positions of UUV{} with the MFSOSMC"),
    ("attitude", "Angular positions of UUV{} with the MFSOSMC"),
    ("velocity", "Linear velocities of UUV{} with the MFSOSMC"),
    ("angular_velocity", "Angular velocities of UUV{} with the MFSOSMC"),
)
GRIPPING_ERRORS = ("x", "y", "z", "phi", "psi")


@dataclass(frozen=True, kw_only=True)
class ThesisFigure:
    """One figure.

    number: such as "5.57".  kind: a function of `drawing`.  cases: of the runs it shows, in the legend's order.
    options: of the function.
    """

    number: str
    title: str
    kind: str
    cases: tuple[str, ...]
    options: Mapping[str, str] = field(default_factory=dict)

    @property
    def stem(self) -> str:
        """fig_5_07 of 5.7."""
        chapter, _, number = self.number.partition(".")
        return f"fig_{chapter}_{int(number):02d}"


def _figures() -> dict[str, ThesisFigure]:
    figures: list[ThesisFigure] = []

    def add(title: str, kind: str, cases: tuple[str, ...], **options: str) -> None:
        figures.append(
            ThesisFigure(number=f"5.{len(figures) + 1}", title=title, kind=kind, cases=cases, options=options)
        )

    for case, controller in TITLES.items():
        for kind, option, title in PER_CONTROLLER:
            name = {"states": "quantity", "path": "view"}.get(kind)
            add(title.format(controller), kind, (case,), **({name: option} if name else {}))
    for currents, where in ((False, ""), (True, " subject to marine currents")):
        cases = tuple(n for n, c in CASES.items() if c.task == "spiral" and c.currents == currents)
        for axis, magnified in SPIRAL_ERRORS:
            what = "Magnification" if magnified else "Comparison"
            without = " (without feedback linearization)" if magnified else ""
            shown = tuple(n for n in cases if not (magnified and CASES[n].controller == "feedback_linearization"))
            add(
                f"{what} of the error convergence of all controllers in the {axis} DOF{where}{without}",
                "errors",
                shown,
                axis=axis,
            )
    gripping = (case_name("gripping", "mfsosmc"),)
    for quantity, title in GRIPPING_STATES:
        for number in ("1", "2"):
            add(title.format(number), "states", gripping, quantity=quantity, vehicle=number)
    add("Desired and real trajectories with the MFSOSMC, isometric", "path", gripping, view="isometric")
    add("Desired and real trajectories with the MFSOSMC, seen from above", "path", gripping, view="above")
    for currents, where in ((False, "without marine currents"), (True, "in the presence of marine currents")):
        cases = tuple(n for n, c in CASES.items() if c.task == "gripping" and c.currents == currents)
        for axis in GRIPPING_ERRORS:
            of = "angle" if axis in ("phi", "psi") else "axis"
            add(f"Error convergence on the {axis} {of} {where}", "errors", cases, axis=axis)
        add(f"Euclidean distance between the UUVs {where}", "distance", cases)
        add(f"Difference between the psi angles of the UUVs {where}", "heading", cases)
    return {figure.number: figure for figure in figures}


FIGURES = _figures()
