"""Every section and key of the experiment file."""

from __future__ import annotations

from dataclasses import replace

from ...metrics import METRICS, STATISTICS
from ...metrics.thrusters import TABLES
from .value_types import (
    SECONDS,
    TABLE,
    TEXT,
    TRUTH,
    Key,
    Section,
    ValueType,
    Variant,
    either,
    is_whole,
    list_of,
    named,
    number,
    one_of,
    positive,
    table,
    whole,
)

ALGORITHMS = ("gauss-seidel", "jacobi")
ISOLATION = ("auto", "process", "none")
RESERVED = ("time", "_heard", "_envelope")  # names in a record that are no component's
COMPONENT_NAME = r"[A-Za-z_]\w*"

PWM_MAPS = ("linear", "t200_16V")
STREAMS = {  # Hz; ArduSub's defaults, libraries/GCS_MAVLink/GCS_MAVLink_Parameters.cpp
    "RAW_SENS": 2.0,
    "EXT_STAT": 2.0,
    "RC_CHAN": 2.0,
    "POSITION": 3.0,
    "EXTRA1": 10.0,
    "EXTRA2": 10.0,
    "EXTRA3": 3.0,
}
FASTEST_STREAM = 50.0  # Hz
LARGEST_SYSTEM_ID = 250  # ground stations use those above
LARGEST_LATITUDE, LARGEST_LONGITUDE = 89.0, 180.0  # degrees

DESIGNS = ("random", "lhs", "sobol")
KEEP = ("full", "decimated", "metrics")
DISTRIBUTIONS = {
    "uniform": Variant(needs=("low", "high"), meaning="every number from `low` to `high` is as likely"),
    "loguniform": Variant(needs=("low", "high"), meaning="the logarithm is uniform; `low` is positive"),
    "normal": Variant(needs=("mean", "std"), meaning="the normal distribution"),
    "integer": Variant(needs=("low", "high"), meaning="every whole number from `low` to `high` is as likely"),
    "choice": Variant(needs=("values",), meaning="each of `values` is as likely"),
    "direction": Variant(
        needs=("axes", "low", "high"),
        meaning="a vector in any direction, its length uniform from `low` to `high`; other axes stay as in the file",
    ),
}
SEARCHABLE = ("uniform", "loguniform", "integer", "choice")  # by orch tune
GOALS = ("minimize", "maximize")


def _seed_problem(value: object) -> str:
    if not is_whole(value):
        return f"is {value!r}, not a whole number"
    return "" if abs(value) < 1 << 63 else f"{value} does not fit 64 bits"


MASTER = Section(
    heading="[master]",
    keys=(
        Key(
            name="stop_time",
            type=SECONDS,
            unit="s",
            required=True,
            missing="; give it in s",
            meaning="When the run ends, a multiple of `step`; it begins at 0.",
            example="40.0",
        ),
        Key(
            name="step",
            type=SECONDS,
            unit="s",
            required=True,
            missing="; give it in s",
            meaning="The communication step: components exchange values at its multiples.",
            example="1e-3",
        ),
        Key(
            name="algorithm",
            type=one_of(*ALGORITHMS),
            default=ALGORITHMS[0],
            meaning="`gauss-seidel`: components step in the order of the file, each fed with the newest outputs; "
            "`jacobi`: all step with the outputs of the step before.",
            example='"jacobi"',
        ),
        Key(
            name="seed",
            type=ValueType(words="whole number", json={"type": "integer"}, problem=_seed_problem),
            absent="none is set",
            meaning="Seeds every component that has a whole-number parameter `seed` which the file does not set, each "
            "with a number drawn from this one and the component's name.",
            example="1",
        ),
    ),
)

