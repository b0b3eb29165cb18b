"""Models: plant documents and what a loop sees of them, controllers, realisations, and measured records."""
