"""``hil campaign``: run many cases in simulated time, and judge each by stated criteria."""

from __future__ import annotations

import argparse
import shlex
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from hil.core.errors import HilError
from hil.host.command_parser import CommandParser
from hil.host.text_file import read_text

if TYPE_CHECKING:
    from rich.console import Console

    from hil.campaigns.campaign_file import Campaign
    from hil.campaigns.prepared import PreparedCampaign
    from hil.campaigns.result_files import ResultFolder
    from hil.campaigns.summary import CampaignSummary

PLAIN_INTERVAL_S = 10.0
"""Shortest time between two lines of progress if the output is no terminal."""
DESCRIPTION = """\
Run the cases of a campaign in simulated time: each fault at each moment, with each set-up and draw. A case
passes if the reaction is the expected one and no valve command exceeds a limit. A campaign that was
interrupted goes on where it stopped. Exit status: 0 if all cases passed, 1 if a case failed, 2 if the file is
wrong."""


def parser() -> CommandParser:
    """Return the parser of the arguments of ``hil campaign``."""
    command = CommandParser(prog="hil campaign", description=DESCRIPTION)
    command.add_argument(
        "campaign", metavar="CAMPAIGN", help="campaign file, or a shipped one: bus, faults, robustness"
    )
    command.add_argument(
        "--output", type=Path, metavar="DIR", help="folder of the results (default campaigns/<name>)"
    )
    command.add_argument(
        "--workers", type=_positive, metavar="N", help="number of processes (default: one per processor)"
    )
    command.add_argument(
        "--dask",
        metavar="ADDRESS",
        help="run the cases on the Dask cluster with this scheduler, such as tcp://10.0.0.5:8786",
    )
    command.add_argument("--draws", type=_positive, metavar="N", help="number of draws instead of the file's")
    command.add_argument(
        "--case", type=int, metavar="NUMBER", help="run this case alone, and print its result"
    )
    command.add_argument("--record", type=Path, metavar="FILE", help="recording of the case of --case")
    return command


def main(argv: list[str]) -> int:
    """Run ``hil campaign`` with ``argv``; return its exit status. Raises HilError for wrong input."""
    options = parser().parse_args(argv)
    if options.record is not None and options.case is None:
        raise HilError("--record is for one case; give its number with --case")
    from hil.campaigns.campaign_file import find_campaign, read_campaign

    path = find_campaign(options.campaign)
    text = read_text(path)
    campaign = read_campaign(text, str(path))
    if options.draws is not None:
        import msgspec

        campaign = msgspec.structs.replace(campaign, draws=options.draws)
    if options.case is not None:
        if options.dask is not None:
            raise HilError("--dask is for whole campaigns; a single case (--case) runs on this machine")
        return _run_one(campaign, options.case, options.record)
    if options.dask is not None and options.workers is not None:
        raise HilError("--workers is for processes of this machine; with --dask, the cluster has the workers")
    return _run_all(campaign, text, path, options)


def _run_one(campaign: Campaign, number: int, record: Path | None) -> int:
    from hil.campaigns.campaign_file import case_count
    from hil.campaigns.case import PASSED, run_case
    from hil.campaigns.prepared import prepare

    if not 0 <= number < case_count(campaign):
        raise HilError(f"--case {number}: the campaign has the cases 0 to {case_count(campaign) - 1}")
    result = run_case(prepare(campaign), number, record)
    for name in result.__struct_fields__:
        print(f"{name:22} {_value_text(getattr(result, name))}")
    if record is not None:
        print(f"{'recording':22} {record}")
    return 0 if result.verdict == PASSED else 1


def _value_text(value: object) -> str:
    """Return a value of a case's result as people write it."""
    if value in (None, "", "{}"):
        return "none"
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:.4g}" if isinstance(value, float) else str(value)


