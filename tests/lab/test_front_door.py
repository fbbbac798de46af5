"""The command and `import lab` before any work: verbs, help, completion, what is not installed, and packages of the same name."""

import contextlib
import os
import re
import shlex
import shutil
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
from commands import Cli, run_there
from pydantic import BaseModel
from virtual_lab import VirtualLab

import lab
import lab.version
from diagnosis.diagnose import Options
from drivers.alicat.wire import UNITS as WIRE
from lab.cli import GROUPS, declared, main, parser
from lab.files.robot_file import paper_robot
from lab.version import strangers
from sim_fakes.alicat import UNITS
from tests.diagnosis.small_campaigns import SOME

ROOT = Path(__file__).parents[2]
RECORDING = ROOT / "tests/recordings/data/bending-schema-1.mcap"


# ------------------------------------------------------------------ import lab
def test_its_names_are_known_and_its_help_begins_with_them() -> None:
    assert lab.__doc__ is not None
    assert set(re.findall(r"^    (\w+)\(", lab.__doc__, re.MULTILINE)) == set(lab.__all__) - {"Case"}
    assert set(lab.__all__) <= set(dir(lab))
    assert all(callable(getattr(lab, name)) and getattr(lab, name).__doc__ for name in lab.__all__)
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        lab.nothing  # noqa: B018


HEAVY = {"scipy", "numba", "pandas", "matplotlib", "diagnosis"}
GUARD = "import lab.guard.process, lab.guard.hosted, lab.guard.new_guard, lab.rig.real_time, lab.files.rig_file as r; r.drivers()"
NEAR = "import lab, pandas; lab.case(pandas.read_csv('trials.csv'), 'robot.yaml')"  # of a robot that explains its table


@pytest.mark.parametrize(
    ("work", "without"),
    [
        ("import lab", {*HEAVY, "numpy", "pydantic", "yaml", "rich", "model", "drivers", "mcap"}),
        (f"import lab; lab.read({str(RECORDING)!r})", {*HEAVY, "drivers"}),
        ("import lab; lab.load_robot('examples/three_chambers/robot.yaml')", {*HEAVY, "drivers", "mcap"}),
        (GUARD, {*HEAVY, "numpy", "mcap", "sim_fakes", "google.protobuf", "rich"}),
        ("import lab.verbs.safe", {*HEAVY, "numpy", "model", "mcap", "drivers", "pydantic"}),
        ("import lab.verbs.check", HEAVY),
        ("import lab.verbs.compare, lab.verbs.diagnose", {"matplotlib", "drivers", "scipy.optimize", "scipy.spatial"}),
        (NEAR, {"scipy.special", "scipy.optimize", "scipy.spatial", "scipy.interpolate", "matplotlib", "drivers"}),
    ],
    ids=["lab", "read", "load_robot", "guard", "safe", "check", "compare", "case"],
)
def test_what_solves_diagnoses_and_draws_is_loaded_where_it_is_used_alone(work: str, without: set[str], small_case: Path) -> None:
    said = f"import sys; {work}; print(sorted(set(sys.modules) & {without}))"
    place = small_case if work == NEAR else ROOT
    done = subprocess.run([sys.executable, "-c", said], capture_output=True, text=True, check=True, cwd=place)
    assert done.stdout == "[]\n"


def test_a_run_on_fakes_is_read_fitted_and_compared(virtual_lab: VirtualLab, tmp_path: Path) -> None:
    with lab.open_rig(virtual_lab.rig, needs=("pressure", "spine", "valve", "gauge", "mocap")) as rig:
        assert "arm" not in rig.identities
        settle = {"min_samples": 3, "still_distance": 5e-3, "max_hidden": 5.0, "max_gap": 10.0, "within": 300.0}
        file = lab.run(rig, "bending", out=tmp_path, spine_lengths=[0.05], pressures=[60e3, 120e3], settle=settle)
    plant = virtual_lab.fakes.plant
    assert float(max(plant.chamber_pressure)) < 5e3 and not plant.valve_on
    recording = lab.read(file)
    assert recording.outcome == "completed" and len(recording.stream("/tip"))
    case = lab.case(file)
    assert case.table["x"].shape == (5,) and case.robot == lab.load_robot(paper_robot())
    fitted = lab.fit(case)
    assert fitted.area_factor is not None
    gap = lab.compare(lab.Case(fitted.robot, case.table))
    assert gap.predicted.shape == gap.measured.shape == (5, 3)


