"""The RTDE variables this controller offers: their wire types and the values that never change.

Names and types as in the RTDE guide of Universal Robots; `outputs` decides what a PolyScope version offers.
"""

from __future__ import annotations

DOUBLE, VECTOR6D, VECTOR3D = "DOUBLE", "VECTOR6D", "VECTOR3D"
INT32, UINT32, UINT64, VECTOR6INT32, UINT8, BOOL = "INT32", "UINT32", "UINT64", "VECTOR6INT32", "UINT8", "BOOL"

FORMAT = {
    DOUBLE: "d", VECTOR6D: "6d", VECTOR3D: "3d", INT32: "i", UINT32: "I", UINT64: "Q", VECTOR6INT32: "6i", UINT8: "B", BOOL: "?",
}  # fmt: skip
"""Type -> code of `struct`."""
COUNT = {VECTOR6D: 6, VECTOR3D: 3, VECTOR6INT32: 6}
"""Values in one variable; 1 where absent."""

REGISTERS = 48
Version = tuple[int, int, int, int]

_VECTORS = [
    "target_q", "target_qd", "target_qdd", "target_current", "target_moment", "actual_q", "actual_qd", "actual_current",
    "joint_control_output", "actual_TCP_pose", "actual_TCP_speed", "actual_TCP_force", "target_TCP_pose", "target_TCP_speed",
    "joint_temperatures", "actual_joint_voltage",
]  # fmt: skip
_DOUBLES = [
    "timestamp", "actual_execution_time", "speed_scaling", "target_speed_fraction", "actual_momentum", "actual_main_voltage",
    "actual_robot_voltage", "actual_robot_current", "standard_analog_input0", "standard_analog_input1",
    "standard_analog_output0", "standard_analog_output1", "io_current", "euromap67_24V_voltage", "euromap67_24V_current",
    "tool_analog_input0", "tool_analog_input1", "tool_output_current", "tool_temperature", "tcp_force_scalar",
]  # fmt: skip
_INTEGERS = {
    "analog_io_types": UINT32,
    "euromap67_input_bits": UINT32,
    "euromap67_output_bits": UINT32,
    "tool_mode": UINT32,
    "tool_analog_input_types": UINT32,
    "tool_output_voltage": INT32,
    "output_bit_registers0_to_31": UINT32,
    "output_bit_registers32_to_63": UINT32,
    "input_bit_registers0_to_31": UINT32,
    "input_bit_registers32_to_63": UINT32,
}
"""With the above all that the maker's example of a recording asks for; what nobody here moves is sent as 0."""

CONSTANT: dict[str, float | list[float]] = {
    "joint_temperatures": [30.0] * 6,
    "actual_joint_voltage": [48.0] * 6,
    "actual_main_voltage": 48.0,
    "actual_robot_voltage": 48.0,
    "joint_mode": [253] * 6,
}


def outputs(version: Version) -> dict[str, str]:
    """Name -> type of everything a client may ask to be sent, for a PolyScope version."""
    names = dict.fromkeys(_VECTORS, VECTOR6D) | dict.fromkeys(_DOUBLES, DOUBLE)
    names |= _INTEGERS
    names |= {"elbow_position": VECTOR3D, "elbow_velocity": VECTOR3D}
    names |= {f"input_int_register_{i}": INT32 for i in range(REGISTERS)}
    names |= {f"input_double_register_{i}": DOUBLE for i in range(REGISTERS)}
    names |= {f"output_bit_register_{i}": BOOL for i in range(64, 128)}
    names |= {"actual_digital_input_bits": UINT64, "actual_digital_output_bits": UINT64}
    names |= {"robot_mode": INT32, "safety_mode": INT32, "joint_mode": VECTOR6INT32}
    names |= {"actual_tool_accelerometer": VECTOR3D, "runtime_state": UINT32}
    names |= {"robot_status_bits": UINT32, "safety_status_bits": UINT32}
    names |= {f"output_int_register_{i}": INT32 for i in range(REGISTERS)}
    names |= {f"output_double_register_{i}": DOUBLE for i in range(REGISTERS)}
    cb3, e_series = version[0] == 3, version[0] >= 5
    if (cb3 and version >= (3, 11)) or (e_series and version >= (5, 5, 1)):
        names |= {"payload": DOUBLE, "payload_cog": VECTOR3D}
    if (cb3 and version >= (3, 15)) or (e_series and version >= (5, 11)):
        names["payload_inertia"] = VECTOR6D
    if (cb3 and version >= (3, 10)) or (e_series and version >= (5, 4)):
        names["safety_status"] = INT32
    if e_series and version >= (5, 9):
        names["ft_raw_wrench"] = VECTOR6D
    return names


def inputs() -> dict[str, str]:
    """Name -> type of all that a client may own and write; `external_force_torque` of a CB3 is assumed, none was at hand."""
    names = {f"input_int_register_{i}": INT32 for i in range(REGISTERS)}
    names |= {f"input_double_register_{i}": DOUBLE for i in range(REGISTERS)}
    names |= {"speed_slider_mask": UINT32, "speed_slider_fraction": DOUBLE, "external_force_torque": VECTOR6D}
    return names
