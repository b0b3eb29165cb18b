"""The shells: one gateway core in real time, in lockstep with simulated boards, or replayed."""
