"""Several models of the same data: information criteria and cross-validation side by side."""

import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from calibration.archive import SavedResult
from calibration.text import aligned
from procmodel.errors import InputError

# From here on the importance weights of cross-validation are not to be trusted (Vehtari et al.).
_PARETO_ALLOWED = 0.7


@dataclass(frozen=True)
class ModelScore:
    """How well one model does.

    Attributes
    ----------
    aic, aic_weight : float
        Akaike's criterion, and the share of belief that follows from it among the models.
    bic : float
        Schwarz' criterion.
    elpd, elpd_error : float or None
        Expected log density of a new reading's model, by leave-one-out cross-validation summed
        over all readings, and its standard error; None without draws.
    behind, behind_error : float or None
        By how much that is less than the best model's, and the standard error of the difference.
    doubtful : int
        Readings whose cross-validation rests on too few draws.
    """

    aic: float
    aic_weight: float
    bic: float
    elpd: float | None = None
    elpd_error: float | None = None
    behind: float | None = None
    behind_error: float | None = None
    doubtful: int = 0


@dataclass(frozen=True)
class Comparison:
    """Models of the same data, the best first.

    Attributes
    ----------
    readings_hash : str
        The readings, x and y.
    scores : dict of str to ModelScore
        By the names given, the best first: by cross-validation where all have draws, else by AIC.
    verdict : str
        What follows, as a sentence.
    """

    readings_hash: str
    scores: dict[str, ModelScore]
    verdict: str

    def report(self) -> str:
        """The comparison as text.

        Returns
        -------
        str
            Several lines.
        """
        best = min(score.aic for score in self.scores.values())
        rows = [["", "AIC above best", "weight", "BIC", "LOO", "behind best"]]
        for name, score in self.scores.items():
            loo = "-" if score.elpd is None else f"{score.elpd:.2f} +- {score.elpd_error:.2g}"
            behind = (
                "-" if score.behind is None else f"{score.behind:.2f} +- {score.behind_error:.2g}"
            )
            rows.append(
                [
                    name,
                    f"{score.aic - best:.2f}",
                    f"{score.aic_weight:.3f}",
                    f"{score.bic:.2f}",
                    loo,
                    behind,
                ]
            )
        lines = [f"models of readings {self.readings_hash}", *aligned(rows, "  ")]
        doubtful = [f"{n} {s.doubtful}" for n, s in self.scores.items() if s.doubtful]
        if doubtful:
            lines.append(
                "cross-validation is doubtful for some readings, each of which moves the posterior "
                f"much: {', '.join(doubtful)}"
            )
        return "\n".join([*lines, self.verdict])

    def as_dict(self) -> dict[str, Any]:
        """The comparison as plain JSON types."""
        return {
            "readings_hash": self.readings_hash,
            "models": {name: vars(score) for name, score in self.scores.items()},
            "verdict": self.verdict,
        }


def compare_models(results: Mapping[str, SavedResult]) -> Comparison:
    """Compare models of the same data.

    Parameters
    ----------
    results : mapping of str to SavedResult
        At least two, by name; see `calibration.archive.load_result`.

    Returns
    -------
    Comparison
        Akaike's and Schwarz' criteria, and leave-one-out cross-validation where there are draws
        with predictions.

    Raises
    ------
    InputError
        If there are fewer than two, or their data differ.
    """
    if len(results) < 2:
        raise InputError("a comparison needs at least two results.")
    hashes = {name: result.tree.attrs["readings_hash"] for name, result in results.items()}
    first, *others = results
    for name in others:
        if hashes[name] != hashes[first]:
            raise InputError(
                f"{first} is of readings {hashes[first]}, {name} of {hashes[name]}: compare models "
                "of the same readings."
            )
    aics = {}
    for name, result in results.items():
        value = result.information["aic"]
        if value is None:
            raise InputError(f"{name} has no finite likelihood to compare: check its fit.")
        aics[name] = value
    least = min(aics.values())
    weights = {name: float(np.exp(-0.5 * (aic - least))) for name, aic in aics.items()}
    pointwise = {name: _leave_one_out(result) for name, result in results.items()}
    by_loo = all(found is not None for found in pointwise.values())
    if by_loo:
        totals = {name: float(np.sum(found[0])) for name, found in pointwise.items() if found}
        order = sorted(results, key=lambda name: -totals[name])
    else:
        order = sorted(results, key=lambda name: aics[name])
    scores = {}
    for name in order:
        bic = results[name].information["bic"]
        extra: dict[str, Any] = {}
        found, top = pointwise[name], pointwise[order[0]]
        if found is not None:
            extra = {
                "elpd": float(np.sum(found[0])),
                "elpd_error": _error_of_sum(found[0]),
                "doubtful": found[1],
            }
            if by_loo and top is not None:
                difference = top[0] - found[0]
                extra |= {
                    "behind": float(np.sum(difference)),
                    "behind_error": _error_of_sum(difference),
                }
        weight = weights[name] / sum(weights.values())
        scores[name] = ModelScore(aics[name], weight, float("nan") if bic is None else bic, **extra)
    return Comparison(hashes[first], scores, _verdict(scores, by_loo))


def _leave_one_out(result: SavedResult) -> tuple[np.ndarray, int] | None:
    """Log density of every reading given the others, and how many of them are doubtful."""
    if "log_likelihood" not in result.tree.children:
        return None
    import arviz_stats

    densities, doubtful = [], 0
    for name in result.tree["log_likelihood"].dataset:
        with warnings.catch_warnings():
            # Its warning about doubtful readings is counted here and said in the report.
            warnings.simplefilter("ignore", UserWarning)
            found = arviz_stats.loo(result.tree, pointwise=True, var_name=str(name), reff=1.0)
        densities.append(np.ravel(np.asarray(found.elpd_i)))
        doubtful += int(np.sum(np.asarray(found.pareto_k) > _PARETO_ALLOWED))
    return np.concatenate(densities), doubtful


def _error_of_sum(values: np.ndarray) -> float:
    return float(np.sqrt(len(values) * np.var(values)))


def _verdict(scores: dict[str, ModelScore], by_loo: bool) -> str:
    (best, _), (second, runner_up) = list(scores.items())[:2]
    if by_loo and runner_up.behind is not None and runner_up.behind_error is not None:
        if runner_up.behind <= 2.0 * runner_up.behind_error:
            return (
                f"cross-validation cannot tell {best} and {second} apart: they differ by less than "
                "two standard errors; prefer the simpler one"
            )
        return f"{best} predicts new readings better than {second}"
    return f"{best} is ahead by AIC ({scores[best].aic_weight:.0%} of the weight)"
