"""The page of a campaign: what each fault did, and the worst cases first, each with its plot.

The worst cases are run again for their recordings: the results of a campaign have none, so that their size
does not grow with the length of the runs.
"""

from __future__ import annotations

import heapq
import shlex
from collections.abc import Iterable
from pathlib import Path
from typing import Final

from jinja2 import Environment

from hil.campaigns.case import FAILED, CaseResult, run_case
from hil.campaigns.prepared import PreparedCampaign
from hil.campaigns.summary import CampaignSummary
from hil.recording import open_recording
from hil.views.plots import plot_run

PAGE: Final = "report.html"
PLOTTED_CASES: Final = 6
"""Number of worst cases with a plot."""
LISTED_CASES: Final = 50
"""Number of worst cases in the table."""

_TEMPLATE: Final = """\
<!doctype html>
<html lang="en"><meta charset="utf-8"><meta name="viewport" content="width=device-width">
<title>{{ campaign.title }}</title>
<style>
body { font: 15px/1.45 system-ui, sans-serif; margin: 2em auto; max-width: 75em; padding: 0 1em; color: #222 }
table { border-collapse: collapse; margin: 1em 0 } td, th { padding: .2em .8em; text-align: right }
td:first-child, th:first-child, td.text { text-align: left } tr:nth-child(even) { background: #f4f4f4 }
img { max-width: 100% } code { background: #eee; padding: .1em .3em; overflow-wrap: anywhere }
.fail { color: #b40000 } .wide { overflow-x: auto } h3, p { overflow-wrap: anywhere }
td.text { min-width: 16em }
</style>
<h1>{{ campaign.title }}</h1>
<p>{{ summary.cases }} cases of {{ campaign.duration_s }} s of control, seed {{ campaign.seed }}:
{% if summary.failed %}<b class="fail">{{ summary.failed }} failed</b>{% else %}all passed{% endif %}.
Valve commands exceeded a limit of the rig file in {{ summary.limits_broken }} cases.</p>
<h2>The worst cases</h2>
{% for result in worst[:plotted] %}
<h3 {% if result.verdict == "fail" %}class="fail"{% endif %}>Case {{ result.number }}:
{{ result.fault or "no fault" }}, {{ result.verdict }}</h3>
<p>{{ result.problem or result.reason }}</p>
<p><code>hil campaign {{ name }} --case {{ result.number }} --record case-{{ result.number }}.mcap</code></p>
<p><a href="cases/case-{{ result.number }}.mcap"><img src="cases/case-{{ result.number }}.png"
alt="setpoint, position and valve voltage of case {{ result.number }}"></a></p>
{% endfor %}
<div class="wide"><table>
<tr><th>case</th><th>fault</th><th>verdict</th><th>state</th><th>periods to centre</th>
<th>largest error</th><th>problem</th></tr>
{% for result in worst %}
<tr><td>{{ result.number }}</td><td class="text">{{ result.fault }}</td><td>{{ result.verdict }}</td>
<td>{{ result.state }}</td>
<td>{{ "" if result.centred_after_periods is none else result.centred_after_periods }}</td>
<td>{{ "%.1f" % (100 * result.max_error) }} %</td><td class="text">{{ result.problem }}</td></tr>
{% endfor %}</table></div>
<h2>Every fault</h2>
<div class="wide"><table>
<tr><th>fault</th><th>cases</th><th>failed</th><th>in fault</th><th>periods to centre</th>
<th>not centred</th><th>largest error</th></tr>
{% for fault, found in summary.by_fault.items() %}
<tr><td>{{ fault }}</td><td>{{ found.cases }}</td><td>{{ found.failed or "" }}</td>
<td>{{ found.ended_in_fault }}</td>
<td>{% if found.max_periods is not none %}at most {{ found.max_periods }}{% endif %}</td>
<td>{{ found.never_centred or "" }}</td><td>{{ "%.1f" % (100 * found.max_error) }} %</td></tr>
{% endfor %}</table></div>
</html>
"""


def worst_cases(results: Iterable[CaseResult], count: int = LISTED_CASES) -> list[CaseResult]:
    """Return the worst results: failed ones first, then those whose valves were centred last.

    The order does not depend on the order of ``results``.
    """
    return heapq.nlargest(count, results, key=_badness)


def write_page(
    folder: Path,
    prepared: PreparedCampaign,
    name: str,
    summary: CampaignSummary,
    results: Iterable[CaseResult],
) -> Path:
    """Write the page into ``folder``, with recordings and plots of the worst cases. Returns its file.

    ``name`` is the campaign as it is given on the command line.
    """
    worst = worst_cases(results)
    cases = folder / "cases"
    cases.mkdir(exist_ok=True)
    for result in worst[:PLOTTED_CASES]:
        path = cases / f"case-{result.number}.mcap"
        path.unlink(missing_ok=True)
        run_case(prepared, result.number, path)
        plot_run(open_recording(path), path.with_suffix(".png"), title=result.fault)
    page = Environment(autoescape=True, trim_blocks=True).from_string(_TEMPLATE)
    text = page.render(
        campaign=prepared.campaign,
        name=shlex.quote(name),
        summary=summary,
        worst=worst,
        plotted=PLOTTED_CASES,
    )
    (folder / PAGE).write_text(text, encoding="utf-8")
    return folder / PAGE


def _badness(result: CaseResult) -> tuple[bool, bool, int, float, int]:
    periods = result.centred_after_periods
    return (result.verdict == FAILED, not result.limits_held, periods or 0, result.max_error, -result.number)
