"""Runs the cases of a campaign on a Dask cluster. The results are the same as in processes of one machine.

A task is a group of cases with the campaign and its documents, so that a worker needs no file. When a worker
is lost, the scheduler gives its groups to another one. The workers must have the same version of this
package: they compute the results.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from importlib import import_module
from threading import Lock
from typing import Any, Final

import hil
from hil.campaigns.case import CaseResult
from hil.campaigns.prepared import PreparedCampaign
from hil.campaigns.runner import WAITING_PER_WORKER, groups_of, run_group
from hil.core.errors import EnvironmentLackError, HilError

CONNECT_TIMEOUT_S: Final = 10.0
_ONE_AT_A_TIME: Final = Lock()
"""A worker may have several threads. They would gain nothing here, and msgspec crashes if two of them use a
type for the first time at once.
"""


def run_cases_on_dask(prepared: PreparedCampaign, first: int, address: str) -> Iterator[list[CaseResult]]:
    """Yield the results of the cases from ``first`` on, in groups and in order.

    ``address`` is that of the scheduler, such as ``tcp://10.0.0.5:8786``. Raises EnvironmentLackError without
    the package ``distributed``, HilError if the cluster cannot be used, and the HilError of a case that
    cannot run.
    """
    distributed = _distributed()
    try:
        client = distributed.Client(address, timeout=CONNECT_TIMEOUT_S, set_as_default=False)
    except (OSError, ValueError) as error:
        raise HilError(
            f"--dask {address}: no scheduler answers within {CONNECT_TIMEOUT_S:g} s ({error}); start one "
            "with `dask scheduler`, and workers with `dask worker ADDRESS --nthreads 1`"
        ) from None
    with client:
        _check_workers(client, address)
        yield from _in_order(distributed, client, prepared, first, address)


def run_group_alone(prepared: PreparedCampaign, start: int, stop: int) -> list[CaseResult]:
    """Run the cases from ``start`` to before ``stop``, while no other thread of this process runs any."""
    with _ONE_AT_A_TIME:
        return run_group(prepared, start, stop)


def version() -> str:
    """Return the version of this package, on the worker that calls it."""
    return hil.__version__


def _distributed() -> Any:
    try:
        return import_module("distributed")
    except ImportError:
        raise EnvironmentLackError("--dask needs distributed; pip install 'pneumatic-hil[dask]'") from None


def _check_workers(client: Any, address: str) -> None:
    """Refuse a cluster without workers, or with workers of another version. Raises HilError."""
    remedy = f"install pneumatic-hil {hil.__version__} there, and start the worker again"
    try:
        versions = client.run(version)
    except ImportError as error:
        raise HilError(
            f"--dask {address}: a worker cannot import pneumatic-hil ({error}); {remedy}"
        ) from None
    if not versions:
        raise HilError(
            f"--dask {address}: the cluster has no workers; start them with `dask worker {address} "
            "--nthreads 1`"
        )
    for worker, found in versions.items():
        if found != hil.__version__:
            raise HilError(
                f"--dask {address}: worker {worker} has pneumatic-hil {found}, and this program "
                f"{hil.__version__}; {remedy}"
            )


def _in_order(
    distributed: Any, client: Any, prepared: PreparedCampaign, first: int, address: str
) -> Iterator[list[CaseResult]]:
    """Yield the results of all groups. As many groups wait as keep every thread of the cluster busy."""
    following = groups_of(prepared, first)
    waiting: deque[Any] = deque()
    try:
        while True:
            wanted = WAITING_PER_WORKER * max(sum(client.nthreads().values()), 1)
            while len(waiting) < wanted and (group := next(following, None)) is not None:
                waiting.append(client.submit(run_group_alone, prepared, *group, pure=False))
            if not waiting:
                return
            yield waiting.popleft().result()
    except distributed.KilledWorker as error:
        raise HilError(
            f"--dask {address}: {error}; perhaps the workers lack memory. Run the same command again to "
            "go on after the last result"
        ) from None
    except (distributed.CancelledError, OSError) as error:
        raise HilError(
            f"--dask {address}: the scheduler was lost ({error}); run the same command again to go on after "
            "the last result"
        ) from None
    finally:
        client.cancel(list(waiting))
