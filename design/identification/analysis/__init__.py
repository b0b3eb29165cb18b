"""Models beside data: simulation, residuals, uncertainty, and responses measured without a model."""
