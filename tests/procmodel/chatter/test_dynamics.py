"""The plant against closed forms, printed multipliers, a simulation by other means, differences."""

import functools
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from procmodel.chatter import dynamics
from procmodel.chatter.cutting import Cut, CuttingCoefficients, Tool
from procmodel.chatter.dynamics import Plant, ProcessNoise, advance, start
from procmodel.chatter.modes import Modes, Sensors, mode_propagator
from procmodel.engagement import ForceCoefficients, mean_force
from procmodel.errors import InputError
from tests.procmodel.chatter.shapes_plant import (
    DOWN,
    FEED,
    FLIP_SPEED,
    KNOWN,
    KNOWN_NAMES,
    MODE,
    SLOT,
    SPEED,
    TOOL,
    UP,
    by_other_means,
    multiplier,
    plant,
    run,
    strongest,
)

TWO = Modes([922.0, 1340.0], [0.011, 0.03], [0.04, 0.05], [[0.8, 0.6], [-0.6, 0.8]])


def test_without_a_chip_a_vibration_decays_exactly():
    there = plant(modes=TWO)
    state = start(there, SPEED)._replace(displacement=jnp.array([1e-5, -2e-5]))
    after, signals = advance(there, state, np.full(1000, SPEED), 0.0)
    w, zeta = np.asarray(TWO.angular), np.asarray(TWO.damping)
    damped, time = w * np.sqrt(1.0 - zeta**2), 1000 * there.step
    free = np.array([1e-5, -2e-5]) * np.exp(-zeta * w * time)
    expected = free * (np.cos(damped * time) + zeta * w / damped * np.sin(damped * time))
    np.testing.assert_allclose(after.displacement, expected, rtol=1e-10)
    assert np.all(np.asarray(signals.force) == 0.0)
    # A period later it has lost exp(-2 pi zeta / sqrt(1 - zeta^2)).
    moved = mode_propagator(w, zeta, 2.0 * np.pi / damped)
    lost = np.exp(-2.0 * np.pi * zeta / np.sqrt(1.0 - zeta**2))
    np.testing.assert_allclose([moved[0], moved[3]], [lost, lost], rtol=1e-12)
    np.testing.assert_allclose(moved[1], 0.0, atol=1e-17)


def test_a_stiff_tool_bends_as_under_a_static_force():
    # Far above the tooth passing, well damped: the tip follows the force.
    stiff = Modes([9000.0, 9000.0], [0.7, 0.7], [0.02, 0.03], [[1, 0], [0, 1]])
    tool = Tool(4, radius=0.005, helix=math.radians(30.0))
    there = plant(800, 20.0, UP, tool, stiff, slices=32)
    state = start(there, 20.0)
    for _ in range(4):
        state, signals = advance(there, state, np.full(800, 20.0), 4e-3)
    tip, bent = np.asarray(signals.tip), np.asarray(signals.force @ stiff.compliance)
    assert np.max(np.abs(tip - bent)) < 0.02 * np.max(np.abs(bent))
    # Over a turn the mean is the force of the milling room, the waves on the surface aside.
    in_mm = ForceCoefficients(600.0, 200.0, 0.0, 0.0, 0.0, 0.0)
    expected = mean_force(in_mm, UP.start, UP.exit, 4, 4.0, FEED * 1e3)[:2]
    np.testing.assert_allclose(np.mean(signals.force, axis=0), expected, rtol=2e-3)


@pytest.mark.parametrize(("cut", "depth", "known"), KNOWN, ids=KNOWN_NAMES)
def test_growth_of_the_reference_case(cut, depth, known):
    # 404 steps in a pitch of 6 ms, 67.3 kHz; the printed values have 8 decimals.
    there = plant(404, cut=cut, regeneration="linear")
    found = multiplier(there, SPEED, depth, 404, start(there, SPEED), 1e-6)
    assert found == pytest.approx(known, abs=5e-4)


