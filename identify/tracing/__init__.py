"""The search for missing effects: score, select, refit, check."""
