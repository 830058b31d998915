"""The hierarchical model of scores: its density, its posterior, and what cuts count for."""

import functools

import numpy as np
import pytest
import scipy.integrate
import scipy.stats

from calibration.chatter_arrays import NullLaw, arranged
from calibration.chatter_cuts import CutScores
from calibration.chatter_scores import fit_scores, score_problem
from calibration.ranks import uniformity
from procmodel.chatter import null_threshold
from procmodel.errors import InputError
from tests.calibration import labelled_cuts as shapes

# One shape and one length of warm-up, so that most tests share what was compiled.
COUNTS, WINDOWS = (5, 5, 2), 12
SHORT = {"draws": 100, "warmup": 150}
NAMES = ("stable_cut_spread", "chatter_cut_spread", "stable_spread", "chatter_spread")


def values(**changed):
    given = {
        "stable_cut_spread": 0.3, "chatter_cut_spread": 0.4, "stable_spread": 0.25,
        "chatter_spread": 0.35, "stable_correlation": 0.3, "chatter_correlation": -0.2,
        "freedom": 5.0, "marginal_share": 0.4, "tool_spread": 0.5, "tool_gap_spread": 0.3,
        "speed_spread": 0.2,
    }  # fmt: skip
    return given | changed


def density(problem, given):
    """Sum of the engine's log-likelihoods at natural values."""
    inner = {f"log_{name}": np.log(value) for name, value in given.items() if value > 0.0}
    inner |= {f"artanh_{name}": np.arctanh(min(value, 0.99)) for name, value in given.items()}
    vector = np.array([(inner | given)[name] for name in problem.layout.free])
    structure = problem.structure.in_natural_coordinates()
    (parts,) = structure.log_likelihoods(vector, problem.fixed_values, problem.data())
    return float(np.sum(parts))


