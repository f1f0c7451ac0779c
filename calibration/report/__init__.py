"""What a fit found, as numbers, remarks, plots and pages."""
