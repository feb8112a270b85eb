"""The claims of sections 5.3 and 5.4: two vehicles grip an object, without and with current."""

from __future__ import annotations

import math
from collections.abc import Mapping

from .... import metrics
from ..cases.chapter5 import LABELS, case_name
from ..cases.signals import Array, Track, distance, heading_difference
from .claims import Claim, listed, verdict

CONTROLLERS = ("mfsosmc", "nstsmc", "ftsosmc")
CONTROLLED = ("x", "y", "z", "phi", "psi")
T_B = 6.0  # s
SHARE = 0.05  # of the initial error: the usual band of a settling time
LEVEL = 1.0  # deg, the band of phi, which starts at its desired value
HELD = (12.0, 24.0)  # s, from gripping to releasing
FREE = 30.0  # s, until when the thesis bounds theta
HEADING = {"mfsosmc": 0.2, "nstsmc": 0.5, "ftsosmc": 0.5}  # deg
DISTANCE = 0.002  # m

Pairs = Mapping[str, tuple[Track, Track]]


def claims(pairs: Pairs) -> list[Claim]:
    """pairs: {case: what its two vehicles did}."""
    return [*_section(pairs, currents=False), *_section(pairs, currents=True)]


def _section(pairs: Pairs, currents: bool) -> list[Claim]:
    section, where = ("5.4", " in the current") if currents else ("5.3", "")
    runs = {controller: pairs[case_name("gripping", controller, currents)] for controller in CONTROLLERS}
    errors = tuple(f"5.{n}" for n in (range(74, 79) if currents else range(67, 72)))
    found = [
        _at_base(section, where, runs["mfsosmc"], errors if currents else ("5.57", "5.58", *errors)),
        *_settled(section, where, runs, errors),
        _kept(section, where, runs, errors),
        *_held(section, where, runs, ("5.79", "5.80") if currents else ("5.72", "5.73")),
    ]
    return found + (_attitude(runs) if currents else _theta_and_velocity(runs))


def _at_base(section: str, where: str, pair: tuple[Track, Track], figures: tuple[str, ...]) -> Claim:
    """MFSOSMC at 6 s, in every controlled axis of both vehicles."""
    left = {}
    for k, track in enumerate(pair, 1):
        after = track.time >= T_B
        for axis in CONTROLLED:
            start = abs(track.of(axis)[0]) or 1.0  # phi starts at no error: in degrees
            left[f"{axis}{k}"] = _peak(track.of(axis)[after]) / start
    worst = max(left, key=lambda name: left[name])
    return Claim(
        section=section,
        text=f"MFSOSMC converges at t_b = 6 s in every controlled axis of both vehicles{where}",
        figures=figures,
        published="error 0 from 6 s",
        ours=f"at most {100 * left[worst]:.2g} % of the initial error left ({worst})",
        verdict=verdict(left[worst] <= 0.005),
        gated=True,
    )


def _settled(section: str, where: str, runs: Pairs, figures: tuple[str, ...]) -> list[Claim]:
    """Convergence times of the other two."""
    found = []
    for controller, limits in (("nstsmc", (2.18, 2.37)), ("ftsosmc", (5.0, 5.0))):
        if where and controller == "nstsmc":
            continue  # section 5.4 gives it no time
        times = [max(_settling(track, axis) for axis in CONTROLLED) for track in runs[controller]]
        strict = [max(_settling(track, axis, 0.2) for axis in CONTROLLED) for track in runs[controller]]
        parts = [time <= limit for time, limit in zip(times, limits, strict=True)]
        published = f"{limits[0]:g} s, {limits[1]:g} s" + (" (without current)" if where else "")
        found.append(
            Claim(
                section=section,
                text=f"{LABELS[controller]} converges within {limits[0]:g} s (vehicle 1) and {limits[1]:g} s "
                f"(vehicle 2){where}",
                figures=figures,
                published=published,
                ours=f"within 5 % of the initial error (phi 1 deg) at {_times(times)}, within 1 % (0.2 deg) at "
                f"{_times(strict)}",
                verdict=verdict(*parts),
            )
        )
    return found


def _kept(section: str, where: str, runs: Pairs, figures: tuple[str, ...]) -> Claim:
    """Errors near zero on the trajectory."""
    rest = {
        LABELS[controller]: 1e3 * max(_peak(track.error[track.time >= 12, :3]) for track in pair)
        for controller, pair in runs.items()
    }
    return Claim(
        section=section,
        text=f"All three controllers keep the position error near zero along the whole trajectory{where}",
        figures=figures[:3],
        published="a vicinity of 0",
        ours=f"largest after 12 s {listed(rest, '.2g', ' mm')}",
        verdict=verdict(*(v < 10 for v in rest.values())),
    )