def test_what_a_notebook_shows_is_short_and_a_table_becomes_a_data_frame(small_case: Path) -> None:
    case = lab.case(small_case)
    fitted, robot = lab.fit(case, "chamber_azimuth"), case.robot
    found = fitted.robot.predict(case.table.pressures, intervals=True)
    assert np.array_equal(np.asarray(found), found.tip) and len([*found]) == 14 and found[:, 2].shape == (14,)
    reached = robot.inverse([[-0.05, float("nan"), float("nan")]], spine_length=0.1)
    few = {effect: SOME[effect] for effect in ("chamber_azimuth", "base_tilt")}
    answer = lab.diagnose(case, Options(quantify=False, experiments=False, catalogue=few))
    shown = [(case, "x [m]"), (lab.compare(case), "measured x [mm]"), (lab.fit(case), "unit"), (fitted, "unit"), (robot, "unit"),
             (found, "sd of a reading of z [mm]"), (reached, "p9 [kPa]"), (answer, "probability")]  # fmt: skip
    for result, heading in shown:
        assert heading in result.to_frame().columns and "<table" in result._repr_html_()
        assert len(repr(result).splitlines()) == 1 and len(repr(result)) < 1500
    assert "14 states in 2 bending trials, spine 0 to 20 cm; t, hold [s]; rate [Pa/s]; spine_length, x, y, z" in repr(case)
    assert "p8, p9 [Pa]" in repr(case) and "mm rms (in-sample)" in repr(lab.compare(case))
    offered = {name for name in dir(robot) if not name.startswith("_")}
    assert {"predict", "inverse", "replace", "length", "to_frame"} <= offered and not offered & set(dir(BaseModel))
    assert repr(robot).startswith(f"<Robot: {robot.name}, 400 mm, 9 chambers")
    frame = case.table.to_frame()
    assert list(frame.columns) == list(case.table.columns) and len(frame) == 14
    assert frame.attrs["units"]["p1"] == "Pa" and case.table.units["x"] == "m"


def test_version_and_schemas(cli: Cli) -> None:
    assert re.match(r"softlab [0-9.]+", cli("--version").out)
    robot = cli("schema", "robot").json
    assert {"type": "string"} in robot["properties"]["length"]["anyOf"]  # 40 cm
    assert {"effects", "tolerances", "posterior"} <= set(robot["properties"])
    assert {"Stated", "Posterior", "Noise"} <= set(robot["$defs"])
    campaign = {"campaign", "protocols", "blocks", "seed", "hands", "warm_up", "stop"}
    assert campaign <= set(cli("schema", "campaign").json["properties"])
    assert "alicat" in cli("schema", "rig").out
    assert cli("schema", "bending").json["properties"]["protocol"] == {"const": "bending"}
    cli("schema", "bendin", code=2)


# ------------------------------------------------------------------ help
VERBS = [verb for group in GROUPS.values() for verb in group]
LISTS_AND_DESCRIBES = """
import sys
from lab.cli import main

main(["help"])
main(["recovr"])
print([m for m in sys.modules if m.startswith(("lab.verbs", "numpy", "pydantic", "drivers"))])
code = main(["info", sys.argv[1]])
print(code, [m for m in sys.modules if m.split(".")[0] in ("drivers", "numba", "scipy", "pymodbus")])
"""


def test_verbs_are_listed_without_their_modules_and_a_recording_is_described_without_drivers_and_kernels() -> None:
    command = [sys.executable, "-c", LISTS_AND_DESCRIBES, RECORDING]
    done = subprocess.run(command, capture_output=True, text=True, check=True).stdout.splitlines()
    assert "[]" in done and done[-1] == "0 []"


def test_the_verbs_are_listed_in_groups(cli: Cli) -> None:
    told = cli("help").out
    assert told == cli("--help").out == cli(code=2).out
    places = [told.index(f"\n{title}:\n") for title in GROUPS]
    assert places == sorted(places) and "\n  recover " in told[places[2] : places[3]]
    assert [line.split()[0] for line in told.splitlines() if line.startswith("  ")] == VERBS


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["recovr", "a.mcap"], "lab recovr: is not a verb; did you mean recover?"),
        (["xyzzy"], "lab xyzzy: is not a verb; lab help lists the verbs"),
        (["help", "exprt"], "lab exprt: is not a verb; did you mean export?"),
        (["watch", "a.mcap", "--sped", "5"], "lab watch --sped: is not an option; did you mean --speed?"),
        (["watch", "a.mcap", "--sped=5"], "lab watch --sped: is not an option; did you mean --speed?"),
        (["run", "-rig", "rig.yaml"], "lab run -rig: is not an option; did you mean --rig?"),
        (["safe", "--al"], "lab safe --al: is not an option; did you mean --all?"),
        (["fakes", "--replace"], "lab fakes --replace: is not an option; lab fakes --help lists the options"),
        (["safe", "--xyzzy"], "lab safe --xyzzy: is not an option; lab safe --help lists the options"),
    ],
)
def test_an_unknown_verb_or_option_is_answered_with_the_nearest(words: list[str], said: str, cli: Cli) -> None:
    told = cli(*words, code=2).err
    assert told.startswith(said) and len(told.splitlines()) == 1