@pytest.mark.parametrize(("pitches", "steps"), [(3, 1214), (4, 1617)])
def test_a_pitch_need_not_be_whole_steps(pitches, steps):
    # 404 2/3 and 404 1/4 steps: the past lies between two of them.
    there = plant(steps / pitches, regeneration="linear")
    state = start(there, SPEED)
    found = multiplier(there, SPEED, 0.5e-3, steps, state, 1e-6, pitches=20, settle=6)
    assert found ** (1.0 / pitches) == pytest.approx(1.07397559, abs=5e-4)


@pytest.mark.slow
@pytest.mark.parametrize(("cut", "depth", "known"), [KNOWN[1], KNOWN[3]], ids=["slot", "down"])
def test_the_error_falls_with_the_square_of_the_step(cut, depth, known):
    errors = []
    for steps in (101, 202, 404, 808):
        there = plant(steps, cut=cut, regeneration="linear")
        errors.append(
            abs(multiplier(there, SPEED, depth, steps, start(there, SPEED), 1e-6) - known)
        )
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert np.all((orders > 1.9) & (orders < 2.3))
    assert errors[-1] < 1e-4


def periodic(there, depth, steps):
    """State on the forced motion: what comes back after a pitch, the surface without waves."""
    state = start(there, SPEED)
    alone = plant(steps, cut=there.cut, regeneration="none")

    def after(q, v):
        begun = start(alone, SPEED)._replace(displacement=q, velocity=v)
        begun = begun._replace(force=advance(alone, begun, np.full(steps, SPEED), depth)[0].force)
        end, signals = advance(alone, begun, np.full(steps, SPEED), depth)
        return np.array([end.displacement[0], end.velocity[0]]), end, signals

    zero = after(jnp.zeros(1), jnp.zeros(1))[0]
    columns = [
        after(jnp.array([1.0 * (i == 0)]), jnp.array([1.0 * (i == 1)]))[0] - zero for i in (0, 1)
    ]
    q, v = np.linalg.solve(np.eye(2) - np.stack(columns, axis=1), zero)
    _, end, _ = after(jnp.array([q]), jnp.array([v]))
    # The tip at the steps of a pitch, over and over.
    held = there.history
    tip, at = np.zeros((steps, 2)), (np.array([q]), np.array([v]))
    begun = start(alone, SPEED)._replace(
        displacement=jnp.array([q]), velocity=jnp.array([v]), force=end.force
    )
    for i in range(steps):
        tip[i, 0] = at[0][0]
        begun, _ = advance(alone, begun, np.full(1, SPEED), depth)
        at = np.asarray(begun.displacement), np.asarray(begun.velocity)
    back = np.arange(1 - held, 1) % steps
    return state._replace(
        tip=jnp.asarray(tip[back]),
        displacement=jnp.array([q]),
        velocity=jnp.array([v]),
        force=end.force,
    )


@pytest.mark.slow
@pytest.mark.parametrize(("depth", "known"), [(0.2e-3, 0.81974278), (0.5e-3, 1.07397559)])
def test_small_disturbances_of_the_periodic_motion_grow_by_the_multiplier(depth, known):
    # The whole law, with the tool that may leave the cut and surfaces of several passes.
    there = plant(404)
    state = periodic(there, depth, 404)
    end, _ = advance(there, state, np.full(404, SPEED), depth)
    # It is periodic: a pitch later it is where it was.
    np.testing.assert_allclose(end.displacement, state.displacement, rtol=1e-4)
    found = multiplier(there, SPEED, depth, 404, state, 1e-11)
    assert found == pytest.approx(known, abs=1e-3)


