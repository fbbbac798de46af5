"""`lab safe` while a run is going: its guard lands the rig at once and for good, whatever became of the rig's files."""

import contextlib
import json
import os
import shutil
import signal
import socket
import stat
import subprocess
import sys
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

import pytest
import yaml
from house import House, until

import timing
from drivers.interfaces import PressureRegulators
from lab.cli import main
from lab.files.rig_file import load_rig
from lab.guard import door, last_used
from lab.guard.commands import Command
from lab.guard.door import Door, LandingAnswer, Owner, demand_free, land, names_of_path, owners
from lab.guard.guard import Guard
from lab.guard.instruments import exclusive
from lab.guard.last_used import forget, recall
from lab.guard.latch import Latch, RigLocked
from lab.guard.messages import RigLanded, SafeReport, SafeStep
from tests.simulated.bench import raises
from timing import RigClock

REPORT = SafeReport((SafeStep("pressure", True, "highest pressure 0.1 kPa"), SafeStep("arm", False, "moving")))


class Lander:
    """A guard as its door sees it."""

    def __init__(self) -> None:
        self.ending = False
        self.asked: list[str] = []

    def hand_over(self, by: str) -> SafeReport:
        self.asked.append(by)
        return REPORT

    def locked(self) -> str:
        return "the arm moves"


@pytest.fixture(autouse=True)
def own_prefix(monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest) -> None:
    """Tests of the door alone see no guards of other tests."""
    if "house" not in request.fixturenames:
        monkeypatch.setattr(door, "PREFIX", f"softlab-test/{os.getpid()}/")


# ------------------------------------------------------------------ the door
@contextlib.contextmanager
def open_door(names: Sequence[str], *about: str) -> Iterator[tuple[Door, Lander]]:
    """A door and the guard behind it."""
    lander = Lander()
    opened = Door(names, lander, *about)
    opened.open()
    yield opened, lander
    opened.close()


def test_an_owner_says_who_it_is_and_lands_when_asked() -> None:
    with open_door(["a", "b"], "/lab/rig.yaml", "lab run bending") as (_, lander):
        (owner,) = owners(["b", "c"])
        assert (owner.rig, owner.about, owner.pid) == ("/lab/rig.yaml", "lab run bending", os.getpid())
        assert owner.names == {"a", "b"} and owners() == [owner]
        assert land(["a"]).answers == {owner: LandingAnswer(REPORT, "the arm moves")}
        assert len(lander.asked) == 1 and f"process {os.getpid()}" in lander.asked[0]
    assert owners(["a", "b"]) == [] and owners() == []


def test_a_name_has_one_owner_and_who_comes_second_is_refused_at_once_by_name() -> None:
    second = Door(["b", "c"], Lander())
    with open_door(["a", "b"], "", "lab run bending"):
        raises(RigLocked, "in use: lab run bending", second.open, within=3600)
        raises(RigLocked, "in use: lab run bending", demand_free, ["b"])
    second.open()
    second.close()


def test_who_comes_while_the_owner_is_ending_waits_for_its_end() -> None:
    second = Door(["a"], Lander())
    with open_door(["a"]) as (_, lander):
        lander.ending = True
        demand_free(["a"])
        raises(RigLocked, "still landing", second.open, within=0.1)
    second.open(within=60)
    second.close()


@pytest.mark.parametrize("question", [b"", b"{", b'["land"]\n', b'{"do": "dance"}\n', b"[" * 200_000, b"\xff\x00\n"])
def test_a_question_that_is_none_lands_nothing_and_hurts_nobody(question: bytes) -> None:
    with open_door(["a"]) as (_, lander):
        with socket.socket(socket.AF_UNIX) as connection:
            connection.connect(door._address("a"))
            with contextlib.suppress(OSError):  # it stops reading when it has had enough
                connection.sendall(question)
        assert len(owners(["a"])) == 1 and lander.asked == []


