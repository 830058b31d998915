"""Templates of programs, the shipped one and a user's own."""

import pytest

from procmodel.errors import InputError
from procmodel.io import ProgramLayer, Scanning, program_text, read_template


@pytest.fixture
def template(tmp_path):
    def write(text):
        path = tmp_path / "ours.toml"
        path.write_text(text)
        return path

    return write


def test_entries_left_out_keep_their_generic_text(template):
    ours = read_template(template('footer = """\nG28\nM2\n"""'))
    assert ours.footer == "G28\nM2"
    assert ours.layer == read_template().layer


def test_fields_take_formats(template):
    path = template(
        'header = "O1 {{}} N{layer_count:03d} F{scan_feed:.2f}"\n'
        'layer = "Z{z:.2f} X{start_x:+.1f} Y{start_y} {passes}"\n'
        'plunge = "{number}"\nfooter = "%"\n'
    )
    plan = Scanning("square", electrode_radius=50, scan_feed=20, plunge_feed=1)
    assert program_text(read_template(path), [ProgramLayer(4, 18.0, 30.0)], plan) == (
        "O1 {} N001 F20.00\nZ-0.02 X+0.0 Y0.0000 4\n%\n"
    )


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ('footer = "{safez}"', ["unknown field '{safez}'", "'footer'", "did you mean 'safe_z'?"]),
        ('footer = "{z}"', ["unknown field '{z}'", "allowed are shape, layer_count,"]),
        ('footer = "{}"', ["unknown field '{}'", "allowed are"]),
        ('footer = "{shape.upper}"', ["unknown field '{shape.upper}'", "allowed are"]),
        ('foot = "M30"', ["unknown entry 'foot'", "did you mean 'footer'?"]),
        ("footer = 30", ["entry 'footer' is not text", "put it in quotes"]),
        ('footer = "{shape"', ["entry 'footer' has unbalanced braces", "double a brace"]),
        ('footer = "}"', ["entry 'footer' has unbalanced braces", "double a brace"]),
        ('footer = "{safe_z:d}"', ["entry 'footer' cannot be filled in", "{z:.3f}"]),
        ('footer = "{safe_z:{x}}"', ["field '{safe_z}'", "braces in its format"]),
        ('line = "G1 X{x}"', ["entry 'line' lacks '{y}'"]),
        ('layer = "{start_x}{start_y}{z}"', ["entry 'layer' lacks '{passes}'"]),
        ('clockwise_arc = "G2 I{i}"', ["entry 'clockwise_arc' lacks '{j}'"]),
        ("footer = ", ["this is not TOML", "Invalid value", "generic_iso.toml"]),
    ],
)
def test_faulty_templates(template, text, parts):
    with pytest.raises(InputError) as raised:
        read_template(template(text))
    for part in ["ours.toml", *parts]:
        assert part in str(raised.value)


def test_missing_template(tmp_path):
    with pytest.raises(InputError, match=r"none\.toml: no such file"):
        read_template(tmp_path / "none.toml")
