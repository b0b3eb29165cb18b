"""Output of a design: controller files, report, figures, terminal text and progress."""
