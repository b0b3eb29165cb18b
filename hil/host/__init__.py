"""What depends on this machine: preflight checks, real-time rights, virtual CAN, child processes."""