class _PlainProgress:
    """Prints one line to stderr every PLAIN_INTERVAL_S, for output that is no terminal."""

    def __init__(self, total: int, clock_s: Callable[[], float] = time.monotonic) -> None:
        self._total = total
        self._clock_s = clock_s
        self._printed_s = clock_s()

    def update(self, finished: int) -> None:
        """Print how many cases are finished if the last line is old."""
        now_s = self._clock_s()
        if now_s - self._printed_s >= PLAIN_INTERVAL_S:
            self._printed_s = now_s
            sys.stderr.write(f"{finished} of {self._total} cases are finished\n")
            sys.stderr.flush()


def _run_all(campaign: Campaign, text: str, path: Path, options: argparse.Namespace) -> int:
    from rich.console import Console

    from hil.campaigns.campaign_file import case_count
    from hil.campaigns.page import write_page
    from hil.campaigns.prepared import prepare
    from hil.campaigns.result_files import ResultFolder
    from hil.campaigns.summary import summarise_campaign

    prepared = prepare(campaign)
    folder = ResultFolder(options.output or Path("campaigns") / path.stem, text, case_count(campaign))
    console = Console(highlight=False, soft_wrap=True, markup=False)
    try:
        _run_remaining(prepared, folder, options)
    except KeyboardInterrupt:
        console.print(f"interrupted after {folder.finished} cases; the same command goes on from there")
        return 130
    summary = summarise_campaign(folder.results())
    _print_summary(console, campaign, summary, options.campaign)
    console.print(f"results    {folder.write_table()}")
    page = write_page(folder.path, prepared, options.campaign, summary, folder.results())
    console.print(f"page       {page}  (the worst cases first, with their plots)")
    return 1 if summary.failed else 0


def _run_remaining(prepared: PreparedCampaign, folder: ResultFolder, options: argparse.Namespace) -> None:
    """Run the cases that have no result yet, and show how far they are and how long they will take."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    from hil.campaigns.campaign_file import case_count
    from hil.campaigns.dask_runner import run_cases_on_dask
    from hil.campaigns.runner import default_workers, run_cases

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    progress = Progress(*columns, console=Console(stderr=True))
    if options.dask is not None:
        groups = run_cases_on_dask(prepared, folder.finished, options.dask)
    else:
        groups = run_cases(prepared, folder.finished, options.workers or default_workers())
    total = case_count(prepared.campaign)
    task = progress.add_task("cases", total=total, completed=folder.finished)
    plain = None if progress.console.is_terminal else _PlainProgress(total)
    with progress:
        for results in groups:
            folder.append(results)
            progress.update(task, completed=folder.finished)
            if plain is not None:
                plain.update(folder.finished)


def _print_summary(console: Console, campaign: Campaign, summary: CampaignSummary, name: str) -> None:
    from rich.table import Table

    table = Table(title=campaign.title, title_justify="left", box=None, pad_edge=False)
    for heading in ("fault", "cases", "failed", "in fault", "periods to centre", "largest error"):
        is_name = heading == "fault"
        table.add_column(heading, justify="left" if is_name else "right", no_wrap=is_name)
    for fault, found in summary.by_fault.items():
        periods = "" if found.max_periods is None else f"≤ {found.max_periods}"
        table.add_row(
            fault,
            str(found.cases),
            str(found.failed) if found.failed else "",
            str(found.ended_in_fault),
            periods,
            f"{100 * found.max_error:.1f} %",
        )
    console.print(table)
    for result in summary.failures:
        number, fault = result.number, result.fault or "no fault"
        console.print(f"case {number} failed: {fault}: {result.problem}", style="red")
        command = f"hil campaign {shlex.quote(name)} --case {number} --record case-{number}.mcap"
        console.print(f"  again    {command}")
    if summary.failed > len(summary.failures):
        console.print(f"{summary.failed - len(summary.failures)} more cases failed; see the results")
    verdict = "all passed" if not summary.failed else f"{summary.failed} failed"
    console.print(f"{summary.cases} cases, {verdict}; commands beyond a limit in {summary.limits_broken}")


def _positive(text: str) -> int:
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number of 1 or more")
    return int(text)
