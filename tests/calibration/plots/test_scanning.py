"""The picture of scanning paths holds what it says."""

import numpy as np
import pytest
import shapely
from matplotlib.collections import LineCollection

from calibration.plots.figures import save
from calibration.plots.scanning import draw_scanning
from procmodel.wear.layer_path import ElectrodeSection
from procmodel.wear.scanning import scan_layers
from procmodel.wear.slicing import slices_of_outline, slices_of_slot

ELECTRODE = ElectrodeSection("round", 40.0)


@pytest.mark.parametrize("layers", [1, 2, 9])
def test_paths_and_layers_are_drawn(layers, tmp_path):
    apart = shapely.box(-150, -100, 150, 100).difference(shapely.box(-20, -20, 20, 20))
    slices = slices_of_outline(apart, np.arange(1.0, layers + 1) * 20.0, 1.4)
    paths = scan_layers(slices, ELECTRODE, 1.0)
    figure = draw_scanning(slices, paths, ELECTRODE, 1.0)
    titled = [axes for axes in figure.axes if axes.get_title(loc="left").startswith("layer ")]
    assert len(titled) == min(layers, 4)
    assert titled[-1].get_title(loc="left").startswith(f"layer {layers}:")
    cut = [c for c in titled[0].collections if isinstance(c, LineCollection)][-1]
    assert len(cut.get_segments()) == int(paths[0].cutting.sum())
    # The order is what the colour shows.
    assert np.all(np.diff(cut.get_array()) >= 0) and cut.get_array()[-1] == pytest.approx(1.0)
    picture = tmp_path / "paths.png"
    save(figure, picture)
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_long_parts_lie_above_one_another():
    slot = slices_of_slot(400.0, 40.0, np.arange(1.0, 7.0))
    figure = draw_scanning(slot, scan_layers(slot, ELECTRODE), ELECTRODE)
    columns = {axes.get_subplotspec().get_gridspec().ncols for axes in figure.axes[:4]}
    assert columns == {1}
