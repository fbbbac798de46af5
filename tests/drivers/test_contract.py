"""Every driver does what every driver must; so does one that a package of a lab's own brings, without a line of ours."""

import json
import os
import shutil
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
from tests.lab.commands import run_there

ROOT = Path(__file__).parents[2]
PACKAGES = (ROOT / "examples/regulator", ROOT / "examples/sensor", ROOT / "examples/arm")
VERIFYING = {"dynamixel", "ft300s", "pfeiffer", "tmcl"}
"""Drivers whose instruments send a checksum."""
THEIRS = ("bench_pr4", "skin_thermometer", "bench_arm", "bench_cameras")


def install(folder: Path, package: Path) -> dict[str, str]:
    """Write what an installer writes of a package's entry points; the environment in which it is installed."""
    project = tomllib.loads((package / "pyproject.toml").read_text())["project"]
    about = folder / f"{project['name'].replace('-', '_')}-{project['version']}.dist-info"
    about.mkdir()
    (about / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {project['name']}\nVersion: {project['version']}\n")
    groups = (
        f"[{group}]\n" + "".join(f"{name} = {value}\n" for name, value in entries.items())
        for group, entries in project["entry-points"].items()
    )
    (about / "entry_points.txt").write_text("\n".join(groups))
    return {**os.environ, "PYTHONPATH": os.pathsep.join(map(str, (folder, package, ROOT)))}


@pytest.fixture(scope="session")
def installed(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """The environment of a machine on which the examples' packages are installed."""
    folder = tmp_path_factory.mktemp("site")
    for package in PACKAGES:
        install(folder, package)
    return {**os.environ, "PYTHONPATH": os.pathsep.join(map(str, (folder, *PACKAGES, ROOT)))}


@pytest.mark.long
@pytest.mark.parametrize("drivers", [THEIRS, *((d,) for d in OWN)], ids=lambda found: "+".join(found))
def test_the_contract(drivers: tuple[str, ...], installed: dict[str, str], tmp_path: Path) -> None:
    done, report = contract(installed, tmp_path, *drivers)
    assert done.returncode == 0, done.stdout + done.stderr
    passed = [name for name, fault in report.items() if fault is None]
    assert all(any(driver in name for name in passed) for driver in drivers), passed
    over_tcp = "test_it_does_not_open_on_a_line_whose_answers_are_all_damaged[bench_arm]"
    assert over_tcp in passed or "bench_arm" not in drivers, report
    verified = [name for name in passed if "whose_checksum_is_wrong" in name]
    assert all(any(f"[{driver}]" in name for name in verified) for driver in VERIFYING & {*drivers}), report


@pytest.mark.parametrize("channels", [1, 2])
def test_the_contract_uses_as_many_channels_as_a_unit_has(channels: int, tmp_path: Path) -> None:
    shutil.copytree(ROOT / "examples/regulator", tmp_path / "unit")
    driver, fake = (tmp_path / "unit/bench_pr4" / name for name in ("driver.py", "fake.py"))
    driver.write_text(driver.read_text().replace("max_length=4", f"max_length={channels}"))
    fake.write_text(fake.read_text().replace("len(site.hoses)", str(channels)))
    done, report = contract(install(tmp_path, tmp_path / "unit"), tmp_path, "bench_pr4 and (channel or plant or keep or vent)")
    assert done.returncode == 0 and list(report.values()) == [None] * 5, done.stdout


def test_a_renamed_copy_has_the_new_name_everywhere(tmp_path: Path) -> None:
    page = (ROOT / "docs/howto/driver.md").read_text()
    rename = [line.strip() for line in page.splitlines() if line.strip().startswith(("mv my_regulator", "sed -i"))]
    shutil.copytree(ROOT / "examples/regulator", tmp_path / "my_regulator")
    subprocess.run("\n".join(rename), cwd=tmp_path, shell=True, check=True)
    assert [p for p in (tmp_path / "my_regulator").rglob("*.toml") if "pr4" in p.read_text()] == []
    environment = install(tmp_path, tmp_path / "my_regulator")
    fakes, found = run_there([["fakes", "--regulators", "ardupres"], ["schema", "rig"]], environment)
    assert "ardupress" in fakes.err and fakes.returncode == 2 and '"ardupress"' in found.out and "Pr4" not in fakes.err


def contract(
    environment: dict[str, str], folder: Path, *drivers: str
) -> tuple[subprocess.CompletedProcess[str], dict[str, str | None]]:
    """Try drivers; each test with the message of its failure, empty when it was skipped, None when it passed."""
    command = [sys.executable, "-m", "pytest", "--pyargs", "lab.driver_contract", "-k", " or ".join(drivers)]
    command += ["-q", "-n0", "-c", os.devnull, "-p", "no:cacheprovider", f"--basetemp={folder / 'pytest'}"]
    report = folder / "report.xml"
    command += [f"--junitxml={report}"]
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, timeout=600)
    told = {}
    for case in ElementTree.parse(report).iter("testcase"):
        wrong = [*case.iter("failure"), *case.iter("error")]
        told[case.attrib["name"]] = wrong[0].attrib["message"] if wrong else "" if len(case) else None
    return done, told


WRONG = {
    "range_ageless": ("a_stream_that_falls_silent_is_stale_after_max_age", ("latest() gave Sample(", "needed StaleReading")),
    "range_trusting": ("it_does_not_open_another_device", ("b'MSG0;4711\\r'", "returned Identity(", "WrongDevice")),
    "range_guessing": ("a_stream_hands_over_no_damaged_answer", ("distance=0.0", "count a damaged one in lost")),
    "range_crashing": ("a_stream_hands_over_no_damaged_answer", ("ValueError", "count a damaged one in lost")),
    "range_holding": ("close_leaves_the_port_to_others", ("is open 2 times", "before open() it was 1 times")),
    "range_sharing": ("close_leaves_the_port_to_others", ("is open 2 times", "before open() it was 1 times")),
    "range_host_time": ("samples_have_the_time_of_the_rig_s_clock", ("a sample has t = ", "now() of the clock")),
    "range_unchecked": ("a_stream_hands_over_no_answer_whose_checksum_is_wrong", ("distance=", "b'D;", "verify the checksum")),
    "range_uncounted": ("a_stream_hands_over_no_answer_whose_checksum_is_wrong", ("lost stays 0", "in lost")),
    "range_credulous": (
        "it_does_not_open_on_answers_whose_checksum_is_wrong",
        ("returned Identity(", "b'D;", "verify the checksum"),
    ),
    "gauge_unchecked": ("no_call_returns_on_an_answer_whose_checksum_is_wrong", ("GaugeSample(", "b'P", "verify the checksum")),
}
"""Drivers that are wrong in one respect: the only test that each fails, and what it says."""


@pytest.mark.long
def test_a_driver_that_is_wrong_in_one_respect_fails_the_test_of_that_and_no_other(tmp_path: Path) -> None:
    done, report = contract(install(tmp_path, ROOT / "tests/drivers/bench_range"), tmp_path, "range_", "gauge_")
    failed = {name: fault for name, fault in report.items() if fault}
    assert failed.keys() == {f"test_{test}[{driver}]" for driver, (test, _) in WRONG.items()}, done.stdout
    assert report["test_it_does_not_open_another_device[range_right]"] is None  # not skipped
    for driver, (test, words) in WRONG.items():
        told = failed[f"test_{test}[{driver}]"]
        assert all(word in told for word in words), told


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


@pytest.mark.long
def test_a_rig_with_instruments_of_one_s_own_is_checked_run_and_replayed(
    fakes: Path, installed: dict[str, str], tmp_path: Path
) -> None:
    def lab(*commands: tuple[str, ...], codes: tuple[int, ...] = (0, 3)) -> list[str]:  # 3: samples lost on a busy computer
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
    assert table.sensor_units == {"sensor_skin_temperature": "K", "sensor_skin_humidity": "1"}
    seen = [(row.t, row.sensors) for row in table]
    for t, sensors in seen:
        before = samples[(samples["t"] > t - 20) & (samples["t"] < t + 20)]["temperature"]
        assert before.min() <= sensors["sensor_skin_temperature"] <= before.max()
    write_csv(table, tmp_path / "trials.csv")
    again = read_csv(tmp_path / "trials.csv")
    assert not again.ignored and [row.sensors for row in again] == [row.sensors for row in table]
    assert replay(file)["sensor_skin_humidity"] == pytest.approx(0.38)