@pytest.mark.parametrize(
    ("modes", "tool", "cut", "depth", "leaves"),
    [
        (MODE, TOOL, SLOT, 1.0e-3, False),
        (TWO, Tool(3, runout=[0.0, 25e-6, -10e-6]), UP, 0.8e-3, True),
        (TWO, TOOL, DOWN, 2.0e-3, True),
    ],
    ids=["slot", "two modes, runout", "leaving the cut"],
)
def test_against_a_simulation_by_other_means(modes, tool, cut, depth, leaves):
    # Spindle speed and depth change as well; chatter, and teeth that miss the stock.
    count, step = 1600, 1.0 / 102400.0
    time = (np.arange(count) + 0.5) * step
    speed = SPEED * (1.0 + 30.0 * time)
    deep = depth * np.minimum(1.0, time / 4e-3)
    there = plant(1, SPEED, cut, tool, modes, step=step, slowest=60.0, fastest=140.0)
    _, signals = advance(there, start(there, SPEED), speed, deep)
    other = by_other_means(modes, tool, cut, speed, deep, step, there.passes)
    middle = 0.5 * (other[1:] + other[:-1])
    size = np.sqrt(np.mean(np.square(middle)))
    assert np.sqrt(np.mean(np.square(signals.tip - middle))) < 0.01 * size
    # Where the tool leaves the cut, it would be another motion against the last pass alone.
    last = plant(
        1, SPEED, cut, tool, modes, step=step, slowest=60.0, fastest=140.0, regeneration="last"
    )
    _, wrong = advance(last, start(last, SPEED), speed, deep)
    assert (np.sqrt(np.mean(np.square(wrong.tip - middle))) > 0.03 * size) == leaves


@pytest.mark.slow
def test_chatter_frequencies():
    # Period doubling at 5 times the rotation, exactly so while the chip is against one pass; the
    # surfaces of earlier passes make it drift, by the other simulation as well.
    for regeneration, expected in (("last", 5.0), ("several", 5.0377)):
        there = plant(300, FLIP_SPEED, regeneration=regeneration)
        tip = run(there, FLIP_SPEED, 3e-3, 3000, blocks=30)[45_000:, 0]
        found = strongest(tip, 1.0 / there.step, forced=2.0 * FLIP_SPEED)
        assert found / FLIP_SPEED == pytest.approx(expected, abs=1e-3)
    # Quasi-periodic chatter at 5000 1/min, at 945 Hz.
    there = plant(404)
    tip = run(there, SPEED, 0.5e-3, 4040, blocks=40)[80_000:, 0]
    assert strongest(tip, 1.0 / there.step) == pytest.approx(945.0, abs=1.0)


def once_per_turn(there, depth):
    """Share of the line at the rotation in the tip's motion along the feed."""
    tip = run(there, SPEED, depth, 8080, blocks=8)[-8080:, 0]
    lines = np.abs(np.fft.rfft(tip - np.mean(tip)))
    return lines[10] / np.max(lines)


def test_runout_gives_a_line_at_the_rotation():
    # Ten turns in a block, stable: without runout the motion repeats every pitch.
    assert once_per_turn(plant(404), 0.1e-3) < 1e-6
    assert once_per_turn(plant(404, tool=Tool(2, runout=[0.0, 10e-6])), 0.1e-3) > 1e-2


def test_imbalance_in_air_gives_the_response_of_the_mode():
    there = plant(404, tool=Tool(2, imbalance=1e-5))
    tip = run(there, SPEED, 0.0, 8080, blocks=12)[-8080:, 0]
    found = 2.0 * np.abs(np.fft.rfft(tip)[10]) / 8080
    ratio = SPEED / 922.0
    force = 1e-5 * (2.0 * math.pi * SPEED) ** 2
    stiffness = 0.03993 * (2.0 * math.pi * 922.0) ** 2
    expected = force / stiffness / math.hypot(1.0 - ratio**2, 2.0 * 0.011 * ratio)
    assert found == pytest.approx(expected, rel=1e-4)


