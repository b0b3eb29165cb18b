"""Match each answer of the ADC board to the SYNC that it answers.

The problem
-----------
A command may leave only in answer to a fresh sample: one that the board took at the last SYNC, and that
arrived within one period of it. SYNC carries no number, and the answer (TPDO1_ADC) does not say which SYNC
it answers. On a link that delays frames by 1.1 periods, the answer to the previous SYNC arrives 0.1 periods
after the last SYNC and looks like a quick answer to it. A loop that accepted it would have one period more of
dead time than its controllers were designed for.

The board counts its answers. A step of the counter by more than one shows how many answers were lost on
their way to the gateway. It does not show how many SYNCs were lost on their way to the board, because the
board does not answer those. An answer that arrives while a later SYNC is still outstanding (sent, and not
answered yet) has two explanations:

    late:  The link is slow. The answer belongs to an earlier SYNC, and the answer to the later one follows.
    lost:  The board missed a SYNC. The answer belongs to the last SYNC, and no answer follows.

The two differ only in what follows. Therefore the gateway sends no SYNC for some periods, and waits.

The states
----------
    SEARCHING        It is unknown which SYNC an answer belongs to. None was fresh since the board started.
    MATCHED          Answers are matched to SYNCs. The last answer belonged to the last SYNC.
    BEHIND           Answers are matched to SYNCs. The last answer belonged to an earlier SYNC: late or lost?
    RESYNCHRONISING  It is unknown which SYNC an answer belongs to, because a SYNC or an answer was lost.

    state                 what happens                                               next state
    --------------------  ---------------------------------------------------------  ---------------
    any                   the answer is fresh: it belongs to the last SYNC (rule 1)  MATCHED
                          and arrives within one period of it
    MATCHED, BEHIND       the answer belongs to the last SYNC, but is too old        MATCHED
    MATCHED, BEHIND       the answer belongs to an earlier SYNC                      BEHIND
    BEHIND                no further answer arrives in time (rule 3)                 RESYNCHRONISING
    MATCHED, no counter   a SYNC is not answered within its period (rule 6)          RESYNCHRONISING
    any                   the board restarts                                         SEARCHING
    MATCHED, BEHIND       the counter shows more answers than outstanding SYNCs      SEARCHING

Everything else leaves the state unchanged.

The rules
---------
1.  An answer whose counter is n higher than that of the answer before belongs to the n-th oldest
    outstanding SYNC. The answers to the n - 1 older ones were lost. Reason: this is right if no SYNC was
    lost. If one was lost, the answer is matched to a SYNC that is too old. The error is on the safe side: a
    fresh answer is rejected, but a late one is not accepted.
2.  While MATCHED, one SYNC leaves in every period, whether or not the SYNC before was answered. Reason:
    after a lost answer, the counter of the next answer shows the loss (rule 1).
3.  While BEHIND, no SYNC leaves until the next answer would have arrived: after the last SYNC, the latency
    of the last answer and one period have passed, or five periods at most. If an answer arrives, the link
    is slow, and rule 1 was right. If none arrives, the outstanding SYNCs are given up as lost. Reason for
    the extra period: the latency may vary from frame to frame. A latency that rises by more than one period
    during the wait is not detected.
4.  While SEARCHING or RESYNCHRONISING, a SYNC leaves only when none is outstanding. One that is not
    answered for five periods is given up. Reason: an answer can then belong to one SYNC only, so its age is
    known, and an answer that takes longer than one period never looks fresh. A latency of more than five
    periods is not detected.
5.  Elapsed time alone does not end a wait (rules 3 and 4): at least two periods without SYNC must have
    begun. Reason: time also passes while this machine stalls. The board may have stalled with it, and
    frames that have arrived meanwhile have not been read yet.
6.  Without a counter, a SYNC that is not answered within its period leads to RESYNCHRONISING, where it is
    given up after three periods. Reason: nothing shows that an answer was lost, so two SYNCs must never be
    outstanding. A sample that arrives three or more periods late is not detected.
7.  A SYNC that must not wait (it makes the DAC board apply a command that centres the valves) leaves at
    once in any state. Reason: safety comes first. Several SYNCs may then be outstanding while SEARCHING or
    RESYNCHRONISING; rule 1 matches an answer to the oldest of them, which is the safe side.

Two examples
------------
One column is one period. ``Sn`` is a SYNC at the beginning of its period, ``an`` is the board's answer to it.

A SYNC is lost. The answer a2 is matched to S1 (rule 1) and rejected. Two periods pass without SYNC (rules 3
and 5). Period 5 begins in state RESYNCHRONISING (rule 4)::

    period    0         1         2         3         4         5         6
    SYNC      S0        S1 lost   S2        -         -         S3        S4
    answer      a0                  a2                            a3        a4
    verdict     fresh               earlier                       fresh     fresh
    state       MATCHED             BEHIND                        MATCHED

The link becomes slow: from S1 on, an answer takes 1.1 periods. No answer is accepted any more::

    period    0         1         2         3         4         5         6
    SYNC      S0        S1        S2        -         S3        S4        -
    answer      a0                  a1        a2                  a3        a4
    verdict     fresh               earlier   too old             earlier   too old
    state       MATCHED             BEHIND    MATCHED             BEHIND    MATCHED
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from enum import Enum
from typing import TypeAlias

MAX_COUNTER_STEP = 127
"""Largest forward counter difference that is still accepted.

