"""Searchers over the unit cube: one interface, several methods, and the parameter bounds."""
