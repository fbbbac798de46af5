"""Every driver does what every driver must; so does one that a package of a lab's own brings, without a line of ours."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml

from drivers.registry import OWN
from lab.verbs.fakes import PATIENT, PATIENT_SETTLE
from recordings.campaign.replay import replay, table_of
from recordings.file.reader import Recording
from recordings.table_file import read_csv, write_csv

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


@pytest.mark.parametrize("driver", [*THEIRS, *(pytest.param(d, marks=pytest.mark.long) for d in OWN)])
def test_the_contract(driver: str, installed: dict[str, str], tmp_path: Path) -> None:
    command = [sys.executable, "-m", "pytest", "--pyargs", "lab.driver_contract", "-k", driver]
    command += ["-q", "-n0", "-c", os.devnull, "-p", "no:cacheprovider", f"--basetemp={tmp_path / 'pytest'}"]
    done = subprocess.run(command, cwd=tmp_path, env=installed, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "passed" in done.stdout


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
    def lab(*words: str, codes: tuple[int, ...] = (0, 3)) -> str:  # 3: samples lost on a busy computer
        done = subprocess.run(
            [sys.executable, "-m", "lab.cli", *words], env=installed, capture_output=True, text=True, timeout=300
        )
        assert done.returncode in codes, done.stdout + done.stderr
        return done.stdout

    # 1: a busy computer sees 5 kPa at the tip too late; what is asked here is the arm
    told = json.loads(lab("check", "--move", "--yes", "--rig", str(fakes), "--seconds", "1", "--json", codes=(0, 1, 3)))
    rows = {row["instrument"]: row for row in told["instruments"]}
    assert rows["pressure"]["model"] == "PR4" and rows["arm"]["model"] == "bench-arm"
    assert all(rows[name]["samples"] > 0 for name in ("arm_state", "mocap", "sensors.skin"))
    moved = {each["what"]: each["ok"] for each in told["moved"]}
    assert moved["arm"] and moved["safe state"], told["moved"]
    settings = ("spine_lengths=[0.05]", "pressures=[60 kPa]", "unload=false", *PATIENT_SETTLE)
    how = [word for setting in settings for word in ("--set", setting)]
    lab("run", "bending", "--rig", str(fakes), *how, "--out", str(tmp_path))
    (file,) = tmp_path.glob("*.mcap")
    assert "bit-identical to the live run's" in lab("replay", str(file))
    assert "/sensor/skin temperature: 29" in lab("info", str(file)) and lab("info", str(file)).count(" K") == 1
    assert json.loads(lab("info", str(file), "--json"))["sensors"]["/sensor/skin"]["humidity"]["unit"] == "1"
    drawn = json.loads(lab("compare", str(file), "--out", str(tmp_path / "compared"), "--json"))
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


@pytest.mark.parametrize(
    ("module", "words"),
    [
        ("raise ImportError('no serial for you')", "cannot be loaded: ImportError: no serial for you"),
        ("DRIVER = 3", "is of type int, not drivers.registry.Driver"),
        (
            "from drivers.registry import Driver\nDRIVER = Driver('presure', dict, dict)",
            "role 'presure' must be one of arm",
        ),
        (
            "from drivers.registry import Driver\nDRIVER = Driver('pressure', dict, 1)",
            "config must be a subclass of drivers.configs.RegulatorsConfig; make must be callable",
        ),
        (
            "from drivers.registry import Driver\nfrom drivers.configs import SensorConfig\n"
            "DRIVER = Driver('sensor', SensorConfig, print, quantities={'T': 'K'})",
            "config must have one of port, ports, host, server, local, where it is reached; quantity 'T': 'K' must be",
        ),
    ],
)
def test_a_package_whose_driver_is_none_is_named_where_it_is_used_and_nowhere_else(
    tmp_path: Path, module: str, words: str
) -> None:
    package = tmp_path / "broken"
    package.mkdir()
    (package / "broken.py").write_text(module)
    (package / "pyproject.toml").write_text(
        '[project]\nname = "broken"\nversion = "1"\n[project.entry-points."softlab.drivers"]\nbroken = "broken:DRIVER"\n'
    )
    install(tmp_path, package)
    env = {**os.environ, "PYTHONPATH": os.pathsep.join((str(tmp_path), str(package)))}
    rig = (ROOT / "examples/rig/rig.yaml").read_text().replace("../paper", str(ROOT / "examples/paper"))
    rig = rig.replace("192.168.0.", "127.0.0.")  # nobody there

    for text, code, told in (
        (rig, 0, ""),
        (
            rig.replace("driver: alicat", "driver: broken"),
            2,
            "instruments.pressure.driver = broken: package broken 1: entry point broken",
        ),
    ):
        path = tmp_path / "rig.yaml"
        path.write_text(text)
        command = [sys.executable, "-m", "lab.cli", "plan", "bending", "--rig", str(path)]
        done = subprocess.run(command, env=env, capture_output=True, text=True, timeout=120)
        assert done.returncode == code, done.stdout + done.stderr
        assert told in done.stderr and (code == 0 or words in done.stderr)
    # a landing goes on without it and tells each of the others for itself
    command = [sys.executable, "-m", "lab.cli", "safe", "--rig", str(path), "--json"]
    done = subprocess.run(command, env=env, capture_output=True, text=True, timeout=120)
    steps = {step["instrument"]: step for step in json.loads(done.stdout)["steps"]}
    assert done.returncode == 1 and set(steps) == {"arm", "pressure", "spine", "valve"}
    assert words in steps["pressure"]["text"] and words not in steps["valve"]["text"]
