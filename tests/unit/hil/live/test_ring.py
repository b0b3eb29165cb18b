"""The ring in shared memory: a reader takes whole messages, in order, and knows what it lost."""

import threading

import pytest

from hil.live.ring import OVERHEAD_BYTES, RingReader, RingWriter, ring_bytes

SLOT_BYTES = OVERHEAD_BYTES + 16
SLOTS = 8


@pytest.fixture
def memory() -> memoryview:
    return memoryview(bytearray(ring_bytes(SLOT_BYTES, SLOTS)))


@pytest.fixture
def writer(memory: memoryview) -> RingWriter:
    return RingWriter(memory, SLOT_BYTES, SLOTS)


@pytest.fixture
def reader(memory: memoryview, writer: RingWriter) -> RingReader:
    return RingReader(memory, SLOT_BYTES, SLOTS)


def write(writer: RingWriter, first: int, end: int) -> None:
    for number in range(first, end):
        writer.write(b"%d" % number)


def test_each_message_is_read_once_and_in_order(writer: RingWriter, reader: RingReader) -> None:
    for first, end in ((0, 3), (3, 3), (3, 9)):
        write(writer, first, end)
        assert reader.read() == ([b"%d" % number for number in range(first, end)], 0)


def test_a_slow_reader_loses_the_oldest_and_counts_them(writer: RingWriter, reader: RingReader) -> None:
    write(writer, 0, SLOTS + 5)
    assert reader.read() == ([b"%d" % number for number in range(5, SLOTS + 5)], 5)


def test_a_late_reader_begins_with_the_oldest_that_is_left(memory: memoryview, writer: RingWriter) -> None:
    write(writer, 0, 20)
    late = RingReader(memory, SLOT_BYTES, SLOTS)
    assert late.read() == ([b"%d" % number for number in range(12, 20)], 0)


def test_a_message_that_is_being_written_is_left_for_the_next_time(
    memory: memoryview, writer: RingWriter, reader: RingReader
) -> None:
    write(writer, 0, 3)
    place = 8 + 2 * SLOT_BYTES + OVERHEAD_BYTES
    memory[place] ^= 1
    assert reader.read().messages == [b"0", b"1"]
    memory[place] ^= 1
    assert reader.read() == ([b"2"], 0)


def test_a_message_that_is_being_overwritten_is_lost(
    memory: memoryview, writer: RingWriter, reader: RingReader
) -> None:
    write(writer, 0, SLOTS)
    memory[8 + OVERHEAD_BYTES] ^= 1
    assert reader.read() == ([b"%d" % number for number in range(1, SLOTS)], 1)


def test_a_length_that_is_not_whole_is_not_believed(
    memory: memoryview, writer: RingWriter, reader: RingReader
) -> None:
    write(writer, 0, 1)
    memory[12:16] = b"\xff" * 4
    assert reader.read() == ([], 0)


def test_a_message_that_does_not_fit_is_refused(writer: RingWriter) -> None:
    writer.write(bytes(16))
    with pytest.raises(ValueError, match="17 bytes does not fit"):
        writer.write(bytes(17))


def test_a_reader_beside_a_fast_writer_never_takes_a_mixed_message(
    writer: RingWriter, reader: RingReader
) -> None:
    count = 20_000
    thread = threading.Thread(target=lambda: [writer.write(b"%08d" % n * 2) for n in range(count)])
    thread.start()
    taken: list[int] = []
    lost = 0
    while True:
        is_last = not thread.is_alive()
        messages, more = reader.read()
        assert all(message[:8] == message[8:] for message in messages)
        taken += [int(message[:8]) for message in messages]
        lost += more
        if is_last:
            break
    assert taken == sorted(set(taken)) and taken[-1] == count - 1
    assert len(taken) + lost == count
