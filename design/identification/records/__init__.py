"""Records as the estimators take them."""