def _held(section: str, where: str, runs: Pairs, figures: tuple[str, str]) -> list[Claim]:
    """Distance and heading difference while the object is held."""
    found = []
    for controller, (one, two) in runs.items():
        window = (one.time >= HELD[0]) & (one.time <= HELD[1])
        apart, turned = distance(one, two)[window], heading_difference(one, two)[window]
        name, band = LABELS[controller], HEADING[controller]
        found += [
            Claim(
                section=section,
                text=f"{name} keeps the vehicles 0.5 m apart from 12 s to 24 s{where}",
                figures=figures[:1],
                published="0.5 m",
                ours=f"{apart.min():.4f} to {apart.max():.4f} m",
                verdict=verdict(_peak(apart - 0.5) <= DISTANCE),
                gated=True,
            ),
            Claim(
                section=section,
                text=f"{name} keeps the headings 180 deg apart from 12 s to 24 s{where}",
                figures=figures[1:],
                published="180 deg",
                ours=f"{turned.min():.3f} to {turned.max():.3f} deg",
                verdict=verdict(_peak(turned - 180) <= band),
                gated=True,
            ),
        ]
    return found


def _theta_and_velocity(runs: Pairs) -> list[Claim]:
    theta = {
        LABELS[controller]: [_peak(track.eta[track.time <= FREE, 4]) for track in pair]
        for controller, pair in runs.items()
    }
    end = [_peak(track.eta[:, 4]) for track in runs["mfsosmc"]]
    one, two = theta.pop("MFSOSMC")
    others = "; ".join(f"{name} {a:.1f} and {b:.1f} deg" for name, (a, b) in theta.items())
    after = runs["mfsosmc"][0].time >= T_B
    off = [abs(track.nu - track.nu_d)[after] for track in runs["mfsosmc"]]
    linear, angular = max(o[:, :3].max() for o in off), max(o[:, [3, 5]].max() for o in off)
    return [
        Claim(
            section="5.3",
            text="Under MFSOSMC theta stays within 1 deg (vehicle 1) and 2 deg (vehicle 2)",
            figures=("5.59", "5.60"),
            published="+-1, +-2 deg",
            ours=f"{one:.2f} and {two:.2f} deg until 30 s, on the way home {end[0]:.2f} and {end[1]:.2f} "
            f"deg; until 30 s {others}",
            verdict=verdict(one <= 1, two <= 2),
            gated=True,
        ),
        Claim(
            section="5.3",
            text="MFSOSMC's velocities have converged at 6 s",
            figures=("5.61", "5.62", "5.63", "5.64"),
            published="at 6 s",
            ours=f"at most {linear:.2g} m/s and {angular:.2g} deg/s away from it on",
            verdict=verdict(linear < 0.05, angular < 2),
        ),
        Claim(
            section="5.3",
            text="Headings are -90 and 90 deg from the start of the gripping",
            figures=("5.65", "5.66"),
            published="-90, 90 deg",
            ours=", ".join(f"{track.eta[int(abs(track.time - 12).argmin()), 5]:.2f} deg" for track in runs["mfsosmc"]),
            verdict=verdict(*(_peak(track.of("psi")[track.time >= 12]) < 0.1 for track in runs["mfsosmc"])),
        ),
    ]


def _attitude(runs: Pairs) -> list[Claim]:
    def worst(controller: str, axis: str, after: float, before: float = 40.0) -> float:
        return max(_peak(t.of(axis)[(t.time >= after) & (t.time <= before)]) for t in runs[controller])

    late = {LABELS[c]: worst(c, "psi", 30.0) for c in CONTROLLERS}
    held = {LABELS[c]: worst(c, "psi", *HELD) for c in CONTROLLERS}
    phi = {LABELS[c]: worst(c, "phi", 12.0) for c in CONTROLLERS}
    theta = [_peak(track.eta[:, 4]) for track in runs["nstsmc"]]
    return [
        Claim(
            section="5.4",
            text="In the current NSTSMC's attitude degrades at the end",
            figures=("5.77", "5.78"),
            published="they degrade",
            ours=f"its psi error grows from {held['NSTSMC']:.2f} deg (12-24 s) to {late['NSTSMC']:.2f} deg "
            f"(from 30 s); theta of vehicle 2 reaches {theta[1]:.0f} deg",
            verdict=verdict(late["NSTSMC"] > 2 * held["NSTSMC"]),
        ),
        Claim(
            section="5.4",
            text="In the current MFSOSMC and FTSOSMC keep phi and psi at 0 after convergence",
            figures=("5.77", "5.78"),
            published="0 deg",
            ours=f"psi after 30 s {listed(late, '.2g', ' deg')}; phi after 12 s {listed(phi, '.2g', ' deg')}",
            verdict=verdict(late["MFSOSMC"] < 0.1, late["FTSOSMC"] < 0.1),
        ),
    ]


def _settling(track: Track, axis: str, part: float = 1.0) -> float:
    """When the error is within `part` of the band for good, until the object is gripped [s]."""
    window = track.time <= HELD[0]
    error = track.of(axis)[window]
    band = (LEVEL if axis == "phi" else SHARE * abs(error[0])) * part
    return metrics.settling_time(track.time[window], error, band)


def _times(values: list[float]) -> str:
    return " and ".join(f"{v:.2f} s" if math.isfinite(v) else "never" for v in values)


def _peak(values: Array) -> float:
    return float(abs(values).max())
