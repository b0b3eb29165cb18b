"""From a design file to a controller: weight selection, fixed-structure synthesis, baselines."""
