"""The ways of ``hil vcan`` that need a kernel with vcan: an interface of the host, and a namespace."""

import subprocess
import sys

from hil.host.vcan import Way, choose_way

VCAN = [sys.executable, "-m", "hil.cli", "vcan", "--"]
EXCHANGE = "candump -L -n 1 vcan0 & until cansend vcan0 123#C0FFEE && ! kill -0 $!; do :; done; exit 9"


def way_in(namespace: list[str]) -> str:
    program = "from hil.host.vcan import choose_way; print(choose_way().name, end='')"
    return subprocess.run([*namespace, sys.executable, "-c", program], capture_output=True, text=True).stdout


def test_an_interface_that_is_up_is_used() -> None:
    assert choose_way() is Way.NATIVE
    done = subprocess.run([*VCAN, "sh", "-c", EXCHANGE], capture_output=True, text=True)
    assert (done.stdout.split()[1:], done.returncode) == (["vcan0", "123#C0FFEE"], 9), done.stderr
    assert subprocess.run([*VCAN, "no-such-command"], capture_output=True).returncode == 127


def test_without_an_interface_a_namespace_is_made() -> None:
    elsewhere = ["unshare", "-n"]
    assert way_in(elsewhere) == "NAMESPACE"
    done = subprocess.run([*elsewhere, *VCAN, "sh", "-c", EXCHANGE], capture_output=True, text=True)
    assert (done.stdout.split()[1:], done.returncode) == (["vcan0", "123#C0FFEE"], 9), done.stderr


def test_an_interface_that_is_down_is_not_used() -> None:
    down = ["unshare", "-n", "sh", "-c", 'ip link add dev vcan0 type vcan && exec "$@"', "sh"]
    assert way_in(down) == "NAMESPACE"


def test_root_keeps_its_rights_in_a_namespace() -> None:
    show = "import os; print(os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1)))"
    done = subprocess.run(
        ["unshare", "-n", *VCAN, sys.executable, "-c", show], capture_output=True, text=True
    )
    assert done.stdout == "None\n", done.stderr
