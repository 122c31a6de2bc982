"""Uncertainty of a fit: covariance, intervals, identifiability."""
