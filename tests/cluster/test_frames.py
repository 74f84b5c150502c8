"""Plain data on a pipe comes out as it went in, and nothing else goes in."""

import io

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from warp_plate.cluster.frames import encode, receive, send

KINDS = ("<f8", "<f4", "<c16", "<i8", "|u1", "|b1")
ARRAYS = st.sampled_from(KINDS).flatmap(
    lambda kind: hnp.arrays(kind, hnp.array_shapes(min_dims=0, max_dims=3, min_side=0, max_side=4))
)
TEXTS = st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"]))
VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | TEXTS | st.binary() | ARRAYS,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(TEXTS, inner, max_size=3),
    max_leaves=8,
)


def same(one, other):
    if isinstance(one, np.ndarray):
        return one.dtype == other.dtype and one.shape == other.shape and one.tobytes() == other.tobytes()
    if isinstance(one, dict):
        return one.keys() == other.keys() and all(same(one[key], other[key]) for key in one)
    if isinstance(one, list):
        return len(one) == len(other) and all(map(same, one, other))
    return type(one) is type(other) and (one == other or one != one)


@given(st.lists(st.dictionaries(TEXTS, VALUES, max_size=4), max_size=3))
def test_messages_come_out_as_they_went_in(messages):
    stream = io.BytesIO()
    for message in messages:
        send(message, stream)
    stream.seek(0)
    assert all(same(message, receive(stream)) for message in messages)
    assert receive(stream) is None


@given(st.integers(0, 10**6))
def test_a_frame_that_is_cut_off_is_none(cut):
    whole = b"".join(encode({"a": np.arange(5.0), "b": [b"xyz", {"c": np.zeros((2, 3), complex)}]}))
    assert receive(io.BytesIO(whole[: cut % len(whole)])) is None


@pytest.mark.parametrize("value", [np.array([object()]), {1, 2}, len])
def test_what_is_not_plain_is_refused(value):
    with pytest.raises(TypeError):
        encode({"value": value})
