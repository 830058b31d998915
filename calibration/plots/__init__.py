"""Pictures of fits and plans. Each function returns a matplotlib figure and saves nothing."""
