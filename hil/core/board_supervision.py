"""Supervision of both boards: reactions to their heartbeats, restarts and emergency messages.

A board that is not operational is started. If it ignores several starts, the gateway starts it more rarely,
and asks it for its error register and its last error.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

from hil.core.board_watch import ADC_NODE, DAC_NODE, BoardWatch, describe_emergency
from hil.core.error_query import SDO_ANSWER, ErrorQuery, Step
from hil.core.frames import Frame
from hil.core.life_cycle import LifeCycleState
from hil.core.operating_state import OperatingState
from hil.core.output import NOTHING, LogThrottle, Output, Severity, combine
from hil.core.rejections import Rejections
from hil.core.rig import Rig, nanoseconds
from hil.core.wire import codec

Emergency: TypeAlias = codec.EmcyAdc | codec.EmcyDac


class BoardSupervision:
    """Both boards of a rig. Times are monotonic nanoseconds.

    ``on_adc_restart`` is called when the ADC board is started, because its sample counter may begin anew.
    """

    def __init__(
        self,
        rig: Rig,
        state: OperatingState,
        throttle: LogThrottle,
        rejections: Rejections,
        on_adc_restart: Callable[[], None],
    ) -> None:
        self.adc = _watch("adc", ADC_NODE, nanoseconds(rig.adc.heartbeat_timeout_s))
        self.dac = _watch("dac", DAC_NODE, nanoseconds(rig.dac.heartbeat_timeout_s))
        self._both = (self.adc, self.dac)
        self._state = state
        self._throttle = throttle
        self._rejections = rejections
        self._on_adc_restart = on_adc_restart
        self._queries = {board.name: ErrorQuery(board.node_id) for board in self._both}
        self._by_answer = {SDO_ANSWER + board.node_id: board for board in self._both}
        """Boards by the identifier of their SDO answers."""
        self._started: set[str] = set()
        """Names of the boards that were sent an NMT start in this period. One start per period is enough."""

    @property
    def are_fit(self) -> bool:
        """True if both boards are operational and without error."""
        return self.adc.is_fit and self.dac.is_fit

    def describe(self) -> str:
        """Return the state of both boards in words."""
        return "; ".join(self._describe(board) for board in self._both)

    def _describe(self, board: BoardWatch) -> str:
        finding = None if board.is_up else self._queries[board.name].finding
        return f"{board.name} {board.describe()}" + (f": {finding}" if finding else "")

    def begin_period(self, now_ns: int) -> Output:
        """Begin a period: react to heartbeats that have timed out, and allow one NMT start to each board."""
        self._started.clear()
        lost = NOTHING
        for board in self._both:
            reason = board.check_timeout(now_ns)
            if reason is not None:
                lost = combine(lost, self._state.lose(board.name, reason))
        return combine(lost, self._check_answers(now_ns))

    def _check_answers(self, now_ns: int) -> Output:
        """Report questions to the boards that were not answered in time."""
        reports = NOTHING
        for board in self._both:
            step = self._queries[board.name].check_timeout(now_ns)
            if step is not None:
                reports = combine(reports, self._take_step(board, step))
        return reports

    def receive_heartbeat(self, board: BoardWatch, data: bytes, now_ns: int) -> Output:
        """Take a heartbeat of ``board``, and start the board if it is not operational."""
        if len(data) != 1:
            return self._rejections.add(f"heartbeat of {board.name} has {len(data)} bytes, not 1")
        was_up, state_before = board.is_up, board.nmt_state
        start = board.heartbeat(data[0], now_ns)
        changed = NOTHING
        if board.nmt_state != state_before:
            kind = f"{board.name} state"
            changed = self._throttle.report(Severity.INFO, board.name, board.describe(), kind)
        if start is None:
            if board.starts.sent == 0:
                self._queries[board.name].reset()
            return changed
        if board is self.adc:
            self._on_adc_restart()
        lost = self._state.lose(board.name, f"left operational: {board.describe()}") if was_up else NOTHING
        return combine(changed, lost, self._start(board, start, now_ns))

    def receive_adc_emergency(self, data: bytes) -> Output:
        """Take an emergency message of the ADC board."""
        return self._receive_emergency(self.adc, data, codec.EMCY_ADC_LENGTH, codec.decode_emcy_adc)

    def receive_dac_emergency(self, data: bytes) -> Output:
        """Take an emergency message of the DAC board."""
        return self._receive_emergency(self.dac, data, codec.EMCY_DAC_LENGTH, codec.decode_emcy_dac)

    def receive_answer(self, identifier: int, data: bytes, now_ns: int) -> Output | None:
        """Take the answer of a board to a question about its errors; None if the frame is no such answer."""
        board = self._by_answer.get(identifier)
        if board is None or not self._queries[board.name].is_answer(data):
            return None
        return self._take_step(board, self._queries[board.name].answer(data, now_ns))

    def _start(self, board: BoardWatch, command: Frame, now_ns: int) -> Output:
        """Start a board, unless it ignores its starts: then ask it why, and start it more rarely."""
        is_due = board.starts.should_start(now_ns)
        if board.name in self._started:
            return NOTHING
        query = self._queries[board.name]
        is_unexplained = board.starts.are_ignored and not query.is_begun
        question = Output((query.begin(now_ns),)) if is_unexplained else NOTHING
        if not is_due:
            return question
        self._started.add(board.name)
        board.starts.start_sent(now_ns)
        return combine(question, Output((command,)))

    def _take_step(self, board: BoardWatch, step: Step) -> Output:
        """Send the next question to a board, or report what it has answered."""
        if step.request is not None:
            return Output((step.request,))
        text = f"not operational after {board.starts.sent} NMT starts: {step.finding}"
        return self._throttle.report(Severity.WARNING, board.name, text, kind=f"{board.name} finding")

    def _receive_emergency(
        self, board: BoardWatch, data: bytes, length: int, decode: Callable[[bytes], Emergency]
    ) -> Output:
        if len(data) != length:
            return self._rejections.add(f"EMCY of {board.name} has {len(data)} bytes, not {length}")
        emergency = decode(data)
        if emergency.error_code == 0:
            board.error = None
            return self._throttle.report(Severity.INFO, board.name, "EMCY: no error")
        board.error = describe_emergency(emergency.error_code, emergency.error_register, data[3:])
        if self._state.current is LifeCycleState.FAULT:
            return self._throttle.report(Severity.WARNING, board.name, board.error)
        return self._state.lose(board.name, board.error)


def _watch(name: str, node_id: int, timeout_ns: int) -> BoardWatch:
    return BoardWatch(name, node_id, timeout_ns, f"{name}.heartbeat_timeout_s")