A larger one means that the counter went backwards.
"""
ANSWER_TIMEOUT_PERIODS = 5
"""Periods after which an unanswered SYNC is given up. A link with a larger latency cannot be detected."""
UNCOUNTED_ANSWER_TIMEOUT_PERIODS = 3
"""Periods after which an unanswered SYNC is given up while RESYNCHRONISING with a board without a counter."""
MIN_SILENT_PERIODS = 2
"""Number of periods without SYNC that must have begun before an unanswered SYNC is given up."""


class MatchState(Enum):
    """What is known about the correspondence of answers and SYNCs. See the module's docstring."""

    SEARCHING = "searching"
    MATCHED = "matched"
    BEHIND = "behind"
    RESYNCHRONISING = "resynchronising"


_SEARCHING, _MATCHED = MatchState.SEARCHING, MatchState.MATCHED
_BEHIND, _RESYNCHRONISING = MatchState.BEHIND, MatchState.RESYNCHRONISING


@dataclass(frozen=True, slots=True)
class Fresh:
    """Answer to the last SYNC that arrived within one period of it."""


@dataclass(frozen=True, slots=True)
class TooOld:
    """Answer to the last SYNC that arrived more than one period after it."""

    age_ns: int


@dataclass(frozen=True, slots=True)
class Earlier:
    """Answer to an earlier SYNC than the last one."""

    later_syncs: int
    """Number of SYNCs that were sent after the one that is answered."""


@dataclass(frozen=True, slots=True)
class Unasked:
    """Answer without an outstanding SYNC."""


@dataclass(frozen=True, slots=True)
class TooMany:
    """Answer whose counter shows more answers than there are outstanding SYNCs. It is not matched."""

    outstanding: int


Match: TypeAlias = Fresh | TooOld | Earlier | Unasked | TooMany
FRESH, UNASKED = Fresh(), Unasked()


class SyncMatcher:
    """State machine that decides when SYNC leaves and which SYNC an answer belongs to.

    Times are nanoseconds on one monotonic clock.
    """

    def __init__(self, period_ns: int, has_counter: bool) -> None:
        self.state = MatchState.SEARCHING
        self._period_ns = period_ns
        self._has_counter = has_counter
        self._outstanding: deque[int] = deque(maxlen=MAX_COUNTER_STEP)
        """Times at which the unanswered SYNCs left, oldest first."""
        self._latency_ns = 0
        """Age of the last answer while BEHIND."""
        self._silent_periods = 0

    @property
    def outstanding(self) -> int:
        """Number of SYNCs that were sent and are not answered yet."""
        return len(self._outstanding)

    def restart(self) -> None:
        """Search again, because the board has restarted or its answers cannot be trusted.

        SYNCs that were sent before may still be answered.
        """
        self.state = _SEARCHING

    def begin_period(self, now_ns: int, may_wait: bool) -> bool:
        """Begin a period and return whether SYNC leaves in it. It always does if it may not wait (rule 7)."""
        self._give_up_overdue(now_ns)
        if may_wait and self._is_waiting:
            self._silent_periods += 1
            return False
        self._silent_periods = 0
        self._outstanding.append(now_ns)
        return True

    def match(self, counter_step: int, now_ns: int) -> Match:
        """Match an answer that arrived at ``now_ns`` to its SYNC by rule 1.

        ``counter_step`` is the counter difference to the answer before, 1 or more; 1 without a counter.
        """
        outstanding = self._outstanding
        if counter_step > len(outstanding) and self._knows_number_of_answers:
            return TooMany(len(outstanding))
        if not outstanding:
            return UNASKED
        for _ in range(min(counter_step, len(outstanding)) - 1):
            outstanding.popleft()
        age_ns = now_ns - outstanding.popleft()
        if not outstanding and age_ns <= self._period_ns:
            self.state = _MATCHED
            return FRESH
        if self.state is _MATCHED or self.state is _BEHIND:
            self.state = _BEHIND if outstanding else _MATCHED
            self._latency_ns = age_ns
        return Earlier(len(outstanding)) if outstanding else TooOld(age_ns)

    @property
    def _knows_number_of_answers(self) -> bool:
        """True if no more answers can come than SYNCs are outstanding.

        Without a counter nothing shows how many answers came. While SEARCHING or RESYNCHRONISING, answers to
        SYNCs that were given up may still arrive.
        """
        return self._has_counter and (self.state is _MATCHED or self.state is _BEHIND)

    @property
    def _is_waiting(self) -> bool:
        """True if SYNC has to wait for an answer (rules 3 and 4)."""
        if self.state is _MATCHED:
            return False
        return self.state is _BEHIND or len(self._outstanding) > 0

    def _give_up_overdue(self, now_ns: int) -> None:
        """Give up the SYNCs whose answers are overdue (rules 3 to 6)."""
        outstanding = self._outstanding
        if self.state is _MATCHED and not self._has_counter and outstanding:
            self.state = _RESYNCHRONISING
        if self._silent_periods < MIN_SILENT_PERIODS:
            return
        if self.state is _BEHIND:
            longest_ns = ANSWER_TIMEOUT_PERIODS * self._period_ns
            if now_ns - outstanding[-1] >= min(self._latency_ns + self._period_ns, longest_ns):
                outstanding.clear()
                self.state = _RESYNCHRONISING
        elif self.state is not _MATCHED:
            timeout_ns = self._timeout_periods * self._period_ns
            while outstanding and now_ns - outstanding[0] >= timeout_ns:
                outstanding.popleft()

    @property
    def _timeout_periods(self) -> int:
        if self.state is _RESYNCHRONISING and not self._has_counter:
            return UNCOUNTED_ANSWER_TIMEOUT_PERIODS
        return ANSWER_TIMEOUT_PERIODS
