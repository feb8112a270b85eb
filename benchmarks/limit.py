"""The limit: the equations of all components of an experiment in one C function, without FMI.

The generated C that the native FMUs carry, called directly and inlined, connections as assignments, recorded signals
written into memory; compiled as the FMUs are.  What a master of separate FMUs does besides comes on top of this.
"""

from __future__ import annotations

import re
import subprocess
import sys
import zipfile
from pathlib import Path

from task import Task, Variable

from orchestrator.models import catalogue
from orchestrator.models.compiler import find

MODEL = """\
#undef CASADI_PREFIX
#undef GUID
#undef WORK
#include "{model}.equations.h"
static void {model}_evaluate({model}_function *function, const double *memory, double *result) {{
    double work[WORK + 1];
    function(&memory, &result, 0, work, 0);
}}
static void {model}_begin(double *memory) {{
#include "{model}.model.h"
    memcpy(memory, START, sizeof START);
}}
static void {model}_initialize(double *memory) {{
#include "{model}.model.h"
    double results[SIZE - STATES + 1];
    memory[1] = 0.0;
    {model}_evaluate({model}_calculate, memory, memory + CALCULATED);
    {model}_evaluate({model}_initial, memory, memory + STATES);
    {model}_evaluate({model}_step, memory, results);
    memcpy(memory + OUTPUTS, results + (OUTPUTS - STATES), (SIZE - OUTPUTS) * sizeof(double));
}}
static void {model}_advance(double *memory, double t, double h) {{
#include "{model}.model.h"
    double results[SIZE - STATES + 1];
    memory[0] = t;
    memory[1] = h;
    {model}_evaluate({model}_step, memory, results);
    memcpy(memory + STATES, results, (SIZE - STATES) * sizeof(double));
}}
"""

PROGRAM = """\
{memories}

static void begin(void) {{
{begin}
    for (int sweep = 0; sweep < {sweeps}; sweep++) {{
{initialize}
    }}
}}

static void record(double *row) {{
{record}
}}

__attribute__((flatten)) static void run(long steps, double *rows) {{
    for (long k = 0; k < steps; k++) {{
        const double t = (double)k * {numerator} / {denominator}, h = {h!r};
{advance}
        if ((k + 1) % {stride} == 0) record(rows + (k + 1) / {stride} * {width});
    }}
}}

int main(int n, char **arguments) {{
    static const char *const names[] = {{{names}}};
    const long steps = n > 1 ? atol(arguments[1]) : 0;
    double *rows = calloc((size_t)(steps / {stride} + 1), {width} * sizeof(double));
    if (!rows) return 1;
    const double *last = rows + steps / {stride} * {width};
    struct timespec began, ended;
    begin();
    record(rows);
    timespec_get(&began, TIME_UTC);
    run(steps, rows);
    timespec_get(&ended, TIME_UTC);
    printf("{{\\"stepping\\": %.9f, \\"final\\": {{", (double)(ended.tv_sec - began.tv_sec)
           + 1e-9 * (double)(ended.tv_nsec - began.tv_nsec));
    for (int i = 0; i < {width}; i++) printf("%s\\"%s\\": %.17g", i ? ", " : "", names[i], last[i]);
    puts("}}}}");
    return 0;
}}
"""

HEAD = "#include <math.h>\n#include <stdio.h>\n#include <stdlib.h>\n#include <string.h>\n#include <time.h>\n"


def compile_limit(task: Task, folder: Path) -> Path:
    """Generate limit.c of a task of native FMUs in an empty folder, and compile it.

    The program takes a number of steps and prints what peers.py prints.
    """
    compiler = find()
    assert compiler is not None, "native FMUs were built with one"
    models = {component.fmu: Path(component.fmu).stem for component in task.components}
    sizes = {fmu: _write_sources(Path(fmu), model, folder) for fmu, model in models.items()}
    text = HEAD + "".join(MODEL.format(model=model) for model in models.values()) + _program(task, models, sizes)
    (folder / "limit.c").write_text(text)
    flags = [flag for flag in _flags() if flag != "-shared"]
    subprocess.run([*compiler.command, *flags, "-o", "limit", "limit.c", "-lm"], cwd=folder, check=True)
    return folder / "limit"


def _flags() -> tuple[str, ...]:
    """Those of native FMUs."""
    sys.path.insert(0, str(catalogue.models_folder()))
    from packager.native import FLAGS

    return tuple(FLAGS)


def _write_sources(fmu: Path, model: str, folder: Path) -> int:
    """The FMU's sources under names of their own; returns the size of its memory."""
    with zipfile.ZipFile(fmu) as archive:
        equations, layout = (archive.read(f"sources/{name}.h").decode() for name in ("equations", "model"))
    # What a model defines, calculate, step_n_in and equations_f2 and the like, gets the model's name.
    equations = equations.replace("equations_", f"{model}_")
    equations = re.sub(r"\b((?:calculate|initial|step|d_step|d_start)(?:_[a-z_]+)?)\(", rf"{model}_\1(", equations)
    function = f"typedef int {model}_function(const double **, double **, int *, double *, int);\n"
    (folder / f"{model}.equations.h").write_text(equations + function)
    (folder / f"{model}.model.h").write_text(layout)
    size = re.search(r"\bSIZE = (\d+)", layout)
    assert size is not None, f"{fmu}: model.h names no SIZE"
    return int(size[1])


def _program(task: Task, models: dict[str, str], sizes: dict[str, int]) -> str:
    def inputs(name: str) -> list[str]:
        return [f"{_at(sink)} = {_at(source)};" for sink, source in task.connections if sink.component == name]

    def lines(depth: int, statements: list[str]) -> str:
        return "\n".join("    " * depth + statement for statement in statements)

    components = task.components
    return PROGRAM.format(
        memories=lines(0, [f"static double {c.name}[{sizes[c.fmu]}];" for c in components]),
        begin=lines(
            1,
            [
                line
                for c in components
                for line in (
                    f"{models[c.fmu]}_begin({c.name});",
                    *(f"{_at(v)} = {float(value)!r};" for v, value in c.values),
                )
            ],
        ),
        initialize=lines(
            2, [line for c in components for line in (*inputs(c.name), f"{models[c.fmu]}_initialize({c.name});")]
        ),
        advance=lines(
            2, [line for c in components for line in (*inputs(c.name), f"{models[c.fmu]}_advance({c.name}, t, h);")]
        ),
        record=lines(1, [f"row[{i}] = {_at(v)};" for i, v in enumerate(task.recorded)]),
        names=", ".join(f'"{v.signal}"' for v in task.recorded),
        sweeps=len(components),
        numerator=task.step[0],
        denominator=task.step[1],
        h=task.h,
        stride=task.stride,
        width=len(task.recorded),
    )


def _at(variable: Variable) -> str:
    return f"{variable.component}[{variable.reference}]"
