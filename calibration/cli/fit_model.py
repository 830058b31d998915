"""`procmodel fit`, `report` and `compare`: a model of the user's own, from job file to verdict."""

import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from calibration.cli import console, options
from procmodel.errors import InputError, nearest

Out = Annotated[
    Path | None, typer.Option("--out", help="Save the result (netCDF), for report and compare.")
]


def fit_command(
    job: Annotated[
        Path, typer.Argument(help="TOML file: model, parameters, data; see the README.")
    ],
    profile: Annotated[
        bool, typer.Option("--profile", help="Profile-likelihood intervals too.")
    ] = False,
    sample: Annotated[bool, typer.Option("--sample", help="Draw from the posterior too.")] = False,
    draws: Annotated[
        int | None, typer.Option("--draws", help="Draws of each ensemble or chain.")
    ] = None,
    seed: Annotated[int | None, typer.Option("--seed", help="Seed of the sampler.")] = None,
    starts: Annotated[
        int | None, typer.Option("--starts", help="Fit from so many starts and keep the best.")
    ] = None,
    checkpoint: Annotated[
        Path | None, typer.Option("--checkpoint", help="Keep the sampler's state here (.h5).")
    ] = None,
    resume: Annotated[
        bool, typer.Option("--resume", help="Go on from the checkpoint if it is there.")
    ] = False,
    out: Out = None,
    plot: options.Plot = None,
    as_json: options.AsJson = False,
) -> None:
    """Fit a model of your own to your data, with intervals that say what the data cannot tell."""
    options.check_outputs(out, plot=plot)
    from calibration.cli.runtime import prepare_jax

    prepare_jax()
    from calibration.archive import information, save_result
    from calibration.cli.fit_job import read_job
    from calibration.intervals import compare_intervals
    from calibration.sampling import SAMPLERS

    asked = read_job(job)
    out = out or asked.out
    if out is not None and out.suffix != ".nc":
        raise InputError(f"{out.name}: a result ends in .nc: rename it.")
    options.check_outputs(out, plot=plot)
    sampling = asked.sample if asked.sample is not None else ({} if sample else None)
    if sampling is None and (draws is not None or seed is not None or checkpoint or resume):
        raise InputError("--draws, --seed, --checkpoint and --resume go with --sample: add it.")
    given = {"draws": draws, "seed": seed, "checkpoint": checkpoint}
    if sampling is not None:
        sampling = sampling | {k: v for k, v in given.items() if v is not None}
        sampling["resume"] = resume
        name = sampling.get("sampler", "auto")
        if name not in SAMPLERS:  # before the fit, which may take long
            raise InputError(f"sampler {name!r} is unknown{nearest(name, SAMPLERS)}.")
    profiling = asked.profile if asked.profile is not None else ({} if profile else None)
    result, table_of_starts, curves, tree = _computed(asked, starts, profiling, sampling)
    intervals = compare_intervals(result, curves, tree, curves.level if curves else 0.95)
    if out is not None:
        save_result(out, result, curves, tree)
    if plot is not None:
        from calibration.plots.figures import save
        from calibration.plots.fit import draw_result

        save(draw_result(result, curves, tree), plot)
    answer = {
        **result.as_dict(),
        "intervals": intervals.as_dict(),
        "information": information(result),
    }
    text = [*table_of_starts, result.report()]
    if curves is not None or tree is not None:
        text.append(intervals.report())
    if tree is not None:
        answer["posterior"] = _draws_as_dict(tree)
        text.append(
            f"draws     {tree.attrs['sampler']} ({tree.attrs['sampler_reason']})\n"
            f"status    {tree.attrs['status']}"
        )
    if out is not None:
        text.append(f"saved in {out}")
    console.show(answer, "\n\n".join(text), as_json)
    if not result.converged or (tree is not None and not tree.attrs["converged"]):
        raise typer.Exit(console.NOT_CONVERGED)


def _computed(
    asked: Any, starts: int | None, profiling: dict | None, sampling: dict | None
) -> tuple[Any, list[str], Any, Any]:
    """Fit, table of its starts, profile and draws, the last two None where not asked for."""
    curves, tree = None, None
    result, table_of_starts = _fitted(asked, starts)
    if result.converged and profiling is not None:
        from calibration.profiling import profile as profile_of

        curves = profile_of(result, progress=_watched(), **profiling)
    if result.converged and sampling is not None:
        from calibration.posterior import with_predictions
        from calibration.sampling import sample as sample_from

        tree = sample_from(asked.problem, start=result, progress=_watched(), **sampling)
        tree = with_predictions(asked.problem, tree)
    return result, table_of_starts, curves, tree


def _fitted(asked: Any, starts: int | None) -> tuple[Any, list[str]]:
    """The fit, and the table of its starts where there are several."""
    from calibration.fitting import fit

    fit_options = dict(asked.fit)
    count = fit_options.pop("starts", None) if starts is None else starts
    fit_options.pop("starts", None)
    if count is None or count == 1:
        return fit(asked.problem, **fit_options), []
    from calibration.solvers.multistart import multistart

    if fit_options:
        raise InputError(
            f"several starts take the default solver: drop {', '.join(fit_options)} or the starts."
        )
    found = multistart(asked.problem, starts=int(count), progress=_watched())
    if found.best is None:
        raise InputError(f"none of {count} starts led anywhere: {found.status}.")
    return found.best, [found.report()]


def _watched() -> bool:
    """Whether to show progress: a bar that nobody watches is litter among the messages."""
    return sys.stderr.isatty()


def _draws_as_dict(tree: Any) -> dict[str, Any]:
    keys = ("sampler", "sampler_reason", "status", "rhat", "ess_bulk", "ess_tail", "acceptance")
    summary: dict[str, Any] = {key: tree.attrs[key] for key in keys}
    summary["converged"] = bool(tree.attrs["converged"])
    posterior = tree["posterior"].dataset
    for name in posterior:
        values = posterior[name]
        low, high = (float(q) for q in values.quantile([0.025, 0.975]))
        summary[str(name)] = {
            "mean": float(values.mean()),
            "std": float(values.std()),
            "interval95": [low, high],
        }
    return summary


def report_command(
    result: Annotated[Path, typer.Argument(help="A result of `procmodel fit` (.nc).")],
    as_json: options.AsJson = False,
) -> None:
    """Print a saved result; the model's code is not needed."""
    from calibration.archive import load_result

    saved = load_result(result)
    answer = {
        **saved.fit,
        "intervals": saved.intervals.as_dict(),
        "information": saved.information,
    }
    if saved.has_draws:
        answer["posterior"] = _draws_as_dict(saved.tree)
    console.show(answer, saved.report(), as_json)


def compare_command(
    results: Annotated[list[Path], typer.Argument(help="Two or more results of the same data.")],
    as_json: options.AsJson = False,
) -> None:
    """Compare models of the same data: AIC, BIC, and leave-one-out cross-validation."""
    from calibration.archive import load_result
    from calibration.comparison import compare_models

    names = [path.stem for path in results]
    if len(set(names)) < len(names):
        names = [str(path) for path in results]
    if len(set(names)) < len(names):
        raise InputError("the same result is named twice: compare different ones.")
    saved = {name: load_result(path) for name, path in zip(names, results, strict=True)}
    comparison = compare_models(saved)
    console.show(comparison.as_dict(), comparison.report(), as_json)