COMPONENT = Section(
    heading="[components.NAME]",
    keys=(
        Key(
            name="fmu",
            type=TEXT,
            absent="one of `fmu` and `builtin` is needed",
            meaning="A model's name (`orch fmus` lists them), or the path of an .fmu, relative to the experiment file.",
            example='"bluerov2_thesis"',
        ),
        Key(
            name="builtin",
            type=TEXT,
            absent="one of `fmu` and `builtin` is needed",
            meaning="A component that runs inside orch, in place of an FMU: `ardupilot_json` or `mavlink_manual`.",
            example='"mavlink_manual"',
        ),
        Key(
            name="parameters",
            type=TABLE,
            absent="the FMU's own",
            meaning="Values of parameters, in the FMU's units. A vector takes a list of its full length, or a table of "
            "some of its axes; the others keep their defaults.",
            example="{ m = 12.0, eta_0 = [0, 0, 1, 0, 0, 0] }",
        ),
        Key(
            name="start",
            type=either(TABLE, one_of("fmu"), otherwise='; give a table of values, or "fmu"'),
            absent="every input is connected",
            meaning='Values that inputs hold which nothing drives; `"fmu"` accepts the FMU\'s own start values.',
            example="{ v_c = [0.2, 0, 0] }",
        ),
        Key(
            name="step",
            type=SECONDS,
            unit="s",
            absent="that of [master]",
            meaning="The component's own period, a multiple of the communication step.",
            example="0.02",
        ),
        Key(
            name="tolerance",
            type=positive("; give a positive number"),
            absent="that of the FMU's DefaultExperiment, if it declares one",
            meaning="The relative tolerance that an FMU with a solver inside is given.",
            example="1e-6",
        ),
        Key(
            name="isolation",
            type=one_of(*ISOLATION),
            default=ISOLATION[0],
            meaning="Whether the FMU runs in a process of its own: `auto` where it must, since another FMU in the same "
            "process would disturb it, `process` always, `none` never.",
            example='"process"',
        ),
        Key(
            name="timeout",
            type=SECONDS,
            unit="s of wall time",
            absent="no limit",
            meaning="How long a step may take; the FMU then runs in a process of its own, which is ended after that.",
            example="5.0",
        ),
    ),
    rules={"oneOf": [{"required": ["fmu"]}, {"required": ["builtin"]}]},
)

CONNECTION = Section(
    heading='[connections] "INPUT" = { ... }',
    keys=(
        Key(
            name="from",
            type=TEXT,
            required=True,
            meaning="The output that drives the input: `component.variable`, of a vector or one axis.",
            example='"vehicle.eta"',
        ),
        Key(
            name="gain",
            type=number(),
            absent="1",
            meaning="Factor, after the conversion of units. It may carry a unit: an output without one is then taken "
            "as it is.",
            example="40.0",
        ),
        Key(
            name="offset",
            type=number(),
            absent="0",
            meaning="Added after the gain, in the input's unit.",
            example="0.5",
        ),
        Key(
            name="unit_check",
            type=TRUTH,
            default=True,
            meaning="`false` takes the number as it is although the units do not fit.",
            example="false",
        ),
    ),
)

RECORD = Section(
    heading="[record]",
    keys=(
        Key(
            name="every",
            type=SECONDS,
            unit="s",
            absent="that of [master] step",
            meaning="From row to row: a multiple of the communication step that divides the stop time.",
            example="0.01",
        ),
        Key(
            name="signals",
            type=list_of(TEXT, otherwise='; give a list of globs, such as ["vehicle*", "!*.nu.*"]'),
            default=["*"],
            meaning="Globs over the outputs, as `component.variable`; a vector's name takes all its axes, and "
            "`!` excludes.",
            example='["*", "!*.eta_d_ddot"]',
        ),
        Key(
            name="inputs",
            type=TRUTH,
            default=False,
            meaning="Whether the globs match inputs and local variables, too.",
            example="true",
        ),
        Key(
            name="envelope",
            type=either(TRUTH, list_of(TEXT), otherwise=", neither true or false nor a list of globs"),
            default=True,
            meaning="Of which recorded signals the least and the largest value between rows are recorded, too: "
            "`true` for outputs that depend on an input at once, such as commands and forces, or globs. Of none where "
            "`every` is the step.",
            example='["allocation.u"]',
        ),
    ),
)

