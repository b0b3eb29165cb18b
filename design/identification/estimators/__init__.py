"""Parametric estimators, and the numerics that they share."""