def test_a_value_without_its_quotes_is_told(cli: Cli) -> None:
    told = cli("plan", "bending", "--set", "rate=20", "kPa/s", code=2).err
    assert "unrecognized arguments: kPa/s; quote a value with spaces: --set 'rate=20 kPa/s'" in told
    assert cli("--sped", "plan", "bending", code=2).err.endswith("unrecognized arguments: --sped\n")
    assert cli("verify", "a.mcap", "b.mcap", code=2).err.endswith("arguments: b.mcap; lab verify takes one file\n")
    assert "value with spaces: --length '9 cm'\n" in cli("init", "--tendons", 4, "--length", 9, "cm", code=2).err


@pytest.mark.parametrize(("verb", "speed"), [("fakes", 0), ("fakes", -3), ("demo", 201)])
def test_a_clock_speed_that_no_rig_can_have_is_refused(verb: str, speed: float, cli: Cli) -> None:
    assert cli(verb, "--speed", speed, code=2).err == f"--speed {speed}: must be 0.1 to 200, times real time\n"


@pytest.mark.parametrize("words", [["--", "--sped"], ["--help", "--sped"]])
def test_what_follows_two_dashes_or_asks_for_help_is_no_unknown_option(words: list[str]) -> None:
    assert declared("watch").unknown_option(["a.mcap", *words]) == ""


def test_the_table_and_the_modules_name_the_same_verbs() -> None:
    modules = {f"lab.{module}" for group in GROUPS.values() for module, _ in group.values()}
    assert sorted(verb.name for module in modules for verb in import_module(module).VERBS) == sorted(VERBS)


@pytest.mark.parametrize("verb", VERBS)
def test_the_help_of_a_verb_ends_with_examples_that_parse_and_a_page_that_exists(verb: str, cli: Cli) -> None:
    told = cli("help", verb).out
    assert "%%" not in told and " --reference A" not in told
    *_, first, second, empty, page = told.splitlines()
    text = (ROOT / page.removeprefix("page: ")).read_text(encoding="utf-8")
    assert not empty and re.search(rf"(lab|make)\s+{verb}\b", text)
    for line in (first, second):
        program, *words = shlex.split(line.partition(" > ")[0])
        assert program == "lab" and words[0] == verb
        assert words[-1] == "--help" or parser().parse_args(words).verb == verb


def test_what_reads_recordings_can_be_told_to_read_those_of_any_size(cli: Cli) -> None:
    readers = [verb for verb in VERBS if re.search(r"(FILE|INPUT|CASE) \[|FILE\||^  file$", cli("help", verb).out, re.M)]
    assert {"power", "diagnose", "verify", "watch"} <= set(readers)
    assert [verb for verb in readers if "--any-size" not in cli("help", verb).out] == []


def test_files_have_names_in_the_usage(cli: Cli) -> None:
    told = cli("fit", "--help").out
    assert "--robot ROBOT.yaml" in told and "--out FOLDER" in told and "INPUT [INPUT ...]" in told


# ------------------------------------------------------------------ completion
ASK = """
source {script}
COMP_WORDS=({line}); COMP_CWORD=$(( ${{#COMP_WORDS[@]}} - 1 )); COMPREPLY=()
_shtab_lab lab "{word}"
printf '%s\\n' "${{COMPREPLY[@]}}"
"""


