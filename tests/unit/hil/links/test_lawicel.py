"""A serial adapter, emulated on pseudo-terminals, passes the contract of links."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from can.interfaces.slcan import slcanBus
from support.back_to_back import BackToBack, Ends, Unplugging
from support.lawicel_adapters import TwoAdapters
from support.link_contract import LinkContract, Pair, arrived

from hil.core.errors import LinkError
from hil.core.frames import Frame
from hil.links import open_link


class TestSlcan(LinkContract):
    origin = "user"

    @pytest.fixture
    def adapters(self) -> Iterator[TwoAdapters]:
        with TwoAdapters() as adapters:
            yield adapters

    @pytest.fixture
    def pair(self, adapters: TwoAdapters) -> Iterator[Pair]:
        with (
            open_link(f"slcan:{adapters.one.device}") as one,
            open_link(f"slcan:{adapters.other.device}") as other,
        ):
            yield one, other

    def test_opening_sets_the_bit_rate_and_joins_the_bus(self, adapters: TwoAdapters) -> None:
        adapter = adapters.one
        with open_link(f"slcan:{adapter.device}@230400"):
            assert adapter.commands == [b"C", b"S6", b"O"]
            assert adapter.on_bus

    @pytest.mark.parametrize(
        ("bit_rate", "command"), [(10_000, b"S0"), (250_000, b"S5"), (800_000, b"S7"), (1_000_000, b"S8")]
    )
    def test_the_adapter_is_set_to_the_bit_rate_of_the_bus_also_when_it_is_opened_again(
        self, adapters: TwoAdapters, bit_rate: int, command: bytes
    ) -> None:
        adapter = adapters.one
        with open_link(f"slcan:{adapter.device}", bit_rate) as link:
            link.reopen()
            assert [line for line in adapter.commands if line[:1] == b"S"] == [command] * 2

    def test_a_bit_rate_that_the_protocol_does_not_have_is_refused(self, adapters: TwoAdapters) -> None:
        with pytest.raises(LinkError) as refused:
            open_link(f"slcan:{adapters.one.device}", 83_333)
        assert str(refused.value) == (
            f"slcan:{adapters.one.device}: a serial adapter cannot be set to 83333 bit/s: the bit rates of "
            "the Lawicel protocol are 10000, 20000, 50000, 100000, 125000, 250000, 500000, 800000 and "
            "1000000 bit/s; change bus.bit_rate in the rig file, or use a SocketCAN adapter"
        )
        assert adapters.one.commands == []

    def test_frames_that_the_adapter_refuses_are_counted(self, pair: Pair, adapters: TwoAdapters) -> None:
        sender, _ = pair
        adapters.one.on_bus = False
        sender.send(Frame(1))
        assert sender.receive(0.5) is None
        assert sender.send_failures == 1

    def test_a_full_line_is_counted_and_frames_stay_whole(self, pair: Pair, adapters: TwoAdapters) -> None:
        sender, receiver = pair
        adapters.pause()
        taken = []
        for number in range(10_000):
            failures = sender.send_failures
            sender.send(Frame(number & 0x7FF, number.to_bytes(8, "little")))
            if sender.send_failures == failures:
                taken.append(number)
        assert 100 < len(taken) < 10_000
        adapters.resume()
        numbers = []
        while len(numbers) < len(taken):
            assert sender.receive(0) is None
            frame = arrived(receiver)
            numbers.append(int.from_bytes(frame.data, "little"))
            assert frame.id == numbers[-1] & 0x7FF
        assert numbers == taken
        assert receiver.receive(0.1) is None
        assert receiver.dropped() == 0

    def test_receiving_writes_the_rest_of_a_frame_that_the_line_took_in_part(
        self, pair: Pair, adapters: TwoAdapters
    ) -> None:
        sender, receiver = pair
        adapters.pause()
        number = 0
        while not sender._port.bus._unsent:  # type: ignore[union-attr]
            failures = sender.send_failures
            while sender.send_failures == failures:
                sender.send(Frame(0x100, bytes(number % 8)))  # varying lengths fill the line within a frame
                number += 1
            adapters.resume()
            while receiver.receive(0.2) is not None:
                pass
            adapters.pause()
        adapters.resume()
        last = Frame(0x100, bytes((number - 2) % 8))
        assert sender.receive(0) is None
        assert arrived(receiver) == last
        assert not sender._port.bus._unsent  # type: ignore[union-attr]

    def test_noise_is_counted_and_discarded(self, pair: Pair, adapters: TwoAdapters) -> None:
        _, receiver = pair
        adapters.other.outgoing.append(
            b"t12\rtXYZ0\rt1238AABB\rT12\r\xff\xfe\rt\xff\rV1013\r" + bytes(300) + b"\r"
            b"t-10105\rt810105\rT2000000000\rr8000\r"
        )
        pair[0].send(Frame(0x42))
        assert arrived(receiver) == Frame(0x42)
        assert (receiver.unreadable, receiver.dropped()) == (9, 0)

    def test_an_unplugged_adapter_is_a_link_error(self, pair: Pair, adapters: TwoAdapters) -> None:
        link, _ = pair
        adapters.unplug(adapters.one)
        with pytest.raises(LinkError, match=r"slcan:/dev/pts/\d+: cannot receive: .*unplugged"):
            link.receive(5)
        with pytest.raises(LinkError, match=r"cannot send: .*unplugged"):
            link.send(Frame(1))

    def test_a_link_that_is_opened_again_works_and_counts_on(self, pair: Pair, adapters: TwoAdapters) -> None:
        sender, receiver = pair
        adapters.other.outgoing.append(b"t12\r")
        adapters.one.on_bus = False
        assert sender.send(Frame(1))
        assert sender.receive(0.5) is None
        assert receiver.receive(0.5) is None
        for link in pair:
            link.reopen()
        assert sender.send(Frame(0x42))
        assert arrived(receiver) == Frame(0x42)
        assert (sender.send_failures, receiver.unreadable) == (1, 1)
        adapters.unplug(adapters.one)
        with pytest.raises(LinkError):
            sender.reopen()
        with pytest.raises(LinkError, match="closed"):
            sender.send(Frame(1))

    def test_a_device_that_does_not_answer_is_a_link_error(
        self, adapters: TwoAdapters, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setattr("hil.links.lawicel._BOOT_TIMEOUT_S", 0.1)
        adapters.one.ignored_lines = 1000
        with pytest.raises(LinkError, match="does not answer"):
            open_link(f"slcan:{adapters.one.device}")

    def test_an_adapter_that_restarts_on_opening_is_waited_for(self, adapters: TwoAdapters) -> None:
        adapters.one.ignored_lines = 2
        with open_link(f"slcan:{adapters.one.device}"):
            assert adapters.one.on_bus

    def test_an_adapter_without_500_kbit_s_is_a_link_error(self, adapters: TwoAdapters) -> None:
        adapters.one.refused.add(b"S6")
        with pytest.raises(LinkError, match="refused 500 kbit/s"):
            open_link(f"slcan:{adapters.one.device}")

    def test_a_second_program_cannot_open_the_adapter(self, pair: Pair, adapters: TwoAdapters) -> None:
        with pytest.raises(LinkError, match="another program uses it"):
            open_link(f"slcan:{adapters.one.device}")


class TestSlcanBackToBack(BackToBack):
    @pytest.fixture
    def ends(self) -> Iterator[Ends]:
        with (
            TwoAdapters() as adapters,
            open_link(f"slcan:{adapters.one.device}") as link,
            slcanBus(adapters.other.device, bitrate=500_000, sleep_after_open=0) as bus,
        ):
            while not adapters.other.on_bus:
                bus.recv(0.01)
            yield link, bus


class TestUnpluggedAdapter(Unplugging):
    """The adapter has a path of its own, as a rule of udev gives it one."""

    adapters: TwoAdapters
    path: Path

    @pytest.fixture
    def pair(self, tmp_path: Path) -> Iterator[Pair]:
        with TwoAdapters() as adapters:
            type(self).adapters, type(self).path = adapters, tmp_path / "adapter"
            self.path.symlink_to(adapters.one.device)
            with (
                open_link(f"slcan:{self.path}") as one,
                open_link(f"slcan:{adapters.other.device}") as other,
            ):
                yield one, other

    def unplug(self) -> None:
        self.path.unlink()
        self.adapters.unplug(self.adapters.one)

    def plug_in(self) -> None:
        self.adapters.plug_in(self.adapters.one)
        self.path.symlink_to(self.adapters.one.device)