METRIC = Section(
    heading="[metrics] NAME = { ... }",
    keys=(
        Key(
            name="of",
            type=replace(one_of(*METRICS), words="name of a metric"),
            required=True,
            meaning="Which metric: the table below lists them.",
            example='"rmse"',
        ),
        Key(
            name="signal",
            type=TEXT,
            required=True,
            meaning="What is judged: a signal, recorded or not, or a vector where the metric is one of vectors.",
            example='"vehicle.eta.x"',
        ),
        Key(
            name="reference",
            type=TEXT,
            absent="zero",
            meaning="What the signal is compared with; the error is signal - reference.",
            example='"reference.eta_d.x"',
        ),
        Key(
            name="unit",
            type=TEXT,
            absent="the signal's",
            meaning="The unit of the number, one that the signal's converts to.",
            example='"mm"',
        ),
        Key(
            name="wrap",
            type=TRUTH,
            absent="true where one of both is an angle: an axis phi, theta or psi",
            meaning="Whether signal - reference is on the circle, the shortest way round; `false` counts turns.",
            example="false",
        ),
        Key(
            name="after",
            type=number(least=0.0),
            unit="s",
            absent="the first step",
            meaning="The window begins then.",
            example="6.0",
        ),
        Key(
            name="before",
            type=number(least=0.0),
            unit="s",
            absent="the last step",
            meaning="The window ends then.",
            example="24.0",
        ),
        Key(
            name="every",
            type=positive("; give a positive number of seconds"),
            unit="s",
            absent="`master.step`",
            meaning="Only samples at its multiples count; a multiple of `master.step`.",
            example="0.01",
        ),
        Key(
            name="band",
            type=positive("; give a positive number"),
            unit="the key `unit`, without it the signal's unit",
            meaning="The error counts as zero within it.",
            example="0.05",
        ),
        Key(
            name="max_power",
            type=positive("; give a positive number"),
            unit="W",
            meaning="Electrical power of a thruster at command 1 or -1, whatever its thrust; it goes with |u|^(3/2). "
            "Not beside `thruster`.",
            example="248.0",
        ),
        Key(
            name="thruster",
            type=one_of(*TABLES),
            absent="`max_power` counts",
            meaning="Power is by the vendor's table of this thruster.",
            example='"t200"',
        ),
        Key(
            name="voltage",
            type=positive("; give a positive number"),
            unit="V",
            absent="`max_power` counts",
            meaning="Supply of the thruster, within its table.",
            example="16.0",
        ),
        Key(
            name="max_thrust",
            type=positive("; give a positive number"),
            unit="N",
            absent="`max_power` counts",
            meaning="Thrust at command 1; at -1 it is as large in reverse.",
            example="40.0",
        ),
        Key(
            name="stat",
            type=one_of(*STATISTICS),
            absent="mean",
            meaning="Which number of the values over the window.",
            example='"min"',
        ),
    ),
    by="of",
    variants={
        name: Variant(
            needs=metric.needs,
            takes=metric.takes,
            meaning=metric.meaning,
            unit=metric.unit.format("U"),
        )
        for name, metric in METRICS.items()
    },
)

ORIGIN = Section(
    heading="[mavlink.origin]",
    keys=tuple(
        Key(
            name=name,
            type=number(-limit, limit, f"; give degrees from -{limit:g} to {limit:g}"),
            unit="degrees",
            required=True,
            missing=f"; give degrees from -{limit:g} to {limit:g}",
            meaning=f"{what} of NED (0, 0, 0).",
            example=example,
        )
        for name, what, limit, example in (
            ("lat", "Latitude", LARGEST_LATITUDE, "44.65"),
            ("lon", "Longitude", LARGEST_LONGITUDE, "-124.05"),
        )
    ),
)

RATES = Section(
    heading="[mavlink.rates]",
    keys=tuple(
        Key(
            name=name,
            type=number(0.0, FASTEST_STREAM, f"; give 0 to {FASTEST_STREAM:g} Hz"),
            unit="Hz",
            default=rate,
            meaning="Rate of ArduPilot's stream of that name.",
            example="25",
        )
        for name, rate in STREAMS.items()
    ),
)

