"""The fake controller without a wire: kinematics, motion, program, safety."""

import math

import numpy as np
import pytest

from sim_fakes.ur import kinematics as k
from sim_fakes.ur.controller import FakeController, Runtime
from sim_fakes.ur.dashboard import answer
from sim_fakes.ur.motion import START_JOINTS, ArmMotion, JointMove, LinearMove, Motion, Profile, stop_linear

PROGRAM = "def rtde_control():\n  global reg_offset_int = # int register offset\n0\nend\n"
MOVEL, STOPL, WATCHDOG = 3, 33, 35


def run(motion: Motion, dt: float = 0.008) -> float:
    """Time until the motion is done, s."""
    t = 0.0
    while motion.step(dt):
        t += dt
    return t


def playing(speed: float = 1.0) -> FakeController:
    """A controller that runs the control script."""
    controller = FakeController(speed=speed)
    controller.load(PROGRAM)
    assert controller.runtime == Runtime.PLAYING
    return controller


def command(controller: FakeController, code: int, doubles: list[float], flag: int = 1) -> None:
    """What a client does: registers, code, wait for done, clear."""
    for i, value in enumerate(doubles):
        controller.write(f"input_double_register_{i}", value)
    controller.write("input_int_register_1", flag)
    controller.write("input_int_register_0", code)
    controller.advance()
    controller.write("input_int_register_0", 0)


# -- kinematics
def test_the_flange_is_where_the_maker_says_at_the_outstretched_and_the_upright_pose() -> None:
    flat, _ = k.forward(k.UR5_CB3, np.zeros(6), np.eye(4))
    assert flat[:3, 3] == pytest.approx([-0.81725, -0.19145, -0.005491], abs=1e-9)
    upright, _ = k.forward(k.UR5_CB3, np.array([0, -math.pi / 2, 0, -math.pi / 2, 0, 0]), np.eye(4))
    assert upright[:3, 3] == pytest.approx([0.0, -0.19145, 1.001059], abs=1e-9)


def test_the_jacobian_is_the_slope_of_the_pose() -> None:
    q, tool = np.array([0.3, -1.2, 1.4, -0.7, 1.1, 0.2]), k.pose_matrix([0.01, 0.0, 0.12, 0.0, 0.3, 0.0])
    pose, jacobian = k.forward(k.UR5_CB3, q, tool)
    for joint in range(6):
        step = np.zeros(6)
        step[joint] = 1e-6
        moved, _ = k.forward(k.UR5_CB3, q + step, tool)
        slope = np.concatenate([moved[:3, 3] - pose[:3, 3], k.rotation_vector(moved[:3, :3] @ pose[:3, :3].T)]) / 1e-6
        assert slope == pytest.approx(jacobian[:, joint], abs=1e-5)


@pytest.mark.parametrize("geometry", [k.UR5_CB3, k.UR5E], ids=["CB3", "e-Series"])
def test_inverse_kinematics_finds_back_from_a_disturbed_start(geometry: k.Geometry) -> None:
    random = np.random.default_rng(1)
    for _ in range(40):
        q = random.uniform(-2.0, 2.0, 6)
        target, _ = k.forward(geometry, q, np.eye(4))
        found = k.inverse(geometry, target, q + random.normal(0, 0.1, 6), np.eye(4))
        assert found is not None
        assert k.forward(geometry, found, np.eye(4))[0] == pytest.approx(target, abs=1e-6)


def test_rotation_vectors_survive_angles_near_zero_and_near_a_half_turn() -> None:
    random = np.random.default_rng(2)
    for angle in [1e-9, 1e-4, 1.0, 3.0, *(math.pi - 10.0 ** -np.arange(2, 12))]:
        axis = random.normal(size=3)
        matrix = k.rotation_matrix(angle * axis / np.linalg.norm(axis))
        assert k.rotation_matrix(k.rotation_vector(matrix)) == pytest.approx(matrix, abs=1e-9)


# -- motion
def test_a_profile_covers_its_distance_with_its_speed_and_acceleration() -> None:
    profile = Profile(0.1, 0.05, 0.5)
    assert profile.duration == pytest.approx(0.1 / 0.05 + 0.05 / 0.5)
    t = np.linspace(0, profile.duration, 2001)
    speed = np.gradient([0.1 * profile.fraction(x) for x in t], t)
    assert speed.max() == pytest.approx(0.05, rel=1e-3)
    assert np.abs(np.gradient(speed, t)).max() == pytest.approx(0.5, rel=0.02)
    assert Profile(0.001, 0.05, 0.5).speed < 0.05


def test_a_linear_move_stays_on_the_straight_line() -> None:
    arm = ArmMotion(k.UR5_CB3)
    start = arm.pose_vector()
    goal = start + [-0.1, 0.08, -0.12, 0, 0, 0]
    motion = LinearMove(arm, goal, 0.1, 0.5)
    direction = (goal - start)[:3] / np.linalg.norm((goal - start)[:3])
    while motion.step(0.008):
        off = arm.pose_vector()[:3] - start[:3]
        assert np.linalg.norm(off - direction * (off @ direction)) < 1e-6
    assert arm.pose_vector()[:3] == pytest.approx(goal[:3], abs=1e-8)
    assert not np.any(arm.qd)


