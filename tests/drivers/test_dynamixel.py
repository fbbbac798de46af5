"""What is particular to the Dynamixel length unit, through dynamixel-sdk against the fake servo."""

from functools import partial

import pytest

import timing
from drivers.dynamixel.bus import Register
from drivers.dynamixel.driver import Config, DynamixelSpine
from drivers.dynamixel.table import PRESENT_POSITION
from drivers.errors import BadReply, DeviceFault, NotReady, Unreachable, WrongDevice
from sim_fakes.dynamixel import DynamixelFake
from sim_fakes.plant import Plant
from tests.drivers.spines import Make, arrive, fault_of, homed, make_pair, under_way, watch
from tests.simulated.bench import Bench, raises, wait_until

TORQUE, WATCHDOG, MODE, GOAL = 64, 98, 11, 116


@pytest.fixture
def make(bench: Bench) -> Make:
    return partial(make_pair, bench, "dynamixel")


def bitten(servo: DynamixelFake) -> None:
    """Wait until the servo's watchdog has bitten."""
    wait_until(lambda: servo.motor.table[WATCHDOG] == 0xFF)


@pytest.mark.parametrize(("mode", "torque"), [(3, 0), (5, 1)])
def test_open_names_the_model_and_drops_the_torque_only_to_change_the_mode(make: Make, mode: int, torque: int) -> None:
    spine, servo = make()
    servo.motor.put(MODE, mode)
    servo.motor.put(TORQUE, 1)
    identity = spine.open()
    assert (identity.model, identity.firmware) == ("XM430-W350", "45")
    assert (servo.motor.get(MODE), servo.motor.get(TORQUE)) == (5, torque)


def persistent(servo: DynamixelFake, address: int, value: int) -> None:
    """Set a register as an earlier program has left it."""
    servo.motor.put(address, value)
    servo.motor.wrote(address)


@pytest.mark.parametrize(
    ("address", "left", "needed"),
    [(10, 8, 0), (11, 3, 5), (12, 7, 255), (20, 1024, 0), (20, -4096, 0), (60, 3, 0), (63, 0, 52), (63, 1, 53), (68, 0, 2),
     (68, 1, 2), (100, 50, 885), (108, 1, 0)],
)  # fmt: skip
def test_settings_that_an_earlier_program_left_are_written_at_open(make: Make, address: int, left: int, needed: int) -> None:
    spine, servo = make()
    persistent(servo, address, left)
    spine.open()
    assert servo.motor.get(address) == needed
    spine.confirm_settings()
    spine.close()
    persistent(servo, address, left)
    persistent(servo, 64, 1)
    spine.open()
    assert servo.motor.get(address) == needed


@pytest.mark.parametrize(
    ("address", "left", "message"),
    [
        (36, 200, r"PWM limit \(register 36\) is 200, needed 885: .* Wizard"),
        (84, 0, r"position P gain \(register 84\) is 0, needed 1: the motor would not hold; .* Wizard"),
    ],
)
def test_settings_that_only_a_person_may_change_are_refused(make: Make, address: int, left: int, message: str) -> None:
    spine, servo = make()
    servo.motor.put(address, left)
    raises(WrongDevice, message, spine.open)
    assert servo.motor.get(address) == left


def test_a_motion_left_over_ends_also_where_a_setting_is_refused(make: Make) -> None:
    spine, servo = make()
    homed(spine)
    spine.move_to(0.3, 0.02)
    persistent(servo, 36, 200)
    other = DynamixelSpine("spine", Config(port=servo.port, metres_per_turn=0.1, timeout=1.0), servo.clock)
    spine._servo.close()  # the program has died
    raises(WrongDevice, "PWM limit", other.open)
    assert servo.motor.length < 0.25
    assert servo.motor.get(GOAL) == pytest.approx(servo.motor.counts, abs=200)


@pytest.mark.parametrize(("address", "value"), [(12, 3), (20, 100), (63, 4), (100, 80), (84, 0)])
def test_a_setting_that_another_host_changed_is_named_before_a_trial(make: Make, address: int, value: int) -> None:
    spine, servo = make()
    spine.open()
    spine.confirm_settings()
    servo.motor.put(address, value)
    raises(WrongDevice, rf"\(register {address}\) is {value}, needed \d+: .*; ", spine.confirm_settings)


def test_a_watchdog_that_trips_holds_the_cord_whatever_homing_offset_was_left(make: Make) -> None:
    spine, servo = make(watchdog=0.5)
    persistent(servo, 20, 1024)
    homed(spine)
    spine.move_to(0.1, 0.05)
    arrive(spine)
    bitten(servo)
    timing.sleep(0.05)  # one second of the rig, in which a motor that moves comes far
    assert servo.motor.length == pytest.approx(0.1, abs=1e-3)


def test_a_servo_of_protocol_1_is_unreachable_and_its_register_is_named(make: Make) -> None:
    spine, servo = make(timeout=0.05)
    servo.motor.put(13, 1)
    raises(Unreachable, r"protocol \(2\.0, register 13\)", spine.open)


def test_an_answer_of_another_length_with_a_right_checksum_is_told_from_a_broken_cable(make: Make) -> None:
    spine, servo = make(timeout=0.1)
    spine.open()
    content = servo._content
    servo._content = lambda address, size: content(address, size - 1) if size > 20 else content(address, size)
    assert "cable" not in raises(BadReply, "with 37 bytes; check that it is an X servo", spine.read)


