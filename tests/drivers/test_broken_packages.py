"""Installed packages whose driver is none: named where they are used, and in nobody's way elsewhere."""

import json
import os
from pathlib import Path

import pytest

from tests.drivers.installed import install
from tests.lab.commands import Done, run_there

ROOT = Path(__file__).parents[2]
BROKEN = {
    "lacking": ("raise ImportError('no serial for you')", "cannot be loaded: ImportError: no serial for you"),
    "number": ("DRIVER = 3", "is of type int, not drivers.registry.Driver"),
    "misspelt": (
        "from drivers.registry import Driver\nDRIVER = Driver('presure', dict, dict)",
        "role 'presure' must be one of arm",
    ),
    "made_of_numbers": (
        "from drivers.registry import Driver\nDRIVER = Driver('pressure', dict, 1)",
        "config must be a subclass of drivers.configs.RegulatorsConfig; make must be callable",
    ),
    "unreachable": (
        "from drivers.registry import Driver\nfrom drivers.configs import SensorConfig\n"
        "DRIVER = Driver('sensor', SensorConfig, print, quantities={'T': 'K'})",
        "config must have one of port, ports, host, server, local, the address of the instrument; quantity 'T': 'K' must be",
    ),
}
"""What their module says, and what is said of it."""
Said = dict[tuple[str, str], Done]
"""By driver and verb."""


@pytest.fixture(scope="module")
def littered(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where all of them are installed."""
    folder = tmp_path_factory.mktemp("littered")
    for name, (module, _) in BROKEN.items():
        package = tmp_path_factory.mktemp(name)
        (folder / f"{name}.py").write_text(module)
        entries = f'[project.entry-points."softlab.drivers"]\n{name} = "{name}:DRIVER"\n'
        (package / "pyproject.toml").write_text(f'[project]\nname = "{name}"\nversion = "1"\n{entries}')
        install(folder, package)
    return folder


@pytest.fixture(scope="module")
def done(littered: Path) -> Said:
    """What each verb says of a rig at which nobody answers and whose regulators have each driver."""
    text = (ROOT / "examples/rig/rig.yaml").read_text().replace("../paper", str(ROOT / "examples/paper"))
    asked = {(name, "plan"): ("plan", "bending") for name in ("alicat", *BROKEN)} | {("lacking", "safe"): ("safe", "--json")}
    for name, _ in asked:
        rig = text.replace("192.168.0.", "127.0.0.").replace("driver: alicat", f"driver: {name}")
        (littered / f"{name}.yaml").write_text(rig)
    commands = [(*words, "--rig", littered / f"{name}.yaml") for (name, _), words in asked.items()]
    said = run_there(commands, {**os.environ, "PYTHONPATH": str(littered)})
    return dict(zip(asked, said, strict=True))


def test_they_hinder_nobody_who_does_not_use_them(done: Said) -> None:
    code, out, err = done["alicat", "plan"]
    assert code == 0, out + err


@pytest.mark.parametrize("name", BROKEN)
def test_each_is_named_where_it_is_used_and_nowhere_else(done: Said, name: str) -> None:
    code, out, err = done[name, "plan"]
    assert code == 2, out + err
    assert f"instruments.pressure.driver = {name}: package {name} 1: entry point {name}" in err and BROKEN[name][1] in err
    assert not any(f"package {other} 1" in err for other in BROKEN if other != name)


def test_a_landing_goes_on_without_them_and_tells_each_of_the_others_for_itself(done: Said) -> None:
    code, out, _ = done["lacking", "safe"]
    steps = {step["instrument"]: step for step in json.loads(out)["steps"]}
    assert code == 1 and set(steps) == {"arm", "pressure", "spine", "valve"}
    words = BROKEN["lacking"][1]
    assert words in steps["pressure"]["text"] and words not in steps["valve"]["text"]
