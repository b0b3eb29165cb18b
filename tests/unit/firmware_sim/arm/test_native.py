"""The binding to the compiled dynamics: its structs, and its errors when the library does not fit."""

import ctypes

import pytest
from support.arm_files import arm_with

from firmware_sim.arm import native
from hil.core.errors import EnvironmentLackError


def test_every_field_of_the_compiled_parameters_is_filled() -> None:
    changes = {"axes.*.valve.overlap": 0.01, "axes.*.spring.centre_n": 1.0}
    packed = native.pack(arm_with(changes))
    for axis in packed.axis:
        assert all(getattr(axis, name) != 0.0 for name, _ in native.AxisParameters._fields_)
    assert all(getattr(packed, name) != 0.0 for name, _ in native.PackedParameters._fields_[1:])


def test_a_library_of_another_version_is_rejected(monkeypatch: pytest.MonkeyPatch) -> None:
    class Longer(ctypes.Structure):
        _fields_ = (*native.ArmState._fields_, ("more", ctypes.c_double))

    monkeypatch.setattr(native, "ArmState", Longer)
    with pytest.raises(
        EnvironmentLackError, match=r"another version of dynamics\.c; install it again: .*pip install -e"
    ):
        native.Dynamics()


def test_a_missing_library_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(native, "EXTENSION_SUFFIXES", [".of-no-python"])
    with pytest.raises(
        EnvironmentLackError, match=r"not compiled.*apt-get install gcc libc6-dev, then pip install"
    ):
        native.Dynamics()
