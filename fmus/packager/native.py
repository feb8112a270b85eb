"""A model as a native FMU: CasADi's C of its equations behind `fmi2.c`, compiled."""

from __future__ import annotations

import concurrent.futures
import json
import pathlib
import subprocess
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from uuv.modelling.equations import Equations, Model

from .archive import DATA, digest_of, write_archive
from .description import TYPES, model_description

WRAPPER = pathlib.Path(__file__).parent / "fmi2.c"

# Every operation rounds as CasADi's interpreter rounds it, so that both packagings give the same bits.
FLAGS = (
    "-std=c11",
    "-O3",
    "-shared",
    "-ffp-contract=off",
    "-fno-math-errno",
    "-fno-trapping-math",
    "-fvisibility=hidden",
)
CAPABILITIES = {
    "canHandleVariableCommunicationStepSize": True,
    "canGetAndSetFMUstate": True,
    "canSerializeFMUstate": True,
    "providesDirectionalDerivative": True,
}


@dataclass(frozen=True)
class Compiler:
    """command: of a C compiler, `folder`: FMI's name of the platform that it makes libraries for."""

    command: tuple[str, ...]
    folder: str

    @property
    def suffix(self) -> str:
        return ".dll" if self.folder.startswith("win") else ".dylib" if self.folder.startswith("darwin") else ".so"

    def library(self, sources: dict[str, bytes]) -> bytes:
        """Compile fmi2.c.  Raises CompilerError with the compiler's first error."""
        with tempfile.TemporaryDirectory() as name:
            folder = pathlib.Path(name)
            for path, content in sources.items():
                (folder / path).write_bytes(content)
            # Code of a Windows library is position-independent in any case.
            flags = [*FLAGS, *([] if self.suffix == ".dll" else ["-fPIC", "-fno-semantic-interposition"])]
            command = [*self.command, *flags, "-o", f"model{self.suffix}", WRAPPER.name, "-lm"]
            try:
                done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
            except OSError as error:
                raise CompilerError(f"{self.command[0]}: {error.strerror}") from None
            if done.returncode:
                lines = done.stderr.strip().splitlines() or [f"exit code {done.returncode}"]
                raise CompilerError(next((line for line in lines if "error" in line), lines[0]))
            return (folder / f"model{self.suffix}").read_bytes()


class CompilerError(Exception):
    """The C compiler fails; the text is its first error."""


def build(
    name: str,
    model: type[Model],
    equations: Equations,
    compilers: Sequence[Compiler],
    data: Mapping[str, bytes],
    target: pathlib.Path,
    pool: concurrent.futures.Executor,
) -> concurrent.futures.Future[None]:
    """Write the FMU, with a library of each compiler, in `pool`; same input and compiler, same bytes.

    data: {name: content} of the data files that its equations were made of.  The result raises CompilerError.
    """
    sources = {"fmi2.c": WRAPPER.read_bytes(), "equations.h": _equations(equations)}
    guid = digest_of({**sources, "class": repr(equations.layout.scalars).encode(), **data})
    sources["model.h"] = _layout(equations, guid)
    description = model_description(model, name, guid, "orch with CasADi", equations, CAPABILITIES, ["fmi2.c"], data)

    def finish() -> None:
        files = {"modelDescription.xml": description, **{f"sources/{path}": text for path, text in sources.items()}}
        files |= {f"{DATA}/{path}": content for path, content in data.items()}
        for compiler in compilers:
            files[f"binaries/{compiler.folder}/{name}{compiler.suffix}"] = compiler.library(sources)
        write_archive(target, files)

    return pool.submit(finish)


def _functions(equations: Equations) -> list[Any]:
    """The three functions of the model, and their derivatives along a direction; see fmi2.c."""
    import casadi as ca

    groups = equations.layout.groups
    parameters, calculated, inputs, states = (groups[g] for g in ("parameter", "calculated", "input", "state"))
    memory, direction = ca.SX.sym("m", states.stop), ca.SX.sym("d", states.start)
    held = ca.vertcat(memory[0] + memory[1], 0, memory[2:])  # where the last step ended
    d_step = _change(equations.step(held), memory[inputs], direction[: inputs.stop - inputs.start])
    c = equations.calculate(held[: parameters.stop])
    head = ca.vertcat(held[: calculated.start], c, held[inputs])
    x = equations.initial(head)
    start = ca.vertcat(c, x, equations.step(ca.vertcat(head, x))[states.stop - states.start :])
    knowns = ca.vertcat(memory[parameters], memory[inputs])
    d_start = _change(start, knowns, ca.vertcat(direction[parameters], direction[inputs]))
    return [
        equations.calculate,
        equations.initial,
        equations.step,
        ca.Function("d_step", [memory, direction], [d_step]),
        ca.Function("d_start", [memory, direction], [d_start]),
    ]


def _change(results: Any, knowns: Any, direction: Any) -> Any:
    import casadi as ca

    if knowns.is_empty() or results.is_empty():
        return ca.SX.zeros(results.numel(), 1)
    return ca.densify(ca.cse(ca.jtimes(results, knowns, direction)))


def _equations(equations: Equations) -> bytes:
    import casadi as ca

    generator = ca.CodeGenerator("equations.h", {"casadi_int": "int", "with_export": True})
    functions = _functions(equations)
    for function in functions:
        generator.add(function)
    work = max(function.sz_w() for function in functions)
    assert not any(function.sz_iw() for function in functions)
    text: str = generator.dump()
    return f"{text}\n#define WORK {work}\n".encode()


def _layout(equations: Equations, guid: str) -> bytes:
    layout = equations.layout
    groups = layout.groups
    kinds = "??" + "".join(TYPES[scalar.type][0] for scalar in layout.scalars)
    all_real = set(kinds[groups["input"].start :]) <= {"R"}
    names = ["t", "h", *(scalar.name for scalar in layout.scalars)]
    lines = [
        f"#define GUID {json.dumps(guid)}",
        "enum {",
        *(
            f"    {word} = {place},"
            for word, place in (
                ("PARAMETERS", groups["parameter"].start),
                ("CALCULATED", groups["calculated"].start),
                ("INPUTS", groups["input"].start),
                ("STATES", groups["state"].start),
                ("OUTPUTS", groups["output"].start),
                ("SIZE", layout.size),
                ("ALL_REAL", int(all_real)),
            )
        ),
        "};",
        f"static const unsigned int PLACES[] = {{{', '.join(map(str, range(layout.size)))}}};",
        f"static const char TYPES[] = {json.dumps(kinds)};",
        f"static const double START[] = {{{', '.join(map(repr, layout.start()))}}};",
        f"static const char *const NAMES[] = {{{', '.join(map(json.dumps, names))}}};",
    ]
    return "\n".join([*lines, ""]).encode()
