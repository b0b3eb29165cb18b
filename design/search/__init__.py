"""Searchers for the best point of a unit cube: one interface, three methods, and the search bounds."""
