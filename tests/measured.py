"""Where measured recordings and profiles lie; tests that read them skip where they are absent."""

import os
from pathlib import Path

import pytest

MEASURED = Path(os.environ.get("PROCMODEL_DATA", Path(__file__).parents[2] / "shared" / "data"))
OUTLINES = MEASURED / "edm_sinking"
MILLING_CUT = MEASURED / "milling_chatter" / "data.mat"


def needs(path):
    """A mark for tests that read what lies there."""
    return pytest.mark.skipif(
        not path.exists(), reason=f"no measured data: {path} is absent; set PROCMODEL_DATA"
    )
