"""How much of everything a run does."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Sizes:
    """Numbers of repeats and sizes of the problems."""

    fit_repeats: int
    batch: int
    batch_repeats: int
    readings: tuple[int, ...]
    layers: tuple[int, ...]
    growth_repeats: int
    cavities: int
    process_repeats: int
    plan_layers: tuple[int, ...]
    plan_repeats: int
    seeds: int
    simulated: int
    places: int
    shapely_places: int
    path_repeats: int
    path_places: tuple[int, ...]
    path_pieces: tuple[int, ...]
    chatter_seconds: float
    chatter_repeats: int
    chatter_recordings: tuple[float, ...]
    chatter_blocks: int
    chatter_hours: int
    electrode_steps: int
    electrode_repeats: int
    plant_seconds: float


FULL = Sizes(
    fit_repeats=11,
    batch=1000,
    batch_repeats=5,
    readings=(100, 1000, 10_000),
    layers=(100, 1000),
    growth_repeats=5,
    cavities=1000,
    process_repeats=7,
    plan_layers=(125, 500),
    plan_repeats=5,
    seeds=12,
    simulated=500,
    places=10_000,
    shapely_places=200,
    path_repeats=7,
    path_places=(10_000, 100_000, 1_000_000),
    path_pieces=(100, 1000, 10_000),
    chatter_seconds=160.0,
    chatter_repeats=5,
    chatter_recordings=(10.0, 100.0, 400.0),
    chatter_blocks=5000,
    chatter_hours=8,
    electrode_steps=1_000_000,
    electrode_repeats=9,
    plant_seconds=2.0,
)

# For trying the parts out: the figures mean nothing.
QUICK = Sizes(
    fit_repeats=3,
    batch=20,
    batch_repeats=2,
    readings=(100, 1000),
    layers=(100, 200),
    growth_repeats=2,
    cavities=40,
    process_repeats=2,
    plan_layers=(25, 50),
    plan_repeats=2,
    seeds=3,
    simulated=20,
    places=1000,
    shapely_places=5,
    path_repeats=2,
    path_places=(1000, 10_000),
    path_pieces=(100, 1000),
    chatter_seconds=8.0,
    chatter_repeats=2,
    chatter_recordings=(2.0, 10.0),
    chatter_blocks=200,
    chatter_hours=1,
    electrode_steps=10_000,
    electrode_repeats=3,
    plant_seconds=0.5,
)
