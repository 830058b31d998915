"""Plans and paths as `wear plan` writes them: what is read, and every way to be wrong."""

import numpy as np
import pytest

from procmodel.errors import InputError
from procmodel.io import read_paths, read_plan

PLAN = "stage [1], target z [um], cumulative feed [um]\n1, 2, 3.5\n1, 4, 6\n2, 4, 2\n"
PATHS = """\
# a remark
layer [1], x [um], y [um], cumulative feed [um], cutting [1], quarter turns [1]
1, 0, 0, 3.5, 0, 0
1, 10, 0, 3.5, 1, 0
1, 10, 5, 3.5, 0, 0
1, 0, 5, 3.5, 1, 0
2, 4, 4, 6, 0, 1
"""


def written(tmp_path, text):
    path = tmp_path / "file.csv"
    path.write_text(text)
    return path


def test_plan(tmp_path):
    plan = read_plan(written(tmp_path, PLAN))
    np.testing.assert_array_equal(plan.bottom, [2.0, 4.0])
    np.testing.assert_array_equal(plan.feed, [3.5, 2.5])
    other = read_plan(plan.path, stage=2)
    np.testing.assert_array_equal(other.cumulative_feed, [2.0])


def test_plan_without_a_stage_and_in_millimetres(tmp_path):
    plan = read_plan(written(tmp_path, "target z [mm], cumulative feed [mm]\n0.002, 0.003\n"))
    np.testing.assert_allclose([plan.bottom[0], plan.feed[0]], [2.0, 3.0])


def test_paths(tmp_path):
    first, second = read_paths(written(tmp_path, PATHS))
    np.testing.assert_array_equal(first.points, [[0, 0], [10, 0], [10, 5], [0, 5]])
    np.testing.assert_array_equal(first.cutting, [True, False, True])
    assert (first.cumulative_feed, first.quarter_turns) == (3.5, 0)
    # A layer of one place is a plunge.
    assert second.points.shape == (1, 2) and second.cutting.shape == (0,)
    assert second.quarter_turns == 1


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("target z [um], cumulative feed [um]\n2, 3\n2, 4\n", r"row 3: target z is 2 um, but must"),
        ("target z [um], cumulative feed [um]\n2, 3\n4, 3\n", r"row 3: cumulative feed is 3 um"),
        ("target z [um], cumulative feed [um]\n0, 3\n", r"row 2: target z is 0 um"),
        ("stage [1], target z [um], cumulative feed [um]\n2, 2, 3\n", "no layer of stage 1"),
    ],
)
def test_wrong_plans(tmp_path, text, words):
    with pytest.raises(InputError, match=words):
        read_plan(written(tmp_path, text))


@pytest.mark.parametrize(
    ("before", "after", "words"),
    [
        ("2, 4, 4, 6", "3, 4, 4, 6", r"row 7: layer 3 comes out of turn"),
        ("1, 0, 0, 3.5", "2, 0, 0, 3.5", r"row 3: layer 2 comes out of turn"),
        ("1, 10, 5, 3.5", "1, 10, 5, 3", r"row 5: cumulative feed changes within layer 1"),
        ("3.5, 1, 0", "3.5, 0, 0", r"row 3: no move of layer 1 cuts"),
        ("1, 10, 5, 3.5, 0, 0", "1, 10, 5, 3.5, 0, 1", r"quarter turns changes within layer 1"),
    ],
)
def test_wrong_paths(tmp_path, before, after, words):
    assert before in PATHS
    with pytest.raises(InputError, match=words):
        read_paths(written(tmp_path, PATHS.replace(before, after)))
