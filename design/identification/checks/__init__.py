"""What can be said against a record or a model, as typed findings."""
