"""Records spoiled at random: the bytes of the file, or what it says through HDF5."""

import json
import os
import random
import shutil
import tempfile
from pathlib import Path

import h5py
import matplotlib.font_manager  # noqa: F401  it writes its cache now, not while files are watched
import numpy as np
from mutate_toml import EVERYTHING, spoil_bytes

from orchestrator.cli import main as cli

VALUES = ("", "[]", "{}", "null", "1", "x", "[[[[", '{"a": 1}', '["a"]', "1e400", "é", "completed", 0, 1, -1, 1e300)


def sources():
    """The bytes of a record of everything."""
    with tempfile.TemporaryDirectory() as folder:
        experiment, path = Path(folder) / "everything.toml", Path(folder) / "source.h5"
        experiment.write_text(EVERYTHING, encoding="utf-8")
        assert cli.execute(["run", str(experiment), "--output", str(path), "--quiet"]) == 0
        return path.read_bytes()


def commands(number, seed, content):
    """Writes the mutant, and gives the commands to try on it, each with the codes that it may have."""
    chance = random.Random(f"{seed} record {number}")
    os.makedirs("results/mutant", exist_ok=True)
    good, path = Path("results/mutant/good.h5"), Path("results/mutant/bad.h5")
    good.write_bytes(content)
    if chance.random() < 0.4:
        content = spoil_bytes(content, chance) if chance.random() < 0.7 else content[: chance.randrange(len(content))]
        path.write_bytes(content)
    else:
        shutil.copy(good, path)
        with h5py.File(path, "r+") as file:
            for _ in range(chance.choice((1, 1, 2, 4))):
                spoil(file, chance)
    os.utime(path, ns=(number, number))  # the index knows a file by its size and time
    run = [str(path)]
    suffix = chance.choice(("csv", "mat", "nc", "mcap", "parquet"))
    trials = [
        ["show", *run],
        ["list"],
        ["diff", str(good), *run],
        ["compare", str(good), *run],
        ["export", *run, "-o", f"results/mutant.{suffix}"],
        ["prune", "--status", "corrupt", "--yes"],
    ]
    if number % 10 == 0:
        trials.insert(4, ["report", *run, "-o", "results/mutant.html"])
        trials.insert(4, ["plot", *run, "--signals", "vehicle.eta.x", "-o", "results/mutant.svg"])
    return [(trial, (0, 2, 3)) for trial in trials]


def spoil(file, chance):
    """One change through HDF5."""
    items = []
    file.visititems(lambda name, item: items.append(name))
    name = chance.choice(items)
    match chance.randrange(6):
        case 0:
            attributes = list(file.attrs)
            file.attrs[chance.choice(attributes)] = chance.choice(VALUES)
        case 1:
            coded = [key for key in file.attrs if str(file.attrs[key])[:1] in ("{", "[")]
            key = chance.choice(coded)
            file.attrs[key] = json.dumps(replaced(json.loads(file.attrs[key]), chance))
        case 2:
            del file.attrs[chance.choice(list(file.attrs))]
        case 3:
            del file[name]
            links = (h5py.SoftLink("/time"), h5py.SoftLink(f"/{name}"), h5py.ExternalLink("other.h5", "/time"))
            file[name] = chance.choice(links)
        case 4:
            del file[name]
            rows = chance.choice((0, 1, 7, 10**6))
            shape = chance.choice(((), (rows,), (rows, 2)))
            file[name] = np.zeros(shape, chance.choice(("f8", "i4", "S3", "f4", "c16")))
        case _:
            attributes = list(file[name].attrs)
            if attributes:
                file[name].attrs[chance.choice(attributes)] = chance.choice(VALUES)


def replaced(value, chance):
    """One value within JSON replaced."""
    if isinstance(value, dict) and value and chance.random() < 0.9:
        key = chance.choice(list(value))
        return {**value, key: replaced(value[key], chance)}
    if isinstance(value, list) and value and chance.random() < 0.9:
        i = chance.randrange(len(value))
        return [*value[:i], replaced(value[i], chance), *value[i + 1 :]]
    return chance.choice((None, 0, -1, 1e300, "", "x", [], {}, True, [1], {"a": 1}))
