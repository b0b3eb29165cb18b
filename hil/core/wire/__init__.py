"""The wire: ``arm.dbc`` describes every frame; the codec is compiled from it."""
