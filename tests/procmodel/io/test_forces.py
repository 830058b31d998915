"""Tables of forces and files of coefficients."""

import json
import math

import numpy as np
import pytest

from procmodel.errors import InputError
from procmodel.io import ForceReadings, read_coefficients, read_forces

CONDITIONS = "feed per tooth [mm],axial depth [mm]"
COEFFICIENTS = {
    "tangential_shear": 796.0,
    "radial_shear": 168.8,
    "axial_shear": 222.0,
    "tangential_edge": 27.7,
    "radial_edge": 30.8,
    "axial_edge": 1.4,
}


@pytest.fixture
def file(tmp_path):
    def write(*lines, name="forces.csv"):
        path = tmp_path / name
        path.write_text("\n".join(lines))
        return path

    return write


def test_units_are_those_of_milling_and_angles_in_rad(file):
    path = file(
        "feed per tooth [um],axial depth [m],start [deg],exit [rad],Fx [kN],Fy [N],Fz [mN]",
        "40,0.005,90,3.14159265,0.1,2,3000",
        "",
        "80,0.002,120,2.5,-0.2,4,-5000",
    )
    found = read_forces(path)
    np.testing.assert_allclose(found.feed_per_tooth, [0.04, 0.08], rtol=1e-14)
    np.testing.assert_allclose(found.axial_depth, [5.0, 2.0], rtol=1e-14)
    np.testing.assert_allclose(found.start, [math.pi / 2, 2 * math.pi / 3], rtol=1e-14)
    np.testing.assert_allclose(found.exit, [math.pi, 2.5], rtol=1e-8)
    np.testing.assert_allclose(found.forces["Fx"], [100.0, -200.0], rtol=1e-14)
    np.testing.assert_allclose(found.forces["Fz"], [3.0, -5.0], rtol=1e-14)
    np.testing.assert_array_equal(found.rows, [2, 4])
    assert found.rotation is None


@pytest.mark.parametrize(("milling", "arc"), [("down", (150.0, 180.0)), ("up", (0.0, 30.0))])
def test_engagement_angle_and_milling_give_the_arc(file, milling, arc):
    path = file(f"{CONDITIONS},engagement angle [deg],Fx [N],Fy [N]", "0.04,5,30,1,2")
    found = read_forces(path, milling)
    np.testing.assert_allclose(np.rad2deg([found.start[0], found.exit[0]]), arc, atol=1e-12)
    assert set(found.forces) == {"Fx", "Fy"}


def test_rotation_makes_them_instantaneous(file):
    path = file(
        f"rotation_deg,{CONDITIONS},start_deg,exit_deg,Fx [N],Fy [N]", "720,0.04,5,0,90,1,2"
    )
    np.testing.assert_allclose(read_forces(path).rotation, [4.0 * math.pi], rtol=1e-14)


ARC = "start [deg],exit [deg]"


@pytest.mark.parametrize(
    ("header", "row", "parts"),
    [
        (f"{CONDITIONS},{ARC},Fx [N],Fy [N]", "0,5,0,90,1,2", ["row 2", "zero feed per tooth"]),
        (f"{CONDITIONS},{ARC},Fx [N],Fy [N]", "1,-5,0,90,1,2", ["row 2", "negative axial depth"]),
        (f"{CONDITIONS},{ARC},Fx [N],Fy [N]", "1,5,-9,90,1,2", ["row 2", "start is below 0 deg"]),
        (f"{CONDITIONS},{ARC},Fx [N],Fy [N]", "1,5,0,190,1,2", ["row 2", "exit is above 180 deg"]),
        (f"{CONDITIONS},{ARC},Fx [N],Fy [N]", "1,5,90,80,1,2", ["row 2", "start is greater than"]),
        (f"{CONDITIONS},{ARC},Fx [N],Fy [N]", "1,5,0,90,nan,2", ["row 2", "'Fx'", "finite"]),
        (f"{CONDITIONS},{ARC},Fx [N],Fy [N]", "1,5,0,90,,2", ["row 2", "'Fx' is empty"]),
        (f"{CONDITIONS},{ARC},Fx [N]", "1,5,0,90,1", ["no column 'Fy'", "'Fy [N]'"]),
        (f"{CONDITIONS},{ARC},Fx [mm],Fy [N]", "1,5,0,90,1,2", ["'Fx'", "'mm'"]),
        (f"{CONDITIONS},{ARC},Fx,Fy [N]", "1,5,0,90,1,2", ["'Fx' has no unit", "'Fx [N]'"]),
        (f"{CONDITIONS},start [deg],Fx [N],Fy [N]", "1,5,0,1,2", ["no 'exit'", "add 'exit [deg]'"]),
        (f"{CONDITIONS},Fx [N],Fy [N]", "1,5,1,2", ["where a flute is engaged"]),
        (
            f"{CONDITIONS},{ARC},engagement angle [deg],Fx [N],Fy [N]",
            "1,5,0,90,90,1,2",
            ["both 'start' and 'engagement angle'", "keep one"],
        ),
        (
            f"{CONDITIONS},engagement angle [deg],Fx [N],Fy [N]",
            "1,5,30,1,2",
            ["down or up", "'start [deg], exit [deg]'"],
        ),
    ],
)
def test_faulty_tables(file, header, row, parts):
    with pytest.raises(InputError) as raised:
        read_forces(file(header, row))
    for part in ["forces.csv", *parts]:
        assert part in str(raised.value)


