"""Plans: from fitted models and their uncertainty to what the machine is told."""
