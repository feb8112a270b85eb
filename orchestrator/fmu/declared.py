"""What becomes of each thing that a modelDescription.xml can declare.

`TABLE` has every attribute of the schemas of FMI 2.0 and 3.0.  `make reference` writes it into docs/fmus.md.
`notes` makes of it what `orch check` and a run say of an FMU.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

HONOURED, REFUSED, NOTED, SHOWN, UNUSED = "honoured", "refused", "noted", "shown", "unused"
SHOWN_NAMES = 4  # variables that a note names
BEGIN, END = "<!-- what is declared: begin -->", "<!-- what is declared: end -->"

# Where the attributes of a place stand, in FMI 2.0 and 3.0.
PATHS = {
    "CoSimulation": ("CoSimulation",),
    "DefaultExperiment": ("DefaultExperiment",),
    "clock": ("ModelVariables/Clock",),
}


@dataclass(frozen=True, kw_only=True)
class Row:
    """Attributes of one place with one treatment.

    how: in what way.  note: from the root and the elements of the place to a sentence on an FMU, "" for none.
    """

    place: str
    names: str
    treatment: str
    how: str
    note: Callable[[Any, Sequence[Any]], str] | None = None

    @property
    def attributes(self) -> list[str]:
        """Names of the attributes; "*" for all."""
        return self.names.split()


def _tool(root: Any, elements: Sequence[Any]) -> str:
    tool = root.get("generationTool") or "the tool that exported it"
    if not _true(elements, "needsExecutionTool") or "pythonfmu" in tool.lower():  # of whose tool, Python, orch is made
        return ""
    return f"needs {tool} on the machine that runs it (needsExecutionTool)"


def _asynchronous(root: Any, elements: Sequence[Any]) -> str:
    if not _true(elements, "canRunAsynchronuously"):
        return ""
    return "may answer a step before it is done (canRunAsynchronuously): a run in which it does so fails"


def _start_time(root: Any, elements: Sequence[Any]) -> str:
    start = float(elements[0].get("startTime") or 0.0)
    return f"its own experiment begins at {start:g} s (DefaultExperiment); runs begin at 0 s" if start else ""


def _clocks(root: Any, elements: Sequence[Any]) -> str:
    names = [element.get("name") for element in elements]
    more = f" and {len(names) - SHOWN_NAMES} more" if len(names) > SHOWN_NAMES else ""
    one = len(names) == 1
    return (
        f"its clock{'' if one else 's'} {', '.join(names[:SHOWN_NAMES])}{more} {'does' if one else 'do'} not tick: "
        "variables of a clock keep their values"
    )


def _true(elements: Sequence[Any], name: str) -> bool:
    return any(element.get(name) in ("true", "1") for element in elements)


ROOT, SLAVE, EXPERIMENT = "fmiModelDescription", "CoSimulation", "DefaultExperiment"
TABLE = (
    Row(place=ROOT, names="fmiVersion", treatment=HONOURED, how="2.0 and 3.0 run; others are refused"),
    Row(place=ROOT, names="guid instantiationToken", treatment=HONOURED, how="given to the FMU, which may refuse it"),
    Row(place=ROOT, names="modelName description generationTool", treatment=SHOWN, how="`orch fmus`"),
    Row(
        place=ROOT,
        names="author copyright license version generationDateAndTime variableNamingConvention numberOfEventIndicators",
        treatment=UNUSED,
        how="in the record, with all of modelDescription.xml",
    ),
    Row(place="ModelExchange", names="*", treatment=REFUSED, how="unless the FMU has a CoSimulation, too"),
    Row(place="ScheduledExecution", names="*", treatment=REFUSED, how="unless the FMU has a CoSimulation, too"),
    Row(place=SLAVE, names="modelIdentifier", treatment=HONOURED, how="name of the library"),
    Row(
        place=SLAVE,
        names="canBeInstantiatedOnlyOncePerProcess",
        treatment=HONOURED,
        how='each further instance gets a process of its own; `isolation = "none"` is then refused',
    ),
    Row(
        place=SLAVE,
        names="canHandleVariableCommunicationStepSize",
        treatment=HONOURED,
        how="all steps of a component are of one length",
    ),
    Row(
        place=SLAVE,
        names="fixedInternalStepSize",
        treatment=NOTED,
        how="where a component's step is no multiple of it; also a warning of the run",
    ),
    Row(
        place=SLAVE,
        names="canGetAndSetFMUstate canGetAndSetFMUState canSerializeFMUstate canSerializeFMUState",
        treatment=HONOURED,
        how="without both, a checkpoint is refused",
    ),
    Row(
        place=SLAVE,
        names="hasEventMode",
        treatment=HONOURED,
        how="an FMU handles its events itself; one that refuses is stepped through event mode",
    ),
    Row(
        place=SLAVE,
        names="mightReturnEarlyFromDoStep",
        treatment=HONOURED,
        how="allowed in event mode only; elsewhere an early return ends the run as an error",
    ),
    Row(
        place=SLAVE,
        names="needsExecutionTool",
        treatment=NOTED,
        how="which tool must be on the machine; not for FMUs in Python",
        note=_tool,
    ),
    Row(
        place=SLAVE,
        names="canRunAsynchronuously",
        treatment=NOTED,
        how="a step that returns fmi2Pending ends the run as an error",
        note=_asynchronous,
    ),
    Row(
        place=SLAVE,
        names="canNotUseMemoryManagementFunctions",
        treatment=HONOURED,
        how="the functions are always given, never required",
    ),
    Row(
        place=SLAVE,
        names="canInterpolateInputs maxOutputDerivativeOrder recommendedIntermediateInputSmoothness",
        treatment=UNUSED,
        how="inputs are held over a step",
    ),
    Row(
        place=SLAVE,
        names="canReturnEarlyAfterIntermediateUpdate providesIntermediateUpdate providesEvaluateDiscreteStates "
        "providesDirectionalDerivative providesDirectionalDerivatives providesAdjointDerivatives "
        "providesPerElementDependencies",
        treatment=UNUSED,
        how="capabilities that a run does not need",
    ),
    Row(place="SourceFiles", names="name", treatment=UNUSED, how="the binary runs"),
    Row(
        place=EXPERIMENT,
        names="tolerance",
        treatment=HONOURED,
        how="given to the FMU, unless the component sets `tolerance`; part of the run id",
    ),
    Row(
        place=EXPERIMENT,
        names="startTime",
        treatment=NOTED,
        how="where it is not 0: runs begin at 0 s",
        note=_start_time,
    ),
    Row(place=EXPERIMENT, names="stopTime stepSize", treatment=SHOWN, how="`orch fmus`; the experiment decides"),
    Row(place="Unit", names="name", treatment=HONOURED, how="connections compare and convert"),
    Row(
        place="BaseUnit", names="kg m s A K mol cd rad factor offset", treatment=HONOURED, how="compared and converted"
    ),
    Row(place="DisplayUnit", names="name factor offset inverse", treatment=UNUSED, how="values are in the unit itself"),
    Row(place="Item", names="name value", treatment=HONOURED, how="values of an enumeration, by either"),
    Row(place="Item", names="description", treatment=UNUSED, how=""),
    Row(
        place="Category",
        names="name description",
        treatment=UNUSED,
        how="warnings and errors are kept, whatever theirs",
    ),
    Row(
        place="type",
        names="name unit quantity min max relativeQuantity",
        treatment=HONOURED,
        how="as those of the variables that name it",
    ),
    Row(
        place="type",
        names="description displayUnit nominal unbounded maxSize mimeType",
        treatment=UNUSED,
        how="as those of variables",
    ),
    Row(
        place="variable",
        names="name valueReference causality variability declaredType start",
        treatment=HONOURED,
        how='start values are shown; `start = "fmu"` accepts them for free inputs',
    ),
    Row(place="variable", names="unit", treatment=HONOURED, how="compared and converted; without one, it fits any"),
    Row(place="variable", names="relativeQuantity", treatment=HONOURED, how="the offset of a unit is left out"),
    Row(
        place="variable",
        names="min max",
        treatment=HONOURED,
        how="values beyond them are set, noted by `orch check` and a warning of the run, in every step",
    ),
    Row(
        place="variable",
        names="quantity",
        treatment=HONOURED,
        how="`angle`: differences are on the circle; others are not used",
    ),
    Row(place="variable", names="description", treatment=SHOWN, how="`orch fmus`, and the record"),
    Row(
        place="variable",
        names="initial displayUnit nominal unbounded derivative reinit canHandleMultipleSetPerTimeInstant "
        "intermediateUpdate previous mimeType maxSize",
        treatment=UNUSED,
        how="of model exchange, of clocks, or for people",
    ),
    Row(place="variable", names="clocks", treatment=NOTED, how="as clocks"),
    Row(
        place="clock",
        names="name valueReference causality variability declaredType clocks description canBeDeactivated priority "
        "intervalVariability intervalDecimal shiftDecimal supportsFraction resolution intervalCounter shiftCounter "
        "canHandleMultipleSetPerTimeInstant",
        treatment=NOTED,
        how="clocks do not tick",
        note=_clocks,
    ),
    Row(place="Dimension", names="start valueReference", treatment=HONOURED, how="the shape of an array"),
    Row(place="Start", names="value", treatment=HONOURED, how="of texts and binaries"),
    Row(place="Alias", names="name description displayUnit", treatment=UNUSED, how="connect the variable by its name"),
    Row(
        place="Output, InitialUnknown",
        names="index valueReference dependencies",
        treatment=HONOURED,
        how="the order of initialization, and circles of feedthrough",
    ),
    Row(place="Output, InitialUnknown", names="dependenciesKind", treatment=UNUSED, how="all kinds count alike"),
    Row(
        place="other unknowns",
        names="index valueReference dependencies dependenciesKind",
        treatment=UNUSED,
        how="of model exchange, or of clocks",
    ),
    Row(place="annotation", names="name type", treatment=UNUSED, how="but orch's own: the digests of data files"),
)


def notes(root: Any) -> Iterator[str]:
    """Sentences on what an FMU declares and a run does not do.  root: of a checked modelDescription.xml."""
    for row in TABLE:
        if row.note is None:
            continue
        elements = [element for path in PATHS[row.place] for element in root.iterfind(path)]
        if elements and (sentence := row.note(root, elements)):
            yield sentence


def page() -> str:
    """The table, as docs/fmus.md has it."""
    lines = ["| where | attributes | | how |", "|---|---|---|---|"]
    for row in TABLE:
        names = "all" if row.names == "*" else ", ".join(f"`{name}`" for name in row.attributes)
        lines.append(f"| {row.place} | {names} | {row.treatment} | {row.how} |")
    return "\n".join(lines)


def main(path: Path) -> None:
    """Write the table into a page, between its marks."""
    head, _, rest = path.read_text(encoding="utf-8").partition(BEGIN)
    path.write_text(f"{head}{BEGIN}\n{page()}\n{END}{rest.partition(END)[2]}", encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
