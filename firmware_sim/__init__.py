"""Simulated firmware: the valve and potentiometer boards, and the plants behind them."""
