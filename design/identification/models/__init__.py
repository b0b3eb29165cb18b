"""Model structures, sampled and continuous models, and the way between them."""
