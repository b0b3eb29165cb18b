"""Parts that depend on the machine: preflight checks, real-time rights, virtual CAN, child processes."""
