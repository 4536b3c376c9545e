"""Common parts of all campaigns: the command, the committed results, and texts of pages made from results."""

from __future__ import annotations

import argparse
import dataclasses
import datetime
import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, NamedTuple, TypeVar

from granular.commands.console import Parser, add_version_option, print_result
from granular.commands.options import OutputOptions
from granular.commands.signature import add_option_group
from granular.shared.blocks import Table
from granular.shared.errors import InputError
from granular.shared.files import ResultCache, replace_non_finite_by_none, write_text

if TYPE_CHECKING:
    from matplotlib.figure import Figure

ROOT = Path(__file__).parents[1]
RESULTS = "results.json"

Plain = dict[str, Any]
Results = TypeVar("Results")
Case = TypeVar("Case")


class PageBlock(NamedTuple):
    """Text between two marks in a page, which is made from results."""

    page: str
    text: str


def _return_none(_: Any) -> Any:
    return None


def _return_empty_mapping(_: Any) -> Mapping[str, Any]:
    return {}


@dataclasses.dataclass(frozen=True)
class Campaign(Generic[Results]):
    """A campaign and its command ``python -m research.NAME``.

    Attributes
    ----------
    name, purpose : str
    quick, full : str
        Descriptions, for the help, of the runs made with ``--quick`` and ``--full``.
    run : callable
        Returns the results of the runs selected by the command's options; caches them below ``options.out``,
        reuses cached ones, and writes ``results.json``.
    from_plain : callable
        Returns results from the data of a file.
    empty : Results
        Results if there is no file.
    text, summary : callable
        Return the results as text for the console, and as plain data.
    blocks : callable
        Returns blocks of pages by name.
    pictures : callable
        Returns figures by file.
    add_options : callable
        Adds options specific to the campaign to its parser.
    instead : callable
        Returns plain data and text if an option of the campaign selects another output; otherwise None.
    show : callable
        Returns the results to show if nothing is run; None for the committed results.
    stale : callable
        Returns the names of committed results that the present code does not reproduce.
    examples : str
        End of the command's help.
    """

    name: str
    purpose: str
    quick: str
    full: str
    run: Callable[[Any], Results]
    from_plain: Callable[[Any], Results]
    empty: Results
    text: Callable[[Results], str]
    summary: Callable[[Results], Plain]
    blocks: Callable[[Results], Mapping[str, PageBlock]] = _return_empty_mapping
    pictures: Callable[[Results], Mapping[str, Figure]] = _return_empty_mapping
    add_options: Callable[[Parser], None] = _return_none
    instead: Callable[[Any], tuple[Plain, str] | None] = _return_none
    show: Callable[[Any], Results] | None = None
    stale: Callable[[Any], Sequence[str]] = lambda _: ()
    examples: str = ""

    @property
    def results_file(self) -> Path:
        """File of the committed results."""
        return results_file_of_campaign(self.name)

    def read_committed_results(self) -> Results:
        """Committed results."""
        return read_results(self.results_file, self.from_plain, self.empty)

    def parser(self) -> Parser:
        """Make the parser of the command line."""
        item = Parser(
            prog=f"python -m research.{self.name}",
            description=self.purpose,
            epilog=self.examples,
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        add_version_option(item)
        out = f"out/{self.name}"
        item.add_argument(
            "-o",
            "--out",
            metavar="DIR",
            default=out,
            help=f"directory of runs and results; finished runs are reused ({out} if not given)",
        )
        length = item.add_mutually_exclusive_group()
        length.add_argument("--quick", action="store_true", help=self.quick)
        length.add_argument(
            "--full", action="store_true", help=f"{self.full}; without any of these options nothing is run"
        )
        length.add_argument(
            "--check",
            action="store_true",
            help="list committed results that are stale, and blocks of pages that differ from the results",
        )
        length.add_argument(
            "--guide",
            action="store_true",
            help="write blocks and pictures of the committed results into the pages",
        )
        self.add_options(item)
        add_option_group(item, OutputOptions)
        return item

    def main(self, arguments: Sequence[str]) -> None:
        """Run the command."""
        options = self.parser().parse_args(arguments)
        if (other := self.instead(options)) is not None:
            print_result(*other, options.json)
        elif options.guide:
            pages = [str(path) for path in self.write_pages(self.read_committed_results(), ROOT)]
            print_result({"pages": pages}, f"written: {', '.join(pages)}", options.json)
        elif options.check:
            stale, off = list(self.stale(options)), self.outdated_blocks(self.read_committed_results(), ROOT)
            words = [f"{len(stale)} stale", *stale, f"{len(off)} blocks of pages differ", *off]
            print_result({"stale": stale, "pages": off}, "\n".join(words), options.json)
        elif options.quick or options.full:
            result = self.run(options)
            location = f"\nresults: {Path(options.out) / RESULTS}"
            print_result(self.summary(result), self.text(result) + location, options.json)
        else:
            result = self.read_committed_results() if self.show is None else self.show(options)
            print_result(self.summary(result), self.text(result), options.json)

    def replace_blocks_in_page(self, page: str, blocks: Mapping[str, str]) -> str:
        """Return a page with the texts between the marks of its blocks replaced; blocks by name."""
        for name, text in blocks.items():
            begin, end = self.begin_and_end_marks(name)
            if begin in page and end in page:
                before, _, rest = page.partition(begin)
                page = f"{before}{begin}\n{text}\n{end}{rest.partition(end)[2]}"
        return page

    def begin_and_end_marks(self, name: str) -> tuple[str, str]:
        """Return the begin and end marks of a block."""
        return (
            f"<!-- made from research/{self.name}/{RESULTS}: {name} -->",
            f"<!-- end of {self.name}: {name} -->",
        )

    def outdated_blocks(self, results: Results, root: Path = ROOT) -> list[str]:
        """Return the blocks whose text in their pages differs from the text made from these results."""
        return [
            f"{block.page}: {name}"
            for name, block in self.blocks(results).items()
            if "\n".join((self.begin_and_end_marks(name)[0], block.text, self.begin_and_end_marks(name)[1]))
            not in (root / block.page).read_text(encoding="utf-8")
        ]

    def write_pages(self, results: Results, root: Path = ROOT) -> list[Path]:
        """Write blocks and pictures below ``root``, and return their files."""
        blocks = self.blocks(results)
        pages: dict[Path, dict[str, str]] = {}
        for name, block in blocks.items():
            pages.setdefault(root / block.page, {})[name] = block.text
        for path, texts in pages.items():
            page = path.read_text(encoding="utf-8")
            path.write_text(self.replace_blocks_in_page(page, texts), encoding="utf-8")
        drawn = {root / name: figure for name, figure in self.pictures(results).items()}
        for path, figure in drawn.items():
            from granular.render import save_picture

            save_picture(figure, path, overwrite=True)
        return [*pages, *drawn]


def results_file_of_campaign(name: str) -> Path:
    """Return the file of a campaign's committed results."""
    return ROOT / "research" / name / RESULTS


def add_workers_option(item: argparse.ArgumentParser, default: int | None, words: str) -> None:
    """Add the option for the number of processes; see `check_workers_option`."""
    item.add_argument("--workers", type=int, default=default, metavar="N", help=f"processes ({words})")


def check_workers_option(options: Any) -> None:
    """Refuse fewer processes than one.

    Raises
    ------
    InputError
        If ``--workers`` is below 1.
    """
    if options.workers is not None and options.workers < 1:
        raise InputError(f"--workers {options.workers} is not a possible number of processes; give 1 or more")


def make_or_read_cached_rows(
    cases: Sequence[Case],
    key: Callable[[Case], str],
    make: Callable[[Case], Plain],
    cache: ResultCache | None,
    *,
    label: str,
    progress: bool,
) -> list[Plain]:
    """Return a row for each case; rows are cached as soon as they are made, and reused."""
    from granular.shared.progress_bars import progress_bar

    rows = []
    with progress_bar(total=len(cases), desc=label, wanted=progress) as bar:
        for case in cases:
            name = key(case)
            row = None if cache is None else cache.read(name)
            if row is None:
                row = make(case)
                if cache is not None:
                    cache.store(name, row)
            rows.append(row)
            bar.update()
    return rows


def read_results(path: Path, from_plain: Callable[[Any], Results], empty: Results) -> Results:
    """Return results from a file, or ``empty`` if there is no file.

    Raises
    ------
    InputError
        If the file does not hold results.
    """
    try:
        return from_plain(json.loads(path.read_text(encoding="utf-8")))
    except FileNotFoundError:
        return empty
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(f"{path} holds no results ({error}); create it again") from None


def write_results(plain: Mapping[str, Any], path: Path) -> None:
    """Write results to a file with one row per line, so that differences between versions are readable."""
    text = json.dumps(replace_non_finite_by_none(plain), separators=(",", ":"))
    for mark in ('},"', '},{"'):
        text = text.replace(mark, "},\n" + mark[2:])
    write_text(path, text + "\n")


def command_date_and_versions(command: str) -> Plain:
    """Return command, date, machine and versions."""
    from validation.report_tasks import machine_info

    now = datetime.datetime.now(datetime.UTC).strftime("%Y-%m-%d")
    return {"command": command, "date": now, **machine_info()}


def round_floats_in_plain_data(value: Any, digits: int) -> Any:
    """Return plain data with every float rounded to a number of digits."""
    if isinstance(value, Mapping):
        return {name: round_floats_in_plain_data(item, digits) for name, item in value.items()}
    if isinstance(value, list | tuple):
        return [round_floats_in_plain_data(item, digits) for item in value]
    return float(f"{value:.{digits}g}") if isinstance(value, float) else value


def markdown_table(header: Iterable[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a Markdown table for a page."""
    head = tuple(header)
    lines = [f"| {' | '.join(cells)} |" for cells in (head, *rows)]
    return "\n".join([lines[0], f"|{'---|' * len(head)}", *lines[1:]])


def markdown_of_console_table(table: Table) -> str:
    """Return a table of the console as Markdown."""
    return markdown_table(table.header, [list(map(str, row)) for row in table.rows])
