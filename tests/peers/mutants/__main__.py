"""Experiment files, FMUs and records spoiled at random, and what orch says to them: all in this one process.

    python tests/peers/mutants experiments --count 500 --seed 1
    python tests/peers/mutants archives --count 100 --seed 1
    python tests/peers/mutants records --count 100 --seed 1
    python tests/peers/mutants experiments --only 1234 --seed 1        one again, with all that orch says

Works in the current folder.  A mutant must be refused with an error message (exit code 2) or be valid (0; of a run also
3): no traceback, no crash, no command over 10 s, no file written but in results/ and where temporary files go.  Prints
what breaks this; exit code 1 if anything does.
"""

import argparse
import contextlib
import faulthandler
import io
import json
import os
import sys
import tempfile
import warnings

import mutate_fmu
import mutate_record
import mutate_toml

from orchestrator.cli import main as cli
from orchestrator.models import build

LONGEST = 10.0  # s that a command may take
# Which argument names the file that changes, and which the folder that it is relative to.
WRITES = {
    "os.mkdir": (0, 2),
    "os.remove": (0, 1),
    "os.rmdir": (0, 1),
    "os.truncate": (0, None),
    "os.rename": (1, 3),
    "os.link": (1, 3),
    "os.symlink": (1, 2),
}
MODES = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_APPEND
strays: list[str] = []
ended: dict[tuple[str, int], int] = {}  # how often a command ended so
allowed: list[str] = []


def watch(event, arguments):
    """An audit hook: notes every file that is changed where none should be."""
    if not allowed or (event != "open" and event not in WRITES):
        return
    if event == "open" and not (isinstance(arguments[2], int) and arguments[2] & MODES):
        return
    which, folder = WRITES.get(event, (0, None))
    path = arguments[which]
    if isinstance(path, (str, bytes, os.PathLike)):
        above = f"/proc/self/fd/{arguments[folder]}" if folder and arguments[folder] >= 0 else "."
        place = os.path.realpath(os.path.join(above, os.fsdecode(path)))
        if not place.startswith(tuple(allowed)):
            strays.append(f"{event} {place}")


def attempt(command):
    """Exit code and all that the command says."""
    out = io.StringIO()
    faulthandler.dump_traceback_later(LONGEST, exit=True)
    try:
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(out):
            code = cli.execute(command)
    finally:
        faulthandler.cancel_dump_traceback_later()
    return code, out.getvalue()


def judge(number, commands, loud):
    """What is wrong with the answers to one mutant, as messages."""
    found = []
    for command, codes in commands:
        strays.clear()
        code, said = attempt(command)
        ended[command[0], code] = ended.get((command[0], code), 0) + 1
        if loud:
            print(f"$ orch {' '.join(command)[:300]}\n{said[:3000]}\n-> {code}")
        if code not in codes or "Traceback" in said or "This is a bug" in said or (code and not said.strip()):
            found.append(f"{number}: {' '.join(command)[:200]} -> {code}\n{said[-3000:]}")
        found += [f"{number}: {' '.join(command)[:200]} writes: {stray}" for stray in strays[:3]]
        if "--json" in command and code != 2:
            try:
                json.loads(said[said.index("{") :] if code == 0 else said.splitlines()[0])
            except ValueError as error:
                found.append(f"{number}: {' '.join(command)[:200]}: no JSON: {error}\n{said[-500:]}")
    return found


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=["experiments", "archives", "records"])
    parser.add_argument("--count", type=int, default=500)
    parser.add_argument("--seed", default="1")
    parser.add_argument("--only", type=int, metavar="NUMBER")
    parser.add_argument("--given", metavar="DIR", help="more FMUs to spoil")
    asked = parser.parse_args()
    global SOURCES
    build.build(mutate_toml.MODELS)
    mutate = {"experiments": mutate_toml, "archives": mutate_fmu, "records": mutate_record}[asked.what]
    sources = mutate.sources(asked.given) if asked.what == "archives" else mutate.sources()
    warnings.simplefilter("ignore")  # zipfile's, of names that occur twice
    temporary = os.path.realpath(tempfile.gettempdir())
    mine = {"mutant.toml", "mutant.fmu", "results", *os.listdir()}
    sys.dont_write_bytecode = True
    sys.addaudithook(watch)
    allowed[:] = [os.path.realpath("results"), os.path.realpath("mutant."), f"{temporary}{os.sep}orch-", os.devnull]
    broken = 0
    for number in range(asked.count) if asked.only is None else [asked.only]:
        found = judge(number, mutate.commands(number, asked.seed, sources), asked.only is not None)
        found += [f"{number}: leaves {name}" for name in set(os.listdir()) - mine]
        if found:
            broken += 1
            print("\n".join(found), flush=True)
    allowed.clear()
    left = [name for name in os.listdir(temporary) if name.startswith("orch-")]
    print(", ".join(f"{command} {code}: {times} times" for (command, code), times in sorted(ended.items())))
    print(f"{broken} of {asked.count} mutants broke a rule; {len(left)} temporary folders left")
    sys.stdout.flush()
    os._exit(1 if broken or left else 0)


if __name__ == "__main__":
    main()