def test_one_that_owns_a_name_and_stands_still_is_known_as_silent(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(door, "WHO_WITHIN", 0.1)
    frozen = door._bound("a")
    assert frozen is not None
    with frozen:
        (owner,) = land(["a"]).silent
        assert owner == Owner("", os.getpid(), owner.user)
        raises(RigLocked, "does not answer", demand_free, ["a"])


def test_a_full_queue_is_not_taken_for_nobody(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(door, "WHO_WITHIN", 0.1)
    with socket.socket(socket.AF_UNIX) as frozen, contextlib.ExitStack() as crowd:
        frozen.bind(door._address("a"))
        frozen.listen(1)
        with contextlib.suppress(BlockingIOError):
            while True:
                one = crowd.enter_context(socket.socket(socket.AF_UNIX))
                one.setblocking(False)
                one.connect(door._address("a"))
        (owner,) = land(["a"]).doubtful
        assert "cannot be asked" in str(owner) and owner.pid == 0
        raises(RigLocked, "cannot be asked", demand_free, ["a"])


def test_many_who_say_nothing_hold_up_nobody() -> None:
    with open_door(["a"]) as (_, lander), contextlib.ExitStack() as crowd:
        for _ in range(300):
            crowd.enter_context(socket.socket(socket.AF_UNIX)).connect(door._address("a"))
        assert len(land(["a"]).answered) == 1 and len(lander.asked) == 1


def test_all_who_ask_while_it_lands_get_the_answer_of_one_landing() -> None:
    names, going = [f"{number}" for number in range(40)], timing.Event()
    with open_door(names) as (opened, lander):
        lander.hand_over = lambda by: (lander.asked.append(by), going.wait(), REPORT)[-1]  # type: ignore[method-assign]
        timing.Thread(target=lambda: until(lambda: len(opened._landing or []) == 40) and going.set()).start()
        assert [answer for _, answer in land(names).answered] == [LandingAnswer(REPORT, "the arm moves")]
        assert len(lander.asked) == 1


def test_an_answer_that_never_ends_is_no_answer(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(door, "WHO_WITHIN", 0.3)
    listening = door._bound("a")
    assert listening is not None

    def drip() -> None:
        with contextlib.suppress(OSError), listening.accept()[0] as connection:
            while True:
                connection.sendall(b" ")
                timing.sleep(0.01)

    timing.Thread(target=drip).start()
    with listening:
        assert len(land(["a"]).silent) == 1


# ------------------------------------------------------------------ the door next to rig.yaml
def test_a_guard_out_of_reach_of_its_names_is_asked_next_to_rig_yaml(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / ("long" * 40)
    folder.mkdir()
    rig = folder / "rig.yaml"
    second = Door(names_of_path(rig), Lander(), str(rig), "lab run bending")
    with open_door(names_of_path(rig), str(rig), "lab run bending"):
        # as in another network name space, no abstract name of before is in reach from here on
        monkeypatch.setattr(door, "PREFIX", f"{door.PREFIX}elsewhere/")
        assert stat.S_IMODE((folder / "rig.yaml.sock").stat().st_mode) == 0o600
        assert [answer for _, answer in land(names_of_path(rig), rig).answered] == [LandingAnswer(REPORT, "the arm moves")]
        raises(RigLocked, "in use: lab run bending", second.open, within=3600)
    assert list(folder.iterdir()) == []
    second.open()
    second.close()


def test_a_socket_that_a_crash_left_is_replaced_and_a_file_of_that_name_is_no_obstacle(tmp_path: Path) -> None:
    rig = tmp_path / "rig.yaml"
    with socket.socket(socket.AF_UNIX) as left:
        left.bind(str(tmp_path / "rig.yaml.sock"))
    assert owners(names_of_path(rig), rig) == []
    for _ in range(2):
        with open_door(names_of_path(rig), str(rig)):
            assert len(land(names_of_path(rig), rig).answered) == 1
        (tmp_path / "rig.yaml.sock").write_text("no socket")


# ------------------------------------------------------------------ other accounts
STRANGER = """
import contextlib, json, math, os, resource, socket, sys, timing
resource.setrlimit(resource.RLIMIT_NOFILE, (resource.getrlimit(resource.RLIMIT_NOFILE)[1],) * 2)
os.setgroups([])
os.setuid(65534)
kind, *addresses = sys.argv[1:]
kept, listening = [], []
for address in addresses * (2000 if kind == "crowd" else 1):
    one = socket.socket(socket.AF_UNIX)
    kept.append(one)
    if kind == "crowd":
        one.connect("\\0" + address)
    else:
        one.bind("\\0" + address)
        one.listen(100)
        listening.append(one)
print("ready", flush=True)
while True:
    for one in timing.readable(listening, math.inf):
        kept.append(one.accept()[0])
        if kind != "silent":
            with contextlib.suppress(OSError):  # who asked may have gone
                kept[-1].recv(1000)
                step = {"instrument": "pressure", "confirmed": True, "text": "highest pressure 0.0 kPa"}
                for line in ({"guard": "me", "names": json.loads(kind)}, {"steps": [step], "locked": ""}):
                    kept[-1].sendall(json.dumps(line).encode() + b"\\n")
"""
as_root = pytest.mark.skipif(os.getuid() != 0, reason="only root can become another user")


@contextlib.contextmanager
def stranger(kind: str, names: Iterable[str]) -> Iterator[subprocess.Popen[str]]:
    """A process of another account at these names: a "crowd", "silent", or the JSON of names that it claims to own."""
    addresses = [door._address(name)[1:] for name in names]
    with subprocess.Popen([sys.executable, "-c", STRANGER, kind, *addresses], stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None and process.stdout.readline() == "ready\n"
            yield process
            assert process.poll() is None  # nobody has ended it
        finally:
            process.kill()


@as_root
def test_a_crowd_of_another_account_holds_up_nobody_and_may_ask_all_the_same(tmp_path: Path) -> None:
    rig = tmp_path / "rig.yaml"
    with open_door(names_of_path(rig), str(rig)) as (opened, lander):
        with stranger("crowd", names_of_path(rig)):
            assert until(lambda: len(opened._asking) <= door.MOST_STRANGERS)
            assert len(land(names_of_path(rig), rig).answered) == 1 and lander.asked
        asked = "import sys; from lab.guard import door; door.PREFIX = sys.argv[1]; import os; os.setuid(65534)"
        command = [sys.executable, "-c", f"{asked}; door.land(sys.argv[2:])", door.PREFIX, *names_of_path(rig)]
        subprocess.run(command, check=True)
        assert until(lambda: "lab safe, by nobody" in lander.asked[-1])


@as_root
@pytest.mark.parametrize("kind", ["silent", '["a", "b"]'])
def test_the_word_of_another_account_is_not_believed_and_it_is_not_ended(kind: str, tmp_path: Path) -> None:
    rig = tmp_path / "rig.yaml"
    with stranger(kind, ["a"]) as process:
        found = land(["a"], rig)
        assert (found.answered, found.silent, found.names_for(rig)) == ([], [], frozenset())
        (owner,) = found.doubtful
        assert (owner.pid, owner.uid) == (process.pid, 65534) and "are believed" in str(owner)
        raises(RigLocked, f"process {process.pid} of user nobody", Door(["a"], Lander(), str(rig)).open)


@as_root
def test_the_owner_of_the_folder_is_believed_about_its_own_rig_alone(tmp_path: Path) -> None:
    tmp_path.chmod(0o711)
    theirs = tmp_path / "theirs"
    theirs.mkdir()
    os.chown(theirs, 65534, 65534)
    with stranger('["a", "b"]', ["a"]):
        rig, own = theirs / "rig.yaml", tmp_path / "rig.yaml"
        assert land(["a"], rig).names_for(rig) == {"a", "b"}
        assert land(["a"], own).names_for(own) == frozenset()
        assert land().names_for(own) == frozenset()


# ------------------------------------------------------------------ a run that is going
def test_a_rig_that_is_used_lands_at_once_and_for_good(small: House, capsys: pytest.CaptureFixture[str]) -> None:
    with small.opened(inflated=True) as rig:
        assert main(["safe", "--json", "--rig", str(small.rig)]) == 0
        told = json.loads(capsys.readouterr().out)
        assert told["confirmed"] and {s["instrument"] for s in told["steps"]} == {"pressure", "spine", "valve"}
        assert small.highest() < 5e3 and not small.fakes.plant.valve_on
        assert until(lambda: rig.vital.landed is not None, 30.0)
        assert rig.vital.landed is not None and "requested by lab safe" in rig.vital.landed.text
        raises(RigLanded, "requested by lab safe", rig.actuators.pressure.set, (20e3, 20e3, 20e3))
        raises(RigLanded, "requested by lab safe", rig.actuators.resume)
    assert not small.latch.exists()


def test_a_second_program_is_refused_at_once_and_told_of_the_first(
    house: House, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    house.change(without=("arm", "force"))
    other = tmp_path / "other.yaml"  # another file for the same instruments
    shutil.copy(house.rig, other)
    shutil.copy(house.rig.with_name("robot.yaml"), tmp_path)
    with house.opened() as rig:
        for words in (["check", "--move", "--yes"], ["check"], ["run", "bending", "--out", str(tmp_path)]):
            for path in (house.rig, other):
                assert main([*words, "--rig", str(path)]) == 1
                assert f"process {os.getpid()}" in " ".join(capsys.readouterr().err.split())
        rig.actuators.pressure.set((0.0, 0.0, 0.0))


# ------------------------------------------------------------------ on a bad day
def spoilt(day: str, rig: Path) -> Path:
    """The rig's files after a bad day; where its rig.yaml is by then."""
    match day:
        case "log deleted":
            rig.with_suffix(".guard.log").unlink(missing_ok=True)
        case "wrong table":
            rig.write_text(rig.read_text().replace("max_pressure", "max_presure").replace("heartbeat", "hartbeat"))
        case "not text":
            rig.write_bytes(b"\xff\x00\xfe")
        case "gone":
            rig.unlink()
        case "folder moved":
            return rig.parent.rename(rig.parent.with_name("moved")) / rig.name
        case "by link" | "by linked folder":
            what, link = (rig, "link.yaml") if day == "by link" else (rig.parent, "linked")
            rig.parent.with_name(link).symlink_to(what)
            return rig.parent.with_name(link) / (rig.name if what != rig else "")
        case "folder read-only":  # for root, too: where a file should be stands a folder, so that nothing can be created
            for name in ("rig.latch", "rig.guard.log"):
                rig.with_name(name).unlink(missing_ok=True)
                rig.with_name(name).mkdir()
    return rig


READ_ONLY, MOVED = "folder read-only", "folder moved"
BAD_DAYS = ("log deleted", "wrong table", "not text", "gone", MOVED, "by link", "by linked folder", READ_ONLY)


@pytest.fixture
def own_folder(small: House, tmp_path: Path) -> Iterator[House]:
    """The house with its rig.yaml in a folder of its own, whose files may be spoilt."""
    folder = tmp_path / "rig"
    folder.mkdir()
    for name in ("rig.yaml", "robot.yaml"):
        shutil.copy(small.rig.with_name(name), folder)
    yield House(small.fakes, folder / "rig.yaml")
    if (left := recall(folder / "rig.yaml")) is not None:
        forget(left)


@pytest.mark.parametrize("day", BAD_DAYS)
def test_a_live_run_is_landed(own_folder: House, day: str) -> None:
    with own_folder.opened(inflated=True):
        place = spoilt(day, own_folder.rig)
        code = main(["safe", "--rig", str(place)])
        assert own_folder.highest() < 5e3 and not own_folder.fakes.plant.valve_on
        assert code == (1 if day in (READ_ONLY, MOVED) else 0)  # a latch stays behind


def test_what_no_driver_reaches_is_not_confirmed_by_the_guard_of_another_rig_on_the_same_lines(
    own_folder: House, capsys: pytest.CaptureFixture[str]
) -> None:
    text = own_folder.rig.read_text()
    assert "driver: alicat" in text
    other = own_folder.rig.with_name("other.yaml")
    other.write_text(text.replace("driver: alicat", "driver: nobodys"))
    with own_folder.opened():
        assert main(["safe", "--rig", str(other), "--json"]) == 1
    assert any("nobodys" in step["text"] for step in json.loads(capsys.readouterr().out)["steps"])


CRASHING = """
import os, signal, sys
from pathlib import Path
from lab.files.rig_file import load_rig
from lab.rig.assembly import Rig
rig = Rig(load_rig(Path(sys.argv[1])))
assert rig.open_all(str) == {}
rig.actuators.valve.set(True)
rig.actuators.pressure.set((20e3, 20e3, 20e3))
os.kill(rig.actuators._process.pid, signal.SIGKILL)
os.kill(os.getpid(), signal.SIGKILL)
"""


@pytest.mark.real
@pytest.mark.parametrize(
    "day", [d if d in ("gone", MOVED, READ_ONLY) else pytest.param(d, marks=pytest.mark.long) for d in BAD_DAYS]
)
def test_what_a_crash_left_behind_is_landed(own_folder: House, day: str) -> None:
    done = subprocess.run([sys.executable, "-c", CRASHING, str(own_folder.rig)], check=False)
    assert done.returncode == -signal.SIGKILL and until(lambda: own_folder.highest() > 10e3)
    place = spoilt(day, own_folder.rig)
    if day == MOVED:
        own_folder = House(own_folder.fakes, place)
    code = main(["safe", "--clear", "--rig", str(place)])
    assert own_folder.highest() < 5e3 and not own_folder.fakes.plant.valve_on
    locked = day == READ_ONLY
    assert code == (1 if locked else 0) and (Latch(place).read() is not None) is locked


def test_all_rigs_are_landed_that_are_in_use_or_were_left_unsafe(
    own_folder: House, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(door, "PREFIX", f"softlab-test-all/{os.getpid()}/")
    monkeypatch.setattr(last_used, "FOLDER", tmp_path)
    assert main(["safe", "--all"]) == 0 and "No rig" in capsys.readouterr().out
    rig = load_rig(own_folder.rig)
    guard = Guard(rig, RigClock(rig.clock.speed))
    guard.take_over()
    guard.open("pressure")
    assert until(lambda: max(guard.do(Command("pressure", PressureRegulators.set, ((20e3,) * 3,)))) > 19e3)  # at max_rate
    assert until(lambda: own_folder.highest() > 10e3)
    assert main(["safe", "--all"]) == 0
    assert own_folder.highest() < 5e3 and str(own_folder.rig) in capsys.readouterr().out.replace("\n", "")
    guard.close()
    last_used.remember(rig)  # as a guard leaves it that was killed
    assert main(["safe", "--all", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)["rigs"]
    assert list(told) == [str(own_folder.rig)] and told[str(own_folder.rig)]["confirmed"]


ANOTHER_USER = """
import os, sys
from lab import cli
from lab.files.rig_file import found_drivers
import lab.console, lab.guard.latch, lab.guard.new_guard, lab.rig.interrupts, lab.rig.real_time, lab.verbs.safe
import serial, rich.text, getpass, concurrent.futures.thread, multiprocessing.connection
found_drivers()
os.setgroups([])
os.setuid(65534)
sys.exit(cli.main(["safe", "--rig", sys.argv[1]]))
"""


@pytest.mark.real
@pytest.mark.skipif(os.getuid() != 0, reason="only root can become another user")
@pytest.mark.parametrize("crashed", [False, True], ids=["a live run", "after a crash"])
def test_another_user_may_land_a_rig_whose_folder_is_closed_to_them(own_folder: House, crashed: bool) -> None:
    """After a crash the lines must be theirs to use, as the group dialout makes them."""
    fakes = own_folder.fakes
    with contextlib.ExitStack() as alive:
        if crashed:
            subprocess.run([sys.executable, "-c", CRASHING, str(own_folder.rig)], check=False)
        else:
            alive.enter_context(own_folder.opened(inflated=True))
        assert until(lambda: own_folder.highest() > 10e3)
        own_folder.rig.parent.chmod(0o700)
        for table in yaml.safe_load(own_folder.rig.read_text())["instruments"].values():
            os.chmod(os.path.realpath(table["port"]), 0o666 if crashed else 0o600)
        command = [sys.executable, "-c", ANOTHER_USER, str(own_folder.rig)]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert own_folder.highest() < 5e3 and not fakes.plant.valve_on, done.stdout + done.stderr
        assert "Traceback" not in done.stderr and done.returncode == (1 if crashed else 0)


@pytest.mark.real
@as_root
def test_what_a_crash_left_behind_is_landed_though_another_account_says_that_it_was(
    own_folder: House, capsys: pytest.CaptureFixture[str]
) -> None:
    subprocess.run([sys.executable, "-c", CRASHING, str(own_folder.rig)], check=False)
    assert until(lambda: own_folder.highest() > 10e3)
    names = names_of_path(own_folder.rig)
    with stranger(json.dumps(sorted(names)), names):
        assert main(["safe", "--rig", str(own_folder.rig)]) == 1
        assert own_folder.highest() < 5e3 and not own_folder.fakes.plant.valve_on
    said = " ".join(capsys.readouterr().err.split())
    assert "of user nobody (only root" in said and "read from the instruments alone" in said


def test_names_of_a_path_are_those_of_what_it_leads_to(tmp_path: Path) -> None:
    (tmp_path / "link.yaml").symlink_to(tmp_path / "rig.yaml")
    assert names_of_path(tmp_path / "rig.yaml") < names_of_path(tmp_path / "link.yaml")


def test_names_of_an_instrument_are_those_of_what_its_address_leads_to(house: House, tmp_path: Path) -> None:

    def names(instrument: str, **table: str) -> frozenset[str]:
        rig = load_rig(house.rig)
        config = getattr(rig.instruments, instrument).model_copy(update=table)
        return exclusive(rig.model_copy(update={"instruments": rig.instruments.model_copy(update={instrument: config})}))[
            instrument
        ]

    arm = names("arm", host="127.0.0.1")
    for spelling in ("localhost", "LOCALHOST.", "127.1", "127.0.0.1 ", "::ffff:127.0.0.1", "0x7f.0.0.1", "0.0.0.0"):
        assert arm & names("arm", host=spelling), spelling
    assert not arm & names("arm", host="127.0.0.2") and not arm & names("arm", host="127.0.0.11")
    box = names("gauge", port="socket://127.0.0.1:4001")
    for spelling in ("socket://localhost:4001", "RFC2217://127.1:4001?ign_set_control", "socket://[::ffff:127.0.0.1]:4001 "):
        assert box & names("gauge", port=spelling), spelling
    assert not box & names("gauge", port="socket://127.0.0.1:4002")
    (tmp_path / "link").symlink_to("/dev/null")
    device = names("gauge", port="/dev/null")
    assert device & names("gauge", port=str(tmp_path / "link")) and not device & names("gauge", port="/dev/zero")
