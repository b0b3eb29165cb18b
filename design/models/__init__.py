"""Plant models, their realisations, what limits any controller of them, and measured records."""
