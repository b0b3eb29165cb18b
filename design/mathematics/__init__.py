"""Batched polynomials, the largest value of a frequency response, and the matrix exponential."""
