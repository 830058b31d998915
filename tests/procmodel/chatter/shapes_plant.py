"""The reference case of milling with regeneration, and a simulation of it by other means.

The case (one mode along the feed, two teeth) and its values are Insperger's and Stepan's, the
multipliers converged ones. The other simulation goes tooth by tooth with a Runge-Kutta step and
looks up the past by linear interpolation over the angle.
"""

import math

import numpy as np

from procmodel.chatter.cutting import Cut, CuttingCoefficients, Tool, engaged_between
from procmodel.chatter.dynamics import Plant, advance, start
from procmodel.chatter.modes import Modes

FEED = 1e-4
MODE = Modes(922.0, 0.011, 0.03993)
TOOL = Tool(2)
COEFFICIENTS = CuttingCoefficients(6e8, 2e8)
SLOT = Cut(0.0, math.pi, FEED)
DOWN = Cut(*engaged_between(0.5, "down"), FEED)
UP = Cut(*engaged_between(0.5, "up"), FEED)
# Engagement, axial depth [m] and |mu| at 5000 1/min.
KNOWN = [
    (SLOT, 0.2e-3, 0.81974278),
    (SLOT, 0.5e-3, 1.07397559),
    (SLOT, 1.0e-3, 1.40647353),
    (DOWN, 0.5e-3, 0.81238294),
    (UP, 0.5e-3, 1.30585907),
]
KNOWN_NAMES = ["slot 0.2 mm", "slot 0.5 mm", "slot 1.0 mm", "down", "up"]
SPEED = 5000.0 / 60.0
FLIP_SPEED = 12500.0 / 60.0


def plant(steps=404, speed=SPEED, cut=SLOT, tool=TOOL, modes=MODE, **rest):
    """Plant at one speed, with so many steps in a tooth's pitch."""
    limits = {"slowest": speed, "fastest": speed} | {
        k: rest.pop(k) for k in ("slowest", "fastest") if k in rest
    }
    step = rest.pop("step", 1.0 / (speed * tool.teeth * steps))
    return Plant(modes, tool, cut, COEFFICIENTS, step=step, **limits, **rest)


def run(plant, speed, depth, steps, blocks=1, state=None):
    """Tip over several blocks, shape (blocks * steps, 2)."""
    state = start(plant, speed) if state is None else state
    tips = []
    for _ in range(blocks):
        state, signals = advance(plant, state, np.full(steps, speed), depth)
        tips.append(np.asarray(signals.tip))
    return np.concatenate(tips)


def decay_ratio(values):
    """Magnitude of the roots of the recurrence of two terms that values obey, its last part."""
    x = np.asarray(values)
    rows = np.stack([x[1:-1], x[:-2]], axis=1)
    scale = 1.0 / np.linalg.norm(rows, axis=1)
    found = np.linalg.lstsq(rows * scale[:, None], x[2:] * scale, rcond=None)[0]
    return np.max(np.abs(np.roots([1.0, *-found])))


def multiplier(plant, speed, depth, steps, state, size, pitches=60, settle=20):
    """|mu| of a small disturbance, from one pitch to the next."""
    moved = state._replace(displacement=state.displacement + size)
    apart = []
    for _ in range(pitches):
        state, _ = advance(plant, state, np.full(steps, speed), depth)
        moved, _ = advance(plant, moved, np.full(steps, speed), depth)
        apart.append(float(moved.displacement[0] - state.displacement[0]))
    return decay_ratio(apart[settle:])


def strongest(signal, rate, forced=None):
    """Frequency of the highest line of a spectrum, multiples of a forced one left out."""
    x = signal - np.mean(signal)
    size = 1 << 21
    spectrum = np.abs(np.fft.rfft(x * np.hanning(len(x)), size))
    frequency = np.arange(len(spectrum)) * rate / size
    if forced:
        away = np.abs(frequency - forced * np.round(frequency / forced))
        spectrum = np.where(away < 0.02 * forced, 0.0, spectrum)
    return frequency[np.argmax(spectrum)]


def by_other_means(modes, tool, cut, speed, depth, step, passes):
    """Tip at every step, tool straight-fluted, several modes; shapes (n,) of speed and depth."""
    w, zeta, mass = (np.asarray(v) for v in (modes.angular, modes.damping, modes.mass))
    way, feed = np.asarray(modes.direction), float(cut.feed_per_tooth)
    runout, teeth = np.asarray(tool.runout), tool.teeth
    begin, end = float(cut.start), float(cut.exit)
    kt, kn = float(COEFFICIENTS.tangential), float(COEFFICIENTS.normal)
    count, q = len(speed), len(w)
    turned = np.concatenate([[0.0], np.cumsum(speed * step)])
    # Before the start the spindle turns at the first speed, the tip at rest.
    before = np.array([-2.0 * passes, -1e-9])
    tips = np.zeros((count + 1, 2))

    def past(at, known):
        angles = np.concatenate([before, turned[: known + 1]])
        moves = np.concatenate([np.zeros((2, 2)), tips[: known + 1]])
        return [np.interp(at, angles, moves[:, i]) for i in (0, 1)]

    def rate(y, at, known, a):
        tip = y[:q] @ way
        back = np.stack(past(at - np.arange(1, passes + 1) / teeth, known), axis=1)
        force = np.zeros(2)
        for tooth in range(teeth):
            phi = 2.0 * np.pi * ((at + tooth / teeth) % 1.0)
            if not begin <= phi <= end:
                continue
            n = np.array([math.sin(phi), math.cos(phi)])
            t = np.array([math.cos(phi), -math.sin(phi)])
            chip = min(
                n @ (tip - back[k - 1])
                + k * feed * n[0]
                + runout[tooth]
                - runout[(tooth + k) % teeth]
                for k in range(1, passes + 1)
            )
            force -= a * max(chip, 0.0) * (kt * t + kn * n)
        return np.concatenate([y[q:], way @ force / mass - 2.0 * zeta * w * y[q:] - w**2 * y[:q]])

    y = np.zeros(2 * q)
    for i in range(count):
        a, b, m = turned[i], turned[i + 1], 0.5 * (turned[i] + turned[i + 1])
        k1 = rate(y, a + 1e-12, i, depth[i])
        k2 = rate(y + 0.5 * step * k1, m, i, depth[i])
        k3 = rate(y + 0.5 * step * k2, m, i, depth[i])
        k4 = rate(y + step * k3, b - 1e-12, i, depth[i])
        y = y + step / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
        tips[i + 1] = y[:q] @ way
    return tips
