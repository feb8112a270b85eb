"""The claims of sections 5.3 and 5.4: two vehicles grip an object, without and with current."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping

from ..cases.chapter5 import LABELS, case_name
from ..cases.extremes import PairExtremes
from .claims import ANGLE, POSITIONS, Claim, converged, peak, settled, velocities, verdict

CONTROLLERS = ("mfsosmc", "nstsmc", "ftsosmc")
ATTITUDE = ("phi", "psi")
CONTROLLED = (*POSITIONS, *ATTITUDE)
TIMES = {"mfsosmc": (6.0, 6.0), "nstsmc": (2.18, 2.37), "ftsosmc": (5.0, 5.0)}  # s, of convergence as published
HELD = (12.0, 24.0)  # s, from gripping to releasing
HOME = 30.0  # s, from when on the vehicles swim home: the end of the trajectory
DISTANCE = 0.002  # m, what a grip gives way
HEADING = 0.5  # deg, turns the front of a vehicle, 0.25 m from its middle, aside by as much

Pairs = Mapping[str, PairExtremes]


def claims(pairs: Pairs) -> list[Claim]:
    """pairs: {case: what its two vehicles did}."""
    return [*_section(pairs, currents=False), *_section(pairs, currents=True)]


def _section(pairs: Pairs, currents: bool) -> list[Claim]:
    section, where = ("5.4", " in the current") if currents else ("5.3", "")
    runs = {controller: pairs[case_name("gripping", controller, currents)] for controller in CONTROLLERS}
    errors = tuple(f"5.{n}" for n in (range(74, 79) if currents else range(67, 72)))
    claims = [
        _at_base(section, where, runs["mfsosmc"], errors if currents else ("5.57", "5.58", *errors)),
        *_settled(section, where, runs, errors),
        _kept(section, where, runs, errors[:3] if currents else errors, POSITIONS if currents else CONTROLLED),
        *_held(section, where, runs, ("5.79", "5.80") if currents else ("5.72", "5.73")),
    ]
    return claims + (_attitude(runs) if currents else _theta_and_velocity(runs))


def _at_base(section: str, where: str, pair: PairExtremes, figures: tuple[str, ...]) -> Claim:
    """MFSOSMC at 6 s, in every controlled axis of both vehicles."""
    after = TIMES["mfsosmc"][0]
    kept = [ok for of in (pair.one, pair.two) for ok in converged(of, after, CONTROLLED).values()]
    return Claim(
        section=section,
        text=f"MFSOSMC converges at t_b = 6 s in every controlled axis of both vehicles{where} and stays",
        figures=figures,
        published="error 0 from 6 s",
        ours=_left(pair, (after, after), CONTROLLED),
        verdict=verdict(*kept),
        gated=True,
    )


def _settled(section: str, where: str, runs: Pairs, figures: tuple[str, ...]) -> list[Claim]:
    """Convergence times of the other two."""
    claims = []
    for controller in ("nstsmc", "ftsosmc"):
        if where and controller == "nstsmc":
            continue  # section 5.4 gives it no time
        limits = TIMES[controller]
        pair = runs[controller]
        times = [{axis: settled(of, axis) for axis in CONTROLLED} for of in (pair.one, pair.two)]
        claims.append(
            Claim(
                section=section,
                text=f"{LABELS[controller]} converges within {limits[0]:g} s (vehicle 1) and {limits[1]:g} s "
                f"(vehicle 2){where}",
                figures=figures,
                published=f"{limits[0]:g} s, {limits[1]:g} s" + (" (without current)" if where else ""),
                ours="; ".join(f"vehicle {k}: {_times(of)}" for k, of in enumerate(times, 1)),
                verdict=verdict(*(max(of.values()) <= limit for of, limit in zip(times, limits, strict=True))),
            )
        )
    return claims


def _kept(section: str, where: str, runs: Pairs, figures: tuple[str, ...], axes: tuple[str, ...]) -> Claim:
    """Errors near zero from the published time of convergence to the end."""
    kept = {
        controller: all(
            ok
            for of, after in zip((pair.one, pair.two), TIMES[controller], strict=True)
            for ok in converged(of, after, axes).values()
        )
        for controller, pair in runs.items()
    }
    return Claim(
        section=section,
        text=f"All three controllers keep the {'position error' if where else 'errors'} near zero from their time of "
        f"convergence to the end{where}",
        figures=figures,
        published="a vicinity of 0",
        ours="; ".join(f"{LABELS[c]}: {_left(pair, TIMES[c], axes)}" for c, pair in runs.items()),
        verdict=verdict(*kept.values()),
    )


def _held(section: str, where: str, runs: Pairs, figures: tuple[str, str]) -> list[Claim]:
    """Distance and heading difference while the object is held."""
    claims = []
    for controller, pair in runs.items():
        window = (pair.one.time >= HELD[0]) & (pair.one.time <= HELD[1])
        apart, turned = pair.distance[window], pair.heading[window]
        name = LABELS[controller]
        claims += [
            Claim(
                section=section,
                text=f"{name} keeps the vehicles 0.5 m apart from 12 s to 24 s{where}",
                figures=figures[:1],
                published="0.5 m",
                ours=f"{apart.min():.4f} to {apart.max():.4f} m",
                verdict=verdict(peak(apart - 0.5) <= DISTANCE),
                gated=True,
            ),
            Claim(
                section=section,
                text=f"{name} keeps the headings 180 deg apart from 12 s to 24 s{where}",
                figures=figures[1:],
                published="180 deg",
                ours=f"{turned.min():.3f} to {turned.max():.3f} deg",
                verdict=verdict(peak(turned - 180) <= HEADING),
                gated=True,
            ),
        ]
    return claims


def _theta_and_velocity(runs: Pairs) -> list[Claim]:
    theta = {LABELS[c]: [peak(of.eta[:, :, 4]) for of in (pair.one, pair.two)] for c, pair in runs.items()}
    one, two = theta.pop("MFSOSMC")
    others = "; ".join(f"{name} {a:.1f} and {b:.1f} deg" for name, (a, b) in theta.items())
    vehicles = (runs["mfsosmc"].one, runs["mfsosmc"].two)
    carried = [peak(of.eta[of.time <= HOME, :, 4]) for of in vehicles]
    left = [velocities(of, TIMES["mfsosmc"][0]) for of in vehicles]
    return [
        Claim(
            section="5.3",
            text="Under MFSOSMC theta stays within 1 deg (vehicle 1) and 2 deg (vehicle 2)",
            figures=("5.59", "5.60"),
            published="+-1, +-2 deg",
            ours=f"{one:.2f} and {two:.2f} deg over the whole task ({carried[0]:.2f} and {carried[1]:.2f} deg until "
            f"the way home at 30 s); {others}",
            verdict=verdict(one <= 1, two <= 2),
        ),
        Claim(
            section="5.3",
            text="MFSOSMC's velocities have converged at 6 s",
            figures=("5.61", "5.62", "5.63", "5.64"),
            published="at 6 s",
            ours="; ".join(f"vehicle {k}: {of.text}" for k, of in enumerate(left, 1)),
            verdict=verdict(*(part for of in left for part in of.converged)),
        ),
        Claim(
            section="5.3",
            text="Headings are -90 and 90 deg from the start of the gripping",
            figures=("5.65", "5.66"),
            published="-90, 90 deg",
            ours=", ".join(
                f"{of.eta[of.time >= HELD[0], 0, 5].min():.3f} to {of.eta[of.time >= HELD[0], 1, 5].max():.3f} deg"
                for of in vehicles
            ),
            verdict=verdict(*(peak(of.of("psi")[of.time >= HELD[0]]) <= ANGLE for of in vehicles)),
        ),
    ]


def _attitude(runs: Pairs) -> list[Claim]:
    def worst(controller: str, axis: str, after: float, before: float = math.inf) -> float:
        pair = runs[controller]
        return max(peak(of.of(axis)[(of.time >= after) & (of.time <= before)]) for of in (pair.one, pair.two))

    nstsmc = runs["nstsmc"]
    theta = peak(nstsmc.two.eta[:, :, 4])
    grown = {axis: (worst("nstsmc", axis, HELD[0], HOME), worst("nstsmc", axis, HOME)) for axis in ATTITUDE}
    kept = [
        all(converged(of, TIMES[c][0], ATTITUDE)[axis] for of in (runs[c].one, runs[c].two))
        for c in ("mfsosmc", "ftsosmc")
        for axis in ATTITUDE
    ]
    return [
        Claim(
            section="5.4",
            text="In the current NSTSMC's attitude degrades at the end",
            figures=("5.77", "5.78"),
            published="phi and psi degrade",
            ours="; ".join(
                f"largest error of {axis} {before:.2g} deg from 12 to 30 s, {after:.2g} deg from 30 s"
                for axis, (before, after) in grown.items()
            )
            + f"; theta of vehicle 2 reaches {theta:.0f} deg",
            verdict=verdict(
                *(
                    after > before and not all(converged(of, HOME, ATTITUDE)[axis] for of in (nstsmc.one, nstsmc.two))
                    for axis, (before, after) in grown.items()
                )
            ),
        ),
        Claim(
            section="5.4",
            text="In the current MFSOSMC and FTSOSMC keep phi and psi at 0 after convergence",
            figures=("5.77", "5.78"),
            published="0 deg",
            ours="; ".join(f"{LABELS[c]}: {_left(runs[c], TIMES[c], ATTITUDE)}" for c in ("mfsosmc", "ftsosmc")),
            verdict=verdict(*kept),
        ),
    ]


def _left(pair: PairExtremes, after: Iterable[float], axes: Iterable[str]) -> str:
    """The worst of what is left of the errors from those times on, by kind."""
    share, angle = {}, {}
    for number, (of, start) in enumerate(zip((pair.one, pair.two), after, strict=True), 1):
        for axis in axes:
            error = of.of(axis)
            rest = peak(error[of.time >= start])
            if error[0]:
                share[f"{axis}{number}"] = 100 * rest / float(error[0])
            else:
                angle[f"{axis}{number}"] = rest
    parts = [
        f"at most {worst[name]:.2g} {unit} ({name})"
        for worst, unit in ((share, "% of the initial error"), (angle, "deg"))
        if worst and (name := max(worst, key=lambda n: worst[n]))
    ]
    return ", ".join(parts)


def _times(times: Mapping[str, float]) -> str:
    """The last axis to settle, and the others where one never does."""
    last = max(times, key=lambda axis: times[axis])
    never = [axis for axis, time in times.items() if math.isinf(time)]
    finite = {axis: time for axis, time in times.items() if math.isfinite(time)}
    if not never:
        return f"{times[last]:.2f} s ({last})"
    return f"never in {', '.join(never)}" + (f", else {max(finite.values()):.2f} s" if finite else "")