@pytest.mark.slow
def test_blocks_together_are_one():
    noise = ProcessNoise(1e-3, 1e-3)
    there = plant(1, step=1e-5, slowest=60.0, fastest=120.0, noise=noise, modes=TWO, slices=2)
    speed, depth = np.linspace(70.0, 110.0, 3000), np.linspace(0.0, 1e-3, 3000)
    end, whole = advance(there, start(there, 70.0, 5), speed, depth)
    state, parts = start(there, 70.0, 5), []
    for rows in np.split(np.arange(3000), 3):
        state, signals = advance(there, state, speed[rows], depth[rows])
        parts.append(signals)
    size = np.max(np.abs(np.asarray(whole.tip)))
    tips = np.concatenate([p.tip for p in parts])
    # The rotation is added up in another order, by which an edge of the cut moves by rounding.
    np.testing.assert_allclose(tips, whole.tip, atol=1e-9 * size)
    np.testing.assert_allclose(state.displacement, end.displacement, atol=1e-9 * size)
    assert int(state.steps) == int(end.steps) == 3000
    _, other = advance(there, start(there, 70.0, 6), speed, depth)
    assert np.max(np.abs(np.asarray(other.tip - whole.tip))) > 1e-3 * size


def test_blocks_of_one_length_share_a_compilation(monkeypatch):
    traced, kept = [], dynamics._together
    monkeypatch.setattr(dynamics, "_together", lambda *a: traced.append(a[5]) or kept(*a))
    there = plant(400, slowest=50.0, fastest=SPEED)
    state, _ = advance(there, start(there, SPEED), np.full(640, SPEED), 1e-4)
    first = len(traced)
    other = plant(400, slowest=50.0, fastest=SPEED, modes=Modes(800.0, 0.02, 0.05), cut=DOWN)
    advance(there, state, np.linspace(SPEED, 60.0, 640), 5e-4)
    advance(other, state, np.full(640, 55.0), np.linspace(0.0, 1e-3, 640))
    assert first > 0 and len(traced) == first
    advance(there, state, np.full(641, SPEED), 1e-4)
    assert len(traced) > first


def test_white_force_noise_gives_the_variance_of_the_mode():
    level = 0.05
    there = plant(60, noise=ProcessNoise(0.0, level))
    tip = run(there, SPEED, 0.0, 60_000, blocks=4)[20_000:, 0]
    w = 2.0 * math.pi * 922.0
    expected = level**2 / (8.0 * 0.011 * w**3 * 0.03993**2)
    # About 1,400 independent times of the mode's decay: 5 standard errors.
    assert np.var(tip) == pytest.approx(expected, rel=0.2)
    # Half the level would not pass.
    assert np.var(tip) != pytest.approx(0.25 * expected, rel=0.2)


def test_sensors_mix_the_modes():
    sensors = Sensors([[0.5, 0.25]], [[2.0, 1.0], [0.0, 3.0]])
    there, bare = (plant(404, modes=TWO, **rest) for rest in ({"sensors": sensors}, {}))
    speed = np.full(2000, SPEED)
    _, mixed = advance(there, start(there, SPEED), speed, 2e-4)
    _, tip = advance(bare, start(bare, SPEED), speed, 2e-4)
    inverse = np.linalg.inv(np.asarray(TWO.direction))
    modal = np.asarray(tip.tip) @ inverse
    np.testing.assert_allclose(mixed.displacement[:, 0], modal @ [0.5, 0.25], rtol=1e-9, atol=1e-15)
    # The acceleration is the second difference of the displacement, away from jumps of the force.
    second = np.diff(np.asarray(tip.tip), 2, axis=0) / there.step**2
    error = np.asarray(tip.acceleration)[1:-1] - second
    assert np.sqrt(np.mean(error**2)) < 0.02 * np.sqrt(np.mean(second**2))
    modal = np.asarray(tip.acceleration) @ inverse
    expected = modal @ np.array([[2.0, 0.0], [1.0, 3.0]])
    np.testing.assert_allclose(mixed.acceleration, expected, rtol=1e-9, atol=1e-6)


