"""The names under which a server may be called: those of the machine, and no others (DNS rebinding)."""

from __future__ import annotations

import ipaddress
import re
import socket
from pathlib import Path

import pytest

from hil.live import address
from hil.live.address import LOOPBACK, machine_addresses, open_address, open_stream_address


def names(host: str) -> list[str]:
    """Return the accepted names without their port, which all of them have."""
    with open_stream_address(host, 0) as opened:
        end = f":{opened.listener.getsockname()[1]}"
        assert all(name.endswith(end) for name in opened.hosts)
        return [name.removesuffix(end) for name in opened.hosts]


def test_a_server_on_every_address_answers_to_each_of_the_machine(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(address, "machine_addresses", lambda: [LOOPBACK, "192.168.1.5", "10.0.0.7"])
    monkeypatch.setattr(socket, "gethostname", lambda: "Rig-PC")
    assert names("0.0.0.0") == ["rig-pc", LOOPBACK, "192.168.1.5", "10.0.0.7", "localhost"]
    assert "192.168.1.5:" in capsys.readouterr().err  # the user sees what to open on another machine
    with open_address("0.0.0.0") as page:
        assert any(host.startswith("192.168.1.5:") for host in page.hosts)


def test_a_server_on_one_address_answers_to_no_other(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(address, "machine_addresses", lambda: ["192.168.1.5"])
    assert names(LOOPBACK) == [LOOPBACK, "localhost"]
    assert names("localhost") == ["localhost", LOOPBACK]
    assert names("127.0.0.2") == ["127.0.0.2"]


def test_the_port_that_browsers_do_not_send_may_be_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    with open_address() as other:
        port = other.listener.getsockname()[1]
        assert LOOPBACK not in other.hosts
    monkeypatch.setattr(address, "DEFAULT_PORT", port)
    with open_address(LOOPBACK, port) as page:
        assert {LOOPBACK, f"{LOOPBACK}:{port}"} <= set(page.hosts)
        assert page.url.startswith(f"http://{LOOPBACK}:{port}/")


def test_the_addresses_of_the_machine_are_those_of_its_interfaces() -> None:
    found = machine_addresses()
    assert LOOPBACK in found
    assert len(set(found)) == len(found)
    for each in found:
        assert ipaddress.ip_address(each).version == 4
        with socket.socket() as sock:
            sock.bind((each, 0))  # refused for an address that is not the machine's
    local = re.findall(r"\|-- (\S+)\n +/32 host LOCAL", Path("/proc/net/fib_trie").read_text())
    assert LOOPBACK in local
    assert set(local) <= set(found)
