"""What a design writes: controller files, report, figures and terminal text."""
