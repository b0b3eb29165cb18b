"""Tables of setpoints for a gateway that runs: read in another process, used only for their own request."""

from __future__ import annotations

import pytest
from support.constants import PERIOD_S
from support.gateway_bench import RigBench, make_rig

from hil.core.gateway import Gateway
from hil.core.output import Cycle
from hil.core.requests import Reply, SetpointRequest
from hil.core.setpoint_change import MAX_TABLE_CHARACTERS, PreparedSetpoint, prepare_setpoint

TABLE = "time_s,setpoint\n0,0\n1,0.05\n2,-0.05\n"
REQUEST = SetpointRequest("vertical", "csv:path/table.csv", TABLE)
RIG = make_rig(axes=["vertical"])


def prepared_of(request: SetpointRequest) -> PreparedSetpoint:
    found = prepare_setpoint(request, RIG)
    assert found is not None
    return found


def operate(gateway: Gateway, request: SetpointRequest, prepared: PreparedSetpoint | None) -> Reply:
    reply = gateway.operate(request, gateway.next_deadline_ns, prepared).reply
    assert reply is not None
    return reply


def setpoints_after(prepared: PreparedSetpoint | None) -> list[float]:
    """Setpoints of the periods after the request, in state running."""
    bench = RigBench(RIG, setpoints="hold").run()
    bench.periods(3)
    reply = operate(bench.gateway, REQUEST, prepared)
    assert reply.accepted
    assert reply.text.startswith("setpoint csv:path/table.csv, approached now")
    bench.transcript.cycles.clear()
    bench.periods(200)
    cycles: list[Cycle] = bench.transcript.cycles
    return [cycle.axes[0].setpoint for cycle in cycles if cycle.fresh]


def test_a_table_is_followed_whether_it_was_prepared_or_not() -> None:
    followed = setpoints_after(prepared_of(REQUEST))
    assert followed == setpoints_after(None)
    assert followed[round(1.0 / PERIOD_S)] == pytest.approx(0.05, abs=0.01)
    assert followed[-1] == pytest.approx(-0.05, abs=1e-12)


def test_only_the_table_of_the_same_request_is_used() -> None:
    other = prepared_of(REQUEST._replace(table="0,0\n1,0.1\n"))
    assert setpoints_after(other) == setpoints_after(None)


@pytest.mark.parametrize(
    ("table", "reason"),
    [
        ("time_s,setpoint\n0,0\n1,x\n", "path/table.csv: row 3: '1,x' is not time_s,setpoint"),
        ("0,0\n1,0.2\n", "reaches 0.2 m, beyond 0.15 m (rig: axes.vertical.max_y)"),
        ("0,0\n0.01,0.1\n", "limit 0.45 m/s (rig: axes.vertical.operator.setpoint_max_speed)"),
        ("\n", "path/table.csv: no rows of time_s,setpoint"),
        ("0,0\n" * (MAX_TABLE_CHARACTERS // 4 + 1), "limit 65536; leave out rows"),
    ],
)
def test_a_wrong_table_is_refused_with_its_reason(table: str, reason: str) -> None:
    request = REQUEST._replace(table=table)
    prepared = prepared_of(request)
    assert reason in prepared.refusal
    gateway = RigBench(RIG).run().gateway
    for given in (prepared, None):
        reply = operate(gateway, request, given)
        assert (reply.accepted, reply.text) == (False, f"setpoint refused: {prepared.refusal}")


def test_a_limit_is_checked_again_when_a_table_is_used() -> None:
    """A prepared table is trusted to be that of the request, not to be within limits."""
    outside = prepared_of(REQUEST)._replace(values=(0.0, 0.3, 0.3))
    reply = operate(RigBench(RIG).run().gateway, REQUEST, outside)
    assert not reply.accepted
    assert "reaches 0.3 m, beyond 0.15 m" in reply.text


def test_other_setpoints_need_no_preparation() -> None:
    assert prepare_setpoint(SetpointRequest("vertical", "0.05"), RIG) is None
