"""What installed packages announce: one that is broken hinders nobody, and is named with what to do where it is used."""

import os
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from commands import Cli, run_there

from lab.files.all_protocols import found_protocols
from lab.files.own_effects import catalogue, effects_from_file
from lab.files.packages import Unusable, installed, python_file
from lab.files.rig_file import found_drivers
from lab.verbs.fakes import found_fakes
from model.robot import load_robot

ROOT = Path(__file__).parents[2]
RIG = str(ROOT / "examples/rig/rig.yaml")
CREEP = (ROOT / "examples/protocol/creep.py").read_text()
EFFECT = """
from model.effects import EffectSpec, Law, Parameter
def soften(q, v):
    q.body_modulus = q.body_modulus * (1 + v["size"])
EFFECTS = (EffectSpec("{id}", "material", "", (Parameter("size", "1", 0.1, -0.9, 1.0),), Law(before=soften), "", ""),)
"""
DRIVER = """
from drivers.configs import GaugeConfig
from drivers.registry import Driver
class Config(GaugeConfig):
    port: str
DRIVER = Driver("gauge", Config, print)
"""
FAKE = """
from sim_fakes.instrument import Fake
FAKE = Fake("{role}", lambda site: [], lambda site, parts: dict())
"""
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
        "from drivers.registry import Driver\nfrom drivers.configs import SensorConfig\nclass Config(SensorConfig): port: int\n"
        "DRIVER = Driver('sensor', Config, print, quantities={'T': 'K'})",
        "config must have one of port, ports, host, server, local as text, the instrument's address; quantity 'T': 'K' must be",
    ),
}
"""Drivers that are none: what their module says, and what is said of it."""
Install = Callable[..., None]


