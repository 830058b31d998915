"""The results as Markdown: sections with tables, and every target met or missed."""

import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

RESULTS = Path(__file__).with_name("RESULTS.md")


@dataclass(frozen=True)
class Target:
    """A figure that was wanted, and what was found."""

    what: str
    wanted: str
    found: str
    met: bool

    @property
    def verdict(self) -> str:
        return "met" if self.met else "**MISSED**"


@dataclass
class Section:
    """One topic's results, grown as it runs so that a failure keeps what was found before."""

    title: str
    blocks: list[str] = field(default_factory=list)
    targets: list[Target] = field(default_factory=list)
    failure: str = ""
    seconds: float = 0.0

    def text(self, *lines: str) -> None:
        self.blocks.append("\n".join(lines))

    def heading(self, title: str) -> None:
        self.blocks.append(f"### {title}")

    def table(self, header: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
        lines = [header, ["---"] * len(header), *rows]
        self.blocks.append("\n".join("| " + " | ".join(map(_cell, line)) + " |" for line in lines))

    def target(self, what: str, wanted: str, found: str, met: bool) -> None:
        self.targets.append(Target(what, wanted, found, bool(met)))

    def render(self) -> str:
        blocks = [f"## {self.title}", *self.blocks]
        if self.failure:
            blocks.append(f"**This part failed:** {self.failure}")
        # Those that were met stand in the summary alone.
        missed = [t for t in self.targets if not t.met]
        blocks += [f"Target {t.verdict}: {t.what}: {t.found} (wanted {t.wanted})." for t in missed]
        return "\n\n".join([*blocks, f"This part took {self.seconds:.0f} s."])


def render(sections: Sequence[Section], machine: Sequence[str], seconds: float) -> str:
    """All results as one page."""
    targets = [(section, target) for section in sections for target in section.targets]
    summary = Section("Targets")
    failed = [section.title for section in sections if section.failure]
    if failed:
        summary.text(f"**Parts that failed:** {', '.join(failed)}.")
    missed = sum(not target.met for _, target in targets)
    summary.text(f"{len(targets) - missed} of {len(targets)} targets met.")
    summary.table(
        ["target", "wanted", "found", ""],
        [[t.what, t.wanted, t.found, t.verdict] for _, t in targets],
    )
    head = [
        "# Benchmarks",
        "Written by `make bench` (`python -m benchmarks`); do not edit. Ours and the alternatives "
        "ran in one process or in turns, on the same data. Times are median (lower to upper "
        "quartile) over the repeats, per call, with everything compiled; compilation is stated "
        "apart. A ratio is taken within each repeat; above 1 means that the alternative takes "
        "longer than ours.",
        "\n".join(f"- {line}" for line in [*machine, f"the whole run took {seconds:.0f} s"]),
        "\n\n".join([f"## {summary.title}", *summary.blocks]),
    ]
    page = "\n\n".join([*head, *(section.render() for section in sections)]) + "\n"
    return _without_folders(page)


def write(text: str) -> Path:
    """Put the page in its place, complete or not at all."""
    from procmodel.io import write_text

    write_text(RESULTS, text)
    return RESULTS


def _without_folders(page: str) -> str:
    """The page without this machine's folders, which an error message may name."""
    folders = [RESULTS.parents[1], sys.prefix, sys.base_prefix, tempfile.gettempdir(), Path.home()]
    for folder in sorted(map(str, folders), key=len, reverse=True):
        if len(folder) > 1:
            page = page.replace(folder, "...")
    return page


def _cell(value: str) -> str:
    return str(value).replace("|", "\\|")