def test_engagement_angle_out_of_range_names_its_row(file):
    path = file(f"{CONDITIONS},engagement angle [deg],Fx [N],Fy [N]", "1,5,30,1,2", "1,5,200,1,2")
    with pytest.raises(InputError, match=r"forces\.csv, row 3: engagement angle 200 deg is not"):
        read_forces(path, "down")


def test_readings_without_a_file_are_checked_too():
    forces = {"Fx": [1.0, 2.0], "Fy": [1.0, 2.0]}
    found = ForceReadings(0.04, 5.0, [0.0, 1.0], math.pi, forces)
    np.testing.assert_array_equal(found.feed_per_tooth, [0.04, 0.04])
    with pytest.raises(InputError, match=r"^reading 2: start is greater than exit"):
        ForceReadings(0.04, 5.0, [0.0, 1.0], 0.5, forces)
    with pytest.raises(InputError, match=r"^axial_depth has shape \(3,\) for 2 readings"):
        ForceReadings(0.04, [1.0, 2.0, 3.0], 0.0, 1.0, forces)
    with pytest.raises(InputError, match=r"^Fy has shape \(1,\)"):
        ForceReadings(0.04, 5.0, 0.0, 1.0, {"Fx": [1.0, 2.0], "Fy": [1.0]})
    with pytest.raises(InputError, match=r"^unknown force 'thrust'; known are Fx, Fy, Fz$"):
        ForceReadings(0.04, 5.0, 0.0, 1.0, {"thrust": [1.0], "Fy": [1.0]})
    with pytest.raises(InputError, match=r"^there is no Fy"):
        ForceReadings(0.04, 5.0, 0.0, 1.0, {"Fx": [1.0]})


def toml(**values):
    return "\n".join(f"{name} = {value}" for name, value in values.items())


def test_coefficients_from_toml(file):
    path = file(toml(**COEFFICIENTS, source="'table 5'"), name="steel.toml")
    assert read_coefficients(path) == COEFFICIENTS


def test_without_both_axial_ones_no_axial_force(file):
    partial = {n: v for n, v in COEFFICIENTS.items() if not n.startswith("axial")}
    found = read_coefficients(file(toml(**partial), name="steel.toml"))
    assert found == partial | {"axial_shear": 0.0, "axial_edge": 0.0}
    with pytest.raises(InputError, match=r"steel\.toml: there is no axial_edge: add it"):
        read_coefficients(file(toml(**partial, axial_shear=1.0), name="steel.toml"))


def result(**changes):
    estimate = {"verdict": "identified", "interval95": [0.0, 1.0]}
    parameters = {name: {"value": v, **estimate} for name, v in COEFFICIENTS.items()}
    parameters["tangential_edge"] |= changes.pop("edge", {})
    return json.dumps({"converged": True, "status": "s", "parameters": parameters} | changes)


def test_coefficients_from_a_fit(file):
    assert read_coefficients(file(result(), name="fit.json")) == COEFFICIENTS
    by_prior = result(edge={"verdict": "flat", "interval95": [1.0, 2.0]})
    assert read_coefficients(file(by_prior, name="fit.json")) == COEFFICIENTS


@pytest.mark.parametrize(
    ("text", "name", "message"),
    [
        ("a = = 1", "c.toml", "not valid TOML"),
        (toml(**COEFFICIENTS, axial_edgy=1.0), "c.toml", "did you mean 'axial_edge'"),
        (toml(**COEFFICIENTS | {"axial_edge": "nan"}), "c.toml", "axial_edge is nan"),
        (toml(**COEFFICIENTS | {"axial_edge": "true"}), "c.toml", "axial_edge is True"),
        (toml(**COEFFICIENTS | {"axial_edge": "'1'"}), "c.toml", "write a finite number"),
        (toml(tangential_shear=1.0), "c.toml", "there is no radial_shear: add it"),
        ("{", "c.json", "not the result of a fit"),
        ("[1]", "c.json", "not the result of a fit"),
        (json.dumps({"parameters": {"wear_ratio": 1.0}}), "c.json", "not the result of a fit"),
        (result(converged=False, status="ran out"), "c.json", r"did not converge \(ran out\)"),
        (
            result(edge={"verdict": "flat", "interval95": None}),
            "c.json",
            "the forces left tangential_edge open: measure at another feed",
        ),
    ],
)
def test_faulty_coefficients(file, text, name, message):
    with pytest.raises(InputError, match=message) as raised:
        read_coefficients(file(text, name=name))
    assert name in str(raised.value)
