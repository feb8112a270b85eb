"""The claims of sections 5.1 and 5.2: one vehicle on a spiral, without and with current."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence

from ..cases.chapter5 import TIME_BASES, case_name, spirals
from ..cases.extremes import Extremes
from ..cases.signals import AXES
from .claims import (
    ANGLE,
    BAND,
    POSITIONS,
    SMOOTH,
    Claim,
    about,
    band,
    converged,
    listed,
    peak,
    settled,
    velocities,
    verdict,
)
from .tables import Verdict

LINEAR, ANGULAR, CONTROL = ("5.2", "5.5"), ("5.3", "5.6"), ("5.4", "5.7")  # tables without and with current
CLASSICAL = {"PID": "pid", "feedback linearization": "feedback_linearization", "Lyapunov": "lyapunov"}
LAST_ROUND = 18.0  # s, from when on what is lasting shows: the spiral repeats itself every 12 s until 30 s


def claims(tracks: Mapping[str, Extremes], verdicts: Sequence[Verdict]) -> list[Claim]:
    """tracks: {case: what its vehicle did}.  verdicts: of all cells."""
    means = {(v.cell.table, v.cell.case): v.ours for v in verdicts if v.cell.quantity == "mean"}

    def mean(table: str, controller: str, t_b: int | None = None) -> float:
        return means[table, case_name("spiral", controller, table in ("5.5", "5.6", "5.7"), t_b)]

    return [
        *_pid(tracks["thesis_spiral_pid"]),
        *_feedback(tracks["thesis_spiral_feedback_linearization"]),
        *_lyapunov(tracks["thesis_spiral_lyapunov"]),
        *_mfsosmc(tracks, currents=False),
        *_means(mean),
        *_attitude_of_feedback(tracks),
        *_mfsosmc(tracks, currents=True),
        *_in_current(tracks, mean),
    ]


def _pid(pid: Extremes) -> list[Claim]:
    beyond = {a: _overshoot(pid, a) for a in POSITIONS}
    rest, lasting = _lasting(pid)
    arrived = max(float(pid.time[(pid.of(a) <= band(pid.of(a))).argmax()]) for a in POSITIONS)
    later = pid.time >= arrived
    early, late = peak(pid.u[~later]), peak(pid.u[later])
    return [
        Claim(
            section="5.1.1",
            text="PID overshoots in x, y, z and phi, not in psi, which starts at its desired value",
            figures=("5.1", "5.2"),
            published="overshoot, no number",
            ours=f"{listed(beyond, '.0f', ' %')}, phi {peak(pid.of('phi')):.2f} deg, psi {peak(pid.of('psi')):.2f} deg",
            verdict=verdict(
                *(v > 100 * BAND for v in beyond.values()), peak(pid.of("phi")) > ANGLE, peak(pid.of("psi")) <= ANGLE
            ),
        ),
        Claim(
            section="5.1.1",
            text="PID never brings the errors to zero",
            figures=("5.5", "5.43", "5.44", "5.45"),
            published="a small error remains",
            ours=f"largest error in the last round {listed(rest, '.2g', ' %')} of the initial one",
            verdict=verdict(*lasting),
        ),
        Claim(
            section="5.1.1",
            text="PID works its thrusters hard only at the start; near the trajectory the commands are smooth",
            figures=("5.6", "5.7"),
            published="strong, then constant and smooth",
            ours=f"largest |u| {early:.2f} before each position error has been zero once ({arrived:.2f} s), {late:.2f} "
            f"after it; there changes of at most {peak(pid.jump[later]):.1g} in a step",
            verdict=verdict(late < early, peak(pid.jump[later]) <= SMOOTH),
        ),
    ]


def _feedback(feedback: Extremes) -> list[Claim]:
    late = feedback.time >= LAST_ROUND
    phi, theta = peak(feedback.of("phi")), float(feedback.eta[:, 1, 4].max())
    least, largest = float(feedback.eta[late, 0, 4].min()), float(feedback.eta[late, 1, 4].max())
    rates = {"p": peak(feedback.nu[:, :, 3]), "r": peak(feedback.nu[:, :, 5])}
    after = feedback.time >= 10.0
    return [
        Claim(
            section="5.1.2",
            text="Feedback linearization lets phi and theta overshoot while it catches the spiral",
            figures=("5.9",),
            published="phi 50 deg, theta 40 deg",
            ours=f"phi {phi:.0f} deg, theta {theta:.0f} deg",
            verdict=verdict(about(phi, 50), about(theta, 40)),
        ),
        Claim(
            section="5.1.2",
            text="Under feedback linearization theta stays off zero afterwards",
            figures=("5.9",),
            published="about 10 deg",
            ours=f"{least:.1f} to {largest:.1f} deg in the last round",
            verdict=verdict(about(least, 10) and about(largest, 10)),
        ),
        Claim(
            section="5.1.2",
            text="Feedback linearization reaches angular velocities above 100 deg/s",
            figures=("5.11",),
            published="> 100 deg/s",
            ours=listed(rates, ".0f", " deg/s"),
            verdict=verdict(max(rates.values()) > 100),
        ),
        Claim(
            section="5.1.2",
            text="Its commands are abrupt at first and smooth after about 10 s",
            figures=("5.13", "5.14"),
            published="smooth after 10 s",
            ours=f"changes of up to {peak(feedback.jump[~after]):.2g} in a step of 1 ms before 10 s, "
            f"{peak(feedback.jump[after]):.2g} after; {_saturation(feedback)}",
            verdict=verdict(peak(feedback.jump[~after]) > SMOOTH, peak(feedback.jump[after]) <= SMOOTH),
        ),
    ]


def _lyapunov(lyapunov: Extremes) -> list[Claim]:
    times = {a: settled(lyapunov, a) for a in POSITIONS}
    beyond = max(_overshoot(lyapunov, a) for a in POSITIONS)
    phi = lyapunov.error[:, :, AXES.index("phi")].mean(axis=1)
    crossings = int((phi[1:] * phi[:-1] < 0).sum())
    largest = peak(lyapunov.of("phi"))
    return [
        Claim(
            section="5.1.3",
            text="Lyapunov-based control converges exponentially in about 6 s, without overshoot",
            figures=("5.15", "5.43"),
            published="about 6 s",
            ours=f"zero for good after {listed(times, '.2f', ' s')}; overshoot {beyond:.2g} %",
            verdict=verdict(*(about(v, 6) for v in times.values()), beyond <= 100 * BAND),
        ),
        Claim(
            section="5.1.3",
            text="Its phi oscillates in a small neighbourhood of zero",
            figures=("5.16", "5.47"),
            published="no number",
            ours=f"|phi| at most {largest:.2g} deg, with {crossings} changes of sign",
            verdict=verdict(largest <= ANGLE, crossings > 1),
        ),
    ]


def _mfsosmc(tracks: Mapping[str, Extremes], currents: bool) -> list[Claim]:
    """Convergence at the time base, in position, attitude and velocity; thrusters."""
    section, where = ("5.2", " in the current too") if currents else ("5.1.4", "")
    claims = []
    runs = {f"{t_b} s": tracks[case_name("spiral", "mfsosmc", currents, t_b)] for t_b in TIME_BASES}
    for k, (t_b, track) in enumerate(zip(TIME_BASES, runs.values(), strict=True)):
        after = track.time >= t_b
        left = max(peak(track.of(a)[after]) / track.of(a)[0] for a in POSITIONS)
        angle = max(peak(track.of(a)[after]) for a in ("phi", "psi"))
        base = 22 + 7 * k
        figures = ("5.50", "5.51", "5.52", "5.54", "5.56") if currents else (f"5.{base}", f"5.{base + 1}", "5.43")
        claims.append(
            Claim(
                section=section,
                text=f"MFSOSMC with a time base of {t_b} s has converged in every controlled axis at {t_b} s"
                f"{where} and stays",
                figures=figures,
                published=f"error 0 from {t_b} s",
                ours=f"at most {100 * left:.2g} % of the initial position errors, {angle:.1g} deg of phi and psi left",
                verdict=verdict(*converged(track, t_b, (*POSITIONS, "phi", "psi")).values()),
            )
        )
        if not currents:
            off = velocities(track, t_b)
            claims.append(
                Claim(
                    section=section,
                    text=f"Its velocities have converged at {t_b} s, too",
                    figures=(f"5.{base + 2}", f"5.{base + 3}"),
                    published="at the time base",
                    ours=off.text,
                    verdict=verdict(*off.converged),
                )
            )
    if currents:
        return claims
    jumps = {name: peak(track.jump) for name, track in runs.items()}
    forces = {name: peak(track.tau[:, :, :3]) for name, track in runs.items()}
    saturated = {name: bool(track.saturated.any()) for name, track in runs.items()}
    claims += [
        Claim(
            section=section,
            text="MFSOSMC keeps its thrusters out of saturation",
            figures=("5.28", "5.35", "5.42"),
            published="no saturation",
            ours="; ".join(f"{name}: {_saturation(track)}" for name, track in runs.items()),
            verdict=verdict(not any(saturated.values())),
        ),
        Claim(
            section=section,
            text="Its command signals are smooth and continuous",
            figures=("5.28", "5.35", "5.42"),
            published="smooth",
            ours=f"largest change in one step {listed(jumps, '.2f')}: the relay chatters, and alpha jumps at t_b",
            verdict=verdict(*(v <= SMOOTH for v in jumps.values())),
        ),
        Claim(
            section=section,
            text="A longer time base asks for less force",
            figures=("5.27", "5.34", "5.41"),
            published="less aggressive",
            ours=f"largest force {listed(forces, '.1f', ' N')} in the first steps; Table 5.4 has the RMS",
            verdict=verdict(forces["3 s"] > (1 + BAND) * forces["5 s"], forces["5 s"] > (1 + BAND) * forces["7 s"]),
        ),
    ]
    return claims


def _means(mean: Callable[..., float]) -> list[Claim]:
    """What section 5.1.5 reads off Tables 5.2-5.4."""
    linear, angular, control = (_ranking(mean, table) for table in ("5.2", "5.3", "5.4"))
    by_base = [[mean(table, "mfsosmc", t) for t in TIME_BASES] for table in ("5.3", "5.4")]
    order = sorted(linear, key=lambda name: linear[name])
    return [
        Claim(
            section="5.1.5",
            text="Feedback linearization has the smallest linear errors, Lyapunov the second, MFSOSMC with 3 s the "
            "third",
            figures=("Table 5.2",),
            published="0.172, 0.184, 0.201 m (its own table has PID third, at 0.197 m)",
            ours=" < ".join(f"{name} {linear[name]:.3f}" for name in order[:4]) + " m",
            verdict=verdict(order[0] == "feedback linearization", order[1] == "Lyapunov", order[2] == "MFSOSMC 3 s"),
        ),
        Claim(
            section="5.1.5",
            text="MFSOSMC has the smallest angular errors",
            figures=("Table 5.3",),
            published="0.369 deg at 3 s (0.381 PID, 0.464 Lyapunov); 0.588 at 5 s and 0.749 at 7 s are larger",
            ours=listed(angular, ".3f") + " deg",
            verdict=verdict(
                min(angular, key=lambda n: angular[n]) == "MFSOSMC 3 s", max(by_base[0]) < angular["Lyapunov"]
            ),
        ),
        Claim(
            section="5.1.5",
            text="MFSOSMC's angular error grows with the time base",
            figures=("Table 5.3",),
            published="0.369, 0.588, 0.749 deg",
            ours=", ".join(f"{v:.3f}" for v in by_base[0]) + " deg",
            verdict=verdict(by_base[0] == sorted(by_base[0])),
        ),
        Claim(
            section="5.1.5",
            text="Feedback linearization needs the most of its thrusters, Lyapunov and MFSOSMC about the same",
            figures=("Table 5.4",),
            published="0.213; 0.123 and 0.104 to 0.133",
            ours=listed(control, ".3f"),
            verdict=verdict(
                max(control, key=lambda n: control[n]) == "feedback linearization",
                all(about(control[f"MFSOSMC {t} s"], control["Lyapunov"]) for t in TIME_BASES),
            ),
        ),
        Claim(
            section="5.1.5",
            text="MFSOSMC's thrusters work less with a longer time base",
            figures=("Table 5.4",),
            published="0.133, 0.112, 0.104",
            ours=", ".join(f"{v:.3f}" for v in by_base[1]),
            verdict=verdict(by_base[1] == sorted(by_base[1], reverse=True)),
        ),
    ]


def _attitude_of_feedback(tracks: Mapping[str, Extremes]) -> list[Claim]:
    claims = []
    for axis, figures in (("phi", ("5.46", "5.47")), ("psi", ("5.48", "5.49"))):
        worst = {c.label: peak(tracks[c.name].of(axis)) for c in spirals(currents=False)}
        own = worst.pop("Feedback linearization")
        claims.append(
            Claim(
                section="5.1.6",
                text=f"Feedback linearization's {axis} error is an order of magnitude above all others",
                figures=figures,
                published="10 times",
                ours=f"{own:.1f} deg against at most {max(worst.values()):.1f} deg",
                verdict=verdict(own >= 10 * max(worst.values())),
            )
        )
    return claims


def _in_current(tracks: Mapping[str, Extremes], mean: Callable[..., float]) -> list[Claim]:
    classical = {name: tracks[case_name("spiral", c, True)] for name, c in CLASSICAL.items()}
    rest = {name: max(_lasting(track)[0].values()) for name, track in classical.items()}
    lasting = [part for track in classical.values() for part in _lasting(track)[1]]
    worst = {a: {name: peak(track.of(a)) for name, track in classical.items()} for a in ("phi", "psi")}
    least = {
        a: max(peak(tracks[case_name("spiral", "mfsosmc", True, t)].of(a)) for t in TIME_BASES) for a in ("phi", "psi")
    }
    growth = {
        tables: {name: 100 * (mean(tables[1], c) / mean(tables[0], c) - 1) for name, c in CLASSICAL.items()}
        for tables in (LINEAR, ANGULAR, CONTROL)
    }
    bases = {
        tables: [100 * (mean(tables[1], "mfsosmc", t) / mean(tables[0], "mfsosmc", t) - 1) for t in TIME_BASES]
        for tables in (LINEAR, ANGULAR, CONTROL)
    }
    control = _ranking(mean, "5.7")
    linear, angular, effort = (list(growth[tables].values()) for tables in (LINEAR, ANGULAR, CONTROL))
    return [
        Claim(
            section="5.2.1",
            text="PID, feedback linearization and Lyapunov never eliminate the position error in the current",
            figures=("5.50", "5.51", "5.52"),
            published="they oscillate",
            ours=f"largest error in the last round {listed(rest, '.2g', ' %')} of the initial one",
            verdict=verdict(*lasting),
        ),
        Claim(
            section="5.2.1",
            text="In the current phi is worst under feedback linearization, then Lyapunov; MFSOSMC keeps 0",
            figures=("5.53", "5.54"),
            published="240 deg, 6 deg, 0",
            ours=f"{listed(worst['phi'], '.1f', ' deg')}, MFSOSMC {least['phi']:.1g} deg",
            verdict=verdict(
                about(worst["phi"]["feedback linearization"], 240),
                about(worst["phi"]["Lyapunov"], 6),
                least["phi"] <= ANGLE,
            ),
        ),
        Claim(
            section="5.2.1",
            text="In the current psi is worst under feedback linearization, PID and Lyapunov oscillate",
            figures=("5.55", "5.56"),
            published="up to 400 deg",
            ours=f"{listed(worst['psi'], '.1f', ' deg')}, MFSOSMC {least['psi']:.1f} deg before its time base",
            verdict=verdict(
                worst["psi"]["feedback linearization"] == max(worst["psi"].values()),
                about(worst["psi"]["feedback linearization"], 400),
            ),
        ),
        Claim(
            section="5.2.2",
            text="The current leaves MFSOSMC's linear errors as they are and raises the mean of the others",
            figures=("Table 5.5",),
            published="PID 5 %, feedback linearization 18 %, Lyapunov 42 %",
            ours=f"{listed(growth[LINEAR], '.1f', ' %')}; MFSOSMC at most {max(map(abs, bases[LINEAR])):.2f} %",
            verdict=verdict(max(map(abs, bases[LINEAR])) < 1, *_near(linear, (5, 18, 42))),
        ),
        Claim(
            section="5.2.2",
            text="The current leaves MFSOSMC's angular errors as they are and raises the mean of the others",
            figures=("Table 5.6",),
            published="PID 1700 %, feedback linearization 600 %, Lyapunov 1500 % (its tables give 72 %, 504 %, "
            "1459 %: 172 %, 604 %, 1559 % of what they were)",
            ours=f"{listed(growth[ANGULAR], '.0f', ' %')}; MFSOSMC at most {max(map(abs, bases[ANGULAR])):.2f} %",
            verdict=verdict(max(map(abs, bases[ANGULAR])) < 1, *_near(angular, (1700, 600, 1500))),
        ),
        Claim(
            section="5.2.2",
            text="In the current MFSOSMC with 7 s needs the least of its thrusters",
            figures=("Table 5.7",),
            published="0.190 (Lyapunov 0.192)",
            ours=listed(control, ".4f"),
            verdict=verdict(min(control, key=lambda n: control[n]) == "MFSOSMC 7 s"),
        ),
        Claim(
            section="5.2.2",
            text="The current raises the mean command of every controller",
            figures=("Table 5.7",),
            published="PID 39 %, feedback linearization 147 %, Lyapunov 56 %, MFSOSMC 58, 67, 82 % (the tables: "
            "78 % at 5 s)",
            ours=f"{listed(growth[CONTROL], '.0f', ' %')}, MFSOSMC {', '.join(f'{v:.0f}' for v in bases[CONTROL])} %",
            verdict=verdict(*_near([*effort, *bases[CONTROL]], (39, 147, 56, 58, 78, 82))),
        ),
    ]


def _ranking(mean: Callable[..., float], table: str) -> dict[str, float]:
    """{controller: mean of its row}."""
    rows = {name: mean(table, controller) for name, controller in CLASSICAL.items()}
    return {**rows, **{f"MFSOSMC {t} s": mean(table, "mfsosmc", t) for t in TIME_BASES}}


def _near(values: Iterable[float], published: Iterable[float]) -> list[bool]:
    """Which growths [%] lie within 5 percentage points, or a tenth, of the published."""
    return [abs(a - b) <= max(5.0, 0.1 * b) for a, b in zip(values, published, strict=True)]


def _overshoot(of: Extremes, axis: str) -> float:
    """Largest error of the opposite sign, in percent of the initial one."""
    error = of.error[:, :, AXES.index(axis)]
    return max(0.0, float((-error / error[0, 0]).max()) * 100.0)


def _lasting(of: Extremes) -> tuple[dict[str, float], list[bool]]:
    """Largest position error in the last round in percent of the initial one, and whether it is off zero, by axis."""
    rest = {a: 100 * peak(of.of(a)[of.time >= LAST_ROUND]) / float(of.of(a)[0]) for a in POSITIONS}
    return rest, [v > 100 * BAND for v in rest.values()]


def _saturation(of: Extremes) -> str:
    steps = int(of.saturated.sum())
    if not steps:
        return f"never saturated, |u| at most {peak(of.u):.3f}"
    return f"saturated in {steps} steps, last at {of.time[of.saturated > 0][-1]:.2f} s"
