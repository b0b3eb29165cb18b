"""The modules that a sample passes on its way to a valve, and the tests that must notice their mutants."""

from __future__ import annotations

MODULES = tuple(
    f"hil/core/{name}.py"
    for name in (
        "sample_guard",
        "surplus_answers",
        "sync_matching",
        "axis_loops",
        "references",
        "envelope",
        "envelope_settings",
        "valve_commands",
        "gateway",
        "period_clock",
        "stale_periods",
        "life_cycle",
        "operating_state",
        "arming",
        "operator_requests",
        "axis_requests",
        "jog",
        "jogging",
        "board_supervision",
        "board_watch",
        "nmt_starts",
        "rejections",
        "foreign_frames",
        "hardware_protection",
        "watched_input",
        "valve_read_back",
        "input_settings",
        "output",
        "wire/codec",
        "wire/crc8",
        "wire/frame_crc",
    )
)
NOT_RUN = frozenset(
    {
        "test_closed_loop_poles.py",
        "test_control_law.py",
        "test_controller_file.py",
        "test_document_kinds.py",
        "test_documents.py",
        "test_excitation.py",
        "test_law_matching.py",
        "test_setpoint_profile.py",
    }
)
"""Test files of ``tests/unit/hil/core`` that are about other modules. Leaving them out saves time."""
