"""Fits: predictions and their derivatives, misfit, bounded least squares."""