@pytest.fixture(scope="module")
def script(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("completion") / "lab.bash"
    with path.open("w") as file, contextlib.redirect_stdout(file):
        assert main(["completion", "bash"]) == 0
    (path.parent / "beam.yaml").touch()
    (path.parent / "beside.txt").touch()
    return path


@pytest.mark.parametrize(
    ("line", "offered"),
    [
        ("lab diag", {"diagnose"}),
        ("lab run be", {"beam.yaml", "beside.txt"}),
        ("lab run --res", {"--resume"}),
        ("lab fit --with spine_sl", {"spine_slip"}),
        ("lab fakes --effect vacuum_l", {"vacuum_leak"}),
    ],
)
def test_bash_completes(script: Path, line: str, offered: set[str]) -> None:
    ask = ASK.format(script=script, line=line, word=line.rpartition(" ")[2])
    done = subprocess.run(["bash", "-c", ask], cwd=script.parent, capture_output=True, text=True, check=True)
    assert set(done.stdout.split()) == offered, done.stderr


def test_zsh_gets_a_completion_that_it_can_read(tmp_path: Path, cli: Cli) -> None:
    said = cli("completion", "zsh").out
    assert said.startswith("#compdef lab") and "_files" in said
    if zsh := shutil.which("zsh"):
        (tmp_path / "_lab").write_text(said)
        subprocess.run([zsh, "-n", tmp_path / "_lab"], check=True)


# ------------------------------------------------------------------ neighbours
COMMAND, FRONT_DOOR = ("-m", "lab.cli", "schema", "robot"), ("-c", "import lab; lab.load_robot")


@pytest.mark.parametrize(
    ("words", "first"),
    [
        (FRONT_DOOR, "model/__init__.py"), (COMMAND, "model/__init__.py"), (COMMAND, "model/data.csv"), (COMMAND, "model.py"),
        (COMMAND, "timing.py"), (FRONT_DOOR, "timing.py"),
    ],
    ids=["import lab", "a package", "a folder of data", "a module", "timing", "timing at import lab"],
)  # fmt: skip
def test_another_package_of_the_same_name_on_the_path_is_named(tmp_path: Path, words: tuple[str, ...], first: str) -> None:
    (tmp_path / first).parent.mkdir(exist_ok=True)
    (tmp_path / first).write_text("")
    name = first.partition("/")[0].partition(".")[0]
    env = {**os.environ, "PYTHONPATH": str(tmp_path)}
    done = subprocess.run([sys.executable, *words], cwd="/", env=env, capture_output=True, text=True, timeout=600)
    told = " ".join(done.stderr.split())
    assert done.returncode == (1 if "-c" in words else 2), told
    assert f"another package called {name}, {tmp_path}/{name}" in told and "an environment of its own" in told


def test_a_package_that_was_written_over_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    assert strangers() == ""
    monkeypatch.setattr(lab.version, "_written", lambda: {"model": "another digest"})
    assert "another package has written into" in strangers() and "model" in strangers()


# ------------------------------------------------------------------ without the instruments' libraries
LIBRARIES = ("rtde_control", "rtde_receive", "serial", "pymodbus", "dynamixel_sdk", "pytrinamic", "pfeiffer_vacuum_protocol")


def test_all_but_the_rig_works_and_a_rig_says_what_to_install(tmp_path: Path) -> None:
    case, rig, landed = tmp_path / "case", ("--rig", ROOT / "examples/rig/rig.yaml"), tmp_path / "rig.yaml"
    shutil.copy(ROOT / "examples/rig/rig.yaml", landed)  # beside no robot.yaml: a landing needs none
    robot = ("--robot", paper_robot())  # the recording's own is one of a test
    works = (
        ("info", RECORDING), ("replay", RECORDING), ("verify", RECORDING), ("export", RECORDING, "--case", "--out", case),
        ("schema", "robot"), ("compare", case, *robot),
    )  # fmt: skip
    refused = (("plan", "bending", *rig), ("check", *rig), ("demo", "--out", tmp_path / "demo"))
    others = (("safe", "--rig", landed), ("fakes", "--unit", "torr"))
    done = run_there((*works, *refused, *others), lacking=LIBRARIES)  # a computer without these libraries
    assert not [each for each in done if "Traceback" in each.err]
    for each in done[: len(works)]:
        assert each.returncode in (0, 3), each.out + each.err
    assert "Measured against model" in done[len(works) - 1].out
    for each in done[len(works) : -2]:
        assert each.returncode == 2 and "the instruments' libraries are not installed" in each.err
        assert "pip install 'softlab[rig]'" in each.err
    safe, fakes = done[-2:]
    assert safe.returncode == 1 and "make it safe by hand" in safe.flat_out
    assert all(f"{name}: NOT CONFIRMED" in safe.out for name in ("arm", "pressure", "spine", "valve"))
    assert landed.with_suffix(".latch").exists()
    assert fakes.returncode == 2 and "must be one of Pa, hPa, kPa, MPa, mbar, bar, psi" in fakes.err
    assert tuple(WIRE) == UNITS