def test_a_joint_move_takes_the_time_of_the_joint_with_the_longest_way() -> None:
    arm = ArmMotion(k.UR5_CB3)
    goal = np.array(START_JOINTS) + [0.5, 0.1, 0, 0, 0, -0.2]
    assert run(JointMove(arm, goal, 1.0, 2.0)) == pytest.approx(0.5 / 1.0 + 1.0 / 2.0, abs=0.02)
    assert arm.q == pytest.approx(goal)


@pytest.mark.parametrize("dt", [0.002, 0.16], ids=["fine", "sped up"])
def test_a_linear_stop_needs_half_the_speed_squared_over_the_deceleration(dt: float) -> None:
    arm = ArmMotion(k.UR5_CB3)
    motion = LinearMove(arm, arm.pose_vector() + [0, 0, -0.2, 0, 0, 0], 0.1, 1.0)
    while np.linalg.norm(arm.tcp_speed()[:3]) < 0.0999:
        motion.step(0.002)
    before = arm.pose_vector()[2]
    run(stop_linear(arm, 0.5), dt)
    assert before - arm.pose_vector()[2] == pytest.approx(0.1**2 / 2 / 0.5, rel=0.02)
    assert not np.any(arm.qd)


# -- controller


@pytest.mark.parametrize(
    ("code", "doubles", "reason"),
    [
        (MOVEL, [1.5, 0, 0, 0, 0, 0, 0.1, 0.5], "no inverse kinematics"),
        (MOVEL, [0.4, 0, 0.4, 2.2, -2.2, 0, 3.5, 0.5], "out of range"),
        (MOVEL, [math.nan, 0, 0.4, 2.2, -2.2, 0, 0.1, 0.5], "not a number"),
        (STOPL, [0.0], "deceleration 0"),
        (99, [], "command 99"),
    ],
)
def test_what_the_script_cannot_do_ends_it_with_a_reason(code: int, doubles: list[float], reason: str) -> None:
    controller = playing()
    command(controller, code, doubles)
    assert controller.runtime == Runtime.STOPPED
    assert reason in controller.ended[-1]


def test_a_move_during_an_asynchronous_stop_is_two_threads_at_one_arm() -> None:
    controller = playing()
    goal = (controller.arm.pose_vector() - [0, 0, 0.1, 0, 0, 0]).tolist()
    command(controller, MOVEL, [*goal, 0.1, 0.5])
    for _ in range(30):
        controller.advance()
    command(controller, STOPL, [0.1])
    controller.advance()
    command(controller, MOVEL, [*goal, 0.1, 0.5])
    assert "another thread" in controller.ended[-1]


def test_cycles_that_a_late_host_makes_up_count_by_the_time_they_took() -> None:
    controller = playing(speed=20.0)
    command(controller, WATCHDOG, [10.0])
    controller.write("input_int_register_0", 0)
    for _ in range(22):
        controller.advance(0.5 * controller.period)
    controller.advance(1.0)
    assert controller.runtime == Runtime.PLAYING
    for _ in range(2):
        controller.advance(0.5 * controller.period)
    assert controller.runtime == Runtime.STOPPED and "watchdog" in controller.ended[-1]


def test_no_program_starts_during_a_protective_stop() -> None:
    controller = playing()
    controller.protective_stop("test")
    controller.load(PROGRAM)
    assert controller.runtime == Runtime.STOPPED
    assert controller.ended[-1] == "rtde_control not started: the arm is not ready"
    assert answer(controller, "safetystatus") == "Safetystatus: PROTECTIVE_STOP"
    assert answer(controller, "unlock protective stop").startswith("Cannot unlock protective stop until 5s")
    after(controller, 5.1)
    assert answer(controller, "unlock protective stop") == "Protective stop releasing"
    controller.load(PROGRAM)
    assert controller.runtime == Runtime.PLAYING


def after(controller: FakeController, seconds: float) -> None:
    for _ in range(math.ceil(seconds / controller.period)):
        controller.advance()


def test_a_program_that_runs_is_stopped_and_power_and_brakes_take_seconds() -> None:
    assert answer(playing(), "stop") == "Stopped"
    controller = playing()
    assert answer(controller, "power off") == "Powering off"
    assert controller.ended[-1] == "powered off"
    assert answer(controller, "robotmode") == "Robotmode: POWER_OFF"
    assert answer(controller, "brake release") == "Brake releasing"
    assert answer(controller, "robotmode") == "Robotmode: POWER_ON"
    after(controller, 4.1)
    assert answer(controller, "robotmode") == "Robotmode: IDLE"
    after(controller, 2.1)
    assert answer(controller, "robotmode") == "Robotmode: RUNNING"
    controller.power(on=False)
    controller.power(on=True)
    controller.safety_stop("ROBOT_EMERGENCY_STOP")
    after(controller, 5)
    assert answer(controller, "robotmode") == "Robotmode: POWER_OFF"


@pytest.mark.parametrize(
    ("request_", "told"),
    [
        ("stop", "Failed to execute: stop"),
        ("play", "Failed to execute: play"),
        ("pause", "Failed to execute: pause"),
        ("load x.urp", "File not found: x.urp"),
        ("restart safety", "Restarting safety"),
        ("shutdown", "Shutting down"),
        ("nonsense", "could not understand: 'nonsense'"),
    ],
)
def test_the_dashboard_answers_what_it_documents(request_: str, told: str) -> None:
    assert answer(FakeController(version=(5, 11, 0, 1)), request_).startswith(told)