def some_cuts(count=9, seed=0):
    rng = np.random.default_rng(seed)
    labels = ("stable", "chatter", "marginal", "stable", "chatter")
    return [
        shapes.cut(rng, label, count=count, tool="AB"[i % 2], speed=(9e3, 12e3)[i // 3])
        for i, label in enumerate(labels)
    ]


def levels_covariance(cuts, given):
    """Covariance of the levels v of cuts, and their mean, written out pair by pair."""
    up = {"stable": 0.0, "marginal": given["marginal_share"], "chatter": 1.0}
    spread = {c: given["stable_cut_spread" if c == "stable" else "chatter_cut_spread"] for c in up}
    u = np.array([up[c.label] for c in cuts])
    mean = np.log(10.0) + 2.0 * u
    size = len(cuts)
    covariance = np.empty((size, size))
    for i, a in enumerate(cuts):
        for j, b in enumerate(cuts):
            total = 1.5**2 + 1.5**2 * u[i] * u[j]
            if a.tool == b.tool:
                total += given["tool_spread"] ** 2 + given["tool_gap_spread"] ** 2 * u[i] * u[j]
            if a.spindle_speed == b.spindle_speed:
                total += given["speed_spread"] ** 2
            covariance[i, j] = total + (spread[a.label] ** 2 if i == j else 0.0)
    return mean, covariance


def test_normal_windows_have_the_density_of_one_large_normal_distribution():
    """Against all windows of all cuts at once; constants that no parameter moves are the same.

    The floor under what windows tell, which normal ones never reach, moves it by half a percent:
    2e-3 in the logarithm of the density of five cuts.
    """
    cuts = some_cuts()
    problem = score_problem(cuts)
    found, expected = [], []
    for changed in ({}, {"stable_cut_spread": 0.9}, {"tool_spread": 1.5}, {"speed_spread": 0.9},
                    {"marginal_share": 0.9}, {"stable_correlation": 0.7},
                    {"chatter_spread": 0.2}):  # fmt: skip
        given = values(**changed, freedom=1e6)
        mean, between = levels_covariance(cuts, given)
        sizes = [len(c.scores) for c in cuts]
        of_cut = np.repeat(np.arange(len(cuts)), sizes)
        covariance = between[np.ix_(of_cut, of_cut)]
        for i, cut in enumerate(cuts):
            kind = "stable" if cut.label == "stable" else "chatter"
            apart = np.abs(np.subtract.outer(np.arange(sizes[i]), np.arange(sizes[i])))
            place = np.ix_(of_cut == i, of_cut == i)
            covariance[place] += (
                given[f"{kind}_spread"] ** 2 * given[f"{kind}_correlation"] ** apart
            )
        y = np.concatenate([c.log_scores for c in cuts])
        expected.append(scipy.stats.multivariate_normal.logpdf(y, mean[of_cut], covariance))
        found.append(density(problem, given))
    np.testing.assert_allclose(np.subtract(found, found[0]), np.subtract(expected, expected[0]),
                               atol=2e-3)  # fmt: skip


def cut_density(y, mean, between, phi, s, nu, v):
    """Log density of the windows of a cut and of its level v, by SciPy's distributions."""
    total = scipy.stats.t.logpdf(y[0] - v, nu, scale=s)
    off = y[1:] - v - phi * (y[:-1] - v)
    total += scipy.stats.t.logpdf(off, nu, scale=s * np.sqrt(1 - phi**2)).sum()
    return total + scipy.stats.norm.logpdf(v, mean, np.sqrt(between))


@pytest.mark.parametrize(("count", "tolerance"), [(4, 0.1), (40, 0.02)])
def test_heavy_tails_have_the_density_found_by_quadrature(count, tolerance):
    """One cut, its level integrated out numerically: Laplace is good from a few windows on."""
    rng = np.random.default_rng(3)
    worst = 0.0
    for _ in range(5):
        cut = shapes.cut(rng, "chatter", count=count)
        y = cut.log_scores
        problem = score_problem([cut], null=NullLaw(25, 100))
        level, spread = problem.datasets["cuts"].x["level_mean"], 0.5
        found, expected = [], []
        for given in (values(), values(chatter_spread=0.5, freedom=3.0, chatter_cut_spread=0.6)):
            phi, s, nu = (
                given[f"chatter_{name}"] if name != "freedom" else given[name]
                for name in ("correlation", "spread", "freedom")
            )
            between = spread**2 + 1.5**2 + given["chatter_cut_spread"] ** 2
            between += sum(given[f"{n}_spread"] ** 2 for n in ("tool", "tool_gap", "speed"))

            of_level = functools.partial(cut_density, y, level.sum(), between, phi, s, nu)
            around = np.linspace(y.min() - 1.0, y.max() + 1.0, 1001)
            logs = np.array([of_level(v) for v in around])
            top = logs.max()
            expected.append(top + np.log(scipy.integrate.trapezoid(np.exp(logs - top), around)))
            found.append(density(problem, given))
        worst = max(worst, abs(np.diff(found)[0] - np.diff(expected)[0]))
    assert worst < tolerance


def test_a_cut_left_out_is_as_if_it_were_not_there():
    cuts = some_cuts()
    one, other = values(), values(stable_cut_spread=0.8, chatter_correlation=0.5, tool_spread=1.0)
    for out in (0, 4):
        left = score_problem(cuts, left_out=[out])
        gone = score_problem([c for i, c in enumerate(cuts) if i != out])
        assert density(left, one) - density(left, other) == pytest.approx(
            density(gone, one) - density(gone, other), abs=1e-5
        )


def test_long_cuts_are_used_in_pieces_of_successive_windows():
    cut = CutScores("stable", "A", 1e4, np.arange(1000.0), 0.1, 0.1)
    x = arranged([cut, CutScores("chatter", "A", 1e4, np.arange(5.0), 0.1, 0.1)])
    windows = np.expm1(x["windows"][0])
    first = np.flatnonzero(x["first"][0])
    np.testing.assert_array_equal(first, [0, 16, 32, 48])
    assert windows[0] == 0.0 and windows[-1] == pytest.approx(999.0)
    steps = np.diff(windows)
    np.testing.assert_allclose(np.delete(steps, first[1:] - 1), 1.0)
    assert x["used"][1].sum() == 5


@pytest.fixture(scope="module")
def posterior():
    rng = np.random.default_rng(5)
    cuts = shapes.cuts(rng, *COUNTS, count=WINDOWS)
    return fit_scores(cuts, seed=1, warmup=150)


def test_the_posterior_converges_over_independent_chains_and_holds_the_truth(posterior):
    assert posterior.converged, posterior.status
    assert posterior.tree["posterior"].sizes["chain"] == 4
    assert posterior.tree.attrs["rhat"] < 1.01 and posterior.tree.attrs["ess_bulk"] > 400
    assert posterior.warnings == ()
    truth = shapes.Truth()
    for name in NAMES:
        draws = posterior.draws(name)
        true = truth.cut_spread if "cut" in name else truth.spread
        assert abs(draws.mean() - true) < 4.0 * draws.std(), name
    for label in ("stable", "marginal", "chatter"):
        level = posterior.level(label, "A", 12000.0)
        assert abs(level.mean() - truth.level(label)) < 3.5 * level.std()
        # 5 cuts (2 marginal ones) of spread 0.3 know a level to about 0.13 (0.2), not to the 0.05
        # that 60 windows would.
        assert 0.1 < level.std() < 0.4
    for name in ("stable_correlation", "chatter_correlation"):
        assert abs(posterior.draws(name).mean() - 0.3) < 0.35


def test_an_unseen_tool_is_less_known_than_one_that_was_seen(posterior):
    seen = posterior.level("stable", "A", 12000.0)
    assert posterior.level("stable", None, 12000.0).std() > 1.5 * seen.std()
    assert posterior.level("stable", "A", None).std() > 1.1 * seen.std()
    with pytest.raises(InputError, match="no cut is of the tool 'B'; known are A"):
        posterior.level("stable", "B", None)
    with pytest.raises(InputError, match="no cut is at 9000 1/min; known are 12000"):
        posterior.level("stable", "A", 9000.0)


def test_same_seed_same_draws():
    cuts = shapes.cuts(np.random.default_rng(0), *COUNTS, count=WINDOWS)
    one, same, other = (fit_scores(cuts, seed=seed, **SHORT) for seed in (1, 1, 2))
    np.testing.assert_array_equal(one.levels, same.levels)
    assert not np.array_equal(one.levels, other.levels)


REPEATS, KEPT = 28, 49


def ranks(parameters=None, repeats=REPEATS):
    """Ranks of true levels and spreads among draws, everything drawn from the priors."""
    rng = np.random.default_rng(11)
    found = {"stable level": [], "gap": [], "stable_cut_spread": [], "chatter_spread": []}
    for repeat in range(repeats):
        problem = score_problem(shapes.cuts(rng, *COUNTS, count=WINDOWS))
        drawn = {n: float(prior.draw(rng, 1)[0]) for n, prior in problem.layout.priors}
        true = {n.removeprefix("log_"): np.exp(value) for n, value in drawn.items()}
        true |= {n.removeprefix("artanh_"): np.tanh(value) for n, value in drawn.items()
                 if n.startswith("artanh_")}  # fmt: skip
        stable = np.log(10.0) + 1.5 * rng.normal() + true["tool_spread"] * rng.normal()
        stable += true["speed_spread"] * rng.normal()
        gap = 2.0 + 1.5 * rng.normal() + true["tool_gap_spread"] * rng.normal()
        cuts = []
        named = zip(("stable", "chatter", "marginal"), COUNTS, strict=True)
        for label in [label for label, count in named for _ in range(count)]:
            kind = "stable" if label == "stable" else "chatter"
            truth = shapes.Truth(
                stable, gap, true[f"{kind}_cut_spread"], true[f"{kind}_spread"],
                true["freedom"], true[f"{kind}_correlation"],
            )  # fmt: skip
            up = {"stable": 0.0, "chatter": 1.0, "marginal": true["marginal_share"]}[label]
            level = stable + up * gap + truth.cut_spread * rng.normal()
            # y itself: below the floor of scores the logarithm would cut it off.
            cuts.append(Exact(label, shapes.windows(rng, level, truth, WINDOWS)))
        posterior = fit_scores(cuts, seed=repeat, parameters=parameters, **SHORT)
        low = posterior.level("stable", "A", 12000.0)
        drawn = {
            "stable level": (low, stable),
            "gap": (posterior.level("chatter", "A", 12000.0) - low, gap),
        }
        for name in ("stable_cut_spread", "chatter_spread"):
            if name not in (parameters or {}):
                drawn[name] = (posterior.draws(name), true[name])
        for name, (draws, truth) in drawn.items():
            kept = draws[np.linspace(0, len(draws) - 1, KEPT).astype(int)]
            found[name].append(int(np.sum(kept < truth)))
    return {name: np.array(each) for name, each in found.items() if each}


class Exact(CutScores):
    """A cut given by y."""

    def __init__(self, label, y):
        super().__init__(label, "A", 12000.0, np.ones(len(y)), 0.16, 0.16)
        object.__setattr__(self, "y", y)

    @property
    def log_scores(self):
        return self.y


def at_the_ends(ranks):
    """Probability of so many ranks among the outer six of fifty, if they were uniform."""
    count = int(np.sum((ranks <= 2) | (ranks >= KEPT - 2)))
    return scipy.stats.binom.sf(count - 1, len(ranks), 6.0 / (KEPT + 1))


@pytest.mark.slow
def test_ranks_of_the_truth_are_uniform():
    for name, each in ranks().items():
        assert uniformity(each, KEPT) > 0.0025, (name, sorted(each))
        assert at_the_ends(each) > 0.01, (name, sorted(each))


@pytest.mark.slow
def test_without_the_effect_of_cuts_the_model_is_overconfident():
    """The negative control: windows counted as if they were independent evidence."""
    alone = {"stable_cut_spread": 1e-3, "chatter_cut_spread": 1e-3}
    found = ranks(alone, repeats=16)
    for name in ("stable level", "gap"):
        assert at_the_ends(found[name]) < 0.005, (name, sorted(found[name]))


def test_without_stable_cuts_the_law_of_noise_stands_for_them():
    null = NullLaw(25, 616)
    assert np.exp(null.quantile(0.99)) == pytest.approx(null_threshold(25, 616, 0.01))
    rng = np.random.default_rng(2)
    chatter = shapes.cuts(rng, 0, 4, count=16)
    with pytest.raises(InputError, match="no cut is labelled stable"):
        score_problem(chatter)
    problem = score_problem(chatter, null=null)
    x = problem.datasets["cuts"].x
    assert x["level_mean"][0] == pytest.approx(np.log(null_threshold(25, 616, 0.5)))
    # What cuts add to noise is within a factor of e, at two standard deviations.
    assert x["level_variance"][0] == pytest.approx(0.25)
    spread = np.exp(problem.parameters["log_stable_spread"].prior.mean)
    ratio = null_threshold(25, 616, 0.16) / null_threshold(25, 616, 0.84)
    assert spread == pytest.approx(0.5 * np.log(ratio))
    # With a stable cut the law of noise only says where to look.
    both = score_problem([*chatter, shapes.cut(rng, "stable", count=16)], null=null)
    assert both.datasets["cuts"].x["level_variance"][0] == pytest.approx(1.5**2)


def test_chatter_is_needed_and_parameters_are_known():
    stable = shapes.cuts(np.random.default_rng(0), 3, 0)
    with pytest.raises(InputError, match="no cut is labelled chatter"):
        score_problem(stable)
    both = shapes.cuts(np.random.default_rng(0), 3, 3)
    with pytest.raises(InputError, match="'freedoms' is unknown; did you mean 'freedom'"):
        score_problem(both, parameters={"freedoms": 4.0})
    with pytest.raises(InputError, match="no cut is labelled chatter"):
        score_problem(both, left_out=[3, 4, 5])


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"label": "chater"}, "cut 1: label 'chater' is unknown; did you mean 'chatter'"),
        ({"scores": np.array([])}, "cut 1: there is no score"),
        ({"scores": np.array([1.0, np.nan])}, "cut 1: score 2 is no number"),
        ({"step": 0.0}, "cut 1: step and length of a window must be above 0"),
    ],
)
def test_faulty_cuts_are_refused_by_name(changed, words):
    given = {
        "label": "stable", "tool": "A", "spindle_speed": 1e4, "scores": np.ones(3), "step": 0.1,
        "length": 0.1, "name": "cut 1",
    }  # fmt: skip
    with pytest.raises(InputError, match=words):
        CutScores(**(given | changed))
