"""The names that `calibration` offers, whatever was imported before them."""

import pkgutil
import subprocess
import sys

import calibration


def test_no_name_is_also_a_modules():
    # Importing a module puts it into its package under its own name, over what stood there.
    modules = {module.name for module in pkgutil.iter_modules(calibration.__path__)}
    assert not modules & set(calibration.__all__)


def test_every_name_is_the_thing_named():
    script = (
        "import calibration\n"
        "for name in calibration.__all__:\n"
        "    value = getattr(calibration, name)\n"
        "    assert value.__name__ == name, (name, value)\n"
    )
    subprocess.run([sys.executable, "-c", script], check=True)
