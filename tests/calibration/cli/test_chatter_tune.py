"""`procmodel chatter tune`: labelled recordings in, a threshold with its figures out."""

import json

import pytest

from tests.calibration import labelled_cuts as shapes

COSTS = ("--false-alarm-cost", 1, "--miss-cost", 3)
SETTINGS = ("--window", 512, "--band", 200, 3500)


@pytest.fixture(scope="module")
def shop(tmp_path_factory):
    labels = ("stable",) * 5 + ("marginal",) + ("chatter",) * 5
    return shapes.shop(tmp_path_factory.mktemp("shop"), labels=labels)


@pytest.fixture
def options(shop):
    table, baseline = shop
    return ("chatter", "tune", table, "--baseline", baseline, *COSTS)


def test_labelled_cuts_to_a_threshold(options, shop, tmp_path, run_json):
    out, picture = tmp_path / "tuned.json", tmp_path / "tuned.png"
    result = run_json(
        *options, *SETTINGS, "--cost-per", "cut", "--false-alarms-per-hour", 60, "--folds", 2,
        "--tune-band", "--out", out, "--plot", picture,
    )  # fmt: skip
    low, high = result["threshold"]["interval90"]
    assert 0.0 < low <= result["threshold"]["value"] <= high
    for name in ("false_alarms_per_hour", "detection_probability", "delay_s"):
        low, high = result[f"{name}_interval90"]
        assert isinstance(result[name], float) and low <= high
    assert result["false_alarms_per_hour"] < 60.5
    assert result["cuts"] == {"stable": 5, "marginal": 1, "chatter": 5}
    assert result["rule"] == {"votes": 2, "of": 5, "averaged": 1}
    held = result["held_out"]
    assert held["folds"] == 2
    for part in (held, held["in_sample"]):
        assert 0.5 < part["auc"] <= 1.0
        assert part["cuts"] == result["cuts"]
    assert any("stable windows of 5 cuts can promise no less than one in" in w
               for w in result["warnings"])  # fmt: skip
    tuned = result["tuning"]["tuned"]
    assert 1000.0 < tuned["low"] < 1234.0 < tuned["high"] < 1500.0
    assert json.loads(out.read_text()) == result
    assert picture.read_bytes().startswith(b"\x89PNG")
    found = run_json(
        "chatter", "detect", shop[0].parent / "cut 6.wav", "--baseline", shop[1],
        "--spindle-speed", 6000, "--tuned", out, *SETTINGS,
    )  # fmt: skip
    assert found["threshold"] == result["threshold"]["value"]


@pytest.mark.parametrize(
    ("more", "parts"),
    [
        (("--miss-cost", 0), ("--miss-cost is 0", "above 0")),
        (("--chatter-share", 1), ("--chatter-share is 1", "between 0 and 1")),
        (("--folds", 1), ("--folds is 1", "0 for none")),
        (("--seed", -1), ("--seed is -1",)),
        (("--cost-per", "hour"), ("costs are per 'hour'", "window")),
        (("--votes", 6), ("6 of 5 windows",)),
        (("--window", 1024), ("labels.csv, row 2", "window length 512, not 1024")),
        (("--plot", "tuned.txt"), ("tuned.txt", ".png")),
        (("--channel", "z"), ("labels.csv, row 2", "'z'")),
    ],
)
def test_bad_input_is_one_sentence(options, run, more, parts):
    code, out, err = run(*options, *more)
    assert code == 2
    assert out == ""
    assert err.count("\n") == 1
    for part in parts:
        assert part in err


def test_a_label_that_is_not_one_names_file_and_row(options, shop, run):
    text = shop[0].read_text().replace("chatter", "chater", 1)
    table = shop[0].parent / "wrong.csv"
    table.write_text(text)
    code, _, err = run(*options[:2], table, *options[3:])
    assert code == 2
    assert "wrong.csv, row 8: label 'chater' is unknown; did you mean 'chatter'?" in err