@pytest.fixture
def install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Install]:
    """Installs a package with a module of its name and these entry points, group -> {name: attribute}."""
    before = set(sys.modules)
    monkeypatch.syspath_prepend(str(tmp_path))

    def install(package: str, text: str, **groups: dict[str, str]) -> None:
        (tmp_path / f"{package}.py").write_text(text)
        info = tmp_path / f"{package}-1.0.dist-info"
        info.mkdir()
        (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {package}\nVersion: 1.0\n")
        lines = [
            f"[softlab.{group}]\n" + "".join(f"{n} = {package}{at}\n" for n, at in entries.items())
            for group, entries in groups.items()
        ]
        (info / "entry_points.txt").write_text("\n".join(lines))
        found_drivers.cache_clear()
        found_fakes.cache_clear()

    yield install
    for name in set(sys.modules) - before:
        if str(getattr(sys.modules[name], "__file__", "")).startswith(str(tmp_path)):
            del sys.modules[name]
    monkeypatch.undo()
    found_drivers.cache_clear()
    found_fakes.cache_clear()


def number(name: str, thing: object) -> dict[str, int]:
    """Entry points of these tests give numbers."""
    if not isinstance(thing, int):
        raise Unusable(f"is no number but {thing!r}")
    return {name: thing}


def test_a_broken_package_is_named_with_its_error_and_its_cure_and_hinders_nobody(install: Install) -> None:
    install("good", "ONE = 1", numbers={"one": ":ONE"})
    install("odd", "ONE = 'a'", numbers={"odd": ":ONE", "gone": ":TWO"})
    install("worse", "raise SystemExit('no licence')", numbers={"worse": ":ONE"})
    found = installed("softlab.numbers", {"zero": 0}, number)
    assert found.usable == {"zero": 0, "one": 1} and not found.doubts
    assert found.broken["odd"] == (
        "package odd 1.0: entry point odd = odd:ONE of softlab.numbers: is no number but 'a'; "
        "repair it or remove it: pip uninstall odd"
    )
    assert "AttributeError" in found.broken["gone"] and "SystemExit: no licence" in found.broken["worse"]


def test_a_name_of_our_own_stays_ours_and_of_two_packages_neither_has_it(install: Install) -> None:
    install("first", "ONE = 1", numbers={"zero": ":ONE", "mine": ":ONE"})
    install("second", "ONE = 2", numbers={"mine": ":ONE", "lost": ":TWO"})
    found = installed("softlab.numbers", {"zero": 0}, number, {"lost": "install it"})
    assert found.usable == {"zero": 0}
    assert "package first 1.0" in found.doubts["zero"] and "belongs to this software" in found.doubts["zero"]
    assert found.broken["lost"] == "install it" and "package second 1.0" in found.doubts["lost"]
    both = found.broken["mine"]
    assert "first 1.0" in both and "second 1.0" in both and "pip uninstall first or pip uninstall second" in both


def test_a_broken_one_takes_no_name_from_a_good_one(install: Install) -> None:
    install("first", "ONE = 1", numbers={"mine": ":ONE"})
    install("second", "", numbers={"mine": ":ONE"})
    found = installed("softlab.numbers", {}, number)
    assert found.usable == {"mine": 1} and "package second 1.0" in found.doubts["mine"]


def test_protocols(install: Install, cli: Cli) -> None:
    install("packaged", CREEP, protocols={"creep": "", "bending": ""})
    install("odd", "import nothing_of_this_name", protocols={"odd": ""})
    assert set(found_protocols().usable) == {"stiffness", "bending", "elongation", "cycles", "arm_accuracy", "creep"}
    assert "note" not in cli("plan", "elongation", "--rig", RIG, "--set", "repeats=2").err
    assert "package packaged 1.0: entry point bending" in cli("plan", "bending", "--rig", RIG).flat_err
    missing = cli("plan", "odd", "--rig", RIG, code=2).err
    assert "cannot be loaded: ModuleNotFoundError: No module named 'nothing_of_this_name'" in missing
    cli("schema", "odd", code=2)


def test_fakes(install: Install, cli: Cli, tmp_path: Path) -> None:
    install("odd", "FAKE = 3", fakes={"odd": ":FAKE"})
    install("alone", FAKE.format(role="gauge"), fakes={"alone": ":FAKE"})
    install("mixed", DRIVER + FAKE.format(role="valve"), fakes={"mixed": ":FAKE"}, drivers={"mixed": ":DRIVER"})
    install("greedy", DRIVER + FAKE.format(role="gauge"), fakes={"pfeiffer": ":FAKE"}, drivers={"pfeiffer": ":DRIVER"})
    for words, told in (
        (["--gauge", "odd"], "package odd 1.0: entry point odd = odd:FAKE of softlab.fakes: is of type int"),
        (["--gauge", "alone"], "a fake alone exists, but no driver of this name"),
        (["--valve", "mixed"], "its fake is for valve, its driver for gauge"),
        (["--arm", "alicat"], "--arm alicat: must be one of ur5"),
        (["--sensor", "skin"], "--sensor skin: must be NAME=DRIVER"),
        (["--sensor", "skin=alone"], "no fake for sensor is installed"),
    ):
        text = cli("fakes", *words, code=2).flat_err
        assert told in text, text
    assert "package greedy 1.0: entry point pfeiffer" in text  # played all the same, by ours


def rig_with(path: Path, driver: str) -> Path:
    """A rig at which nobody answers, whose regulators have this driver."""
    text = Path(RIG).read_text().replace("../paper", str(ROOT / "examples/paper")).replace("192.168.0.", "127.0.0.")
    path.write_text(text.replace("driver: alicat", f"driver: {driver}"))
    return path


def test_a_driver_that_is_none_is_named_where_it_is_used_and_hinders_nobody_elsewhere(
    install: Install, cli: Cli, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("lab.guard.new_guard.REACH_WITHIN", 1.0)  # of instruments that nobody reaches
    for name, (module, _) in BROKEN.items():
        install(name, module, drivers={name: ":DRIVER"})
    cli("plan", "bending", "--rig", rig_with(tmp_path / "rig.yaml", "alicat"))
    for name, (_, words) in BROKEN.items():
        err = cli("plan", "bending", "--rig", rig_with(tmp_path / "rig.yaml", name), code=2).err
        assert f"instruments.pressure.driver = {name}: package {name} 1.0: entry point {name}" in err and words in err
        assert not any(f"package {other} 1" in err for other in BROKEN if other != name)
    landed = cli("safe", "--rig", rig_with(tmp_path / "rig.yaml", "lacking"), "--json", code=1).json
    steps = {step["instrument"]: step["text"] for step in landed["steps"]}
    assert set(steps) == {"arm", "pressure", "spine", "valve"}
    assert BROKEN["lacking"][1] in steps["pressure"] and BROKEN["lacking"][1] not in steps["valve"]


def test_a_driver_that_takes_a_name_of_ours_is_told_by_the_check(install: Install, cli: Cli, tmp_path: Path) -> None:
    install("greedy", DRIVER, drivers={"pfeiffer": ":DRIVER"})
    rig = rig_with(tmp_path / "rig.yaml", "alicat")
    text = rig.read_text()
    rig.write_text(text[: text.index("instruments:")] + "instruments: {gauge: {driver: pfeiffer, port: /dev/nobody}}\n")
    (warning,) = cli("check", "--rig", rig, "--seconds", "0", "--json", code=1).json["warnings"]
    assert warning.startswith("gauge: package greedy 1.0: entry point pfeiffer = greedy:DRIVER of softlab.drivers")


def test_a_mistake_in_a_driver_is_named_with_its_line(install: Install, tmp_path: Path) -> None:
    text = DRIVER.replace('"gauge", Config, print', '"{role}", Config, Odd, quantities={{"t_skin": "K"}}')
    text = text.replace("GaugeC", "{base}C")
    text = "class Odd:\n    lost = 0\n    def __init__(self, *_): ...\n    def open(self):\n        a, b = (1,)\n" + text
    for name, role, base in (("odd_gauge", "gauge", "Gauge"), ("odd_sensor", "sensor", "Sensor")):
        install(name, text.format(role=role, base=base), drivers={name: ":DRIVER"})
    rig = rig_with(tmp_path / "rig.yaml", "alicat")
    known, port = rig.read_text().partition("instruments:")[0], "port: /dev/nobody}"
    tables = f"gauge: {{driver: odd_gauge, {port}, sensors: {{skin: {{driver: odd_sensor, {port}}}"
    rig.write_text(f"{known}instruments: {{{tables}}}\n")
    environment = os.environ | {"PYTHONPATH": f"{tmp_path}{os.pathsep}{ROOT}"}
    (done,) = run_there([["check", "--rig", rig, "--seconds", "0", "--json"]], environment)
    words = "error in the driver {}, {}.py line 5: ValueError: not enough values to unpack (expected 2, got 1)"
    assert [row["problem"] for row in done.json["instruments"]] == [
        words.format(name, name) for name in ("odd_gauge", "odd_sensor")
    ]


def test_effects(install: Install) -> None:
    robot = load_robot(ROOT / "examples/paper/robot.yaml")
    install("packaged", EFFECT.format(id="from_package"), effects={"any": ":EFFECTS"})
    install("greedy", EFFECT.format(id="base_tilt"), effects={"any": ":EFFECTS"})
    law = "Law(before=lambda q, v: 1 / 0)"
    install("failing", EFFECT.format(id="failing").replace("Law(before=soften)", law), effects={"failing": ":EFFECTS"})
    effects, told = catalogue(robot)
    assert "from_package" in effects and "failing" not in effects and effects["base_tilt"].equation
    text = "\n".join(told)
    assert "package failing 1.0" in text and "its law fails: ZeroDivisionError" in text
    assert "package greedy 1.0: entry point any = greedy:EFFECTS of softlab.effects: the name base_tilt" in text


@pytest.mark.parametrize(
    "text", ["EFFECTS = ()", "EFFECTS = ('colder',)", "EFFECTS = 3", "nothing = 1", "1 / 0", "def oops(:", "raise SystemExit"]
)
def test_a_file_without_good_effects_is_refused_by_name(tmp_path: Path, text: str, cli: Cli) -> None:
    path = tmp_path / "own.py"
    path.write_text(text)
    said = cli("effects", "--out", tmp_path / "out", "--effects", path, code=2).err
    assert "own.py" in said and ("EFFECTS must be a tuple of EffectSpec" in said or text.startswith(("1", "def", "raise")))


def test_a_file_is_run_as_no_module_that_others_could_import(tmp_path: Path) -> None:
    path = tmp_path / "own.py"
    path.write_text(EFFECT.format(id="from_file"))
    assert [spec.id for spec in effects_from_file(path)] == ["from_file"]
    assert python_file(path)[0].__name__ not in sys.modules
