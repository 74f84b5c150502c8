"""Scene files of hostile text are parsed or refused in one line, in a time that grows with their length.

What is quadratic takes hours for these lengths, which the time limit of all tests ends.
"""

from contextlib import nullcontext

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from support.attacks import examples
from support.scenes import MATERIAL, PAPER
from warp_plate import Scene, SceneError
from warp_plate.scene.load import parse_toml

FRAGMENTS = ['\\"', '"', "'", '"""', "'''", '\\"""\n', "\\", "a.", '"a".', "a ", "[", "{a=", "[[a]]\n", "# ", "=", "1,"]
FRAGMENTS += ["\n", "\r\n", "\t", "1_", "0x", "a=1\n", 'a="x\n', "\0", "é", "title=", PAPER[:300], PAPER]


@pytest.mark.hour
@given(st.lists(st.sampled_from(FRAGMENTS), max_size=4), st.lists(st.sampled_from(FRAGMENTS), min_size=1, max_size=3))
@example([], ['\\"'])
@example([], ['\\"""\n'])
@example(['title = "'], ['\\"'])
@examples(25)
def test_repeated_fragments(start, repeated):
    piece = "".join(repeated)
    text = "".join(start) + piece * max(1, 2**18 // len(piece)) + "\\"
    message = "none"
    try:
        Scene.parse(text, "x.toml")  # which may be a scene with a long comment
    except SceneError as error:
        message = str(error)
    assert len(message.splitlines()) == 1
    assert len(message) < 1000


def test_a_file_longer_than_any_scene(tmp_path):
    (tmp_path / "a.toml").write_bytes(b"\n" * (2**22 + 1))
    with pytest.raises(SceneError, match=r"a\.toml: 4194305 bytes; a scene file has at most 4194304"):
        Scene.load(tmp_path / "a.toml")


@pytest.mark.parametrize(
    "before", ['x="""\\"""', 'x="""a\\"""b"""\n', 'x={a="""a"""",', "x='''a'''''\n", 'x=""\n', "#'''\n"]
)
def test_deep_keys_hide_behind_no_text(before):
    with pytest.raises(SceneError, match="ten parts") as caught:
        parse_toml(before + '"""\n' * before.endswith('"""') + "a." * 10 + "a=1", "x.toml")
    assert str(caught.value).startswith("x.toml: ")


@pytest.mark.parametrize(("side", "refusal"), [(50, None), (0, r"plate\.holes\[0\]: the ellipse crosses or touches")])
def test_thousands_of_holes(side, refusal):
    """Apart from each other, or all in one place."""
    places = (0.2 / max(side, 1)) * (np.indices((50, 50)).reshape(2, -1).T % max(side, 1) + 0.5)
    holes = [{"disc": (x, y, 0.001), "edge": "free"} for x, y in places.tolist()]
    plate = {**MATERIAL, "outline": {"rectangle": (0.2, 0.2)}, "holes": holes}
    actuators = [{"name": "a", "area": (0.0005, 0.0007, 0.0005, 0.0007)}]
    target = {"area": (0.0, 0.1, 0.0, 0.1)}
    tables = {"plate": plate, "actuators": actuators, "target": target, "drive": {"frequency": 290.0}}
    with pytest.raises(SceneError, match=refusal) if refusal else nullcontext():
        Scene.from_tables({**tables, "edges": {"outline": "clamped"}, "window": {"start": 0.01, "end": 0.02}})


def test_dots_in_texts_are_no_keys():
    text = "a." * 20
    parsed = parse_toml(
        f'a=\'{text}\' # {text}\nb="""\\"""{text}"""\nc=\'\'\'{text}\'\'\'\'\'\nd="\\"{text}"', "x.toml"
    )
    assert parsed == {"a": text, "b": f'"""{text}', "c": f"{text}''", "d": f'"{text}'}