SYSTEM_ID = whole(1, LARGEST_SYSTEM_ID, f"; a system id is a whole number from 1 to {LARGEST_SYSTEM_ID}")

MAVLINK = Section(
    heading="[mavlink]",
    keys=(
        Key(
            name="vehicles",
            type=named(SYSTEM_ID),
            absent="every vehicle, in order",
            meaning="The components that ground stations see, with their MAVLink system ids. A vehicle is a component "
            "that puts out `eta` and `nu`.",
            example="{ vehicle = 1 }",
        ),
        Key(
            name="origin",
            type=table(ORIGIN),
            absent="off Newport, Oregon",
            meaning="Where NED (0, 0, 0) is on Earth.",
            example="{ lat = 44.65, lon = -124.05 }",
        ),
        Key(
            name="pwm_map",
            type=one_of(*PWM_MAPS),
            default=PWM_MAPS[0],
            meaning="What PWM a thruster command is: 1500 ± 400 µs, or that of a T200 at 16 V for its thrust.",
            example='"t200_16V"',
        ),
        Key(
            name="rates",
            type=table(RATES),
            absent="ArduSub's own",
            meaning="Rates of ArduPilot's streams.",
            example="{ EXTRA1 = 25 }",
        ),
    ),
)

DISTRIBUTION = Section(
    heading='[sweep.vary] "KEY" = { ... }',
    keys=(
        Key(
            name="distribution",
            type=replace(one_of(*DISTRIBUTIONS), words="name of a distribution"),
            required=True,
            meaning="Which distribution: the table below lists them.",
            example='"uniform"',
        ),
        Key(name="low", type=number(), meaning="The least value.", example="8.0"),
        Key(name="high", type=number(), meaning="The largest value.", example="12.0"),
        Key(name="mean", type=number(), meaning="Mean of a normal distribution.", example="1.0"),
        Key(
            name="std",
            type=positive("; give a positive number"),
            meaning="Standard deviation of a normal distribution.",
            example="0.2",
        ),
        Key(
            name="values",
            type=list_of(least=1, otherwise="; give a list of values to draw from"),
            meaning="What is chosen from.",
            example="[0.0, 0.5]",
        ),
        Key(
            name="axes",
            type=list_of(TEXT, 2, 3, '; give two or three axes, such as ["x", "y"]'),
            meaning="The axes of the vector that has a direction, two or three.",
            example='["x", "y"]',
        ),
    ),
    by="distribution",
    variants=DISTRIBUTIONS,
)

TUNE = Section(
    heading="[sweep.tune]",
    keys=(
        Key(
            name="objective",
            type=either(TEXT, named(number()), otherwise="; name a metric, or give a table of metrics and weights"),
            required=True,
            missing="; name a metric, or give a table of metrics and their weights",
            meaning="The metric that is searched by, or metrics with their weights, which are summed.",
            example="{ rmse_x = 1.0, power = 0.001 }",
        ),
        Key(
            name="goal",
            type=one_of(*GOALS),
            default=GOALS[0],
            meaning="What the search does with the objective.",
            example='"maximize"',
        ),
        Key(
            name="component",
            type=TEXT,
            absent="the one whose `fmu` varies",
            meaning="The component whose parameters are tuned.",
            example='"controller"',
        ),
        Key(
            name="trials",
            type=whole(1),
            required=True,
            missing="; give a whole number, at least 1",
            meaning="Trials of each controller.",
            example="40",
        ),
        Key(
            name="draws",
            type=whole(1),
            required=True,
            missing="; give a whole number, at least 1",
            meaning="Draws that a trial is judged on.",
            example="8",
        ),
        Key(
            name="held_out",
            type=whole(1),
            required=True,
            missing="; give a whole number, at least 1",
            meaning="Other draws, on which the defaults and the tuned parameters are compared at the end.",
            example="50",
        ),
        Key(
            name="search",
            type=named(named(table(DISTRIBUTION))),
            required=True,
            missing="; give each controller a table of the parameters to tune, such as [sweep.tune.search.pid]",
            meaning="For each FMU, the parameters that are searched, each with a distribution: "
            + ", ".join(f"`{name}`" for name in SEARCHABLE)
            + ".",
            example='{ pid = { "K_p.x" = { distribution = "loguniform", low = 10.0, high = 1000.0 } } }',
        ),
    ),
)

