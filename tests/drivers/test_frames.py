"""Rotations against each other and against known ones."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.frames import (
    apply,
    compose,
    matrix_from_quaternion,
    quaternion_from_matrix,
    rotation_from_vector,
    vector_from_rotation,
)

HALF = math.sqrt(0.5)
parts = st.tuples(*[st.floats(-1, 1)] * 4).filter(lambda q: math.hypot(*q) > 0.1)
vectors = st.tuples(*[st.floats(-2, 2)] * 3)


@pytest.mark.parametrize(
    ("quaternion", "axis"), [((HALF, HALF, 0, 0), (0, 0, 1)), ((HALF, 0, HALF, 0), (0, 1, 0)), ((HALF, 0, 0, HALF), (-1, 0, 0))]
)
def test_a_quarter_turn_takes_y_where_it_should(
    quaternion: tuple[float, float, float, float], axis: tuple[float, float, float]
) -> None:
    assert apply((0, 0, 0), matrix_from_quaternion(quaternion), (0, 1, 0)) == pytest.approx(axis, abs=1e-12)


@given(parts)
def test_quaternion_and_matrix_tell_the_same_rotation(q: tuple[float, float, float, float]) -> None:
    matrix = matrix_from_quaternion(q)
    again = quaternion_from_matrix(matrix)
    assert again[0] >= 0
    assert math.hypot(*again) == pytest.approx(1)
    assert matrix_from_quaternion(again) == pytest.approx(matrix, abs=1e-9)
    assert matrix @ matrix.T == pytest.approx(np.eye(3), abs=1e-12)


@given(parts, parts)
def test_composing_quaternions_multiplies_matrices(
    a: tuple[float, float, float, float], b: tuple[float, float, float, float]
) -> None:
    product = matrix_from_quaternion(a) @ matrix_from_quaternion(b)
    assert matrix_from_quaternion(compose(a, b)) == pytest.approx(product, abs=1e-9)


@given(vectors)
def test_a_rotation_vector_is_its_own_axis_and_angle(vector: tuple[float, float, float]) -> None:
    matrix = rotation_from_vector(vector)
    assert np.trace(matrix) == pytest.approx(1 + 2 * math.cos(math.hypot(*vector)), abs=1e-9)
    assert matrix @ np.array(vector) == pytest.approx(np.array(vector), abs=1e-9)


@given(vectors)
def test_a_rotation_s_vector_is_the_shortest_that_gives_it(vector: tuple[float, float, float]) -> None:
    matrix = rotation_from_vector(vector)
    found = vector_from_rotation(matrix)
    assert rotation_from_vector(found) == pytest.approx(matrix, abs=1e-9)
    assert np.linalg.norm(found) <= math.pi + 1e-9
