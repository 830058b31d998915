"""`python -m benchmarks [--quick] [part ...]`: runs the parts, prints and writes the results."""

import argparse
import importlib
import sys
import time
import traceback

from benchmarks import measure, report
from benchmarks.sizes import FULL, QUICK, Sizes

# Part on the command line: its module and its title.
PARTS = {
    "fit": ("benchmarks.one_fit", "One fit"),
    "batch": ("benchmarks.batch", "A thousand fits"),
    "growth": ("benchmarks.growth", "Growth with readings and layers"),
    "coverage": ("benchmarks.coverage", "Coverage of the 95 % intervals"),
    "process": ("benchmarks.process", "The command as a whole process"),
    "plan": ("benchmarks.plan", "Feed schedules"),
    "slicing": ("benchmarks.slicing", "Solids in layers"),
    "zmap": ("benchmarks.zmap", "Electrode and cavity wearing each other"),
    "path": ("benchmarks.engagement", "Engagement and corrected paths"),
    "chatter": ("benchmarks.chatter", "Chatter"),
    "electrode": ("benchmarks.electrode", "Paths of electrodes"),
    "many": ("benchmarks.many", "Ten thousand small fits"),
    "sampling": ("benchmarks.sampling", "Effective draws per second"),
    "first": ("benchmarks.first_result", "The first posterior of a process"),
    "simulation": ("benchmarks.simulation", "Simulation-based calibration"),
}


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    parser.add_argument("parts", nargs="*", metavar="part", help=f"of {', '.join(PARTS)}")
    parser.add_argument("--quick", action="store_true", help="small sizes, to try the parts out")
    options = parser.parse_args(arguments)
    unknown = [part for part in options.parts if part not in PARTS]
    if unknown:
        parser.error(f"unknown part {unknown[0]!r}; known are {', '.join(PARTS)}")
    begin, machine = time.perf_counter(), measure.machine()
    _prepare_jax()
    chosen = [part for part in PARTS if part in options.parts] or list(PARTS)
    sections = [_run(part, QUICK if options.quick else FULL) for part in chosen]
    page = report.render(sections, machine, time.perf_counter() - begin)
    print(page)
    if options.parts or options.quick:
        print("Not written: only a full run with all parts replaces RESULTS.md.")
    else:
        print(f"Written to {report.write(page).name}.")
    return 1 if any(section.failure for section in sections) else 0


def _prepare_jax() -> None:
    import jax

    jax.config.update("jax_enable_x64", True)
    # A cache on disk would make the first call look compiled.
    jax.config.update("jax_enable_compilation_cache", False)


def _run(part: str, sizes: Sizes) -> report.Section:
    """One part; whatever goes wrong in it is stated in its section."""
    module, title = PARTS[part]
    section = report.Section(title)
    print(f"{part} ...", file=sys.stderr, flush=True)
    begin = time.perf_counter()
    try:
        importlib.import_module(module).run(section, sizes)
    # Whatever breaks one part is written into the results, and the others still run.
    except Exception as error:
        traceback.print_exc()
        section.failure = f"{type(error).__name__}: {str(error).strip() or 'no message'}"
    section.seconds = time.perf_counter() - begin
    return section


if __name__ == "__main__":
    sys.exit(main())
