"""Effective draws per second by replication: our samplers beside emcee on four posteriors."""

import time
from collections.abc import Callable
from dataclasses import dataclass

import emcee
import numpy as np

from benchmarks import measure
from benchmarks.posteriors import Posterior, posteriors
from benchmarks.report import Section
from benchmarks.sizes import Sizes
from calibration import FitResult, fit, sample

BESIDE_EMCEE, BESIDE_EMCEE_ON_WEAR, BESIDE_BEST = 10.0, 20.0, 0.5
EACH, ALL = "emcee, one walker at a time", "emcee, all walkers at once"
# One walker at a time makes the same draws: a few runs tell how long they take.
TIMED = 3


@dataclass(frozen=True)
class Replicated:
    """What many runs of a contestant with different seeds gave.

    Attributes
    ----------
    seconds : ndarray, shape (seeds,)
        Of each run, start and diagnostics included.
    means : ndarray, shape (seeds, p)
        Mean of each run.
    note : str
        What the contestant said of itself.
    """

    seconds: np.ndarray
    means: np.ndarray
    note: str = ""

    def effective(self, variance: np.ndarray) -> float:
        """Draws that a run is worth: how much less its means scatter than single draws."""
        return len(variance) / float(np.sum(np.var(self.means, axis=0, ddof=1) / variance))

    def rate(self, variance: np.ndarray) -> float:
        """Effective draws per second."""
        return self.effective(variance) / float(np.median(self.seconds))


def run(section: Section, sizes: Sizes) -> None:
    section.text(
        f"Every contestant samples each posterior with {sizes.seeds} seeds. Its effective draws "
        "are the variance of the posterior over the variance of its means from seed to seed, "
        "taken together over the parameters, with a relative error of about "
        f"{100 * np.sqrt(2.0 / (sizes.seeds - 1)):.0f} % for one parameter, less for more. No "
        "autocorrelation formula is in it. Ours is `calibration.sample` as it comes: with the "
        "start's fit, the diagnostics and the labelled tree. emcee has a NumPy density, as many "
        "walkers, and starts around the same optimum; it makes no diagnostics."
    )
    for posterior in posteriors():
        _one(section, posterior, sizes.seeds)


def _one(section: Section, posterior: Posterior, seeds: int) -> None:
    section.heading(posterior.title[0].upper() + posterior.title[1:])
    start = fit(posterior.problem)
    contestants = {
        "stretch": _ours(posterior, "stretch"),
        "nuts": _ours(posterior, "nuts"),
        ALL: _emcee(posterior, start, vectorize=True),
    }
    compiling = {name: measure.first_call(lambda c=c: c(0))[0] for name, c in contestants.items()}
    found = {name: _replicated(call, seeds) for name, call in contestants.items()}
    slow = _replicated(_emcee(posterior, start, vectorize=False), min(TIMED, seeds))
    found[EACH] = Replicated(slow.seconds, found[ALL].means)
    chosen = str(sample(posterior.problem, seed=1, sampler="auto").attrs["sampler"])
    variance = _variance(posterior)
    rates = {name: runs.rate(variance) for name, runs in found.items()}
    section.table(
        ["contestant", "time of a run", "first call", "effective draws", "per second", "said"],
        [
            [
                f"{name} (what `auto` takes)" if name == chosen else name,
                measure.time_spread(runs.seconds),
                f"{compiling[name]:.1f} s" if name in compiling else "",
                f"{runs.effective(variance):.0f}",
                f"{rates[name]:.0f}",
                runs.note,
            ]
            for name, runs in found.items()
        ],
    )
    wear = posterior.title.startswith("wear")
    wanted = BESIDE_EMCEE_ON_WEAR if wear else BESIDE_EMCEE
    for peer in (EACH, ALL):
        ratio = rates[chosen] / rates[peer]
        section.target(
            f"effective draws per second, {posterior.title}, beside {peer}",
            f"at least {wanted:g} times",
            f"{ratio:.1f} times",
            ratio >= wanted,
        )
    best = max(rates["stretch"], rates["nuts"])
    section.target(
        f"what `sample` chose, {posterior.title}",
        "at least half of the better of stretch and nuts",
        f"{chosen}: {rates[chosen] / best:.2f} of it",
        rates[chosen] >= BESIDE_BEST * best,
    )
    _agree(section, posterior, found[chosen], found[ALL], variance, chosen)


def _agree(
    section: Section,
    posterior: Posterior,
    ours: Replicated,
    theirs: Replicated,
    variance: np.ndarray,
    chosen: str,
) -> None:
    """All have to sample the same distribution: means within their scatter from seed to seed."""
    errors = [np.var(r.means, axis=0, ddof=1) / len(r.means) for r in (ours, theirs)]
    off = (ours.means.mean(axis=0) - theirs.means.mean(axis=0)) / np.sqrt(errors[0] + errors[1])
    worst = float(np.max(np.abs(off)))
    # Student's t of so many seeds: 5 is about what 4 is to a normal variate.
    section.target(
        f"means of {chosen} beside emcee, {posterior.title}",
        "within 5 standard errors from seed to seed",
        f"{worst:.1f}",
        worst <= 5.0,
    )


def _replicated(call: Callable[[int], tuple[np.ndarray, str]], seeds: int) -> Replicated:
    call(0)  # what others compiled in between may have pushed this out
    seconds, means, note = [], [], ""
    for seed in range(1, seeds + 1):
        begin = time.perf_counter()
        mean, note = call(seed)
        seconds.append(time.perf_counter() - begin)
        means.append(mean)
    return Replicated(np.array(seconds), np.array(means), note)


def _ours(posterior: Posterior, sampler: str) -> Callable[[int], tuple[np.ndarray, str]]:
    names = posterior.problem.layout.free

    def call(seed: int) -> tuple[np.ndarray, str]:
        tree = sample(posterior.problem, seed, sampler=sampler)
        draws = tree["posterior"].dataset
        mean = np.array([float(np.mean(np.asarray(draws[name]))) for name in names])
        return mean, str(tree.attrs["status"]).split(":")[0]

    return call


def _emcee(
    posterior: Posterior, start: FitResult, vectorize: bool
) -> Callable[[int], tuple[np.ndarray, str]]:
    names = posterior.problem.layout.free
    count, walkers = len(names), max(16, 4 * len(names))
    centre = np.array([start.parameters[name].value for name in names])
    spread = np.array([start.parameters[name].std or 0.1 for name in names])

    def call(seed: int) -> tuple[np.ndarray, str]:
        rng = np.random.default_rng(seed)
        first = centre + spread * rng.normal(size=(walkers, count))
        lower, upper = posterior.problem.layout.natural_bounds()
        first = np.clip(first, lower + 1e-3 * spread, upper - 1e-3 * spread)
        sampler = emcee.EnsembleSampler(walkers, count, posterior.log_density, vectorize=vectorize)
        # Left alone, every sampler starts from the same random state.
        random = np.random.RandomState(rng.integers(2**32)).get_state()
        state = sampler.run_mcmc(
            emcee.State(first, random_state=random), posterior.emcee_steps // 2
        )
        sampler.reset()
        sampler.run_mcmc(state, posterior.emcee_steps)
        return sampler.get_chain(flat=True).mean(axis=0), ""

    return call


def _variance(posterior: Posterior) -> np.ndarray:
    """Variance of each parameter from one long run."""
    names = posterior.problem.layout.free
    tree = sample(posterior.problem, 12345, 160_000, "stretch")
    draws = tree["posterior"].dataset
    return np.array([float(np.var(np.asarray(draws[name]))) for name in names])