@pytest.mark.slow
def test_gradients_against_differences():
    def end(values):
        modes = Modes(values[:2], values[2:4], values[4:6], TWO.direction)
        tool = Tool(2, 0.005, values[12], jnp.stack([jnp.zeros(()), values[6]]))
        cut = Cut(0.0, 0.5 * math.pi, values[7])
        there = Plant(
            modes,
            tool,
            cut,
            CuttingCoefficients(values[8], values[9], 0.0, 2e3),
            step=2e-5,
            slowest=60.0,
            fastest=100.0,
            slices=3,
        )
        speed = values[10] * jnp.ones(400)
        _, signals = advance(there, start(there, 80.0), speed, values[11])
        return jnp.sum(jnp.square(1e6 * signals.tip)) + 1e-3 * signals.acceleration[-1, 0]

    at = jnp.array([922.0, 1340.0, 0.011, 0.03, 0.04, 0.05, 1e-5, FEED, 6e8, 2e8, 80.0, 6e-4, 0.5])
    backward = jax.jit(jax.grad(end))(at)
    # Forwards as well, in a direction that moves everything by its own size.
    _, forward = jax.jit(lambda x: jax.jvp(end, (x,), (x,)))(at)
    assert float(forward) == pytest.approx(float(backward @ at), rel=1e-8)
    end = jax.jit(end)
    for i in range(len(at)):
        step = np.zeros(len(at))
        step[i] = 1e-6 * at[i]
        difference = (end(at + step) - end(at - step)) / (2.0 * step[i])
        # The speed moves the instants at which teeth enter: smooth only on average.
        assert float(backward[i]) == pytest.approx(float(difference), rel=1e-3 if i == 10 else 1e-5)


@pytest.mark.slow
def test_many_plants_at_once():
    depths = jnp.array([1e-4, 5e-4, 1e-3])
    there = plant(200)
    state, speed = start(there, SPEED), np.full(600, SPEED)
    together = jax.vmap(lambda a: advance(there, state, speed, a)[1].tip)(depths)
    for i, depth in enumerate(depths):
        alone = advance(there, state, speed, depth)[1].tip
        np.testing.assert_allclose(together[i], alone, rtol=1e-9, atol=1e-15)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (functools.partial(plant, slices=0), r"^slices is 0, but must be a whole number, 1 or"),
        (functools.partial(plant, regeneration="lst"), r"'lst' is unknown; did you mean 'last'\?"),
        (functools.partial(plant, step=0.0), r"^step is 0 s, but must be above 0\.$"),
        (functools.partial(plant, 3), r"fewer than 4 of them; make it 0\.0015 s or shorter\.$"),
        (functools.partial(plant, slowest=99.0), r"must be above 0 and in this order\.$"),
        (
            functools.partial(plant, sensors=Sensors([[1.0, 1.0]], [[1.0]])),
            r"^displacement gain has 2 columns, but there are 1 modes\.$",
        ),
        (lambda: Modes(922.0, 1.2, 0.04), r"^damping is 1\.2, but must be at least 0 and at most"),
        (lambda: Modes([9.0, 8.0], [0.1], [1.0, 1.0]), r"^damping has the shape \(1,\), but 2"),
        (lambda: Modes(0.0, 0.1, 1.0), r"^frequency is 0 Hz, but must be above 0\.$"),
    ],
)
def test_bad_settings(make, message):
    with pytest.raises(InputError, match=message):
        make()


def test_bad_speed_and_depth():
    there = plant(404, slowest=50.0, fastest=90.0)
    with pytest.raises(InputError, match=r"^the rotation is 91 rev/s, .* 50 to 90; widen slowest"):
        advance(there, start(there, 50.0), np.array([60.0, 91.0]), 0.0)
    with pytest.raises(InputError, match=r"^the rotation is nan rev/s"):
        start(there, math.nan)
    with pytest.raises(InputError, match=r"^depth is -1 m, but must be at least 0\.$"):
        advance(there, start(there, 50.0), np.array([60.0, 61.0]), -1.0)