SWEEP = Section(
    heading="[sweep]",
    keys=(
        Key(
            name="vary",
            type=named(either(list_of(least=1), table(DISTRIBUTION))),
            absent="needed, but in a search",
            meaning="What varies: any dotted key, with a list of values or a distribution. Every draw of the "
            "distributions meets every combination of the lists.",
            example='{ "components.controller.fmu" = ["pid", "mfsosmc"] }',
        ),
        Key(
            name="draws",
            type=whole(1),
            absent="needed where something is drawn",
            meaning="How many draws of the distributions.",
            example="200",
        ),
        Key(
            name="skip",
            type=whole(0),
            default=0,
            meaning="How many draws are left out before the first.",
            example="50",
        ),
        Key(
            name="design",
            type=one_of(*DESIGNS),
            default=DESIGNS[0],
            meaning="How draws are made: independent, a Latin hypercube, or Sobol points.",
            example='"sobol"',
        ),
        Key(name="seed", type=whole(), default=0, meaning="Seeds the draws.", example="1"),
        Key(
            name="keep",
            type=one_of(*KEEP),
            default=KEEP[0],
            meaning="Which rows the records keep: all, at most 501, or none; metrics are of every step in any case.",
            example='"metrics"',
        ),
        Key(
            name="zip",
            type=list_of(list_of(TEXT), otherwise='; give lists of keys, such as [["master.step", "record.every"]]'),
            default=[],
            meaning="Groups of lists whose values change together.",
            example='[["components.controller.fmu", "components.controller.parameters"]]',
        ),
        Key(
            name="tune",
            type=table(TUNE),
            absent="no search",
            meaning="A search for the parameters of controllers, which `orch tune` makes.",
            example="{ ... }",
        ),
    ),
)

EXPERIMENT = Section(
    heading="Sections",
    keys=(
        Key(
            name="title",
            type=TEXT,
            absent="the file's name",
            meaning="What the experiment shows, in a sentence.",
            example='"A BlueROV2 follows a spiral"',
        ),
        Key(
            name="master",
            type=table(MASTER),
            absent="needed",
            meaning="Time: how far and in which steps.",
            example="{ ... }",
        ),
        Key(
            name="components",
            type=named(table(COMPONENT), f"^(?!({'|'.join(RESERVED)})$){COMPONENT_NAME}$"),
            absent="needed",
            meaning="What runs, in the order in which it steps: each component's name and its table.",
            example="{ ... }",
        ),
        Key(
            name="connections",
            type=named(either(TEXT, table(CONNECTION))),
            absent="none",
            meaning='Which output drives which input: `"input" = "output"`, or a table where something lies between.',
            example="{ ... }",
        ),
        Key(
            name="record",
            type=table(RECORD),
            absent="every output at every step",
            meaning="Which rows and signals the record keeps.",
            example="{ ... }",
        ),
        Key(
            name="metrics",
            type=named(table(METRIC)),
            absent="none",
            meaning="Numbers that sum the run up.",
            example="{ ... }",
        ),
        Key(
            name="mavlink",
            type=table(MAVLINK),
            absent="ArduSub's defaults",
            meaning="What ground stations see.",
            example="{ ... }",
        ),
        Key(
            name="sweep",
            type=table(SWEEP),
            absent="a single run",
            meaning="Many runs of the same experiment.",
            example="{ ... }",
        ),
    ),
    rules={"required": ["master", "components"]},
)

SECTIONS = (
    EXPERIMENT,
    MASTER,
    COMPONENT,
    CONNECTION,
    RECORD,
    METRIC,
    SWEEP,
    DISTRIBUTION,
    TUNE,
    MAVLINK,
    ORIGIN,
    RATES,
)
