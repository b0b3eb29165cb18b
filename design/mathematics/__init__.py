"""Polynomials, peaks of rational functions over frequency, and the matrix exponential."""
