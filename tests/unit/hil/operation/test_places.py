"""Fair shares of the places of clients."""

from __future__ import annotations

from hil.operation.places import Place, Places


class Bench:
    """Places for three clients. ``evicted`` are the numbers of the clients that lost theirs."""

    def __init__(self) -> None:
        self.places = Places(3)
        self.evicted: list[int] = []
        self._number = 0

    def take(self, process_id: int) -> Place | None:
        number = self._number = self._number + 1
        return self.places.take(process_id, float(number), lambda: self.evicted.append(number))


def test_a_process_may_hold_every_place_but_no_more() -> None:
    bench = Bench()
    assert all(bench.take(7) for _ in range(3))
    assert bench.take(7) is None
    assert bench.evicted == []


def test_another_process_gets_the_place_that_is_idle_for_longest() -> None:
    bench = Bench()
    first = bench.take(7)
    assert first is not None
    bench.take(7)
    bench.take(7)
    first.active_s = 9.0
    assert bench.take(8) is not None
    assert bench.evicted == [2]


def test_a_process_with_fewer_places_loses_none() -> None:
    bench = Bench()
    for process_id in (8, 7, 7, 9):
        assert bench.take(process_id) is not None
    assert bench.evicted == [2]
    assert bench.take(7) is None


def test_among_processes_with_one_place_each_the_newcomer_gets_one() -> None:
    bench = Bench()
    for process_id in (1, 2, 3, 4):
        assert bench.take(process_id) is not None
    assert bench.evicted == [1]


def test_a_place_that_is_given_back_is_free() -> None:
    bench = Bench()
    places = [bench.take(7) for _ in range(3)]
    for place in places:
        assert place is not None
        bench.places.release(place)
        bench.places.release(place)
    assert all(bench.take(7) for _ in range(3))
