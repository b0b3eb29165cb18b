"""The simulated boards as state machines: the ADC board, the DAC board, the serial adapter."""
