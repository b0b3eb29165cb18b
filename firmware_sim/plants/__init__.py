"""Plants behind the simulated boards: the interface, and linear plants."""