def test_positions_that_look_like_a_packet_header_are_read_right(make: Make) -> None:
    spine, servo = make()
    spine.open()
    servo.motor.place(-131073)  # FF FF FD FF on the wire
    assert spine.read().length == pytest.approx(-131073 / 4096 * 0.1)


def test_overload_drops_the_torque_and_homing_restarts_the_servo(make: Make, plant: Plant) -> None:
    spine, servo = make(stall_time=8.0)
    under_way(spine)
    plant.spine_blocked = True
    fault_of(spine, "overload")
    assert servo.motor.get(TORQUE) == 0
    raises(NotReady, "home", spine.move_to, 0.1, 0.02)
    plant.spine_blocked = False
    spine.home()
    assert watch(spine, lambda s: s.homed).length == 0
    assert plant.spine_drive == pytest.approx(0, abs=5e-4)


def test_a_servo_that_fails_while_a_stall_is_answered_says_why(make: Make, plant: Plant) -> None:
    spine, servo = make(current_limit=0.8)
    homed(spine)
    spine.move_to(0.3, 0.02)
    wrote = servo.motor.wrote

    def fails_as_its_torque_goes_off(address: int) -> None:
        wrote(address)
        if address == TORQUE and not servo.motor.get(TORQUE):
            servo.motor.fail(1 << 5)

    servo.motor.wrote = fails_as_its_torque_goes_off  # type: ignore[method-assign]
    plant.spine_blocked = True
    fault_of(spine, "overload")


def test_every_bit_of_a_hardware_error_is_named(make: Make) -> None:
    spine, servo = make()
    spine.open()
    servo.faults.extra["hardware_error"] = 0b100101
    fault_of(spine, "supply voltage, overheated, overload")


def test_a_supply_that_sags_ends_the_motion_although_the_torque_stays_on(make: Make, plant: Plant) -> None:
    spine, servo = make()
    under_way(spine)
    servo.faults.extra["hardware_error"] = 1
    assert "stopped and holds" in fault_of(spine, "supply voltage")
    timing.sleep(0.5)
    stopped = plant.spine_drive
    timing.sleep(0.5)
    assert stopped < 0.2 and plant.spine_drive == stopped and servo.motor.get(TORQUE) == 1


def test_one_reading_that_is_wrong_by_a_turn_is_neither_told_nor_held(make: Make, plant: Plant) -> None:
    spine, servo = make()
    homed(spine)
    servo.faults.extra["glitch"] = 1
    assert spine.read().length == pytest.approx(0.0, abs=1e-3)
    servo.faults.extra["glitch"] = 1
    spine.stop()
    timing.sleep(0.5)
    assert plant.spine_drive == pytest.approx(0.0, abs=1e-3) and servo.motor.get(116) == pytest.approx(servo.motor.counts, abs=3)


def test_a_stop_is_sent_again_when_the_watchdog_bites_on_its_way(make: Make, monkeypatch: pytest.MonkeyPatch) -> None:
    spine, servo = make(watchdog=0.2)
    homed(spine)
    spine.move_to(0.35, 0.02)
    read, held_up = spine._servo.read, []

    def late(register: Register) -> int:
        value = read(register)
        if register == PRESENT_POSITION and not held_up:
            held_up.append(register)
            bitten(servo)
        return value

    monkeypatch.setattr(spine._servo, "read", late)
    spine.stop()
    assert held_up and spine.read().homed


def test_reading_keeps_the_watchdog_quiet(make: Make) -> None:
    spine, servo = make(watchdog=0.6)
    homed(spine)
    end = timing.now() + 0.9
    while timing.now() < end:
        spine.read()
        timing.sleep(0.02)
    assert servo.motor.table[WATCHDOG] == 30


def test_a_jam_met_while_homing_again_is_not_taken_for_the_end_stop(make: Make, plant: Plant) -> None:
    spine, _ = make()
    homed(spine)
    spine.move_to(0.1, 0.05)
    arrive(spine)
    plant.spine_blocked = True
    spine.home()
    raises(DeviceFault, r"blocked 0\.1", watch, spine, lambda s: s.homed)
    plant.spine_blocked = False
    spine.home()
    assert watch(spine, lambda s: s.homed).homed
    assert plant.spine_drive == pytest.approx(0, abs=5e-4)


def test_a_first_homing_that_met_a_jam_is_found_out_by_the_next(make: Make, plant: Plant) -> None:
    spine, _ = make()
    plant.spine_blocked = True
    homed(spine)
    plant.spine_blocked = False
    spine.home()
    raises(DeviceFault, "beyond where an earlier run", watch, spine, lambda s: s.homed)
    spine.home()
    assert watch(spine, lambda s: s.homed).homed


@pytest.mark.parametrize(("release", "torque"), [(True, 0), (False, 1)])
def test_close_leaves_the_torque_as_configured_and_the_watchdog_off(make: Make, release: bool, torque: int) -> None:
    spine, servo = make(release_on_close=release)
    homed(spine)
    spine.close()
    assert servo.motor.get(TORQUE) == torque
    assert servo.motor.table[WATCHDOG] == 0
