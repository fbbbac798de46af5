"""Every driver does what every driver must; so does one that a package of a lab's own brings, without a line of ours."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree

import pytest
import yaml

from drivers.registry import OWN
from lab.verbs.fakes import PATIENT, PATIENT_SETTLE
from recordings.campaign.replay import replay, table_of
from recordings.file.reader import Recording
from recordings.table_file import read_csv, write_csv
from tests.lab.commands import Done, run_there

ROOT = Path(__file__).parents[2]
PACKAGES = (ROOT / "examples/regulator", ROOT / "examples/sensor", ROOT / "tests/drivers/bench_arm")
THEIRS = ("bench_pr4", "skin_thermometer", "bench_arm", "bench_cameras")


@pytest.fixture(scope="session")
def installed(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """The environment of a machine on which the examples' packages are installed."""
    folder = tmp_path_factory.mktemp("site")
    for package in PACKAGES:
        install(folder, package)
    return {**os.environ, "PYTHONPATH": os.pathsep.join(map(str, (folder, *PACKAGES)))}


def install(folder: Path, package: Path) -> None:
    """What an installer writes of a package's entry points."""
    project = tomllib.loads((package / "pyproject.toml").read_text())["project"]
    about = folder / f"{project['name'].replace('-', '_')}-{project['version']}.dist-info"
    about.mkdir()
    (about / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {project['name']}\nVersion: {project['version']}\n")
    groups = (
        f"[{group}]\n" + "".join(f"{name} = {value}\n" for name, value in entries.items())
        for group, entries in project["entry-points"].items()
    )
    (about / "entry_points.txt").write_text("\n".join(groups))


@pytest.mark.parametrize(
    "drivers", [THEIRS, *(pytest.param((d,), marks=pytest.mark.long) for d in OWN)], ids=lambda found: "+".join(found)
)
def test_the_contract(drivers: tuple[str, ...], installed: dict[str, str], tmp_path: Path) -> None:
    command = [sys.executable, "-m", "pytest", "--pyargs", "lab.driver_contract", "-k", " or ".join(drivers)]
    command += ["-q", "-n0", "-c", os.devnull, "-p", "no:cacheprovider", f"--basetemp={tmp_path / 'pytest'}"]
    report = tmp_path / "report.xml"
    command += [f"--junitxml={report}"]
    done = subprocess.run(command, cwd=tmp_path, env=installed, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stdout + done.stderr
    passed = [case.attrib["name"] for case in ElementTree.parse(report).iter("testcase") if len(case) == 0]
    assert all(any(driver in name for name in passed) for driver in drivers), passed


@pytest.fixture
def fakes(installed: dict[str, str], tmp_path: Path) -> Iterator[Path]:
    """rig.yaml of a rig whose regulators, arm and cameras and one of whose sensors are the packages'."""
    rig = tmp_path / "rig.yaml"
    command = [sys.executable, "-m", "lab.cli", "fakes", "--speed", "20", "--rig", str(rig)]
    command += ["--regulators", "bench_pr4", "--sensor", "skin=skin_thermometer"]
    command += ["--arm", "bench_arm", "--mocap", "bench_cameras"]
    running = subprocess.Popen(command, env=installed, stdout=subprocess.PIPE, text=True)
    try:
        assert running.stdout is not None and running.stdout.readline()
        made = yaml.safe_load(rig.read_text())
        for name, values in PATIENT["instruments"].items():
            foreign = made["instruments"][name]["driver"] in THEIRS
            known = ("max_age", "timeout") if foreign else tuple(values)
            made["instruments"][name] |= {key: value for key, value in values.items() if key in known}
        rig.write_text(yaml.safe_dump({**made, "limits": PATIENT["limits"], "safe": PATIENT["safe"]}))
        yield rig
    finally:
        running.terminate()
        running.wait(30)


def test_a_rig_with_instruments_of_one_s_own_is_checked_run_and_replayed(
    fakes: Path, installed: dict[str, str], tmp_path: Path
) -> None:
    def lab(
        *commands: tuple[str, ...], codes: tuple[int, ...] = (0, 3)
    ) -> list[str]:  # 3: samples lost on a busy computer
        done = run_there(commands, installed)
        assert all(code in codes for code, _, _ in done), done
        return [out for _, out, _ in done]

    # 1: a busy computer sees 5 kPa at the tip too late; what is asked here is the arm
    (said,) = lab(("check", "--move", "--yes", "--rig", str(fakes), "--seconds", "1", "--json"), codes=(0, 1, 3))
    told = json.loads(said)
    rows = {row["instrument"]: row for row in told["instruments"]}
    assert rows["pressure"]["model"] == "PR4" and rows["arm"]["model"] == "bench-arm"
    assert all(rows[name]["samples"] > 0 for name in ("arm_state", "mocap", "sensors.skin"))
    moved = {each["what"]: each["ok"] for each in told["moved"]}
    assert moved["arm"] and moved["safe state"], told["moved"]
    settings = ("spine_lengths=[0.05]", "pressures=[60 kPa]", "unload=false", *PATIENT_SETTLE)
    how = [word for setting in settings for word in ("--set", setting)]
    lab(("run", "bending", "--rig", str(fakes), *how, "--out", str(tmp_path)))
    (file,) = tmp_path.glob("*.mcap")
    replayed, shown, listed, compared = lab(
        ("replay", str(file)),
        ("info", str(file)),
        ("info", str(file), "--json"),
        ("compare", str(file), "--out", str(tmp_path / "compared"), "--json"),
    )
    assert "bit-identical to the live run's" in replayed
    assert "/sensor/skin temperature: 29" in shown and shown.count(" K") == 1
    assert json.loads(listed)["sensors"]["/sensor/skin"]["humidity"]["unit"] == "1"
    drawn = json.loads(compared)
    assert Path(drawn["sensors"]).stat().st_size > 10_000
    # from here on without the packages: the recording tells what the sensor measured
    recording = Recording.open(file)
    assert not recording.metadata.get("identity.arm") and not len(recording.stream("/arm"))  # a sweep needs no arm
    samples = recording.stream("/sensor/skin")
    assert samples.dtype.names == ("t", "temperature", "humidity") and len(samples) > 20
    table = table_of(recording)
    assert table.units == {"sensor_skin_temperature": "K", "sensor_skin_humidity": "1"}
    seen = [(row.t, row.sensors) for row in table]
    for t, sensors in seen:
        before = samples[(samples["t"] > t - 20) & (samples["t"] < t + 20)]["temperature"]
        assert before.min() <= sensors["sensor_skin_temperature"] <= before.max()
    write_csv(table, tmp_path / "trials.csv")
    again = read_csv(tmp_path / "trials.csv")
    assert not again.ignored and [row.sensors for row in again] == [row.sensors for row in table]
    assert replay(file)["sensor_skin_humidity"] == pytest.approx(0.38)


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
"""Packages whose driver is none, all of them installed: what their module says, and what is said of it."""
Said = dict[tuple[str, str], Done]


@pytest.fixture(scope="module")
def said(tmp_path_factory: pytest.TempPathFactory) -> Said:
    """What (verb, driver of the regulators) ends with on a machine on which they are installed; nobody answers at the rig."""
    folder = tmp_path_factory.mktemp("littered")
    for name, (module, _) in BROKEN.items():
        package = tmp_path_factory.mktemp(name)
        (folder / f"{name}.py").write_text(module)
        entries = f'[project.entry-points."softlab.drivers"]\n{name} = "{name}:DRIVER"\n'
        (package / "pyproject.toml").write_text(f'[project]\nname = "{name}"\nversion = "1"\n{entries}')
        install(folder, package)
    text = (ROOT / "examples/rig/rig.yaml").read_text().replace("../paper", str(ROOT / "examples/paper"))
    asked: dict[tuple[str, str], tuple[str, ...]] = {}
    for name in ("alicat", *BROKEN):
        rig = folder / f"{name}.yaml"
        rig.write_text(text.replace("192.168.0.", "127.0.0.").replace("driver: alicat", f"driver: {name}"))
        asked["plan", name] = ("plan", "bending", "--rig", str(rig))
        if name in BROKEN:
            asked["safe", name] = ("safe", "--rig", str(rig), "--json")
    done = run_there(list(asked.values()), {**os.environ, "PYTHONPATH": str(folder)})
    return dict(zip(asked, done, strict=True))


def test_packages_whose_driver_is_none_hinder_nobody_who_does_not_use_them(said: Said) -> None:
    code, out, err = said["plan", "alicat"]
    assert code == 0, out + err


@pytest.mark.parametrize("name", BROKEN)
def test_a_package_whose_driver_is_none_is_named_where_it_is_used_and_nowhere_else(said: Said, name: str) -> None:
    words = BROKEN[name][1]
    code, out, err = said["plan", name]
    assert code == 2, out + err
    assert f"instruments.pressure.driver = {name}: package {name} 1: entry point {name}" in err and words in err
    assert not any(f"package {other} 1" in err for other in BROKEN if other != name)


@pytest.mark.parametrize("name", BROKEN)
def test_a_landing_goes_on_without_a_driver_that_is_none_and_tells_each_of_the_others_for_itself(
    said: Said, name: str
) -> None:
    code, out, _ = said["safe", name]
    steps = {step["instrument"]: step for step in json.loads(out)["steps"]}
    assert code == 1 and set(steps) == {"arm", "pressure", "spine", "valve"}
    words = BROKEN[name][1]
    assert words in steps["pressure"]["text"] and words not in steps["valve"]["text"]
